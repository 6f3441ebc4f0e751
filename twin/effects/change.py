"""Changes that effects make to a machine: parameters, loop terms and model edits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import mujoco
import numpy as np

from twin.effects.coupling import Coupling, coupling
from twin.effects.effect import BLOCKS, EFFECTS
from twin.effects.setting import Setting, parse_setting, settings_of
from twin.effects.structural_mode import mode_parameters, structural_mode
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import FORCE, MEASURE, X_LOAD_FORCE, Term, arrays, term
from twin.simulation.plant_spec import ModelEdit, at_home, frames_of_model

FASTEST_MODE = 1.5
"""Largest natural frequency times tick of a spring. Semi-implicit Euler is unstable above 2."""


@dataclass(frozen=True)
class _AddedInertia:
    """The edit that adds mass or inertia to the load of an axis."""

    axis: str
    added: float

    def __call__(self, spec: mujoco.MjSpec) -> None:
        spec.joint(self.axis).armature += self.added


@dataclass
class Change:
    """A machine with its effects applied one by one; arrays are (axis,) in the machine's order."""

    machine: Machine
    started_at: float = 0.0
    lead_ticks: int = 0  # length of the lead-in, before time 0
    terms: list[Term] = field(default_factory=list)
    model_edits: list[ModelEdit] = field(default_factory=list)
    couplings: dict[str, Coupling] = field(default_factory=dict)  # of the axes whose rotor has its own joint
    transmission_errors: list[tuple[Any, Axis, list[float]]] = field(default_factory=list)  # term, axis, three parameters
    scale_offset: np.ndarray = field(default_factory=lambda: np.zeros(0))
    constant_force: np.ndarray = field(default_factory=lambda: np.zeros(0))
    force_at_rest: list[tuple[int, Callable[[np.ndarray], float]]] = field(default_factory=list)
    """Forces on the load towards +q that the integrators carry at the start of a run: axis index, force as a function of the start (axis,)."""

    def __post_init__(self) -> None:
        self.scale_offset = np.zeros(len(self.machine.axes))
        self.constant_force = np.zeros(len(self.machine.axes))

    def index(self, axis: Axis) -> int:
        """Index of an axis in the machine's order."""
        return self.machine.axis_names.index(axis.name)

    def scale(self, axis: Axis, **factors: float) -> None:
        """Multiply fields of the axis, its motor or its loops."""
        now = self.machine.axis(axis.name)
        self.set(axis, **{name: now.number(name) * factor for name, factor in factors.items()})

    def set(self, axis: Axis, **values: Any) -> None:
        """Replace fields of the axis, its motor or its loops. The control keeps the torque constant that it was commissioned with."""
        now = self.machine.axis(axis.name)
        kept = {"commissioned_torque_constant": now.commissioned_torque_constant} if now.has_constant else {}
        self.machine = self.machine.with_axis(axis.name, **{**kept, **values})

    def add_term(self, law: Any, stage: int, axis: Axis, parameters: Sequence[float] = (), order: int = 0) -> None:
        """Add a term of the compiled loop."""
        self.terms.append(Term(law, stage, self.index(axis), parameters, order))

    def add_force(self, axis: Axis, force: float) -> None:
        """Add a constant force on the load, towards +q; the integrators carry it at the start of a run."""
        self.constant_force[self.index(axis)] += force
        self.add_term(constant_load_force, FORCE, axis, [force])

    def constant_force_at(self, start: np.ndarray) -> np.ndarray:
        """Force (axis,) towards +q at rest at `start` (axis,)."""
        force = self.constant_force.copy()
        for a, law in self.force_at_rest:
            force[a] += law(start)
        return force

    def add_inertia(self, axis: Axis, added: float) -> None:
        """Add mass or inertia to the load of this axis only."""
        self.model_edits.append(_AddedInertia(axis.name, added))

    def couple(self, cause: str, axis: Axis, stiffness: float, damping: float, clearance: float = 0.0) -> None:
        """Add a spring, a damper and a dead zone between rotor and load; `cause` is the name of the effect, for messages."""
        self.couplings.setdefault(axis.name, Coupling()).add(cause, stiffness, damping, clearance)

    def add_transmission_error(self, law: Any, axis: Axis, parameters: Sequence[float]) -> None:
        """Add a transmission error, by which the load leads the rotor: a term with at most three parameters. `apply_effects` adds a fourth, 1
        for a rotor with its own joint."""
        self.transmission_errors.append((law, axis, [*parameters, *([0.0] * (3 - len(parameters)))]))

    def load_inertia(self, axis: Axis) -> float:
        """Mass or inertia of the load alone, without rotor, in the home pose [kg, kg m2]."""
        return load_inertia(self.machine, axis)

    def rotor_offset(self, index: int, held: float) -> float:
        """Rotor minus load position of a coupled axis at rest."""
        axis = self.machine.axes[index]
        return self.couplings[axis.name].rotor_offset(held, axis.coulomb_friction)

    def check_step(self, axis: Axis, what: str, stiffness: float, mass: float) -> None:
        """Raise InputError if the base tick cannot resolve the natural frequency of a spring."""
        h = self.machine.base_tick
        w = math.sqrt(stiffness / mass)
        if w * h > FASTEST_MODE:
            raise InputError(
                f"{what} on axis {axis.name}: stiffness {stiffness:g} oscillates at {w / (2 * math.pi):.0f} Hz, too fast for a tick of "
                f"{h * 1e6:g} us; give at most {(FASTEST_MODE / h) ** 2 * mass:.3g}, or leave the effect out"
            )


