"""Parameters that differ from machine to machine within `parameter_tolerance`: nuisances, re-tuned but never an effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.machine import Machine

UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of a uniform spread of half width 1."""

_AXIS_FIELDS = {
    "torque_constant": "torque_constant_nm_per_a",
    "resistance": "resistance_ohm",
    "inductance": "inductance_h",
    "rotor_inertia": "rotor_inertia_kg_m2",
    "moving_mass": "moving_mass_kg",
    "coulomb_friction": "coulomb_friction_nm",
    "viscous_friction": "viscous_friction_nm_s_per_rad",
}


@dataclass(frozen=True)
class Nuisance:
    """One parameter: axis (or None) and quantity, or a body whose mass and inertia scale together."""

    owner: str
    quantity: str

    def apply(self, machine: Machine, factor: float) -> Machine:
        """The machine with this parameter multiplied."""
        if self.quantity == "body":
            bodies = tuple(
                replace(b, mass_kg=b.mass_kg * factor, inertia_kg_m2=_scaled(b.inertia_kg_m2, factor)) if b.name == self.owner else b
                for b in machine.bodies
            )
            return replace(machine, bodies=bodies)
        if self.owner not in machine.axis_names:
            return machine
        axis = machine.axis(self.owner)
        name = _AXIS_FIELDS[self.quantity]
        return machine.with_axis(self.owner, **{name: factor * getattr(axis.motor if hasattr(axis.motor, name) else axis, name)})

    def axes(self, group: Sequence[str]) -> tuple[str, ...]:
        """The axes of a group whose motion it changes: its own, or all that carry the body."""
        return tuple(group) if self.quantity == "body" else (self.owner,)

    def paths(self, machine: Machine) -> list[str]:
        """Paths of the machine file that carry it."""
        if self.quantity == "body":
            return [f"body.{self.owner}.mass_kg", f"body.{self.owner}.inertia_kg_m2"]
        table = machine.document["axis"][self.owner]
        if self.quantity == "rotor_inertia":
            return [f"axis.{self.owner}.{key}" for key in table if key.startswith("rotor_and")]
        name = _AXIS_FIELDS[self.quantity]
        return [f"axis.{self.owner}.motor.{name}" if name in table["motor"] else f"axis.{self.owner}.{name}"]


def _scaled(inertia: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    x, y, z = inertia
    return factor * x, factor * y, factor * z


def nuisances_of(machine: Machine, axes: Sequence[str]) -> tuple[Nuisance, ...]:
    """All toleranced parameters of a group of axes; bodies belong to the rotary axes that carry them."""
    found = []
    for name in axes:
        axis = machine.axis(name)
        for quantity in _AXIS_FIELDS:
            if quantity != "moving_mass" or axis.moving_mass_kg is not None:
                found.append(Nuisance(name, quantity))
    if any(machine.axis(name).kind == "rotary" for name in axes):
        found += [Nuisance(body.name, "body") for body in machine.bodies]
    return tuple(found)


def tuned(nuisances: Sequence[Nuisance], deviations: np.ndarray) -> Callable[[Machine], Machine]:
    """Turns a machine into the one whose parameters deviate by these fractions (nuisance,)."""

    def machine_of(machine: Machine) -> Machine:
        for nuisance, deviation in zip(nuisances, deviations):
            if deviation != 0.0:
                machine = nuisance.apply(machine, 1.0 + float(deviation))
        return machine

    return machine_of
