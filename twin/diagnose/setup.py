"""Constant inputs of the steps of a diagnosis: the machine, the folds of the runs, and the options of the call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twin.machine.machine import Machine


@dataclass(frozen=True)
class Setup:
    """Machine file, folds and options of one diagnosis."""

    machine: Machine
    nominal: Machine  # the machine with an empty list of effects
    folds: Sequence[Sequence[int]]  # runs that are held out together
    quick: bool
    seed: int
    threads: int
    progress: Callable[[str], None]
