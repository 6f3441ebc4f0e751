"""Diagnosis of the sim-to-real gap: its location, its cause, and how far a correction reduces it.

campaign -> observe (noise, residuals of single blocks and of the closed loop) -> screen and fit all effects on all axes
         -> accept the effects that reach the evidence they need -> validate on held-out runs -> diagnosis

procedure        the steps in their order; setup: what they share; settings: their thresholds; state: what a step takes and returns
observe          a group of axes (axis_groups) in all runs (view): channels (channel, control_law), their noise (noise), simulations
tuning           re-tuning: tolerance, columns, drive_train, imperfections, slip
search           rounds of starts (start_values), screen, rivals, fit, cross_validation, plausible, not_visible
verdict          final sizes (sizes), probabilities, what stays unknown
validation       the corrected machine (corrected) on held-out runs, judged by judgement; law: laws that no effect describes
where            places of the gap, from the residual of each block (blocks, force_balance, recorded_control)
budget           contributions at the tool point (tool_point); waterfall: the gap step by step; next_measurement
diagnosis        the result and its document; output, report, recording and wording present it
first            the first answer to a recording, without a machine file
"""

from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.procedure import diagnose

__all__ = ["Diagnosis", "diagnose"]
