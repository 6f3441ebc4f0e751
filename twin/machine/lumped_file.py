"""Machine file from a recording alone. The comment of each number says whether it was measured, lumped, tried or assumed."""

from collections.abc import Sequence
import math
from pathlib import Path
from xml.sax.saxutils import escape

from twin.control.actuator import EFFORTS
from twin.control.actuator import SPEED_GAIN as SPEED_GAIN_KEY
from twin.control.speed_controller import MEAN_CYCLES
from twin.control.structures import INTEGRAL, NUMBERS, ideal_structure
from twin.documents import toml_text
from twin.files import write_whole
from twin.machine.axis_lumps import ACCELERATION, SPEED_GAIN, AxisLumps, Mechanics, rounded_up
from twin.machine.commented import ASSUMED, BOUNDED, MEASURED, OF_SUM, TRIED, Numbers, axis_lines, commented, head_lines, number_line
from twin.machine.keys import NOISE, SMALLEST
from twin.machine.parameters import file_from_typed

LUMP = "lump"
BY_LOAD = "measured by the recorded external load"
ROOM = 1.5
"""Factor from recorded to permitted speed and acceleration."""
PEAK_ROOM, LIMIT_ROOM = 4.0, 1.5
"""Factors from the recorded peak command, and from the command at the permitted speed and acceleration, to its limit. The recording need
not reach the limit, and a limit set too low adds a fault."""
TRAVEL_ROOM_M = 2.0
LEAST_SPEED = {"linear": 1.0, "rotary": 2.0 * math.pi}
"""Least permitted speed of an axis [m/s, rad/s], because another recording may be faster."""
SMALL_FORCE = 0.02
"""A constant force below this share of the peak command is omitted."""
UNKNOWN_MASS = 1.0
"""Where no effort is recorded [kg, kg m2]: the recording gives forces no scale."""
G = 9.81

NO_BOUND = 100.0
"""A bound of a mass at so many times what its samples give says nothing."""

PRINTED = 5e-9
"""Largest part of a number that its nine digits leave out."""


def write_lumped_machine(out: Path, lumps: Sequence[AxisLumps], source: str) -> None:
    """Write the machine file and, beside it, its model; `source` names the recording."""
    model = out.with_suffix(".xml")
    bodies = "\n".join(_body(one, i) for i, one in enumerate(lumps))
    lines = [*_head(out, model, lumps, source), *(line for one in lumps for line in _axis(one)), *_measurement(lumps)]
    write_whole(model, _MODEL.format(name=_xml(out.stem), source=_xml(source), bodies=bodies))
    write_whole(out, "\n".join(lines) + "\n")


_MODEL = """<mujoco model="{name}">
  <!-- Lumped axes of the recording {source}, side by side: the recording does not show how they carry each other. -->
  <compiler angle="radian" inertiafromgeom="false"/>
  <worldbody>
{bodies}
  </worldbody>
</mujoco>
"""


def _head(out: Path, model: Path, lumps: Sequence[AxisLumps], source: str) -> list[str]:
    period = whole_cycle(lumps[0].period)
    measured = any(one.law.measured for one in lumps)
    whole = all(one.law.direct for one in lumps)
    held = min(one.held for one in lumps) if any(one.held < 1.0 for one in lumps) else max(one.held for one in lumps)
    cycle = held * period if measured or held != 1.0 else _part_of(period, 4e-3)
    shortest = min(cycle, period)
    speed = shortest if whole else _part_of(shortest, 125e-6)
    about = (
        f"Machine of the recording {source}, made by: twin machine new --from-recording",
        "There is no data sheet. 'lump' marks a lumped parameter: referred to the axis, in units of the recorded command, with a torque",
        "constant of 1 in place of torque constant, gear and lead. Only ratios between lumped parameters are meaningful, not their values.",
        "'measured' comes from the recording alone. 'tried' was chosen so that the simulated axis follows like the recorded one.",
        f"'{ASSUMED}' is an assumption: replace it if you know better.",
    )
    tolerance = (0.05, f"{ASSUMED}; tolerance of the lumped parameters between recordings")
    part = f"1/{round(1.0 / held)} of the recorded cycle, by the moment of the feedforward in the recorded speed set point"
    lines = [
        *head_lines(about, out.stem, model.name, tolerance, [one.name for one in lumps]),
        "[control]",
        number_line("speed_cycle_us", speed * 1e6, "the recorded cycle" if whole else ASSUMED),
        number_line("position_cycle_us", cycle * 1e6, ("the recorded cycle" if held >= 1.0 else part) if measured else ASSUMED),
    ]
    if measured and held >= 1.0:
        lines.append(commented('setpoint_interpolation = "linear"', "a delay of half a cycle is the mean of two set points"))
    return lines


