"""Writing of a campaign: traces block by block, campaign.toml, import.json; the table and the pictures of what was written."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import itertools
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomlkit

from twin.errors import InputError
from twin.files import beside, stamped, write_whole
from twin.recordings.campaign import EVENTS, UNSTATED, ChannelFact
from twin.recordings.channels import Piece
from twin.recordings.mapping import Map
from twin.recordings.recorded_run import Understood
from twin.recordings.relations import ForceSign
from twin.recordings.signals import BLOCK
from twin.recordings.trace import FORCES, Trace, measured_position_in, unit_of, written
from twin.report.curves import Curve, Panel, curves_figure
from twin.report.figure import save_png
from twin.simulation.summary import table
from twin.units import AXIS_UNITS, UNITS, in_words

ERROR = "_error"
"""Set point minus position [SI], only for the picture."""
POINTS = 3000
"""Points of a curve in the picture: smallest and largest sample of each part."""
MOST_AXES = 8
"""Axes in a picture."""


@dataclass
class Written:
    """A written trace: name, start time, and thinned curves of each signal in the written unit, which keep its smallest and largest sample."""

    name: str
    started_at_s: float
    feedforward: str | None
    piece: Piece
    units: dict[tuple[str, str], str]
    curves: dict[tuple[str, str], list[np.ndarray]] = field(default_factory=dict)
    times: list[np.ndarray] = field(default_factory=list)

    def curve(self, key: tuple[str, str]) -> np.ndarray:
        """Values of a thinned signal."""
        return np.concatenate(self.curves[key])


def write_run(known: Understood, started_at_s: float, out: Path, runs: Collection[str]) -> list[Written]:
    """Write the traces of a run: one, or one per piece between gaps, named name_1, name_2, skipping the names of other `runs`."""
    # the map gives the start of the run; without it a part starts later than its recording
    start = known.pieces[0].begin if known.run.started_at_s is not None else known.begin
    of_pieces = (name for i in itertools.count(1) if (name := f"{known.run.name}_{i}") not in runs)
    names = [known.run.name] if len(known.pieces) == 1 else of_pieces
    return [_write_piece(known, piece, name, started_at_s + piece.begin - start, out) for name, piece in zip(names, known.pieces)]


def _write_piece(known: Understood, piece: Piece, name: str, started_at_s: float, out: Path) -> Written:
    order = {axis: i for i, axis in enumerate(dict.fromkeys(c.column.axis for c in known.channels))}
    keys = sorted(known.block(piece, 0, 2), key=lambda k: order[k[0]])
    units = {(axis, signal): unit_of(signal, known.kinds[axis]) for axis, signal in keys}
    result = Written(name, started_at_s, known.run.feedforward, piece, units)
    part = max(1, int(np.ceil(piece.count / (POINTS / 2))))
    # blocks contain whole parts of the picture
    step = max(BLOCK // part, 1) * part

    def blocks() -> Iterator[Trace]:
        for first in range(0, piece.count, step):
            last = min(first + step, piece.count)
            block = known.block(piece, first, last)
            yield Trace(piece.period * np.arange(first, last), {key: block[key] for key in keys}, known.kinds)

    for trace in written(blocks(), out / f"{name}.parquet"):
        result.times.append(_thinned(trace.time, part)[0])
        for axis in order:
            if shown := trace.measured_position(axis):
                error = trace.get(axis, "setpoint") - trace.get(axis, shown)
                result.curves.setdefault((axis, ERROR), []).append(_thinned(error, part)[1])
        for key in keys:
            result.curves.setdefault(key, []).append(_thinned(trace.get(*key) / UNITS[units[key]][1], part)[1])
    return result


def _thinned(values: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
    """(first time of each part twice, smallest and largest of each part): a thinned curve that keeps its peaks."""
    if part == 1:
        return values, values
    starts = np.arange(0, len(values), part)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    return np.repeat(values[starts], 2), np.column_stack([low, high]).ravel()


def write_campaign(out: Path, mapping: Map, runs: Sequence[tuple[Understood, Sequence[Written]]]) -> None:
    """Write campaign.toml and import.json."""
    document: dict[str, Any] = {"machine": mapping.machine_name} if mapping.machine_name else {}
    document["run"] = [_run(known, trace) for known, traces in runs for trace in traces]
    content = {"runs": {trace.name: _record(known, trace) for known, traces in runs for trace in traces}}
    head = "# imported by 'twin import'; import.json records the details\n"
    try:
        _write_events(out / EVENTS, runs)
        write_whole(out / "campaign.toml", head + tomlkit.dumps(document))
        write_whole(out / "import.json", json.dumps(stamped(content, "import"), indent=2) + "\n")
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}); give another --out") from None


def _run(known: Understood, trace: Written) -> dict[str, Any]:
    """[[run]] with [[run.channel]] and [run.labels]: findings of the import, for identification and diagnosis."""
    run: dict[str, Any] = {"file": f"{trace.name}.parquet"} | ({"feedforward": trace.feedforward} if trace.feedforward else {})
    run["started_at_s"] = round(trace.started_at_s, 6)
    # what is zero is left out, as the defaults are
    facts = [{k: v for k, v in msgspec.to_builtins(_fact(known, trace, key)).items() if v} for key in trace.units]
    if found := [fact for fact in facts if len(fact) > 2]:  # more than axis and signal
        run["channel"] = found
    if labels := {name: _digits(value, 9) for (piece, name), value in known.labels.items() if piece == trace.piece}:
        run["labels"] = labels
    return run


def _fact(known: Understood, trace: Written, key: tuple[str, str]) -> ChannelFact:
    """Findings about one channel."""
    skew = next((item for item in known.skews if (item.axis, item.signal) == key), None)
    channel = next((c for c in known.channels if c.key == key), None)
    back = channel.skew_s if channel else 0.0
    late = skew is not None and (skew.clear or bool(back))
    # what the map gives; the skews are those that are left beside it
    given = channel.column.skew_ms * 1e-3 if channel else 0.0
    encoder, offset = known.offsets.get((trace.piece, key[0]), ("", 0.0))
    offset = offset if key[1] == encoder else 0.0
    linear, sign = known.kinds[key[0]] == "linear", known.signs.get(key, ForceSign())
    stated = channel.signal.stated_unit if channel is not None and channel.column.scale is None else ""
    return ChannelFact(
        axis=key[0], signal=key[1], latency=_digits(skew.seconds + given if skew is not None and late else back, 6),
        latency_deviation=_digits(skew.deviation if skew is not None and late else 0.0, 3), taken_back=_digits(back, 6),
        offset_m=_digits(offset if linear else 0.0, 9), offset_rad=_digits(0.0 if linear else offset, 9),
        offset_taken_out=known.centred and key[1] == encoder,
        sign=-1 if channel and channel.column.factor < 0.0 else 1, against=sign.sign < 0, unsigned=sign.unsigned,
        stated_unit=stated or (UNSTATED if channel is not None and channel.column.unit_assumed else ""),
        made_from=known.made.get(key, ""),  # type: ignore[arg-type]
    )  # fmt: skip


def _digits(value: float, count: int) -> float:
    """A number with so many significant digits."""
    return float(f"{value:.{count}g}")


def _write_events(path: Path, runs: Sequence[tuple[Understood, Sequence[Written]]]) -> None:
    """Write program block events, each in its run; times [s] in that run's trace, negative for a block that started before."""
    import pyarrow as pa
    import pyarrow.parquet

    rows: list[dict[str, Any]] = []
    for known, traces in runs:
        for trace in traces:
            begin, end = trace.piece.begin, trace.piece.end
            # the last block of each channel before the trace is still active in it
            before = {event.channel: event for event in known.events if event.time < begin}
            for event in [*before.values(), *(e for e in known.events if begin <= e.time <= end)]:
                named = {"channel": event.channel, "block": event.block, "text": event.text, "run": trace.name}
                rows.append({"time": event.time - begin, **named})
    if not rows:
        path.unlink(missing_ok=True)
        return
    fields = [("time", pa.float64()), ("channel", pa.int64()), ("block", pa.string()), ("text", pa.string()), ("run", pa.string())]
    with beside(path) as partial:
        pyarrow.parquet.write_table(pa.Table.from_pylist(rows, schema=pa.schema(fields)), partial)


