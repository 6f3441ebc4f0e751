"""The decoupled plant: independent axes in closed form, about ten times faster than MuJoCo, for fits and screening.

Each axis, and each rotor with its own joint, takes the same step as in MuJoCo, per tick h:

    a  = (F - b(t) - D v) / M(t)                    free acceleration under drive force, bias and viscous friction
    f  = clip(-(a + B v) / (1/M + R), +-level)      Coulomb force of MuJoCo's soft constraint
    v += h (M a + f) / (M + h D);  q += h v         semi-implicit Euler, viscous friction implicit

Inertia M(t) and bias b(t) (gravity, Coriolis, acceleration of coupled axes) come from the MJCF, evaluated along a known motion: the
nominal run. An effect changes that motion by micrometres only. The compiled loop is the same as for MuJoCo; only the address of the step
function differs. A test compares the decoupled plant with MuJoCo.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
import functools
import threading
from typing import Any

import mujoco
from numba import carray, types
import numpy as np

from twin.compiled_functions import compiled, compiled_callback
from twin.effects import Change
from twin.machine.machine import Machine
from twin.simulation import loop
from twin.simulation.axis_table import axis_table
from twin.simulation.engine_calls import call_address_2, call_address_3, call_address_4, engine_function_address
from twin.simulation.plant_spec import Plant, build_plant, inertial_key

# Unsigned: the compiled step would ask of each signed index whether it counts from the end, a third of its instructions.
_0, _1, _2, _PER_DOF, _VECTORS = np.array([0, 1, 2, 4, 12], np.uint64)
# layout of the constants: header, constants of each degree of freedom, series
_H, _COUNT, _ROWS, _ROW_TICKS, _RUNNING = np.arange(5, dtype=np.uint64)
_HEADER: Any = np.uint64(5)
_VISCOUS, _REFERENCE, _SOFTNESS, _GEAR = np.arange(4, dtype=np.uint64)
# layout of the state: header, one vector per quantity
_TICK = _0
_QPOS, _QVEL, _CTRL, _APPLIED, _BIAS, _PASSIVE, _CONSTRAINT, _LEVEL, _MASS, _INVERSE, _YIELDING, _ADVANCE = np.arange(12, dtype=np.uint64)

SERIES_PERIOD = 2e-3
"""Sample period of inertia and bias along the motion [s]."""


@dataclass(frozen=True)
class Motion:
    """A known motion of all axes: position, speed, acceleration, each (sample, axis) in SI, and the sample period [s].

    `loads` caches inertia and bias of the models evaluated along it.
    """

    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    period: float
    loads: OrderedDict[object, _Loads] = field(default_factory=OrderedDict, repr=False)
    parts: dict[tuple[int, ...], Motion] = field(default_factory=dict, repr=False)

    def part(self, axes: tuple[int, ...]) -> Motion:
        """The motion of some axes, by index; cached."""
        if axes not in self.parts:
            index = list(axes)
            self.parts[axes] = Motion(self.position[:, index], self.speed[:, index], self.acceleration[:, index], self.period)
        return self.parts[axes]


@dataclass(frozen=True)
class _Loads:
    """Loads of a compiled model along a motion: inertia, bias and friction constants."""

    inertia: np.ndarray  # (row, axis) without rotor
    bias: np.ndarray  # (row, axis)
    row_ticks: float
    reference: np.ndarray  # B of the friction constraint
    softness: np.ndarray  # R of the friction constraint

    def of(self, axes: Sequence[int]) -> _Loads:
        """Loads of some axes, by index."""
        return _Loads(self.inertia[:, axes], self.bias[:, axes], self.row_ticks, self.reference[axes], self.softness[axes])


class _Memory:
    """Constants and state of all degrees of freedom in the layout of the compiled step, with the engine views of the loop."""

    def __init__(
        self,
        header: tuple[float, float, float],
        constants: np.ndarray,
        inertia: np.ndarray,
        bias: np.ndarray,
        vectors: np.ndarray,
        load: np.ndarray,
        rotor: np.ndarray,
        friction: np.ndarray,
    ) -> None:
        """`header`: base tick [s], ticks per row of the series, first tick. `constants` (dof, _PER_DOF), series (row, dof), `vectors`
        (_VECTORS, dof); `load`, `rotor` and `friction` (axis,) are the degrees of freedom of each axis."""
        tick, row_ticks, first_tick = header
        rows, dofs = inertia.shape
        self.header, self.constants, self.inertia, self.bias = header, constants, inertia, bias
        self.load, self.rotor, self.friction = load, rotor, friction
        self._constants = np.concatenate([[tick, dofs, rows, row_ticks, dofs], constants.ravel(), inertia.ravel(), bias.ravel()])
        self._state = np.concatenate([[first_tick], vectors.ravel()])
        self.vectors = v = self._state[1:].reshape(_VECTORS, dofs)
        levels = loop.friction_levels(v[_LEVEL], load, rotor, friction)
        self.engine = loop.Engine(
            step=_step_address(),
            model=self._constants.ctypes.data,
            data=self._state.ctypes.data,
            qpos=v[_QPOS],
            qvel=v[_QVEL],
            ctrl=v[_CTRL],
            applied=v[_APPLIED],
            bias=v[_BIAS],
            passive=v[_PASSIVE],
            constraint=v[_CONSTRAINT],
            frictionloss=v[_LEVEL],
            places=axis_table(loop.Places(*levels, load, load, rotor, rotor, friction, rotor)),
        )

    def keep(self, plants: Sequence[DecoupledPlant]) -> None:
        """Advance only these plants, the first of those that were joined, from now on."""
        self._constants[_RUNNING] = sum(len(plant._memory.constants) for plant in plants)


class DecoupledPlant:
    """Independent axes along a known motion; same interface to the loop as `twin.simulation.mujoco_plant.MujocoPlant`."""

    def __init__(self, change: Change, motion: Motion, carried_by: Machine | None = None) -> None:
        """`motion` covers the axes of `change`, or those of `carried_by`, a machine that also has the axes that carry them."""
        axes = change.machine.axes
        loads = loads_along(change, motion, carried_by)
        if carried_by is not None:
            loads = loads.of([carried_by.axis_names.index(axis.name) for axis in axes])
        n = len(axes)
        split = [a for a, axis in enumerate(axes) if axis.name in change.couplings]
        dofs = n + len(split)
        reflected = np.array([axis.reflected_inertia for axis in axes])

        constants = np.zeros((dofs, _PER_DOF))
        constants[:n, _VISCOUS] = [axis.viscous_friction for axis in axes]
        constants[:n, _REFERENCE] = loads.reference
        constants[:n, _SOFTNESS] = loads.softness
        constants[:n, _GEAR] = [1.0 / axis.ratio for axis in axes]
        rows = len(loads.inertia) + 1
        inertia, bias = np.empty((rows, dofs)), np.zeros((rows, dofs))
        inertia[:-1, :n] = loads.inertia + reflected
        bias[:-1, :n] = loads.bias
        inertia[-1], bias[-1] = inertia[-2], bias[-2]  # values after the end of the motion
        vectors = np.zeros((_VECTORS, dofs))
        vectors[_LEVEL, :n] = [axis.coulomb_friction for axis in axes]
        load, rotor, friction = (np.arange(n, dtype=np.uint64) for _ in range(3))
        for i, a in enumerate(split):
            # the softness of the friction constraint is inversely proportional to the inertia, here without the rotor
            constants[a, _SOFTNESS] *= inertia[0, a] / loads.inertia[0, a]
            inertia[:, a] -= reflected[a]
            inertia[:, n + i] = reflected[a]
            constants[n + i] = (0.0, 1.0, 1.0, 1.0 / axes[a].ratio)
            rotor[a] = n + i
            friction[a] = n + i if axes[a].friction_side == "motor" else a
            constants[n + i, _REFERENCE] = constants[a, _REFERENCE]
            constants[n + i, _SOFTNESS] = constants[a, _SOFTNESS] * loads.inertia[0, a] / reflected[a]
            for dof, side in ((a, "load"), (n + i, "motor")):
                constants[dof, _VISCOUS] = axes[a].friction_share(side) * axes[a].viscous_friction
                vectors[_LEVEL, dof] = axes[a].friction_share(side) * axes[a].coulomb_friction
        header = (change.machine.base_tick, loads.row_ticks, -float(change.lead_ticks))
        self._split = split
        self._memory = _Memory(header, constants, inertia, bias, vectors, load, rotor, friction)
        self.start_bias = loads.bias[0]
        self.engine = self._memory.engine

    @property
    def times(self) -> tuple[float, float, float]:
        """Base tick [s], ticks per row of the loads, first tick. Plants with equal values can be joined."""
        return self._memory.header

    def place_at_rest(self, start: np.ndarray, constant_force: np.ndarray, change: Change) -> np.ndarray:
        """Place load and rotor at `start` (axis,); returns the holding force at each axis."""
        held = self.start_bias - constant_force
        self.engine.qpos[: len(start)] = start
        for a in self._split:
            self.engine.qpos[self.engine.places.rotor_position[a]] = start[a] + change.rotor_offset(a, float(held[a]))
        return held


def joined(plants: Sequence[DecoupledPlant]) -> _Memory:
    """Several decoupled plants of equal `times` as one, in their current state. A plant keeps its last loads after the end of its motion."""
    parts = [plant._memory for plant in plants]
    first = np.cumsum([0, *(part.inertia.shape[1] for part in parts)], dtype=np.uint64)
    rows = max(len(part.inertia) for part in parts)

    def side_by_side(series: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([np.pad(values, ((0, rows - len(values)), (0, 0)), mode="edge") for values in series], axis=1)

    return _Memory(
        parts[0].header,
        np.concatenate([part.constants for part in parts]),
        side_by_side([part.inertia for part in parts]),
        side_by_side([part.bias for part in parts]),
        np.concatenate([part.vectors for part in parts], axis=1),
        *(np.concatenate([getattr(part, name) + at for part, at in zip(parts, first)]) for name in ("load", "rotor", "friction")),
    )


_MAX_CACHED = 64
_lock = threading.Lock()


def loads_along(change: Change, motion: Motion, machine: Machine | None = None) -> _Loads:
    """Loads of a changed machine, or of `machine` with its edits, along a motion; cached, because a fit needs the same loads many times."""
    machine = machine or change.machine
    # the loads do not depend on friction or drives; effects change them only by editing the model
    key = (inertial_key(machine), tuple(change.model_edits), machine.base_tick)
    with _lock:
        known = motion.loads.get(key)
    if known is not None:
        return known
    plant = build_plant(machine, change.model_edits)
    model = plant.model
    constant = _is_constant(plant, motion)
    inertia, bias = _along(plant, motion, constant)
    impedance = float(model.dof_solimp[0, 1])
    every = max(1, round(SERIES_PERIOD / motion.period))
    loads = _Loads(
        inertia=inertia + model.dof_armature[plant.load_dof],
        bias=bias,
        row_ticks=1e9 if constant else every * motion.period / machine.base_tick,
        reference=2.0 / (impedance * np.maximum(model.dof_solref[plant.load_dof, 0], 2.0 * machine.base_tick)),
        softness=(1.0 - impedance) / impedance * model.dof_invweight0[plant.load_dof],
    )
    with _lock:
        motion.loads[key] = loads
        while len(motion.loads) > _MAX_CACHED:
            motion.loads.popitem(last=False)
    return loads


def _along(plant: Plant, motion: Motion, constant: bool) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal inertia of the loads, without rotors and armature, and bias, each (row, axis), along a motion.

    The bias holds gravity, Coriolis forces and the coupling forces of other axes' accelerations.
    """
    model, data = plant.model, plant.data
    axes = len(plant.load_dof)
    rows = np.zeros(2, int) if constant else np.arange(0, len(motion.position), max(1, round(SERIES_PERIOD / motion.period)))
    inertia, bias = np.empty((len(rows), axes)), np.empty((len(rows), axes))
    gear = model.actuator_gear[plant.actuator, 0]
    own = model.actuator_armature[plant.actuator] * gear**2 + model.dof_armature[plant.load_dof]
    _read_along(
        tuple(engine_function_address(name) for name in ("mj_kinematics", "mj_comPos", "mj_makeM", "mj_comVel")),
        engine_function_address("mj_rne"),
        engine_function_address("mj_fullM"),
        model._address,
        data._address,
        (data.qpos, data.qvel, data.qfrc_bias, np.zeros((model.nv, model.nv))),
        (plant.load_position, plant.load_dof),
        (motion.position[rows], motion.speed[rows], motion.acceleration[rows]),
        own,
        inertia,
        bias,
    )
    return inertia, bias


