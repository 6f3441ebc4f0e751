"""Control structures: the speed controller of an axis, and what turns its output into torque; the numbers of all their blocks together."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
import math

from twin.control import current_controller, drive_position_loop, position_controller, speed_controller
from twin.control.number import Parameter

INTEGRAL = "speed_integral_time_s"
IN_FLOW = (*position_controller.PARAMETERS, *drive_position_loop.PARAMETERS, *speed_controller.PARAMETERS, *current_controller.PARAMETERS)
"""Numbers of all blocks in the order of the signals, from the set point to the current."""

POSITION_LOOP = frozenset(p.name for p in (*position_controller.PARAMETERS, *drive_position_loop.PARAMETERS))
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

    def searched(self, numbers: Iterable[Parameter], fed: bool = True) -> list[str]:
        """Those of some numbers that the axis has and a fit in closed loop can move; last, and only if `fed`, weights of the feedforward."""
        own = (p.name for p in numbers if p.search and self.has(p.name) and (fed or "feedforward" not in p.name))
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
    def carries_load(self) -> bool:
        """True if the control carries a constant force without a following error; what it carries at the start of a record is then unknown."""
        return math.isfinite(self.speed_integral_time_s)

    @property
    def is_one_law(self) -> bool:
        """True if position and speed controller act as one law: two P controllers are a PD controller of the position."""
        return not self.carries_load


@dataclass(frozen=True)
class Actuator:
    """What turns the output of the speed controller into torque.

    table       table of the axis with its numbers: `[axis.N.motor]` or `[axis.N.actuator]`
    loops       keys of its controllers in `[axis.N.loops]`
    cycle       key of its cycle in `[control]`; '' if it needs none
    electrical  fields of its winding in `Motor`; none for an ideal actuator, whose numbers may be lumped
    measured    True if a sensor measures the effort; False if the recorded command is what acts
    gives       signals that it makes beside the effort
    """

    table: str
    loops: tuple[str, ...] = ()
    cycle: str = ""
    electrical: tuple[str, ...] = ()
    measured: bool = False
    gives: tuple[str, ...] = ()


SERVO = Actuator(
    "motor", tuple(p.name for p in current_controller.PARAMETERS), "current_cycle_us", ("resistance_ohm", "inductance_h"),
    measured=True, gives=("voltage",),
)  # fmt: skip
IDEAL = Actuator("actuator")


@dataclass(frozen=True)
class Structure:
    """The blocks of an axis after its P position controller: a P or PI speed controller, and the actuator."""

    integral: bool
    actuator: Actuator

    @property
    def without(self) -> frozenset[str]:
        """Keys of `[axis.N.loops]` that belong to blocks of other structures."""
        # with a current loop the torque feedforward of the NC and that of the drive cannot be identified separately
        others = (speed_controller.DRIVE_FEEDFORWARD,) if self.actuator is SERVO else SERVO.loops
        return frozenset(others if self.integral else (*others, INTEGRAL))


STRUCTURES = {"P/PI/PI": Structure(True, SERVO), "P/PI": Structure(True, IDEAL), "P/P": Structure(False, IDEAL)}
"""Position, speed and current controller of an axis, or an ideal actuator in place of the last. The first one is the default."""


def ideal_structure(numbers: Collection[str]) -> str:
    """The structure with an ideal actuator that has these numbers."""
    return next(name for name, s in STRUCTURES.items() if s.actuator is IDEAL and s.integral == (INTEGRAL in numbers))
