"""A proposal always: what the names of columns do not say, their numbers say. Made data with the names taken away, and recordings of others."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.builders.one_axis import there_and_back
from tests.builders.recorded_files import move, write_csv
from twin import simulate
from twin.cli import main
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.formats.by_content import read_recording
from twin.recordings.names import meaning_of
from twin.recordings.plausible import doubts_of
from twin.recordings.propose import Proposal, propose
from twin.recordings.relations import follows, force_sign
from twin.recordings.signals import Clock, ReadOptions, Recording, Signal, TimeSource
from twin.recordings.skew import Skew
from twin.recordings.trace import Trace
from twin.recordings.units_found import as_made
from twin.recordings.wrapped import turn_of, unwrapped

Array = np.ndarray
TIME = np.arange(3000) * 2e-3
RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data" / "recordings"
UNITS = {"mm": 1.0, "m": 1e-3}
SPEEDS = {"mm/s": 1.0, "mm/min": 60.0, "m/min": 0.06}


def recording(columns: Mapping[str, Array], period: float | None = None, source: TimeSource | None = None) -> Recording:
    """A recording of columns, every `period` [s]; None: without a time."""
    rows = np.arange(len(next(iter(columns.values()))), dtype=float)
    time = rows if period is None else rows * period
    source = source or TimeSource(known=period is not None)
    return Recording(Path("run.csv"), "CSV", {n: Signal(n, np.asarray(v, float), time) for n, v in columns.items()}, source=source)


def roles(proposal: Proposal) -> dict[str, str]:
    """Column -> axis.signal of the used columns."""
    return {c.name: f"{c.axis}.{c.signal}" for c in proposal.used}


def unit_of(proposal: Proposal, name: str) -> str:
    return next(c.unit for c in proposal.columns if c.name == name)


@pytest.fixture(scope="module")
def simulated() -> Trace:
    """Two axes of the Mikron that go there and back one after the other, every 1 ms."""
    machine = load_machine().with_axes(["X", "Z"]).with_feedforward("off")
    move = there_and_back(0.12, 0.3)
    x = np.concatenate([move, np.full(len(move) // 2, move[-1]), 0.5 * move])
    z = np.concatenate([np.zeros(len(move)), 0.4 * move[: len(move) // 2], 0.7 * move])[: len(x)]
    z = np.pad(z, (0, len(x) - len(z)), mode="edge")
    time = np.arange(len(x)) * 1e-3
    setpoints = Trace(time, {("X", "setpoint"): x, ("Z", "setpoint"): z - 0.2}, {"X": "linear", "Z": "linear"})
    return simulate(machine, setpoints).trace


@pytest.mark.parametrize("seed", range(6))
def test_columns_without_names_or_time_are_known_by_their_numbers(simulated: Trace, seed: int) -> None:
    """Any order, any usual unit of the speed, any sign of the current: the roles, the unit, the sign and the period are found."""
    rng = np.random.default_rng(seed)
    trace, noise = simulated, rng.normal(0.0, 5e-5, (2, len(simulated.time)))  # mm
    wound_up = 1.5e-3 * np.tanh(trace.get("X", "velocity") / 1e-3)  # friction winds up the drive train
    speed_unit = str(rng.choice(list(SPEEDS)))
    sign = float(rng.choice([-1.0, 1.0]))
    truth = {
        "setpoint": trace.get("X", "setpoint") * 1e3,
        "position": trace.get("X", "position") * 1e3 + noise[0],
        "motor_position": trace.get("X", "motor_position") * 1e3 + wound_up + noise[1],
        "velocity": trace.get("X", "velocity") * 1e3 * SPEEDS[speed_unit],
        "velocity_setpoint": trace.get("X", "velocity_setpoint") * 1e3 * SPEEDS[speed_unit],
        "current": sign * trace.get("X", "current"),
    }
    order = rng.permutation(list(truth))
    columns = {f"column {i + 1}": truth[signal] for i, signal in enumerate(order)}
    found = propose([recording(columns)])
    assert roles(found) == {f"column {i + 1}": f"X.{signal}" for i, signal in enumerate(order)}
    velocity = f"column {list(order).index('velocity') + 1}"
    current = next(c for c in found.columns if c.signal == "current")
    assert current.sign == sign
    assert found.time is not None
    if speed_unit == "mm/s":  # other units explain other usual periods as well, and the period is asked for
        assert found.time.interval == pytest.approx(1e-3)
        assert unit_of(found, velocity) == "mm/s"
    assert any("--interval-ms" in question for question in found.questions)


def test_axes_without_names_are_told_apart(simulated: Trace) -> None:
    signals = ("setpoint", "position", "velocity")
    columns = {f"{axis}{signal}": simulated.get(axis, signal) * 1e3 for axis in "XZ" for signal in signals}
    names = {f"f{i}": key for i, key in enumerate(columns)}
    found = propose([recording({f: columns[key] for f, key in names.items()}, simulated.period)])
    own = {axis: {names[n][0] for n, role in roles(found).items() if role.startswith(axis)} for axis in found.axes}
    assert len(own) == 2
    assert all(len(real) == 1 for real in own.values())
    assert {names[n][1:]: role.partition(".")[2] for n, role in roles(found).items()} == {s: s for s in signals}


def test_parts_of_a_control_with_their_own_names_are_joined_by_their_signals(simulated: Trace) -> None:
    """A letter and a number of a joint or of a slave of the bus are one axis where the numbers say so: here X is joint 1 and slave 0."""
    x, z = ({s: simulated.get(a, s) * 1e3 for s in ("setpoint", "position", "velocity_setpoint", "current")} for a in "XZ")
    columns = {
        "joint.0.motor-pos-cmd": z["setpoint"], "joint.0.motor-pos-fb": z["position"], "joint.1.motor-pos-cmd": x["setpoint"],
        "joint.1.motor-pos-fb": x["position"], "joint.1.vel-cmd": np.gradient(x["setpoint"], 1e-3), "pid.x.command": np.roll(x["setpoint"], 1),
        "pid.x.output": x["velocity_setpoint"], "pid.z.command": z["setpoint"], "lcec.0.0.torque-actual": x["current"],
        "lcec.0.1.torque-actual": z["current"],
    }  # fmt: skip
    found = propose([recording(columns, 1e-3)])
    expected = {
        "joint.0.motor-pos-fb": "Z.motor_position", "joint.1.motor-pos-fb": "X.motor_position", "lcec.0.0.torque-actual": "X.torque",
        "lcec.0.1.torque-actual": "Z.torque", "pid.x.output": "X.velocity_setpoint", "joint.1.vel-cmd": "X.velocity_feedforward",
    }  # fmt: skip
    assert roles(found).items() >= expected.items()
    assert found.axes == ["X", "Z"]
    assert any(note.startswith("X: one axis by their numbers: ") for note in found.notes)


def test_parts_that_may_be_several_axes_are_not_joined(simulated: Trace) -> None:
    """Two joints of a gantry have one set point, and two axes on a straight line have proportional ones."""
    s, q = simulated.get("X", "setpoint") * 1e3, simulated.get("X", "position") * 1e3
    other = q + 2e-3 * np.sin(0.02 * np.arange(len(q)))
    names = ("joint.0.motor-pos-cmd", "joint.0.motor-pos-fb", "joint.1.motor-pos-cmd", "joint.1.motor-pos-fb", "pid.x.command")
    assert propose([recording(dict(zip(names, (s, q, s, other, s))), 1e-3)]).axes == ["0", "1"]
    assert propose([recording(dict(zip((*names[:2], "pid.y.command"), (s, q, 0.6 * s))), 1e-3)]).axes == ["0"]
    found = propose([recording(dict(zip((*names[:4], "pid.x.feedback", "pid.y.feedback"), (s, q, s, other, other, q))), 1e-3)])
    assert roles(found).keys() == {*names[:4]}  # the feedback decides
    assert roles(found)["joint.1.motor-pos-fb"] == "X.motor_position"


def test_a_record_cut_in_motion_shows_what_follows_what() -> None:
    """The start of a move, as a trigger of a scope records it: the position has not come as far as its set point."""
    t = np.arange(300) * 1e-3
    s = np.where(t < 0.2, 0.0, 500.0 * np.maximum(t - 0.2, 0.0) ** 2)
    x = np.interp(t - 0.008, t, s)
    found = follows(x, s)
    assert found.lag == pytest.approx(8.0, abs=0.02)
    assert found.factor == pytest.approx(1.0, abs=1e-3)
    joined = propose([recording({"joint.0.motor-pos-cmd": s, "board.0.encoder.02.position": x}, 1e-3)])
    assert roles(joined) == {"joint.0.motor-pos-cmd": "0.setpoint", "board.0.encoder.02.position": "0.position"}


def test_limits_are_no_signals(simulated: Trace) -> None:
    """LinuxCNC's limit of the following error grows with the speed."""
    s, x = simulated.get("X", "setpoint") * 1e3, simulated.get("X", "position") * 1e3
    limit = np.maximum(10.0, 0.6 * np.abs(np.gradient(s, 1e-3)))
    found = propose([recording({"joint.0.motor-pos-cmd": s, "joint.0.motor-pos-fb": x, "joint.0.f-error-lim": limit}, 1e-3)])
    assert set(roles(found)) == {"joint.0.motor-pos-cmd", "joint.0.motor-pos-fb"}
    assert "joint.0.f-error-lim" in found.unknown


