"""The table of the comparison, from the stored results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from twin.simulation.summary import table

HEADING = ["method", "gap left out", "position", "effort", "largest error", "intervals hold", "named", "processor time", "lines"]


def results_in(folder: Path) -> dict[str, dict[str, Any]]:
    """Stored results by name of the input."""
    files = [f for f in sorted(folder.glob("*.json")) if f.stem != "peers"]
    return {f.stem: json.loads(f.read_text(encoding="utf-8")) for f in files}


def row_of(name: str, row: dict[str, Any], causes: list[str] | None) -> list[str]:
    """One method in words."""
    if "failed" in row:
        return [name, "failed", *[""] * 7]
    gap, numbers = row["gap"], row["numbers"].values()
    claimed = [n["holds"] for n in numbers if n["holds"] is not None]
    named = ", ".join(row["causes"]) or row["verdict"] or ""
    return [
        name,
        f"{gap['times_noise']:.1f} x noise",
        f"{gap['position']:.2f}",
        f"{gap['effort']:.3f}",
        f"{100 * max(n['error'] for n in numbers):.1f} %" if numbers else "",
        f"{sum(claimed)} of {len(claimed)}" if claimed else "",
        named,
        f"{row['cpu_s']:.1f} s",
        str(row["lines"] or ""),
    ]


def table_text(folder: Path) -> str:
    """One table an input."""
    parts = []
    for name, result in results_in(folder).items():
        rows = [row_of(method, row, result["causes"]) for method, row in result["rows"].items()]
        parts.append(f"{name}: {result['text']}\n" + table(HEADING, rows, left=1))
    return "\n\n".join(parts)
