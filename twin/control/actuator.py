"""What turns the output of the speed controller into torque: a motor behind its current controller, or an ideal actuator in their place.

A sensor measures what a motor does with a command; an ideal actuator obeys, so its recorded command acts. Its numbers are per unit of the command.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.control import speed_controller
from twin.control.number import Parameter, positive, same_key
from twin.errors import InputError, nearest

SPEED_GAIN = next(p for p in speed_controller.PARAMETERS if p.name == "speed_gain_nm_s_per_rad")


@dataclass(frozen=True)
class Effort:
    """The command of a speed controller: its unit, and the numbers of an ideal actuator that stand in for those of a motor.

    output    signal that the speed controller gives
    peak      largest command
    constant  torque per unit of the command, of the actuator and as commissioned; none if the command is a torque
    gains     the speed gain per unit of the command, per motor radian and per axis unit
    noisy     True if its record has noise of its own: a current or a torque is measured, whatever the machine says of its control; a voltage is a command
    """

    unit: str
    output: str
    peak: Parameter
    constant: tuple[Parameter, ...] = ()
    gains: tuple[Parameter, ...] = ()
    noisy: bool = True

    @property
    def has_back_emf(self) -> bool:
        """Whether it acts through a winding, whose back EMF looks like a viscous friction and whose lag delays the force: a voltage."""
        return self.unit == "V"


def _effort(unit: str, output: str, peak: str, direct: str = "") -> Effort:
    most = same_key(f"actuator.{peak}", positive(), field="motor.peak_current_a", direct=direct)
    if unit == "Nm":
        return Effort(unit, output, most)
    key, own = f"torque_constant_nm_per_{unit.lower()}", f"force_constant_n_per_{unit.lower()}"
    turn, way = (f"loops.speed_gain_{unit.lower()}_s_per_{per}" for per in ("rad", "m"))
    constant = (
        same_key(f"actuator.{key}", positive(), field="motor.torque_constant_nm_per_a", direct=own),
        same_key(f"commissioned.{key}", positive(required=False), field="commissioned_torque_constant", direct=own),
    )
    gains = [Parameter(SPEED_GAIN.field, *keys, positive(required=False)) for keys in ((turn, turn, ""), (way, "", way))]
    return Effort(unit, output, most, constant, tuple(gains), noisy=unit != "V")


EFFORTS = {
    "current": _effort("A", "current_setpoint", "peak_current_a"),
    "voltage": _effort("V", "voltage", "peak_voltage_v"),
    "torque": _effort("Nm", "torque", "peak_torque_nm", "peak_force_n"),
}


def gain_factor(gain: Parameter, constant: float, ratio: float) -> float:
    """Nm s/rad of a speed gain per unit of the command. `constant`: torque per unit; `ratio`: axis units per motor radian."""
    return constant * (ratio if gain.screw.endswith("_m") else 1.0)


@dataclass(frozen=True)
class Actuator:
    """What turns the output of the speed controller into torque.

    table     table of the axis with its numbers: `[axis.N.motor]` or `[axis.N.actuator]`
    commands  what the speed controller may command; the key `command` of the table chooses if there are several
    cycle     key of its cycle in `[control]`; '' if it needs none
    winding   True if it has a current controller and a winding, with a voltage and losses, and a sensor measures the effort; False if a recorded
              command is a sample of what acts
    """

    table: str
    commands: tuple[str, ...]
    cycle: str = ""
    winding: bool = False

    def command_in(self, table: Mapping[str, Any], where: str) -> str:
        """What the speed controller of an axis table commands."""
        own = table.get(self.table)
        command = own.get("command") if isinstance(own, dict) and len(self.commands) > 1 else self.commands[-1]
        if not isinstance(command, str) or command not in self.commands:
            raise InputError(f"{where[:-1]}.{self.table}]: command = {command!r}; {nearest(str(command), self.commands)}")
        return command


SERVO = Actuator("motor", ("current",), "current_cycle_us", winding=True)
IDEAL = Actuator("actuator", tuple(EFFORTS))