def test_counts_of_a_turn_without_a_name_that_begin_anew_both_ways_are_a_position() -> None:
    """Such a column is no speed, and its turn is one of the axis; a counter that overflows one way is none."""
    t = np.arange(400) * 0.05
    turned = np.rint(2048.0 + 5000.0 * np.sin(0.4 * t))
    speed, effort = np.gradient(turned, 0.05) / 7.74, np.sign(np.cos(0.4 * t))
    one = recording({"column 1": turned % 4096.0, "column 2": np.rint(speed), "column 3": effort + 1e-3 * speed}, 0.05)
    found = propose([unwrapped(one)])
    assert roles(found).items() >= {"column 1": "X.position", "column 2": "X.velocity"}.items()
    (column,) = (c for c in found.columns if c.name == "column 1")
    assert column.extra == (f"scale = {360.0 / 4096.0:.9g}",)
    assert column.assumed.endswith("taken as a turn")  # regression: the counts of a linear axis that overflow gave measured numbers in deg
    assert turn_of(Signal("column 1", np.rint(600.0 * t) % 4096.0, t)) is None
    np.testing.assert_array_equal(unwrapped(one).signals["column 1"].values, turned)


def test_a_position_that_rests_at_the_end_of_its_turn_is_counted_on() -> None:
    """It wavers by its noise about the end while nothing near it moves."""
    t = np.arange(4000) * 0.001
    turned = 500.0 * np.clip(t - 2.0, 0.0, 1.0)
    turned[100:1500:50] -= np.tile([1e-4, 2e-4], 14)
    signal = Signal("C position actual", turned % 360.0, t, unit="deg")
    assert turn_of(signal) == 360.0
    jumps = np.where(t < 2.0, 0.0, 350.0)
    assert turn_of(Signal("C position actual", jumps, t, unit="deg")) is None


def test_counts_at_uneven_times_keep_their_size() -> None:
    """They are compared between the samples, as an angle beside them is: the nearest sample is off by the motion until then."""
    time = np.cumsum(np.random.default_rng(8).choice([0.05, 0.06, 0.1, 0.115], 90))
    angle = 90.0 * np.clip(0.5 + np.sin(2.0 * time), 0.0, 1.0)
    table = {"motor_pos": (angle, "deg", ""), "motor_position": (np.rint(angle / 0.00133), "", "inc")}
    signals = {name: Signal(name, values, time, unit, "", stated) for name, (values, unit, stated) in table.items()}
    found = propose([Recording(Path("run.csv"), "CSV", signals, source=TimeSource())])
    [size] = [float(key.split()[-1]) for c in found.columns for key in c.extra if key.startswith("scale")]
    assert size == pytest.approx(0.00133, rel=1e-3)


def test_the_proposed_units_of_an_axis_agree() -> None:
    """A motor whose shaft is the axis does not accelerate in mm/s2."""
    t = np.arange(500) * 1e-3
    speed = 300.0 * np.sin(9.0 * t) ** 3 * np.cos(2.0 * t)
    found = propose([recording({"motor speed": speed, "acceleration": np.gradient(speed, 1e-3), "torque": np.sign(speed)}, 1e-3)])
    assert unit_of(found, "acceleration") == "deg/s2"


def test_names_of_servos_and_one_side_of_a_robot() -> None:
    for names in (("goal_position", "present_position"), ("Referencia", "Posicao"), ("LeftTarget", "LeftPosition")):
        m = move(TIME)
        found = propose([recording({"Battery": 24.0 + 0.0 * TIME, names[0]: m["soll"], names[1]: m["ist"]}, 2e-3)])
        assert roles(found) == {names[0]: "X.setpoint", names[1]: "X.position"}
        assert not any("no name says" in question for question in found.questions)


def test_a_force_without_an_axis_is_of_the_axis_that_it_moves(simulated: Trace) -> None:
    columns = {f"{a}.{s}": simulated.get(a, s) * 1e3 for a in "XZ" for s in ("setpoint", "position")}
    columns |= {"torque": simulated.get("Z", "current"), "motor current": np.random.default_rng(0).normal(size=len(simulated.time))}
    found = propose([recording(columns, 1e-3)])
    assert roles(found)["torque"] == "Z.torque"
    assert "no axis alone" in found.unknown["motor current"]


def test_of_columns_without_names_that_go_with_the_motion_one_is_a_force(simulated: Trace) -> None:
    """The force of another axis that starts at the same time goes with this one, too."""
    columns = {f"c{i}": simulated.get("X", s) * 1e3 for i, s in enumerate(("setpoint", "position", "current"))}
    columns["c3"] = np.sign(np.gradient(columns["c1"])) + 0.3 * np.random.default_rng(0).normal(size=len(simulated.time))
    assert set(roles(propose([recording(columns, 1e-3)])).items()) == {("c0", "X.setpoint"), ("c1", "X.position"), ("c2", "X.current")}


def test_one_encoder_under_two_names_is_one(simulated: Trace) -> None:
    s, q = simulated.get("X", "setpoint") * 1e3, simulated.get("X", "position") * 1e3
    found = propose([recording({"X.setpoint": s, "X.position": q, "X.motor_position": q}, 1e-3)])
    assert roles(found) == {"X.setpoint": "X.setpoint", "X.motor_position": "X.motor_position"}


def test_of_two_equally_smooth_columns_the_later_one_is_the_position() -> None:
    m = move(TIME)
    found = propose([recording({"f1": m["ist"], "f2": m["soll"], "f3": m["speed"]}, 2e-3)])
    assert roles(found) == {"f1": "X.position", "f2": "X.setpoint", "f3": "X.velocity"}


def test_the_speed_of_the_profile_is_no_output_of_a_controller() -> None:
    m = move(TIME)
    profile = np.gradient(m["soll"], 2e-3)
    for name in ("target_velocity", "f9"):
        found = propose([recording({"target_position": m["soll"], "actual_position": m["ist"], name: profile}, 2e-3)])
        assert "X.velocity_setpoint" not in roles(found).values()
        assert not found.feedforward
    assert any("no gain follows from it" in note for note in found.notes) or roles(found).get("f9") != "X.velocity_setpoint"
    controlled = 20.0 * (m["soll"] - m["ist"])
    found = propose([recording({"target_position": m["soll"], "actual_position": m["ist"], "target_velocity": controlled}, 2e-3)])
    assert roles(found)["target_velocity"] == "X.velocity_setpoint"


def test_the_set_point_of_a_current_is_its_command_and_alone_the_current() -> None:
    m = move(TIME)
    motion = {"pos_setpoint": m["soll"], "pos_estimate": m["ist"], "Iq_setpoint": m["strom"]}
    assert roles(propose([recording(motion, 2e-3)]))["Iq_setpoint"] == "X.current"
    found = roles(propose([recording({**motion, "Iq_measured": m["strom"] + 0.01 * np.cos(np.arange(len(TIME)))}, 2e-3)]))
    assert (found["Iq_setpoint"], found["Iq_measured"]) == ("X.current_setpoint", "X.current")


def test_objects_of_a_drive_and_speeds_alone_are_known_by_their_names() -> None:
    """A following error is no output of a controller, though gain times following error is one; a speed set point is no measured speed."""
    m = move(TIME)
    counts = {name: np.rint(8000.0 * m[name]) for name in ("soll", "ist", "speed")}
    columns = {
        "0x607A Target position": counts["soll"], "0x6064 Position actual value": counts["ist"], "0x606C Velocity actual value": counts["speed"],
        "0x60F4 Following error actual value": counts["soll"] - counts["ist"], "0x6077 Torque actual value": np.rint(100.0 * m["strom"]),
    }  # fmt: skip
    found = propose([recording(columns, 2e-3)])
    assert set(roles(found).values()) == {"X.setpoint", "X.position", "X.velocity", "X.torque"}
    [torque] = [c for c in found.columns if c.signal == "torque"]
    assert "per mille" in torque.assumed
    speeds = {"r62: Speed setpoint after filter": m["speed"] + m["strom"], "r63: Actual speed value": m["speed"]}
    found = propose([recording({**speeds, "r80: Torque actual value": m["strom"]}, 2e-3)])
    assert list(roles(found).values()) == ["X.velocity", "X.velocity_setpoint", "X.torque"]


