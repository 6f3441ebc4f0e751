"""Effects between motor and load: reversal, resonance, lead."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import chirp

from tests.builders.one_axis import MACHINE, NO_COULOMB, TICK, axis_of, follow, steady, there_and_back
from twin.effects import apply_effects, load_inertia, with_effects
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

AXES = ("X", "Y", "A", "C")


def motor_minus_scale(trace, axis):
    return trace.get(axis, "motor_position") - trace.get(axis, "position")


def reduced_mass(axis):
    load, rotor = load_inertia(MACHINE, axis_of(axis)), axis_of(axis).reflected_inertia
    return load * rotor / (load + rotor)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("stiffness_hz", [None, 300.0])
def test_backlash(axis, stiffness_hz):
    """A slow reversal shows clearance + 2 Fc / contact_stiffness between motor and scale; 450 Hz on the reduced mass if not given."""
    stiffness = (2 * math.pi * (stiffness_hz or 450.0)) ** 2 * reduced_mass(axis)
    friction = axis_of(axis).coulomb_friction
    effect = {"name": "backlash", "clearance": 15e-6} | ({"contact_stiffness": stiffness} if stiffness_hz else {})
    speed, tilt = 0.001, -0.3 if axis == "A" else 0.0
    move = there_and_back(1e-3, speed, 0.5, 50.0)
    # A is held where its gravity torque is zero, so that no flank is loaded
    if axis == "A":
        tilt = balanced_tilt()
    trace = follow(axis, tilt + move, [effect])
    gap = motor_minus_scale(trace, axis)
    velocity = np.gradient(trace.get(axis, "position"), TICK)
    forth = gap[(velocity > 0.98 * speed) & (trace.time < trace.time[-1] / 2)]
    back = gap[(velocity < -0.98 * speed) & (trace.time > trace.time[-1] / 2)]
    # sliding at 1 mm/s the load also has viscous friction, at both ends of the difference
    expected = 15e-6 + 2 * (friction + axis_of(axis).viscous_friction * speed) / stiffness
    assert np.median(forth) - np.median(back) == pytest.approx(expected, rel=0.01)


def balanced_tilt():
    """The tilt of A at which its holding current is zero."""
    angles = np.linspace(-1.2, 0.4, 17)
    held = [follow("A", np.full(4, angle)).get("A", "current")[0] for angle in angles]
    return float(np.interp(0.0, *zip(*sorted(zip(held, angles)))))


def test_backlash_is_not_visible_if_gravity_keeps_one_flank_loaded():
    """On Z the load stays on its lower flank in both directions; only the spring deflects."""
    stiffness = (2 * math.pi * 450.0) ** 2 * reduced_mass("Z")
    trace = follow("Z", there_and_back(1e-3, 0.001, 0.5, 50.0), [{"name": "backlash", "clearance": 15e-6}])
    gap = motor_minus_scale(trace, "Z")
    assert gap.min() > 7.5e-6
    assert np.ptp(gap) < 2.5 * axis_of("Z").coulomb_friction / stiffness


def chirped(axis, effects, low, high, seconds=4.0):
    """Transfer function from the force on the rotor to its speed, and from its position to the load's, over frequency [Hz]."""
    t = np.arange(round(seconds / 1e-3) + 1) * 1e-3
    amplitude = 2e-5 if axis_of(axis).kind == "linear" else 2e-4
    fade = np.clip(np.minimum(t, t[-1] - 0.3 - t) / 0.2, 0.0, 1.0)
    trace = follow(
        axis,
        amplitude * fade * chirp(t, low, t[-1], high),
        [NO_COULOMB, *effects, {"name": "position_gain", "factor": 0.3}],
        feedforward="velocity",
    )
    # torque of a tick acts between two samples of the speed; no noise and no friction: one record is enough
    torque, speed, q, p = (trace.get(axis, s) for s in ("torque", "velocity", "position", "motor_position"))
    spectra = [np.fft.rfft(s) for s in ((torque[1:] + torque[:-1]) / 2, np.diff(speed) / TICK, q[1:], p[1:])]
    hz = np.fft.rfftfreq(len(torque) - 1, TICK)
    band = (hz > low * 1.1) & (hz < high * 0.9)
    return hz[band], np.abs(spectra[1] / spectra[0])[band], np.abs(spectra[2] / spectra[3])[band]