LEAST_LOAD = 1e-9
"""Load over rotor inertia; below it the load is not known from their sum."""


def load_inertia(machine: Machine, axis: Axis) -> float:
    """Mass or inertia of an axis' load alone, without rotor, in the home pose [kg, kg m2].

    Raises:
        InputError: the load is nothing beside the rotor, so that their difference is rounding.
    """
    inertia, _ = at_home(machine)
    total, rotor = float(inertia[machine.axis_names.index(axis.name)]), axis.reflected_inertia
    if not total - rotor > LEAST_LOAD * rotor:
        unit = "kg" if axis.kind == "linear" else "kg m2"
        raise InputError(
            f"axis {axis.name}: its load vanishes beside its rotor, which acts like {rotor:.3g} {unit}; correct the inertia of one"
        )
    return total - rotor


def held_force(machine: Machine, axis: Axis) -> float:
    """Force that holds an axis against gravity in the home pose [N, Nm]."""
    _, bias = at_home(machine)
    return float(bias[machine.axis_names.index(axis.name)])


def upward(machine: Machine, axis: Axis) -> float:
    """Component of a linear axis along +z of the machine frame, 0 for a horizontal axis."""
    model = frames_of_model(machine)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    up = float(data.xaxis[model.joint(axis.name).id][2])
    return up if abs(up) > 1e-9 else 0.0


def weight(machine: Machine, axis: Axis) -> float:
    """Weight on a linear axis [N], 0 for a rotary or horizontal axis."""
    return (axis.moving_mass_kg or 0.0) * machine.gravity * abs(upward(machine, axis)) if axis.kind == "linear" else 0.0


def reduced_mass(machine: Machine, axis: Axis) -> float:
    """Rotor and load of an axis in series, m1 m2 / (m1 + m2) [kg, kg m2], without the part of the load that swings in a structural mode."""
    load, rotor = (1.0 - axis.mode_mass_share) * load_inertia(machine, axis), axis.reflected_inertia
    return load * rotor / (load + rotor)


def total_inertia(machine: Machine, axis: Axis) -> float:
    """Mass or inertia of load and rotor in the home pose [kg, kg m2]."""
    return load_inertia(machine, axis) + axis.reflected_inertia


def apply_effects(machine: Machine, started_at: float = 0.0) -> Change:
    """Apply the constant loads and the effects of a machine; `started_at` [s] since the start of the campaign."""
    change = Change(machine, started_at)
    settings = settings_of(machine)
    listed = {(s.effect.name, s.axis) for s in settings}
    for axis in machine.axes:
        if axis.constant_force:
            change.add_force(axis, -axis.constant_force)
        if axis.mode_mass_share:  # the share of the structural mode leaves the mass that feels the drive and swings behind it
            mass = load_inertia(machine, axis)
            change.add_inertia(axis, -axis.mode_mass_share * mass)
            change.add_term(structural_mode, FORCE, axis, mode_parameters(axis, mass, machine.base_tick))
        if axis.presliding_stiffness and ("presliding", axis.name) not in listed:
            EFFECTS["presliding"].act(change, axis, stiffness=axis.presliding_stiffness)
    # sorted by block, then as in the library, so that the order in the machine file does not matter
    order = {name: i for i, name in enumerate(EFFECTS)}
    for setting in sorted(settings, key=lambda s: (BLOCKS.index(s.effect.block), order.get(s.effect.name, len(order)))):
        if not setting.is_nil:
            source = {"from_axis": change.machine.axis(setting.from_axis)} if setting.from_axis else {}
            setting.effect.act(change, change.machine.axis(setting.axis), **source, **setting.parameters)
    for name, c in change.couplings.items():
        axis = change.machine.axis(name)
        mass = reduced_mass(change.machine, axis)
        change.check_step(axis, c.cause, c.stiffness, mass)
        h = change.machine.base_tick
        # exact decay of the relative speed over a tick, stable for any damping
        rate = c.damping * h / mass
        damping = c.damping * (-math.expm1(-rate) / rate if rate > 0 else 1.0)
        change.add_term(coupling, FORCE, axis, [c.clearance / 2.0, c.stiffness, damping])
    for law, axis, parameters in change.transmission_errors:
        change.add_term(law, MEASURE, axis, [*parameters, float(axis.name in change.couplings)])
    return change


def with_effects(machine: Machine, effects: Sequence[Setting | dict[str, Any]]) -> Machine:
    """The machine with exactly these effects, as Settings or as tables {name, axis, parameters}."""
    tables = [e.table() if isinstance(e, Setting) else dict(e) for e in effects]
    changed = machine.with_effect_tables(tables)
    settings_of(changed)
    return changed


def add_effects(machine: Machine, *effects: str | Setting) -> Machine:
    """The machine with these effects in addition to its own.

    Each is 'NAME:AXIS:PARAMETER=VALUE[,PARAMETER=VALUE]' as after `--effect`, or a Setting. A value is in SI or has its unit:
    'backlash:X:clearance=15e-6', 'backlash:X:clearance=15um'.
    Raises InputError for an unknown name, axis or parameter, a value out of bounds, or a duplicate effect on an axis.
    """
    settings = [parse_setting(effect, machine) if isinstance(effect, str) else effect for effect in effects]
    return with_effects(machine, [*settings_of(machine), *settings])


@term
def constant_load_force(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += p[0]."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] += p[0]