def test_a_speed_set_point_has_the_unit_of_the_measured_speed() -> None:
    """0.17 turns for each um/s would be m/min, 1.7 times as fast as the axis."""
    m = move(TIME)
    speeds = {"speed set": 10.0 * (m["soll"] - m["ist"]), "speed act": 0.1 * m["speed"]}
    found = propose([recording({"pos set": np.rint(1e3 * m["soll"]), "pos act": np.rint(1e3 * m["ist"]), **speeds}, 2e-3)])
    assert roles(found)["speed set"] == "X.velocity_setpoint"
    assert [unit_of(found, name) for name in speeds] == ["rev/s", "rev/s"]
    [measured, commanded] = [c.extra for c in found.columns if c.name in speeds]
    assert measured == commanded == ("mm_per_rev = 10",)


def test_of_a_quantity_that_is_named_twice_the_one_that_is_not_called_actual_is_commanded() -> None:
    m = move(TIME)
    names = {"Axis.Position": "soll", "Axis.ActualPosition": "ist", "Axis.ActualVelocity": "speed"}
    found = propose([recording({name: m[own] for name, own in names.items()}, 2e-3)])
    assert roles(found) == dict(zip(names, ("X.setpoint", "X.position", "X.velocity")))
    found = propose([recording({"Axis.Position": m["ist"], "Axis.TargetPosition": m["soll"]}, 2e-3)])
    assert roles(found) == {"Axis.Position": "X.position", "Axis.TargetPosition": "X.setpoint"}


def test_two_positions_of_one_encoder_are_no_set_point_and_position() -> None:
    m = move(TIME)
    found = propose(
        [recording({"X_abs": np.round(m["ist"], 3), "X_mach": np.round(m["ist"] - 350.0, 3), "load": np.abs(m["strom"])}, 2e-3)]
    )
    assert "setpoint" not in {c.signal for c in found.used}


def test_joints_that_words_name_are_told_apart() -> None:
    m, slow = move(TIME), move(0.5 * TIME)
    columns = {
        f"/{place}/{joint}/{quantity}": 0.1 * one[own]
        for joint, one in (("elbow_joint", m), ("wrist_joint", slow))
        for place, quantity, own in (
            ("joint_states", "position", "ist"), ("joint_states", "velocity", "speed"), ("joint_states", "effort", "strom"), ("state/reference", "position", "soll"),
        )
    }  # fmt: skip
    found = propose([recording(columns, 2e-3)])
    signals = ("position", "velocity", "torque", "setpoint")
    assert roles(found) == {name: f"{name.split('/')[-2]}.{signals[i % 4]}" for i, name in enumerate(columns)}


def test_words_of_names_tell_axes_apart_where_each_stands_with_each_signal() -> None:
    m, slow = move(TIME), move(0.5 * TIME)
    names = (
        "gantry_left_pos_cmd",
        "gantry_left_pos_act",
        "gantry_left_current",
        "gantry_right_pos_cmd",
        "gantry_right_pos_act",
        "gantry_right_current",
    )
    columns = dict(zip(names, (m["soll"], m["ist"], m["strom"], slow["soll"], slow["ist"], slow["strom"])))
    signals = ("setpoint", "position", "current")
    found = propose([recording(columns, 2e-3)])
    assert roles(found) == {name: f"gantry_{name.split('_')[1]}.{signals[i % 3]}" for i, name in enumerate(names)}
    joined = {"".join(word.title() for word in name.split("_")[1:]): values for name, values in columns.items()}  # LeftPosCmd
    assert {role.split(".")[0] for role in roles(propose([recording(joined, 2e-3)])).values()} == {"Left", "Right"}
    alone = propose([recording({"Xyz_pos_cmd": m["soll"], "Xyz_pos_act": m["ist"]}, 2e-3)])
    assert set(roles(alone).values()) == {"X.setpoint", "X.position"}


def test_the_motor_of_a_joint_in_degrees_turns_it() -> None:
    """The unit of a column without a known name is one, too: else the travel of a turn would be in mm, and the import refuse its own map."""
    m = move(TIME)
    signals = {"arm_cmd": (m["soll"], "deg"), "arm_fb": (m["ist"], "deg"), "arm_n": (m["speed"] / 3.6 * 60.0, "rev/min")}
    made = {n: Signal(n, v, TIME, unit) for n, (v, unit) in signals.items()}
    found = propose([Recording(Path("run.csv"), "CSV", made)])
    [travel] = [c.extra[0] for c in found.used if c.signal == "velocity"]
    assert travel.startswith("deg_per_rev = 3.6")
    assert roles(propose([recording({"joint1_cmd": m["soll"], "joint1_fb": m["ist"]}, 2e-3)])) == {
        "joint1_cmd": "1.setpoint",
        "joint1_fb": "1.position",
    }