def whole_cycle(period: float) -> float:
    """A recorded period as a whole number of nanoseconds in each of its speed cycles, so that the file's digits hold it exactly."""
    count = round(period / _part_of(period, 125e-6))
    return count * round(period / count * 1e9) * 1e-9


def _part_of(period: float, longest: float) -> float:
    """The longest integer fraction of a period that does not exceed `longest`."""
    return period / math.ceil(period / longest - 1e-9)


def _axis(one: AxisLumps) -> list[str]:
    linear, m, vertical = one.kind == "linear", one.forces, _hangs(one)
    per = "m" if linear else "rad"
    unit = one.force_unit or "Nm"
    lumped = one.origin(LUMP)
    if m and m.force_per_unit is not None:
        unit, lumped = "N" if linear else "Nm", one.origin(BY_LOAD)
    inertia = _inertia(one)
    size = "half of what the recorded effort can accelerate" if one.most_inertia else "no recorded effort gives its size"
    lump = f"{lumped}: {unit} per {per}/s2" if m else f"{ASSUMED}: {size}"
    if m and m.between:
        low, high = ((inertia + sign * m.half.get("inertia", 0.0)) * factor for sign, factor in zip((-1.0, 1.0), m.between))
        lump = (
            f"{BOUNDED}: {lump}, between {low:.3g} and {high:.3g} by what the {m.effort} does between its samples; record 4 samples a cycle"
        )
    elif m:
        lump += m.interval("inertia")
    if m and m.largest_inertia is not None:
        largest = m.largest_inertia * (m.between[1] if m.between else 1.0)
        bound = f"{BOUNDED}: below {largest:.3g} {unit} per {per}/s2, " if largest < NO_BOUND * m.largest_inertia else ""
        lump = f"{bound}{ASSUMED} {inertia:.3g}; record accelerations{'' if bound else ' and more samples'}"
    speed, acceleration = _permitted(one)
    limited = one.mechanics is not None and one.mechanics.limited
    numbers = {
        "max_velocity": (speed, f"{ASSUMED}; recorded: {60.0 * one.speed / (1.0 if linear else 2.0 * math.pi):.3g}"),
        "max_acceleration": (acceleration, f"{ASSUMED}: {'what the limit leaves' if limited else f'{ROOM:g} times the recorded'}"),
        "max_jerk": (50.0 * acceleration, ASSUMED),
    }
    words = [*(f"# {note}" for note in one.notes), f'kind = "{one.kind}"']
    if one.force_unit:
        words.append(commented(f"force_unit = {toml_text(one.force_unit)}", "that of the recorded command: no force is known"))
    loops = _loops(one, one.mechanics.inertia if one.mechanics else inertia)
    words.append(
        commented(
            f'structure = "{ideal_structure(loops)}"',
            "no current loop: the lag of the actuator stands for it, or that of the speed controller",
        )
    )
    shown = "" if one.law.measured or not one.both_encoders else f"{ASSUMED}: "
    encoder = commented(f'encoder = "{one.encoder}"', f"{shown}closes the position loop")
    if linear:
        low, high = one.travel[0] - TRAVEL_ROOM_M, one.travel[1] + TRAVEL_ROOM_M
        travel = commented(f"travel_m = [{low:.6g}, {high:.6g}]", f"{ASSUMED}: the recorded travel plus {TRAVEL_ROOM_M:g} m at each end")
        words += [commented('drive = "direct"', "lead and motor are unknown: all numbers refer to the axis"), encoder, travel]
        carried = _carried(one)
        if vertical:
            weighed = f"{lump}; {OF_SUM}, if all of its constant force is weight: no counterbalance, no one-way friction"
            numbers["moving_mass_kg"] = carried, weighed
            numbers["rotor_inertia_kg_m2"] = inertia - carried, weighed
        elif one.both_encoders:
            words.append(f"# {ASSUMED}: {MOTOR_PART:.0%} of the mass are at the motor, the rest at the load; the recording shows the sum")
            if (part := one.friction_on_load) is not None:
                side = "the deflection of the drive train goes with acceleration and friction"
                words.append(commented(f'friction_side = "{"load" if part >= 0.5 else "motor"}"', f"most of it: {side}"))
                numbers["other_side_friction"] = min(part, 1.0 - part), f"{BOUNDED}: {side}, and with play"
            numbers["moving_mass_kg"] = carried, f"{lump}; {OF_SUM}"
            numbers["rotor_inertia_kg_m2"] = inertia - carried, f"{lump}; {OF_SUM}"
        else:
            numbers["moving_mass_kg"] = inertia, lump
    else:
        words += [encoder, commented('travel_deg = "endless"', ASSUMED)]
        numbers["ratio"] = 1.0, "the gear is unknown: all numbers refer to the axis"
        numbers["rotor_inertia_kg_m2"] = inertia * (1.0 - _BODY_PART), f"{lump}; the other {_BODY_PART:.0%} are in the model"
    numbers |= _friction(m, inertia, lumped, unit, per)
    if m and not vertical and abs(m.constant) >= SMALL_FORCE * m.peak:
        said = f"{BOUNDED if m.one_way else lumped}: {unit}; one recording cannot separate weight, counterbalance and one-way friction"
        numbers["constant_torque_nm"] = m.constant, said
    if one.law.acceleration:
        scale, said = one.mechanics.scale if one.mechanics else 1.0, one.origin(one.law.origin)
        fed = scale * one.law.acceleration
        said = _with_interval(fed, said, scale * one.law.half.get(ACCELERATION, 0.0)) if one.law.half else said
        numbers["commissioned_inertia"] = fed, f"{said}; what the control feeds forward, at the axis"
    numbers |= _actuator(one) | {f"loops.{key}": number for key, number in loops.items()}
    command = commented(f'command = "{m.effort}"', "as recorded") if m else 'command = "torque"'
    tables = {"": words, "actuator": [command]}
    for path, (value, half) in one.law.blocks.items():
        block, key = path.split(".")
        tables.setdefault(f"block.{block}", []).append(number_line(key, value, _about_block(value, half)))
    return axis_lines(one.name, one.drive, tables, numbers, {}, "")


