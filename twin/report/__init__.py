"""Building blocks of the HTML reports: page template, tables, embedded figures.

page        a whole page from title, lead and sections
Section     heading, text, figures and tables
Table       heading and rows
Figure      inline SVG with caption
new_figure  a matplotlib figure in the style of the reports
figure_svg  a matplotlib figure as inline SVG
save_png    a matplotlib figure as a file
"""

from twin.report.figure import figure_svg, new_figure, save_png
from twin.report.page import Figure, Section, Table, address, link_from, page, write_page

__all__ = ["Figure", "Section", "Table", "address", "figure_svg", "link_from", "new_figure", "page", "save_png", "write_page"]
