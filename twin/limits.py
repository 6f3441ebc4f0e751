"""Limits on sizes: each size is estimated before the work, and an InputError states estimate, limit and how to raise it."""

from collections.abc import Iterator
import contextlib
import math
import os

from twin.errors import InputError
from twin.system import memory_bytes

RAISED_BY = "TWIN_LIMITS"
"""Environment variable with the factor on all limits. `--limits FACTOR` of every command sets it; workers inherit it."""

MOST_SETPOINTS = 10_000_000
"""Set points of one motion held in memory: 2.8 hours at 1 kHz, 1 GB."""

MEMORY_SHARE = 0.125
"""Share of the computer's memory that the content of one file may take once it is read: it is copied a few times on its way."""


def raised_by() -> float:
    """The factor on all limits; 1 by default."""
    try:
        factor = float(os.environ.get(RAISED_BY, "1"))
    except ValueError:
        factor = math.nan
    if not 1.0 <= factor <= 1e6:
        raise InputError(f"{RAISED_BY} = '{os.environ[RAISED_BY][:40]}': give a factor from 1 to 1e6")
    return factor


@contextlib.contextmanager
def raised(factor: float) -> Iterator[None]:
    """Context: all limits are multiplied by this factor, also in child processes."""
    before = os.environ.get(RAISED_BY)
    os.environ[RAISED_BY] = repr(factor)
    try:
        yield
    finally:
        os.environ.pop(RAISED_BY)
        if before is not None:
            os.environ[RAISED_BY] = before


def refuse_above(estimate: float, limit: float, what: str, where: str, remedy: str) -> None:
    """Raise InputError if `estimate` exceeds `limit` times the factor of `raised_by`.

    The message states `where`, the estimate of `what`, the limit, `remedy` and the factor that would allow it.
    """
    limit *= raised_by()
    if not estimate <= limit:
        raise InputError(f"{where}: about {estimate:.3g} {what}, the limit is {limit:.3g}: {remedy}{_or_raise(estimate / limit)}")


def _or_raise(times: float) -> str:
    """End of a message: the factor on all limits that would allow a size of so many times its limit."""
    factor = times * raised_by()
    return f"; or raise all limits with --limits {math.ceil(factor * 1.01):g}" if factor < 1e6 else ""


def most_bytes() -> float:
    """Memory that the content of one file may take [bytes]."""
    return MEMORY_SHARE * memory_bytes() * raised_by()


def refuse_bytes(estimate: float, where: str, remedy: str) -> None:
    """Raise InputError if the content of a file takes more memory than `most_bytes`; the message has both numbers."""
    limit = most_bytes()
    if not estimate <= limit:
        raise InputError(
            f"{where}: takes about {estimate / 1e9:.3g} GB of memory once read, the limit is {limit / 1e9:.3g} GB "
            f"({MEMORY_SHARE:.3g} of this computer's memory): {remedy}{_or_raise(estimate / limit)}"
        )