def _scopes() -> dict[str, tuple[str, dict[str, str]]]:
    """Text of exports in the layout of scopes of drives, and what their columns are."""
    m = move(TIME)
    soll, ist, speed, amps = m["soll"], m["ist"], m["speed"], m["strom"]
    counts, rpm, ms = 6553.6, 6.0, TIME * 1e3  # of a turn of 10 mm

    def rows(columns: list[Array], separator: str = ",") -> str:
        return "\n".join(separator.join(f"{value:.4f}" for value in row) for row in zip(*columns))

    return {
        "counts, and names of one letter beside 'loop'": (
            "Scope,AKD\nTime (ms),PL.CMD (Counts16Bit),PL.FB (Counts16Bit),VL.CMD (rpm),VL.FB (rpm),IL.CMD (Arms)\n"
            + rows([ms, np.rint(soll * counts), np.rint(ist * counts), 20.0 * (soll - ist) * rpm, speed * rpm, amps]),
            {"PL.CMD": "X.setpoint", "PL.FB": "X.position", "VL.CMD": "X.velocity_setpoint", "VL.FB": "X.velocity", "IL.CMD": "X.current"},
        ),
        "counts a second": (
            "Time,Position Command [cnt],Position [cnt],Velocity [cnt/sec],Active Current [A]\n"
            + rows([TIME, np.rint(soll * counts), np.rint(ist * counts), speed * counts, amps]),
            {"Position Command": "X.setpoint", "Position": "X.position", "Velocity": "X.velocity", "Active Current": "X.current"},
        ),
        "a line for each channel": (
            "SCOPE Ver 9.20\nSampling cycle(Position)=2ms\nCH1=X:POSF [mm]\nCH2=X:VCMD [1/min]\nCH3=X:SPEED [1/min]\nCH4=X:ERR [um]\nDATA\n"
            + rows([ist, 20.0 * (soll - ist) * rpm, speed * rpm, (soll - ist) * 1e3], " "),
            {"X:POSF": "X.position", "X:VCMD": "X.velocity_setpoint", "X:SPEED": "X.velocity", "X:ERR": "X.following_error"},
        ),
        "speeds and an error in units of nobody": (
            "Sampling time[us],2000\nNo.,Feedback Speed[min-1],Torque Reference[%],Position Error[reference unit]\n"
            + rows([np.arange(len(TIME)), speed * rpm, amps, (soll - ist) * 1e3]),
            {"Feedback Speed": "X.velocity", "Torque Reference[%]": "X.torque"},
        ),
        "a following error without a name": (
            "RPOS(0),FPOS(0),PE(0),FVEL(0)\n" + rows([soll, ist, soll - ist, speed]),
            {"RPOS(0)": "0.setpoint", "FPOS(0)": "0.position", "FVEL(0)": "0.velocity"},
        ),
        "a time that counts the rows": (
            "Time (msec),X Position Command (mm),X Position Feedback (mm)\n" + rows([np.arange(len(TIME)), soll, ist]),
            {"X Position Command": "X.setpoint", "X Position Feedback": "X.position"},
        ),
        "a time base, and numbers of parameters": (
            "[Header]\nTime base=2.000 ms\n[Data]\nS-0-0047, Lage-Sollwert [mm]\tS-0-0051, Lage-Istwert Geber 1 [mm]\n" + rows([soll, ist], "\t"),
            {"S-0-0047, Lage-Sollwert": "X.setpoint", "S-0-0051, Lage-Istwert Geber 1": "X.motor_position"},
        ),
        "NaN in a column that nobody needs": (
            "time,cmd,pos,cur,temp\n" + "\n".join(f"{row},nan" for row in rows([TIME, soll, ist, amps]).split("\n")),
            {"cmd": "X.setpoint", "pos": "X.position", "cur": "X.current"},
        ),
        "a time since 1970 that counts the rows": (
            "n_ms,pos_ref,pos\n" + rows([1.7e12 + np.arange(len(TIME)), soll, ist]).replace(".0000,", ","),
            {"pos_ref": "X.setpoint", "pos": "X.position"},
        ),
        "a unit beside a name that nobody knows": (
            "t[s];B_Soll[°];B_Ist[°];B_Omg[°/s]\n" + rows([TIME, soll, ist, speed], ";"),
            {"B_Soll": "B.setpoint", "B_Ist": "B.position", "B_Omg": "B.velocity"},
        ),
        "loops of a drive with two currents": (
            "t (ms),IL.CMD (Arms),IL.FB (Arms),VL.CMD (rpm),VL.FB (rpm),PL.CMD (counts),PL.FB (counts)\n"
            + rows([ms, amps, np.round(amps, 2), 20.0 * (soll - ist) * rpm, speed * rpm, np.rint(soll * counts), np.rint(ist * counts)]),
            {"PL.CMD": "X.setpoint", "PL.FB": "X.position", "VL.FB": "X.velocity", "VL.CMD": "X.velocity_setpoint", "IL.FB": "X.current"},
        ),
        "units without cells above number and time": (
            'Kind,POSF,ERR,SPEED,TCMD\nUnit,mm,mm,min-1,%\nConv.Coef,1.0,1.0,3750.0,40.0\nIndex,Time[msec],X:POSF,X:ERR,X:SPEED,X:TCMD\n'
            + rows([np.arange(len(TIME)), ms, ist, soll - ist, speed * rpm, 10.0 * amps]),
            {"X:POSF": "X.position", "X:ERR": "X.following_error", "X:SPEED": "X.velocity", "X:TCMD": "X.torque"},
        ),
        "a list of channels above names with units": (
            "Kanal 1;S-0-0047;Lage-Sollwert;Grad\nKanal 2;S-0-0051;Lage-Istwert Geber 1;Grad\nKanal 3;S-0-0040;Geschwindigkeit;U/min\n"
            "Kanal 4;S-0-0084;Drehmoment;%\n\n[Messwerte]\nZeit;S-0-0047 Lage-Sollwert;S-0-0051 Lage-Istwert Geber 1;"
            "S-0-0040 Geschwindigkeits-Istwert;S-0-0084 Drehmoment-/Kraft-Istwert\nms;Grad;Grad;U/min;%\n" + rows([ms, soll, ist, speed / 6.0, amps], ";"),
            {"S-0-0047 Lage-Sollwert": "X.setpoint", "S-0-0051 Lage-Istwert Geber 1": "X.motor_position",
             "S-0-0040 Geschwindigkeits-Istwert": "X.velocity", "S-0-0084 Drehmoment-/Kraft-Istwert": "X.torque"},
        ),
        "units of a program beside turns of the motor": (
            "t [s];gAxis01.PCTRL_S_SET [Units];gAxis01.PCTRL_S_ACT [Units];gAxis01.SCTRL_SPEED_ACT [1/s];gAxis01.ICTRL_ISQ_ACT [A]\n"
            + rows([TIME, 2500.0 * soll, 2500.0 * ist, 0.1 * speed, amps], ";"),
            {"gAxis01.PCTRL_S_SET": "X.setpoint", "gAxis01.PCTRL_S_ACT": "X.position", "gAxis01.SCTRL_SPEED_ACT": "X.velocity",
             "gAxis01.ICTRL_ISQ_ACT": "X.current"},
        ),
        "a command in Chinese, and the encoder of the motor": (
            "时间(ms)\t位置命令(PUU)\t电机反馈位置(PUU)\t位置误差(PUU)\t电机速度(0.1r/min)\n"
            + rows([ms, np.rint(soll * counts), np.rint(ist * counts), np.rint((soll - ist) * counts), np.rint(speed * rpm * 10.0)], "\t"),
            {"位置命令(PUU)": "X.setpoint", "电机反馈位置(PUU)": "X.motor_position", "电机速度": "X.velocity"},
        ),
        "the speed of a position command": (
            "No.,Time[ms],Position command speed[r/min],Motor speed[r/min],Torque command[%],Position deviation[command unit]\n"
            + rows([np.arange(len(TIME)), ms, np.gradient(soll, 2e-3) * rpm, speed * rpm, 10.0 * amps, np.rint((soll - ist) * 1e3)]),
            {"Position command speed": "X.velocity_feedforward", "Motor speed": "X.velocity", "Torque command[%]": "X.torque"},
        ),
        "turns of one name, and none of another": (
            "timestamp,axis0.controller.pos_setpoint,axis0.encoder.pos_estimate,axis0.encoder.vel_estimate\n" + rows([TIME, 0.1 * soll, 0.1 * ist, 0.1 * speed]),
            {"axis0.controller.pos_setpoint": "0.setpoint", "axis0.encoder.pos_estimate": "0.position", "axis0.encoder.vel_estimate": "0.velocity"},
        ),
        "two speeds of an oscilloscope": (
            "t [s];s actual X [mm];s noml X [mm];v (n act) X [mm/min];v (n noml) X [mm/min]\n" + rows([TIME, ist, soll, 60.0 * speed, 1200.0 * (soll - ist)], ";"),
            {"s noml X": "X.setpoint", "s actual X": "X.position", "v (n act) X": "X.velocity", "v (n noml) X": "X.velocity_setpoint"},
        ),
        "a current across the magnets": (
            "t,x_soll,x_ist,v_ist,i_q,i_d\n" + rows([TIME, soll, ist, speed, amps, 0.01 * np.sin(40.0 * TIME)]),
            {"x_soll": "X.setpoint", "x_ist": "X.position", "v_ist": "X.velocity", "i_q": "X.current"},
        ),
        "remarks of the logger between the rows": (
            rows([np.arange(900, 900 + len(TIME)), soll, ist, speed], " ").replace("\n1500.", "\noverrun\n1500."),
            {"column 2": "X.setpoint", "column 3": "X.position", "column 4": "X.velocity"},
        ),
        "an axis behind the name": (
            "t(ms)\tA.TPOS.X\tA.POS.X\tA.TPOS.Y\tA.POS.Y\n" + rows([ms, soll, ist, 0.5 * ist, 0.5 * np.roll(ist, 5)], "\t"),
            {f"A.{name}.{axis}": f"{axis}.{signal}" for axis in "XY" for name, signal in (("TPOS", "setpoint"), ("POS", "position"))},
        ),
        "units below names without a key": (
            '"","Motor speed","Torque","Droop pulses(1 pulse)"\n"Sampling time","2 ms"\n"Unit","r/min","%","pulse"\n'
            + rows([np.arange(len(TIME)), speed * rpm, 10.0 * amps, np.rint((soll - ist) * counts)]),
            {"Motor speed": "X.velocity", "Torque": "X.torque"},
        ),
        "an axis between brackets": (
            "t[ms] Motor[1].DesPos.a Motor[1].ActPos.a Motor[1].IqCmd.a\n" + rows([ms, soll, ist, amps], " "),
            {"Motor[1].DesPos.a": "1.setpoint", "Motor[1].ActPos.a": "1.position", "Motor[1].IqCmd.a": "1.current"},
        ),
        "a letter as an index": (
            "t[ms],aaAxis[Y].sCommandPos,aaAxis[Y].sActualPos,aaAxis[Y].rTorque\n" + rows([ms, soll, ist, amps]),
            {"aaAxis[Y].sCommandPos": "Y.setpoint", "aaAxis[Y].sActualPos": "Y.position", "aaAxis[Y].rTorque": "Y.torque"},
        ),
        "a word that all names hold, and plurals": (
            "ROBOT_TIME,ROBOT_TARGET_JOINT_POSITIONS (J2),ROBOT_ACTUAL_JOINT_POSITIONS (J2),ROBOT_ACTUAL_JOINT_VELOCITIES (J2)\n"
            + rows([TIME, soll, ist, speed]),
            {"ROBOT_TARGET_JOINT_POSITIONS (J2)": "2.setpoint", "ROBOT_ACTUAL_JOINT_POSITIONS (J2)": "2.position",
             "ROBOT_ACTUAL_JOINT_VELOCITIES (J2)": "2.velocity"},
        ),
        "joints by their names below commands and states": (
            "time,/joint_states/elbow/position,/joint_commands/elbow/position,/joint_states/shoulder/position,/joint_commands/shoulder/position\n"
            + rows([TIME, ist, soll, -ist, -soll]),
            {"/joint_commands/elbow/position": "elbow.setpoint", "/joint_states/elbow/position": "elbow.position",
             "/joint_commands/shoulder/position": "shoulder.setpoint", "/joint_states/shoulder/position": "shoulder.position"},
        ),
        "a unit of one letter before the axis, and a load without a name of a torque": (
            "Time (ms),Position Command (mm) - Y,Position Feedback (mm) - Y,Current Feedback (A) - Y,Y servo load (%)\n"
            + rows([ms, soll, ist, amps, 10.0 * amps]),
            {"Position Command - Y": "Y.setpoint", "Position Feedback - Y": "Y.position", "Current Feedback - Y": "Y.current",
             "Y servo load (%)": "Y.torque"},
        ),
        "a percentage behind the index": (
            "Time (ms),RPOS(0) [mm],FPOS(0) [mm],DCOM(0) [%]\n" + rows([ms, soll, ist, amps]),
            {"RPOS(0)": "0.setpoint", "FPOS(0)": "0.position", "DCOM(0) [%]": "0.current"},
        ),
        "milliseconds beside a clock of whole seconds": (
            "Date,Time,Millitm,Axis_Y.CommandPosition,Axis_Y.ActualPosition\n"
            + "\n".join(f"03/05/2024,10:00:{int(t):02d},{round(t % 1 * 1e3)},{a:.4f},{b:.4f}" for t, a, b in zip(TIME, soll, ist)),
            {"Axis_Y.CommandPosition": "Y.setpoint", "Axis_Y.ActualPosition": "Y.position"},
        ),
        "one axis a row": (
            "time,axis,cmd_pos,act_pos,current\n"
            + "\n".join(f"{t:.3f},{axis},{s * a:.4f},{s * b:.4f},{s * c:.4f}" for t, a, b, c in zip(TIME, soll, ist, amps)
                        for axis, s in (("Y", 1.0), ("Z", -0.5))),
            {f"{axis} {name}": f"{axis}.{signal}" for axis in "YZ"
             for name, signal in (("cmd_pos", "setpoint"), ("act_pos", "position"), ("current", "current"))},
        ),
        "a letter of a current behind the axis": (
            "t,x_cmd,x_act,x_i\n" + rows([TIME, soll, ist, amps]), {"x_cmd": "X.setpoint", "x_act": "X.position", "x_i": "X.current"},
        ),
        "a current of one letter": (
            "t[s];Y1_Soll[mm];Y1_Ist[mm];Y2_Soll[mm];Y2_Ist[mm];Y1_I[A];Y2_I[A]\n" + rows([TIME, soll, ist, soll, ist, amps, 0.9 * amps], ";"),
            {f"{axis}_{name}": f"{axis}.{signal}" for axis in ("Y1", "Y2") for name, signal in (("Soll", "setpoint"), ("Ist", "position"), ("I", "current"))},
        ),
    }  # fmt: skip


