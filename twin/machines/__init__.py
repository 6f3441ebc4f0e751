"""A machine of one's own: a machine file from an MJCF or URDF, what is missing or unusual in it, its loops, its data sheet.

new         a commented machine file from a model
check       what is missing, impossible or unusual, with the margins of each loop
show        the data sheet, also under the names of a Sinumerik's machine data
"""
