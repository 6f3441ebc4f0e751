"""The summary of a run: following error, current and utilisation of the limits by axis."""

from collections.abc import Hashable, Iterable, Sequence
import math
import re
from typing import Any, TypeVar

import numpy as np

from twin.control.structures import NC_WEIGHTS
from twin.effects import settings_of
from twin.effects.readable import setting_text
from twin.machine.machine import Machine
from twin.simulation.result import Run
from twin.units import AXIS_UNITS

Key = TypeVar("Key", bound=Hashable)


def summary_of(machine: Machine, run: Run) -> dict[str, Any]:
    """Numbers of `summary.json`, in um, arcsec, m/min, deg/s, A.

    The following error is set point minus position at the same time; the error without delay takes the set point `set_point_delay_s` earlier.
    """
    axes = {}
    for axis in machine.axes:
        trace = run.trace
        errors = run.errors[axis.name]
        effort, speed = trace.get(axis.name, axis.effort), trace.get(axis.name, "velocity")
        units = AXIS_UNITS[axis.kind]
        unit, factor = units.error
        per = _ending(axis.effort_unit)
        speed_unit, speed_factor = ("m/min", 60.0) if axis.kind == "linear" else ("deg/s", math.degrees(1.0))
        axes[axis.name] = {
            "following_error_max": errors.following * factor,
            "following_error_rms": errors.following_rms * factor,
            "error_without_delay_max": errors.without_delay * factor,
            "error_without_delay_rms": errors.without_delay_rms * factor,
            "reversal_peak": None if errors.reversal_peak is None else errors.reversal_peak * factor,
            "reversals": errors.reversals,
            "following_error_unit": unit,
            "speed_max": float(np.abs(speed).max() * speed_factor),
            "speed_unit": speed_unit,
            "speed_limit_used": float(np.abs(speed).max() / axis.max_velocity),
            "effort": axis.effort,
            "effort_unit": axis.effort_unit,
            f"{axis.effort}_max{per}": float(np.abs(effort).max()),
            f"{axis.effort}_rms{per}": float(np.sqrt(np.mean(effort**2))),
            f"{axis.effort}_limit{per}": axis.motor.peak_current_a,
            "current_limited_s": run.current_limited_s[axis.name],
            "voltage_limited_s": run.voltage_limited_s[axis.name],
        }
    effects = [dict(effect) for effect in machine.effects]
    return {"machine": machine.name, "effects": effects, "duration_s": float(run.trace.time[-1]), "axes": axes}


def _ending(unit: str) -> str:
    """Ending of a key with a unit: _a, _nm; _percent."""
    return "_" + re.sub(r"\W+", "_", unit.lower().replace("%", "percent")).strip("_")


def summary_table(summary: dict[str, Any]) -> str:
    """The summary as a text table."""
    rows = []
    for name, a in summary["axes"].items():
        effort, unit, error_unit = a["effort"], a["effort_unit"], a["following_error_unit"]
        largest, limit = (a[f"{effort}_{what}{_ending(unit)}"] for what in ("max", "limit"))
        limits = [f"{effort} {a['current_limited_s'] * 1e3:.1f} ms"] * (a["current_limited_s"] > 0)
        limits += [f"voltage {a['voltage_limited_s'] * 1e3:.1f} ms"] * (a["voltage_limited_s"] > 0)
        limits += ["speed"] * (a["speed_limit_used"] > 1.0)
        rows.append(
            [
                name,
                f"{a['error_without_delay_max']:.2f} {error_unit}",
                f"{a['error_without_delay_rms']:.2f} {error_unit}",
                "-" if a["reversal_peak"] is None else f"{a['reversal_peak']:.2f} {error_unit}",
                f"{a['following_error_max']:.2f} {error_unit}",
                f"{a['speed_max']:.3f} {a['speed_unit']}",
                f"{a['speed_limit_used'] * 100:.0f} %",
                f"{largest:.2f} {unit}",
                f"{largest / limit * 100:.0f} %",
                ", ".join(limits) or "-",
            ]
        )
    efforts = {a["effort"] for a in summary["axes"].values()}
    commanded = f"{efforts.pop()} max" if len(efforts) == 1 else "command max"
    errors = ("error without delay", "RMS", "after reversals", "following error max")
    return table(["axis", *errors, "speed max", "of limit", commanded, "of limit", "limits met"], rows)


def effects_line(machine: Machine) -> str:
    """The effects of a machine in one line: 'backlash X (clearance 15.0 um)', or 'none'."""
    return "; ".join(setting_text(setting, machine) for setting in settings_of(machine)) or "none"


def feedforward_line(machine: Machine) -> str:
    """Feedforward of the control: 'velocity+torque', or by axis if the axes differ: 'X off, Y velocity'."""
    words = {}
    for axis in machine.axes:
        weights = {word: getattr(axis.loops, name) for word, name in NC_WEIGHTS.items()}
        words[axis.name] = "+".join(word + ("" if w == 1.0 else f" x {w:.3g}") for word, w in weights.items() if w) or "off"
    if len(set(words.values())) == 1:
        return next(iter(words.values()))
    return ", ".join(f"{name} {word}" for name, word in words.items())


def listed(words: Sequence[str]) -> str:
    """'X', 'X and Y', 'X, Y and Z'."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def once(remarks: Iterable[tuple[Key, str]]) -> dict[Key, str]:
    """Remarks (key, axis) that differ in the axis alone as one: key -> 'axis X', 'axes X and Y', '' where they name no axis."""
    axes: dict[Key, list[str]] = {}
    for key, axis in remarks:
        axes.setdefault(key, []).append(axis)
    return {key: f"{'axis' if len(names) == 1 else 'axes'} {listed(names)}" if names[0] else "" for key, names in axes.items()}


def table(heading: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Plain text table; the first `left` columns are left-aligned, the others right-aligned."""
    widths = [max(len(str(row[i])) for row in [heading, *rows]) for i in range(len(heading))]
    lines = []
    for row in [heading, *rows]:
        cells = [str(cell).ljust(width) if i < left else str(cell).rjust(width) for i, (cell, width) in enumerate(zip(row, widths))]
        lines.append("  ".join(cells).rstrip())
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)
