"""A block of an axis' control that its machine file lists: numbers with their keys, law, place in the loop.

    [axis.X.block.friction_pulse]
    amplitude_m_per_min = 0.015
    decay_time_s = 0.015

The package docstring says how a block is added.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from twin.control.number import Key, OnControl, Parameter, si_from_key, unit_of_key
from twin.errors import InputError, nearest


class Cycles(Protocol):
    """Cycles of a control [s]; a Machine has them."""

    @property
    def position_cycle(self) -> float: ...
    @property
    def speed_cycle(self) -> float: ...
    @property
    def current_cycle(self) -> float: ...


def listed_number(name: str, linear: str, rotary: str, bounds: Key, data: Mapping[str, OnControl] | None = None) -> Parameter:
    """A number of a listed block: name for its laws, which get it in SI at the axis; key on a linear and on a rotary axis, with the unit at its end."""
    return Parameter(name, linear, rotary, linear, bounds, data or {})


Values = Mapping[str, float]
"""Numbers of a block by name, SI at the axis."""


@dataclass(frozen=True)
class Block:
    """A block, declared once in its own file.

    name       table below `[axis.N.block]`
    numbers    its numbers
    stage      stage of the loop that calls `law` (`loop_terms`: SETPOINT, SPEED, DRIVE, CURRENT, VOLTAGE)
    law        compiled term with its own state; None for a set point filter
    constants  parameters of the term from the numbers, the cycles and the position gain [1/s]
    kernel     weights of a set point filter at the last position cycles, newest first, with the sum 1
    linear     what the block adds to the output of the position controller for the error, a transfer function from the numbers, the cycles and
               the position gain: polynomials in 1/z of the position cycle, of equal length, for the margins
    strengths  groups of numbers that scale something the block does, down to nothing at 0; each group is an effect of the library
    replaces   recorded signals whose unexplained part this block makes itself, so that a simulation must not add it again
    """

    name: str
    numbers: tuple[Parameter, ...]
    stage: int = -1
    law: Any = None
    constants: Callable[[Values, Cycles, float], list[float]] = lambda _values, _cycles, _gain: []
    kernel: Callable[[Values, Cycles], np.ndarray] | None = None
    linear: Callable[[Values, Cycles, float], tuple[np.ndarray, np.ndarray]] | None = None
    strengths: tuple[tuple[str, ...], ...] = ()
    replaces: tuple[str, ...] = ()

    def __hash__(self) -> int:
        return hash(self.name)


@dataclass(frozen=True)
class Listed:
    """A block of an axis with its numbers in the order of `block.numbers`, SI."""

    block: Block
    sizes: tuple[float, ...]

    @property
    def values(self) -> dict[str, float]:
        """The numbers by name, SI, without those that were left out of the file."""
        return {number.name: size for number, size in self._given()}

    def _given(self) -> list[tuple[Parameter, float]]:
        return [(n, size) for n, size in zip(self.block.numbers, self.sizes) if size != 0.0 or n.bounds.required]

    def text(self, kind: str) -> str:
        """The block in one line, in the units of the file: 'friction_pulse 0.015 m/min, 0.015 s'."""
        shown = []
        for number, size in self._given():
            key = number.key(kind)
            shown.append(f"{size / si_from_key(key):.4g} {unit_of_key(key)}".strip())
        return f"{self.block.name} {', '.join(shown)}"


def keyed(block: Block, found: Mapping[str, tuple[float, float]], kind: str) -> dict[str, tuple[float, float]]:
    """Numbers by name with their half intervals, SI -> the same by 'block.key', in the units of the file."""
    keys = {number.name: number.key(kind) for number in block.numbers}
    return {f"{block.name}.{keys[n]}": (v / si_from_key(keys[n]), half / si_from_key(keys[n])) for n, (v, half) in found.items()}


BLOCKS: dict[str, Block] = {}
"""All blocks by name; `twin.control.library` fills it."""


def register(block: Block) -> Block:
    """Add a block to BLOCKS. Raises InputError for a name that exists."""
    if block.name in BLOCKS:
        raise InputError(f"block {block.name}: a block of that name exists already; use another name")
    BLOCKS[block.name] = block
    return block


def named_blocks(tables: Any, where: str) -> list[Block]:
    """The blocks of `[axis.N.block]` in the order of their action. Raises InputError for an unknown one."""
    if not isinstance(tables, Mapping) or not all(isinstance(table, Mapping) for table in tables.values()):
        raise InputError(f"{where}: must hold one table for each block; write [axis.N.block.NAME]")
    for name in tables:
        if name not in BLOCKS:
            raise InputError(f"{where}: no block '{name}'; {nearest(str(name), BLOCKS)}")
    return sorted((BLOCKS[name] for name in tables), key=lambda block: (block.stage, block.name))


def listed(block: Block, table: Mapping[str, Any], kind: str) -> Listed:
    """A block with the numbers of its checked table; an optional number that is left out is 0."""
    return Listed(block, tuple(float(table.get(n.key(kind), 0.0)) * si_from_key(n.key(kind)) for n in block.numbers))
