"""Two runs, campaigns or machines beside each other, aligned on their set points.

align      rows of two traces that belong together, by time where the set points agree, else by the way along the path
compare    two traces -> Comparison: what differs, by axis and signal, and where most
machines   two machine files -> the numbers and effects that differ
"""
