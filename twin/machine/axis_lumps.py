"""What a recording alone shows of an axis: its control, and its mechanics lumped in units of the recorded command."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
import math

from twin.control.actuator import EFFORTS
from twin.control.structures import INTEGRAL, NUMBERS
from twin.machine.commented import MEASURED, of_unknown_scale

LEAST_LAG_S = 0.5e-3
"""Shortest lag of a speed loop."""

ASSUMED_INTEGRAL_TIME_S = 0.02
"""Integral time of a speed controller that the recording does not show."""


@dataclass(frozen=True)
class AxisControl:
    """Control of an axis: numbers of its loops by their names in a machine file. `origin` says where these are from."""

    loops: Mapping[str, float]
    origin: str = MEASURED
    lag: float = LEAST_LAG_S  # of the speed loop
    speed_gain: float = 0.0  # command per m/s; 0: derived from the lag
    acceleration: float = 0.0  # feedforward of the acceleration, command per m/s2
    half: Mapping[str, float] = field(default_factory=dict)  # 95 % half intervals; inf: not determined by itself
    cycles: int = 1  # times that it computes from one sample to the next
    more: str = ""  # what it has beside these numbers
    blocks: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # 'block.key' -> number and half interval, unit of the file

    def __getitem__(self, name: str) -> float:
        """A number of its loops; where nothing shows it, the assumed integral time, or that of an axis without it."""
        return self.loops.get(name, ASSUMED_INTEGRAL_TIME_S if name == INTEGRAL else NUMBERS[name].absent or 0.0)

    @property
    def measured(self) -> bool:
        """Read from the control's own signals."""
        return self.origin == MEASURED

    @property
    def partly_fed(self) -> bool:
        """True if it feeds forward neither all of the speed nor nothing, as most do: its weight is a number more."""
        return self["velocity_feedforward"] not in (0.0, 1.0)

    @property
    def direct(self) -> bool:
        """True if the recorded command shows the speed controller; else its lag and integral time are tried."""
        return self.speed_gain > 0.0


SPEED_GAIN = "speed_gain"
"""Name of the half interval of a speed gain, whose key depends on the command."""

ACCELERATION = "acceleration"
"""Name of the half interval of the feedforward of the acceleration."""


def rounded_up(half: float) -> str:
    """Half width of an interval with two digits, rounded up: the written interval covers what the number covers."""
    step = 10.0 ** (math.floor(math.log10(half)) - 1) if 0.0 < half < math.inf else 1.0
    rounded = math.ceil(half / step * (1.0 - 1e-9)) * step if math.isfinite(half) else math.inf
    return f"{rounded:.0f}" if 100.0 <= rounded < 1e6 else f"{rounded:.2g}"


@dataclass(frozen=True)
class Mechanics:
    """Lumped parameters in units of the command per axis unit."""

    effort: str
    inertia: float
    coulomb: float
    viscous: float
    constant: float
    gravity: tuple[float, float]  # factors of cos q and sin q, for rotary axes
    peak: float  # the largest recorded command
    force_per_unit: float | None = None  # N or Nm per unit of the command, if a known external load gives it
    steady_speed: float | None = None  # the one speed of the recording: `coulomb` is then the whole friction there
    one_way: bool = False  # only the sum of `coulomb` and `constant` is then known
    largest_inertia: float | None = None  # the recording gives this bound only
    half: Mapping[str, float] = field(default_factory=dict)  # 95 % half intervals of inertia, coulomb, viscous
    limited: bool = False  # `peak` is the limit of the command
    between: tuple[float, float] | None = None  # bounds of the inertia as multiples, where the command may move between its samples

    def interval(self, name: str) -> str:
        """The 95 % interval of a number in words; '' if it is not known."""
        value, half = getattr(self, name), self.half.get(name)
        if half is None:
            return ""
        return f", 95 % +- {rounded_up(100.0 * half / value)} %" if value else f", 95 % below {rounded_up(half)}"

    @property
    def scale(self) -> float:
        """Factor from lumped parameters to forces; 1 if no load gives it."""
        return self.force_per_unit or 1.0

    @property
    def forces(self) -> Mechanics:
        """The same in N and kg or Nm and kg m2 if a known load gives the scale, else unchanged."""
        k = self.scale
        return replace(
            self, inertia=k * self.inertia, coulomb=k * self.coulomb, viscous=k * self.viscous, constant=k * self.constant,
            gravity=(k * self.gravity[0], k * self.gravity[1]), peak=k * self.peak,
            largest_inertia=None if self.largest_inertia is None else k * self.largest_inertia,
            half={name: k * half for name, half in self.half.items()},
        )  # fmt: skip


@dataclass(frozen=True)
class AxisLumps:
    """All identified data of an axis. `notes` name what could not be identified."""

    name: str
    kind: str
    encoder: str
    travel: tuple[float, float]
    speed: float
    acceleration: float
    period: float
    law: AxisControl
    mechanics: Mechanics | None
    noise: float
    effort_noise: float
    noise_below: float = 0.0
    """What the noise of the position, and that of the effort, is only known to be below."""
    effort_noise_below: float = 0.0
    notes: tuple[str, ...] = field(default=())
    others: tuple[AxisControl, ...] = ()  # other controls that the recording does not exclude
    held: float = 1.0  # samples in a cycle of the position controller: a whole number, or one over a whole number
    most_inertia: float = 0.0  # largest recorded effort over the highest acceleration; 0 without an effort
    friction_on_load: float | None = None  # share, of a slide with both encoders whose drive train shows it
    both_encoders: bool = False  # motor encoder and scale are recorded: motor and load are bodies of their own
    unscaled: Mapping[str, str] = field(default_factory=dict)  # signal -> stated unit that is none of motion or force, read without a scale

    @property
    def drive(self) -> str:
        """Lead and motor of a linear axis are unknown; a rotary one has a gear of 1."""
        return "direct" if self.kind == "linear" else "gear"

    @property
    def where(self) -> str:
        """The signal of the position that closes the loop."""
        return "position" if self.encoder == "scale" else "motor_position"

    @property
    def forces(self) -> Mechanics | None:
        """Mechanics in N and kg or Nm and kg m2 if a known load gives the scale, else lumped; None if unknown."""
        return self.mechanics.forces if self.mechanics else None

    @property
    def force_unit(self) -> str:
        """Unit of its forces: that of the recorded command if no force is known, "" if they are N or Nm.

        Per cent are those of the command: "0.4 % more" would be another statement.
        """
        m = self.mechanics
        if m is None or m.force_per_unit is not None:
            return ""
        own = EFFORTS[m.effort]
        stated = self.unscaled.get(m.effort, "?")
        if "%" in stated:
            return f"{stated} {m.effort}"
        return stated if stated != "?" else own.unit if own.constant else ""

    def origin(self, word: str, signals: Collection[str] = ()) -> str:
        """Comment of a number from these signals (default: all), `word` where their units are known."""
        return of_unknown_scale(word, {s: unit for s, unit in self.unscaled.items() if not signals or s in signals})
