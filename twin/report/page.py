"""A self-contained HTML page: styles and figures are embedded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
import os
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

import twin
from twin.documents import read_text
from twin.files import write_whole


@dataclass(frozen=True)
class Table:
    """Heading and rows of text. The first `left` columns and those in `words` (indices, which wrap) are left-aligned; `marked` rows (indices) are highlighted.

    A table with `folded` text opens when that text is clicked.
    """

    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: int = 1
    marked: frozenset[int] = frozenset()
    words: frozenset[int] = frozenset()
    caption: str = ""
    folded: str = ""


@dataclass(frozen=True)
class Figure:
    """Inline SVG (`twin.report.figure_svg`) with its caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A section of a page: cards side by side (the first paragraph of each is large), then paragraphs, links (text, address relative to the page), items,
    figures and tables."""

    title: str
    paragraphs: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    items: Sequence[str] = ()
    cards: Sequence[Section] = ()
    links: Sequence[tuple[str, str]] = ()


def page(title: str, lead: str, sections: Sequence[Section], made: str = "") -> str:
    """The page as HTML; `made` is the line on its origin (default: `made_line()`)."""
    environment = Environment(
        loader=PackageLoader("twin.report", "."), autoescape=select_autoescape(["html"], default=True), undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("page.html").render(title=title, lead=lead, sections=sections, made=made or made_line())


def write_page(path: str | Path, title: str, lead: str, sections: Sequence[Section], made: str = "") -> None:
    """Write the page; creates its folder."""
    write_whole(Path(path), page(title, lead, sections, made))


def link_from(path: Path, text: str, to: Path) -> None:
    """Add a link to another page to the contents of a page that was written before; once."""
    page, anchor = read_text(path, "a page"), f'<a href="{address(to, path)}">{text}</a>'
    if anchor not in page:
        write_whole(path, page.replace("</nav>", f"{anchor}</nav>", 1))


def address(to: Path, page: Path) -> str:
    """Address of a file relative to a page; its own address on another drive."""
    try:
        return quote(Path(os.path.relpath(to.resolve(), page.resolve().parent)).as_posix())
    except ValueError:
        return to.resolve().as_uri()


def made_line(machine: str = "", inputs: str = "", seed: int | None = None) -> str:
    """'Made by twin 0.1.0 on 2026-01-31 14:05 with Mikron UCP 710; input: circle; seed 3.'"""
    with_machine = f" with {machine}" if machine else ""
    given = f"; input: {inputs}" if inputs else ""
    drawn = "" if seed is None else f"; seed {seed}"
    return f"Made by twin {twin.__version__} on {datetime.now():%Y-%m-%d %H:%M}{with_machine}{given}{drawn}."
