"""Write the identified machine as a machine file, and the result as JSON."""

from dataclasses import asdict, replace
import math
from pathlib import Path
from typing import Any

from twin.documents import flat, value_at
from twin.estimate.regression import Range
from twin.identify.between_samples import is_hidden
from twin.identify.check_recording import ONE_SPEED
from twin.identify.drive_balance import FRICTIONS
from twin.identify.result import Identification, Parameter
from twin.machine.commented import ASSUMED, BOUNDED, TRIED, of_unknown_scale
from twin.machine.machine import Machine, write_machine

NEED_NO_SCALE = ("1", "1/s", "s", "Hz")
"""Units of numbers that time and ratios give, whatever the units of the recorded signals are."""

WIDE = 0.5
"""A value is bounded, not identified, if half its 95 % interval is larger than this share of the value."""


def is_wide(p: Parameter, r: Range) -> bool:
    """Is this value of a parameter bounded, not identified? A delay near zero is a delay all the same."""
    return r.half > WIDE * abs(r.value) and not p.path.endswith(("delay_s", "time_s"))


def machine_comments(result: Identification) -> dict[str, str]:
    """Path -> comment of each changed value: grade, interval, campaign. A value that only its product or sum determines says so."""
    name = Path(result.campaign).name
    out = {}
    changed = _changed(result.before, result.machine)
    one_speed = {finding.axis for finding in result.findings if finding.text.startswith(ONE_SPEED)}
    inertia = {p.axis: result.taken(p) for p in result.parameters if p.name == "inertia"}
    for p in result.parameters:
        if p.path in changed or (p.path and p.at_bound and result.taken(p) is not None):
            r = result.taken(p) or p.value
            limit = ", at its bound" if p.at_bound else ""
            split = p.name in FRICTIONS and p.axis in one_speed
            limit += ", known is the sum of both frictions in the narrow range of speeds driven" if split else ""
            # what the fit leaves open keeps the interval of the regression
            value, room = float(value_at(result.machine.document, p.path) or 0.0), 1e-6 * abs(r.value)
            outside = not r.low - room <= value <= r.high + room
            grade = BOUNDED if split or outside or is_wide(p, r) else "identified"
            # a controller whose work between the samples is not recorded is any that moves the axis alike
            grade = TRIED if math.isnan(p.condition) and is_hidden(result.before, result.machine.axis(p.axis)) else grade
            text = f"{grade}  95 % {r.low:.6g} .. {r.high:.6g}{limit}, campaign {name}"
            out[p.path] = of_unknown_scale(text, result.unscaled.get(p.axis, {})) if p.product or p.unit not in NEED_NO_SCALE else text
    for path in changed:
        if path in out or path == "effect":
            continue
        if path.startswith("measurement."):
            out[path] = f"identified  from standstill, campaign {name}"
        elif "rotor" in path or "moving_mass" in path:
            whole, axis = inertia.get(path.split(".")[1]), result.machine.axis(path.split(".")[1])
            hidden = is_hidden(result.before, axis)
            grade = BOUNDED if whole is None or whole.half > WIDE * abs(whole.value) or hidden else "identified"
            known = f"  95 % {whole.low:.6g} .. {whole.high:.6g} of the inertia at the motor" if whole is not None else ""
            text = f"{grade}{known}{f', by what the {axis.effort} does between its samples' if hidden else ''}, campaign {name}"
            out[path] = of_unknown_scale(text, result.unscaled.get(axis.name, {}))
        elif (own := _of_block(result, path)) is not None:
            out[path] = f"identified  95 % {own[0] - own[1]:.6g} .. {own[0] + own[1]:.6g}, campaign {name}"
        elif "torque_constant" in path or path.startswith("body."):
            out[path] = f"identified  share of products with the torque constant within parameter_tolerance, campaign {name}"
        elif path.startswith("axis.") and not path.endswith(("inductance_h", "resistance_ohm")):
            out[path] = f"{ASSUMED}  value of the best fit; campaign {name} alone does not determine it"
        else:
            out[path] = f"identified  campaign {name}"
    return out


def _of_block(result: Identification, path: str) -> tuple[float, float] | None:
    """A number of a block that the position controller shows, and its half interval, in the unit of the file; None at another path."""
    parts = path.split(".")
    law = result.direct.position.get(parts[1]) if parts[2:3] == ["block"] else None
    found = law.blocks.get(".".join(parts[3:])) if law is not None else None
    return found if found is not None and math.isfinite(found[1]) else None


def _changed(before: Machine, after: Machine) -> list[str]:
    """Paths of values that differ between two machine files."""
    old, new = (flat(machine.document, nested=(dict,)) for machine in (before, after))
    return [path for path, value in new.items() if value != old.get(path)]


def write_identified(result: Identification, path: str | Path) -> None:
    """Write the machine file: values rounded to their interval, each with its grade as a comment, and a table [identified] with the source."""
    changed = _changed(result.before, result.machine)
    machine = result.before.with_values({path: _rounded(value_at(result.machine.document, path)) for path in changed})
    table = {
        "campaign": Path(result.campaign).name,
        "route": result.chosen,
        "fitted_runs": list(result.training),
        "left_out_runs": list(result.held_out),
        "torque_constants": "current and motion determine only products; split within parameter_tolerance"
        if all(result.tolerance_holds.values())
        else "current and motion determine only products; the file's torque constants were kept where the products contradict parameter_tolerance",
    }
    machine = replace(machine, document={**machine.document, "identified": table})
    write_machine(machine, path, machine_comments(result))


def _rounded(value: Any) -> Any:
    """Round numbers to seven digits, also inside lists and tables; strings stay unchanged."""
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(v) for v in value]
    return value if isinstance(value, str | bool | int) else float(f"{value:.7g}")


def as_json(result: Identification) -> dict[str, Any]:
    """The result for JSON: parameters, findings, skew, gaps, times."""
    return {
        "campaign": result.campaign,
        "route": result.chosen,
        "refused": result.refused,
        "fitted_runs": list(result.training),
        "left_out_runs": list(result.held_out),
        "parameters": [
            {
                "axis": p.axis, "name": p.name, "unit": p.unit, "path": p.path, "before": p.before,
                **asdict(result.taken(p) or p.value),
                "product_at_file_torque_constant": asdict(p.estimate) if p.product else None,
                "regression": asdict(p.value), "refined": p.refined and asdict(p.refined),
                "taken": result.taken(p) is not None, "outcome": result.outcome(p),
                "condition": p.condition if math.isfinite(p.condition) else None, "at_bound": p.at_bound,
            }
            for p in result.parameters
        ],
        "findings": [{"run": f.run, "axis": f.axis, "text": f.text} for f in result.findings],
        "notes": [{"axis": f.axis, "text": f.text} for f in result.notes],
        "late_channels": [{"axis": c.axis, "signal": c.signal, "seconds": c.seconds, "low": c.seconds - c.half, "high": c.seconds + c.half} for c in result.skews],
        "gap": result.gaps,
        "tolerance_holds": result.tolerance_holds,
        "seconds": result.seconds,
    }  # fmt: skip
