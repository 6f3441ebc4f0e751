"""The effects library: one row per effect, each parameter acts, neutral values do nothing, bad input gives one line.

A new effect needs nothing here: its row is made from its usual sizes. The laws themselves are tested in tests/reference/test_effects_*.py.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
import functools
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.builders.one_axis import MACHINE, NO_COULOMB, follow, there_and_back
from tests.conftest import ROOT
from twin.cli import main
from twin.effects import BLOCKS, Effect, apply_effects, check_setting, parse_setting, settings_of, with_effects
from twin.effects import EFFECTS as ALL_EFFECTS
from twin.effects.change import add_effects, load_inertia
from twin.effects.effect import Parameter
from twin.effects.user_files import effects_of
from twin.errors import InputError, SimulationError, TwinError
from twin.machine.machine import Machine, load_machine
from twin.simulation.plant_spec import build_plant
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

EFFECTS = {name: effect for name, effect in ALL_EFFECTS.items() if not effect.block_of_control}
"""Those of the blocks of a control are tested in test_control_blocks."""

X = MACHINE.axis("X")


@dataclass(frozen=True)
class Row:
    """An effect with parameters, and another value of each parameter that must change an output."""

    parameters: dict[str, float]
    other: dict[str, float]
    axis: str = "X"
    also: dict[str, str] = field(default_factory=dict)  # from_axis
    with_axes: str = ""


ROWS = {
    "position_gain": Row({"factor": 0.9}, {"factor": 1.1}),
    "velocity_feedforward": Row({"factor": 0.97}, {"factor": 1.03}),
    "torque_feedforward": Row({"factor": 0.7}, {"factor": 1.3}),
    "loop_delay": Row({"delay_s": 0.5e-3}, {"delay_s": -0.25e-3}),
    "speed_gain": Row({"factor": 0.7}, {"factor": 1.3}),
    "speed_integral_time": Row({"factor": 0.6}, {"factor": 2.0}),
    "set_point_filter": Row({"time_constant_s": 2e-3}, {"time_constant_s": 4e-3}),
    "current_filter": Row({"time_constant_s": 0.5e-3}, {"time_constant_s": 1.5e-3}),
    "torque_constant": Row({"factor": 0.93}, {"factor": 1.05}),
    "current_limit": Row({"limit_a": 8.0}, {"limit_a": 6.0}),
    "inertia": Row({"added": 500.0}, {"added": -200.0}),
    "coulomb_friction": Row({"factor": 1.3}, {"factor": 0.7}),
    "viscous_friction": Row({"factor": 1.5}, {"factor": 0.5}),
    "stribeck": Row({"excess": 500.0, "velocity": 0.004}, {"excess": 300.0, "velocity": 0.002}),
    "presliding": Row({"stiffness": 1e8, "damping": 3e5}, {"stiffness": 2e8, "damping": 1e5}),
    "viscous_asymmetry": Row({"fraction": 0.3}, {"fraction": -0.2}),
    "position_dependent_friction": Row({"fraction": 0.4, "wavelength": 0.02}, {"fraction": 0.3, "wavelength": 0.03}),
    "constant_force": Row({"force": 400.0}, {"force": -200.0}),
    "table_unbalance": Row(
        {"mass_kg": 40.0, "radius_m": 0.15, "angle_rad": 0.8, "height_m": 0.1},
        {"mass_kg": 30.0, "radius_m": 0.1, "angle_rad": 2.0, "height_m": 0.2},
        axis="A", with_axes="C",
    ),
    "backlash": Row(
        {"clearance": 15e-6, "contact_stiffness": 4e9, "contact_damping": 1e6},
        {"clearance": 10e-6, "contact_stiffness": 2e9, "contact_damping": 2e6},
    ),
    "transmission_compliance": Row({"stiffness": 8e7, "damping": 4e4}, {"stiffness": 6e7, "damping": 6e4}),
    "frame_vibration": Row(
        {"frequency_hz": 30.0, "mass_ratio": 0.06, "damping_ratio": 0.05}, {"frequency_hz": 25.0, "mass_ratio": 0.04, "damping_ratio": 0.1}
    ),
    "torque_ripple": Row(
        {"amplitude_nm": 0.2, "periods_per_rev": 6.0, "phase_rad": 0.3}, {"amplitude_nm": 0.1, "periods_per_rev": 4.0, "phase_rad": 1.0}
    ),
    "lead_error": Row({"fraction": 60e-6}, {"fraction": -30e-6}),
    "cyclic_error": Row({"amplitude": 5e-6, "phase_rad": 0.3}, {"amplitude": 3e-6, "phase_rad": 1.0}),
    "encoder_eccentricity": Row({"amplitude": 5e-5, "phase_rad": 0.3}, {"amplitude": 3e-5, "phase_rad": 1.0}, axis="C"),
    "thermal_drift": Row({"rate": 0.3e-6}, {"rate": -0.2e-6}),
    "cross_axis_coupling": Row({"mass": 120.0}, {"mass": 60.0}, also={"from_axis": "Y"}, with_axes="Y"),
    "periodic_disturbance": Row({"frequency_hz": 20.0, "force": 300.0}, {"frequency_hz": 12.0, "force": 200.0}),
}  # fmt: skip


def short_move(axis: str) -> np.ndarray:
    """Set points (sample,) at 1 ms: forward and back in about 0.3 s, with acceleration, constant speed and reversal."""
    if MACHINE.axis(axis).kind == "linear":
        return there_and_back(0.006, 0.08)
    return there_and_back(0.06, 0.8, 20.0, 2000.0)


@functools.cache
def moved(name: str, **values: float):
    """The trace of a row's axis (all driven axes move equally) with the row's parameters, some replaced."""
    row = ROWS[name]
    machine = MACHINE.with_axes([row.axis, *row.with_axes])
    machine = with_effects(machine, [{"name": name, "axis": row.axis, **row.also, **row.parameters, **values}])
    position = np.column_stack([short_move(row.axis)] * len(machine.axes))
    return simulate(machine, Setpoints(position, 1e-3)).trace


def bare(name: str):
    return on_axes(ROWS[name].axis, ROWS[name].with_axes)


@functools.cache
def on_axes(axis: str, with_axes: str):
    """The trace of a row's axis without an effect."""
    machine = MACHINE.with_axes([axis, *with_axes])
    return simulate(machine, Setpoints(np.column_stack([short_move(axis)] * len(machine.axes)), 1e-3)).trace


