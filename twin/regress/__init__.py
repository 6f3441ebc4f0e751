"""Headless regression runs: cases against golden results, with machine-readable verdicts.

suite     TOML files -> checked cases              golden    result of a case, and the stored one with versions, date and reasons
runners   runs each kind of case
compare   outcome against golden, within tolerance where     first block of an axis whose behaviour changed
run_suite all cases in parallel                    write     table, JUnit XML, JSON
recorded  moves, and campaigns of the second plant evidence  folder of a failed case
"""
