"""The desk: a local web page that lists the results in a folder, opens reports and the viewer, and compares two results.

entries     results in a folder: runs, campaigns, diagnoses, comparisons, studies, ...
desk.html   template of the page
server      serves the page on this computer
"""
