"""`twin watch`: dated campaigns into a history, each judged once, and what the history says.

dated campaigns -> one projection each (stored, one transaction a campaign) -> series of sizes -> changes, causes, forecasts -> document, page
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
import functools
import hashlib
import json
import os
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from twin.diagnose.check import check_campaign
from twin.diagnose.simulations import on_threads
from twin.effects import Setting
from twin.errors import InputError, TwinError
from twin.history.columns import directions_of
from twin.history.dated import Dated, dated_campaigns
from twin.history.judge import Judgement, judged
from twin.history.limits import limits_of
from twin.history.projection import Projection, groups_of, projected, reference_view
from twin.history.sized import sizes_on
from twin.history.store import Row, Store
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun

VERSION = 2
"""Raised when projections are computed in another way, so that old and new ones are not mixed."""


@threadpool_limits.wrap(limits=1, user_api="blas")
def watch(
    folder: Path,
    out: Path,
    machine: Machine,
    *,
    limits: Sequence[Setting] = (),
    tolerance: float | None = None,
    threads: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Judgement, list[str]]:
    """Bring the history in `out` up to date with a folder of dated campaigns; its judgement, and notes on what was left out.

    A growing change is carried forward to its size in `limits`, or to `tolerance` [m] at the tool point, or to the usual size of its effect.

    Raises InputError if nothing is dated or can be judged, or the history belongs to another machine. A campaign that cannot be read is named in a note and tried again
    the next time.
    """
    dated, notes = dated_campaigns(folder)
    store = Store(out, reference_of(machine))
    try:
        known = store.digests()
        new = [one for one in dated if one.digest not in known]
        with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
            for number, one in enumerate(new):
                progress(f"{one.name} ({number + 1} of {len(new)})")
                try:
                    store.put(row_of(one, machine, pool))
                except TwinError as error:
                    notes.append(f"left out: {error}")
        rows = store.rows()
    finally:
        store.close()
    if not rows:
        raise InputError(f"{folder}: no campaign could be judged; {notes[-1]}")
    progress("judging")
    groups = sorted({axes for row in rows for axes in row.projections}, key=lambda axes: machine.axis_names.index(axes[0]))
    judged_here = {row.digest for row in rows}

    @functools.cache
    def last() -> Sequence[MeasuredRun]:
        """Runs of the last recording that was judged and is still there; read when a change asks for them."""
        one = next((one for one in reversed(dated) if one.digest in judged_here), None)
        return one.runs(machine) if one else ()

    limit_of = limits_of(machine, limits, tolerance, last)
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        size_of = sizes_on(last, machine, on_threads(pool))
        return judged(rows, {axes: directions_of(machine, axes) for axes in groups}, limit_of, size_of), notes


def row_of(one: Dated, machine: Machine, pool: ThreadPoolExecutor) -> Row:
    """A campaign projected onto the directions of the machine."""
    runs = one.runs(machine)
    check_campaign(Campaign(one.path, "", runs), machine)
    found: dict[tuple[str, ...], Projection] = {}
    for run in runs:
        view = reference_view(machine, run)
        for axes in groups_of(machine, [run]):
            if (p := projected(machine, run, axes, on_threads(pool), view)) is not None:
                found[axes] = found[axes] + p if axes in found else p
    return Row(one.digest, one.name, one.day, program_of(runs), found)


def program_of(runs: Sequence[MeasuredRun]) -> tuple[float, ...]:
    """What identifies a program: path, lowest and highest set point of each axis over all runs [m, rad]."""
    out: list[float] = []
    for axis in sorted({axis for run in runs for axis in run.trace.axes}):
        points = [run.trace.get(axis, "setpoint") for run in runs if axis in run.trace.axes]
        out += [
            float(sum(np.abs(np.diff(p)).sum() for p in points)),
            float(min(p.min() for p in points)),
            float(max(p.max() for p in points)),
        ]
    return tuple(float(f"{value:.6g}") for value in out)


def reference_of(machine: Machine) -> str:
    """Digest of all that the projections depend on: the machine and the directions."""
    names = [d.name for axis in machine.axis_names for d in directions_of(machine, (axis,))]
    content = json.dumps([VERSION, machine.document, names], sort_keys=True, default=str)
    return hashlib.sha256(content.encode()).hexdigest()
