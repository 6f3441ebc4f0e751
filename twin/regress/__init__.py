"""Headless regression runs: cases against golden results, with machine-readable verdicts.

suite     TOML files -> checked cases              outcome   result of a case: trace, events, numbers
runners   runs each kind of case                   golden    stored result, with versions, date and reasons
compare   outcome against golden, within tolerance where     first block of an axis whose behaviour changed
run_suite all cases in parallel                    write     table, JUnit XML, JSON
recorded  moves, and campaigns of the second plant evidence  folder of a failed case
"""
