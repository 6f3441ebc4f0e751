"""The gap budget: contributions at the tool point compared with closed forms; noise as in the gaps."""

from dataclasses import replace
import math

import mujoco
import numpy as np
import pytest

from tests.builders.diagnosis_state import PERIOD_S, columns_of, found_of, group_of, no_tuning
from tests.builders.script import script
from twin.diagnose import report
from twin.diagnose.budget import Budget, budget_over, document_of, noise_of, overlap_text, parts_of
from twin.diagnose.corrected import corrected_machine
from twin.diagnose.fit import Fit
from twin.diagnose.tolerance import nuisances_of
from twin.diagnose.tool_point import LOAD, ToolPoint
from twin.diagnose.tuning import tuning_from
from twin.diagnose.view import view_of
from twin.effects import EFFECTS, Setting
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import SignalGap
from twin.simulation.plant_spec import frames_of_model

SAMPLES, RATE = 1500, 1e-5
RUNS = {"a": 3.0, "b": 41.0**0.5}
"""Noise [um] of two runs, 5 um RMS in total."""
KINDS = {"X": "linear", "Y": "linear", "Z": "linear", "A": "rotary", "C": "rotary"}


def standing(samples, **at):
    """A motion in which every axis is at rest at `at` [m, rad], default 0."""
    time = PERIOD_S * np.arange(samples)
    return Trace(time, {(axis, "load_position"): np.full(samples, at.get(axis, 0.0)) for axis in KINDS}, KINDS)


def budget_of(machine, corrected, found, views, residual, noise):
    return budget_over([*parts_of(machine, corrected, found)], machine, corrected, views, residual, noise)


@pytest.fixture(scope="module")
def of_drift():
    """The budget of a machine with thermal drift of a screw, and the machine."""
    group = group_of([np.zeros(SAMPLES)])
    setting = Setting(EFFECTS["thermal_drift"], "X", {"rate": RATE})
    fit = Fit((setting,), [], 0.0, np.zeros(0), np.zeros(SAMPLES), columns_of(np.zeros((SAMPLES, 0))), no_tuning(SAMPLES))
    machine, found = group.views[0].machine, [found_of(group, fit=fit)]
    return budget_of(machine, corrected_machine(machine, found), found, group.views, [None], {}), machine, setting


def test_thermal_drift_moves_the_tool_but_not_the_scale(of_drift):
    budget, machine, _ = of_drift
    (row,) = [r for r in budget.rows if r.kind == "effect"]
    lag = 1.0 / machine.axis("X").loops.position_gain_per_s
    grown = RATE * np.maximum(PERIOD_S * np.arange(SAMPLES) - lag, 0.0)
    assert row.tool_point == pytest.approx(np.sqrt(np.mean(grown**2)), rel=0.02)
    assert row.position == pytest.approx(row.tool_point, rel=1e-9)
    assert row.signals["position"] < 0.05 * row.position  # the loop keeps the scale on its set point
    assert row.alone == pytest.approx(row.tool_point, rel=0.02)  # no other contribution overlaps
    assert row.at_s == pytest.approx(PERIOD_S * (SAMPLES - 1))


def test_a_run_without_the_axis_has_its_drift_but_no_current_in_motion(of_drift):
    budget, machine, setting = of_drift
    group = group_of([np.zeros(SAMPLES)])
    view = group.views[0]
    alone = replace(view, trace=Trace(view.trace.time, {("Y", "setpoint"): np.zeros(SAMPLES)}, {"Y": "linear"}), references={})
    fit = Fit((setting,), [], 0.0, np.zeros(0), np.zeros(SAMPLES), columns_of(np.zeros((SAMPLES, 0))), no_tuning(SAMPLES))
    found = [found_of(group, fit=fit)]
    (row,) = [r for r in budget_of(machine, corrected_machine(machine, found), found, [alone], [None], {}).rows if r.kind == "effect"]
    assert row.tool_point == pytest.approx(next(r for r in budget.rows if r.kind == "effect").tool_point)
    assert row.signals["current"] == 0.0


def test_independent_contributions_add_up_to_the_total(of_drift):
    budget = of_drift[0]
    assert budget.one_out == pytest.approx(budget.explained, rel=1e-6)
    assert budget.one_in == pytest.approx(budget.explained, rel=0.02)


