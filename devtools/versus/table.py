"""The tables of the comparison, in Markdown, from the stored results."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any

from devtools.pages import put_between

NOT_RESULTS = ("peers",)


def results_in(folder: Path) -> dict[str, dict[str, Any]]:
    """Stored results by name of the input, those of real axes first."""
    found = {f.stem: json.loads(f.read_text(encoding="utf-8")) for f in sorted(folder.glob("*.json")) if f.stem not in NOT_RESULTS}
    return dict(sorted(found.items(), key=lambda item: item[1]["causes"] is not None))


def markdown(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(cells)} |" for cells in (heading, ["---"] * len(heading), *rows)]
    return "\n".join(lines)


def methods_of(results: dict[str, dict[str, Any]]) -> list[str]:
    """All methods, in the order of the first result that has them."""
    return list(dict.fromkeys(m for result in results.values() for m in result["rows"]))


def gaps_table(results: dict[str, dict[str, Any]]) -> str:
    """Gap on the runs left out, in times noise: one row an input, one column a method; the best in bold."""
    methods = methods_of(results)
    rows = []
    for result in results.values():
        gaps = {m: row["gap"]["times_noise"] for m, row in result["rows"].items() if "gap" in row}
        best = min(gaps.values())
        texts = {m: f"{g:.2f}" if g < 9.95 else f"{g:.1f}" for m, g in gaps.items()}
        rows.append([result["text"], *(f"**{texts[m]}**" if gaps.get(m) == best else texts.get(m, "failed") for m in methods)])
    return markdown(["gap left out, times noise", *methods], rows)


def answers_table(results: dict[str, dict[str, Any]]) -> str:
    """What each method claims: errors of numbers and intervals where the truth is known, causes, time, lines."""
    rows = []
    for method in methods_of(results)[1:]:
        own = {name: result["rows"][method] for name, result in results.items() if method in result["rows"]}
        own = {name: row for name, row in own.items() if "gap" in row}
        if not own:
            continue
        numbers = [n for name, row in own.items() if results[name]["causes"] is not None for n in row["numbers"].values()]
        worst = sorted(n["error"] for n in numbers)
        claimed = [n["holds"] for n in numbers if n["holds"] is not None]
        asked = [row["right"] for row in own.values() if row["right"] is not None]
        times = sorted(row["cpu_s"] for row in own.values())
        lines = {row["lines"] for row in own.values()}
        rows.append(
            [
                method,
                f"{100 * worst[len(worst) // 2]:.1f} %, {100 * worst[-1]:.0f} %" if worst else "",
                f"{sum(claimed)} of {len(claimed)}" if claimed else "none claimed",
                f"{sum(asked)} of {len(asked)}" if asked else "names none",
                f"{times[0]:.0f} to {times[-1]:.0f} s",
                str(max(lines)),
            ]
        )
    heading = [
        "method",
        "error of the numbers, median and largest",
        "intervals that contain the truth",
        "cause right",
        "processor time",
        "lines",
    ]
    return markdown(heading, rows)


def says_table(results: dict[str, dict[str, Any]]) -> str:
    """What each method names and says, by input."""
    rows = []
    for result in results.values():
        for method, row in list(result["rows"].items())[1:]:
            rows.append([result["text"], method, f"failed: {row['failed']}" if "failed" in row else row["says"]])
    return markdown(["input", "method", "says"], rows)


def table_text(folder: Path) -> str:
    """All tables."""
    results = results_in(folder)
    return "\n\n".join(table(results) for table in TABLES.values()) if results else "no results"


def put_into(page: Path, folder: Path) -> None:
    """Write the tables into a page, each at its place."""
    for name, table in TABLES.items():
        put_between(page, name, table(results_in(folder)))


TABLES = {"gaps": gaps_table, "answers": answers_table, "says": says_table}
