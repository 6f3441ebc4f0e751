"""Design studies: vary numbers of the machine file, run programs or set points, show what each number buys.

    study file -> variants -> evaluate, on threads or a cluster -> store -> results -> report, best machine

spec.py       the study file: factors, ties, design, runs, responses
paths.py      numbers of a machine by path
design.py     factors -> table of variants -> machines
evaluate.py   one variant -> its responses (the only part that simulates)
carry_out.py  variants -> store, on any `concurrent.futures` executor
store.py      results in SQLite, one row committed as it arrives
answers.py    main effects, sensitivity indices, Pareto front, surrogate: numbers in, numbers out
results.py    rows of a study -> its answers; the table; the surrogate of a finished study
report.py     findings in words, figures, HTML
output.py     all that is written
"""
