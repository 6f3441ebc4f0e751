"""A proposal as text: as a map with evidence and second choices as comments, and as a table for the terminal; doubtful, omitted and unknown columns, too."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import json
import re
import sys
import textwrap

import numpy as np

from twin.documents import toml_text
from twin.recordings.propose import Proposal
from twin.recordings.propose_columns import Proposed
from twin.recordings.signals import Clock, Recording, Signal, TimeSource
from twin.recordings.trace import FORCES


def map_text(proposal: Proposal, files: Sequence[str], clock: Clock, dialect: Mapping[str, object], given: str) -> str:
    """The map as TOML. `clock` and `dialect`: what the user gave to read the files. `given`: text of a partial map, which stays as it is at the top;
    only what it lacks is added."""
    lines = [
        f"# proposed by 'twin import' for {', '.join(files)} from column names and recorded numbers",
        "# edit it, and import again with: twin import FILES --map THIS_FILE --out CAMPAIGN",
    ]
    if given:
        lines = [given.rstrip(), "", f"# added by 'twin import' for {', '.join(files)} from column names and recorded numbers"]
    else:
        lines += _settings(proposal)
    if clock.interval_s and "[time]" not in given:
        lines += ["", "[time]", f"interval_ms = {clock.interval_s * 1e3:.9g}"]
    elif proposal.time.text and "[time]" not in given:
        lines += ["", *_time(proposal.time)]
    if dialect and "[csv]" not in given:
        lines += ["", "[csv]", *(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in dialect.items())]
    stated = set(re.findall(r'^\s*name\s*=\s*["\'](.*?)["\']', given, re.MULTILINE))
    for column in proposal.columns:
        if column.name not in stated:
            lines += ["", *_column(column)]
    if proposal.left_out:
        lines += ["", "# left out:", *(f"#   {_one_line(text)}" for text in proposal.left_out)]
    if proposal.unknown:
        lines += ["", "# columns without a use:", *(f"#   {_one_line(name)}" for name in grouped(proposal.unknown))]
    return "\n".join(lines) + "\n"


def _settings(proposal: Proposal) -> Iterator[str]:
    if len(proposal.feedforward) > 1:
        yield '# feedforward: it differs between the recordings; write a [[run]] with file = "..." and feedforward = "..." for each'
    elif proposal.feedforward:
        yield f'feedforward = "{"".join(proposal.feedforward)}"           # from the recorded feedforward signals'
    else:
        yield '# feedforward = "off"         # off | velocity | velocity+torque: feedforward in use; the recording does not show it'
    if proposal.fill:
        yield 'gaps = "fill"                # a few samples are lost so often that only short pieces would be left: a cubic fills them'
    yield 'skew = "encoders"            # late encoders are corrected; campaign.toml lists the latency of each channel'
    yield 'offsets = "correct"          # a constant difference between two encoders is removed and listed in campaign.toml'
    if proposal.labels:
        yield f"labels = {json.dumps(proposal.labels, ensure_ascii=False)}   # constant within a run; they go into campaign.toml"


def _time(time: TimeSource) -> list[str]:
    """[time], as a comment if it must still be given."""
    lines = [f"# {_one_line(time.question or time.text)}"]
    if not time.known:
        return [*lines, "# [time]", "# interval_ms = 1.0"]
    if not time.column:
        return [*lines, "[time]", f"interval_ms = {time.interval * 1e3:.9g}"]
    return [*lines, "[time]", f"column = {toml_text(time.column)}", f'unit = "{time.unit}"']


def _column(column: Proposed) -> list[str]:
    """[[column]] with its evidence; a doubtful one as a comment."""
    mark = "# " if column.doubt else ""
    lines = [f"# doubtful, not used: {column.doubt}"] if column.doubt else []
    if column.reason and not column.doubt:
        lines.append(f"# {column.reason}" + (f"; second choice: {column.second}" if column.second else ""))
    lines.append(f"{mark}[[column]]")
    remark = column.remark if column.remark != column.assumed else ""
    of_sign = remark if column.signal in FORCES and column.sign < 0 else ""
    of_unit = "; ".join(text for text in (column.assumed and f"assumed: {column.assumed}", "" if of_sign else remark) if text)
    lines += [f"{mark}name = {toml_text(column.name)}", f"{mark}axis = {toml_text(column.axis)}"]
    lines += [f"{mark}signal = {toml_text(column.signal)}"]
    lines.append(f"{mark}unit = {toml_text(column.unit)}{_comment(of_unit)}")
    lines += [f"{mark}unit_assumed = true   # nobody stated it; delete this line where it is right"] if column.assumed else []
    lines += [f"{mark}{key}" for key in column.extra]
    lines += [f"{mark}optional = true   # not in every file"] if column.optional else []
    if column.sign < 0:
        lines.append(f"{mark}sign = -1{_comment(of_sign)}")
    return lines


def _comment(text: str) -> str:
    return f"   # {text}" if text else ""


def grouped(unknown: Mapping[str, str]) -> list[str]:
    """Columns with one name and one reason on one line: 'LOAD|1, LOAD|2' as 'LOAD|1 2', 'tau(1), tau(2)' as 'tau(1 2)'."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for name, why in unknown.items():
        match = re.fullmatch(r"(.*[(|\[_])(\w+)([)\]]?)", name)
        groups.setdefault((match[1], match[3], why) if match else (name, "", why), []).append(match[2] if match else "")
    return [f"{stem}{' '.join(numbers)}{end}" + (f": {why}" if why else "") for (stem, end, why), numbers in groups.items()]


