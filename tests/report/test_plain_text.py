"""Names of runs, axes and surfaces are drawn as they are: `$` begins no formula, `<` and `&` no tag."""

from pathlib import Path

from twin.report.figure import figure_svg, new_figure, save_png
from twin.report.page import Figure, Section, Table, page

NAME = r"run $x_{ & <b>$\frac"


def test_names_that_would_be_broken_formulas(tmp_path: Path) -> None:
    figure, axes = new_figure(1, 1)
    axes[0, 0].bar([NAME, "b"], [1.0, 100.0], label=NAME)
    axes[0, 0].set_title(NAME)
    axes[0, 0].annotate(NAME, (0.0, 1.0))
    axes[0, 0].set_yscale("log")  # its tick labels are formulas, and stay
    axes[0, 0].set_xticks([0, 1], [NAME, "b"])
    axes[0, 0].legend()
    figure.suptitle(NAME)
    assert figure_svg(figure)
    save_png(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_names_in_a_page_are_escaped() -> None:
    text = page(NAME, NAME, [Section(NAME, [NAME], [Figure("<svg/>", NAME)], [Table([NAME], [[NAME]])], [NAME])])
    assert "<b>" not in text
    assert "&lt;b&gt;" in text
