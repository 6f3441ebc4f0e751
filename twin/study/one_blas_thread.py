"""Limits BLAS to one thread per variant. More threads change the last bits (they split long dot products) and wait for each other.

A matrix exponential of four states takes 0.03 ms on one thread and 8 ms on two, and variants run on all cores anyway. BLAS threads
spin after their work, so a study holds the limit for its whole duration and a cluster worker for its lifetime.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import functools
import threading
from typing import Any

import numpy as np  # noqa: F401  threadpoolctl finds only BLAS libraries that are already loaded
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

_COUNTING = threading.Lock()
_INSIDE: list[Any] = []
"""The active limit, once per thread inside `one_blas_thread`."""


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS of this process to one thread, until the last of several concurrent callers leaves."""
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
    """Limit BLAS of this process to one thread from now on."""
    _enter()


def _enter() -> None:
    with _COUNTING:
        _INSIDE.append(_INSIDE[0] if _INSIDE else _libraries().limit(limits=1, user_api="blas"))


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
