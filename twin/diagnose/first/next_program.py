"""The next measurement after a card: constant speeds of the axes whose friction the recording does not split, as a program for the control."""

from dataclasses import replace
from pathlib import Path

from twin.diagnose.first.card import Card
from twin.identify.plan import PlannedRun, constant_speeds, write_planned
from twin.machine.machine import Machine

NAME = "next_program"


def next_run(card: Card, machine: Machine) -> PlannedRun | None:
    """The moves; None if the recording splits the friction of every axis that moves.

    They stay inside the travel of the machine file and inside the recorded speed.
    """
    names = {f.name for f in card.facts if f.rows is not None and (f.friction is None or f.friction.coulomb is None or min(f.strokes) == 0)}
    fastest = {f.name: f.speed for f in card.facts}
    axes = [replace(a, max_velocity=min(a.max_velocity, fastest[a.name])) for a in machine.axes if a.name in names]
    return constant_speeds(machine, axes, NAME) if axes else None


def write_next(run: PlannedRun, machine: Machine, out: Path) -> str:
    """Write the moves as a Siemens program and as set points; returns the sentence on what they are for."""
    write_planned(run, machine, out)
    axes = ", ".join(dict.fromkeys(name for targets, _ in run.blocks for name in targets))
    return (
        f"next measurement: constant speeds of {axes} in both directions, {run.duration:.0f} s, inside the recorded travel and speed: "
        f"{NAME}.mpf; record set point, position, motor encoder and current"
    )
