"""Sizes are estimated before the work: what is above a limit is refused with the estimate, the limit and the way to raise it."""

from __future__ import annotations

import math
import os

from twin.errors import InputError

RAISED_BY = "TWIN_LIMITS"
"""Environment variable with the factor by which all limits are raised; `--limits FACTOR` of every command sets it, workers inherit it."""


MOST_SETPOINTS = 10_000_000
"""Set points of one motion that is held: 2.8 hours at 1 kHz, 1 GB."""


def raised_by() -> float:
    """The factor by which limits are raised, 1 where nothing is said."""
    try:
        factor = float(os.environ.get(RAISED_BY, "1"))
    except ValueError:
        factor = math.nan
    if not 1.0 <= factor <= 1e6:
        raise InputError(f"{RAISED_BY} = '{os.environ[RAISED_BY][:40]}': give a factor from 1 to 1e6")
    return factor


def refuse_above(estimate: float, limit: float, what: str, where: str, remedy: str) -> None:
    """Refuse what would be larger than a limit.

    Raises:
        InputError: `where`: about `estimate` `what`, the limit, `remedy`, and the factor that would let it through.
    """
    limit *= raised_by()
    if not estimate <= limit:
        factor = estimate / limit * raised_by()
        more = f"; or raise all limits with --limits {math.ceil(factor * 1.01):g}" if math.isfinite(factor) and factor < 1e6 else ""
        raise InputError(f"{where}: about {estimate:.3g} {what}, the limit is {limit:.3g}: {remedy}{more}")
