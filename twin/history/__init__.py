"""A machine over time, and against its own earlier record.

dated campaigns -> projections (G, b) -> sizes over time -> change, cause, forecast          `watch`, `judge`, `document`
campaign and baseline -> the same projections about the machine of the baseline -> differences    `since`
"""