SCOPES = _scopes()


def test_the_milliseconds_of_a_robots_clock_are_no_date(tmp_path: Path) -> None:
    m = move(TIME)
    rows = [f"{4208163634 + 4 * i},{a:.4f},{b:.4f}" for i, (a, b) in enumerate(zip(m["soll"], m["ist"]))]
    (tmp_path / "robot.csv").write_text("IPOC,ASPos.A1,AIPos.A1\n" + "\n".join(rows) + "\n", encoding="utf-8")
    found = propose([read_recording(tmp_path / "robot.csv", ReadOptions(Clock(), None, tmp_path / "scratch"))])
    assert found.time is not None
    assert (found.time.column, found.time.unit) == ("IPOC", "ms")


@pytest.mark.parametrize("case", SCOPES)
def test_exports_of_scopes_of_drives(tmp_path: Path, case: str) -> None:
    text, expected = SCOPES[case]
    (tmp_path / "scope.txt").write_text(text + "\n", encoding="utf-8")
    found = propose([read_recording(tmp_path / "scope.txt", ReadOptions(Clock(), None, tmp_path / "scratch"))])
    assert {name: signal for name, signal in roles(found).items() if name in expected} == expected
    assert not any("velocity" in signal or "current" in signal for name, signal in roles(found).items() if name not in expected)
    assert found.time is None or found.time.known
    # what is proposed is imported: counts are no metres
    assert main(["import", str(tmp_path / "scope.txt"), "--out", str(tmp_path / "out"), "--no-picture"]) == 0


def test_what_a_unit_contradicts_is_not_proposed() -> None:
    m = move(TIME)
    made = {n: Signal(n, m[own], TIME, unit) for n, own, unit in (("Lageistwert", "ist", "mm"), ("Schleppfehler", "soll", "rev/min"))}
    assert set(roles(propose([Recording(Path("run.csv"), "CSV", made)])).values()) == {"X.position"}


def test_a_set_point_beside_an_encoder_of_the_motor_leads_it() -> None:
    """The encoder's name is known, the other column's is not: it is no second encoder that is 20 ms early."""
    m = move(TIME)
    found = propose([recording({"motor position": np.roll(m["soll"], 10), "Xyz": m["soll"], "strom": m["strom"]}, 2e-3)])
    assert roles(found)["Xyz"] == "X.setpoint"


def test_the_feedforward_in_use_follows_from_no_assumption() -> None:
    m = move(TIME)
    follows = m["soll"] + 1e-3 * np.sin(40.0 * TIME)
    columns = {
        "RPOS(0)": m["soll"],
        "FPOS(0)": follows,
        "FVEL(0)": np.gradient(follows, 2e-3),
        "RVEL(0)": np.diff(m["soll"], prepend=0.0) / 2e-3,
    }
    found = propose([recording(columns, 2e-3)])
    assert roles(found)["RVEL(0)"] == "0.velocity_feedforward"
    assert not found.feedforward


def test_a_clock_that_jitters_changes_no_travel() -> None:
    """Its steps are 5 ms as a rule and 5.3 ms on average: the slope of the rows would be 6 % too steep."""
    random = np.random.default_rng(1)
    time = np.round(np.cumsum(5e-3 + np.abs(random.normal(0.0, 4e-4, 1000)) + 5e-3 * (random.random(1000) < 0.02)), 3)
    m = move(time)
    columns = {"pos_cmd": m["soll"], "pos_act": m["ist"], "n_act": 6.0 * m["speed"]}
    units = {"n_act": "rev/min", "pos_cmd": "mm", "pos_act": "mm"}
    made = {n: Signal(n, v, time, units[n]) for n, v in columns.items()}
    [speed] = [c for c in propose([Recording(Path("run.csv"), "CSV", made)]).used if c.signal == "velocity"]
    assert float(speed.extra[0].removeprefix("mm_per_rev = ")) == pytest.approx(10.0, rel=0.01)


def test_the_travel_of_a_motor_turn_by_a_set_point_alone_is_assumed() -> None:
    """Regression: the axis lags behind it, and 9.85 mm of a screw of 10 mm counted as known."""
    m = move(TIME)
    units = {"pos_cmd": "mm", "n_act": "rev/min"}
    made = {n: Signal(n, v, TIME, units[n]) for n, v in {"pos_cmd": m["soll"], "n_act": 6.0 * m["speed"]}.items()}
    [speed] = [c for c in propose([Recording(Path("run.csv"), "CSV", made)]).used if c.signal == "velocity"]
    assert speed.assumed.startswith("travel of a motor turn by the slope of the set point")


def test_fields_of_messages_are_grouped_by_their_joint() -> None:
    m, slow = move(TIME), move(0.5 * TIME)
    columns = {
        f"/{place}/joint_{j}/position": one[name]
        for j, one in ((1, m), (2, slow))
        for place, name in (("states", "ist"), ("controller_state/reference", "soll"))
    }
    found = propose([recording(columns, 2e-3)])
    assert roles(found) == {name: f"{name.split('_')[-1][0]}.{'setpoint' if 'reference' in name else 'position'}" for name in columns}


def test_numbers_glued_to_names_tell_axes_apart() -> None:
    """As a message of joint states becomes columns. A single axis keeps the name of its own."""
    m, slow = move(TIME), move(0.5 * TIME)
    own = (("position", "ist"), ("velocity", "speed"), ("effort", "strom"))
    columns = {f"field.{quantity}{j}": 0.1 * one[name] for j, one in enumerate((m, slow)) for quantity, name in own}
    found = propose([recording(columns, 2e-3)])
    assert roles(found) == {f"field.{q}{j}": f"{j}.{'torque' if q == 'effort' else q}" for j in (0, 1) for q, _ in own}
    assert {*roles(propose([recording(dict(list(columns.items())[:3]), 2e-3)])).values()} == {"0.position", "0.velocity", "0.torque"}
    commanded = {
        f"{path}.position{j}": one[name] for j, one in enumerate((m, slow)) for path, name in (("reference", "soll"), ("state", "ist"))
    }
    found = propose([recording(commanded, 2e-3)])
    assert roles(found) == {n: f"{n[-1]}.{'setpoint' if n.startswith('ref') else 'position'}" for n in commanded}