@pytest.mark.parametrize("axis", ["X", "C"])
@pytest.mark.parametrize("mode_hz", [35.0, 75.0])
def test_transmission_compliance(axis, mode_hz):
    """The motor has an antiresonance at sqrt(k / load) / 2 pi and a resonance at sqrt(k / reduced) / 2 pi."""
    load = load_inertia(MACHINE, axis_of(axis))
    stiffness = (2 * math.pi * mode_hz) ** 2 * load
    damping = 2 * 0.02 * math.sqrt(stiffness * reduced_mass(axis))
    hz, motor, ratio = chirped(axis, [{"name": "transmission_compliance", "stiffness": stiffness, "damping": damping}], 15.0, 240.0)
    resonance = math.sqrt(stiffness / reduced_mass(axis)) / (2 * math.pi)
    assert hz[np.argmin(motor)] == pytest.approx(mode_hz, rel=0.02)
    near = (hz > 0.7 * resonance) & (hz < 1.4 * resonance)
    assert hz[near][np.argmax(motor[near])] == pytest.approx(resonance, rel=0.02)
    assert hz[np.argmax(ratio)] == pytest.approx(mode_hz, rel=0.02)


@pytest.mark.parametrize("axis", ["X", "C"])
def test_transmission_compliance_damps(axis):
    """Load over motor: (k + j w c) / (k - w^2 m + j w (c + b)) at every frequency, peak included."""
    load, b = load_inertia(MACHINE, axis_of(axis)), axis_of(axis).viscous_friction
    k = (2 * math.pi * 50.0) ** 2 * load
    c = 2 * 0.1 * math.sqrt(k * load)
    hz, _, ratio = chirped(axis, [{"name": "transmission_compliance", "stiffness": k, "damping": c}], 15.0, 120.0)
    w = 2 * np.pi * hz
    expected = np.abs((k + 1j * w * c) / (k - w**2 * load + 1j * w * (c + b)))
    assert np.abs(ratio / expected - 1.0).max() < 0.02


def test_default_damping():
    """Contact: ratio 0.3 on the reduced mass at 450 Hz; the damper is weakened by what a tick would damp too much."""
    change = apply_effects(with_effects(MACHINE.with_axes(["X"]), [{"name": "backlash", "axis": "X", "clearance": 1e-5}]))
    half, k, c = change.terms[-1].parameters
    w, reduced = 2 * math.pi * 450.0, reduced_mass("X")
    rate = 2 * 0.3 * w * TICK
    assert half == 0.5e-5
    assert k == pytest.approx(w**2 * reduced, rel=1e-9)
    assert c == pytest.approx(2 * 0.3 * w * reduced * -math.expm1(-rate) / rate, rel=1e-9)


def test_transmission_compliance_deflects_under_weight_friction_and_acceleration():
    """At rest on Z by m g / k, at constant speed on X by (Fc + b v) / k, accelerating by M a / k more."""
    z, x = axis_of("Z"), axis_of("X")
    held = follow("Z", np.zeros(40), [{"name": "transmission_compliance", "stiffness": 5e7}])
    assert motor_minus_scale(held, "Z") == pytest.approx(np.full(len(held.time), z.moving_mass_kg * 9.81 / 5e7), rel=1e-6)
    moved = follow("X", steady(0.05, 0.6), [{"name": "transmission_compliance", "stiffness": 5e7}])
    expected = (x.coulomb_friction + x.viscous_friction * 0.05) / 5e7
    assert motor_minus_scale(moved, "X")[-321:].mean() == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("extra", [[], [{"name": "stribeck", "excess": 300.0, "velocity": 1.0}]])