def _inertia(one: AxisLumps) -> float:
    """The inertia of an axis; of one whose effort shows none, half of what the effort can accelerate."""
    return one.forces.inertia if one.forces else 0.5 * one.most_inertia or UNKNOWN_MASS


def _about_block(value: float, half: float) -> str:
    """Origin of a number of a block with the half width of its interval."""
    if math.isinf(half):
        return f"{TRIED}: the nearest that this block can do; the recorded signal holds more"
    return f"{MEASURED}, 95 % +- {rounded_up(half)}" if half < abs(value) else _NOT_ALONE


def _friction(m: Mechanics | None, inertia: float, lumped: str, unit: str, per: str) -> Numbers:
    """Coulomb and viscous friction; a sum that the recording does not separate stands in one of them."""
    if m is None:
        return dict.fromkeys(("coulomb_friction_nm", "viscous_friction_nm_s_per_rad"), (0.02 * inertia, ASSUMED))
    coulomb, viscous = f"{lumped}: {unit}{m.interval('coulomb')}", f"{lumped}: {unit} per {per}/s{m.interval('viscous')}"
    if m.one_way:
        coulomb = f"{BOUNDED}: {unit}, its sum with the constant {'force' if per == 'm' else 'torque'} is known; record both directions"
    if m.steady_speed:
        coulomb = f"{coulomb}, with the viscous friction at {m.steady_speed:.3g} {per}/s"
        viscous = f"{ASSUMED}: its sum with Coulomb friction is known"
    return {"coulomb_friction_nm": (m.coulomb, coulomb), "viscous_friction_nm_s_per_rad": (m.viscous, viscous)}


