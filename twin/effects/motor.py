"""Effects of the motor: torque constant off nominal, and torque ripple."""

import math

from twin.effects.change import Change
from twin.effects.effect import DEGREES, Parameter, Picture, effect, factor_of
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import FORCE, X_MOTOR_TORQUE, X_ROTOR_MIDDLE, arrays, term
from twin.simulation.waves import sine


@effect(
    block="current loop",
    parameters=(factor_of("torque_constant_nm_per_a", 0.3, 1.5, (0.88, 0.95), beyond_tolerance=2.0),),
    rivals="Inertia, Coulomb and viscous friction scaled by the same factor look the same. A known weight or added mass distinguishes them.",
    picture=Picture("Higher current for the same torque, also at rest on Z.", axis="Z", sizes={"factor": 0.9}),
)  # fmt: skip
def torque_constant(change: Change, axis: Axis, factor: float) -> None:
    """Torque constant of the motor off nominal.

    Kt = factor x nominal; the control still divides by the nominal Kt; the back-EMF is unchanged. Source: magnet temperature,
    saturation; tolerance of motor data 3 to 7.5 %.
    """
    change.scale(axis, torque_constant_nm_per_a=factor)


SERVO_PEAK_NM = 20.0
"""A motor of this peak torque or more has a ripple of the usual size; that of a smaller motor is proportional to its peak torque."""


def _ripple_of_motor(machine: Machine, axis: Axis) -> tuple[float, float]:
    share = min(1.0, axis.motor.torque_constant_nm_per_a * axis.motor.peak_current_a / SERVO_PEAK_NM)
    return (0.04 * share, 0.3 * share)


def _ripple_of_every_motor(machine: Machine, axis: Axis) -> float:
    """A sixth of the smallest usual ripple, at most 0.03 % of the peak torque [Nm]."""
    return _ripple_of_motor(machine, axis)[0] / 6.0


@effect(
    block="mechanics",
    axes="turning motor",
    parameters=(
        Parameter("amplitude_nm", "torque", 0.0, 10.0, _ripple_of_motor, neutral=0.0, logarithmic=True, normal_size=_ripple_of_every_motor),
        Parameter("periods_per_rev", "number", 0.1, 500.0, (4.0, 12.0), logarithmic=True, scan="turn"),
        Parameter("phase_rad", "angle", -2 * math.pi, 2 * math.pi, default=0.0, shape=True, periodic=True, shown=DEGREES),
    ),
    rivals="Position-dependent friction changes sign with the direction of motion; ripple does not.",
    picture=Picture(
        "Current ripple locked to the motor angle, here 6 periods per turn.",
        "constant speed",
        sizes={"amplitude_nm": 0.25, "periods_per_rev": 6.0},
    ),
)
def torque_ripple(change: Change, axis: Axis, amplitude_nm: float, periods_per_rev: float, phase_rad: float) -> None:
    """Torque ripple over the rotor angle (cogging).

    T += amplitude sin(n theta + phase), theta = motor position / r. Locked to position, keeps its sign at a reversal. Source:
    detent torque of permanent-magnet motors, 1 to 4 % of rated.
    """
    change.add_term(ripple, FORCE, axis, [amplitude_nm, periods_per_rev / axis.ratio, phase_rad])


@term
def ripple(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """T += p[0] sin(p[1] q + p[2])."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_MOTOR_TORQUE] += p[0] * sine(p[1] * x[axis, X_ROTOR_MIDDLE] + p[2])