def test_a_letter_of_current_beside_positions_is_one() -> None:
    m = move(TIME)
    found = propose([recording({"cmd": m["soll"], "act": m["ist"], "i": m["strom"]}, 2e-3)])
    assert roles(found)["i"] == "X.current"
    beside = propose([recording({"x_ref": 1e-3 * m["soll"], "x_meas": 1e-3 * m["ist"], "i_q": m["strom"]}, 2e-3)])
    assert {c.unit for c in beside.columns if c.signal == "position"} == {"mm"}  # the q names no joint


def test_a_position_without_a_name_is_measured() -> None:
    m = move(TIME)
    found = propose([recording({"CH1": m["ist"], "CH2": m["strom"]}, 2e-3)])
    assert roles(found)["CH1"] == "X.position"


def test_what_is_no_measurement_is_said_and_not_used() -> None:
    m = move(TIME)
    droop = np.clip(np.rint(4000.0 * (m["soll"] - m["ist"])), -32768.0, 20000.0)
    columns = {
        "Lagesollwert X": m["soll"], "Lageistwert X": m["ist"], "Schleppabstand X": droop, "Strom X": m["strom"],
        "Spannung X": 48.0 + 0.1 * np.sin(9.0 * TIME), "aux": np.repeat([0.0, 1.0], 1500), "n": np.arange(3000.0), "copy": m["soll"],
    }  # fmt: skip
    droop[:900] = -32768.0
    found = propose([recording(columns, 2e-3)])
    assert set(roles(found).values()) == {"X.setpoint", "X.position", "X.current"}
    doubts = {c.name: c.doubt for c in found.columns if c.doubt}
    assert "end of its counter" in doubts["Schleppabstand X"] or "position itself" in doubts["Schleppabstand X"]
    assert "a supply" in doubts["Spannung X"]
    assert found.unknown["aux"] == "a switch"
    assert "counts" in found.unknown["n"]
    assert "Lagesollwert X" in found.unknown["copy"]


def test_counts_and_signs_in_a_bit() -> None:
    x = 500.0 * np.sin(1.3 * TIME)
    s = np.rint(2048.0 + x)
    speed = np.rint(np.gradient(x, 2e-3))
    columns = {"target pos (1)": s, "pos (1)": np.rint(2048.0 + np.roll(x, 5)), "speed (1)": np.where(speed < 0, 32768.0 - speed, speed)}
    found = propose([recording(columns, 2e-3)])
    by_name = {c.name: c for c in found.used}
    assert "sign_bit = 15" in by_name["speed (1)"].extra
    assert {c.unit for c in found.used} == {"deg", "deg/s"}
    assert any("counts, taken as 4096 a turn" in question for question in found.questions)


@pytest.mark.parametrize(("unit", "step"), [("ms", 2.0), ("s", 2e-3), ("us", 2000.0)])
def test_the_recorded_speed_decides_the_unit_of_time(unit: str, step: float) -> None:
    m = move(TIME)
    source = TimeSource("time", "ms" if step >= 0.5 else "s", assumed=True, text="nothing states the unit")
    read = step * (1e-3 if step >= 0.5 else 1.0)
    columns = {"Lagesollwert X": m["soll"], "Lageistwert X": m["ist"], "Drehzahlistwert X": m["speed"]}
    found = propose([recording(columns, read, source)])
    assert found.time is not None
    assert found.time.unit == unit
    assert unit_of(found, "Drehzahlistwert X") == "mm/s"


def imported(tmp_path: Path, file: Path, *more: str) -> MeasuredRun:
    assert main(["import", str(file), "--out", str(tmp_path / "out"), "--no-picture", *more]) == 0
    return read_campaign(tmp_path / "out").runs[0]


def test_a_partial_map_is_completed(tmp_path: Path) -> None:
    m = move(TIME)
    file = write_csv(tmp_path / "run.csv", {"t": TIME, "a": m["soll"], "b": m["ist"], "c": m["speed"], "d": m["strom"]})
    partial = tmp_path / "partial.toml"
    partial.write_text('[[column]]\nname = "b"\naxis = "Y"\nsignal = "position"\nunit = "mm"\n', encoding="utf-8")
    run = imported(tmp_path, file, "--map", str(partial))
    assert set(run.trace.signals) == {("Y", s) for s in ("setpoint", "position", "velocity", "current")}
    assert np.allclose(run.trace.get("Y", "setpoint") * 1e3, m["soll"])
    partial.write_text('[time]\ncolumn = "t"\n', encoding="utf-8")
    assert imported(tmp_path / "again", file, "--map", str(partial)).trace.axes == ("X",)


def test_without_a_set_point_there_is_still_an_answer(tmp_path: Path) -> None:
    m = move(TIME)
    lag = imported(
        tmp_path / "a", write_csv(tmp_path / "a.csv", {"t": TIME, "actual_position": m["ist"], "position_error": m["soll"] - m["ist"]})
    )
    assert lag.fact("X", "setpoint").made_from == "following_error"
    assert np.allclose(lag.trace.get("X", "setpoint") * 1e3, m["soll"])
    path = imported(tmp_path / "b", write_csv(tmp_path / "b.csv", {"t": TIME, "actual_position": m["ist"], "current": m["strom"]}))
    assert path.fact("X", "setpoint").made_from == "position"
    speed = imported(tmp_path / "c", write_csv(tmp_path / "c.csv", {"t": TIME, "actual_speed_mm_s": m["speed"], "current": m["strom"]}))
    assert speed.fact("X", "setpoint").made_from == speed.fact("X", "motor_position").made_from == "velocity"
    travelled = speed.trace.get("X", "motor_position") * 1e3
    assert np.abs(travelled - (m["ist"] - m["ist"][0])).max() < 1e-3 * np.ptp(m["ist"])
    assert force_sign(speed.trace.get("X", "current"), speed.trace.get("X", "motor_position"), 2e-3, "linear").sign == 1


def test_a_map_of_the_user_is_checked_against_the_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    m = move(TIME)
    step = 2.0 * np.pi / 10000.0
    place = np.round(np.rint(m["ist"] / step) * step, 6)
    file = write_csv(tmp_path / "run.csv", {"t": TIME, "s": m["soll"], "x": place, "i": -m["strom"], "extra": m["speed"]})
    rows = [("s", "setpoint", "mm"), ("x", "position", "mm"), ("i", "current", "A")]
    (tmp_path / "map.toml").write_text(
        "\n".join(f'[[column]]\nname = "{n}"\naxis = "X"\nsignal = "{s}"\nunit = "{u}"' for n, s, u in rows), encoding="utf-8"
    )
    run = imported(tmp_path, file, "--map", str(tmp_path / "map.toml"))
    said = capsys.readouterr().out
    assert run.fact("X", "current").against
    for words in ("X.current pushes against the motion", "its steps are 1/10000 of a turn in rad", "not in the map: extra"):
        assert words in said


def test_a_speed_that_is_a_difference_of_positions_is_not_shifted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    m = move(TIME)
    speed = np.zeros(len(TIME))
    speed[4:] = (m["ist"][4:] - m["ist"][:-4]) / 8e-3
    table = {"t": TIME, "Lagesollwert X": m["soll"], "Lageistwert X": m["ist"], "Drehzahlistwert X": speed}
    run = imported(tmp_path, write_csv(tmp_path / "run.csv", table))
    assert "a difference of positions over 4 samples" in capsys.readouterr().out
    assert run.fact("X", "velocity").taken_back == 0.0
    assert np.allclose(run.trace.get("X", "velocity") * 1e3, speed)
    rough, sure = (Skew("X", "velocity", 0.27e-3, deviation) for deviation in (2e-5, 2e-6))
    assert (rough.differenced(6e-4), sure.differenced(6e-4)) == (1, 0)  # 0.27 ms +- 0.08 ms may be half a sample