def test_friction_at_the_motor_does_not_deflect_the_drive_train(extra):
    """`friction_side = "motor"`: the same current at constant speed as with friction on the load, and no deflection but that of acceleration."""
    x = axis_of("X")
    effects = [{"name": "transmission_compliance", "stiffness": 5e7, "axis": "X"}, *({**e, "axis": "X"} for e in extra)]
    traces = {
        side: simulate(
            with_effects(MACHINE.with_axes(["X"]).with_axis("X", friction_side=side), effects),
            Setpoints(steady(0.05, 0.6)[:, None], 1e-3),
            sample_period=TICK,
        ).trace
        for side in ("load", "motor")
    }
    friction = x.coulomb_friction + x.viscous_friction * 0.05 + sum(e["excess"] for e in extra)  # below this velocity of Stribeck
    assert motor_minus_scale(traces["load"], "X")[-321:].mean() == pytest.approx(friction / 5e7, rel=5e-3)
    assert abs(motor_minus_scale(traces["motor"], "X")[-321:].mean()) < 0.005 * friction / 5e7
    currents = [trace.get("X", "current")[-321:].mean() for trace in traces.values()]
    assert currents[1] == pytest.approx(currents[0], rel=1e-3)
    frictions = [trace.get("X", "torque_friction")[-321:].mean() for trace in traces.values()]
    assert frictions[1] == pytest.approx(frictions[0], rel=1e-3)


@pytest.mark.parametrize("side", ["load", "motor"])
@pytest.mark.parametrize(
    "extra", [{}, {"name": "stribeck", "excess": 300.0, "velocity": 1.0}, {"name": "presliding", "stiffness": 1e8}], ids=str
)
def test_a_share_of_friction_acts_on_the_other_side_of_the_drive_train(side, extra):
    """The load's part deflects the spring at constant speed; effects of friction act on `friction_side`, and the sum is the same without a share."""
    x = axis_of("X")
    effects = [{"name": "transmission_compliance", "stiffness": 5e7, "axis": "X"}, *([{**extra, "axis": "X"}] if extra else [])]
    traces = {
        share: simulate(
            with_effects(MACHINE.with_axes(["X"]).with_axis("X", friction_side=side, other_side_friction=share), effects),
            Setpoints(steady(0.05, 0.6)[:, None], 1e-3),
            sample_period=TICK,
        ).trace
        for share in (0.0, 0.3)
    }
    nominal, excess = x.coulomb_friction + x.viscous_friction * 0.05, extra.get("excess", 0.0)
    on_load = 0.7 * nominal + excess if side == "load" else 0.3 * nominal
    assert motor_minus_scale(traces[0.3], "X")[-321:].mean() == pytest.approx(on_load / 5e7, rel=1e-2)
    for signal in ("current", "torque_friction"):
        whole, shared = (trace.get("X", signal)[-321:].mean() for trace in traces.values())
        assert shared == pytest.approx(whole, rel=2e-3), signal


def test_without_a_spring_the_side_of_friction_changes_nothing():
    moved = [
        simulate(
            MACHINE.with_axes(["X"]).with_axis("X", friction_side=side, other_side_friction=share),
            Setpoints(steady(0.05, 0.2)[:, None], 1e-3),
        ).trace
        for side, share in (("load", 0.0), ("motor", 0.0), ("load", 0.4))
    ]
    assert all(np.array_equal(moved[0].get("X", "current"), other.get("X", "current")) for other in moved[1:])


def test_compliance_and_backlash_together_are_springs_in_series():
    """clearance + 2 Fc (1 / k + 1 / k_c) at a slow reversal."""
    k, k_c = 6e7, 3e8
    effects = [{"name": "transmission_compliance", "stiffness": k}, {"name": "backlash", "clearance": 15e-6, "contact_stiffness": k_c}]
    for order in (effects, effects[::-1]):
        trace = follow("X", there_and_back(1e-3, 1e-3, 0.5, 50.0), order)
        gap, velocity = motor_minus_scale(trace, "X"), np.gradient(trace.get("X", "position"), TICK)
        late = trace.time > trace.time[-1] / 2
        shown = np.median(gap[(velocity > 9e-4) & ~late]) - np.median(gap[(velocity < -9e-4) & late])
        expected = 15e-6 + 2 * (axis_of("X").coulomb_friction + axis_of("X").viscous_friction * 1e-3) * (1 / k + 1 / k_c)
        assert shown == pytest.approx(expected, rel=0.02)