def equal(one, two) -> bool:
    return all(np.array_equal(one.signals[key], two.signals[key]) for key in one.signals)


def row_of(effect: Effect) -> Row:
    """A row from the usual sizes of an effect: each parameter a quarter and three quarters of the way through its range."""
    axis = effect.axes(MACHINE)[0]
    other = next((a.name for a in effect.axes(MACHINE) if a is not axis), "") if effect.from_axis else ""
    ranges = {p.name: p.usual_range(MACHINE, axis) for p in effect.parameters}
    quarter, three = ({name: low + share * (high - low) for name, (low, high) in ranges.items()} for share in (0.25, 0.75))
    return Row(three, quarter, axis.name, {"from_axis": other} if other else {}, other)


ROWS |= {name: row_of(effect) for name, effect in EFFECTS.items() if name not in ROWS}


def test_a_new_effect_gets_a_row():
    """Values within bounds that change an output."""
    with effects_of([ROOT / "examples" / "own_effect" / "load_friction.py"]):
        row = row_of(ALL_EFFECTS["load_friction"])
        table = {"name": "load_friction", "axis": row.axis, **row.parameters}
        assert not equal(follow("X", short_move("X"), [table]), follow("X", short_move("X"), [{**table, **row.other}]))


def test_every_row_is_of_an_effect():
    assert set(ROWS) == set(EFFECTS)


