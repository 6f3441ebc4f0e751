"""The examination: sealed campaigns drawn from an independent second plant, their diagnosis, marks and score.

From the machine file to a campaign; none of these modules imports the twin's laws:
    parameters   machine file and factors -> SI arrays          paths       moves and contours within limits
    tilting_pair Lagrangian of A and C                          programme   set points of test, program and exam runs
    friction     stick-slip and bristle                         effects     the library's effects, implemented independently
    mechanics    motors, drive trains, loads, RK4               outside     effects that the library lacks
    control      the sampled cascade                            richness    small imperfections on every axis
    measurement  scales, encoders, noise                        plant       one run: settings, set points -> Trace
    compiled     decorator of the compiled functions            draw        case from a seed, campaign files, truth
"""
