"""MuJoCo's own system identification (`mujoco.sysid`), set up as the tests and docstrings in its wheel do.

A one-joint MJCF, a `Parameter` with a modifier for each number, `ModelSequences`, `build_residual_fn`, `optimize(optimizer="mujoco")`,
`calculate_intervals`, and the insights of its report. The recorded force drives a `motor`, as in the example of the pushed mass, in windows that
each start from the measured state, since an open-loop position would drift over a whole run. A cascade of P and PI is no actuator of MuJoCo;
the P/P control of EMPS nearly is one (`position`, with set points as in the example of the arm), but without the delay of its speed the inertia
came out 10 % off where windows give 0.5 %.
"""

from __future__ import annotations

import contextlib
import io
from typing import Any

import mujoco
import numpy as np

from twin.machine.machine import Axis

from .answer import Answer
from .inputs import Input
from .numbers import drive_force, motor_motion, numbers_of, sizes_of, with_numbers

WINDOW_S = 0.5
"""Length of a window with recorded current."""

HARD = 'solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"'
"""Solver parameters of the friction that let a joint stick. With MuJoCo's own an axis at rest creeps, its force fades, and the fit is 14 % off."""


def model_xml(axis: Axis, numbers: dict[str, float], period: float) -> str:
    """One joint with the numbers of the machine file, its motor and sensors."""
    joint = "slide" if axis.kind == "linear" else "hinge"
    return f"""<mujoco><compiler angle="radian"/><option timestep="{period}" integrator="implicitfast" gravity="0 0 0"/>
    <worldbody><body name="body"><inertial pos="0 0 0" mass="{numbers["inertia"]}" diaginertia="{3 * (str(numbers["inertia"]) + " ")}"/>
    <joint name="q" type="{joint}" axis="0 0 1" damping="{numbers["viscous_friction"]}"
     frictionloss="{numbers["coulomb_friction"]}" {HARD}/></body></worldbody>
    <actuator><motor name="drive" joint="q"/></actuator>
    <sensor><jointpos name="position" joint="q"/><jointvel name="speed" joint="q"/></sensor></mujoco>"""


def sysid_fit(one: Input) -> Answer:
    """Inertia, viscous and Coulomb friction and a constant force by `mujoco.sysid`."""
    from mujoco import sysid
    from mujoco.sysid.report.sections.insights import AutomatedInsights

    (axis,) = one.machine.axes
    start = numbers_of(one.machine)
    sizes, period = sizes_of(start), one.fitted[0].trace.period
    spec = mujoco.MjSpec.from_string(model_xml(axis, start, period))
    model = spec.compile()

    def constant(s: mujoco.MjSpec, p: Any) -> None:
        drive = s.actuator("drive")
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.biasprm[0] = -p.value[0]

    params = sysid.ParameterDict()
    modifiers = {"inertia": set_inertia, "viscous_friction": set_damping, "coulomb_friction": set_friction}
    for name, modifier in modifiers.items():
        params.add(sysid.Parameter(name, start[name], 0.2 * start[name], 5.0 * start[name], modifier=modifier))
    size = sizes["constant_force"]
    params.add(sysid.Parameter("constant_force", start["constant_force"], -3.0 * size, 3.0 * size, modifier=constant))

    names, states, controls, sensors = [], [], [], []
    for run in one.fitted:
        name, trace = axis.name, run.trace
        q, control = motor_motion(axis, trace), drive_force(axis, trace)
        v = trace.get(name, "velocity") if trace.has(name, "velocity") else np.gradient(q, period)
        length = round(WINDOW_S / period)
        for at in range(0, len(q) - length + 1, length):
            part, t = slice(at, at + length), np.arange(length) * period
            names.append(f"{run.name} {at * period:.1f} s")
            states.append(sysid.create_initial_state(model, q[at : at + 1], v[at : at + 1]))
            controls.append(sysid.TimeSeries(t, control[part, None]))
            sensors.append(sysid.TimeSeries.from_names(t, np.column_stack([q, v])[part], model))
    sequences = sysid.ModelSequences("axis", spec, names, states, controls, sensors)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    with contextlib.redirect_stdout(io.StringIO()):
        found, result = sysid.optimize(params, residual, optimizer="mujoco", verbose=False)
        left, _, _ = residual(found.as_vector(), found)
        _, half = sysid.calculate_intervals(left, result.jac)
    values = {n: float(found[n].value[0]) for n in [*modifiers, "constant_force"]}
    intervals = {n: (values[n], values[n] - h, values[n] + h) for n, h in zip(values, half.tolist())}
    insights = AutomatedInsights("log", found).get_context()["insights"]
    return Answer(with_numbers(one.machine, values), intervals, "; ".join(i["title"] for i in insights))


def set_inertia(spec: mujoco.MjSpec, parameter: Any) -> None:
    """Modifier: mass of a sliding body, inertia of a turning one. (As `armature` the friction of the joint would be too soft: MuJoCo scales it
    with the mass of the body alone.)"""
    body = spec.body("body")
    body.mass = parameter.value[0]
    body.inertia = [parameter.value[0]] * 3


def set_damping(spec: mujoco.MjSpec, parameter: Any) -> None:
    """Modifier: viscous friction, the first coefficient of the joint's damping."""
    spec.joint("q").damping[0] = parameter.value[0]


def set_friction(spec: mujoco.MjSpec, parameter: Any) -> None:
    """Modifier: Coulomb friction."""
    spec.joint("q").frictionloss = parameter.value[0]


sysid_fit.written_by_user = (model_xml, set_inertia, set_damping, set_friction, sysid_fit)  # type: ignore[attr-defined]
