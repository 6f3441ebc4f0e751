"""Every example of the tree is run: by a case of the regression suites, by a test, or by a command that a test executes."""

from pathlib import Path
import re

import pytest

from tests.conftest import ROOT

EXAMPLES = ROOT / "examples"
KINDS = (".py", ".mpf", ".apt", ".ngc", ".h", ".csv")
"""What can be run: scripts, programs, tables of set points or readings."""
HELD = ("golden",)
"""Folders of results, not of examples."""


def runnable() -> list[Path]:
    """All examples that can be run."""
    return [f for f in sorted(EXAMPLES.rglob("*")) if f.suffix in KINDS and not set(HELD) & set(f.relative_to(EXAMPLES).parts)]


def runners() -> str:
    """The text of what runs examples in CI: tests, suites, studies, and the examples that run other files."""
    files = [f for f in (ROOT / "tests").rglob("*.py") if f.name != Path(__file__).name]
    files += [*(EXAMPLES / "regression").rglob("*.toml"), *(EXAMPLES / "studies").glob("*.toml")]
    return "\n".join(f.read_text(encoding="utf-8") for f in files)


def is_run(example: Path, text: str) -> bool:
    """Whether a test or a case names the file: its name in full, or its folder and its stem where the name is only run.py."""
    if example.name in ("run.py",):
        folder = re.escape(example.parent.relative_to(EXAMPLES).as_posix())
        return re.search(rf"{folder}/run|{re.escape(example.parent.name)}[\"'] ?/ ?[\"']run", text) is not None
    stem, name = re.escape(example.stem), re.escape(example.name)
    return re.search(rf"(?<![\w-]){name}(?![\w])|[\"']{stem}[\"']|from [\w.]*\b{stem} import", text) is not None


@pytest.mark.parametrize("example", [f.relative_to(EXAMPLES).as_posix() for f in runnable()])
def test_the_example_is_run_by_a_test(example: str) -> None:
    assert is_run(EXAMPLES / example, runners()), f"no test or regression case runs examples/{example}: add one"


def test_an_example_that_nothing_runs_is_noticed() -> None:
    text = runners()
    assert not is_run(EXAMPLES / "not_there.mpf", text)
    assert not is_run(EXAMPLES / "nowhere" / "run.py", text)
