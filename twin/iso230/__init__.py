"""The trade's yardsticks: positioning by ISO 230-2 and circles by ISO 230-4, from measurements and from the twin.

table, trace, run or campaign -> readings -> the standard's numbers -> the usual plot
"""
