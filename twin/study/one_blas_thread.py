"""One BLAS thread for each variant: more give other last bits (a dot product of 10 000 samples is split among them) and wait for each other.

A matrix exponential of four states takes 0.03 ms on one thread and 8 ms on two, and variants run on all cores anyway. BLAS threads that come back
spin for a while: a study holds the limit as long as it runs, a worker of a cluster for good.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import functools
import threading
from typing import Any

import numpy as np  # noqa: F401  BLAS libraries must be loaded before they are looked for
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

_COUNTING = threading.Lock()
_INSIDE: list[Any] = []
"""The limit that holds, once for each thread that is inside."""


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS of this process on one thread until the last of all threads that are inside leaves."""
    _enter()
    try:
        yield
    finally:
        with _COUNTING:
            limit = _INSIDE.pop()
            if not _INSIDE:
                limit.restore_original_limits()


@functools.cache
def stay_on_one_blas_thread() -> None:
    """BLAS of this process on one thread from now on."""
    _enter()


def _enter() -> None:
    with _COUNTING:
        _INSIDE.append(_INSIDE[0] if _INSIDE else _libraries().limit(limits=1, user_api="blas"))


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
