"""Location of the gap: axis, block, regime, runs, interval, frequency band, and the regressor of the residual."""

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
import scipy

from twin.diagnose.blocks import CHANNEL_SHOWS, REGIMES, BlockResidual, block_residuals, regime_masks, scaling
from twin.diagnose.cross_validation import retuned_within
from twin.diagnose.judgement import NEXT_TO_NOTHING
from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import tuned
from twin.diagnose.view import RunView
from twin.effects import Setting
from twin.machine.machine import Axis, Machine


def places(
    states: Sequence[GroupState], settings: Sequence[Setting], machine: Machine, weights: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Places of the gap, largest share first. Blocks with an effect lead their axis.

    The machine of each group is first re-tuned within its tolerance, because that is no fault of a block. `weights` is the squared gap above
    noise of each axis. Groups without an effect and with a negligible gap are skipped.

    A fault in one block changes the inputs of the other blocks, but not their laws. A block is listed if its law fails and if this causes a
    noticeable share of the gap in position or current (`share_of_gap`).
    """
    listed: list[dict[str, Any]] = []
    levels: dict[tuple[str, str], float] = {}
    least = T.near_noise * max(weights.values(), default=0.0)
    for f in states:
        group = f.group
        if not (f.fit.settings or f.unknown or any(weights.get(axis, 0.0) > least for axis in group.axes)):
            continue
        healthy = tuned(f.tuning.nuisances, retuned_within(f).theta * f.tuning.spread)
        residuals = block_residuals(group, healthy)
        for axis, block in sorted({(b.axis, b.block) for b in residuals}):
            parts = [b for b in residuals if (b.axis, b.block) == (axis, block)]
            share = share_of_gap(f.rigid, axis, block, parts)
            square = sum(float(np.sum(b.normed**2)) for b in parts) / max(sum(len(b.residual) for b in parts), 1)
            levels[axis, block] = float(np.sqrt(square))
            if square > T.by_chance and share > T.near_noise:
                listed.append(_place(group, axis, block, parts, share, levels[axis, block]))
    for setting in settings:
        _assign_effect(listed, setting, machine, levels)
    _merge_echoes(listed)
    # an axis has the weight of its gap, divided among its blocks by their shares
    for axis in {p["axis"] for p in listed}:
        mine = [p for p in listed if p["axis"] == axis]
        total = sum(p["share"] for p in mine) or 1.0
        for place in mine:
            place["share"] *= max(weights.get(axis, 0.0), 1e-6) / total
    total = sum(p["share"] for p in listed) or 1.0
    for place in listed:
        place["share"] /= total
    return sorted(listed, key=lambda p: -p["share"])


def share_of_gap(group: Group, name: str, block: str, parts: Sequence[BlockResidual]) -> float:
    """Share of the squared gap of an axis, in position or current, that the error of a block causes, from 0 to 1; 1 if the gap was not recorded.

        position controller   speed error e of its law:   position error e / (s + Kv)
        speed controller      current error di:           speed error e = di Kt r / Kp, then the same
        mechanics             force error F:              current error F r / Kt
        transmission          motor minus scale:          itself, compared with the gap of the position

    `group` holds the gap: its channels about the machine file. `parts` are the residuals of the block, one per run.
    """
    made = gap = 0.0
    for part in parts:
        view = group.views[part.run]
        axis = view.machine.axis(name)
        square = {c.name: float(np.mean(c.residual**2)) for c in group.channels if (c.run, c.axis) == (part.run, name)}
        weight = len(view.trace.time)
        if block == "transmission":
            made += weight * square.get("motor_minus_scale", 0.0)
            gap += weight * (square.get("motor_minus_scale", 0.0) + square.get("position", 0.0))
        elif block == "mechanics":
            made += weight * float(np.mean((part.residual * axis.ratio / axis.motor.torque_constant_nm_per_a) ** 2))
            gap += weight * square.get("current", 0.0)
        else:
            kp = axis.loops.speed_gain_nm_s_per_rad
            speed = part.residual * (1.0 if block == "position controller" else axis.commissioned_torque_constant * axis.ratio / kp)
            made += weight * float(np.mean(_position_error(speed, part, view, axis) ** 2))
            gap += weight * square.get("position", 0.0)
    return min(1.0, made / gap) if gap > 0.0 else 1.0


def _position_error(speed: np.ndarray, part: BlockResidual, view: RunView, axis: Axis) -> np.ndarray:
    """Position error (sample,) that an error of the speed set point causes in closed loop: x' = e - Kv x, e held over a sample."""
    gain = axis.loops.position_gain_per_s
    decay = math.exp(-gain * _step(part, view.trace.period))
    return np.asarray(scipy.signal.lfilter([0.0, (1.0 - decay) / gain], [1.0, -decay], speed))


def _step(part: BlockResidual, period: float) -> float:
    """Time between the samples of a residual [s]."""
    return float(np.median(np.diff(part.index))) * period if len(part.index) > 1 else period


def largest_remaining_block(state: GroupState, axis: str) -> tuple[str, str]:
    """Block of an axis with the largest residual of the last fit, and the regressor of that residual ('-': none)."""
    group = state.group
    residual = state.fit.residual(group) / group.weights
    parts: dict[str, list[BlockResidual]] = {}
    for c in group.channels:
        if c.axis != axis or c.name in ("position", "velocity"):
            continue  # they follow the other channels
        index = np.flatnonzero(group.views[c.run].rows_of(axis, c.name))
        block = CHANNEL_SHOWS.get(c.name, "mechanics")
        parts.setdefault(block, []).append(BlockResidual(c.run, axis, block, residual[c.rows], float(np.mean(c.sigma)), index))
    if not parts:
        return "mechanics", "-"
    block = max(parts, key=lambda b: sum(p.excess for p in parts[b]))
    return block, _scales_with(group, axis, parts[block])


def _assign_effect(listed: list[dict[str, Any]], setting: Setting, machine: Machine, levels: Mapping[tuple[str, str], float]) -> None:
    """Assign an effect to a listed place on its axis, and name the place after the block of the effect.

    An effect without a matching place is listed as a new one with a share next to nothing, and with the level of its block if the block was
    measured. `levels` holds the residual over noise by axis and block.
    """
    block, axis = setting.effect.block, setting.axis
    same = {
        "current loop": ("mechanics", "speed controller"),
        "mechanics": ("mechanics", "speed controller"),
        "measurement": ("transmission", "mechanics"),
        "transmission": ("transmission", "mechanics"),
        "speed controller": ("speed controller", *machine.axis(axis).loops.one_law, "mechanics"),
        "position controller": ("position controller", "speed controller"),
    }[block]
    mine = [p for p in listed if p["axis"] == axis]
    for name in same:
        for place in mine:
            if place["block"] == name and "effect" not in place:
                place["block"] = block
                place["effect"] = setting.effect.name
                return
    if any(place["block"] == block for place in mine):
        return  # a larger effect is already assigned to it
    listed.append(
        {
            "axis": axis,
            "block": block,
            "share": NEXT_TO_NOTHING,
            "scales_with": "-",
            "regime": "all",
            "runs": [],
            **({"level": levels[axis, block]} if (axis, block) in levels else {}),
            "effect": setting.effect.name,
        }
    )


def _merge_echoes(listed: list[dict[str, Any]]) -> None:
    """Move most of the share of blocks without an effect to the largest block of the same axis with an effect, which mostly causes their residual."""
    for axis in {p["axis"] for p in listed}:
        mine = [p for p in listed if p["axis"] == axis]
        if leading := [p for p in mine if "effect" in p]:
            largest = max(leading, key=lambda p: p["share"])
            for other in (p for p in mine if "effect" not in p):
                largest["share"] += (1.0 - T.echo) * other["share"]
                other["share"] *= T.echo


def _place(group: Group, axis: str, block: str, parts: list[BlockResidual], share: float, level: float) -> dict[str, Any]:
    excess = sum(b.excess for b in parts)
    runs = sorted(parts, key=lambda b: -b.excess)
    named, reached = [], 0.0
    for part in runs:
        named.append(group.views[part.run].name)
        reached += part.excess
        if reached >= T.nearly_all * excess:
            break
    top = runs[0]
    view = group.views[top.run]
    start, stop = _stretch(top, view.trace.period)
    return {
        "axis": axis,
        "block": block,
        "share": share,
        "scales_with": _scales_with(group, axis, parts),
        "regime": _regime(group, axis, parts),
        "runs": named,
        "level": level,
        "stretch": {"run": view.name, "from_s": float(view.trace.time[start]), "to_s": float(view.trace.time[stop])},
        "band_hz": _band(top, view.trace.period),
    }


def _regime(group: Group, axis: str, parts: list[BlockResidual]) -> str:
    """The regime with most of the excess; 'all' if none has most of it."""
    energy = dict.fromkeys(REGIMES, 0.0)
    for part in parts:
        masks = regime_masks(group.views[part.run], axis)
        for regime in REGIMES:
            inside = masks[regime][part.index]
            energy[regime] += float(np.sum(part.normed[inside] ** 2 - 1.0)) if inside.any() else 0.0
    total = sum(max(e, 0.0) for e in energy.values()) or 1.0
    best = max(REGIMES, key=lambda regime: energy[regime])
    return best if energy[best] / total > T.most else "all"


def _scales_with(group: Group, axis: str, parts: list[BlockResidual]) -> str:
    """The regressor that explains most of a block's residual; '-' if none explains a tenth."""
    names = group.views[0].machine.axis_names
    total = sum(float(b.residual @ b.residual) for b in parts) or 1.0
    sums: dict[str, tuple[float, float]] = {}
    for part in parts:
        view = group.views[part.run]
        # only a force has a meaningful constant residual: zeros of encoders are arbitrary
        force = part.block in ("mechanics", "current loop")
        residual = part.residual if force else part.residual - part.residual.mean()
        for name, regressor in scaling(view, axis, part.index, names).items():
            if name == "1" and not force:
                continue
            xy, xx = sums.get(name, (0.0, 0.0))
            sums[name] = (xy + float(regressor @ residual), xx + float(regressor @ regressor))
    shares: dict[str, float] = {}
    for name, (xy, xx) in sums.items():
        if xx > 0:
            both = name.split(" (")[0]  # sine and cosine are one regressor
            shares[both] = shares.get(both, 0.0) + xy**2 / xx / total
    best = max(shares, key=lambda name: shares[name], default="-")
    return best if shares.get(best, 0.0) > T.remaining else "-"


def _stretch(part: BlockResidual, period: float) -> tuple[int, int]:
    """First and last sample of the interval with the largest excess: `stretch_s` long, at most a third of the run."""
    n = len(part.residual)
    width = max(10, min(n // 3, round(T.stretch_s / _step(part, period))))
    # a varying residual counts more than a constant one
    ones = np.ones(width)
    energy = np.convolve(part.normed**2, ones, mode="valid") - 0.9 * np.convolve(part.normed, ones, mode="valid") ** 2 / width
    at = int(np.argmax(energy)) if len(energy) else 0
    return int(part.index[at]), int(part.index[min(at + width, n) - 1])


def _band(part: BlockResidual, period: float) -> list[float]:
    """Frequencies [Hz] between which the middle four fifths of the residual's power lie."""
    values = part.normed - part.normed.mean()
    power = np.cumsum(np.abs(np.fft.rfft(values)) ** 2)
    frequencies = np.fft.rfftfreq(len(values), _step(part, period))
    if power[-1] <= 0:
        return [0.0, 0.0]
    low, high = np.searchsorted(power / power[-1], [0.1, 0.9])
    return [float(frequencies[min(low, len(frequencies) - 1)]), float(frequencies[min(high, len(frequencies) - 1)])]