def _record(known: Understood, trace: Written) -> Mapping[str, Any]:
    return {
        "files": list(known.run.files),
        "period_s": trace.piece.period,
        "samples": trace.piece.count,
        "gaps_filled": trace.piece.filled,
        "columns": [
            {
                "column": c.column.name, "file": c.file, "axis": c.column.axis, "signal": c.column.signal, "taken_as": c.conversion.unit,
                "factor_to_si": c.conversion.factor, "interval_s": c.timing.interval, "taken_back_s": c.skew_s,
            }
            for c in known.channels
        ],
        "skew": [
            {"axis": s.axis, "signal": s.signal, "against": s.reference, "seconds": s.seconds, "deviation": s.deviation, "clear": s.clear} for s in known.skews
        ],
        "notes": list(known.notes),
    }  # fmt: skip


def understood_table(known: Understood, traces: Sequence[Written]) -> str:
    """One line per column: source, meaning, interval, range."""
    rows = []
    for channel in known.channels:
        key = channel.key if channel.key in traces[0].units else (channel.key[0], "position")
        low, high = min(t.curve(key).min() for t in traces), max(t.curve(key).max() for t in traces)
        column = channel.column
        skew = f"{channel.skew_s * 1e3:.3g} ms" if channel.skew_s else "-"
        span = f"{low + 0.0:.5g} .. {high + 0.0:.5g} {traces[0].units[key]}"
        meant = [column.name, ".".join(channel.key), channel.conversion.unit, f"{column.factor:g}"]
        rows.append([*meant, f"{channel.timing.interval * 1e3:.4g} ms", skew, span])
    return table(["column", "signal", "unit", "factor", "interval", "skew removed", "range"], rows, left=3)


