"""Numbers of the pages against the outputs of commands (devtools/pages.py): what is seen, corrected and refused; every picture has a recipe."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from devtools.pages import PAGES, agrees, claims, differences
from devtools.pictures import PICTURES, recipe_of

PAGE = """The error grows from 9.7 to 18.1 um at 15 m/min.

<!-- numbers: twin run a.csv
X  after reversals  {9.7} um  {18.1} um
-->

<!-- output -->

    $ twin check parts
    program    moves     time
    ---------  -----  -------
    one.mpf       77  257.3 s
      ...
    three.mpf   1012   85.6 s

End.
"""
OUTPUTS = {
    "twin run a.csv": "axis\nX  largest  9.69 um  12.00 um\nX  after reversals  9.69 um  18.13 um  1 %\n",
    "twin check parts": "program  moves  time\none.mpf  77  257.31 s  ok\ntwo.mpf  13  18.5 s  ok\nthree.mpf  1012  85.6 s  ok\n",
}


def found(tmp_path: Path, page: str, write: bool = False, **changes: str) -> tuple[list[str], str]:
    """The differences of a page, and the page afterwards."""
    file = tmp_path / "page.md"
    file.write_text(page, encoding="utf-8")
    run: Callable[[str], str] = {**OUTPUTS, **{f"twin {k.replace('_', ' ')}": v for k, v in changes.items()}}.__getitem__
    return differences(file, run, write=write), file.read_text(encoding="utf-8")


def test_a_true_page_passes(tmp_path: Path) -> None:
    assert len(claims(PAGE)) == 2
    assert found(tmp_path, PAGE)[0] == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{9.7}", "{9.8}", "9.8 is now 9.69"),
        ("77 ", "78 ", "78 is now 77"),
        ("257.3 s", "257.4 s", "257.4 is now 257.31"),
        ("three.mpf ", "four.mpf ", "does not print: four.mpf"),
        ("to 18.1", "to 18.2", "the paragraph above `twin run a.csv` does not say 18.1"),
        ("after reversals", "after stops", "does not print: X  after stops"),
    ],
)
def test_a_false_page_fails(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert any(words in text for text in found(tmp_path, PAGE.replace(old, new))[0])


def test_written_numbers_keep_their_digits_and_agree(tmp_path: Path) -> None:
    now = OUTPUTS["twin check parts"].replace("257.31", "261.48")
    then = {"run_a.csv": "X  after reversals  8.44 um  20.06 um\n"}
    assert len(found(tmp_path, PAGE, True, check_parts=now, **then)[0]) == 3
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    for text in ("from 8.4 to 20.1 um at 15 m/min", "{8.4} um  {20.1} um", "77  261.5 s"):
        assert text in page
    assert found(tmp_path, page, check_parts=now, **then)[0] == []


def test_a_mark_without_its_lines_is_refused() -> None:
    with pytest.raises(SystemExit, match="without a block"):
        claims("Text.\n\n<!-- output -->\nno block\n")


@pytest.mark.parametrize(
    ("said", "right", "wrong"),
    [("9.7", "9.69", "9.79"), ("0.064", "0.065", "0.066"), ("500", "500.00", "501"), ("1.5e-3", "1.52e-3", "-1.5e-3")],
)
def test_numbers_agree_to_their_last_digit(said: str, right: str, wrong: str) -> None:
    assert agrees(said, right)
    assert not agrees(said, wrong)


def test_pages_have_claims_and_pictures_have_recipes() -> None:
    assert sum(len(claims(page.read_text(encoding="utf-8"))) for page in PAGES) >= 9
    pictures = [file.relative_to(PICTURES).as_posix() for file in PICTURES.rglob("*.*")]
    assert [picture for picture in pictures if recipe_of(picture) is None] == []
