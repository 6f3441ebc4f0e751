"""The card: the first answer to a recording, as text for a terminal and as JSON, and the next measurement as a program for the control."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import Any

from twin.control.actuator import EFFORTS
from twin.diagnose.first.axis_facts import AxisFacts, facts_of
from twin.diagnose.first.odd import Odd, oddities
from twin.diagnose.first.people import Shown, number, shown
from twin.diagnose.first.shows import can_show, cannot_show, speed_text
from twin.effects.readable import NOTHING
from twin.estimate.regression import Range
from twin.files import write_json
from twin.identify.plan import PlannedRun, constant_speeds, write_planned
from twin.machine.axis_lumps import AxisLumps
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.units import AXIS_UNITS

HEADING = ("axis", "moves", "lag", "gain", "friction", "after reversals", "motor - scale", "vibration", "noise")
NEXT = "next_program"
SMALLEST_NOISE = 1e-7
"""Smaller noise, as a share of the travel, is rounding of the computer."""


@dataclass(frozen=True)
class Card:
    """First answer: facts of each axis, remarks, limits, and the sentences on diagnosis and next measurement."""

    runs: tuple[str, ...]
    facts: tuple[AxisFacts, ...]
    gains: Mapping[str, str]
    """Position gain of each axis whose control law was found in the recording, as text."""
    odd: tuple[Odd, ...]
    can: tuple[str, ...]
    cannot: tuple[str, ...]


def card_of(runs: Sequence[MeasuredRun], lumps: Sequence[AxisLumps] = ()) -> Card:
    """The card of recorded runs. `lumps`: the control laws found when a machine was made from the same runs."""
    axes = dict.fromkeys(axis for run in runs for axis in run.trace.axes)
    facts = tuple(found for axis in axes if (found := facts_of(runs, axis)) is not None)
    gains = {one.name: f"{number(one.law['position_gain_per_s'])} 1/s" for one in lumps if one.law.measured}
    return Card(
        tuple(run.name for run in runs), facts, gains, tuple(oddities(facts)), tuple(can_show(facts)), tuple(cannot_show(facts, gains))
    )


def rows_of(card: Card) -> list[list[str]]:
    """The table of the card, one row for each axis; '-' where the recording says nothing."""
    return [_row(one, card.gains.get(one.name, "-")) for one in card.facts]


def _row(one: AxisFacts, gain: str) -> list[str]:
    error = shown("error", one.kind)
    moves = "-"
    if one.rows is not None:
        moves = f"{shown('position', one.kind).text(one.travel[1] - one.travel[0])} {speed_text(one)}, {one.strokes[0]} + {one.strokes[1]} strokes"
    lags = "; ".join(f"{_ms(lag)}{f' ({flag})' if flag else ''}" for flag, lag in one.lags.items()) or "-"
    reversal = "-" if one.reversal is None else error.text(one.reversal) + ("" if one.reversal_stands_out else " (as elsewhere)")
    line = "-"
    if one.vibration is not None:
        size = error if one.vibration.signal == "position" else shown(one.vibration.signal)
        line = f"{one.vibration.frequency:.3g} Hz, {size.text(one.vibration.amplitude)}"
    t = one.transmission
    encoders = "-" if t is None else f"{number(t.low * error.at(t.high).factor)} to {error.text(t.high)}"
    if t is not None and t.lost is not None and t.lost.known:
        encoders += f", {error.interval(abs(t.lost.value), t.lost.half)} between directions"
    return [one.name, moves, lags, gain, _friction(one), reversal, encoders, line, _noise(one)]


def _noise(one: AxisFacts) -> str:
    """Noise of single samples and the step of a record with few digits; '-' where equal neighbours show neither."""
    error = shown("error", one.kind)
    noise = [error.text(one.noise)] if one.noise > SMALLEST_NOISE * (one.travel[1] - one.travel[0]) else []
    return ", ".join([*noise, *([f"step {error.text(one.step)}"] if one.step > one.noise else [])]) or "-"


def _ms(lag: Range) -> str:
    if lag.half > NOTHING * abs(lag.value):  # at one speed in one direction it is a constant of the position, too
        return "not determined"
    return Shown("ms", 1e3).known(lag)


def _friction(one: AxisFacts) -> str:
    f = one.friction
    if f is None:
        return "-"
    size = shown(f.effort)
    if f.coulomb is None or f.viscous is None:
        speed = AXIS_UNITS[one.kind].speed
        words = [word for word, is_in in (("weight", not min(one.strokes)), ("any back EMF", EFFORTS[f.effort].has_back_emf)) if is_in]
        included = f", {' and '.join(words)} included" if words else ""
        return f"{size.known(f.at_speed)} at {number(f.speed * speed[1])} {speed[0]}{included}"
    per, factor = AXIS_UNITS[one.kind].speed
    many, name = (1.0, "") if abs(f.viscous.value) >= 1e-3 * factor else (1000.0, "1000 ")  # a small one for 1000 mm/s or deg/s
    slope = f"{number(many * abs(f.viscous.value) / factor)} {size.unit} per {name}{per}"
    return f"{size.interval(f.coulomb.value, f.coulomb.half)} {'-' if f.viscous.value < 0.0 else '+'} {slope}"


def card_text(card: Card) -> str:
    """The card for a terminal, within 100 columns where names allow it."""
    period, lasts = card.facts[0].period if card.facts else 0.0, max((f.duration for f in card.facts), default=0.0)
    lines = [f"{len(card.runs)} {'run' if len(card.runs) == 1 else 'runs'}, {lasts:.1f} s, a sample each {period * 1e3:g} ms"]
    for row in rows_of(card):
        lines.append(f"\naxis {row[0]}: {row[1] if row[1] != '-' else 'at rest'}")
        lines += [f"  {name:<16} {cell}" for name, cell in zip(HEADING[2:], row[2:]) if cell != "-"]
    if turned := [f.name for f in card.facts if f.friction and f.friction.against]:
        lines.append(f"\nnote: the effort of axis {', '.join(turned)} pushes against the motion as recorded; its sign is taken as opposite")
    lines += [
        "",
        "odd:" if card.odd else "odd: nothing beyond the scatter of this recording",
        *_items(f"{o.axis} {o.sentence}" for o in card.odd),
    ]
    lines += ["this recording shows:", *_items(card.can), *(["it cannot show:"] if card.cannot else []), *_items(card.cannot)]
    return "\n".join(lines)


def _items(sentences: Iterable[str]) -> list[str]:
    """Sentences as a list, wrapped."""
    return [fill(s, 98, initial_indent="  - ", subsequent_indent="    ") for s in sentences]


def card_document(card: Card) -> dict[str, Any]:
    """Content of `card.json`, SI; intervals as half widths at 95 %."""

    def pair(value: Range | None) -> dict[str, float] | None:
        return None if value is None else {"value": value.value, "half": value.half}

    axes = {}
    for one in card.facts:
        f, t, v = one.friction, one.transmission, one.vibration
        axes[one.name] = {
            "kind": one.kind, "signals": list(one.signals), "period_s": one.period, "duration_s": one.duration, "travel": list(one.travel),
            "speed": one.speed, "strokes": list(one.strokes), "noise": one.noise, "step": one.step, "following_max": one.following,
            "lag_s": {flag or "unknown": pair(lag) for flag, lag in one.lags.items()}, "gain": card.gains.get(one.name),
            "reversal_peak": one.reversal, "reversals": one.reversals, "reversal_stands_out": one.reversal_stands_out,
            "friction": None if f is None else {
                "effort": f.effort, "speed": f.speed, "at_speed": pair(f.at_speed), "coulomb": pair(f.coulomb), "viscous": pair(f.viscous),
                "inertia": pair(f.inertia), "constant": pair(f.constant), "against": f.against, "peak": f.peak, "explained": f.explained,
            },
            "encoders": None if t is None else {"low": t.low, "high": t.high, "lost_motion": pair(t.lost)},
            "vibration": None if v is None else {"frequency_hz": v.frequency, "amplitude": v.amplitude, "signal": v.signal},
        }  # fmt: skip
    odd = [{"axis": o.axis, "kind": o.kind, "sentence": o.sentence} for o in card.odd]
    return {"runs": list(card.runs), "axes": axes, "odd": odd, "shows": list(card.can), "cannot_show": list(card.cannot)}


def write_card(card: Card, path: Path) -> None:
    """Write `card.json`."""
    write_json(card_document(card), path, "card")


def next_run(card: Card, machine: Machine) -> PlannedRun | None:
    """Constant speeds of the axes whose friction the recording does not split; None if the recording splits the friction of every axis that moves.

    They stay inside the travel of the machine file and inside the recorded speed.
    """
    names = {f.name for f in card.facts if f.rows is not None and (f.friction is None or f.friction.coulomb is None or min(f.strokes) == 0)}
    fastest = {f.name: f.speed for f in card.facts}
    axes = [replace(a, max_velocity=min(a.max_velocity, fastest[a.name])) for a in machine.axes if a.name in names]
    return constant_speeds(machine, axes, NEXT) if axes else None


def write_next(run: PlannedRun, machine: Machine, out: Path) -> str:
    """Write the moves as a Siemens program and as set points; returns the sentence on what they are for."""
    write_planned(run, machine, out)
    axes = ", ".join(dict.fromkeys(name for targets, _ in run.blocks for name in targets))
    return (
        f"next measurement: constant speeds of {axes} in both directions, {run.duration:.0f} s, inside the recorded travel and speed: "
        f"{NEXT}.mpf; record set point, position, motor encoder and current"
    )
