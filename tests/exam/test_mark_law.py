"""The shape of a law found is compared with the true law of a fault outside the library."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin.exam.mark_law import SIMILAR, laws_of_fault, shape_agreement
from twin.exam.plant.outside import LAWS, OUTSIDE
from twin.exam.score import confusion, macro_f1
from twin.machine.machine import load_machine

MACHINE = load_machine()
FAULTS: dict[str, dict[str, Any]] = {
    "notch_filter": {"frequency_hz": 120.0, "width": 0.8},
    "position_dead_band": {"band": 5e-6},
    "speed_set_point_smoothing": {"time_constant_s": 4e-3},
    "one_sided_speed_clip": {"limit": 0.2},
    "magnetic_saturation": {"saturation_a": 30.0},
    "inverter_dead_time": {"voltage_v": 10.0},
    "windage": {"drag": 900.0},
    "warming_friction": {"share": -0.4, "time_constant_s": 60.0},
    "hardening_spring": {"stiffness": 1e8, "per_m2": 1e10},
    "two_stage_lost_motion": {"width": 20e-6, "share": 0.05},
    "scale_coupling_play": {"width": 10e-6},
    "scale_interpolation_error": {"amplitude": 1e-6, "period": 20e-6},
    "tilt_crosstalk": {"from_axis": "Y", "gain": -1e-4},
    "current_recorded_late": {"skew_s": 4e-3},
    "scale_sampling_jitter": {"deviation_s": 40e-6},
}
FOUND: dict[str, tuple[str, str, dict[str, float], tuple[float, float]]] = {
    "notch_filter": ("current", "notch", {"frequency_hz": 120.0, "width": 0.8}, (0.0, 1.0)),
    "position_dead_band": ("speed", "dead band", {"band": 5e-6}, (-1e-4, 1e-4)),
    "speed_set_point_smoothing": ("speed", "lag", {"time_constant_s": 4e-3}, (0.0, 1.0)),
    "one_sided_speed_clip": ("speed", "clip above", {"limit": 0.2}, (-0.22, 0.22)),
    "magnetic_saturation": ("torque", "bending", {"knee": 30.0}, (-30.0, 30.0)),
    "inverter_dead_time": ("voltage", "saturation", {"height": -10.0, "scale": 0.2}, (-10.0, 10.0)),
    "windage": ("friction", "power", {"height": 36.0, "reach": 0.2, "n": 2.0}, (0.0, 0.2)),
    "warming_friction": ("friction", "approach", {"height": -200.0, "scale": 60.0}, (0.0, 300.0)),
    "hardening_spring": ("force", "power", {"height": 1e3, "reach": 1e-5, "n": 3.0}, (-1e-5, 1e-5)),
    "two_stage_lost_motion": ("force", "stage", {"height": -1e3, "width": 10e-6}, (-2e-5, 2e-5)),
    "scale_coupling_play": ("displacement", "line", {"height": -5e-6, "reach": 1.0, "length": 5e-6}, (-1.0, 1.0)),
    "scale_interpolation_error": ("displacement", "sine", {"amplitude": 1e-6, "period": 20e-6, "phase_rad": 0.0}, (0.0, 20e-6)),
    "tilt_crosstalk": ("displacement", "line", {"height": -1e-5, "reach": 0.1}, (-0.1, 0.1)),
    "current_recorded_late": ("current", "dead time", {"time_s": 4e-3}, (0.0, 1.0)),
    "scale_sampling_jitter": ("displacement", "jitter", {"deviation_s": 40e-6}, (0.0, 0.2)),
}
"""Output, formula, parameters and measured range of the law that a perfect diagnosis finds."""


def fault(name: str) -> dict[str, Any]:
    return {"name": name, "axis": "X", "block": OUTSIDE[name].block, **FAULTS[name]}


def entry(name: str, **numbers: float) -> dict[str, Any]:
    """The law found, with some parameters changed, as `diagnosis.json` has it."""
    output, formula, parameters, (low, high) = FOUND[name]
    return {
        "axis": "X",
        "block": OUTSIDE[name].block,
        "output": output,
        "variables": [LAWS[name].variable],
        "formula": formula,
        **({"from_axis": FAULTS[name]["from_axis"]} if "from_axis" in FAULTS[name] else {}),
        "parameters": {n: {"value": v} for n, v in {**parameters, **numbers}.items()},
        "measured": {"x": np.linspace(low, high, 40).tolist()},
    }


@pytest.mark.parametrize("name", OUTSIDE)
def test_the_true_law_has_the_right_shape(name: str) -> None:
    filtered_at_a_cycle = name == "speed_set_point_smoothing"  # every 2 ms; the true lag of 4 ms is continuous
    assert shape_agreement(fault(name), {"laws": [entry(name)]}, MACHINE) > (0.995 if filtered_at_a_cycle else 0.999)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("notch_filter", {"frequency_hz": 152.0}),
        ("position_dead_band", {"band": 4e-5}),
        ("one_sided_speed_clip", {"limit": 0.1}),
        ("windage", {"height": -36.0}),
        ("warming_friction", {"scale": 5.0}),
        ("two_stage_lost_motion", {"width": 2e-6}),
        ("scale_coupling_play", {"length": 4e-5}),
        ("scale_interpolation_error", {"phase_rad": 0.5}),
        ("tilt_crosstalk", {"height": 1e-5}),
        ("current_recorded_late", {"time_s": 2e-3}),
    ],
)
def test_a_law_with_wrong_numbers_has_another_shape(name: str, numbers: dict[str, float]) -> None:
    assert shape_agreement(fault(name), {"laws": [entry(name, **numbers)]}, MACHINE) < SIMILAR


def test_a_table_is_compared_by_its_points() -> None:
    v = np.linspace(0.0, 0.2, 12)
    law = {k: x for k, x in entry("windage").items() if k != "formula"} | {"formula": "table", "parameters": {"scale": {"value": 1.0}}}
    assert shape_agreement(fault("windage"), {"laws": [{**law, "points": [[x, 900.0 * x**2 + 3.0 * x] for x in v]}]}, MACHINE) > 0.99
    assert shape_agreement(fault("windage"), {"laws": [{**law, "points": [[x, np.sqrt(x)] for x in v]}]}, MACHINE) < SIMILAR


def test_a_law_elsewhere_or_none_has_no_shape() -> None:
    elsewhere = {**entry("windage"), "axis": "Y"}
    assert laws_of_fault(fault("windage"), {"laws": [elsewhere]}) == []
    assert shape_agreement(fault("windage"), {"laws": [elsewhere]}, MACHINE) == 0.0
    assert shape_agreement(fault("windage"), {}, MACHINE) == 0.0
    curve = {**entry("notch_filter"), "formula": "table", "points": [[0.0, 0.0], [1.0, 1.0]], "parameters": {"scale": {"value": 1.0}}}
    assert shape_agreement(fault("notch_filter"), {"laws": [curve]}, MACHINE) == 0.0


def test_a_dead_time_that_is_longer_than_the_memory_of_the_tick_is_compared_at_the_cycle_of_its_controller() -> None:
    late = {**entry("speed_set_point_smoothing"), "formula": "dead time", "parameters": {"time_s": {"value": 9e-3}}}
    assert shape_agreement(fault("speed_set_point_smoothing"), {"laws": [late]}, MACHINE) < SIMILAR


@pytest.mark.parametrize("verdict", ["unknown", "law"])
def test_a_fault_outside_the_library_is_told_by_both_verdicts(verdict: str) -> None:
    """Confusion and F1 count 'law' on such a fault as the mark does: right. On another machine it is the wrong label."""
    outside, healthy, backlash = (
        {"outside": o, "true": t, "verdict": verdict, "named": []}
        for o, t in (([["creep", "X", "mechanics"]], []), ([], []), ([], [["backlash", "X"]]))
    )
    assert confusion([outside, healthy, backlash]) == {
        true: {"outside the library": 1} for true in ("backlash", "none", "outside the library")
    }
    assert macro_f1(confusion([outside])) == 1.0
    assert macro_f1(confusion([healthy])) == 0.0