def test_every_row_names_all_parameters():
    for name, row in ROWS.items():
        names = {p.name for p in EFFECTS[name].parameters}
        assert set(row.parameters) == names
        assert set(row.other) == names


def test_names_and_parameters_are_the_fixed_ones():
    """Machine files, diagnosis and examination share these names."""
    fixed = """position_gain factor; velocity_feedforward factor; torque_feedforward factor; loop_delay delay_s; speed_gain factor;
    speed_integral_time factor; set_point_filter time_constant_s; current_filter time_constant_s; torque_constant factor;
    current_limit limit_a; inertia added; coulomb_friction factor; viscous_friction factor; stribeck excess velocity;
    presliding stiffness; viscous_asymmetry fraction;
    position_dependent_friction fraction wavelength; constant_force force; table_unbalance mass_kg radius_m angle_rad height_m;
    backlash clearance; transmission_compliance stiffness; frame_vibration frequency_hz; torque_ripple amplitude_nm periods_per_rev;
    lead_error fraction; cyclic_error amplitude; encoder_eccentricity amplitude; thermal_drift rate; cross_axis_coupling mass;
    periodic_disturbance frequency_hz force"""
    for line in fixed.split(";"):
        name, *parameters = line.split()
        assert set(parameters) <= {p.name for p in EFFECTS[name].parameters}


@pytest.mark.parametrize("name", EFFECTS)
def test_unit_is_complete(name):
    """Block, law with equation, bounds that contain the usual range on every axis that can have the effect."""
    effect = EFFECTS[name]
    assert effect.block in BLOCKS
    assert len(effect.law.splitlines()) >= 3
    assert effect.summary
    assert effect.axes(MACHINE)
    for axis in effect.axes(MACHINE):
        for p in effect.parameters:
            low, high = p.usual_range(MACHINE, axis)
            assert p.low <= low < high <= p.high, (axis.name, p.name)
            assert p.unit(axis)
    assert any(p.neutral is not None for p in effect.parameters)


FACTORS = [(name, p) for name, effect in EFFECTS.items() for p in effect.parameters if p.is_factor]


@pytest.mark.parametrize(("name", "parameter"), FACTORS, ids=[name for name, _ in FACTORS])
def test_a_factor_multiplies_the_field_that_it_names(name, parameter):
    """Diagnosis uses this name for the changed law of the position controller."""
    setting = check_setting({"name": name, "axis": "X", parameter.name: 1.25}, MACHINE, "test")
    changed = apply_effects(with_effects(MACHINE.with_axes(["X"]), [setting])).machine.axis("X")

    def value(axis):
        return next(getattr(part, parameter.multiplies) for part in (axis, axis.motor, axis.loops) if hasattr(part, parameter.multiplies))

    assert value(changed) == pytest.approx(1.25 * value(X), rel=1e-12)
    assert setting.factor_on(parameter.multiplies) == 1.25
    assert setting.factor_on("ratio") == 1.0


def test_names_that_effects_give_of_each_other_exist():
    for effect in EFFECTS.values():
        assert set(effect.contains) <= set(EFFECTS), effect.name
        assert all(p.judged_with in ("", *(q.name for q in effect.parameters)) for p in effect.parameters)
        assert effect.rivals, "say what separates it from its rivals"
        assert effect.picture.look, "say what to look at in its picture"


@pytest.mark.parametrize(("name", "parameter"), [(name, p.name) for name, effect in EFFECTS.items() for p in effect.parameters])
def test_each_parameter_changes_an_output(name, parameter):
    row = ROWS[name]
    assert not equal(moved(name), moved(name, **{parameter: row.other[parameter]}))


