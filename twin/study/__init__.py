"""Design studies: vary numbers of the machine file, run programs or set points, tell what each number buys.

spec.py       the study file: factors, design, runs, responses
design.py     factors -> table of variants
evaluate.py   one variant -> its responses (the only part that simulates; runs on threads or on a cluster)
store.py      results in SQLite, one row committed as it arrives
carry_out.py  variants -> store, on any `concurrent.futures` executor
answers.py    table -> main effects, sensitivity indices, Pareto front, surrogate
output.py     table, plots, report, best machine
"""

from twin.study.spec import Study, read_study

__all__ = ["Study", "read_study"]
