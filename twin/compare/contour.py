"""Contour error of a run: distance of the followed tool path from that of the set points."""

from __future__ import annotations

import math

from twin.errors import TwinError
from twin.geometry.tool_path import contour_error, search_window, tool_path_of
from twin.simulation.result import Run


def contour_numbers(run: Run) -> dict[str, float] | None:
    """Largest and RMS contour error of the tool tip [um]; None for a machine without tool or part frame."""
    try:
        followed, commanded = (tool_path_of(run.trace, signal, run.machine) for signal in ("position", "setpoint"))
    except TwinError:
        return None
    found = contour_error(followed, commanded, search_window(run.machine)).error
    return {"max_um": float(found.max()) * 1e6, "rms_um": math.sqrt(float(found @ found) / len(found)) * 1e6}
