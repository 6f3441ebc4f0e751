"""Figures of the reports: one style, no display needed, embedded as SVG or saved as PNG."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any
import warnings

from twin.files import beside
from twin.units import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

STYLE: Any = {
    "font.size": 9.5,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e7ec",
    "grid.linewidth": 0.7,
    "axes.edgecolor": "#8a94a3",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "svg.fonttype": "path",
    "svg.hashsalt": "twin",
    "text.parse_math": False,
}
INK, SOFT, BLUE, RED, GREEN, AMBER = "#1c2430", "#8a94a3", "#0b5394", "#c0392b", "#2e8b57", "#d08a1d"


def new_figure(rows: int, columns: int, width: float = 11.0, height: float = 3.0, **options: Any) -> tuple[MplFigure, Any]:
    """A figure in the style of the reports, `height` inches per row; returns (figure, axes (rows, columns))."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(width, height * rows), layout="constrained")
        FigureCanvasAgg(figure)
        return figure, figure.subplots(rows, columns, squeeze=False, **options)


def house_style(figure: MplFigure) -> MplFigure:
    """Move titles to the left, remove legend frames, write plain numbers at logarithmic axes; polar panels keep their titles. No text is a formula:
    names may contain `$`.
    """
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter, LogFormatter

    for axes in figure.axes:
        for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            if isinstance(axis.get_major_formatter(), LogFormatter):
                shown = "235" if high < 30.0 * low else ""  # first digits of numbers between the powers of ten
                axis.set_major_formatter(FuncFormatter(lambda x, _: plain(x, 1, least=0.0)))
                axis.set_minor_formatter(FuncFormatter(lambda x, _, shown=shown: plain(x, 1, least=0.0) if f"{x:e}"[0] in shown else ""))
        title = axes.get_title(loc="center")
        if title and not axes.get_title(loc="left") and axes.name != "polar":
            axes.set_title("", loc="center")
            axes.set_title(title, loc="left", fontsize=min(axes.title.get_fontsize(), STYLE["axes.titlesize"]), weight="bold")
        if legend := axes.get_legend():
            legend.set_frame_on(False)
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # type: ignore[attr-defined]
    return figure


def figure_svg(figure: MplFigure) -> str:
    """Inline SVG without XML header; equal figures give equal text."""
    from matplotlib import rc_context

    out = io.StringIO()
    with rc_context(STYLE):
        house_style(figure).savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def save_png(figure: MplFigure, path: str | Path, dots_per_inch: int = 130) -> None:
    """Save the figure as a file."""
    from matplotlib import rc_context

    path = Path(path)
    # matplotlib warns if a long name leaves no room for the panels
    with rc_context(STYLE), beside(path) as partial, warnings.catch_warnings(action="ignore", category=UserWarning):
        house_style(figure).savefig(partial, dpi=dots_per_inch)
