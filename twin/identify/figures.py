"""Figures of the identification report: friction law, table gravity, gap. None where there is nothing to show."""

import math
from typing import Any

import numpy as np

from twin.estimate.regression import NORMAL_95
from twin.identify.axis_run import slides_above
from twin.identify.drive_balance import FRICTIONS, Balance
from twin.identify.result import Identification
from twin.identify.rotary_pair import FIRST_MOMENTS, pair_of
from twin.machine.machine import Axis, Machine
from twin.report import new_figure
from twin.report.colours import axis_colour, hexadecimal
from twin.report.figure import INK, SOFT
from twin.units import in_words

POINTS = 14
"""Most points of friction in each direction."""

STEADY = 0.02
"""A row is at constant speed if its acceleration is less than this share of the largest."""


def _shown(result: Identification, *names: str) -> list[Axis]:
    """Axes with a torque balance that identified these parameters."""
    known = {(p.axis, p.name) for p in result.parameters}
    return [a for a in result.before.axes if result.direct.balance_of(a.name) is not None and all((a.name, n) in known for n in names)]


def friction_points(machine: Machine, balance: Balance, axis: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed [rad/s], friction torque [Nm] and its standard deviation at constant speeds, averaged over rows of equal speed and direction."""
    rows, (own, factors) = balance.rows[axis], zip(*(balance.place(machine.axis(axis), name) for name in FRICTIONS))
    kept = np.isin(np.arange(len(balance.names)), own)
    friction = (rows.y - rows.columns @ np.where(kept, 0.0, balance.fit.values)) * factors[0]
    steady = np.abs(rows.acceleration) < STEADY * max(float(np.abs(rows.acceleration).max()), 1e-9)
    speed, torque = rows.speed[steady], friction[steady]
    points = []
    least = slides_above(machine.axis(axis))
    edges = np.geomspace(least, max(np.abs(speed).max(initial=0.0) * 1.001, least * 1.1), POINTS + 1)
    place = np.sign(speed) * np.digitize(np.abs(speed), edges)
    for k in np.unique(place[place != 0.0]):
        inside = place == k
        if inside.sum() >= 5:
            points.append((speed[inside].mean(), torque[inside].mean(), torque[inside].std() / np.sqrt(inside.sum() / 5.0)))
    return tuple(np.array(c) for c in zip(*points)) if points else (np.zeros(0),) * 3  # type: ignore[return-value]


def friction_figure(result: Identification) -> Any | None:
    """Friction against speed for every axis: points of constant speed, identified law with 95 % band, law of the file before."""
    axes = _shown(result, *FRICTIONS)
    if not axes:
        return None
    columns = min(3, len(axes))
    figure, panels = new_figure(-(-len(axes) // columns), columns, height=2.9)
    for panel, axis in zip(panels.ravel(), axes):
        balance = result.direct.balance_of(axis.name)
        assert balance is not None
        colour = hexadecimal(axis_colour(axis.name))
        speed, torque, deviation = friction_points(result.before, balance, axis.name)
        coulomb, viscous = (result.parameter(axis.name, name) for name in FRICTIONS)
        top = max(float(np.abs(speed).max()) if len(speed) else 0.0, slides_above(axis))
        unit, factor = ("m/min", 60.0 * axis.ratio) if axis.kind == "linear" else ("deg/s", math.degrees(axis.ratio))
        for sign in (-1.0, 1.0):
            w = sign * np.linspace(0.0, 1.08 * top, 50)
            law = sign * coulomb.estimate.value + viscous.estimate.value * w
            half = coulomb.estimate.half + viscous.estimate.half * np.abs(w)
            panel.fill_between(w * factor, law - half, law + half, color=colour, alpha=0.25, lw=0)
            panel.plot(w * factor, law, color=colour, lw=1.6, label="identified law, 95 % band" if sign > 0 else None)
            before = sign * coulomb.before + viscous.before * w
            panel.plot(w * factor, before, color=SOFT, lw=1.0, ls="--", label="machine file before" if sign > 0 else None)
        panel.errorbar(speed * factor, torque, NORMAL_95 * deviation, fmt="o", ms=3.2, color=INK, lw=0.9, label="constant-speed parts")
        panel.axhline(0.0, color=SOFT, lw=0.6)
        small = viscous.unit.startswith("Nm")  # mNm s/rad at a motor, N s/m of a direct drive
        slope = f"{1e3 * viscous.estimate.value:.3g} m{viscous.unit}" if small else f"{viscous.estimate.value:.3g} {viscous.unit}"
        panel.set_title(f"{axis.name}: {coulomb.estimate.value:.3g} {coulomb.unit} + {slope}")
        panel.set_xlabel(f"speed [{unit}]")
        panel.set_ylabel(f"friction at the motor [{coulomb.unit}]")
    for panel in panels.ravel()[len(axes) :]:
        panel.axis("off")
    figure.legend(*panels.ravel()[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def gravity_figure(result: Identification) -> Any | None:
    """Gravity torque of a rotary pair over the angle of its outer axis for two positions of the inner one, and its first moments."""
    pair = pair_of(result.before)
    if pair is None or (balance := result.direct.balance.get(" ".join(pair.axes))) is None:
        return None
    rows, axis = balance.rows[pair.outer], result.before.axis(pair.outer)
    index = [balance.names.index(n) for n in FIRST_MOMENTS]
    of_y, of_z, of_x, of_c = balance.fit.values[index]
    gravity = rows.y - rows.columns @ np.where(np.isin(np.arange(len(balance.names)), index), 0.0, balance.fit.values)
    figure, panels = new_figure(1, 2, height=3.2)
    left, right = panels[0]
    colour, step = hexadecimal(axis_colour(pair.outer)), max(1, len(gravity) // 1500)
    left.plot(
        math.degrees(1.0) * rows.position[::step],
        gravity[::step],
        ".",
        ms=2.2,
        color=colour,
        alpha=0.5,
        rasterized=True,
        label=f"measured, all {pair.inner}",
    )
    angle = np.linspace(*axis.travel, 120)
    for c, style in ((0.0, "-"), (np.pi, "--")):
        y = of_y + of_x * np.sin(c) + of_c * np.cos(c)
        law = np.array([y, of_z]) @ pair.gravity_at(angle)
        left.plot(math.degrees(1.0) * angle, law, color=INK, lw=1.2, ls=style, label=f"law, {pair.inner} = {math.degrees(c):.0f}°")
    left.set(
        xlabel=f"angle of {pair.outer} [deg]",
        ylabel=f"gravity torque on {pair.outer} [Nm]",
        title=f"Gravity on {pair.outer} over its angle",
    )
    left.legend(frameon=False, fontsize=8)
    shown = [p for p in result.parameters if p.name in FIRST_MOMENTS and p.before]
    for k, p in enumerate(shown):
        off, half = (100.0 * v / abs(p.before) for v in (p.estimate.value - p.before, p.estimate.half))
        right.errorbar(k, off, half, fmt="o", ms=5, color=colour, capsize=4)
        right.annotate(f"{p.estimate.number} kg m", (k, off), xytext=(8, 4), textcoords="offset points", fontsize=8.5)
    right.axhline(0.0, color=SOFT, lw=1.0, ls="--")
    right.set_xlim(-0.5, len(shown) - 0.2)
    right.margins(y=0.15)
    right.set_xticks(range(len(shown)), [in_words(p.name) for p in shown])
    right.set(ylabel="off the machine file [%]", title="First moments with 95 % interval")
    return figure


def shared_gaps(result: Identification) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """(axis, signal) that all stages were compared in -> the gap of each stage."""
    stages = list(result.gaps.values())
    signals = [(a, s) for a, of in stages[0].items() for s in of if all(s in g.get(a, {}) for g in stages)] if stages else []
    return {(a, s): [g[a][s] for g in stages] for a, s in signals}


STAGES = {
    "before": (SOFT, "machine file before"),
    "regression": ("#0b5394", "regression"),
    "refined": ("#2e8b57", "in closed loop"),
    "control": ("#8a6d00", "control only"),
}
"""Colour and name of each stage whose gap is simulated."""

WIDE = 10.0
"""Gaps with a larger ratio are drawn on a logarithmic scale."""


def gap_figure(result: Identification) -> Any | None:
    """Gap over noise on held-out motion, before and after, by axis and signal."""
    gaps, stages = shared_gaps(result), list(result.gaps)
    if not gaps:
        return None
    figure, panels = new_figure(1, 1, height=3.0)
    panel = panels[0, 0]
    ratios = np.array([[g["rms"] / max(g["noise"], 1e-12) for g in of_stages] for of_stages in gaps.values()]).T
    for k, stage in enumerate(stages):
        colour, label = STAGES[stage]
        panel.bar(np.arange(len(gaps)) + (k - 0.5 * (len(stages) - 1)) * 0.27, ratios[k], 0.25, color=colour, label=label)
    panel.axhline(1.0, color=INK, lw=0.8)
    if ratios.max() > WIDE * ratios.min():
        panel.set_yscale("log")
    panel.margins(y=0.2)
    labels = [f"{a}\n{s.replace('motor_position', 'motor').replace('velocity', 'speed')}" for a, s in gaps]
    panel.set_xticks(np.arange(len(gaps)), labels, fontsize=7.5)
    panel.set_ylabel("gap / noise")
    panel.set_title("Gap on held-out motion; measuring noise alone gives 1")
    panel.legend(ncols=3, frameon=False)
    return figure