def test_without_out_it_prints_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    m = move(TIME)
    file = write_csv(tmp_path / "run.csv", {"f1": m["soll"], "f2": m["ist"], "f3": m["strom"]})
    assert main(["import", str(file)]) == 0
    table = capsys.readouterr().out.partition("# proposed by")[0]
    assert "X.setpoint" in table
    assert "--interval-ms" in table
    assert max(map(len, table.splitlines()[1:])) <= 100
    assert [p.name for p in tmp_path.iterdir()] == ["run.csv"]
    assert main(["import", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "--interval-ms" in capsys.readouterr().err


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_column_with_an_impossible_value_is_said_without_a_warning(value: float) -> None:
    """The first value is no number of a machine, in the column of a position, of a time without a name, and in all of them."""
    columns = move(TIME)
    for spoilt in (("ist",), ("strom", "speed"), tuple(columns)):
        made = {name: np.where(np.arange(len(v)) < 2, value, v) if name in spoilt else v for name, v in columns.items()}
        with np.errstate(all="raise"):
            found = propose([recording(made), recording(made, 2e-3)])
        said = [*found.left_out, *found.unknown.values(), *(c.doubt for c in found.columns)]
        assert any("at sample 1: repair it" in text for text in said)
        assert not any("nan" in text for text in said)


def test_a_lag_is_found_wherever_the_record_begins_and_ends() -> None:
    """A correlation that stops with the record prefers no lag where the record begins or ends far from its mean."""
    there = -np.cos(np.linspace(0.0, 2.0 * np.pi, 1500))
    for lag in (0, 1, 11, 90, -40):
        late = there[np.clip(np.arange(len(there)) - lag, 0, len(there) - 1)]
        assert follows(late, there).lag == pytest.approx(lag, abs=1e-6)


def test_a_deviation_beside_the_speed_of_the_profile_gives_set_point_and_position(tmp_path: Path) -> None:
    """As drives record it: both speeds in rev/min, the deviation in counts of 65536 a turn, the torque in per cent of its rating."""
    period, lag, counts = 1e-3, 0.025, 65536
    t = np.arange(3000) * period
    setpoint = 4.0 * (1.0 - np.cos(4.0 * t)) * np.minimum(t, 1.0)  # turns
    motor = np.interp(t - lag, t, setpoint)
    speed = np.gradient(motor, period)
    force = 20.0 * np.sign(speed) * (np.abs(speed) > 1e-3) + 0.3 * np.gradient(speed, period)
    columns = (
        t * 1e3,
        np.round(60.0 * np.gradient(setpoint, period)),
        np.round(60.0 * speed),
        np.round(counts * (setpoint - motor)),
        np.round(force),
    )
    heading = '"Time[ms]","Position Reference Speed[min-1]","Feedback Speed[min-1]","Position Error Amount[reference unit]","Torque Reference[%]"\n'
    file = tmp_path / "run.csv"
    file.write_text(heading + "".join(",".join(f"{v:g}" for v in row) + "\n" for row in zip(*columns)), encoding="utf-8")
    assert main(["import", str(file), "--out", str(tmp_path / "campaign")]) == 0
    run = read_campaign(tmp_path / "campaign").runs[0]
    assert run.fact("X", "setpoint").made_from == "velocity_feedforward"
    assert run.trace.has("X", "torque")
    assert not run.trace.has("X", "current")
    read, error = run.trace.get("X", "setpoint"), run.trace.get("X", "setpoint") - run.trace.get("X", "position")
    turns = 2.0 * np.pi
    assert np.abs(read - read[0] - turns * setpoint).max() < 2e-3 * turns * np.ptp(setpoint)
    assert np.abs(error - turns * (setpoint - motor)).max() < turns / counts
    text = (tmp_path / "campaign" / "map.toml").read_text(encoding="utf-8")
    assert "scale = 0.00549316" in text
    assert text.count("unit_assumed") == 1  # of the torque


def slide(rows: int = 400) -> tuple[Array, Array, Array]:
    """Position, speed and current of an axis that goes there and back, every 2 ms."""
    t = np.arange(rows) * 2e-3
    x = 40.0 * np.sin(2.0 * np.pi * t / 0.8) ** 3
    v = np.gradient(x, 2e-3)
    return x, v, 1e-4 * np.gradient(v, 2e-3) + 0.4 * np.tanh(v) + 1e-3 * v


def test_the_type_of_a_variable_before_its_name_is_no_part_of_it() -> None:
    x, v, i = slide()
    found = propose([recording({"fSetPos": x, "fActPos": np.roll(x, 2), "fActVelo": v, "fActTorque": np.rint(1000.0 * i)}, 2e-3)])
    assert roles(found)["fActTorque"] == "X.torque"  # whole numbers alone would make it a current in mA


def test_set_and_actual_positions_of_a_robot_sensor_interface() -> None:
    x, *_ = slide()
    y = 0.5 * np.cumsum(x)
    found = propose(
        [recording({"X_RIst": np.roll(y, 3), "Y_RIst": np.roll(x, 3), "X_RSol": y, "Y_RSol": x, "MotorAmps": 12.0 + 0.0 * x}, 2e-3)]
    )
    assert roles(found) == {"X_RSol": "X.setpoint", "X_RIst": "X.position", "Y_RSol": "Y.setpoint", "Y_RIst": "Y.position"}


def test_an_angle_is_no_length() -> None:
    x, *_ = slide()
    found = propose([recording({"command_angle": 90.0 + x, "feedback_angle": 90.0 + np.roll(x, 3)}, 2e-3)])
    assert {c.unit for c in found.used} == {"deg"}
    found = propose([recording({"Winkel Soll": 0.01 * x, "Winkel Ist": 0.01 * np.roll(x, 3)}, 2e-3)])
    assert {c.unit for c in found.used} == {"rad"}


def test_an_axis_that_steps_to_a_constant_set_point_moves() -> None:
    t = np.arange(300) * 2e-3
    x = 180.0 * (1.0 - np.exp(-t / 0.1))
    found = propose([recording({"Target Pos": np.full(300, 180.0), "Position": x, "Velocity": np.gradient(x, 2e-3)}, 2e-3)])
    assert roles(found) == {"Position": "X.position", "Velocity": "X.velocity"}
    held = 180.0 + 1e-3 * np.random.default_rng(1).standard_normal(300)
    found = propose([recording({"Target Pos": np.full(300, 180.0), "Position": held}, 2e-3)])
    assert not found.used
    assert "does not move" in found.left_out[0]


def test_a_speed_without_unit_that_is_no_slope_of_the_position_gets_none() -> None:
    t = np.arange(300) * 2e-3
    x = 5.0 * (1.0 - np.exp(-np.maximum(t - 0.1, 0.0) / 0.08))
    found = propose([recording({"position": x, "velocity": np.where(t < 0.1, -9.0, -18.0) - 4.0 * np.gradient(x, 2e-3)}, 2e-3)])
    assert roles(found) == {"position": "X.position"}
    x, v, _ = slide()
    found = propose([recording({"position": x, "velocity": 0.099 * v}, 2e-3)])
    assert any("no usual unit" in q for q in found.questions)  # 606 mm a turn


def test_an_error_that_changes_farther_than_the_position_is_no_following_error() -> None:
    x, *_ = slide()
    found = propose([recording({"position": x, "position error": 300.0 * np.sin(np.arange(len(x)))}, 2e-3)])
    assert roles(found) == {"position": "X.position"}


def test_columns_named_by_joints_alone_are_their_positions() -> None:
    x, v, i = slide()
    found = propose([recording({"lbr_joint_0": 0.02 * x, "lbr_joint_1": 1e-3 * v, "lbr_joint_2": 0.5 * i}, 2e-3)])
    assert roles(found) == {f"lbr_joint_{k}": f"{k}.position" for k in range(3)}
    assert any("named by its axis alone" in q for q in found.questions)
    t = np.arange(2000) * 2e-3
    circle = {"X": 50.0 * np.cos(5.0 * t), "Y": 50.0 * np.sin(5.0 * t)}
    assert roles(propose([recording(circle, 2e-3)])) == {"X": "X.position", "Y": "Y.position"}  # no speed of the other one
    noise = np.random.default_rng(4).standard_normal((2, 2000))
    assert not propose([recording({"X": noise[0], "Y": noise[1]}, 2e-3)]).used
    pair = propose([recording({"U": circle["X"], "V": circle["Y"]}, 2e-3)])  # may be phases
    assert not {"X.setpoint", "U.position", "V.position"} & {*roles(pair).values()}


def test_a_position_in_a_unit_is_no_time() -> None:
    even = np.arange(200) * 5.0
    found = propose([Recording(Path("run.csv"), "CSV", {"phase": Signal("phase", even, even, "deg"), "effect": Signal("effect", np.sin(even), even)}, source=TimeSource(known=False))])  # fmt: skip
    assert found.time is not None
    assert not found.time.known


def test_a_unit_in_the_name_of_a_joint() -> None:
    x, v, _ = slide()
    found = propose([recording({"x_m": 1e-3 * x, "j1_rad": 0.02 * x, "j2_rad": 1e-4 * v, "cpu_percent": v}, 2e-3)])
    assert roles(found) == {"x_m": "X.position", "j1_rad": "1.position", "j2_rad": "2.position"}
    assert unit_of(found, "x_m") == "m"


def test_an_effort_is_of_a_message_in_si_units() -> None:
    x, v, i = slide()
    found = propose([recording({"position": 0.05 * x, "velocity": 0.05 * v, "effort": i}, 2e-3)])
    assert [unit_of(found, name) for name in ("position", "velocity", "effort")] == ["rad", "rad/s", "Nm"]


def test_an_error_from_a_constant_set_point_gives_no_path() -> None:
    t = np.arange(300) * 2e-3
    x = 180.0 * (1.0 - np.exp(-t / 0.1))
    found = propose([recording({"Position": x, "Position Error": 180.0 - x}, 2e-3)])
    assert roles(found) == {"Position": "X.position"}


def test_a_simple_course_is_no_current_and_what_is_left_to_a_target_no_signal() -> None:
    t = np.arange(160) / 157.0
    sines = {f"column {k}": c + 0.1 * np.sin(4.0 * t - p) for k, c, p in ((2, 0.26, 1.2), (3, 0.71, 2.6), (4, 0.9, 2.5))}
    assert not {"X.current", "X.torque", "X.voltage"} & {*roles(propose([recording(sines, 6.37e-3)])).values()}
    x, v, _ = slide()
    found = propose([recording({"a": x, "b": v, "d": 1.0 - x, "e": -v}, 2e-3)])
    assert roles(found) == {"a": "X.position", "b": "X.velocity"}


def test_the_unit_behind_the_name_of_a_joint_with_words(tmp_path: Path) -> None:
    path = tmp_path / "joints.csv"
    x, *_ = slide()
    lines = [
        f"{2e-3 * k:.3f}|{joint}|{0.01 * x[k] * way:.8f}|{x[k] * way:.4f}"
        for k in range(len(x))
        for joint, way in (("shoulder_pan_joint", 1), ("elbow_joint", -2))
    ]
    path.write_text("timestamp|joint_name|position_rad|torque_Nm\n" + "\n".join(lines) + "\n")
    found = propose([read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))])
    assert roles(found)["elbow_joint position_rad"] == "elbow.position"
    assert unit_of(found, "elbow_joint position_rad") == "rad"


