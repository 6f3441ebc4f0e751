"""The examination: a second plant of its own, sealed campaigns drawn from it, and what they say about a diagnosis.

The plant, from the machine file to the campaign (each module one idea; none imports the twin's laws):
    parameters   machine file and factors -> SI arrays          paths       moves and contours within limits
    tilting_pair Lagrangian of A and C                          programme   set points of test, program and exam runs
    friction     stick-slip and bristle                         effects     the library's effects, written afresh
    mechanics    motors, drive trains, loads, RK4               outside     effects that the library does not have
    control      the sampled cascade                            richness    small physics that is always on
    measurement  scales, encoders, noise                        plant       one run: settings, set points -> Trace
    compiled     the decorator of compiled functions            draw        case by seed, campaign files, truth
"""
