"""The documentation: code blocks are what they say they are, the site has every page, and the first hour can be run from its page.

What is executed elsewhere: the Python of README.md and docs/python.md (test_front_door.py), every command of docs/first_hour.md
(scripts/first_hour, in CI). Every other command line is parsed (tests/cli/test_documented_commands.py). CI builds the site strictly: a
link, an anchor or a page without a place in the navigation fails there.
"""

from __future__ import annotations

import ast
import importlib
from importlib.metadata import packages_distributions
from pathlib import Path
import re
import tomllib

import pytest

from devtools import site_pages, wheel
from tests.conftest import ROOT

PAGES = [ROOT / "README.md", ROOT / "models" / "README.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)
BLOCKS = [(page.name, kind, text) for page in PAGES for kind, text in BLOCK.findall(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(("page", "text"), [(page, text) for page, kind, text in BLOCKS if kind == "toml"])
def test_toml_is_toml(page: str, text: str) -> None:
    assert tomllib.loads(text), page


@pytest.mark.parametrize(("page", "text"), [(page, text) for page, kind, text in BLOCKS if kind == "python"])
def test_python_imports_names_that_exist(page: str, text: str) -> None:
    for node in ast.walk(ast.parse(text, page)):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = importlib.import_module(node.module)
            assert all(hasattr(module, name.name) for name in node.names), f"{page}: {ast.unparse(node)}"


def test_the_effect_of_the_page_is_the_example_that_runs() -> None:
    def bodies(text: str) -> dict[str, str]:
        functions = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
        return {f.name: "\n".join(ast.unparse(line) for line in f.body) for f in functions}

    (block,) = (text for page, kind, text in BLOCKS if page == "effects.md" and kind == "python")
    example = ROOT / "examples" / "own_effect" / "load_friction.py"
    assert bodies(block) == bodies(example.read_text(encoding="utf-8"))


def test_the_first_hour_is_one_list_of_commands() -> None:
    assert len(wheel.commands()) >= 12
    assert {command[0] for command in wheel.commands()} >= {"demo", "run", "gap", "diagnose", *wheel.WAIT_FOR_A_USER}


def test_the_site_has_a_page_for_everything() -> None:
    pages = site_pages.pages()
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in [*pages, *(p.name for p in PAGES if p.parent.name == "docs")]:
        assert f": {page}\n" in nav, page
    assert "### twin run" in pages["reference/commands.md"]
    assert "--beside" in pages["reference/commands.md"]
    assert "twin.simulate(" in pages["reference/python.md"]
    assert "## diagnosis" in pages["reference/json.md"]
    assert "(gallery.md)" in pages["index.md"]


def test_links_are_turned_to_the_site() -> None:
    turned = site_pages.links_on_site(
        "[t](docs/theory.md#accuracy) [m](models/README.md) ![p](docs/pictures/a.png)", "README.md", "index.md"
    )
    assert turned == "[t](theory.md#accuracy) [m](machine.md) ![p](pictures/a.png)"
    assert site_pages.links_on_site("[the file](../examples/x_200mm.csv)", "docs/a.md", "a.md") == "the file (`examples/x_200mm.csv`)"
    with pytest.raises(SystemExit, match=r"nowhere\.csv: no such file"):
        site_pages.links_on_site("[x](../nowhere.csv)", "docs/a.md", "a.md")


def test_pictures_exist() -> None:
    for page in PAGES:
        for picture in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / Path(picture)).is_file(), f"{page.name}: {picture}"


def test_setup_looks_for_nothing_that_it_does_not_install() -> None:
    """scripts/setup finds an installation incomplete if a module of its lists is no dependency: the commands of the README then end before they begin."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = re.findall(r'^\s*needs="(.*)"$', (ROOT / "scripts" / "setup").read_text(encoding="utf-8"), re.MULTILINE)
    runtime, tests = (words.replace("$needs", "").split() for words in lists)
    providers = packages_distributions()
    for modules, asked in ((runtime, project["dependencies"]), (tests, project["optional-dependencies"]["dev"])):
        names = {re.split(r"[^\w.-]", line, maxsplit=1)[0].lower().replace("_", "-") for line in asked}
        alone = [m for m in modules if not any(p.lower().replace("_", "-") in names for p in providers.get(m, []))]
        assert alone == []
