"""Site pages from outside docs/ or generated from code: a hook of mkdocs (mkdocs.yml).

README.md is the home page; the READMEs of models/ and examples/ and the changelog are pages; the reference of commands, Python names
and JSON files is generated from the parser, the docstrings and the schemas. Links between them are adapted to the site.
"""

from __future__ import annotations

import contextlib
import html
import inspect
import io
import json
from pathlib import Path
import posixpath
import re
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = {"README.md": "index.md", "models/README.md": "machine.md", "examples/README.md": "examples.md", "CHANGELOG.md": "changelog.md"}
"""File of the repository -> page of the site."""

_LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s#]+)(#[^)\s]*)?\)")
_FENCE = re.compile(r"(^```.*?^```)", re.M | re.S)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are not files of docs/, and the schemas of the files that users write (called by mkdocs)."""
    from mkdocs.structure.files import File

    sys.path.insert(0, str(ROOT))
    from twin.cli.schema import schemas

    for name, text in pages().items():
        files.append(File.generated(config, name, content=text))
    for name, schema in schemas().items():
        files.append(File.generated(config, f"schemas/{name}.schema.json", content=json.dumps(schema)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Adapt links from pages in docs/ to files outside of it (called by mkdocs)."""
    source = page.file.src_uri
    return markdown if source in pages() else links_on_site(markdown, f"docs/{source}", source)


def pages() -> dict[str, str]:
    """Name of a page -> its Markdown."""
    if not _PAGES:
        _PAGES.update({page: links_on_site((ROOT / file).read_text(encoding="utf-8"), file, page) for file, page in OUTSIDE.items()})
        _PAGES.update({"reference/commands.md": commands(), "reference/python.md": python_names(), "reference/json.md": json_files()})
    return _PAGES


_PAGES: dict[str, str] = {}


def links_on_site(text: str, file: str, page: str) -> str:
    """Text of a file of the repository with its links adapted to a page of the site.

    A link to a file that has no page becomes its path.
    """

    def turned(match: re.Match[str]) -> str:
        words, target, anchor = match[1], match[2], match[3] or ""
        if "://" in target:
            return match[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(file), target))
        if path in OUTSIDE:
            path = f"docs/{OUTSIDE[path]}"
        if path.startswith("docs/"):
            return f"{words}({posixpath.relpath(path[len('docs/') :], posixpath.dirname(page) or '.')}{anchor})"
        if not (ROOT / path).exists():
            raise SystemExit(f"{file}: {target}: no such file")
        return f"{words[1:-1]} (`{path}`)" if words[1:-1].strip("`") != path else f"`{path}`"

    return "".join(part if part.startswith("```") else _LINK.sub(turned, part) for part in _FENCE.split(text))


def commands() -> str:
    """The help of every command."""
    sys.path.insert(0, str(ROOT))
    from twin.cli.parser import COMMANDS, build_parser

    out = ["# Commands", "", "Output of `twin COMMAND --help`. Exit codes: 0 done, 1 a verdict that fails, 2 bad input or usage."]
    for group, of_group in COMMANDS.items():
        out += ["", f"## {group[0].upper() + group[1:]}"]
        for name in of_group:
            printed = io.StringIO()
            with contextlib.suppress(SystemExit), contextlib.redirect_stdout(printed):
                build_parser(name).parse_args([name, "--help"])
            out += ["", f"### twin {name}", "", "```text", printed.getvalue().rstrip(), "```"]
    return "\n".join(out) + "\n"


def python_names() -> str:
    """The public names with signature and docstring."""
    sys.path.insert(0, str(ROOT))
    import twin

    out = ["# Python names", "", "The public names of `import twin`; [From Python](../python.md) shows their use."]
    for name in sorted(n for n in twin.__all__ if not n.startswith("_")):
        thing = getattr(twin, name)
        function = getattr(thing, "__wrapped__", thing)  # of a package that is called like its function
        out += ["", f"## {name}", ""]
        if callable(function):
            with contextlib.suppress(TypeError, ValueError):
                out += ["```python", f"twin.{name}{inspect.signature(function)}", "```", ""]
        out += ["```text", inspect.getdoc(function) or "", "```"]
        members = [m for m in vars(thing) if not m.startswith("_")] if inspect.isclass(thing) else []
        rows = [(m, inspect.getdoc(getattr(thing, m, None)) or "") for m in members]
        described = [(m, text.splitlines()[0]) for m, text in rows if text and not isinstance(getattr(thing, m), (int, float, str, dict))]
        if described:
            out += [
                "",
                "| member | meaning |",
                "|---|---|",
                *(f"| `{m}` | {html.escape(text).replace('|', chr(92) + '|')} |" for m, text in described),
            ]
    return "\n".join(out) + "\n"


def json_files() -> str:
    """The formats of the JSON files, from their schemas."""
    out = [
        "# JSON files",
        "",
        "Each file begins with `schema` (name and number of its format) and `version` (of twin). Source: `twin/report/schemas`.",
    ]
    for file in sorted((ROOT / "twin" / "report" / "schemas").glob("*.json")):
        schema = json.loads(file.read_text(encoding="utf-8"))
        out += ["", f"## {file.stem}", "", schema.get("title", ""), "", "| key | type | always | meaning |", "|---|---|---|---|"]
        for key, of in schema.get("properties", {}).items():
            kind = of.get("type", "one of " + ", ".join(f"`{v}`" for v in of["enum"]) if "enum" in of else "")
            kinds = " or ".join(kind) if isinstance(kind, list) else kind
            always = "yes" if key in schema.get("required", ()) else ""
            out.append(f"| `{key}` | {kinds} | {always} | {html.escape(of.get('description', ''))} |")
    return "\n".join(out) + "\n"
