"""Shared pieces of the HTML reports: one page template, tables, and figures that stand inside the page.

page        a whole page from a title, a lead and sections
Section     heading, text, tables and figures of one part
Table       heading row, rows, classes of cells
figure_svg  a matplotlib figure as inline SVG, and save_png for a file
"""

from twin.report.figure import figure_svg, new_figure, save_png
from twin.report.page import Figure, Section, Table, page, write_page

__all__ = ["Figure", "Section", "Table", "figure_svg", "new_figure", "page", "save_png", "write_page"]
