"""Standard tests of machine tools: positioning by ISO 230-2 and circles by ISO 230-4, for measurements and for the twin.

table, trace, run or campaign -> readings -> numbers of the standard -> the usual plot
"""
