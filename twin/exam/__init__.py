"""The examination: sealed campaigns drawn from an independent second plant, their diagnosis, marks and score.

From the machine file to a campaign; none of these modules imports the twin's laws:
    parameters   machine file and factors -> SI arrays, sensors, imperfections paths       moves and contours within limits
    tilting_pair Lagrangian of A and C                                        programme   set points of test, program and exam runs
    mechanics    motors, drive trains, loads, friction, RK4                   effects     the library's effects, implemented independently
    control      the sampled cascade                                          outside     effects that the library lacks
    compensation functions that a control can switch on                       plant       one run: settings, set points -> Trace
    compiled     decorator of the compiled functions                          draw        case from a seed, campaign files, truth
"""
