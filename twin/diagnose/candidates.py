"""Where to start each effect: a few settings per effect and axis, from its usual sizes and from spectra of the residual.

A start is simulated once; its size is then scaled linearly, and effects with a phase are combined from sine and cosine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import itertools
import math
from typing import ClassVar

import numpy as np

from twin.diagnose.observe import Group
from twin.effects import EFFECTS, Effect, Setting
from twin.effects.effect import Parameter
from twin.machine.machine import Axis, Machine

PEAKS = 2
"""Spectral lines that are tried for an effect that repeats along position or time."""

CLIPPED = (0.85, 0.96, 0.99, 1.02, 1.05, 1.08)
"""Levels of a clipped current as shares of the largest that was measured."""

LARGEST_ORDER_HZ = 60.0
"""Above this frequency the current no longer shows a disturbance as it is."""

SLOW_ENOUGH = 0.1
"""Share of the motion that must be slow enough for a wave along the travel to be looked for: a short lead turns fast."""


_SAMPLED = {"set_point_filter": "position_cycle", "current_filter": "current_cycle"}
"""First-order lags, and the cycle c at which they are sampled: they delay by c / (exp(c / T) - 1), next to nothing below half a cycle."""


@dataclass(frozen=True)
class Start:
    """Settings to simulate, and how to read them: one setting, or a sine and a cosine of the same effect."""

    settings: tuple[Setting, ...]

    @property
    def effect(self) -> Effect:
        return self.settings[0].effect

    @property
    def axis(self) -> str:
        return self.settings[0].axis

    @property
    def key(self) -> tuple[str, str, str | None]:
        """Effect, axis and from_axis: what makes a candidate."""
        return self.settings[0].key


def size_parameter(effect: Effect) -> Parameter:
    """The parameter that says how large the effect is: the one with a neutral value."""
    return (
        next(p for p in effect.parameters if p.neutral is not None and not p.shape)
        if any(p.neutral is not None and not p.shape for p in effect.parameters)
        else next(p for p in effect.parameters if p.neutral is not None)
    )


def deviation_of(parameter: Parameter, value: float) -> float:
    """How far a value is from doing nothing; an angle is known as an angle."""
    if parameter.periodic:
        return 1.0
    neutral = parameter.neutral if parameter.neutral is not None and math.isfinite(parameter.neutral) else 0.0
    return abs(value - neutral)


def is_scaled(parameter: Parameter) -> bool:
    """True where the answer is in proportion to the deviation from neutral (springs and limits are not)."""
    return parameter.neutral is not None and math.isfinite(parameter.neutral)


def is_lag(effect: Effect) -> bool:
    """True where the size is the time constant of a sampled lag: what it delays may be far less."""
    return effect.name in _SAMPLED


def is_spring(effect: Effect) -> bool:
    """True where the size is a stiffness: what the effect does is about in proportion to 1 / stiffness."""
    return size_parameter(effect).name == "stiffness"


def starts_of(group: Group, machine: Machine, residual: np.ndarray) -> list[Start]:
    """All starts of all effects on the axes of a group; `residual` (row,) weighted, for the spectra."""
    starts = []
    for name in group.axes:
        axis = machine.axis(name)
        lines = _Lines(group, machine, axis, residual)
        for effect in EFFECTS.values():
            if axis not in effect.axes(machine):
                continue
            sources = [a.name for a in effect.axes(machine) if a.name != name] if effect.from_axis else [None]
            for source in sources:
                for values in _values(effect, machine, axis, lines):
                    starts.append(_start(effect, machine, axis, source, values))
    return starts


def _start(effect: Effect, machine: Machine, axis: Axis, source: str | None, values: dict[str, float]) -> Start:
    shaped = {p.name: p.default for p in effect.parameters if p.default is not None}
    shaped |= {p.name: p.fitted(machine, axis, {**shaped, **values}) for p in effect.parameters if p.fitted is not None}
    settings = [Setting(effect, axis.name, {**shaped, **values}, source)]
    phase = next((p for p in effect.parameters if p.periodic and p.shape), None)
    if phase:
        settings = [Setting(effect, axis.name, {**shaped, **values, phase.name: angle}, source) for angle in (0.0, math.pi / 2)]
    return Start(tuple(settings))


def _values(effect: Effect, machine: Machine, axis: Axis, lines: _Lines) -> list[dict[str, float]]:
    """Start values of the parameters that are not shape."""
    choices: list[list[tuple[str, float]]] = []
    size = size_parameter(effect)
    for p in effect.parameters:
        if p.shape and p is not size:
            continue
        low, high = p.usual_range(machine, axis)
        if p.name == "limit_a":
            values = lines.current_levels()
        elif (effect.name, p.name) in lines.scanned:
            values = lines.peaks(effect.name)
        elif p is size and is_scaled(p):
            values = _sizes(effect, p, low, high)
        elif p.periodic:
            values = [i * math.pi / 3 for i in range(6)]
        elif p.logarithmic:
            values = list(np.geomspace(low / 1.5, high * 1.5, 5)) if p is size else list(np.geomspace(low, high, 3))
        else:
            values = [0.5 * (low + high)]
        choices.append([(p.name, float(v)) for v in values])
    return [dict(combination) for combination in itertools.product(*choices)]


def _sizes(effect: Effect, p: Parameter, low: float, high: float) -> list[float]:
    """One usual size, or one on either side of neutral where the answer bends."""
    neutral = p.neutral or 0.0
    if p.name == "factor":
        if low < neutral < high:
            return [neutral + 0.5 * (low - neutral), neutral + 0.5 * (high - neutral)]
        return [0.5 * (low + high)]
    if low < neutral < high:
        return [0.5 * high, 0.5 * low] if effect.name == "loop_delay" else [0.5 * high]
    if p.logarithmic:
        return [float(v) for v in np.geomspace(low, high, 3)] if effect.name == "backlash" else [math.sqrt(low * high)]
    return [0.5 * (low + high)]


class _Lines:
    """Spectral lines of an axis' residual: along the motor's turn, along the travel, in time, and of a frame that swings."""

    scanned: ClassVar = {
        ("torque_ripple", "periods_per_rev"),
        ("position_dependent_friction", "wavelength"),
        ("periodic_disturbance", "frequency_hz"),
        ("frame_vibration", "frequency_hz"),
    }

    def __init__(self, group: Group, machine: Machine, axis: Axis, residual: np.ndarray):
        self.group, self.axis = group, axis
        self.values = residual / group.weights
        self.channels = {}
        for channel in group.channels:
            if channel.axis == axis.name:
                self.channels[channel.run, channel.name] = channel
        self.machine = machine

    def peaks(self, effect: str) -> list[float]:
        """The strongest values of the scanned parameter."""
        scan = {
            "torque_ripple": self._along_turn,
            "position_dependent_friction": self._along_travel,
            "periodic_disturbance": self._in_time,
            "frame_vibration": self._frame,
        }[effect]
        values, power = scan()
        return _strongest(values, power)

    def current_levels(self) -> list[float]:
        """Levels at which a clipped current would show: about the largest that was measured.

        A record samples the saw-tooth that the current is between two cycles at one place of it: the limit may lie above.
        """
        level = 0.0
        for (run, name), _ in self.channels.items():
            trace = self.group.views[run].trace
            if name == "current":
                level = max(level, float(np.quantile(np.abs(trace.get(self.axis.name, self.axis.effort)), 0.9995)))
        level = level or 0.3 * self.axis.motor.peak_current_a
        return [share * level for share in CLIPPED]

    def _pieces(self, name: str):  # type: ignore[no-untyped-def]
        """Per run: residual, position, speed at the channel's samples."""
        for (run, channel_name), channel in self.channels.items():
            if channel_name != name:
                continue
            view = self.group.views[run]
            a = view.machine.axis_names.index(self.axis.name)
            values = self.values[channel.rows]
            q, v = view.motion.position[:, a], view.motion.speed[:, a]
            t = view.trace.time - view.trace.time[0]
            if name in ("current", "windup"):
                moving = view.reference(self.axis.name)[2]
                q, v, t = q[moving], v[moving], t[moving]
            yield values, q, v, t

    def _along_turn(self) -> tuple[np.ndarray, np.ndarray]:
        return self._along(signed=False, low=0.5, high=40.0, per=2.0 * math.pi * self.axis.ratio, inverse=False)

    def _along_travel(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = EFFECTS["position_dependent_friction"].parameter("wavelength").usual_range(self.machine, self.axis)
        return self._along(signed=True, low=1.0 / (3.0 * high), high=3.0 / low, per=1.0, inverse=True)

    def _along(self, signed: bool, low: float, high: float, per: float, inverse: bool) -> tuple[np.ndarray, np.ndarray]:
        """Spectrum of the current's residual over position: bins of an eighth of the shortest wave, then a Fourier transform."""
        parts = list(self._pieces("current"))
        if not parts:
            return np.array([1.0]), np.array([0.0])
        bin_width = per / high / 8.0
        start = min(float(q.min()) for _, q, _, _ in parts)
        count = int((max(float(q.max()) for _, q, _, _ in parts) - start) / bin_width) + 2
        if count > 400_000:
            return np.array([1.0]), np.array([0.0])
        total, hits = np.zeros(count), np.zeros(count)
        speeds, top = np.abs(np.concatenate([v for _, _, v, _ in parts])), high
        while top > 4.0 * low and np.mean(speeds * top / 4.0 / per < LARGEST_ORDER_HZ) < SLOW_ENOUGH:
            top /= 2.0
        for values, q, v, _ in parts:
            slow = np.abs(v) * top / 4.0 / per < LARGEST_ORDER_HZ
            index = ((q[slow] - start) / bin_width).astype(int)
            weighted = (values - np.median(values))[slow] * (np.sign(v[slow]) if signed else 1.0)
            np.add.at(total, index, weighted)
            np.add.at(hits, index, 1.0)
        mean = np.where(hits > 0, total / np.maximum(hits, 1.0), 0.0) * np.sqrt(np.minimum(hits, 20.0))
        mean -= np.where(hits > 0, mean[hits > 0].mean() if np.any(hits > 0) else 0.0, 0.0)
        size = 1 << (8 * count - 1).bit_length()
        waves = np.fft.rfftfreq(size, bin_width) * per
        if signed:
            # the phase is known: sin(2 pi q / wavelength) from q = 0
            power = np.abs(np.imag(np.fft.rfft(mean, size) * np.exp(-2j * np.pi * np.fft.rfftfreq(size, bin_width) * start))) ** 2
        else:
            power = np.abs(np.fft.rfft(mean, size)) ** 2
        keep = (waves >= low) & (waves <= top)
        return (1.0 / waves[keep] if inverse else waves[keep]), power[keep]

    def _in_time(self) -> tuple[np.ndarray, np.ndarray]:
        frequencies = np.arange(1.0, 120.0, 0.02)
        power = np.zeros(len(frequencies))
        for values, _, _, t in self._pieces("current"):
            if len(t) < 200:
                continue
            period = float(np.median(np.diff(t)))
            grid = np.zeros(round(t[-1] / period) + 1)
            grid[np.rint(t / period).astype(int)] = values - np.median(values)
            size = 1 << max(16, (len(grid) - 1).bit_length())
            spectrum = np.abs(np.fft.rfft(grid, size)) ** 2 / len(grid)
            power += np.interp(frequencies, np.fft.rfftfreq(size, period), spectrum)
        return frequencies, power

    def _frame(self) -> tuple[np.ndarray, np.ndarray]:
        """How much of the windup (or, without it, of the position) a frame that swings with each frequency explains.

        Frequencies that a run's sampling cannot show (from half its rate on) get nothing from it.
        """
        from scipy.signal import lfilter

        frequencies = np.geomspace(12.0, 90.0, 40)
        power = np.zeros(len(frequencies))
        name = "windup" if any(n == "windup" for _, n in self.channels) else "position"
        for values, _, v, t in self._pieces(name):
            if len(t) < 3:
                continue
            period = float(np.median(np.diff(t)))
            a = np.gradient(v, period)
            for i in np.flatnonzero(frequencies < 0.5 / period):
                response = lfilter(*_swing(float(frequencies[i]), period), a)
                norm = float(response @ response)
                if norm > 0:
                    power[i] += float(response @ values) ** 2 / norm
        return frequencies, power


FRAME_DAMPING = 0.05
"""Damping ratio with which a swinging frame is looked for."""


def _swing(frequency_hz: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Filter (b, a) from acceleration to the swing x of a frame, x'' + 2 z w x' + w^2 x = acceleration, exact for one held over a sample.

    With r = exp(-z w T), c = r cos(w_d T), s = r sin(w_d T), q = z / sqrt(1 - z^2), w_d = w sqrt(1 - z^2):
    b = (0, 1 - c - q s, r^2 - c + q s) / w^2,   a = (1, -2 c, r^2). Stable at every sampling period.
    """
    w, z = 2.0 * math.pi * frequency_hz, FRAME_DAMPING
    root = math.sqrt(1.0 - z * z)
    r = math.exp(-z * w * period)
    c, s, q = r * math.cos(w * root * period), r * math.sin(w * root * period), z / root
    return np.array([0.0, 1.0 - c - q * s, r * r - c + q * s]) / w**2, np.array([1.0, -2.0 * c, r * r])


def _strongest(values: np.ndarray, power: np.ndarray) -> list[float]:
    """Local maxima, strongest first, at most PEAKS."""
    if len(power) < 3 or not np.any(power > 0):
        return [float(values[len(values) // 2])]
    inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
    inner = inner[np.argsort(-power[inner])][: 4 * PEAKS]
    chosen: list[float] = []
    for i in inner:
        if all(abs(math.log(values[i] / c)) > 0.02 for c in chosen):
            chosen.append(float(values[i]))
        if len(chosen) == PEAKS:
            break
    return chosen or [float(values[int(np.argmax(power))])]


def softened(start: Start, machine: Machine, share: float) -> Setting:
    """The setting of a spring that gives `share` as much as the start's; what else is fitted to a stiffness follows it."""
    first = start.settings[0]
    fitted = {p.name for p in start.effect.parameters if p.fitted is not None}
    values = {name: value for name, value in first.parameters.items() if name not in fitted}
    values["stiffness"] /= share
    return _start(start.effect, machine, machine.axis(first.axis), first.from_axis, values).settings[0]


def combine(start: Start, sizes: Sequence[float], machine: Machine) -> Setting:
    """The setting that a linear combination of the start's answers stands for: `sizes` multiply the deviation from neutral.

    Of a lag they multiply what it delays.
    """
    first = start.settings[0]
    size = size_parameter(start.effect)
    neutral = size.neutral or 0.0
    deviation = first.parameters[size.name] - neutral
    if len(sizes) == 2:
        phase = next(p for p in start.effect.parameters if p.periodic and p.shape)
        # c1 sin(x) + c2 sin(x + pi/2) = amplitude sin(x + phase)
        amplitude, angle = math.hypot(*sizes), math.atan2(sizes[1], sizes[0])
        values = {size.name: neutral + amplitude * deviation, phase.name: angle % (2 * math.pi)}
    elif is_lag(start.effect):
        cycle = getattr(machine, _SAMPLED[start.effect.name])
        delay = sizes[0] * cycle / math.expm1(cycle / deviation)
        values = {size.name: cycle / math.log1p(cycle / delay)}
    else:
        values = {size.name: neutral + sizes[0] * deviation}
    return Setting(start.effect, first.axis, {**first.parameters, **values}, first.from_axis)
