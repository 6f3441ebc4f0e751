"""Tools for those who develop twin: benchmarks, calibration, pictures. Not part of the wheel."""
