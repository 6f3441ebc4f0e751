"""Headless regression runs: cases against golden results, with a verdict that a program can read.

suite     TOML files -> checked cases              outcome   what one case gives: trace, events, numbers
runners   how each kind of case is run             golden    the kept result, with versions, date and reasons
compare   outcome against golden, within tolerance where     which block of which axis left its law first
run_suite all cases in parallel                    write     table, JUnit XML, JSON, a folder for each failure
"""
