"""Laws in a machine file: reading, writing, errors; the loop computes the equation of the file."""

import math
from pathlib import Path
import pickle

import numpy as np
import pytest

from twin.cli import main as twin_command
from twin.effects import apply_effects, check_setting, settings_of, with_effects
from twin.effects.law import law_of
from twin.effects.law_filters import RING, filter_row, filtered, response
from twin.effects.law_shapes import SHAPES, TABLE, row_of, values_of
from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine, write_machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

MACHINE = load_machine()
X = MACHINE.with_axes(["X"])
BELL = {
    "name": "law", "axis": "X", "block": "mechanics", "output": "friction", "variables": ["speed"],
    "formula": "height * e^(-((speed - at) / width)^2)", "height": 150.0, "width": 0.005, "at": 0.0,
}  # fmt: skip
STROKE = moves_in_turn(0.0, [0.0015, -0.0015], 0.010, 0.5, 20.0, 0.05, 1e-3)[1]


def trace_of(*effects: dict, position: np.ndarray = STROKE, machine=X, started_at: float = 0.0):
    points = Setpoints(np.column_stack([position] * len(machine.axes)) if position.ndim == 1 else position, 1e-3)
    return simulate(with_effects(machine, effects), points, started_at=started_at).trace


def test_a_law_is_the_effect_of_the_library_that_has_the_same_equation():
    """Gaussian friction over speed is Stribeck friction; the difference is half a tick of acceleration."""
    plain, stribeck = trace_of(), trace_of({"name": "stribeck", "axis": "X", "excess": 150.0, "velocity": 0.005})
    bell = trace_of(BELL).get("X", "current")
    effect = np.abs(stribeck.get("X", "current") - plain.get("X", "current")).max()
    assert effect > 0.1
    assert np.abs(bell - stribeck.get("X", "current")).max() < 0.01 * effect


def test_a_constant_law_of_position_is_a_constant_force_and_is_held_at_rest():
    constant = trace_of({"name": "constant_force", "axis": "X", "force": 200.0})
    points = {"name": "law", "axis": "X", "block": "mechanics", "variables": ["position"], "points": [[-1.0, -200.0], [1.0, -200.0]]}
    np.testing.assert_allclose(trace_of(points).get("X", "current"), constant.get("X", "current"), atol=1e-9)


def test_a_law_of_the_turn_is_a_ripple():
    ripple = trace_of({"name": "torque_ripple", "axis": "X", "amplitude_nm": 0.2, "periods_per_rev": 4.0, "phase_rad": 0.3})
    wave = {"name": "law", "axis": "X", "block": "current loop", "variables": ["turn"], "formula": "sine"}
    wave |= {"amplitude": 0.2, "period": math.pi / 2.0, "phase_rad": 0.3}
    np.testing.assert_allclose(trace_of(wave).get("X", "current"), ripple.get("X", "current"), atol=1e-9)


def test_a_machine_with_a_law_that_was_read_goes_to_another_process():
    machine = with_effects(X, [BELL])
    assert settings_of(machine) is settings_of(machine)
    there = pickle.loads(pickle.dumps(machine))
    assert there == machine
    assert settings_of(there)[0].table() == BELL


def test_only_a_recorded_current_is_late():
    plain = trace_of()
    late = trace_of({"name": "law", "axis": "X", "block": "measurement", "output": "current", "variables": ["current"],
                     "formula": "dead time", "time_s": 0.004})  # fmt: skip
    np.testing.assert_allclose(late.get("X", "current")[4:], plain.get("X", "current")[:-4], atol=1e-12)
    assert np.array_equal(late.get("X", "position"), plain.get("X", "position"))


@pytest.mark.parametrize(("name", "numbers"), [("lag", {"time_constant_s": 0.004}), ("notch", {"width": 0.7, "frequency_hz": 90.0}),
                                               ("dead time", {"time_s": 0.0013})])  # fmt: skip
def test_a_filter_has_its_frequency_response(name: str, numbers: dict[str, float]):
    cycle, frequency = 2.5e-4, 60.0
    row, state = np.array(filter_row(SHAPES[name], numbers, cycle)), np.zeros(RING + 1)
    t = cycle * np.arange(8000)
    out = np.array([filtered(SHAPES[name].code, u, row, state, i == 0) for i, u in enumerate(np.sin(2 * np.pi * frequency * t))])
    settled = slice(4000, 8000)  # whole periods
    measured = 2.0 * np.mean(out[settled] * np.exp(-2j * np.pi * frequency * t[settled])) * 1j
    assert measured == pytest.approx(response(SHAPES[name], numbers, cycle, np.array([frequency]))[0], abs=2e-6)


