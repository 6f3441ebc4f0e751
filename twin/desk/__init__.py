"""The desk: a local page that lists what commands wrote to a folder, opens reports and the viewer, and compares two.

entries   what lies in a folder: runs, campaigns, diagnoses, comparisons, studies and so on, each read from its own document
desk      the page
server    answers a browser on this computer
"""
