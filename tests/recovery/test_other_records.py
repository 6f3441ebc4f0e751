"""Diagnosis of unusual recordings and machines: a clock that fits no cycle, a single signal, no tolerance."""

from dataclasses import replace
import math

import numpy as np
import pyarrow.parquet as pq
import pytest

from examples.diagnose import short_runs
from tests.recovery.test_diagnosis import campaign_of, group_of, observed, run_of, searched, travel
from twin.cli import main
from twin.diagnose import diagnose
from twin.diagnose.observe import observe
from twin.diagnose.output import summary_text
from twin.diagnose.search import search
from twin.diagnose.setup import Setup
from twin.diagnose.sizes import without_implausible
from twin.diagnose.verdict import named_effects
from twin.diagnose.view import view_of
from twin.diagnose.where import _assign_effect, _merge_echoes
from twin.effects import EFFECTS, Setting
from twin.exam.questions import RICHNESS
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.run import simulate
from twin.simulation.setpoints import recorded_setpoints

FOLDS = [[0], [1], [2]]


@pytest.mark.parametrize(("period", "begin"), [(1e-3, 86400.123), (0.9e-3, 0.0), (1.0 / 1024.0, 17.0)])
def test_a_clock_that_fits_no_cycle_is_not_a_fault(tmp_path, period, begin):
    """The twin is compared at the times of the recording; controller samples are used only if they are recorded."""
    campaign, _ = campaign_of(tmp_path, "healthy", None, "X", [*short_runs("X"), travel("X")])
    machine, runs = load_machine(), []
    for run in campaign.runs:
        setpoints = recorded_setpoints(run.trace, machine)
        fine = simulate(machine.with_feedforward(run.feedforward), setpoints, sample_period=machine.base_tick, noise_seed=99).trace
        times = np.arange(0.0, fine.time[-1], period)
        signals = {key: np.interp(times, fine.time, values) for key, values in fine.signals.items() if key[0] == "X"}
        signals["X", "setpoint"] = setpoints.at(times)[:, 0]
        runs.append(replace(run, trace=replace(run.trace, time=begin + times, signals=signals)))
    group = group_of(replace(campaign, runs=runs), "X")
    levels = {c.name: float(np.mean((c.residual / c.sigma) ** 2)) for c in group.channels}
    assert ("controller" in levels) == (period == 1e-3)
    assert max(levels.values()) < 1.5
    assert searched(group).fit.settings == ()


def test_a_speed_alone_is_diagnosed_and_drawn(tmp_path):
    campaign_of(tmp_path, "single", "backlash", "X", short_runs("X"))
    for file in tmp_path.glob("*.parquet"):
        table = pq.read_table(file)
        pq.write_table(table.select([c for c in table.column_names if c.split()[0] in ("time", "X.setpoint", "X.velocity")]), file)
    assert main(["diagnose", str(tmp_path), "--out", str(tmp_path / "out"), "--quick"]) == 0
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


def test_a_machine_without_tolerance_is_searched(tmp_path):
    campaign, _ = campaign_of(tmp_path, "single", "backlash", "X", [*short_runs("X"), travel("X")])
    machine = load_machine().with_values({"parameter_tolerance": 0.0})
    group = observe([view_of(machine, run) for run in campaign.runs], ("X",))
    found = search(group, Setup(machine, FOLDS, map, lambda _: None))
    assert found.fit.settings[0].effect.name == "backlash"


def test_an_effect_that_shrinks_below_belief_is_taken_out_of_the_machine_too(tmp_path):
    """An effect that is not named is not in the corrected machine."""
    group, _ = observed(tmp_path, "single", "coulomb_friction", "X")
    found = searched(group)
    assert len(named_effects([found])) == 1
    small = replace(found.fit.settings[0], parameters={"factor": 1.001})
    found = without_implausible(replace(found, fit=replace(found.fit, settings=(small,))))
    assert found.fit.settings == () == tuple(named_effects([found]))


