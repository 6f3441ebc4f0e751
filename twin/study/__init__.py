"""Design studies: vary numbers of the machine file, run programs or set points, quantify the influence of each number.

    study file -> variants -> evaluate, on threads or a cluster -> store -> results -> report, best machine

spec.py       the study file: factors, ties, design, runs, responses
paths.py      numbers of a machine by path
design.py     factors -> table of variants -> machines
evaluate.py   one variant -> its responses (the only module that simulates)
execution.py  variants -> store, on any `concurrent.futures` executor
row_file.py   rows in SQLite, each committed as it arrives
outcomes.py   main effects, sensitivity indices, Pareto front, surrogate
results.py    rows of a study -> its answers; the table; the surrogate of a finished study
report.py     findings in words, figures, HTML
output.py     output files
"""