@pytest.mark.parametrize(
    ("name", "parameter"),
    [(n, p) for n, e in EFFECTS.items() for p in e.parameters if p.neutral is not None],
    ids=lambda x: getattr(x, "name", x),
)
def test_neutral_is_bit_identical_to_the_machine_without_it(name, parameter):
    assert equal(moved(name, **{parameter.name: parameter.neutral}), bare(name))
    assert not equal(moved(name), bare(name))


@pytest.mark.parametrize("name", [n for n in EFFECTS if n != "periodic_disturbance"])
def test_start_is_at_rest(name):
    """The scale shows the set point and nothing moves in the first millisecond, for any start of the run."""
    row = ROWS[name]
    for start in (0.0, 0.11) if row.axis == "X" else (0.0, -0.4):
        machine = MACHINE.with_axes([row.axis, *row.with_axes])
        machine = with_effects(machine, [{"name": name, "axis": row.axis, **row.also, **row.parameters}])
        trace = simulate(machine, Setpoints(np.full((20, len(machine.axes)), start), 1e-3), sample_period=125e-6, started_at=30.0).trace
        first = trace.time <= 1e-3
        assert trace.get(row.axis, "position")[0] == pytest.approx(start, abs=1e-15)
        assert np.abs(trace.get(row.axis, "position") - start)[first].max() < 1e-9
        assert np.abs(trace.get(row.axis, "velocity")[first]).max() < 1e-5


@pytest.mark.parametrize(("axis", "effects", "offset"), [
    ("Z", [{"name": "backlash", "clearance": 20e-6, "contact_stiffness": 1e9}], 10e-6 + 350 * 9.81 / 1e9),
    ("X", [{"name": "backlash", "clearance": 20e-6, "contact_stiffness": 1e9}], 0.0),
    ("X", [{"name": "backlash", "clearance": 20e-6, "contact_stiffness": 1e9}, {"name": "constant_force", "force": -400.0}], -10e-6 - 4e-7),
    ("Z", [{"name": "transmission_compliance", "stiffness": 5e7}], 350 * 9.81 / 5e7),
])  # fmt: skip
def test_start_on_the_pressed_flank(axis, effects, offset):
    """The gap is centred without a force; with a force, the axis stays on the loaded flank with the spring deflected."""
    trace = follow(axis, np.zeros(100), effects)
    stretch = trace.get(axis, "motor_position") - trace.get(axis, "position")
    assert stretch[0] == pytest.approx(offset, abs=1e-12)
    assert np.abs(stretch - offset).max() < 1e-9
    assert np.abs(trace.get(axis, "velocity")).max() < 1e-6


ALL_ON_X = [{"name": name, "axis": "X", **row.also, **row.parameters} for name, row in ROWS.items() if row.axis == "X"]


def test_many_at_once_in_any_order():
    """All effects of X together, including backlash and compliance, are stable; their order in the file does not matter."""
    runs = []
    for tables in (ALL_ON_X, ALL_ON_X[::-1]):
        machine = with_effects(MACHINE.with_axes(["X", "Y"]), tables)
        trace = simulate(machine, Setpoints(np.column_stack([short_move("X")] * 2), 1e-3)).trace
        runs.append(trace)
        assert np.abs(trace.get("X", "setpoint") - trace.get("X", "position")).max() < 2e-3
    assert equal(*runs)


def test_order_of_viscous_friction_and_its_asymmetry():
    tables = [{"name": "viscous_asymmetry", "fraction": 0.3}, {"name": "viscous_friction", "factor": 2.0}]
    assert equal(*(follow("X", short_move("X"), t) for t in (tables, tables[::-1])))


def test_on_different_axes_at_once():
    """Effects of one axis do not change uncoupled axes."""
    effects = [{"name": "backlash", "axis": "X", "clearance": 15e-6}, {"name": "transmission_compliance", "axis": "Y", "stiffness": 1e8}]
    pair = MACHINE.with_axes(["X", "Y"])
    position = Setpoints(np.column_stack([short_move("X")] * 2), 1e-3)
    both = simulate(with_effects(pair, effects), position).trace
    for effect in effects:
        alone = simulate(with_effects(pair, [effect]), position).trace
        off = both.get(effect["axis"], "position") - alone.get(effect["axis"], "position")
        assert np.abs(off).max() < 1e-12


