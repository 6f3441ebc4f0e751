"""Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.

campaign -> observe (residuals of cut blocks and closed loop, noise) -> screen and fit every effect on every axis
         -> select (one by one while they earn their place) -> check on runs left out -> diagnosis
"""

from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.procedure import diagnose

__all__ = ["Diagnosis", "diagnose"]
