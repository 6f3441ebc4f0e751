"""Print the table of all words that the readers know, or write it into docs/program_words.md.

python devtools/words_table.py [--write]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.program.iso import ISO_G, ISO_M
from twin.program.klartext import KLARTEXT, KLARTEXT_M
from twin.program.sinumerik import SINUMERIK_G, SINUMERIK_M, SINUMERIK_NAMES
from twin.program.state import ACTS, NOTE, REFUSED

PAGE = Path(__file__).resolve().parents[1] / "docs" / "program_words.md"
BEGIN, END = "<!-- words: python devtools/words_table.py --write -->\n", "<!-- end of words -->\n"
KINDS = {ACTS: "acts", NOTE: "noted", REFUSED: "refused"}


def rows(table: dict, prefix: str) -> list[tuple[str, str, str]]:
    """Words with the same meaning in one row: words, kind, meaning."""
    grouped: dict[tuple[str, str], list[str]] = {}
    for key, (kind, meaning, *_) in table.items():
        name = key if isinstance(key, str) else f"{prefix}{key:g}"
        grouped.setdefault((kind, meaning), []).append(name)
    return [(_short(names), KINDS[kind], meaning) for wanted in KINDS for (kind, meaning), names in grouped.items() if kind == wanted]


def _short(names: list[str]) -> str:
    """The words of a row; a long run of numbers by its ends."""
    return " ".join(names) if len(names) < 90 else f"{names[0]} .. {names[-1]}"


def text() -> str:
    """The tables as Markdown."""
    parts = []
    for title, table, prefix in (
        ("SINUMERIK, G", SINUMERIK_G, "G"),
        ("SINUMERIK, M (any other is not known, and noted as such)", SINUMERIK_M, "M"),
        ("SINUMERIK, names", SINUMERIK_NAMES, ""),
        ("ISO, Fanuc and LinuxCNC, G", ISO_G, "G"),
        ("ISO, M (any other is not known, and noted as such)", ISO_M, "M"),
        ("HEIDENHAIN Klartext, start of a block", KLARTEXT, ""),
        ("HEIDENHAIN Klartext, M (any other is not known, and noted as such)", KLARTEXT_M, "M"),
    ):
        lines = [f"\n### {title}\n", "| words | | meaning here |", "|---|---|---|"]
        lines += [f"| `{words}` | {kind} | {meaning} |" for words, kind, meaning in rows(table, prefix)]
        parts.append("\n".join(lines) + "\n")
    return "".join(parts)


def with_table(page: str) -> str:
    """The page with its table as the readers have it now."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return head + BEGIN + text() + "\n" + END + tail


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write it into docs/program_words.md")
    if parser.parse_args().write:
        PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(text())


if __name__ == "__main__":
    main()
