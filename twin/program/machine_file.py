"""The table [program] of the machine file, used by all readers of programs."""

from __future__ import annotations

from collections.abc import Iterable
import math

from twin.machine.machine import Machine


def first_feed(machine: Machine) -> float:
    """Feed before the first F or FEDRAT [mm/min]; not a number where the file gives none."""
    return float(machine.document.get("program", {}).get("feed_mm_min", math.nan))


def moves_no_axis(machine: Machine, names: Iterable[str]) -> bool:
    """Is a subprogram, by one of its names in capitals, among those that move no axis?"""
    still = machine.document.get("program", {}).get("calls_without_motion", [])
    return not {str(name).upper() for name in still}.isdisjoint(names)
