"""A proposed map as text, with doubtful, omitted and unknown columns as comments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import json
import re

from twin.documents import toml_text
from twin.recordings.propose import Proposal
from twin.recordings.signals import Clock


def map_text(proposal: Proposal, files: Iterable[str], clock: Clock | None = None, dialect: Mapping[str, object] | None = None) -> str:
    """The map as TOML. `clock` and `dialect`: what the user gave to read the files."""
    lines = [
        f"# proposed by 'twin import' for {', '.join(files)} from column names and recorded numbers",
        "# edit it, and import again with: twin import FILES --map THIS_FILE --out CAMPAIGN",
    ]
    if proposal.mixed_feedforward:
        lines.append('# feedforward: it differs between the recordings; write a [[run]] with file = "..." and feedforward = "..." for each')
    elif proposal.feedforward:
        lines.append(f'feedforward = "{proposal.feedforward}"           # from the recorded feedforward signals')
    else:
        lines.append('# feedforward = "off"         # off | velocity | velocity+torque: feedforward in use; the recording does not show it')
    lines.append('skew = "encoders"            # late encoders are corrected; campaign.toml lists the latency of each channel')
    lines.append('offsets = "correct"          # a constant difference between two encoders is removed and listed in campaign.toml')
    if proposal.labels:
        lines.append(f"labels = {json.dumps(proposal.labels, ensure_ascii=False)}   # constant within a run; they go into campaign.toml")
    if clock and clock.interval_s:
        lines += ["", "[time]", f"interval_ms = {clock.interval_s * 1e3:.9g}"]
    if dialect:
        lines += ["", "[csv]", *(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in dialect.items())]
    for column in proposal.columns:
        mark = "# " if column.doubt else ""
        lines.append("")
        if column.doubt:
            lines.append(f"# doubtful, not used: {column.doubt}")
        lines.append(f"{mark}[[column]]")
        remark = f"   # {column.remark}" if column.remark else ""
        unit = f"{mark}unit = {toml_text(column.unit)}" + ("" if column.signal.startswith(("current", "torque", "voltage")) else remark)
        lines += [
            f"{mark}name = {toml_text(column.name)}",
            f"{mark}axis = {toml_text(column.axis)}",
            f"{mark}signal = {toml_text(column.signal)}",
            unit,
        ]
        if column.extra:
            lines.append(f"{mark}{column.extra}")
        if column.sign < 0:
            lines.append(f"{mark}sign = -1{remark}")
        elif column.signal.startswith(("current", "torque", "voltage")) and remark:
            lines.append(f"#{remark[4:]}")
    if proposal.left_out:
        lines += ["", "# left out:", *(f"#   {_one_line(text)}" for text in proposal.left_out)]
    if proposal.unknown:
        lines += ["", "# columns without a known use:", *(f"#   {_one_line(name)}" for name in _grouped(proposal.unknown))]
    return "\n".join(lines) + "\n"


def _grouped(names: Sequence[str]) -> list[str]:
    """Columns with one name on one line: 'LOAD|1, LOAD|2' as 'LOAD|1 2', 'tau(1), tau(2)' as 'tau(1 2)'."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name in names:
        match = re.fullmatch(r"(.*[(|\[])(\w+)([)\]]?)", name)
        groups.setdefault((match[1], match[3]) if match else (name, ""), []).append(match[2] if match else "")
    return [f"{stem}{' '.join(numbers)}{end}" for (stem, end), numbers in groups.items()]


def _one_line(text: str) -> str:
    return " ".join(text.split())
