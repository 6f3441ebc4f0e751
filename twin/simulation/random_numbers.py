"""Random numbers of the measuring noise.

A diagnosis simulates each run many times with the same noise. Numbers that were drawn lately are remembered: to draw them takes longer than to
simulate an axis with them.
"""

from collections import OrderedDict
from collections.abc import Mapping
from threading import Lock
from typing import Any

import numpy as np

MOST_BYTES = 60_000_000
"""Memory of remembered numbers: 45 s of five axes at a tick of 125 us."""

_Drawn = tuple[np.ndarray, Mapping[str, Any]]  # numbers, and the state of the generator after them
_drawn: OrderedDict[object, _Drawn] = OrderedDict()  # the latest used last
_lock = Lock()


class NormalNumbers:
    """Standard normal numbers (tick, *shape) of a seed, drawn stretch by stretch."""

    def __init__(self, seed: int | tuple[int, ...], shape: tuple[int, ...]) -> None:
        self._seed, self._shape, self._first = seed, shape, 0
        self._generator = np.random.default_rng(seed)

    def draw(self, ticks: int) -> np.ndarray:
        """The numbers of the next `ticks` ticks. Others read the same array: do not write to it."""
        key = self._seed, self._shape, self._first, ticks
        self._first += ticks
        with _lock:
            if key in _drawn:
                _drawn.move_to_end(key)
                numbers, self._generator.bit_generator.state = _drawn[key]
                return numbers
        numbers = self._generator.standard_normal((ticks, *self._shape))
        with _lock:
            _drawn[key] = numbers, self._generator.bit_generator.state
            while sum(known.nbytes for known, _ in _drawn.values()) > MOST_BYTES:
                _drawn.popitem(last=False)
        return numbers