def _one_line(text: str) -> str:
    return " ".join(text.split())


def proposal_table(proposal: Proposal, recordings: Sequence[Recording]) -> str:
    """What each used column is, its course as a line of blocks, and why; then what is not used. Fits into WIDTH columns of text."""
    signals = {name: signal for r in recordings for name, signal in r.signals.items()}
    rows = []
    for c in proposal.columns:
        if not c.doubt:
            why = "; ".join(part for part in (c.reason or "its name", *c.extra, "sign = -1" * (c.sign < 0)) if part)
            rows.append([c.name, f"{c.axis}.{c.signal}", c.unit, _blocks(signals[c.name]) if c.name in signals else "", why])
    lines = []
    if rows:
        limits = (6, 24), (6, 26), (4, 9), (6, COURSE)
        widths = [min(max(*map(len, cells), least), most) for cells, (least, most) in zip(zip(*rows), limits)]
        room = max(WIDTH - sum(widths) - 2 * len(widths), 20)
        for row in [["column", "signal", "unit", "course", "why"], ["-" * w for w in (*widths, room)], *rows]:
            cells = [*(textwrap.wrap(cell, w) or [""] for cell, w in zip(row[:4], widths)), textwrap.wrap(row[4], room)]
            for i in range(max(map(len, cells))):
                parts = [(cell[i] if i < len(cell) else "").ljust(w) for cell, w in zip(cells, (*widths, 0))]
                lines.append("  ".join(parts).rstrip())
    lines += _wrapped([f"not used: '{c.name}' ({c.axis}.{c.signal}): {c.doubt}" for c in proposal.columns if c.doubt], "  - ")
    lines += _wrapped(proposal.left_out, "  - ")
    if proposal.unknown:
        lines += _wrapped([f"columns without a use: {', '.join(grouped(proposal.unknown))}"], "  - ")
    lines += _wrapped(proposal.notes, "  - ")
    lines += _wrapped(proposal.questions, "  ? ")
    return "\n".join(lines)


WIDTH, COURSE = 100, 16
"""Characters of a line, and of the course of a column."""
_HEIGHTS = "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"


def _blocks(signal: Signal) -> str:
    """The course of a column as a line of blocks, empty where the terminal has no such letters."""
    if "utf" not in (getattr(sys.stdout, "encoding", None) or "").lower() or len(signal.values) < 2:
        return ""
    rows = np.linspace(0, len(signal.values) - 1, min(COURSE, len(signal.values))).astype(int)
    values = np.array([float(signal.values[int(r) : int(r) + 1][0]) for r in rows])
    span = float(np.ptp(values))
    return "".join(_HEIGHTS[int(7.999 * (v - values.min()) / span) if span > 0.0 else 0] for v in values)


def _wrapped(texts: Iterable[str], mark: str) -> list[str]:
    return [line for text in texts for line in textwrap.wrap(text, WIDTH, initial_indent=mark, subsequent_indent=" " * len(mark))]