@compiled
def _read_along(stages, forces, full_inertia, model, data, views, places, motion, own, inertia, bias):  # type: ignore[no-untyped-def]
    """Fill inertia and bias (row, axis) along the motion by the required stages of MuJoCo's forward dynamics."""
    qpos, qvel, engine_bias, full = views
    load_position, load_dof = places
    position, speed, acceleration = motion
    for row in range(len(position)):
        for a in range(len(own)):
            qpos[load_position[a]] = position[row, a]
            qvel[load_dof[a]] = speed[row, a]
        for stage in stages:
            call_address_2(stage, model, data)
        call_address_4(forces, model, data, 0, engine_bias.ctypes.data)  # mj_rne at zero acceleration
        call_address_3(full_inertia, model, data, full.ctypes.data)
        for a in range(len(own)):
            i = load_dof[a]
            inertia[row, a] = full[i, i] - own[a]
            bias[row, a] = engine_bias[i]
            for b in range(len(own)):
                if b != a:
                    bias[row, a] += full[i, load_dof[b]] * acceleration[row, b]


def _is_constant(plant: Plant, motion: Motion) -> bool:
    """Whether no hinge moves, so that inertia and gravity forces are constant."""
    model = plant.model
    hinges = [a for a, dof in enumerate(plant.load_dof) if model.jnt_type[model.dof_jntid[dof]] == mujoco.mjtJoint.mjJNT_HINGE]
    return not hinges or bool(np.ptp(motion.position[:, hinges], axis=0).max() < 1e-4)


