"""Numbers of the pages against the code that makes them; all pictures of the pages.

    python -m devtools.pages --check        run the commands behind the pages' numbers; exit code 1 and one line for each that differs (CI)
    python -m devtools.pages --write        the same, and correct the numbers in the pages
    python -m devtools.pages --pictures     make every picture (devtools/pictures.py)

Two marks in a page name the command behind its numbers. An output, in which lines may be left out:

    <!-- output -->

        twin check examples/parts
        part1_tangent_planes.mpf   ok          77  257.3 s

Numbers of a sentence: a comment right after its paragraph has the command and the lines of its output, with each number that the paragraph
repeats in braces. Such a line may be shorter than that of the output: it is searched anywhere in it.

    The error after the reversal grows from 9.7 to 18.1 um.
    <!-- numbers: twin run examples/x_200mm.csv --effect backlash:X:clearance=15e-6 --beside
    largest {9.7} um {18.1} um
    -->

`slow output` and `slow numbers` are only run with --slow. Commands begin with `twin` or `python` and run in one folder that has
`examples` and `models`; those of a page run in its order, so one may read what another wrote.

A decimal number agrees if it differs from the output by at most half a unit of its own last digit, plus one unit of the output's last
digit (another processor may round differently). A whole number has to be the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
import contextlib
from dataclasses import dataclass
import io
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
import tempfile

from devtools.pictures import make_all

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "models" / "README.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])(?!\.\d)")
OUTPUT = re.compile(r"^<!-- (slow )?output -->\n\n((?:(?: {4}.*)?\n)+)", re.M)
NUMBERS = re.compile(r"^<!-- (slow )?numbers: (.+)\n((?:.+\n)+?)-->", re.M)
MARK = re.compile(r"^<!-- (?:slow )?(?:output|numbers)", re.M)


@dataclass(frozen=True)
class Claim:
    """Lines that a page expects of a command. `lines` are (start, end) in the page's text; `repeats` is the paragraph of the numbers in
    braces, None for an output block."""

    command: str
    slow: bool
    lines: tuple[tuple[int, int], ...]
    repeats: tuple[int, int] | None = None


def claims(page: str) -> list[Claim]:
    """All claims of a page, in its order."""
    found = []
    for block in OUTPUT.finditer(page):
        command, lines = "", []
        for line in re.finditer(r"^ {4}(.*\S)", block[2], re.M):
            start, text = block.start(2) + line.start(1), line[1].removeprefix("$ ")
            if text.startswith(("twin ", "python ")):
                if lines:
                    found.append((start, Claim(command, bool(block[1]), tuple(lines))))
                command, lines = re.split(r" {2,}| # ", text)[0], []
            elif text.strip() != "..." and set(text) - set("- "):
                lines.append((start, block.start(2) + line.end(1)))
        found.append((block.end(), Claim(command, bool(block[1]), tuple(lines))))
    for note in NUMBERS.finditer(page):
        lines = [(note.start(3) + line.start(), note.start(3) + line.end()) for line in re.finditer(r".+", note[3])]
        before = re.sub(r"<!--.*?-->", lambda comment: " " * len(comment[0]), page[: note.start()], flags=re.S).rstrip()
        found.append((note.end(), Claim(note[2].strip(), bool(note[1]), tuple(lines), (before.rfind("\n\n") + 1, len(before)))))
    if len(MARK.findall(page)) != len(OUTPUT.findall(page)) + len(NUMBERS.findall(page)):
        raise SystemExit("a mark `output` without a block, or `numbers` without lines: see python -m devtools.pages --help")
    return [claim for _, claim in sorted(found, key=lambda pair: pair[0])]


def form(line: str) -> str:
    """A line with `#` for each number and single spaces: what has to be the same."""
    return " ".join(NUMBER.sub("#", line.replace("{", "").replace("}", "")).split())


def agrees(said: str, is_now: str) -> bool:
    """Whether a number of a page is that of the output; both as printed."""
    units = [
        10.0 ** -len(n.lower().partition("e")[0].partition(".")[2]) * 10.0 ** float(n.lower().partition("e")[2] or 0)
        for n in (said, is_now)
    ]
    allowed = 0.5 * units[0] + units[1] if "." in is_now or "e" in is_now else 0.5 * (units[0] if "." in said else 0.0)
    return abs(float(said) - float(is_now)) <= allowed * (1.0 + 1e-9)


def as_said(said: str, is_now: str) -> str:
    """The number of the output with the digits and the sign convention of the page's."""
    decimals = len(said.partition(".")[2])
    return is_now if "e" in said + is_now else f"{float(is_now):{'+' if said[0] == '+' else ''}.{decimals}f}"