def test_a_lag_of_the_current_set_point_is_the_current_filter():
    listed = trace_of({"name": "current_filter", "axis": "X", "time_constant_s": 0.001})
    lag = {
        "name": "law",
        "axis": "X",
        "block": "speed controller",
        "variables": ["current_setpoint"],
        "formula": "lag",
        "time_constant_s": 0.001,
    }
    np.testing.assert_allclose(trace_of(lag).get("X", "current"), listed.get("X", "current"), atol=1e-9)


def test_a_law_of_direction_has_a_memory_length():
    """A slow stroke of many lengths ends with the full force; the force balance shows it in the current."""
    length, force = 1e-4, 300.0
    hysteresis = {"name": "law", "axis": "X", "block": "mechanics", "variables": ["direction"], "formula": "line"}
    hysteresis |= {"height": -force, "length": length}
    more = trace_of(hysteresis).get("X", "torque") - trace_of().get("X", "torque")
    moving = np.abs(np.gradient(STROKE, 1e-3)[: len(more)]) > 0.009
    half = len(more) // 2
    r = X.axes[0].ratio
    assert np.median(more[:half][moving[:half]]) == pytest.approx(force * r, rel=0.02)
    assert np.median(more[half:][moving[half:]]) == pytest.approx(-force * r, rel=0.02)


def test_displacements_of_motor_and_scale_show_between_the_encoders():
    stroke = moves_in_turn(0.0, [0.05, -0.05], 0.05, 0.5, 20.0, 0.05, 1e-3)[1]
    for block, sign in (("transmission", 1.0), ("measurement", -1.0)):
        law = {"name": "law", "axis": "X", "block": block, "variables": ["position"], "formula": "line", "height": 1e-4, "reach": 1.0}
        trace = trace_of(law, position=stroke)
        motor_minus_scale = trace.get("X", "motor_position") - trace.get("X", "position")
        np.testing.assert_allclose(motor_minus_scale, sign * 1e-4 * trace.get("X", "position"), atol=2e-9)


def test_a_law_of_another_axis_takes_that_axis():
    two = MACHINE.with_axes(["X", "Y"])
    position = np.column_stack([STROKE, 0.0 * STROKE])
    law = {
        "name": "law",
        "axis": "Y",
        "block": "measurement",
        "variables": ["position"],
        "from_axis": "X",
        "formula": "line",
        "height": 0.05,
    }
    trace = trace_of(law, position=position, machine=two)
    # the loop is closed on the scale, so the load moves in the opposite direction
    assert np.ptp(trace.get("Y", "motor_position")) == pytest.approx(0.05 * np.ptp(trace.get("X", "position")), rel=0.05)


def test_a_memory_in_time_lets_the_output_follow():
    law = {**BELL, "variables": ["time"], "formula": "approach", "scale": 1e-6, "memory_s": 100.0, "height": 150.0}
    law = {k: v for k, v in law.items() if k not in ("width", "at")}
    assert np.abs(trace_of(law).get("X", "torque") - trace_of().get("X", "torque")).max() < 0.05


def test_a_law_is_written_and_read_without_loss(tmp_path: Path):
    curve = {"name": "law", "axis": "Y", "block": "mechanics", "output": "force", "variables": ["position"], "between": "cubic"}
    curve |= {"points": [[-0.1, 3.25], [0.0, -1.5], [0.2, 0.1]]}
    machine = with_effects(MACHINE, [BELL, {**BELL, "variables": ["acceleration_size"], "formula": "gaussian"}, curve])
    write_machine(machine, tmp_path / "machine.toml")
    again = load_machine(tmp_path / "machine.toml")
    assert [s.table() for s in settings_of(again)] == [s.table() for s in settings_of(machine)]
    assert settings_of(again)[0].table() == BELL
    # the setting equals its table
    assert check_setting(settings_of(again)[2].table(), machine, "again").table() == settings_of(machine)[2].table()


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_moves_with_every_number(name: str):
    shape = SHAPES[name]
    x = np.linspace(0.2, 1.3, 7)
    numbers = {n.name: 0.7 if n.default in (None, 0.0, 1.0) else n.default for n in shape.numbers}
    if shape.code >= 100:
        return
    y = values_of(shape, x, row_of(shape, numbers, 1.0))
    assert np.abs(y).max() > 0.0
    for number in shape.numbers:
        moved = values_of(shape, x, row_of(shape, {**numbers, number.name: 1.1 * numbers[number.name]}, 1.0))
        assert np.abs(moved - y).max() > 1e-6, number.name


