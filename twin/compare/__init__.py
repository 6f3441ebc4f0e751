"""Compare two runs, campaigns or machines, aligned on their set points.

align      two traces -> the same on common rows, matched by time or by path length
compare    two traces -> Comparison: differences by axis and signal; two machine files -> the numbers and effects that differ
pages      HTML pages of a gap and of a comparison
"""