def beyond(parameter, low: float, high: float) -> list[tuple[float, float]]:
    """The ends of the usual range, each with the value three times as far from neutral, within bounds: (usual, beyond)."""
    by_factor = (3 * low if low < 0.0 else low / 3, 3 * high)
    far = (1 + 3 * (low - 1), 1 + 3 * (high - 1)) if parameter.neutral == 1.0 else by_factor
    return [(usual, float(np.clip(v, parameter.low, parameter.high))) for usual, v in zip((low, high), far)]


STABILITY = [(name, axis.name) for name, effect in EFFECTS.items() for axis in effect.axes(MACHINE)]
REFUSED = {
    ("current_limit", "Z"): "cannot be held",  # less than the holding current
    ("transmission_compliance", "all"): "unstable",  # a position gain of 50 1/s destabilises a mode at 20 Hz
    ("loop_delay", "all"): "exceeds the nominal delay",  # three times the usual size is the entire delay
}


@pytest.mark.parametrize(("name", "axis"), STABILITY)
def test_stable_or_refused_three_times_beyond_the_usual_range(name, axis):
    """After a short move each axis comes to rest at its set point, or the run is refused with a reason."""
    effect, a = EFFECTS[name], MACHINE.axis(axis)
    other = next(n for n in "XYZ" if n != axis)
    machine = MACHINE.with_axes({"table_unbalance": ["A", "C"], "cross_axis_coupling": [axis, other]}.get(name, [axis]))
    also = {"from_axis": other} if effect.from_axis else {}
    sizes = {p.name: p.usual_range(MACHINE, a) for p in effect.parameters if not p.shape or p.default is not None}
    middle = {n: (low + high) / 2 for n, (low, high) in sizes.items()}
    move = np.concatenate([short_move(axis), np.full(1000 if name in ("frame_vibration", "current_limit") else 400, short_move(axis)[-1])])
    setpoints = Setpoints(np.column_stack([move] * len(machine.axes)), 1e-3)

    def comes_to_rest(**value: float) -> None:
        trace = simulate(with_effects(machine, [{"name": name, "axis": axis, **also, **middle, **value}]), setpoints).trace
        speed = np.abs(trace.get(axis, "velocity"))
        rest = 0.02 if name == "periodic_disturbance" else 0.05 if name == "frame_vibration" else 0.005
        assert speed[-200:].max() < rest * speed.max() + 1e-4, value
        assert np.abs(trace.get(axis, "setpoint") - trace.get(axis, "position"))[-200:].max() < 0.01 * np.ptp(move), value

    for p in (p for p in effect.parameters if p.name in sizes):
        for usual, far in beyond(p, *sizes[p.name]):
            try:
                comes_to_rest(**{p.name: far})
                continue
            except TwinError as error:
                message = str(error)
            assert REFUSED.get((name, axis), REFUSED.get((name, "all"), "not refused")) in message, (p.name, far)
            comes_to_rest(**{p.name: usual})


@pytest.mark.parametrize("table", [
    {"name": "transmission_compliance", "stiffness": 1e12},
    {"name": "backlash", "clearance": 1e-5, "contact_stiffness": 1e12},
    {"name": "presliding", "stiffness": 1e12},
    {"name": "presliding", "stiffness": 1e8, "damping": 1e9},
    {"name": "inertia", "added": -700.0},
])  # fmt: skip
def test_a_mode_too_fast_for_the_tick_is_refused(table):
    with pytest.raises(InputError, match=r"on axis X.*give (at most|more than)"):
        follow("X", np.zeros(10), [table])


