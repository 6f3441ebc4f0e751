"""Normal differences between machines: parameters within `parameter_tolerance`, and normal imperfections.

Both are nuisance parameters: they are fitted but never reported as effects. Normal imperfections are a slightly elastic drive train and a
small slip before break-away. Beyond the limits in the thresholds they are effects.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from twin.diagnose.settings import T
from twin.effects import EFFECTS, Setting, settings_of, with_effects
from twin.effects.change import FASTEST_MODE, load_inertia, reduced_mass
from twin.machine.axis import path_of, toleranced
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import SPREAD
from twin.units import ARCSEC

UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of a uniform spread of half width 1."""

NORMAL: dict[str, str] = {effect.normal: effect.name for effect in EFFECTS.values() if effect.normal}
NORMAL["damping"] = NORMAL["elasticity"]
"""Normal imperfection -> the effect that it is if it is large. Springs are measured by their compliance; `damping` is that of the drive train."""

SPRING_EFFECT = NORMAL["elasticity"]
"""Effect of the linear spring of a drive train."""

SPRINGS = ("elasticity", "slip")
"""Normal imperfections with a stiffness; their compliance cannot be negative."""


@dataclass(frozen=True)
class Nuisance:
    """A parameter of an axis, a body whose mass and inertia scale together, or a normal imperfection of an axis.

    The deviation of an imperfection is 0 if it is absent, and the tolerance at the largest normal size.
    """

    owner: str
    quantity: str

    @property
    def is_imperfection(self) -> bool:
        """Is it a normal imperfection, not a parameter of the machine file?"""
        return self.quantity in NORMAL

    def apply(self, machine: Machine, factor: float) -> Machine:
        """The machine with this parameter multiplied by `factor`."""
        if self.quantity == "body":
            return machine.with_body(self.owner, factor)
        if self.owner not in machine.axis_names:
            return machine
        axis = machine.axis(self.owner)
        if self.is_imperfection:
            share = (factor - 1.0) / machine.parameter_tolerance
            if self.quantity == "damping":
                return _damped(machine, self.owner, T.normal_damping ** min(max(share, -T.widest), T.widest))
            if share < T.doubt:
                return machine
            stiffness = min(_softest(machine, axis, self.quantity) / share, _stiffest(machine, axis, self.quantity))
            return with_added(machine, [Setting(EFFECTS[NORMAL[self.quantity]], self.owner, {"stiffness": stiffness})])
        return machine.with_each_axis({self.owner: {SPREAD[self.quantity]: factor * axis.number(SPREAD[self.quantity])}})

    def axes(self, group: Sequence[str]) -> tuple[str, ...]:
        """Axes of a group whose motion the parameter changes: its own axis, or all axes for a body."""
        return tuple(group) if self.quantity == "body" else (self.owner,)

    def paths(self, machine: Machine) -> list[str]:
        """Paths of its numbers in the machine file; none for an imperfection."""
        if self.quantity == "body":
            return [f"body.{self.owner}.mass_kg", f"body.{self.owner}.inertia_kg_m2"]
        if self.is_imperfection:
            return []
        return [machine.in_file(path_of(machine.axis(self.owner), self.quantity), 0.0)[0]]


def _damped(machine: Machine, owner: str, factor: float) -> Machine:
    """The machine with the damping of an elastic drive train multiplied; unchanged if the drive train is rigid."""
    changed = []
    for own in settings_of(machine):
        if own.axis == owner and own.effect.name == NORMAL["damping"]:
            fitted = own.effect.parameter("damping").fitted
            default = fitted(machine, machine.axis(owner), own.parameters) if fitted else 0.0
            own = replace(own, parameters={**own.parameters, "damping": factor * own.parameters.get("damping", default)})
        changed.append(own)
    return with_effects(machine, changed)


def can_be_imperfect(machine: Machine, axis: str, quantity: str) -> bool:
    """Whether an axis can have a normal imperfection: slip precedes break-away by Coulomb friction, and a drive train connects a rotor with its load."""
    own = machine.axis(axis)
    return (own.coulomb_friction if quantity == "slip" else own.reflected_inertia) > 0.0


