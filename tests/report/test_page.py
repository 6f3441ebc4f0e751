"""The one document model of all reports: cards, alignment and folding of tables, and text that is never markup."""

from __future__ import annotations

import re

from twin.report import Section, Table, page


def test_a_page_holds_what_its_sections_say() -> None:
    table = Table(["what", "size", "where"], [["<b>", "1", "here"], ["b", "2", "there"]], marked=frozenset({1}), words=frozenset({2}))
    cards = [Section("Where", ["Axis X", "in the mechanics"]), Section("Which", ["Backlash"])]
    html = page("Title", "lead", [Section("First", cards=cards), Section("Second", ["text"], tables=[table], items=["one"])])
    assert [html.index(word) for word in ("Title", "Axis X", "Backlash", "text", "one", "there")] == sorted(
        html.index(word) for word in ("Title", "Axis X", "Backlash", "text", "one", "there")
    )
    assert re.findall(r"<h3>(.*?)</h3>", html) == ["Where", "Which"]
    assert "<b>" not in html
    first, marked = re.findall(r"<tr.*?</tr>", html)[1:]
    assert re.findall(r"<td( class=\"l\")?>", first) == [' class="l"', "", ' class="l"']
    assert 'class="mark"' in marked
    assert 'class="mark"' not in first
