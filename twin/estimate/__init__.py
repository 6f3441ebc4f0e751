"""Estimation: problem -> linearised -> solved. Nothing here depends on machines: other rooms define the free parameters and the residuals.

problem        free numbers with bounds and steps, residuals by part and signal; at a point their columns, damped step, covariance by clusters
search         damped Gauss-Newton on all parts at once, each signal with an unknown noise level
regression     the linear problem: values, covariance by clusters, what the data do not separate
held_out_gain  held-out evidence between two laws
noise_of_signals  whether a residual is noise of the signals of a law
"""
