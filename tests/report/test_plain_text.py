"""Names of runs, axes and surfaces are drawn as they are: `$` begins no formula, `<` and `&` no tag."""

from pathlib import Path

from twin.report.figure import figure_svg, house_style, new_figure, save_png
from twin.report.page import Figure, Section, Table, page

NAME = r"run $x_{ & <b>$\frac"


def test_names_that_would_be_broken_formulas(tmp_path: Path) -> None:
    figure, axes = new_figure(1, 1)
    axes[0, 0].bar([NAME, "b"], [1.0, 100.0], label=NAME)
    axes[0, 0].set_title(NAME)
    axes[0, 0].annotate(NAME, (0.0, 1.0))
    axes[0, 0].set_yscale("log")
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


def test_logarithmic_axes_have_plain_numbers() -> None:
    figure, panels = new_figure(1, 2)
    axes = panels[0, 0]
    axes.plot([0.5, 2000.0], [1.2, 7.0])
    axes.set_xscale("log")
    axes.set_yscale("log")
    small = panels[0, 1]
    small.plot([1e-5, 1e6], [1.0, 2.0])
    small.set_xscale("log")
    house_style(figure).canvas.draw()
    assert "0.000001" in (wide := [label.get_text() for label in small.get_xticklabels()])
    assert not any("e" in text for text in wide)
    shown = [[label.get_text() for label in axis.get_ticklabels(which="both")] for axis in (axes.xaxis, axes.yaxis)]
    assert {"1", "10", "100", "1000"} <= set(shown[0])
    assert "20" not in shown[0]
    assert {"2", "3", "5"} <= set(shown[1])
    assert not any("10^" in text or "mathdefault" in text for texts in shown for text in texts)