def test_a_curve_goes_through_its_points_and_stays_beyond_them():
    table = {"block": "mechanics", "variables": ["position"], "points": [[0.0, 1.0], [1.0, 3.0], [3.0, -1.0]]}
    for between in ("linear", "cubic"):
        law = law_of({**table, "between": between}, "test")
        assert law.shape.code == TABLE
        y = law.values(np.array([-5.0, 0.0, 1.0, 2.0, 3.0, 9.0]), {"scale": 2.0}, X.axes[0])
        np.testing.assert_allclose(y[[0, 1, 2, 4, 5]], [2.0, 2.0, 6.0, -2.0, -2.0])
    wave = law_of({**table, "points": [[0.0, 1.0], [1.0, 3.0], [2.0, 1.0]], "period": 2.0}, "test")
    np.testing.assert_allclose(wave.values(np.array([0.5, 2.5, -1.5]), {}, X.axes[0]), 2.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"block": "motor"}, "block = 'motor' is not known"),
        ({"block": [["mechanics"]]}, "block = [['mechanics']] is not known"),
        ({"output": "torque"}, "law of the mechanics: output = 'torque' is not known; known are: force, friction"),
        ({"output": {"a": 1}}, "output = {'a': 1} is not known"),
        ({"variables": [["speed"]]}, "no variable ['speed']"),
        ({"variables": ["weight"]}, "no variable 'weight'"),
        ({"variables": ["following_error"]}, "is available in the position controller only"),
        ({"variables": ["speed", "position"]}, "give exactly one"),
        ({"formula": "bessel"}, "is not one of the shapes step, line"),
        ({"formula": "lag"}, "a lag filters current over"),
        ({"points": [[0.0, 1.0]]}, "either a formula or points"),
        ({"width": -1.0}, "out of bounds"),
        ({"colour": 1.0}, "no parameter 'colour'"),
        (
            {"block": "position controller", "output": "set_point", "variables": ["following_error"]},
            "following_error is known to speed only, not to set_point",
        ),
        (
            {"block": "position controller", "output": "set_point", "variables": ["speed_setpoint"]},
            "speed_setpoint is known to speed and received_speed only",
        ),
    ],
)
def test_a_faulty_law_is_refused_in_one_line(change: dict, said: str):
    with pytest.raises(InputError, match=said.replace("[", r"\[")) as refused:
        check_setting({**BELL, **change}, MACHINE, "file")
    assert "\n" not in str(refused.value)


def test_faulty_points_are_refused():
    curve = {"name": "law", "axis": "X", "block": "mechanics", "variables": ["position"]}
    for points in ([[0.0, 1.0], [0.0, 2.0]], [[0.0, 1.0]], [1.0, 2.0], [[0.0, math.nan], [1.0, 0.0]]):
        with pytest.raises(InputError, match="points"):
            check_setting({**curve, "points": points}, MACHINE, "file")


def test_the_page_lists_and_draws_the_laws_of_a_machine(tmp_path: Path, capsys: pytest.CaptureFixture):
    write_machine(with_effects(MACHINE, [BELL]), tmp_path / "machine.toml")
    assert twin_command(["effects", "law", "--machine", str(tmp_path / "machine.toml"), "--picture", str(tmp_path / "law.png")]) in (
        0,
        None,
    )
    said = capsys.readouterr().out
    assert "height * e^(-((x - at) / width)^2)" in said
    assert "on axis X: A law of the mechanics: friction over speed without sign" in said
    assert (tmp_path / "law.png").stat().st_size > 2000


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ({"block": "mechanics", "output": "force", "variables": ["position"], "formula": "line"}, ""),
        (
            {"block": "transmission", "output": "force", "variables": ["position"], "formula": "line"},
            "a force of the transmission needs a spring",
        ),
        (
            {"block": "transmission", "output": "force", "variables": ["windup"], "formula": "line", "from_axis": "Y"},
            "or backlash to axis Y",
        ),
    ],
)
def test_a_law_of_a_spring_that_is_not_there_is_refused(law: dict, said: str):
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": 1e8}
    elastic = [spring] if "from_axis" in law else []
    machine = with_effects(MACHINE, [*elastic, {"name": "law", "axis": "X", "height": 10.0, "reach": 0.1, **law}])
    if not said:
        apply_effects(machine)
        return
    with pytest.raises(InputError, match=said):
        apply_effects(machine)