def _permitted(one: AxisLumps) -> tuple[float, float]:
    """Permitted speed and acceleration of an axis: behind a known limit the recorded speed, and what it leaves for acceleration there."""
    if one.mechanics and one.mechanics.limited:
        left = one.mechanics.peak / LIMIT_ROOM - _force(one.mechanics, one.speed, 0.0)
        return one.speed, max(left, SMALL_FORCE * one.mechanics.peak) / one.mechanics.inertia
    return max(ROOM * one.speed, LEAST_SPEED[one.kind]), ROOM * max(one.acceleration, 0.1)


def _force(m: Mechanics, speed: float, acceleration: float) -> float:
    """What an axis takes at most at a speed and an acceleration, in units of the command."""
    return m.inertia * acceleration + m.coulomb + m.viscous * speed + abs(m.constant) + math.hypot(*m.gravity)


def _peak(one: AxisLumps, m: Mechanics) -> tuple[float, str]:
    """Limit of the command and its comment: beyond the recorded one, and enough for what the axis is permitted."""
    if m.limited:
        return m.peak, "measured: the command stands there where its law asks for more"
    speed, acceleration = _permitted(one)
    full = _force(m, speed, acceleration)
    if LIMIT_ROOM * full > PEAK_ROOM * m.peak:
        return LIMIT_ROOM * full, f"{ASSUMED}: {LIMIT_ROOM:g} times what the permitted speed and acceleration take; recorded: {m.peak:.3g}"
    return PEAK_ROOM * m.peak, f"{ASSUMED}: {PEAK_ROOM:g} times the recorded"


def _actuator(one: AxisLumps) -> Numbers:
    """Constant and limit of the command."""
    m = one.mechanics
    if m is None:
        return {EFFORTS["torque"].peak.key(one.drive): (20.0 * _inertia(one) * max(one.acceleration, 0.1), ASSUMED)}
    effort = EFFORTS[m.effort]
    said = f"{LUMP}: everything between command and motion is one number, {ASSUMED} 1" if m.force_per_unit is None else BY_LOAD
    return {**{p.key(one.drive): (m.scale, said) for p in effort.constant[:1]}, effort.peak.key(one.drive): _peak(one, m)}


def _loops(one: AxisLumps, inertia: float) -> Numbers:
    """Gains and delays; a speed gain is given per unit of the command."""
    law = one.law
    known = (SPEED_GAIN_KEY, *EFFORTS[one.mechanics.effort if one.mechanics else "torque"].gains)
    gain = [key for p in known if (key := p.key(one.drive))][-1].removeprefix("loops.")
    said = law.origin
    grade = ASSUMED if said == ASSUMED else TRIED
    tried = f"{grade}: {LUMP} over a lag of {law.lag * 1e3:.3g} ms"
    numbers: dict[str, tuple[float, str]] = {
        "position_gain_per_s": (law["position_gain_per_s"], said),
        gain: (law.speed_gain, one.origin(MEASURED)) if law.speed_gain else (inertia / law.lag, tried),
        INTEGRAL: (law[INTEGRAL], MEASURED if law.direct else grade),
        MEAN_CYCLES: (law[MEAN_CYCLES], "measured: the speed is a difference of positions this many cycles apart"),
        "velocity_feedforward": (law["velocity_feedforward"], said),
        "position_delay_s": (law["position_delay_s"], said),
        "feedforward_delay_s": (law["feedforward_delay_s" if law.measured else "position_delay_s"], said),
        "dsc_delay_s": (law["dsc_delay_s"], "measured: the drive closes the position loop and gets the command this late"),
    }
    half = {gain if n == SPEED_GAIN else n: h for n, h in law.half.items() if n != ACCELERATION}
    numbers |= {n: (numbers[n][0], _with_interval(*numbers[n], h)) for n, h in half.items()}
    if law.acceleration:
        numbers["torque_feedforward"] = 1.0, f"{said}: the control feeds forward what it was commissioned with"
    return {n: found for n, found in numbers.items() if n == gain or not NUMBERS[n].is_absent(found[0])}


def _with_interval(value: float, said: str, half: float) -> str:
    """The comment of a number of the control with its 95 % interval."""
    return f"{said}, 95 % +- {rounded_up(max(half, PRINTED * abs(value)))}" if math.isfinite(half) else _NOT_ALONE


