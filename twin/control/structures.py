"""Control structures: the speed controller of an axis, and what turns its output into torque."""

from __future__ import annotations

from dataclasses import dataclass

from twin.control import current_controller, speed_controller

INTEGRAL = "speed_integral_time_s"


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


def _keys(parameters: tuple) -> tuple[str, ...]:  # type: ignore[type-arg]
    return tuple(p.screw.rsplit(".", 1)[-1] for p in parameters)


SERVO = Actuator(
    "motor", _keys(current_controller.PARAMETERS), "current_cycle_us", ("resistance_ohm", "inductance_h"), measured=True, gives=("voltage",)
)
IDEAL = Actuator("actuator")


@dataclass(frozen=True)
class Structure:
    """The blocks of an axis after its P position controller: a P or PI speed controller, and the actuator."""

    integral: bool
    actuator: Actuator

    @property
    def without(self) -> frozenset[str]:
        """Keys of `[axis.N.loops]` that belong to blocks of other structures."""
        own = (*self.actuator.loops, *((INTEGRAL,) if self.integral else ()))
        optional = (*_keys(current_controller.PARAMETERS), INTEGRAL)
        # with a current loop the torque feedforward of the NC and that of the drive cannot be identified separately
        drive = (speed_controller.DRIVE_FEEDFORWARD,) if self.actuator is SERVO else ()
        return frozenset(optional) - frozenset(own) | frozenset(drive)


STRUCTURES = {"P/PI/PI": Structure(True, SERVO), "P/PI": Structure(True, IDEAL), "P/P": Structure(False, IDEAL)}
"""Position, speed and current controller of an axis, or an ideal actuator in place of the last. The first one is the default."""