def test_lead_error():
    """Motor position = q0 + (q - q0)(1 - fraction); its speed follows."""
    start = 0.1
    trace = follow("X", start + there_and_back(0.02, 0.1), [{"name": "lead_error", "fraction": 60e-6}])
    q = trace.get("X", "position")
    assert np.abs(trace.get("X", "motor_position") - (start + (q - start) * (1 - 60e-6))).max() < 1e-15
    check_motor_speed(trace, "X")


def test_cyclic_error():
    """Motor position = q - amplitude (sin(q / r + phase) - sin(q0 / r + phase)); its speed follows and shakes the motor."""
    r, start = axis_of("X").ratio, 0.1003
    trace = follow("X", start + there_and_back(0.02, 0.1), [{"name": "cyclic_error", "amplitude": 5e-6, "phase_rad": 0.7}])
    q = trace.get("X", "position")
    expected = q - 5e-6 * (np.sin(q / r + 0.7) - math.sin(start / r + 0.7))
    assert np.abs(trace.get("X", "motor_position") - expected).max() < 1e-15
    check_motor_speed(trace, "X")


@pytest.mark.parametrize("axis", AXES)
def test_response_of_a_rotor_on_a_spring_to_a_transmission_error(axis):
    """At constant speed, M = rotor + load, b viscous friction, G the drive from motor speed to acceleration: the response of a rigid drive train is
    q / e = G s / (s^2 + b/M s + G (s + Kv)), that of a rotor on a spring (G s + share s^2) / (the same), share = rotor / M. G comes from the rigid one."""
    r, amplitude, kv = axis_of(axis).ratio, 2e-6, axis_of(axis).loops.position_gain_per_s
    load, rotor = load_inertia(MACHINE, axis_of(axis)), axis_of(axis).reflected_inertia
    spring = {
        "name": "transmission_compliance",
        "stiffness": (2 * math.pi * 1500.0) ** 2 * reduced_mass(axis),
        "damping": 0.02 * load * 1e4,
    }
    cyclic = {"name": "cyclic_error", "amplitude": amplitude, "phase_rad": 0.7}
    hz = 25.0
    move = (-0.5 if axis == "A" else 0.0) + steady(2 * math.pi * hz * r, 0.8)
    answers = []
    for beside in ([], [spring]):
        plain, trace = (follow(axis, move, [NO_COULOMB, *beside, *more]) for more in ([], [cyclic]))
        held = (trace.time > 0.4) & (trace.time < 0.4 + 10 / hz)
        carrier = np.exp(-2j * np.pi * hz * trace.time[held])
        answers.append(np.mean((trace.get(axis, "position") - plain.get(axis, "position"))[held] * carrier))
    error = np.mean(amplitude * np.sin(plain.get(axis, "position")[held] / r + 0.7) * carrier)
    s = 2j * np.pi * hz
    rigid = answers[0] / error
    inert = s**2 + axis_of(axis).viscous_friction / (load + rotor) * s
    kv = kv * np.mean(np.exp(-s * TICK * np.arange(16)))  # held over the position cycle of 16 ticks
    drive = rigid * inert / (s - rigid * (s + kv))
    own = (drive * s + rotor / (load + rotor) * s**2) / (inert + drive * (s + kv))
    assert abs(own - rigid) > 0.1  # the response of the spring alone is a hundredth of that
    assert answers[1] / error == pytest.approx(own, abs=0.03 * abs(own))


def check_motor_speed(trace, axis):
    """The recorded motor speed is the derivative of the recorded motor position."""
    p, v = trace.get(axis, "motor_position"), trace.get(axis, "velocity")
    assert np.abs(np.diff(p) / TICK - (v[1:] + v[:-1]) / 2).max() < 2e-6
