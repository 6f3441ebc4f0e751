"""`twin watch`: dated campaigns into a history, each judged once, and what the history says.

dated campaigns -> one projection each (stored, one transaction a campaign) -> series of sizes -> changes, causes, forecasts -> document, page
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
import contextlib
import functools
import hashlib
import json
import math
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from twin.diagnose.check_campaign import check_campaign
from twin.diagnose.tool_point import ToolPoint
from twin.effects import Setting
from twin.errors import InputError, TwinError
from twin.history.columns import Direction, changed, directions_of
from twin.history.dated import Dated, dated_campaigns
from twin.history.judge import USUAL, Judgement, Limit, LimitOf, SizeOf, judge_recording
from twin.history.projection import Linearised, Noise, Projection, Reference
from twin.history.series import Series, filters, same_program
from twin.history.store import Row, Store
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.remedy.predict import decoupled, given_motion
from twin.system import cores

HARMLESS = 1e-9
"""A change that displaces the tool by less does not move it [m]."""

VERSION = 4
"""Raised when projections are computed in another way, so that old and new ones are not mixed."""

STEPS, CLOSE, FACTOR = 8, 0.002, 4.0
"""Most simulations of a change, the relative accuracy of its size, and the largest factor on the slope's size."""


@threadpool_limits.wrap(limits=1, user_api="blas")
def watch(
    folder: Path,
    out: Path,
    machine: Machine,
    *,
    limits: Sequence[Setting] = (),
    tolerance: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Judgement, list[str]]:
    """Bring the history in `out` up to date with a folder of dated campaigns; its judgement, and notes on what was left out.

    A growing change is carried forward to its size in `limits`, or to `tolerance` [m] at the tool point, or to the usual size of its effect.

    Raises InputError if nothing is dated or can be judged, or the history belongs to another machine. A campaign that cannot be read is named in a note and tried again
    the next time.
    """
    dated, wrong, notes = dated_campaigns(folder)
    with ThreadPoolExecutor(cores()) as pool:
        reference = Reference(machine, pool.map, lambda: first_of(dated, machine))
        with contextlib.closing(Store(out, reference_of(machine))) as store:
            rows = {row.digest: row for row in store.rows()}
            new = [one for one in dated if one.digest not in rows]
            notes += [f"left out: {error}" for name, error in wrong.items() if name not in {row.name for row in rows.values()}]
            for number, one in enumerate(new):
                progress(f"{one.name} ({number + 1} of {len(new)})")
                try:
                    row = row_of(one, reference, rows.values())
                except TwinError as error:
                    notes.append(f"left out: {error}")
                    continue
                store.put(row)
                rows = {digest: known for digest, known in rows.items() if known.name != row.name} | {row.digest: row}
        if not rows:
            raise InputError(f"{folder}: no campaign could be judged; {notes[-1]}")
        progress("judging")

        @functools.cache
        def last() -> tuple[Sequence[MeasuredRun], Sequence[Noise]]:
            """Runs and noise of the last recording that was judged and is still there; read for the first change that needs them."""
            one = next((one for one in reversed(dated) if one.digest in rows), None)
            return (one.runs(machine), rows[one.digest].noise) if one else ((), ())

        def linearised(axes: tuple[str, ...]) -> Sequence[Linearised]:
            return [own for _, own in reference.linearised(last()[0], axes, last()[1])]

        groups = sorted({axes for row in rows.values() for axes in row.projections}, key=lambda axes: machine.axis_names.index(axes[0]))
        limit_of = limits_of(machine, limits, tolerance, lambda: last()[0])
        by_day = sorted(rows.values(), key=lambda row: (row.day, row.name))
        return judge_recording(by_day, {axes: reference.directions(axes) for axes in groups}, limit_of, sizes_on(linearised)), notes


def first_of(dated: Sequence[Dated], machine: Machine) -> Sequence[MeasuredRun]:
    """Runs of the first recording that can be read."""
    for one in dated:
        with contextlib.suppress(TwinError):
            return one.runs(machine)
    return ()


