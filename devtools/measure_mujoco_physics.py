"""Compares MuJoCo's springs, dead bands, LuGre friction, cogging and constraints with the twin's own terms for effects.

    python devtools/measure_mujoco_physics.py

Both act on the X axis' masses at the same tick; the reference is an integration of the equations with tight tolerance. Prints the largest
deviation of the load, and microseconds per step of the five-axis machine. docs/effects-in-mujoco.md draws the conclusions.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import ctypes
import math
import statistics
from time import perf_counter
from typing import Any

import mujoco
from numba import njit
import numpy as np
from scipy.integrate import solve_ivp

from twin.effects import load_inertia
from twin.effects.contact import bristle
from twin.effects.coupling import coupling
from twin.effects.motor import ripple
from twin.machine.machine import load_machine
from twin.simulation.engine_calls import call_address_2, engine_function_address
from twin.simulation.loop import call_terms
from twin.simulation.loop_terms import (
    FORCE,
    MAX_AXES,
    PARAMETER_COUNT,
    SIGNAL_COUNT,
    STATE_COUNT,
    X_FRICTION_FORCE,
    X_FRICTION_LEVEL,
    X_LOAD_ACCELERATION,
    X_LOAD_FORCE,
    X_LOAD_MIDDLE,
    X_LOAD_SPEED,
    X_MOTOR_TORQUE,
    X_ROTOR_FORCE,
    X_ROTOR_MIDDLE,
    X_ROTOR_SPEED,
    X_STEP,
    Term,
    term_table,
)
from twin.simulation.plant_spec import build_plant

MACHINE = load_machine()
X = MACHINE.axis("X")
LOAD, ROTOR, LEVEL = load_inertia(MACHINE, X), X.reflected_inertia, X.coulomb_friction
TICK = MACHINE.base_tick
SECONDS = 0.4


class Slides:
    """Masses on frictionless slides (one: the whole axis; two: rotor and load), advanced tick by tick under forces."""

    def __init__(self, masses: list[float], extend: Callable[[mujoco.MjSpec], None] | None = None) -> None:
        spec = mujoco.MjSpec()
        spec.option.timestep = TICK
        spec.option.gravity = [0.0, 0.0, 0.0]
        for i, mass in enumerate(masses):
            body = spec.worldbody.add_body(name=str(i), mass=mass, inertia=[1.0, 1.0, 1.0], explicitinertial=True)
            body.add_joint(name=str(i), type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0])
        if extend:
            extend(spec)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def run(self, pull: Callable[[float], float], term: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
        """(tick,) position of the last mass at the ticks, `pull(t)` acting on the first one in the middle of each step."""
        data, out = self.data, []
        before = np.zeros(self.model.nv)
        for k in range(round(SECONDS / TICK)):
            out.append(data.qpos[-1] - 0.5 * TICK * data.qvel[-1])
            data.qfrc_applied[:] = 0.0 if term is None else term(np.stack([data.qpos, data.qvel, (data.qvel - before) / TICK]))
            data.qfrc_applied[0] += pull((k + 0.5) * TICK)
            before = data.qvel.copy()
            mujoco.mj_step(self.model, data)
        return np.array(out)


def our_term(law: Any, parameters: list[float]) -> Callable[[np.ndarray], np.ndarray]:
    """The compiled term as a function from (quantity, mass) [position ahead, speed, acceleration] to forces (mass,)."""
    call = ctypes.CFUNCTYPE(None, *[ctypes.POINTER(ctypes.c_double)] * 3, ctypes.c_int64)(law.address)
    p, s, x = np.zeros(PARAMETER_COUNT), np.zeros(STATE_COUNT), np.zeros((MAX_AXES, SIGNAL_COUNT))
    p[: len(parameters)] = parameters
    pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in (p, s, x)]

    def force(state: np.ndarray) -> np.ndarray:
        row = x[0]
        row[[X_LOAD_FORCE, X_FRICTION_FORCE, X_ROTOR_FORCE, X_MOTOR_TORQUE]] = 0.0
        row[X_STEP], row[X_FRICTION_LEVEL] = TICK, LEVEL
        row[X_LOAD_MIDDLE], row[X_LOAD_SPEED], row[X_LOAD_ACCELERATION] = state[:, -1]
        row[X_ROTOR_MIDDLE], row[X_ROTOR_SPEED] = state[:2, 0]
        call(*pointers, 0)
        if state.shape[1] == 2:
            return np.array([row[X_ROTOR_FORCE], row[X_LOAD_FORCE]])
        return np.array([row[X_LOAD_FORCE] + row[X_FRICTION_FORCE] + row[X_MOTOR_TORQUE] / X.ratio])

    return force


def truth(rate: Callable[[float, np.ndarray], list[float]], size: int, of: int) -> np.ndarray:
    """(tick,) component `of` of the exact solution from rest."""
    times = np.arange(round(SECONDS / TICK)) * TICK
    return solve_ivp(rate, (0.0, SECONDS), np.zeros(size), t_eval=times, rtol=1e-9, atol=1e-13, max_step=TICK).y[of]


def coupling_rows() -> list[tuple[str, float, float]]:
    """Spring and dead band between rotor and load: our term, and a tendon with springlength = -+ clearance / 2."""
    reduced = LOAD * ROTOR / (LOAD + ROTOR)
    rows = []
    for name, hz, clearance, ratio in (
        ("compliance 50 Hz", 50.0 * math.sqrt(LOAD / reduced), 0.0, 0.08),
        ("backlash 15 um, damped", 450.0, 15e-6, 0.3),
        ("backlash 15 um, no damper", 450.0, 15e-6, 0.0),
    ):
        k = (2 * math.pi * hz) ** 2 * reduced
        c = 2 * ratio * math.sqrt(k * reduced)

        def pull(t: float) -> float:
            return 2000.0 * math.sin(2 * math.pi * 6.0 * t)

        def rate(t: float, y: np.ndarray, k: float = k, c: float = c, half: float = clearance / 2) -> list[float]:
            q_m, q_l, v_m, v_l = y
            d = q_m - q_l
            force = 0.0 if abs(d) <= half and half > 0 else k * (d - math.copysign(half, d)) + c * (v_m - v_l)
            return [v_m, v_l, (pull(t) - force) / ROTOR, force / LOAD]

        def tendon(spec: mujoco.MjSpec, k: float = k, c: float = c, half: float = clearance / 2) -> None:
            t = spec.add_tendon(stiffness=[k, 0.0, 0.0], damping=[c, 0.0, 0.0], springlength=[-half, half])
            t.wrap_joint("0", 1.0)
            t.wrap_joint("1", -1.0)

        exact = truth(rate, 4, 1)
        damping = c * (-math.expm1(-c * TICK / reduced) / (c * TICK / reduced) if c else 1.0)
        ours = Slides([ROTOR, LOAD]).run(pull, our_term(coupling, [clearance / 2, k, damping]))
        theirs = Slides([ROTOR, LOAD], tendon).run(pull)
        rows.append((name, np.abs(ours - exact).max(), np.abs(theirs - exact).max()))
    return rows


def friction_rows() -> list[tuple[str, float, float]]:
    """LuGre friction: our bristle, and the lugre of a passive dcmotor."""
    mass, rows = LOAD + ROTOR, []
    for name, reach, damping_ratio, force, hz in (
        ("LuGre below break-away", 10e-6, 0.3, 0.7, 6.0),
        ("LuGre, breaking away and back", 10e-6, 0.3, 1.6, 6.0),
        ("LuGre, stiff (4 um), 0.1 m/s", 4e-6, 0.3, 12.0, 5.0),
    ):
        k = LEVEL / reach
        c = 2 * damping_ratio * math.sqrt(k * mass)

        def pull(t: float, force: float = force, hz: float = hz) -> float:
            return force * LEVEL * math.sin(2 * math.pi * hz * t)

        def rate(t: float, y: np.ndarray, k: float = k, c: float = c, pull: Callable[[float], float] = pull) -> list[float]:
            _, v, z = y
            bent = v - k * abs(v) * z / LEVEL
            return [v, (pull(t) - k * z - c * bent) / mass, bent]

        def motors(spec: mujoco.MjSpec, k: float = k, c: float = c) -> None:
            a = spec.add_actuator(name="f", target="0", trntype=mujoco.mjtTrn.mjTRN_JOINT)
            a.set_to_dcmotor(
                motorconst=[1e-9, 1e-9], resistance=1.0, lugre=[k, c, LEVEL, LEVEL, 1e-3], ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE)
            )

        exact = truth(rate, 3, 0)
        ours = Slides([mass]).run(pull, our_term(bristle, [k, c]))
        theirs = Slides([mass], motors).run(pull)
        rows.append((name, np.abs(ours - exact).max(), np.abs(theirs - exact).max()))
    return rows


def ripple_row() -> tuple[str, float, float]:
    """Cogging: our ripple, and that of a passive dcmotor."""
    mass, n = LOAD + ROTOR, 6.0 / X.ratio
    amplitude = 0.3 / X.ratio

    def pull(t: float) -> float:
        return 900.0 if t < 0.2 else 0.0

    def rate(t: float, y: np.ndarray) -> list[float]:
        return [y[1], (pull(t) + amplitude * math.sin(n * y[0] + 0.4)) / mass]

    def motors(spec: mujoco.MjSpec) -> None:
        a = spec.add_actuator(name="f", target="0", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        passive = int(mujoco.mjtCtrlInput.mjINPUT_NONE)
        a.set_to_dcmotor(motorconst=[1e-9, 1e-9], resistance=1.0, cogging=[amplitude, n, 0.4], ctrlspec=passive)

    exact = truth(rate, 2, 0)
    ours = Slides([mass]).run(pull, our_term(ripple, [0.3, n, 0.4]))
    theirs = Slides([mass], motors).run(pull)
    return "cogging 0.3 Nm, 6 a turn", np.abs(ours - exact).max(), np.abs(theirs - exact).max()


@njit(nogil=True)
def _steps(step, model, data, count):  # type: ignore[no-untyped-def]
    for _ in range(count):
        call_address_2(step, model, data)


@njit(nogil=True)
def _terms(terms, signals, count):  # type: ignore[no-untyped-def]
    for _ in range(count):
        signals[:, X_LOAD_FORCE] = 0.0
        call_terms(terms, FORCE, signals)


def step_rows(repeats: int = 40, block: int = 400) -> list[tuple[str, float, str]]:
    """Microseconds per step of the five-axis machine: medians over alternating blocks."""

    def tendons(spec: mujoco.MjSpec) -> None:
        for name in ("X", "Y"):
            t = spec.add_tendon(stiffness=[8e7, 0.0, 0.0], damping=[1e4, 0.0, 0.0], springlength=[-1e-5, 1e-5])
            t.wrap_joint(f"{name}.rotor", 1.0)
            t.wrap_joint(name, -1.0)

    def equalities(spec: mujoco.MjSpec) -> None:
        for name in ("X", "Y"):
            e = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=f"{name}.rotor", name2=name, objtype=mujoco.mjtObj.mjOBJ_JOINT)
            e.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]

    def motors(spec: mujoco.MjSpec) -> None:
        for name in ("X", "Y"):
            a = spec.add_actuator(name=f"{name}.friction", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            passive = int(mujoco.mjtCtrlInput.mjINPUT_NONE)
            a.set_to_dcmotor(
                motorconst=[1e-9, 1e-9],
                resistance=1.0,
                cogging=[100.0, 3000.0, 0.0],
                lugre=[1e8, 1e5, 1100.0, 1100.0, 1e-3],
                ctrlspec=passive,
            )

    split = ("X", "Y")
    plants = {
        "five axes": build_plant(MACHINE),
        "with rotor joints on X and Y": build_plant(MACHINE, split_axes=split),
        "with rotor joints and tendons": build_plant(MACHINE, [tendons], split),
        "with rotor joints and equality constraints": build_plant(MACHINE, [equalities], split),
        "five axes with lugre and cogging on X and Y": build_plant(MACHINE, [motors]),
    }
    step = engine_function_address("mj_step")
    times: dict[str, list[float]] = {name: [] for name in plants}
    for _ in range(repeats):
        for name, plant in plants.items():
            mujoco.mj_resetData(plant.model, plant.data)
            plant.data.qvel[:] = 0.05
            begin = perf_counter()
            _steps(step, plant.model._address, plant.data._address, block)
            times[name].append((perf_counter() - begin) / block * 1e6)
    rows = [(name, statistics.median(values[1:]), "us a step") for name, values in times.items()]
    for name, law, parameters in (
        ("our coupling term", coupling, [1e-5, 8e7, 1e4]),
        ("our bristle term", bristle, [1e8, 1e5]),
        ("our ripple term", ripple, [0.3, 3000.0, 0.0]),
    ):
        terms, signals = term_table([Term(law, FORCE, 0, parameters)], 5), np.full((5, SIGNAL_COUNT), 1e-2)
        _terms(terms, signals, 10)
        spent = []
        for _ in range(repeats):
            begin = perf_counter()
            _terms(terms, signals, 10_000)
            spent.append((perf_counter() - begin) / 10_000 * 1e6)
        rows.append((name, statistics.median(spent), "us a tick"))
    return rows


def constraint_violation() -> float:
    """Largest rotor minus load [m] when an equality constraint transmits the acceleration of the axis (2.5 m/s2 of 700 kg)."""

    def equality(spec: mujoco.MjSpec) -> None:
        e = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1="0", name2="1", objtype=mujoco.mjtObj.mjOBJ_JOINT)
        e.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]
        # the stiffest value that the solver allows: two ticks
        e.solref, e.solimp = [2 * TICK, 1.0], [0.9999, 0.9999, 0.001, 0.5, 2.0]

    slides = Slides([ROTOR, LOAD], equality)
    worst = 0.0
    for _ in range(800):
        slides.data.qfrc_applied[0] = 2.5 * (ROTOR + LOAD)
        mujoco.mj_step(slides.model, slides.data)
        worst = max(worst, abs(slides.data.qpos[0] - slides.data.qpos[1]))
    return worst


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    print("largest deviation of the load from the exact motion, um")
    print(f"{'':34s}{'our term':>12s}{'MuJoCo':>12s}")
    for name, ours, theirs in [*coupling_rows(), *friction_rows(), ripple_row()]:
        print(f"{name:34s}{ours * 1e6:12.5f}{theirs * 1e6:12.5f}")
    print(f"\n{constraint_violation() * 1e6:.2g} um  rotor minus load in an equality constraint (a rigid axis has none)\n")
    for name, value, unit in step_rows():
        print(f"{value:8.3f} {unit:10s} {name}")


if __name__ == "__main__":
    main()
