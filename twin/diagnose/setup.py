"""What all steps of a diagnosis share: the machine, the folds of the runs, the threads, and the options of the call."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twin.diagnose.simulations import Mapper
from twin.machine.machine import Machine


@dataclass(frozen=True)
class Setup:
    """Machine file, folds and options of one diagnosis; `mapper` maps over simulations."""

    machine: Machine  # has no effects
    folds: Sequence[Sequence[int]]  # runs that are held out together
    mapper: Mapper
    progress: Callable[[str], None]
    quick: bool = False
    seed: int = 0
    threads: int = 1
