"""Simulation: set points and a machine in, a trace out. Start with `run`."""