def limits_of(machine: Machine, given: Sequence[Setting], tolerance: float | None, runs: Callable[[], Sequence[MeasuredRun]]) -> LimitOf:
    """Sizes that are given count first, then the tolerance W [m] on the runs of the last recording, then the usual size.

    usual sizes of a size s:  |s| / unit, of a spring  unit / s        unit: the usual size (`columns.Direction`)
    tolerance:                theta W / w(theta)                       w: largest displacement of the tool by a change theta
    """
    sizes = {(s.effect.name, s.axis, s.from_axis or ""): s for s in given}

    def limit(direction: Direction, size: float) -> Limit:
        own = sizes.get(direction.cause)
        if own is not None:
            kind, unit = own.effect.size, direction.unit
            return Limit(abs(unit / own.size if kind.is_spring else kind.deviation(own.size) / unit), "the given limit")
        if tolerance is None:
            return USUAL
        moved = displacement(machine, direction, size, runs())
        reached = abs(size) * tolerance / moved if moved > HARMLESS else math.inf
        return Limit(reached, f"{tolerance * 1e6:.4g} um at the tool point on this program")

    return limit


def displacement(machine: Machine, direction: Direction, size: float, runs: Sequence[MeasuredRun]) -> float:
    """Largest displacement [m] of the true tool point by a change of this size [usual sizes] on the set points of these runs."""
    place, found = ToolPoint(machine), 0.0
    for run in runs:
        own = machine.with_feedforward(run.feedforward)
        motion = given_motion(run.name, run.trace, own)
        try:
            base, other = decoupled([own, changed(own, [(direction, size)])], motion)
        except TwinError:  # it diverges
            return math.inf
        found = max(found, float(place.distance(base, other, base.axes).max()))
    return found


def sizes_on(runs_of: Callable[[tuple[str, ...]], Sequence[Linearised]]) -> SizeOf:
    """Sizes of changes that are too large for their slope: a change is simulated on the runs of a group of axes, projected as a recording is
    (`twin.history.series`), and scaled until it shows what the recordings show. The slope's size where it cannot be simulated.

        y(theta) = w'b(theta) / w'G e,   theta <- theta y / y(theta)   until y(theta) = y
    """
    runs_of = functools.cache(runs_of)

    def size_of(direction: Direction, series: Series, y: float) -> float:
        runs, theta = runs_of(series.axes), y
        gram = np.sum([run.gram for run in runs], axis=0) if runs else np.zeros_like(series.gram)
        k = [d.name for d in series.directions].index(direction.name)
        w = filters(gram, series.scatter)[:, k]
        own = float(w @ gram[:, k])
        for _ in range(STEPS if own > 0.0 else 0):
            rights = [np.sum(list(right.values()), axis=0) for run in runs if (right := run.rights_of([(direction, theta)])) is not None]
            found = float(w @ np.sum(rights, axis=0)) / own if len(rights) == len(runs) else 0.0
            if found * y <= 0.0 or not 1.0 / FACTOR < theta / y < FACTOR:
                return y
            theta *= y / found
            if abs(y / found - 1.0) < CLOSE:
                break
        return theta

    return size_of


def row_of(one: Dated, reference: Reference, known: Iterable[Row] = ()) -> Row:
    """A campaign projected onto the directions of the machine, with the noise of a known one of its program."""
    runs = one.runs(reference.machine)
    check_campaign(Campaign(one.path, "", runs), reference.machine)
    program = program_of(runs)
    noise = next((row.noise for row in known if same_program(row.program, program)), ())
    found: dict[tuple[str, ...], Projection] = {}
    seen: dict[str, dict[str, float]] = {run.name: {} for run in runs}
    for axes in reference.groups_of(runs):
        for run, own in reference.linearised(runs, axes, noise):
            p = Projection(own.gram, own.right(run.trace))
            found[axes] = found[axes] + p if axes in found else p
            seen[run.name].update(own.noise)
    return Row(one.digest, one.name, one.day, program, tuple(seen.values()), found)


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