_NOT_ALONE = f"{BOUNDED}: one of many that fit with the other numbers of the position controller; runs with and without feedforward decide"

_BODY_PART = 0.1
"""Share of a rotary inertia that is in the model."""

MOTOR_PART = 0.5
"""Share of the inertia of a slide with two encoders that is taken to be at the motor. A recording shows the sum, play and a spring between them need both."""


def _carried(one: AxisLumps) -> float:
    """Mass of a slide: its weight if it hangs, the load's part if two encoders show motor and load, else the whole inertia."""
    m = one.forces
    if _hangs(one) and m:
        return m.constant / G
    inertia = _inertia(one)
    return inertia * (1.0 - MOTOR_PART) if one.both_encoders else inertia


def _hangs(one: AxisLumps) -> bool:
    """True if the constant force of a slide is its weight: motion both ways separates it from friction, and the inertia permits it."""
    m = one.forces
    if m is None or one.kind != "linear" or m.one_way:
        return False
    return 0.05 * m.peak < m.constant < 0.9 * m.inertia * G


def _body(one: AxisLumps, i: int) -> str:
    """A slide or a hinge with a box as its shape."""
    m, name, vertical = one.forces, _xml(one.name), _hangs(one)
    inertia = _inertia(one)
    if one.kind == "linear":
        mass = _carried(one)
        x, z, moment = 0.0, 0.0, max(1e-6, 1e-3 * mass)
        joint = f'type="slide" axis="{"0 0 1" if vertical else "1 0 0"}"'
    else:  # gravity that turns with the axis: a mass off the axis, with a small part of the inertia
        own = _BODY_PART * inertia
        cosine, sine = m.gravity if m and math.hypot(*m.gravity) > SMALL_FORCE * m.peak else (0.0, 0.0)
        weight = math.hypot(cosine, sine) / G
        mass = max(weight**2 / (0.5 * own), own) if weight else max(own, 1e-6)
        x, z = -cosine / (mass * G), -sine / (mass * G)
        moment = max(own - mass * (x * x + z * z), 0.1 * own)
        joint = 'type="hinge" axis="0 1 0"'
    return (
        f'    <body name="{name}_body" pos="0 {0.4 * i:.3g} 0">\n'
        f'      <inertial pos="{x:.9g} 0 {z:.9g}" mass="{mass:.9g}" diaginertia="{moment:.6g} {moment:.6g} {moment:.6g}"/>\n'
        f'      <joint name="{name}" {joint}/>\n'
        '      <geom type="box" size="0.1 0.1 0.05" rgba="0.10 0.30 0.55 1" contype="0" conaffinity="0" group="2"/>\n    </body>'
    )


def _measurement(lumps: Sequence[AxisLumps]) -> list[str]:
    lines = ["", "[measurement]                              # noise of single samples in the quietest part of the recording"]
    lines.append(number_line("sample_period_us", whole_cycle(lumps[0].period) * 1e6, "the recorded period"))
    for kind, keys in NOISE.items():
        own = [one for one in lumps if one.kind == kind]
        for key, encoder in ((keys["position"], "scale"), (keys["motor"], "motor")):
            if seen := [(one.noise, one.noise_below) for one in own if one.encoder == encoder]:
                word, noise = _of_noise(key, *max(seen))
                lines.append(number_line(key, noise, max((one.origin(word, ("position", "motor_position")) for one in own), key=len)))
    seen = [(one.effort_noise, one.effort_noise_below) for one in lumps if one.mechanics and one.mechanics.effort == "current"]
    if seen:
        word, noise = _of_noise("current_noise_a", *max(seen))
        lines.append(number_line("current_noise_a", noise, word))
    return lines


def _of_noise(key: str, noise: float, below: float) -> tuple[str, float]:
    """Origin of a noise [SI] and its value in the file; `below`: what the recording does not show to be noise."""
    value, most = (file_from_typed(key, number) for number in (noise, below))
    return MEASURED if noise > below else f"{BOUNDED}: below {rounded_up(most)} by this recording", value if value >= SMALLEST else 0.0


def _xml(text: str) -> str:
    return escape(text, {'"': "&quot;", "--": "- -"})