def test_several_joints_without_names_and_set_points() -> None:
    """Positions, then speeds, then currents of three joints, as a robot's client writes them."""
    t = np.arange(1500) * 8e-3
    rng = np.random.default_rng(5)
    q = [
        sum(a * np.sin(w * t + p) for a, w, p in zip(rng.uniform(0.02, 0.1, 5), 1.6 * np.arange(1, 6), rng.uniform(0.0, 6.0, 5)))
        for _ in range(3)
    ]
    v = [np.gradient(own, 8e-3) for own in q]
    i = [np.gradient(own, 8e-3) + 0.8 * np.tanh(40.0 * own) + 0.5 * own + rng.normal(0.0, 0.02, len(t)) for own in v]
    found = propose([recording({f"column {k + 2}": column for k, column in enumerate([*q, *v, *i])}, 8e-3)])
    axes = {c.name: c.axis for c in found.used}
    assert {name: r.split(".")[1] for name, r in roles(found).items()} == {
        f"column {k + 2}": ("position", "velocity", "current")[k // 3] for k in range(9)
    }
    assert all(axes[f"column {k}"] == axes[f"column {k + 3}"] == axes[f"column {k + 6}"] for k in (2, 3, 4))


def test_roles_by_numbers_alone_are_asked() -> None:
    x, v, i = slide()
    assert any("by their numbers alone" in q for q in propose([recording({"a": x, "b": v, "c": i}, 2e-3)]).questions)
    assert not any("by their numbers alone" in q for q in propose([recording({"position": x, "b": v, "c": i}, 2e-3)]).questions)


def test_a_column_named_after_another_quantity_is_no_position() -> None:
    """Two wheels that are asked for one speed: a word too many makes the name unknown, and still it says that this is a speed."""
    x, v, i = slide()
    wheels = {"targetSpeed": np.full(len(v), 200.0), "leftSpeed": x, "rightSpeed": x + 0.01 * v, "leftCommand": i}
    found = propose([recording(wheels, 2e-3)])
    assert not {role.split(".")[1] for role in roles(found).values()} & {"setpoint", "position", "motor_position"}
    found = propose([recording({"wheelSpeed": x, "b": v, "c": i}, 2e-3)])
    assert "wheelSpeed" not in roles(found) or roles(found)["wheelSpeed"].endswith("velocity")


def test_what_a_controller_gives_is_asked_where_only_numbers_say_of_which_quantity() -> None:
    x, v, i = slide()
    asked = {name: propose([recording({"position": x, "b": v, name: i}, 2e-3)]) for name in ("pid.x.output", "c")}
    assert all(roles(found)[name] == "X.current" for name, found in asked.items())
    assert {name: any("may be a speed" in q for q in found.questions) for name, found in asked.items()} == {
        "pid.x.output": True,
        "c": False,
    }


def test_the_output_of_a_controller_at_which_the_axis_moves_is_a_speed() -> None:
    """A law of speed and acceleration explains it as well as a force, but no force is by chance the speed in mm/s."""
    m = move(TIME)
    output = np.gradient(m["ist"] + 4e-4 * m["speed"], TIME)  # a drive with a lag, and an integral part that leaves hardly an error
    asked = m["ist"] + 0.03 * np.random.default_rng(3).standard_normal(len(TIME))  # set points of another task
    found = propose([recording({"motor-pos-cmd": asked, "motor-pos-fb": m["ist"], "pid.x.output": output}, 2e-3)])
    assert roles(found)["pid.x.output"] == "X.velocity_setpoint"


def test_the_speed_of_a_motor_without_a_unit_is_asked() -> None:
    """Ten degrees a second as 1, beside degrees: nothing says that 10 mm are a turn."""
    x, v, _ = slide()
    found = propose([recording({"position": x, "velocity": 0.1 * v}, 2e-3)])
    assert any("rev/s of a motor" in q for q in found.questions)


@pytest.mark.parametrize(("turns_per_s", "odd"), [(100.0, False), (1000.0, True)])
def test_a_motor_without_a_gear_may_turn_fast(turns_per_s: float, odd: bool) -> None:
    angle = 2.0 * np.pi * turns_per_s * 0.1 * np.sin(10.0 * TIME)
    assert any("wrong unit" in d.text for d in doubts_of({("X", "setpoint"): angle}, 2e-3, {"X": "rotary"}, None)) == odd


def test_accelerations_of_a_sensor_make_no_axes() -> None:
    t = np.arange(400) * 2.5e-2
    speed = 1500.0 * np.sin(t) ** 3
    noise = np.random.default_rng(6).standard_normal((3, 400))
    columns = {f"Acc{axis} (g)": own for axis, own in zip("XYZ", noise)}
    found = propose([recording({**columns, "Motor Speed": speed, "Current": 1e-3 * speed + 0.4 * np.tanh(speed)}, 2.5e-2)])
    assert roles(found) == {"Motor Speed": "X.velocity", "Current": "X.current"}


def test_counts_of_one_encoder_beside_the_length_of_another(tmp_path: Path) -> None:
    """Set point and motor encoder of a drive in pulses, of a screw of 12 mm with 8 um of play and 2^22 pulses a turn, and the scale in 0.1 um: this shows the pulses."""
    m, pulses = move(TIME), 2.0**22 / 12.0
    table = {
        "Time (ms)": TIME * 1e3,
        "Command position (pulse)": np.rint(m["soll"] * pulses),
        "Feedback position, motor (pulse)": np.rint(m["ist"] * pulses),
        "Feedback position, load side (0.1 um)": np.rint((m["ist"] - 4e-3 * np.sign(m["speed"])) * 1e4),
        "Motor speed (r/min)": np.round(m["speed"] / 12.0 * 60.0, 2),
    }
    assert main(["import", str(write_csv(tmp_path / "run.csv", table)), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    trace = read_campaign(tmp_path / "out").runs[0].trace
    for signal, column in (("setpoint", "soll"), ("motor_position", "ist"), ("position", "ist")):
        assert np.abs(trace.get("X", signal) * 1e3 - m[column][: len(trace.time)]).max() < 1e-2, signal
    assert f"scale = {12.0 / 2.0**22:.9g}\n" in (tmp_path / "out" / "map.toml").read_text(encoding="utf-8")


def test_a_number_of_a_parameter_ends_with_a_comma() -> None:
    """As IndraWorks writes them: read by its numbers alone, the torque would be a current."""
    names = (
        "S-0-0047, Lage-Sollwert",
        "S-0-0053, Lage-Istwert Geber 2",
        "S-0-0080, Drehmoment/Kraft-Sollwert",
        "Feedback position, load side",
    )
    found = [meaning_of(name) for name in names]
    assert [m and m.signal for m in found] == ["setpoint", "position", "torque_setpoint", "position"]


@pytest.mark.parametrize(("slope", "travel"), [(15.9998, 16.0), (10.0001, 10.0), (15.97, 15.97)])
def test_a_lead_has_few_digits(slope: float, travel: float) -> None:
    assert as_made(slope) == travel
