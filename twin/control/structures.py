"""Control structures: the speed controller of an axis, and what turns its output into torque; the numbers of all their blocks together."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from twin.control import current_controller, drive_position_loop, position_controller, speed_controller
from twin.control.actuator import EFFORTS, IDEAL, SERVO, SPEED_GAIN, Actuator
from twin.control.block import Listed
from twin.control.current_controller import ACTUATOR_LAG
from twin.control.number import Parameter
from twin.control.speed_set_point_filters import lag_of

INTEGRAL = "speed_integral_time_s"
IN_FLOW = (*position_controller.PARAMETERS, *drive_position_loop.PARAMETERS, *speed_controller.PARAMETERS, *current_controller.PARAMETERS)
"""Numbers of all blocks in the order of the signals, from the set point to the current."""

POSITION_LOOP = frozenset(p.name for p in (*position_controller.PARAMETERS, *drive_position_loop.PARAMETERS))
NC_WEIGHTS = {"velocity": "velocity_feedforward", "torque": "torque_feedforward"}
"""Word for a feedforward of the NC -> its weight; a run may switch each on and off."""

NUMBERS = {p.name: p for p in IN_FLOW}


@dataclass(frozen=True, kw_only=True)
class Loops(
    position_controller.PositionNumbers,
    drive_position_loop.DriveLoopNumbers,
    speed_controller.SpeedNumbers,
    current_controller.CurrentNumbers,
):
    """The numbers of the blocks of an axis, `[axis.N.loops]`."""

    def has(self, name: str) -> bool:
        """False for a number that the axis does not have."""
        return not NUMBERS[name].is_absent(getattr(self, name))

    def searched(self, numbers: Iterable[Parameter], fed: Collection[str] = ()) -> list[str]:
        """Those of some numbers that the axis has and a fit in closed loop can move; last weights of the feedforward, those of the NC only if in `fed`."""
        own = (p.name for p in numbers if p.search and (p.name in fed if p.name in NC_WEIGHTS.values() else self.has(p.name)))
        return sorted(own, key=lambda name: "feedforward" in name)

    def for_plant(self, inertia: float, inductance: float, lag: float) -> dict[str, float]:
        """The numbers that keep the shape of the loops where inertia, inductance and lag L / R of the winding are these times as large."""
        current = {
            "current_gain_v_per_a": self.current_gain_v_per_a * inductance,
            "current_integral_time_s": self.current_integral_time_s * lag,
        }
        return {"speed_gain_nm_s_per_rad": self.speed_gain_nm_s_per_rad * inertia, **current}

    @property
    def set_point_delay_s(self) -> float:
        """Delay of a set point [s]: in the position controller of the NC, plus on the way to a drive that closes the loop."""
        return self.position_delay_s + self.dsc_delay_s

    @property
    def acceleration_weight(self) -> float:
        """Sum of the torque feedforward weights of NC and drive, as a share of the torque for the commissioned inertia."""
        return self.torque_feedforward + self.drive_torque_feedforward

    @property
    def one_law(self) -> tuple[str, ...]:
        """Controllers whose recorded signals obey one law: two P controllers are a PD controller of the position."""
        return () if self.has(INTEGRAL) else ("position controller", "speed controller")

    @property
    def within_law(self) -> tuple[str, ...]:
        """Signals inside this law, which the command shows without a record of them: its speeds are differences of the position."""
        return ("velocity", "velocity_setpoint") if self.one_law and self.speed_mean_cycles else ()

    def beyond_start(self, command: np.ndarray) -> np.ndarray:
        """A command without what an integral part held at its first sample, a weight for example, which no signal shows."""
        return command - (command[0] if self.has(INTEGRAL) else 0.0)

    def sag(self, force: float, ratio: float) -> float:
        """Following error [m, rad] with which the control holds a force at rest: F r^2 / (Kp Kv), none with an integral part."""
        return 0.0 if self.has(INTEGRAL) else force * ratio**2 / (self.speed_gain_nm_s_per_rad * self.position_gain_per_s)


def is_fed_as_recorded(loops: Loops, blocks: Iterable[Listed]) -> bool:
    """Whether the speed controller gets the recorded speed set point and the measured speed: the NC closes the position loop, and no filter is between."""
    return loops.dsc_delay_s == 0.0 and speed_controller.sees_motor_speed(loops) and lag_of(blocks) is None


def has_recorded_law(loops: Loops, blocks: Iterable[Listed]) -> bool:
    """Whether Kt_c i* = Kp e + Kp/Tn int e + a_t T_ff holds of the recorded signals; a reference model integrates another error."""
    return is_fed_as_recorded(loops, blocks) and loops.speed_reference_time_s == 0.0


@dataclass(frozen=True)
class Structure:
    """The blocks of an axis after its P position controller: a P or PI speed controller, and the actuator."""

    integral: bool
    actuator: Actuator

    def numbers(self, every: Iterable[Parameter], command: str) -> tuple[Parameter, ...]:
        """Those of the numbers that every axis may have. An ideal actuator has its own, and needs no weights and delays of its loops."""
        # with a current loop the torque feedforward of the NC and that of the drive cannot be identified separately
        if self.actuator.winding:
            others = {speed_controller.DRIVE_FEEDFORWARD, ACTUATOR_LAG}
        else:  # a recorded voltage is the command, a recorded current or torque what follows it
            others = {p.name for p in current_controller.PARAMETERS} - ({ACTUATOR_LAG} if EFFORTS[command].noisy else set())
        own = [p for p in every if p.name not in others and (self.integral or p.name != INTEGRAL)]
        if self.actuator.winding:
            return tuple(own)
        effort = EFFORTS[command]
        own = [p for p in own if not p.field.startswith("motor.") and p.name != "commissioned_torque_constant"]
        # of the loops: not weights and delays, and the gain in one of its units
        needed = {p for p in own if p.bounds.above and p is not SPEED_GAIN}
        loops = [replace(p, bounds=replace(p.bounds, required=p in needed)) if p.field.startswith("loops.") else p for p in own]
        return (*effort.constant[:1], effort.peak, *loops, *effort.gains, *effort.constant[1:])


STRUCTURES = {"P/PI/PI": Structure(True, SERVO), "P/PI": Structure(True, IDEAL), "P/P": Structure(False, IDEAL)}
"""Position, speed and current controller of an axis, or an ideal actuator in place of the last. The first one is the default."""


def ideal_structure(numbers: Collection[str]) -> str:
    """The structure with an ideal actuator that has these numbers."""
    return next(name for name, s in STRUCTURES.items() if s.actuator is IDEAL and s.integral == (INTEGRAL in numbers))
