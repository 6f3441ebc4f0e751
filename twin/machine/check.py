"""Findings about a machine file: missing, impossible and unusual values, one line each with the numbers; the margins that are asked of its loops.

missing      a number that `twin machine new` assumed and nobody has replaced, or that a check needs
impossible   the axis cannot reach its own full acceleration or highest speed, hold its weight, or be stable
unusual      outside the usual range for machines of this class; the finding states the rule
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math

from twin.control.linear import Loop
from twin.control.speed_controller import differentiation
from twin.effects.change import held_force, load_inertia
from twin.machine.commented import UNSURE, guessed_values
from twin.machine.loops import Margins, first_mode, loops_of, margins_of
from twin.machine.machine import Axis, Machine
from twin.simulation.plant_spec import home_inertia_at_motor, load_spec
from twin.units import AXIS_UNITS

LEAST_PHASE_DEG = {"current": 40.0, "speed": 40.0, "position": 50.0}
LEAST_GAIN = 2.0
"""Smallest margins of a loop that does not ring: usual rules of control engineering (40 to 60 degrees, 6 dB)."""

LEAST_RATIO = 3.0
"""An inner loop should be at least this many times faster than the next outer one."""

MOST_PEAK = 1.3
"""Largest peak of the closed position loop; above it the position overshoots the set point."""

MOST_INERTIA_RATIO = 10.0
LEAST_MODE_RATIO = 2.0
"""Largest ratio of load to rotor inertia, and smallest ratio of first mode to speed-loop crossover: common rules of drive sizing."""

LARGEST_SHARE = 0.8
"""Share of a limit that full acceleration or highest speed may use."""

LEAST_STEPS = 10.0
"""A following error at a hundredth of the highest speed should be at least this many encoder steps."""

SLOW_SHARE = 0.01
MOST_INERTIA_ERROR = 0.2

ASKED_GRID = 600
"""Margins are located on so many frequencies while a gain is sought."""


@dataclass(frozen=True)
class Asked:
    """Smallest margins of speed and position loop: phase [deg] by loop, gain [1]."""

    phase: Mapping[str, float] = field(default_factory=lambda: dict(LEAST_PHASE_DEG))
    gain: float = LEAST_GAIN
    peak: float = MOST_PEAK
    """Largest gain of the closed position loop."""

    def shortfalls(self, name: str, m: Margins, word: str = "asked") -> Iterator[str]:
        """What a loop of this name falls short of, in words; of an unstable one nothing else."""
        if not m.stable:
            yield f"the {name} loop is unstable"
            return
        if m.phase < self.phase[name]:
            yield f"the {name} loop has a phase margin of {m.phase:.0f} degrees at {m.crossover:.3g} Hz; {self.phase[name]:g} are {word}"
        if m.gain < self.gain:
            found, least = (20.0 * math.log10(gain) for gain in (m.gain, self.gain))
            yield f"the {name} loop has a gain margin of {found:.1f} dB at {m.phase_crossing:.3g} Hz; {round(least, 1):g} dB are {word}"
        if name == "position" and m.peak > self.peak:
            yield f"the closed position loop peaks at {m.peak:.2f}; above {self.peak:g} it overshoots"

    def missed(self, loop: Loop) -> str:
        """The first of them; '' for nothing."""
        return next(self.shortfalls(loop.name, margins_of(loop, ASKED_GRID)), "")

    def missed_by(self, machine: Machine, axis: str) -> str:
        """The same for speed and position loop of an axis."""
        return next((text for loop in loops_of(machine, machine.axis(axis))[-2:] if (text := self.missed(loop))), "")


def asked_of(phase_deg: float | None, gain_db: float) -> Asked:
    """The margins that the user gives; without a phase those of `twin machine check`."""
    return Asked(dict(LEAST_PHASE_DEG) if phase_deg is None else dict.fromkeys(LEAST_PHASE_DEG, phase_deg), 10.0 ** (gain_db / 20.0))


@dataclass(frozen=True)
class Finding:
    """One finding. Level: missing, impossible or unusual. Axis: '' for the whole machine."""

    level: str
    axis: str
    text: str


@dataclass(frozen=True)
class AxisCheck:
    """The loops of an axis with their margins, and numbers of its drive in the home pose."""

    axis: Axis
    loops: tuple[Loop, ...]
    margins: tuple[Margins, ...]
    inertia: float  # kg m2 at the motor, home pose
    inertia_ratio: float  # load to rotor; inf if the rotor is unknown
    holding: float  # effort that holds the weight [A, V, Nm]
    accelerating: float  # effort of full acceleration with friction and weight
    voltage: float  # at highest speed with friction [V]; for a motor with a winding
    first_mode_hz: float | None


def check_axis(machine: Machine, axis: Axis) -> AxisCheck:
    """Check of one axis in the home pose."""
    inertia = float(home_inertia_at_motor(machine)[machine.axis_names.index(axis.name)])
    loops = tuple(loops_of(machine, axis, inertia))
    held = (held_force(machine, axis) + axis.constant_force) * axis.ratio
    friction = axis.coulomb_friction_nm + axis.viscous_friction_nm_s_per_rad * axis.max_velocity / axis.ratio
    constant = axis.motor.torque_constant_nm_per_a
    speed = axis.max_velocity / axis.ratio
    rotor = axis.rotor_inertia_kg_m2
    return AxisCheck(
        axis=axis,
        loops=loops,
        margins=tuple(margins_of(loop) for loop in loops),
        inertia=inertia,
        inertia_ratio=load_inertia(machine, axis) * axis.ratio**2 / rotor if rotor > 0.0 else math.inf,
        holding=abs(held) / constant,
        accelerating=(abs(held) + friction + inertia * axis.max_acceleration / axis.ratio) / constant,
        voltage=axis.motor.back_emf_v_s_per_rad * speed + axis.motor.resistance_ohm * (abs(held) + friction) / constant,
        first_mode_hz=first_mode(machine, axis),
    )


def check_machine(machine: Machine) -> tuple[list[AxisCheck], list[Finding]]:
    """Checks of all axes, and the findings with the worst first."""
    checks = [check_axis(machine, axis) for axis in machine.axes]
    guessed = unmeasured(machine)
    findings = [*_machine_findings(machine, guessed)]
    for check in checks:
        gains = [name for (_, axis), names in guessed.items() if axis == check.axis.name for name in names if "gain" in name]
        for level, text in _axis_findings(machine, check, gains):
            findings.append(Finding(level, check.axis.name, text))
    order = ("impossible", "missing", "unusual")
    return checks, sorted(findings, key=lambda f: order.index(f.level))


def unmeasured(machine: Machine) -> dict[tuple[str, str], list[str]]:
    """(grade, axis) -> the numbers of the axis ('': of the machine) that are only assumed, tried, bounded or unscaled."""
    out: dict[tuple[str, str], list[str]] = {}
    for path, word in sorted(guessed_values(machine, UNSURE).items(), key=lambda found: UNSURE.index(found[1])):
        axis, name = path.split(".", 2)[1:] if path.startswith("axis.") else ("", path)
        out.setdefault((word, axis), []).append(name)
    return out


def _machine_findings(machine: Machine, guessed: Mapping[tuple[str, str], Sequence[str]]) -> Iterator[Finding]:
    for (word, axis), names in guessed.items():
        of = "" if axis else " of the machine"
        which = f"1 number{of} is" if len(names) == 1 else f"{len(names)} numbers{of} are"
        yield Finding("missing", axis, f"{which} still {word}: {', '.join(names)}")
    noiseless = [a.name for a in machine.axes if not any(vars(machine.noise(a)).values())]
    if noiseless:
        yield Finding(
            "missing",
            "",
            f"[measurement] has neither noise nor resolution for {', '.join(noiseless)}: simulations are free of noise; "
            "gap and diagnosis take the noise from the record",
        )
    driven = set(machine.axis_names)
    still = [joint.name for joint in load_spec(machine.model_path).joints if joint.name not in driven]
    if still:
        yield Finding("unusual", "", f"joints without a drive stand still: {', '.join(still)}")


def _axis_findings(machine: Machine, c: AxisCheck, guessed_gains: Sequence[str]) -> Iterator[tuple[str, str]]:
    axis, motor, loops = c.axis, c.axis.motor, c.axis.loops
    effort, unit = axis.effort, axis.effort_unit
    # limits of the drive
    if c.holding > motor.peak_current_a:
        yield "impossible", f"holding its weight takes {c.holding:.3g} {unit}, the {effort} limit is {motor.peak_current_a:g} {unit}"
    elif c.accelerating > motor.peak_current_a:
        # what is left of the limit after weight and friction
        per_acceleration = c.inertia / axis.ratio / motor.torque_constant_nm_per_a
        reached = max(motor.peak_current_a - c.accelerating + per_acceleration * axis.max_acceleration, 0.0) / per_acceleration
        yield (
            "impossible",
            f"full acceleration takes {c.accelerating:.3g} {unit}, the {effort} limit is {motor.peak_current_a:g} {unit}: "
            f"{reached:.3g} of {axis.max_acceleration:.3g} {'m' if axis.kind == 'linear' else 'rad'}/s2 can be reached",
        )
    elif c.accelerating > LARGEST_SHARE * motor.peak_current_a:
        share = c.accelerating / motor.peak_current_a
        text = f"full acceleration takes {share * 100:.0f} % of the {effort} limit; above {LARGEST_SHARE * 100:.0f} % the loops have no reserve"
        yield "unusual", text
    if c.voltage > motor.bus_limit_v:
        yield "impossible", f"the highest speed takes {c.voltage:.3g} V, the bus gives {motor.bus_limit_v:g} V"
    elif c.voltage > LARGEST_SHARE * motor.bus_limit_v:
        yield "unusual", f"the highest speed takes {c.voltage / motor.bus_limit_v * 100:.0f} % of the bus voltage"
    if c.inertia_ratio > MOST_INERTIA_RATIO and math.isfinite(c.inertia_ratio):
        text = f"the load's inertia is {c.inertia_ratio:.1f} times the rotor's; above {MOST_INERTIA_RATIO:g} a drive is hard to tune"
        yield "unusual", text
    commissioned = axis.commissioned_inertia
    if commissioned is not None and loops.acceleration_weight and abs(commissioned / c.inertia - 1.0) > MOST_INERTIA_ERROR:
        text = f"torque feedforward was commissioned with {commissioned:.3g} kg m2, {commissioned / c.inertia:.2f} times the model's {c.inertia:.3g}"
        yield "unusual", text
    if c.holding > 1e-9 and (sag := loops.sag(held_force(machine, axis) + axis.constant_force, axis.ratio)):
        error, factor = AXIS_UNITS[axis.kind].error
        text = f"the speed controller has no integral part: the force that holds it causes a following error of {sag * factor:.3g} {error}"
        yield "unusual", text
    for level, text in _loop_findings(c):
        yield level, f"{text} (not measured: {', '.join(guessed_gains)})" if guessed_gains else text
    # mechanics and measuring system compared with the loops
    speed = c.margins[-2]
    if c.first_mode_hz is None:
        if axis.rotor_inertia_kg_m2 > 0.0:
            text = "no stiffness between motor and load (effect transmission_compliance): the first mode cannot be compared with the speed loop"
            yield "missing", text
    elif c.first_mode_hz < LEAST_MODE_RATIO * speed.crossover:
        text = f"the first mode of {c.first_mode_hz:.0f} Hz is less than {LEAST_MODE_RATIO:g} times the crossover of the speed loop, {speed.crossover:.0f} Hz"
        yield "unusual", text
    yield from _encoder_findings(machine, axis)


def _loop_findings(c: AxisCheck) -> Iterator[tuple[str, str]]:
    for loop, m in zip(c.loops, c.margins):
        for text in Asked().shortfalls(loop.name, m, "usual"):
            yield "unusual" if m.stable else "impossible", text
        if m.stable and not math.isfinite(m.crossover):
            yield "unusual", f"the gain of the {loop.name} loop never reaches 1: it has no effect"
    for (inner, fast), (outer, slow) in zip(list(zip(c.loops, c.margins))[:-1], list(zip(c.loops, c.margins))[1:]):
        ratio = fast.crossover / slow.crossover if math.isfinite(slow.crossover) else math.inf
        if fast.stable and slow.stable and ratio < LEAST_RATIO:
            yield (
                "unusual",
                f"the {inner.name} loop crosses at {fast.crossover:.3g} Hz, {ratio:.1f} times the {outer.name} loop's {slow.crossover:.3g} Hz; "
                f"{LEAST_RATIO:g} times are usual",
            )


def _encoder_findings(machine: Machine, axis: Axis) -> Iterator[tuple[str, str]]:
    noise = machine.noise(axis)
    resolution = noise.motor_resolution if axis.encoder == "motor" else noise.position_resolution
    error, factor = AXIS_UNITS[axis.kind].error
    slow = SLOW_SHARE * axis.max_velocity
    following = slow * (1.0 / axis.loops.position_gain_per_s + axis.loops.set_point_delay_s)
    if resolution > following / LEAST_STEPS:
        yield (
            "unusual",
            f"an encoder step is {resolution * factor:.3g} {error}; the following error at a hundredth of the highest speed is "
            f"{following * factor:.3g} {error}, fewer than {LEAST_STEPS:g} steps",
        )
    n, rate = differentiation(axis.loops, machine.speed_cycle)
    if n and noise.motor_resolution:
        step = noise.motor_resolution * rate / axis.ratio * axis.loops.speed_gain_nm_s_per_rad
        if step > 0.5 * axis.coulomb_friction_nm:
            share = step / axis.coulomb_friction_nm if axis.coulomb_friction_nm else math.inf
            text = f"one encoder step, differentiated over {n} cycles, causes {share:.1f} times the Coulomb friction: the axis hums at rest"
            yield "unusual", text
