"""Files of controls: correction tables and parameters, written and read back.

table        a datum to enter, with its old value and grade; the error of an axis over position, by direction, independent of a control
linuxcnc     compensation file of a joint (types 0 and 1) as its loader reads it, lines of the ini file
sinumerik    archives of machine data and encoder compensation (EEC); cross compensation (CEC) is read only
heidenhain   parameter lists, old correction tables
isg          lists of leadscrew error compensation (.lis) of Beckhoff and ISG kernels

Nothing is ever sent to a machine. Every statement about a format carries its grade: A read in a manual or in source code, B in a
secondary source, C general knowledge that a user must check before relying on it. A writer prints each grade below A into its file.
"""
