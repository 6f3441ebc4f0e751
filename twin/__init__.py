"""Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant (one compiled loop) -> trace -> tool path -> cut surface
                                                  ^                              |
                          machine (+ effects) ----+---- identify <- campaign ----+-> gap -> diagnose -> corrected machine

SI inside; arrays are (sample, axis) in the order of the machine's axes.
"""

__version__ = "0.1.0"