def normal_slip(axis: Axis) -> float:
    """Largest normal travel before break-away [m, rad]."""
    return T.normal_slip * (1e-6 if axis.kind == "linear" else ARCSEC)


def _softest(machine: Machine, axis: Axis, quantity: str) -> float:
    """Smallest normal stiffness [N/m, Nm/rad]."""
    if quantity == "elasticity":
        return float((2.0 * math.pi * T.normal_mode_hz) ** 2 * load_inertia(machine, axis))
    return axis.coulomb_friction / normal_slip(axis)


def is_normal(machine: Machine, setting: Setting) -> bool:
    """Whether a setting is a normal imperfection: a spring that is no softer than the softest normal one."""
    kind = setting.effect.normal
    if not kind or not can_be_imperfect(machine, setting.axis, kind):
        return False
    return bool(setting.parameters["stiffness"] >= _softest(machine, machine.axis(setting.axis), kind))


def spring_of(settings: Sequence[Setting], axis: str) -> Setting | None:
    """The linear spring of an axis' drive train; None if it is rigid."""
    return next((s for s in settings if s.axis == axis and s.effect.name == SPRING_EFFECT), None)


def drive_train_of(settings: Sequence[Setting], axis: str) -> list[Setting]:
    """Settings that separate motor and load of an axis: its spring, and a backlash, which contains one. Lead and cyclic errors do not."""
    return [s for s in settings if s.axis == axis and (s.effect.name == SPRING_EFFECT or SPRING_EFFECT in s.effect.contains)]


def _stiffest(machine: Machine, axis: Axis, quantity: str) -> float:
    """Largest stiffness that the simulation step resolves [N/m, Nm/rad]: of a drive train between rotor and load, of a contact under the load."""
    mass = reduced_mass(machine, axis) if quantity == "elasticity" else load_inertia(machine, axis)
    return 0.8 * (FASTEST_MODE / machine.base_tick) ** 2 * mass


def least_share(machine: Machine, spring: Nuisance) -> float:
    """Smallest size of a spring that the simulation step resolves, as a share of the largest normal size. A smaller one is left out."""
    axis = machine.axis(spring.owner)
    return _softest(machine, axis, spring.quantity) / _stiffest(machine, axis, spring.quantity)


def nuisances_of(machine: Machine, axes: Sequence[str]) -> tuple[Nuisance, ...]:
    """All toleranced parameters of a group of axes, and the bodies if the group has a rotary axis."""
    found = []
    for name in axes:
        found += [Nuisance(name, quantity) for quantity in toleranced(machine.axis(name))]
    if any(machine.axis(name).kind == "rotary" for name in axes):
        found += [Nuisance(body.name, "body") for body in machine.bodies]
    return tuple(found)


def with_added(machine: Machine, settings: Sequence[Setting]) -> Machine:
    """The machine with its own effects and `settings`. Two springs of the same effect act in series."""
    added = {s.key: s for s in settings}
    kept = []
    for own in settings_of(machine):
        if own.key in added:
            other = added[own.key]
            stiffness = 1.0 / (1.0 / own.parameters["stiffness"] + 1.0 / other.parameters["stiffness"])
            added[own.key] = replace(other, parameters={**own.parameters, **other.parameters, "stiffness": stiffness})
        elif not any(own.effect.name in new.effect.contains and own.axis == new.axis for new in settings):
            kept.append(own)
    return with_effects(machine, [*kept, *added.values()])


def tuned(nuisances: Sequence[Nuisance], deviations: np.ndarray) -> Callable[[Machine], Machine]:
    """A function that changes the nuisances of a machine by these fractions (nuisance,)."""

    def machine_of(machine: Machine) -> Machine:
        for nuisance, deviation in zip(nuisances, deviations):
            if deviation != 0.0:
                machine = nuisance.apply(machine, 1.0 + float(deviation))
        return machine

    return machine_of