def test_divergence_names_the_axis_and_keeps_the_trace():
    with pytest.raises(SimulationError, match="axis C") as caught:
        follow("C", short_move("C"), [NO_COULOMB, {"name": "transmission_compliance", "stiffness": 2e4, "damping": 0.0}])
    assert caught.value.trace is not None


# --- input ---------------------------------------------------------------------------------------------------------------------------


BAD = {
    "backlsh:X:clearance=1e-5": "did you mean 'backlash'?",
    "nothing:X:a=1": "unknown effect 'nothing'",
    "backlash:X:clearence=1e-5": "no parameter 'clearence'; did you mean 'clearance'?",
    "backlash:X": "'clearance' is missing; give it in m",
    "backlash": "write NAME:AXIS:PARAMETER=VALUE",
    "backlash:X:clearance": "'clearance' is not of the form PARAMETER=VALUE",
    "backlash:X:clearance=wide": "clearance = 'wide' is not a number",
    "backlash:X:clearance=20A": "clearance = '20A': give it in m (or mm, um, cm, in)",
    "backlash:X:clearance=20parsec": "give it in m (or mm",
    "thermal_drift:X:rate=1um": "give it in m/s",
    "backlash:X:clearance=nan": "expected a number in m",
    "backlash:X:clearance=-1e-6": "clearance = -1e-06 m is out of bounds; give 0 to 0.01 m",
    "backlash:X:clearance=1": "clearance = 1 m is out of bounds",
    "backlash:X:clearance=inf": "clearance = inf m is out of bounds",
    "backlash:X:clearance=1e-5,clearance=2e-5": "'clearance' is given twice",
    "backlash:Q:clearance=1e-5": "no axis 'Q'",
    "backlash:Q:clearance=15um": "no axis 'Q'",
    "backlash:X:clearance=1e-5,axis=Y": "'axis' is given twice",
    "backlash:X:clearance=1e-5,from_axis=Y": "has no from_axis",
    "encoder_eccentricity:A:amplitude=1e-5": "axis A cannot have it: it is for rotary axes that turn fully round; use C",
    "table_unbalance:C:mass_kg=20,radius_m=0.1,angle_rad=0": "axis C cannot have it: it is for the rotary axis that tilts the table; use A",
    "table_unbalance:A:mass_kg=20": "'radius_m' is missing; give it in m",
    "lead_error:A:fraction=1e-5": "axis A cannot have it: it is for linear axes; use X, Y, Z",
    "thermal_drift:C:rate=1e-7": "axis C cannot have it",
    "cross_axis_coupling:X:mass=50": "from_axis is missing; name another of the linear axes: Y, Z",
    "cross_axis_coupling:X:mass=50,from_axis=X": "from_axis = 'X' cannot be; name another of the linear axes: Y, Z",
    "cross_axis_coupling:X:mass=50,from_axis=A": "from_axis = 'A' cannot be",
}


@pytest.mark.parametrize(
    ("given", "si"),
    [
        ("backlash:X:clearance=20um", "backlash:X:clearance=20e-6"),
        ("backlash:X:clearance=2.0e1 \N{MICRO SIGN}m", "backlash:X:clearance=20e-6"),
        ("backlash:X:clearance=.02mm", "backlash:X:clearance=20e-6"),
        ("backlash:A:clearance=10arcsec", "backlash:A:clearance=4.84813681109536e-05"),
        (
            "table_unbalance:A:mass_kg=3kg,radius_m=20mm,angle_rad=90deg",
            "table_unbalance:A:mass_kg=3,radius_m=0.02,angle_rad=1.5707963267948966",
        ),
    ],
)
def test_a_value_may_have_its_unit(given: str, si: str) -> None:
    """Any parameter, in any unit of its dimension."""
    found, wanted = parse_setting(given, MACHINE), parse_setting(si, MACHINE)
    assert found.parameters == pytest.approx(wanted.parameters, rel=1e-12)


