"""A change of the control or of the machine that answers an effect of the diagnosis."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.control.library import BLOCKS
from twin.control.number import si_from_key
from twin.effects import Setting, settings_of, with_effects
from twin.effects.change import total_inertia
from twin.machine.machine import Axis, Machine
from twin.remedy.advice import GAIN, SET_BACK


def held(axis: Axis, function: str) -> dict[str, float]:
    """The numbers of a function that the control of an axis has already [SI]; empty without it."""
    return next((dict(b.values) for b in axis.blocks if b.block.name == function), {})


@dataclass(frozen=True)
class Change:
    """One change: the axis and effect it answers, the function of the control, its numbers by name [SI at the axis].

    `set_back` gives a number of the control its commissioned value; the deviation that the diagnosis found is then gone. `position_gain`
    is a new gain of the position loop. Every other function is a block of the axis' control.
    """

    axis: str
    function: str
    setting: Setting | None = None
    """The effect that it answers; None for friction that every machine of this kind has."""
    values: Mapping[str, float] = field(default_factory=dict)

    def applied(self, machine: Machine) -> Machine:
        """The machine with this change."""
        if self.function == SET_BACK and self.setting is not None:
            setting = self.setting
            if setting.effect.name == "inertia":
                return machine.with_values({f"axis.{self.axis}.commissioned.{key}": v for key, v in self.table(machine).items()})
            return with_effects(machine, [s for s in settings_of(machine) if s.key != setting.key])
        if self.function == GAIN:
            return machine.with_values({f"axis.{self.axis}.loops.{key}": v for key, v in self.table(machine).items()})
        others = machine.document["axis"][self.axis].get("block", {})
        return machine.with_values({f"axis.{self.axis}.block": {**others, self.function: self.table(machine)}})

    def table(self, machine: Machine) -> dict[str, Any]:
        """The numbers in the units of the machine file, by key. Setting back the feedforward of torque gives the inertia that it then knows."""
        axis = machine.axis(self.axis)
        if self.function == GAIN:
            return dict(self.values)
        if self.function != SET_BACK:
            keys = {n.name: n.key(axis.kind) for n in BLOCKS[self.function].numbers}
            return {key: self.values[name] / si_from_key(key) for name, key in keys.items() if name in self.values}
        if self.setting is None or self.setting.effect.name != "inertia":
            return {}
        now = axis.commissioned_inertia
        if now is None:
            now = total_inertia(with_effects(machine, []), axis) * axis.ratio**2
        return {"inertia_kg_m2": now + self.setting.size * axis.ratio**2}
