"""Diagnosis of the sim-to-real gap: its location, its cause, and how far a correction reduces it.

campaign -> observe (noise, residuals of single blocks and of the closed loop) -> screen and fit all effects on all axes
         -> accept the effects that reach the evidence they need -> validate on held-out runs -> diagnosis
"""

from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.procedure import diagnose

__all__ = ["Diagnosis", "diagnose"]
