"""Every command line in the documentation is one that the parser takes; the help of every command is there."""

from __future__ import annotations

from pathlib import Path
import re
import shlex

import pytest

from tests.conftest import ROOT
from twin.cli.parser import COMMANDS, build_parser

WORDS = {name for group in COMMANDS.values() for name in group}
INLINE = re.compile(r"`(twin [a-z][^`|]*)`")
OPTIONAL = re.compile(r"\[[^\]]*\]|\.\.\.")
PAGES = [ROOT / "README.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ALONE = 2
"""Words of a line that only names a command, such as `twin gap`: nothing to parse."""


def documented() -> list[tuple[str, str]]:
    """(page, command line): indented lines and code words that begin with `twin COMMAND`."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        lines = [line.strip() for line in text.splitlines() if line.startswith("    twin ")]
        found += [(page.name, re.split(r" {2,}| # ", line)[0]) for line in [*lines, *INLINE.findall(text)]]
    return [(page, line) for page, line in dict.fromkeys(found) if line.split()[1] in WORDS and len(line.split()) > ALONE]


def test_there_are_many() -> None:
    assert len(documented()) > 50


@pytest.mark.parametrize(("page", "line"), documented())
def test_parsed(page: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(OPTIONAL.sub("", line).replace("new|check|show", "show").replace("230-2|230-4", "230-2"))[1:]
    parser = build_parser(words[0])
    try:
        parser.parse_args(words)
    except SystemExit:
        message = capsys.readouterr().err
        # a sentence may name an option of a command without all that the command needs
        assert re.search("required|expected one argument", message), f"{page}: {line}: {message}"


@pytest.mark.parametrize("name", sorted(WORDS))
def test_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        build_parser(name).parse_args([name, "--help"])
    assert stop.value.code == 0
    assert not re.search(r"\b(tells?|told)\b", capsys.readouterr().out)


def test_examples_named_in_the_documentation_exist() -> None:
    for page in PAGES:
        for named in re.findall(r"\bexamples/[\w/.-]+\.(?:csv|mpf|toml|apt|py|xml|ngc)\b", page.read_text(encoding="utf-8")):
            assert Path(ROOT / named).is_file(), f"{page.name}: {named}"