def draw_run(known: Understood, trace: Written, path: Path) -> None:
    """Draw position and set point, following error, speed, and current (or torque, voltage) of each axis over time."""

    def panel(axis: str, what: str, *signals: str) -> Panel:
        there = [s for s in signals if (axis, s) in trace.units]
        curves = [Curve(in_words(s), trace.curve((axis, s)), "setpoint" if s.endswith("setpoint") else axis) for s in there]
        return Panel(f"{axis} {what}\n{trace.units[axis, there[0]]}" if there else f"{axis} {what}", curves)

    panels = []
    for axis in list(dict.fromkeys(axis for axis, _ in trace.units))[:MOST_AXES]:
        own = [signal for name, signal in trace.units if name == axis]
        position, force = measured_position_in(own), next((s for s in FORCES if s in own), "")
        unit, factor = AXIS_UNITS[known.kinds[axis]].error
        error = [Curve("", trace.curve((axis, ERROR)) * factor, axis)] if (axis, ERROR) in trace.curves else []
        panels += [
            panel(axis, "position", "setpoint", position),
            Panel(f"{axis} set point minus\nposition, {unit}", error),
            panel(axis, "speed", "velocity_setpoint", "velocity"),
            panel(axis, force or "current, torque, voltage", force),
        ]
    length = f"{trace.piece.count * trace.piece.period:.2f} s every {trace.piece.period * 1e3:g} ms"
    figure = curves_figure(np.concatenate(trace.times), panels, f"{trace.name}: {length}, from {', '.join(known.run.files)}", columns=4)
    save_png(figure, path)