def compared(page: str, claim: Claim, output: str) -> Iterator[tuple[str, list[tuple[int, int, str]]]]:
    """Differences: what a person reads, and the corrections (start, end, text) in the page; none where the line is missing."""
    rows = output.splitlines()
    row = 0
    for start, end in claim.lines:
        said = page[start:end]
        hits = [k for k in range(row, len(rows)) if form(said) in form(rows[k])]
        if not hits:
            yield f"`{claim.command}` does not print: {said.strip()}", []
            continue
        marks = list(NUMBER.finditer(said))
        # the line that agrees in most numbers: tables have many lines of one form
        now = {k: _numbers_of(rows[k], said) for k in hits}
        best = max(hits, key=lambda k: (sum(agrees(m[0], n) for m, n in zip(marks, now[k])), -k))
        row = best + 1
        for mark, number in zip(marks, now[best]):
            if not agrees(mark[0], number):
                new = as_said(mark[0], number)
                changes = [(start + mark.start(), start + mark.end(), new)]
                if claim.repeats and said[mark.start() - 1 : mark.start()] == "{":
                    changes += [(m.start(), m.end(), new) for m in _in_paragraph(page, claim, mark[0])]
                yield f"`{claim.command}`: {mark[0]} is now {number}, in: {said.strip()}", changes
        if claim.repeats:
            for mark in re.finditer(r"\{([^}]+)\}", said):
                if not list(_in_paragraph(page, claim, mark[1])):
                    yield f"the paragraph above `{claim.command}` does not say {mark[1]}", []


def _numbers_of(row: str, said: str) -> list[str]:
    """The numbers of an output line that stand where the page's line has its own."""
    before = form(row).partition(form(said))[0].count("#")
    return NUMBER.findall(row)[before:]


def _in_paragraph(page: str, claim: Claim, number: str) -> Iterator[re.Match[str]]:
    assert claim.repeats
    return (m for m in NUMBER.finditer(page, *claim.repeats) if m[0].lstrip("+") == number.lstrip("+"))


def put_between(page: Path, name: str, text: str) -> None:
    """Write a text into a page, between `<!-- name -->` and `<!-- end name -->`. A page without them raises ValueError."""
    before, rest = page.read_text(encoding="utf-8").split(f"<!-- {name} -->\n")
    page.write_text(f"{before}<!-- {name} -->\n\n{text}\n\n<!-- end {name} -->{rest.split(f'<!-- end {name} -->')[1]}", encoding="utf-8")


def corrected(page: str, changes: Sequence[tuple[int, int, str]]) -> str:
    """The page with all corrections."""
    for start, end, text in sorted(set(changes), reverse=True):
        page = page[:start] + text + page[end:]
    return page


class Folder:
    """Runs commands in one temporary folder, each once."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.outputs, self.seconds = folder, dict[str, str](), dict[str, float]()
        for name in ("examples", "models", "devtools"):
            (folder / name).symlink_to(ROOT / name)

    def __call__(self, command: str) -> str:
        if command not in self.outputs:
            begin = sum(os.times()[:4])
            self.outputs[command] = self._run([file for word in shlex.split(command) for file in self._files(word)])
            self.seconds[command] = sum(os.times()[:4]) - begin
        return self.outputs[command]

    def _files(self, word: str) -> list[str]:
        """The files of a pattern, as a shell gives them; any other word as it is."""
        return sorted(file.relative_to(self.folder).as_posix() for file in self.folder.glob(word)) if "*" in word else [word]

    def _run(self, words: list[str]) -> str:
        if words[0] == "python":
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            done = subprocess.run([sys.executable, *words[1:]], cwd=self.folder, env=environment, capture_output=True, text=True)
            return done.stdout if done.returncode == 0 else f"failed: {done.stderr}"
        from twin.cli import main as twin

        out, before = io.StringIO(), Path.cwd()
        os.chdir(self.folder)
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()) as err:
                code = twin(words[1:])
        finally:
            os.chdir(before)
        return out.getvalue() if code == 0 or out.getvalue() else f"failed: {err.getvalue()}"


def differences(file: Path, run: Callable[[str], str], slow: bool = False, write: bool = False) -> list[str]:
    """One line for each number of the page that is not the code's; `write` corrects those that are known."""
    page, texts, changes = file.read_text(encoding="utf-8"), [], []
    for claim in claims(page):
        if claim.slow and not slow:
            continue
        for text, change in compared(page, claim, run(claim.command)):
            place = page.count("\n", 0, claim.lines[0][0] if claim.lines else 0) + 1
            texts.append(f"{file.name}:{place}: {text}")
            changes += change
    if write and changes:
        file.write_text(corrected(page, changes), encoding="utf-8")
    return texts


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m devtools.pages", description=(__doc__ or "").splitlines()[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true", help="list the numbers that differ")
    what.add_argument("--write", action="store_true", help="correct them")
    what.add_argument("--pictures", action="store_true", help="make the pictures")
    parser.add_argument("--slow", action="store_true", help="with the claims marked slow: minutes")
    parser.add_argument("--only", action="append", metavar="NAME", help="of this page, or this picture (several times)")
    args = parser.parse_args(arguments)
    if args.pictures:
        return make_all(args.only)
    found, number = [], 0
    with tempfile.TemporaryDirectory() as folder:
        run = Folder(Path(folder))
        for page in PAGES:
            if not args.only or page.stem in args.only:
                found += differences(page, run, args.slow, args.write)
                number += len(claims(page.read_text(encoding="utf-8")))
    print("\n".join(found))
    print(f"pages: {len(found)} differences; {number} claims")
    for command, seconds in run.seconds.items():
        print(f"{seconds:6.1f} s of processor time  {command}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