def test_a_budget_without_re_tuning_has_the_other_rows():
    group = group_of([np.zeros(SAMPLES)])
    machine = group.views[0].machine
    nuisances = nuisances_of(machine, ("X",))
    tuning = tuning_from(nuisances, columns_of(np.eye(SAMPLES)[:, : len(nuisances)]), 0.01)
    setting = Setting(EFFECTS["thermal_drift"], "X", {"rate": RATE})
    fit = Fit((setting,), [], 0.0, np.ones(len(nuisances)), np.zeros(SAMPLES), columns_of(np.zeros((SAMPLES, 0))), tuning)
    found = [found_of(group, tuning, fit=fit)]
    rows = budget_of(machine, corrected_machine(machine, found), found, group.views, [None], {}).rows
    assert {row.kind for row in rows} == {"effect", "re-tuned"}


def test_overlap_is_computed_from_all_rows(of_drift):
    row = of_drift[0].rows[0]
    pair = Budget((replace(row, tool_point=3e-6, alone=6e-6), replace(row, tool_point=4e-6, alone=8e-6)), 7e-6, 0.0, 0.0, {})
    assert (pair.one_out, pair.one_in) == pytest.approx((5e-6, 10e-6))
    document = document_of(pair, of_drift[1], {}, {})
    assert all(f" {um} um" in overlap_text(document) for um in ("5.00", "7.00", "10.0"))


def test_the_document_uses_um_and_arcsec(of_drift):
    budget, machine, setting = of_drift
    document = document_of(budget, machine, {setting.key: 0.9}, {setting.key: 0.1})
    (row,) = [r for r in document["rows"] if r["kind"] == "effect"]
    assert row["tool_point"] == pytest.approx(1e6 * budget.rows[0].tool_point)
    assert (row["low"], row["high"]) == pytest.approx((0.9 * row["tool_point"], 1.1 * row["tool_point"]))
    assert (row["probability"], row["position_unit"]) == (0.9, "um")
    assert document["before"] == pytest.approx(1e6 * np.hypot(budget.explained, budget.left))


@pytest.mark.parametrize(("tilt", "turn"), [(0.0, 0.0), (-0.6, 1.1)])
def test_a_linear_axis_moves_the_tool_by_the_same_distance_at_any_table_angle(tilt, turn):
    tool = ToolPoint(load_machine())
    base, other = standing(3, A=tilt, C=turn), standing(3, A=tilt, C=turn, Y=2e-6)
    np.testing.assert_allclose(tool.distance(base, other, ("Y",)), 2e-6, rtol=1e-6)


def test_a_table_rotation_moves_the_tool_by_angle_times_distance():
    tool, angle = ToolPoint(load_machine()), 1e-6
    near, far = (tool.distance(standing(2, X=x), standing(2, X=x, C=angle), ("C",))[0] for x in (0.05, 0.15))
    reach = [np.hypot(x + near_x, y) for x in (0.05, 0.15) for near_x, y in [_from_turning_axis(tool)]]
    assert (near, far) == pytest.approx((angle * reach[0], angle * reach[1]), rel=1e-6)


@pytest.mark.parametrize("structure", ["table_table", "head_table", "head_head", "three_axis"])
def test_every_structure_moves_the_tool_as_the_engine_does(structure):
    """Whatever the axes are called, and whether they turn the part or the tool."""
    machine = script("examples/kinematics/run.py", "kinematics_example").machine_of(structure)
    model = frames_of_model(machine)
    data = mujoco.MjData(model)
    tool, motions, tips = ToolPoint(machine), [], []
    for angle, step in ((0.3, 0.0), (0.3, 2e-4)):
        at = {axis: np.full(2, angle + step * (i + 1)) for i, axis in enumerate(machine.axis_names)}
        for axis, value in at.items():
            data.joint(axis).qpos[0] = value[0]
        mujoco.mj_kinematics(model, data)
        part = data.site("workpiece")
        tips.append(part.xmat.reshape(3, 3).T @ (data.site("tool").xpos - part.xpos))
        motions.append(Trace(np.arange(2.0), {(axis, LOAD): value for axis, value in at.items()}, machine.kinds))
        assert tool.at(motions[-1], 1) == pytest.approx(tuple(tips[-1]), abs=1e-12)
    np.testing.assert_allclose(tool.distance(*motions, machine.axis_names), np.linalg.norm(tips[1] - tips[0]), rtol=1e-9)


def _from_turning_axis(tool):
    """Position of the tool relative to the C axis, in X and Y of the bed, with all axes at 0."""
    offset = tool.kinematics.tool_tip - tool.kinematics.turn.anchor
    return offset[0], offset[1]


def test_noise_of_the_budget_is_that_of_the_signals():
    machine = load_machine().with_axes(["X"])
    gaps = {
        run: {
            "X": {
                "position": SignalGap(1.0, 2.0, 1.2 * noise, noise, "um", 1.0 / noise),
                "current": SignalGap(1.0, 2.0, 0.04, 0.04, "A", 25.0),
            }
        }
        for run, noise in RUNS.items()
    }
    noise = noise_of(gaps, machine)
    assert noise == {("X", "position"): pytest.approx(5e-6), ("X", "current"): pytest.approx(0.04)}


