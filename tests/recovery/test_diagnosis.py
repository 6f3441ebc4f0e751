"""Hidden effects on machines of the second plant are found by the search.

Each effect is listed beside one that is easily confused with it. One axis, three short runs, the whole library as candidates. The
long examination is a command.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import math
import tomllib

import numpy as np
import pyarrow.parquet as pq
import pytest

from examples.diagnose import record, short_runs
from twin.diagnose import diagnose
from twin.diagnose.law.laws import stand_ins
from twin.diagnose.observe import observe
from twin.diagnose.search import search
from twin.diagnose.settings import T
from twin.diagnose.setup import Setup
from twin.diagnose.sizes import with_final_sizes
from twin.diagnose.verdict import is_unknown
from twin.diagnose.view import view_of
from twin.exam.draw import draw_case
from twin.exam.plant.parameters import AXES, Richness
from twin.exam.programme import TestRun
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign

SEED = 5
RIGID = Richness.off()


def run_of(name, turns):
    """One run of rest-to-rest moves at a steady speed: {axis: (distances, speed)} [m, rad]."""
    set_points = {}
    for axis, (distances, speed) in turns.items():
        one = 1.0 if axis in "XYZ" else 16.0
        set_points[axis] = moves_in_turn(0.0, distances, speed, 1.5 * one, 30.0 * one, 0.15, 1e-3)[1]
    length = max(len(p) for p in set_points.values())
    columns = np.zeros((length, len(AXES)))
    for axis, p in set_points.items():
        columns[:, AXES.index(axis)] = np.concatenate([p, np.full(length - len(p), p[-1])])
    return TestRun(name, "test", "velocity+torque", columns)


def travel(axis):
    """A long run over the travel; the table rotates while tilted."""
    if axis == "A":
        return run_of("travel", {"A": ([0.5, -1.2, 0.7], 0.5), "C": ([3.0, 3.0, -6.0], 1.5)})
    one = 1.0 if axis in "XYZ" else 16.0
    return run_of("travel", {axis: ([0.2 * one, -0.2 * one], 0.08 * one)})


def campaign_of(folder, kind, effect, axis, runs, richness=RIGID):
    """Draw a machine and record it: (campaign, hidden effect)."""
    table = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    case = draw_case(SEED, kind, table, effect=effect, axis=axis if effect else None, richness=richness)
    record(case, runs, axis if axis in "XYZ" else "AC", folder, table)
    return read_campaign(folder, load_machine()), case.effects[0] if case.effects else None


def observed(folder, kind, effect, axis, richness=RIGID):
    """Draw a machine and record it: (its residuals against the twin, truth)."""
    campaign, hidden = campaign_of(folder, kind, effect, axis, [*short_runs(axis), travel(axis)], richness)
    return group_of(campaign, axis), hidden


def group_of(campaign, axis):
    machine = load_machine()
    return observe([view_of(machine, run) for run in campaign.runs], (axis,) if axis in "XYZ" else ("A", "C"))


def searched(group):
    with ThreadPoolExecutor(2) as pool:
        machine = load_machine()
        return search(group, Setup(machine, [[0], [1], [2]], pool.map, lambda _: None))


def found_on(folder, kind, effect, axis, richness=RIGID):
    """Draw a machine, record it, search the axis: (found, truth)."""
    group, hidden = observed(folder, kind, effect, axis, richness)
    return searched(group), hidden


@pytest.mark.parametrize(
    ("effect", "axis", "parameter", "accuracy"),
    [
        ("loop_delay", "Y", "delay_s", 0.02),
        ("set_point_filter", "Y", "time_constant_s", 0.02),
        ("velocity_feedforward", "Z", "factor", 0.02),
        ("coulomb_friction", "X", "factor", 0.1),
        ("stribeck", "X", "velocity", 0.1),
        ("presliding", "Y", "stiffness", 0.2),
        ("backlash", "X", "clearance", 0.02),
        ("transmission_compliance", "X", "stiffness", 0.03),
        ("inertia", "Y", "added", 0.1),
        ("torque_constant", "X", "factor", 0.25),
        ("lead_error", "Z", "fraction", 0.02),
        ("thermal_drift", "Z", "rate", 0.02),
        ("cyclic_error", "C", "amplitude", 0.02),
        ("encoder_eccentricity", "C", "amplitude", 0.02),
        ("speed_gain", "Y", "factor", 0.05),
        ("speed_integral_time", "Y", "factor", 0.05),
        ("viscous_friction", "X", "factor", 0.1),
        ("viscous_asymmetry", "X", "fraction", 0.1),
        ("torque_ripple", "Y", "amplitude_nm", 0.1),
        ("position_dependent_friction", "Y", "wavelength", 0.02),
        ("table_unbalance", "A", "mass_kg", 0.25),
        ("torque_feedforward", "Z", "factor", 0.1),
        ("current_limit", "Y", "limit_a", 0.03),
        ("frame_vibration", "X", "frequency_hz", 0.02),
        ("periodic_disturbance", "X", "frequency_hz", 0.02),
        ("constant_force", "Y", "force", 0.1),
        ("position_gain", "Z", "factor", 0.02),
    ],
)
def test_hidden_effect_is_named_with_its_size(tmp_path, effect, axis, parameter, accuracy):
    found, hidden = found_on(tmp_path, "single", effect, axis)
    assert [s.effect.name for s in found.fit.settings] == [effect]
    value = found.fit.settings[0].parameters[parameter]
    neutral = 1.0 if parameter == "factor" else 0.0
    assert abs(value - hidden[parameter]) < accuracy * abs(hidden[parameter] - neutral)


def with_late_break_away(group, samples):
    """The group with the first start of each run delayed by `samples` in the recorded speed."""
    channels = []
    for channel in group.channels:
        residual = channel.residual.copy()
        if channel.name == "velocity":
            speed = group.nominal[channel.run][channel.axis, "velocity"]
            moving = np.abs(speed) > 0.02 * np.abs(speed).max()
            start = np.flatnonzero(moving[1:] & ~moving[:-1])[0]
            stretch = np.arange(start - 10, start + 60)
            residual[stretch] += speed[stretch - samples] - speed[stretch]
        channels.append(replace(channel, residual=residual))
    return replace(group, channels=channels)


def test_a_current_filter_is_named_unless_its_block_shows_another_filter(tmp_path):
    """In closed loop it may stand in for a current that is recorded late. The speed controller, evaluated on what was recorded, tells them apart."""
    found, hidden = found_on(tmp_path, "single", "current_filter", "Y")
    (setting,) = found.fit.settings
    assert setting.key == ("current_filter", "Y", None)
    assert setting.parameters["time_constant_s"] == pytest.approx(hidden["time_constant_s"], rel=0.1)
    assert stand_ins(found) == {}

    def late(view):
        """The run with its current recorded 5 ms late."""
        current = np.interp(view.trace.time - 5e-3, view.trace.time, view.trace.get("Y", "current"))
        return replace(view, trace=replace(view.trace, signals={**view.trace.signals, ("Y", "current"): current}), references={})

    shown = stand_ins(replace(found, group=replace(found.group, views=[late(view) for view in found.group.views])))
    assert 0.5 < shown[setting.key] <= 1.0


@pytest.mark.parametrize(("effect", "parameter"), [("coulomb_friction", "factor"), ("stribeck", "velocity")])
def test_a_late_break_away_bends_no_size(tmp_path, effect, parameter):
    """A break-away 6 ms late affects a few samples that depend steeply on friction; fitting them would change the size by 6 %."""
    group, hidden = observed(tmp_path, "single", effect, "X")
    found = with_final_sizes(searched(with_late_break_away(group, 3)))
    assert [s.effect.name for s in found.fit.settings] == [effect]
    size = abs(hidden[parameter] - (1.0 if parameter == "factor" else 0.0))
    assert abs(found.fit.settings[0].parameters[parameter] - hidden[parameter]) < 0.025 * size


@pytest.mark.parametrize(
    ("effect", "axis"),
    [pytest.param("hardening_spring", "X", marks=pytest.mark.slow), ("windage", "Y"), ("notch_filter", "Z"), ("scale_coupling_play", "Z")],
)
def test_effect_outside_the_library_is_unknown(tmp_path, effect, axis):
    """A related effect may be named but does not explain it: its size differs between runs, or much remains."""
    found, _ = found_on(tmp_path, "outside", effect, axis)
    assert is_unknown(found)


@pytest.mark.parametrize(("effect", "axis"), [("current_limit", "C"), ("backlash", "A"), ("speed_gain", "Y")])
def test_large_effect_casts_no_shadow(tmp_path, effect, axis):
    """On a machine with small imperfections the remainder of a large effect is not named as a second effect."""
    found, _ = found_on(tmp_path, "single", effect, axis, Richness.small())
    assert [(s.effect.name, s.axis) for s in found.fit.settings] == [(effect, axis)]
    assert not is_unknown(found)


def test_a_fitted_position_gain_leaves_no_residual_of_the_control_law(tmp_path):
    """The controller law uses the measured position, so the random rest position of an axis leaves no residual."""
    found, hidden = found_on(tmp_path, "single", "position_gain", "Z", Richness.small())
    left = found.fit.residual(found.group) / found.group.weights
    levels = [float(np.mean((left[c.rows] / c.spread) ** 2)) for c in found.group.channels if c.name == "controller"]
    assert max(levels) < 1.6  # 1.4; fed with the simulated position 2.0
    assert abs(found.fit.settings[0].parameters["factor"] - hidden["factor"]) < 0.02 * abs(hidden["factor"] - 1.0)


def test_drive_train_that_meets_the_cycle_of_the_control_is_healthy(tmp_path):
    """With its first mode at 1 / position cycle, a slightly different damping resembles a wrong filter."""
    found, _ = found_on(tmp_path, "healthy", None, "C", replace(Richness.small(), compliance_hz=(402.0, 403.0)))
    assert found.fit.settings == ()
    assert not is_unknown(found)
    assert found.fit.loss < 1.02 * found.group.expected_loss


def of_scale_and_current(folder, kind, effect, axis, richness=RIGID):
    """Draw a machine and record set point, scale and current only: (its residuals against the twin, truth)."""
    hidden = campaign_of(folder, kind, effect, axis, [*short_runs(axis), travel(axis)], richness)[1]
    for file in folder.glob("*.parquet"):
        table = pq.read_table(file)
        kept = [c for c in table.column_names if "." not in c or c.split()[0].split(".")[1] in ("setpoint", "position", "current")]
        pq.write_table(table.select(kept), file)
    return group_of(read_campaign(folder, load_machine()), axis), hidden


@pytest.mark.parametrize("mode_hz", [430.0, 452.0, 476.0, 520.0])
def test_drive_train_that_meets_the_cycle_is_found_without_motor_encoder(tmp_path, mode_hz):
    """With scale and current only, a mode 5 % off would leave half the noise in addition."""
    richness = replace(Richness.small(), compliance_hz=(mode_hz, mode_hz + 0.5))
    found = searched(of_scale_and_current(tmp_path, "healthy", None, "X", richness)[0])
    assert found.fit.settings == ()
    assert not is_unknown(found)
    assert found.fit.loss < 1.02 * found.group.expected_loss
    fraction = next(b for n, b in zip(found.tuning.nuisances, found.tuning.base) if n.quantity == "elasticity")
    share = fraction / load_machine().parameter_tolerance
    assert T.normal_mode_hz / math.sqrt(share) == pytest.approx(mode_hz, rel=0.06)


def test_a_lead_error_shows_without_motor_encoder(tmp_path):
    """With a known drive train the changed motor motion shows in the speed loop; a slightly late set point has the same effect."""
    group, hidden = of_scale_and_current(tmp_path, "single", "lead_error", "Z", replace(Richness.small(), compliance_hz=(460.0, 461.0)))
    first = searched(group).rounds[0]
    lead = next(c for c in first if c.setting.effect.name == "lead_error")
    assert lead.setting.parameters["fraction"] == pytest.approx(hidden["fraction"], rel=0.05)
    assert lead.evidence > 500.0
    assert first[0].evidence - lead.evidence < T.evidence


def test_a_healthy_machine_has_no_effects(tmp_path):
    found, _ = found_on(tmp_path, "healthy", None, "Y")
    assert found.fit.settings == ()
    assert not is_unknown(found)


def test_effects_that_a_run_cannot_separate_are_reported_as_ambiguous(tmp_path):
    """In a run at constant speed a drifting scale and a lead error have the same effect."""
    campaign_of(tmp_path, "single", "thermal_drift", "Z", [run_of("cruise", {"Z": ([0.2], 0.03)})])
    whole = pq.read_table(tmp_path / "cruise.parquet")
    pq.write_table(whole.slice(400, 5600), tmp_path / "cruise.parquet")
    document = diagnose(read_campaign(tmp_path, load_machine()), load_machine(), quick=True).document()
    named = {(e["effect"], e["axis"]) for e in [*document["effects"], *document["ambiguous_with"]]}
    assert named >= {("thermal_drift", "Z"), ("lead_error", "Z")}
    assert "Z" in document["next_measurement"]
