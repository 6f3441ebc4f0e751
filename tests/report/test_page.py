"""The one document model of all reports: cards, alignment and folding of tables, and text that is never markup."""

from __future__ import annotations

import re

from twin.report import Section, Table, page


def test_a_page_holds_what_its_sections_say() -> None:
    table = Table(["what", "size", "where"], [["<b>", "1", "here"], ["b", "2", "there"]], marked=frozenset({1}), words=frozenset({2}))
    cards = [Section("Where", ["Axis X", "in the mechanics"]), Section("Which", ["Backlash"])]
    html = page("Title", "The lead.", [Section("First", cards=cards), Section("Second", ["A text."], tables=[table], items=["An item."])])
    places = [html.index(word) for word in ("The lead.", "Axis X", "Backlash", "A text.", "An item.", "there")]
    assert places == sorted(places)
    assert re.findall(r"<h3>(.*?)</h3>", html) == ["Where", "Which"]
    assert "<b>" not in html
    first, marked = re.findall(r"<tr.*?</tr>", html)[1:]
    assert re.findall(r"<td( class=\"[a-z ]+\")?>", first) == [' class="l"', "", ' class="l may"']
    assert 'class="mark"' in marked
    assert 'class="mark"' not in first


def test_only_long_words_ask_for_a_wide_column() -> None:
    """Five columns of words, each with room for a sentence, do not fit a page."""
    html = page(
        "Title",
        "the lead.",
        [Section("First", tables=[Table(["a", "b"], [["all", "runs one, two, three and four"]], words=frozenset({0, 1}))])],
    )
    assert re.findall(r'<td class="([\w ]+)">', html) == ["l may", "l w"]


def test_tables_fit_their_page() -> None:
    """Headings and words wrap, numbers do not; a caption is no part of the table, whose width it would take."""
    html = page(
        "Title",
        "the lead.",
        [
            Section(
                "First", tables=[Table(["what", "a long heading of a number"], [["x", "1"], ["a longer text", "1"]], caption="A caption.")]
            )
        ],
    )
    rules = {names.strip(): rule for names, rule in re.findall(r"([\w., ]+?) \{([^}]*)\}", html)}
    assert "white-space: nowrap" in rules["td"]
    assert "white-space: normal" in rules["th.l, td.may, td.w"]
    assert not any("nowrap" in rules[names] for names in ("th", "th, td", "th.l, td.l", "td.w"))
    assert re.findall(r'<td class="([\w ]+)">', html) == ["l", "l may"]
    assert "A caption." in html.partition("<table>")[0]
    assert "The lead." in html
