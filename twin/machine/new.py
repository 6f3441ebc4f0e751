"""A commented machine file from an MJCF or a URDF: data of the model are computed, the other numbers are marked as assumed.

The assumed numbers give an axis that runs: a screw of 10 mm (a gear of 100), a rotor as heavy as its load, loops at 8, 50 and
400 Hz, friction of a few per cent, and a motor with twice the current for full acceleration. `twin machine check` lists them
until you replace them and delete the word from the comment.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
import math
from pathlib import Path

import mujoco
import numpy as np

from twin.control.structures import STRUCTURES
from twin.errors import InputError
from twin.files import write_whole
from twin.machine.commented import ASSUMED, Numbers, axis_lines, commented, head_lines, number_line
from twin.machine.keys import numbers_of_axis
from twin.machine.machine import load_machine
from twin.machine.model_file import check_mjcf, copy_model
from twin.machine.model_limits import compiled_spec, refuse_singular
from twin.machine.sinumerik import DATA, control_cycles, plain_values, read_machine_data
from twin.machine.urdf import JointLimits, spec_of_urdf
from twin.simulation.plant_spec import full_inertia, load_spec

CURRENT_CYCLE_S, POSITION_CYCLE_S = 125e-6, 2e-3
SPEED_LOOP_HZ = 50.0
POSITION_GAIN = 50.0
INTEGRAL_S = 0.010
SPARE_CURRENT = 2.0
CONSTANT = "motor.torque_constant_nm_per_a"


@dataclass(frozen=True)
class JointFacts:
    """Data of one joint in a model, SI at the axis."""

    name: str
    linear: bool
    travel: tuple[float, float] | None
    inertia: float  # of the load, home pose
    mass: float  # all that it moves
    weight: float  # force that holds it against gravity, home pose
    limits: JointLimits


def new_machine(
    model: Path, out: Path, structure: str = next(iter(STRUCTURES)), machine_data: Path | None = None
) -> tuple[list[str], list[str]]:
    """Write the machine file, and its MJCF beside it. Returns the axes, and the machine data that the file has no place for.

    Raises InputError if the model is not a tree of slides and hinges with masses, or if a file would be overwritten.
    """
    if out.suffix.lower() != ".toml":
        raise InputError(f"--out {out}: a machine file ends in .toml; rename it")
    if out.exists():
        raise InputError(f"{out}: exists already; give another name or remove it")
    if structure not in STRUCTURES:
        raise InputError(f"--structure {structure}: use one of {', '.join(STRUCTURES)}")
    limits: dict[str, JointLimits] = {}
    beside = out.parent / (f"{model.stem}.xml" if model.suffix.lower() == ".urdf" else model.name)
    if beside.exists() and beside.resolve() != model.resolve():
        raise InputError(f"{beside}: exists already; give another folder or remove it")
    if model.suffix.lower() == ".urdf":
        spec, limits = spec_of_urdf(model)
        facts = joint_facts(spec, limits, model)
        write_whole(beside, f"<!-- from {model.name} by: twin machine new -->\n{spec.to_xml()}")
    else:
        check_mjcf(model)
        facts = joint_facts(load_spec(model), limits, model)
        copy_model(model, out.parent)
    kinds = {f.name: "linear" if f.linear else "rotary" for f in facts}
    data, left = read_machine_data(machine_data, kinds) if machine_data else ({}, [])
    lines = _head(model, beside, facts, structure, control_cycles(data.get("", {})))
    for fact in facts:
        known = plain_values(data[fact.name], kinds[fact.name]) if fact.name in data else {}
        lines += _axis(fact, structure, known, machine_data.name if machine_data else "")
        left += [f"{d.label} of {fact.name}" for d in DATA[kinds[fact.name]] if d.key in known]
    lines += _measurement(facts)
    write_whole(out, "\n".join(lines) + "\n")
    load_machine(out)
    return [f.name for f in facts], left


def joint_facts(spec: mujoco.MjSpec, limits: Mapping[str, JointLimits], path: Path) -> list[JointFacts]:
    """Slides and hinges of a model with their load, in the order of the tree."""
    model = compiled_spec(spec, str(path))
    if model.njnt == 0:
        raise InputError(f"{path}: no slide and no hinge; a machine needs at least one axis")
    model.opt.gravity[:] = (0.0, 0.0, -9.81)
    model.dof_armature[:], model.actuator_armature[:] = 0.0, 0.0  # rotors belong to the machine file
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    refuse_singular(model, data, str(path))
    full = full_inertia(model, data)
    out = []
    for j in range(model.njnt):
        name = model.joint(j).name
        if not name:
            raise InputError(f"{path}: joint {j + 1} (body '{model.body(model.jnt_bodyid[j]).name}') has no name; an axis needs one")
        if "." in name or " " in name:
            raise InputError(f"{path}: joint '{name}': the name of an axis must not contain dots or spaces; rename it")
        dof = int(model.jnt_dofadr[j])
        linear = int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        limited = bool(model.jnt_limited[j])
        own = limits.get(name, JointLimits())
        out.append(
            JointFacts(
                name=name,
                linear=linear,
                travel=(float(model.jnt_range[j, 0]), float(model.jnt_range[j, 1])) if limited else None,
                inertia=float(full[dof, dof]),
                mass=float(model.body_subtreemass[model.jnt_bodyid[j]]),
                weight=float(data.qfrc_bias[dof]),
                limits=replace(
                    own,
                    damping=own.damping or _positive(np.ravel(model.dof_damping)[dof]),
                    friction=own.friction or _positive(model.dof_frictionloss[dof]),
                ),
            )
        )
    return out


def _positive(value: float) -> float | None:
    return float(value) if value > 0.0 else None


def _head(model: Path, beside: Path, facts: list[JointFacts], structure: str, cycles: Mapping[str, float]) -> list[str]:
    actuator = STRUCTURES[structure].actuator
    values = {
        "current_cycle_us": CURRENT_CYCLE_S * 1e6,
        "speed_cycle_us": CURRENT_CYCLE_S * 1e6,
        "position_cycle_us": POSITION_CYCLE_S * 1e6,
        **cycles,
    }
    about = (
        f"Machine file of {model.name}, begun by: twin machine new",
        "'assumed' marks a number that was assumed so that the machine runs: replace it by a value of the data sheet or your own measurement,",
        "and state its source there. For missing, impossible or unusual values run:  twin machine check FILE",
        "Units are part of the keys. Numbers from the model hold with all joints at zero.",
    )
    tolerance = (0.01, f"{ASSUMED}; tolerance of the parameters below")
    lines = [
        *head_lines(about, beside.stem, beside.name, tolerance, [f.name for f in facts]),
        commented("[control]", "cycles of the controllers"),
    ]
    for key, value in values.items():
        if key == "current_cycle_us" and key != actuator.cycle:
            continue
        lines.append(number_line(key, value, "" if key in cycles else ASSUMED))
    return lines


def _axis(f: JointFacts, structure: str, given: dict[str, float], source: str) -> list[str]:
    """Tables of one axis. `given`: values by key from machine data of the file `source`; those that the axis uses are removed."""
    speed = f.limits.speed or (0.5 if f.linear else 2.0)
    acceleration = 2.0 if f.linear else 5.0
    ratio = _ratio(f, given)
    load = f.inertia * ratio**2
    rotor = _round(load)
    friction = f.limits.friction or 0.03 * f.inertia * acceleration
    damping = f.limits.damping or 0.03 * f.inertia * acceleration / speed
    needed = (abs(f.weight) + friction + damping * speed) * ratio + (load + rotor) * acceleration / ratio
    peak = f.limits.effort * ratio if f.limits.effort else SPARE_CURRENT * needed
    of_model = f"{'from the model' if f.limits.friction or f.limits.damping else ASSUMED}, at the motor"
    screw = f'{ASSUMED}; a linear motor: drive = "direct" and the keys of docs/own_machine.md'
    numbers: Numbers = {
        "max_velocity": (speed, "from the model" if f.limits.speed else ASSUMED),
        "max_acceleration": (acceleration, ASSUMED),
        "max_jerk": (20.0 * acceleration, ASSUMED),
        "ratio": (ratio, screw if f.linear else f"{ASSUMED}; motor turns per turn of the axis"),
        **({"moving_mass_kg": (f.mass, "all that this axis moves, from the model")} if f.linear else {}),
        "rotor_inertia_kg_m2": (rotor, f"{ASSUMED}: as much as the load"),
        "coulomb_friction_nm": (_round(friction * ratio), of_model),
        "viscous_friction_nm_s_per_rad": (_round(damping * ratio**2), of_model),
    }
    command = commented('command = "torque"', "what the speed controller commands: torque, current or voltage")
    actuator = STRUCTURES[structure].actuator
    words = {
        "": [f'kind = "{"linear" if f.linear else "rotary"}"', f'structure = "{structure}"', _travel_line(f, given, source)],
        **({actuator.table: [command]} if len(actuator.commands) > 1 else {}),
    }
    own = {p.field: p.key("gear") for p in numbers_of_axis(structure, "torque")}
    constant = given.get(CONSTANT, 1.0) if CONSTANT in own else 1.0
    control = _motor(f, peak, speed / ratio, constant) | _loops(load + rotor)
    numbers |= {own[field]: number for field, number in control.items() if field in own}
    if "loops.dsc_delay_s" in given:
        numbers["loops.dsc_delay_s"] = 0.0, ASSUMED
    if given.get("commissioned.inertia_kg_m2"):  # 0 on a control without one
        numbers["commissioned_inertia"] = 0.0, ASSUMED
    return axis_lines(f.name, "screw" if f.linear else "gear", words, numbers, given, source)


def _motor(f: JointFacts, peak: float, motor_speed: float, constant: float) -> Numbers:
    """The motor. `peak` torque [Nm], highest `motor_speed` [rad/s], torque `constant` [Nm/A]."""
    of_peak = "from the model's effort" if f.limits.effort else f"{ASSUMED}: {SPARE_CURRENT:g} times full acceleration"
    emf = _round(constant / math.sqrt(3.0))
    return {
        CONSTANT: (constant, ASSUMED),
        "motor.back_emf_v_s_per_rad": (emf, f"{ASSUMED}: torque constant / sqrt(3)"),
        "motor.resistance_ohm": (0.5, ASSUMED),
        "motor.inductance_h": (5e-3, ASSUMED),
        "motor.peak_current_a": (_round(peak / constant), of_peak),
        "motor.bus_limit_v": (_round(max(300.0, 1.5 * emf * motor_speed)), ASSUMED),
    }


def _loops(inertia: float) -> Numbers:
    """Gains, feedforward and delays for an inertia at the motor [kg m2]."""
    numbers = {
        "position_gain_per_s": (POSITION_GAIN, ASSUMED),
        "speed_gain_nm_s_per_rad": (_round(2.0 * math.pi * SPEED_LOOP_HZ * inertia), f"{ASSUMED}: crossover at {SPEED_LOOP_HZ:g} Hz"),
        "speed_integral_time_s": (INTEGRAL_S, ASSUMED),
        "current_gain_v_per_a": (_round(5e-3 / (3.0 * CURRENT_CYCLE_S)), f"{ASSUMED}: amplitude optimum L / (3 T)"),
        "current_integral_time_s": (5e-3 / 0.5, f"{ASSUMED}: L / R"),
        "velocity_feedforward": (1.0, f"{ASSUMED}; weight, 0 switches off"),
        "torque_feedforward": (0.0, f"{ASSUMED}; weight, 0 switches off"),
        "position_delay_s": (0.0, f"{ASSUMED}; balances feedforward against the speed loop"),
        "feedforward_delay_s": (0.0, ASSUMED),
    }
    return {f"loops.{key}": number for key, number in numbers.items()}


def _ratio(f: JointFacts, known: Mapping[str, float]) -> float:
    """Axis units per motor radian: from machine data, else of a 10 mm screw or a gear of 100."""
    if "gear_ratio" in known:
        return 1.0 / known["gear_ratio"]
    return known.get("screw_lead_m_per_rev", 0.010) / (2.0 * math.pi) if f.linear else 0.01


def _travel_line(f: JointFacts, known: dict[str, float], source: str) -> str:
    key, factor = ("travel_m", 1.0) if f.linear else ("travel_deg", 180.0 / math.pi)
    if f"{key}.0" in known and f"{key}.1" in known:
        return commented(f"{key} = [{known.pop(key + '.0'):.9g}, {known.pop(key + '.1'):.9g}]", f"from {source}")
    if f.travel is not None:
        return commented(f"{key} = [{f.travel[0] * factor:.9g}, {f.travel[1] * factor:.9g}]", "from the model")
    return commented("travel_m = [-0.5, 0.5]", ASSUMED) if f.linear else commented('travel_deg = "endless"', "the model has no limit")


def _measurement(facts: Iterable[JointFacts]) -> list[str]:
    linear = {"linear_scale_resolution_m": 1e-8, "linear_scale_noise_m": 2e-8, "speed_noise_m_per_s": 1e-5}
    rotary = {"rotary_encoder_resolution_deg": 1e-6, "rotary_encoder_noise_deg": 2e-6, "speed_noise_deg_per_s": 1e-3}
    kinds = {f.linear for f in facts}
    numbers = {**(linear if True in kinds else {}), **(rotary if False in kinds else {}), "current_noise_a": 0.02}
    lines = ["", "[measurement]", number_line("sample_period_us", 1000.0, "of recorded traces")]
    return [*lines, *(number_line(key, value) for key, value in numbers.items())]


def _round(value: float) -> float:
    """Two significant digits, since an assumed number is not known better."""
    return float(f"{value:.2g}")