_Pointer = types.CPointer(types.float64)


def decoupled_step(constants_pointer: Any, state_pointer: Any) -> None:
    """Advance the degrees of freedom of the plants that run by one tick, by the law in the module docstring."""
    header: Any = carray(constants_pointer, (_HEADER,))
    h = header[_H]
    n = np.uint64(header[_COUNT])
    rows = np.uint64(header[_ROWS])
    constants = carray(constants_pointer, (_HEADER + _PER_DOF * n + _2 * rows * n,))
    state = carray(state_pointer, (_1 + _VECTORS * n,))
    at = max(state[_TICK] + 0.5, 0.0) / header[_ROW_TICKS]
    row = min(np.uint64(at), rows - _2)
    part = min(at - np.float64(row), 1.0)
    masses = _HEADER + _PER_DOF * n + row * n
    biases = masses + rows * n
    for i in range(np.uint64(header[_RUNNING])):
        c = _HEADER + _PER_DOF * i
        mass = constants[masses + i] + part * (constants[masses + n + i] - constants[masses + i])
        bias = constants[biases + i] + part * (constants[biases + n + i] - constants[biases + i])
        v = state[_1 + _QVEL * n + i]
        viscous = constants[c + _VISCOUS]
        if mass != state[_1 + _MASS * n + i]:  # three divisions take longer than the rest; most masses do not change
            state[_1 + _MASS * n + i] = mass
            state[_1 + _INVERSE * n + i] = 1.0 / mass
            state[_1 + _YIELDING * n + i] = 1.0 / (1.0 / mass + constants[c + _SOFTNESS])
            state[_1 + _ADVANCE * n + i] = h / (mass + h * viscous)
        passive = -viscous * v
        free = state[_1 + _CTRL * n + i] * constants[c + _GEAR] + state[_1 + _APPLIED * n + i] - bias + passive
        level = state[_1 + _LEVEL * n + i]
        friction = 0.0
        if level > 0.0:
            friction = -(free * state[_1 + _INVERSE * n + i] + constants[c + _REFERENCE] * v) * state[_1 + _YIELDING * n + i]
            friction = min(max(friction, -level), level)
        v += (free + friction) * state[_1 + _ADVANCE * n + i]
        state[_1 + _QVEL * n + i] = v
        state[_1 + _QPOS * n + i] += h * v
        state[_1 + _BIAS * n + i] = bias
        state[_1 + _PASSIVE * n + i] = passive
        state[_1 + _CONSTRAINT * n + i] = friction
    state[_TICK] += 1.0


@functools.cache
def _step_address() -> int:
    return int(compiled_callback(types.void(_Pointer, _Pointer), decoupled_step).address)