def test_each_of_two_effects_keeps_its_own_place():
    """Both effects keep their own blocks; the share of a block without an effect goes to the larger one, except a twentieth."""
    listed = [{"axis": "X", "block": b, "share": e} for b, e in (("transmission", 100.0), ("mechanics", 20.0), ("speed controller", 10.0))]
    for name, parameters in (("backlash", {"clearance": 1e-5}), ("coulomb_friction", {"factor": 1.3})):
        _assign_effect(listed, Setting(EFFECTS[name], "X", parameters), load_machine(), {})
    _merge_echoes(listed)
    assert {p["block"]: p["share"] for p in listed} == pytest.approx({"transmission": 109.5, "mechanics": 20.0, "speed controller": 0.5})
    by_block = {p["block"]: p for p in listed}
    assert by_block["transmission"]["effect"] == "backlash"
    assert by_block["mechanics"]["effect"] == "coulomb_friction"


def test_a_speed_gain_of_two_p_controllers_is_assigned_to_the_speed_controller():
    machine = load_machine()
    p_only = machine.with_axis("X", speed_integral_time_s=math.inf)
    listed = [{"axis": "X", "block": "position controller", "_excess": 100.0}]
    _assign_effect(listed, Setting(EFFECTS["speed_gain"], "X", {"factor": 1.3}), p_only, {})
    assert [p["block"] for p in listed] == ["speed controller"]


def test_noise_between_motor_and_scale_is_that_of_a_drive_train_that_gives(tmp_path):
    """Noise in the loop deflects the drive train; the deflection by the control cycle does not count as sensor noise."""
    found = searched(observed(tmp_path, "healthy", None, "C", RICHNESS["small"])[0])
    assert any(n.quantity == "elasticity" and n.owner == "C" for n in found.tuning.nuisances)
    levels = [float(np.mean((left / c.spread) ** 2)) for c, left in transmission_residuals(found)]
    assert min(levels) > 0.9
    assert max(levels) < 1.15


def transmission_residuals(found):
    left = found.fit.residual(found.group) / found.group.weights
    return [(c, left[c.rows]) for c in found.group.channels if (c.axis, c.name) == ("C", "motor_minus_scale")]


def test_noise_is_that_of_a_machine_that_rings(tmp_path):
    """Set point steps excite a drive train near 450 Hz: against a rigid twin the scale noise would seem twice as large."""
    group = observed(tmp_path, "healthy", None, "Y", replace(RICHNESS["small"], compliance_hz=(450.0, 450.5)))[0]
    about = searched(group).group
    ratios = [np.median(a.sigma / b.sigma) for a, b in zip(group.channels, about.channels) if a.name == "position" and a.run == 1]
    assert ratios == [pytest.approx(2.0, rel=0.2)]


def test_effects_that_a_campaign_cannot_show_are_listed(tmp_path):
    """Y moves alone in one direction: coupling, direction-dependent friction and drive limits cannot be determined."""
    campaign_of(tmp_path, "healthy", None, "Y", [run_of("one way", {"Y": ([0.05, 0.05], 0.03)})])
    campaign = read_campaign(tmp_path, load_machine())
    document = diagnose(campaign, load_machine()).document()
    told = {(e["effect"], e.get("from_axis")): e["usual_sizes"] for e in document["not_visible"]}
    never = {("cross_axis_coupling", "X"), ("cross_axis_coupling", "Z"), ("current_limit", None)}
    assert {key for key, sizes in told.items() if sizes is None} >= never
    assert set(told) - never == {("viscous_asymmetry", None), ("viscous_friction", None)}
    assert "cross axis coupling on Y from X, Y from Z; current limit on Y; viscous asymmetry on Y" in summary_text(document)


def test_the_level_of_an_effect_without_a_place_is_the_measured_one() -> None:
    """The residual of a block whose law holds is what was measured there; a block that was not measured has no level."""
    for levels, expected in (({("X", "transmission"): 1.17}, 1.17), ({("X", "mechanics"): 3.0}, None)):
        listed = []
        _assign_effect(listed, Setting(EFFECTS["backlash"], "X", {"clearance": 1e-5}), load_machine(), levels)
        assert listed[0].get("level") == expected