@pytest.fixture
def set_points(tmp_path):
    path = tmp_path / "short.csv"
    rows = "\n".join(f"{t * 1e-3:.3f},{1e-3 * t:.4f}" for t in range(20))
    path.write_text(f"time [s],X.setpoint [mm]\n{rows}\n")
    return path


@pytest.mark.parametrize("text", BAD)
def test_bad_effect_on_the_command_line(text, set_points, capsys):
    """Exit code 2 and one line with what, where and what to do."""
    assert main(["run", str(set_points), "--effect", text, "--out", str(set_points.parent / "out"), "--no-recording"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert message.startswith("twin: ")
    assert BAD[text] in message


def test_the_same_effect_twice(set_points, capsys):
    effect = ["--effect", "backlash:X:clearance=1e-5"]
    assert main(["run", str(set_points), *effect, *effect, "--out", str(set_points.parent / "out")]) == 2
    assert "effect backlash is given twice on axis X; keep one" in capsys.readouterr().err


def test_coupling_from_two_axes_is_not_a_duplicate():
    tables = [{"name": "cross_axis_coupling", "axis": "X", "from_axis": a, "mass": 50.0} for a in "YZ"]
    assert len(settings_of(with_effects(MACHINE, tables))) == 2


@pytest.mark.parametrize(("table", "message"), [
    ({"axis": "X"}, "needs a name"),
    ({"name": ["backlash"], "axis": "X"}, "unknown effect"),
    ({"name": "backlash", "clearance": 1e-5}, "'axis' is missing"),
    ({"name": "backlash", "axis": ["X"], "clearance": 1e-5}, "no axis"),
    ({"name": "backlash", "axis": "X", "clearance": "15 um"}, "expected a number in m"),
    ({"name": "backlash", "axis": "X", "clearance": True}, "expected a number in m"),
    ("backlash", "needs a name"),
])  # fmt: skip
def test_bad_table_in_a_machine_file(table, message):
    with pytest.raises(InputError, match=message):
        check_setting(table, MACHINE, "machine.toml: effect 1")


def test_unbalance_needs_a_tilting_pair():
    single = MACHINE.with_axes(["X", "C"])
    with pytest.raises(InputError, match="use no axis of this machine"):
        with_effects(single, [{"name": "table_unbalance", "axis": "C", "mass_kg": 20.0, "radius_m": 0.1, "angle_rad": 0.0}])


def test_delay_cannot_be_negative():
    with pytest.raises(InputError, match="exceeds the nominal delay"):
        apply_effects(
            with_effects(MACHINE.with_axis("X", position_delay_s=0.5e-3), [{"name": "loop_delay", "axis": "X", "delay_s": -1e-3}])
        )


def test_effects_of_a_machine_file_and_of_the_command_line_are_the_same(tmp_path):
    """[[effect]] tables, --effect and Python give the same machine."""
    source = MACHINE.path
    assert source
    (tmp_path / MACHINE.model_path.name).write_text(MACHINE.model_path.read_text())
    file = tmp_path / "loose.toml"
    file.write_text(source.read_text() + '\n[[effect]]\nname = "backlash"\naxis = "X"\nclearance = 1.5e-5\n')
    from_file = settings_of(load_machine(file))
    from_text = parse_setting("backlash:X:clearance=15e-6", MACHINE)
    from_python = settings_of(with_effects(MACHINE, [{"name": "backlash", "axis": "X", "clearance": 1.5e-5}]))
    assert [s.table() for s in from_file] == [from_text.table()] == [s.table() for s in from_python]


def test_effects_command_lists_and_describes(capsys):
    assert main(["effects"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed and EFFECTS[name].summary in listed for name in EFFECTS)
    for name in EFFECTS:
        assert main(["effects", name]) == 0
        message = capsys.readouterr().out
        assert all(p.name in message for p in EFFECTS[name].parameters)
    assert main(["effects", "backlsh"]) == 2
    assert "did you mean 'backlash'?" in capsys.readouterr().err


def test_laws_are_tested():
    """Each effect is named in a reference test."""
    folder = Path(__file__).resolve().parents[1] / "reference"
    text = "".join(file.read_text(encoding="utf-8") for file in folder.glob("test_effects_*.py"))
    assert [name for name in EFFECTS if f'"name": "{name}"' not in text] == []
    assert math.isfinite(X.coulomb_friction)


def test_a_load_that_vanishes_beside_its_rotor_is_refused():
    heavy = MACHINE.with_values({"axis.X.rotor_and_screw_inertia_kg_m2": 1e15})
    with pytest.raises(InputError, match="axis X: its load vanishes beside its rotor"):
        load_inertia(heavy, heavy.axis("X"))


def test_usual_sizes_lie_within_the_bounds():
    axis = MACHINE.axis("X")
    for usual, expected in (((0.0, 0.0), (1.0, 1.0)), ((0.5, 20.0), (1.0, 9.0)), ((2.0, 3.0), (2.0, 3.0))):
        assert Parameter("stiffness", "stiffness", 1.0, 9.0, usual).usual_range(MACHINE, axis) == expected


@pytest.mark.parametrize("share", [1e-9, 1e3])
def test_sizes_of_an_axis_in_any_unit_of_its_command_are_usual(share: float) -> None:
    """An axis of a recording has its mass and friction in A or in counts of a converter: a spring of 1e-3 A/rad is as usual as one of 1e9 Nm/rad."""
    machine = MACHINE.with_values({"axis.C.coulomb_friction_nm": share * MACHINE.document["axis"]["C"]["coulomb_friction_nm"]})
    stiffness = EFFECTS["presliding"].parameter("stiffness")
    ends = stiffness.usual_range(machine, machine.axis("C"))
    assert ends == pytest.approx([share * end for end in stiffness.usual_range(MACHINE, MACHINE.axis("C"))])


def test_a_clamped_mass_stands_above_the_tilting_axis_wherever_the_table_is():
    """The torque that holds the tilted table does not depend on where the frame of the table lies."""
    held = []
    for above in (0.0, 0.03):
        machine = load_machine().with_values({"geometry.a_axis_to_c_axis_z_m": above})
        weight = {"name": "table_unbalance", "axis": "A", "mass_kg": 50.0, "radius_m": 0.0, "angle_rad": 0.0, "height_m": 0.2}
        torques = []
        for effects in ([], [weight]):
            change = apply_effects(with_effects(machine, effects))
            plant = build_plant(change.machine, change.model_edits)
            plant.data.qpos[plant.load_position[machine.axis_names.index("A")]] = 0.5
            mujoco.mj_forward(plant.model, plant.data)
            torques.append(plant.data.qfrc_bias[plant.load_dof[machine.axis_names.index("A")]])
        held.append(torques[1] - torques[0])
    assert held[1] == pytest.approx(held[0], rel=1e-9)
    assert abs(held[0]) > 10.0


def test_the_control_of_a_weaker_motor_keeps_the_torque_constant_of_its_commissioning() -> None:
    """Also where its file says none, because it was that of the motor."""
    shipped = load_machine()
    document = copy.deepcopy(dict(shipped.document))
    del document["axis"]["X"]["commissioned"]["torque_constant_nm_per_a"]
    machine = Machine(document, shipped.model_path)
    before, after = (apply_effects(m).machine.axis("X") for m in (machine, add_effects(machine, "torque_constant:X:factor=0.9")))
    assert after.motor.torque_constant_nm_per_a == pytest.approx(0.9 * before.motor.torque_constant_nm_per_a, rel=1e-12)
    assert after.commissioned_torque_constant == before.commissioned_torque_constant == before.motor.torque_constant_nm_per_a