def still_view(machine, name, samples, started_at):
    """A run in which nothing moves."""
    still = Trace(PERIOD_S * np.arange(samples), {(axis, "setpoint"): np.zeros(samples) for axis in machine.axis_names}, machine.kinds)
    return view_of(machine, MeasuredRun(name, still, None, started_at))


def test_drift_of_an_axis_at_rest_counts(of_drift):
    _, _, setting = of_drift
    machine = load_machine()
    late, early = (
        still_view(machine, f"{started_at}", samples, started_at) for samples, started_at in ((SAMPLES, 100.0), (3 * SAMPLES, 0.0))
    )
    group = group_of([np.zeros(SAMPLES)])
    fit = Fit((setting,), [], 0.0, np.zeros(0), np.zeros(SAMPLES), columns_of(np.zeros((SAMPLES, 0))), no_tuning(SAMPLES))
    found = [found_of(group, fit=fit)]
    for views, seen in (([late], 1.0), ([late, early], math.sqrt(0.5))):  # every run counts alike, however long it is
        budget = budget_of(machine, corrected_machine(machine, found), found, views, [None] * len(views), {})
        (row,) = [r for r in budget.rows if r.kind == "effect"]
        assert row.tool_point == pytest.approx(seen * 100.0 * RATE, rel=0.02)


def test_what_was_not_recorded_does_not_change_the_multiple_of_noise():
    """A spring moves the motor encoder most. Without that encoder in the record, the multiple is that of the other signals alone."""
    group = group_of([np.zeros(SAMPLES)])
    setting = Setting(EFFECTS["thermal_drift"], "X", {"rate": RATE})
    fit = Fit((setting,), [], 0.0, np.zeros(0), np.zeros(SAMPLES), columns_of(np.zeros((SAMPLES, 0))), no_tuning(SAMPLES))
    machine, found = group.views[0].machine, [found_of(group, fit=fit)]
    corrected = corrected_machine(machine, found)

    def multiple(**noise):
        by_signal = {("X", signal): level for signal, level in noise.items()}
        (row,) = [r for r in budget_of(machine, corrected, found, group.views, [None], by_signal).rows if r.kind == "effect"]
        return row.times_noise, row.signals

    both, signals = multiple(position=1e-7, motor_position=1e-9)
    alone, _ = multiple(position=1e-7)
    assert alone == pytest.approx(signals["position"] / 1e-7)
    expected = np.sqrt(((signals["position"] / 1e-7) ** 2 + (signals["motor_position"] / 1e-9) ** 2) / 2.0)
    assert both == pytest.approx(expected)
    assert both > 20.0 * alone


def test_a_budget_of_axes_that_do_not_move_the_tool_has_no_columns_for_it():
    row = {"kind": "effect", "effect": "torque_ripple", "axis": "A", "tool_point": 0.0, "alone": 0.0, "largest": 0.0, "run": "a", "at_s": 0.0, "at_mm": [],
           "position": 12.0, "position_unit": "arcsec", "current": 0.1, "times_noise": 3.0, "probability": 0.9, "low": 0.0, "high": 0.0}  # fmt: skip
    budget = {"rows": [row], "before": 0.0, "after": 0.0, "floor": 0.0, "change": 0.0, "apart": 0.0, "in_turn": 0.0}
    still = report._budget("Gap budget at the tool point", budget, at_tool=False)
    assert (still.title, len(still.figures)) == ("Gap budget", 0)
    assert not any("tool" in heading or "part" in heading for heading in still.tables[0].heading)
    assert "12.0 arcsec" in still.tables[0].rows[0]
    moves = report._budget("Gap budget at the tool point", {**budget, "rows": [{**row, "tool_point": 2.0}]}, at_tool=False, picture=False)
    assert "tool point [um]" in moves.tables[0].heading
    assert len(moves.tables[0].rows[0]) == len(moves.tables[0].heading) == len(still.tables[0].heading) + 4


def test_a_calibration_is_not_called_a_re_tuning():
    found = {
        "gap": {"before": 305.0, "after": 21.4, "held_out_runs": []},
        "effects": [],
        "calibrated": [{"effect": "loop_delay", "axis": "X"}],
    }
    assert report.gap_sentence(found).startswith("The calibration reduces the gap from 305 to 21.4 times the noise")
    assert "re-tuning" in report.gap_sentence({**found, "calibrated": []})
    assert report.gap_sentence({**found, "effects": [{}]}).startswith("The correction")
