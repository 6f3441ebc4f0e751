"""How far the reader agrees with LinuxCNC's interpreter on LinuxCNC's own tests, which are read from where they lie.

    python devtools/linuxcnc_agreement.py ../shared/data/linuxcnc/interp [--all]

The expected canonical calls are replayed to machine coordinates, with their offsets, turns and units, and compared with the moves
that the reader puts out: end points, kinds, centres and senses of arcs, feeds, to what the output prints (4 digits); and the
messages. Moves without a way are left out on both sides.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field
import math
from pathlib import Path
import re
import tempfile
from typing import ClassVar

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.program import moves as mv
from twin.program import read
from twin.program.build import Collector
from twin.program.expressions import WordError
from twin.program.iso_blocks import Iso

MESSAGES_ONLY = {"machine-coord-params", "rotation/abs-pts"}
"""Tests whose script keeps only the messages."""
PRINTED = 0.5e-4
"""Half of the last digit that LinuxCNC prints, in its unit."""
KIND_NAMES = ("rapid", "line", "arc", "dwell")
CLOSE = 1e-6
"""Beyond that, agreement is to this [program unit]."""
INCH = 25.4e-3
"""[m]"""
WITHOUT_M98 = "test-no-fanuc.ini"
"""A configuration of LinuxCNC that switches M98 off, which no program can: runs with it are left out."""
_ACTIVE = re.compile(r"[(;]\s*(DEBUG|PRINT|MSG)\s*,([^()]*(?:\([^()]*\)[^()]*)*)", re.I)
_IN_MESSAGE = re.compile(r"%[df]|%\.(\d)f|#(<[^>]*>|\d+)")
_CALL = re.compile(r"(?:N\S*\s+)?([A-Z][A-Z0-9_]+)\((.*)\)\s*$")


class Talking(Iso):
    """The reader, which also keeps the texts of MSG, DEBUG and PRINT with the values behind their block."""

    messages: ClassVar[list[str]] = []
    block = ""

    def run(self) -> None:
        self.messages.clear()
        super().run()
        self.speak("")

    def fast(self, text: str, line: int) -> bool:
        self.speak(text)
        return super().fast(text, line)

    def speak(self, following: str) -> None:
        """The texts of the block that has run."""
        for kind, text in _ACTIVE.findall(self.block):
            places = 6

            def value(match: re.Match[str]) -> str:
                nonlocal places
                if not match[2]:
                    places = {"%d": 0, "%f": 4}.get(match[0], int(match[1] or 6))
                    return ""
                try:
                    return f"{self.number_of('#' + match[2].upper(), 1):.{places}f}"
                except WordError:
                    return "######"

            self.messages.append(text if kind.upper() == "MSG" else _IN_MESSAGE.sub(value, text))
        self.block = following


def understand(program: Path, machine: Machine) -> Collector:
    """The moves of a program; `Talking` keeps its messages."""
    read.Iso = Talking  # type: ignore[misc]
    return read.understand(program, machine)


@dataclass
class Canon:
    """What canonical calls amount to: moves in mm, deg and mm/min, messages, whether the run ended in an error."""

    moves: list[tuple] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    filtered: bool = False


def numbers(text: str) -> list[float]:
    return [float(v) for v in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def replay(lines: list[str]) -> Canon:
    """Canonical calls as moves in machine coordinates."""
    canon, unit, plane = Canon(), 1.0, "XY"
    origin, shift, turn, feed = np.zeros(3), np.zeros(3), 0.0, 0.0
    here, raw = np.zeros(5), np.zeros(3)
    seen, turning, per_turn = False, 0.0, 0.0

    def machine(point: np.ndarray) -> np.ndarray:
        c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        p = (point + shift) * unit
        return np.array([c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]]) + origin * unit

    for line in lines:
        match = _CALL.search(line)
        if not match:
            continue
        name, text = match[1], match[2]
        n = numbers(text) if name not in ("MESSAGE", "COMMENT") else []
        if name == "USE_LENGTH_UNITS":
            new = 25.4 if "INCH" in text else 1.0
            origin, shift, raw, feed = origin * unit / new, shift * unit / new, raw * unit / new, feed * unit / new
            unit = new
        elif name == "SET_G5X_OFFSET":
            origin = np.array(n[1:4])
        elif name == "SET_G92_OFFSET":
            shift = np.array(n[:3])
        elif name == "SET_XY_ROTATION":
            turn = n[0]
        elif name == "SELECT_PLANE":
            plane = text.split("_")[-1]
        elif name == "SET_FEED_RATE":
            feed = n[0]
        elif name == "SET_SPINDLE_SPEED":
            turning = n[-1]
        elif name == "START_SPEED_FEED_SYNC":
            per_turn = n[0]
        elif name == "RIGID_TAP":  # down and back
            for place in (np.array(n[:3]), raw):
                canon.moves.append((mv.LINE, np.concatenate([machine(place), here[3:]]), None, per_turn * turning * unit, unit))
        elif name == "MESSAGE":
            canon.messages.append(text.strip('"').strip())
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED"):
            arc = None
            if name == "ARC_FEED":
                first, second, third = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "YZ": (1, 2, 0)}[plane]
                raw = raw.copy()
                raw[first], raw[second], raw[third] = n[0], n[1], n[5]
                centre = raw.copy()
                centre[first], centre[second] = n[2], n[3]
                arc = machine(centre), n[4], (first, second)
                end = np.concatenate([machine(raw), [n[6], n[8]]])
            else:
                raw = np.array(n[:3])
                end = np.concatenate([machine(raw), [n[3], n[5]]])
            kind = {"STRAIGHT_TRAVERSE": mv.RAPID, "STRAIGHT_FEED": mv.LINE, "ARC_FEED": mv.ARC}[name]
            if arc is not None or np.abs(end - here).max() > 2.0 * PRINTED * unit or not seen:
                canon.moves.append((kind, end, arc, feed * unit, unit))
            here, seen = end, True
    return canon


def ours(out: Collector) -> Canon:
    """The reader's moves and messages in the same form."""
    canon = Canon(messages=[m.strip() for m in Talking.messages])
    here = np.zeros(5)
    for row, (kind, target) in enumerate(zip(out.kinds, out.targets)):
        if kind == mv.DWELL:
            continue
        end = np.array(target) * [1e3, 1e3, 1e3, 180.0 / math.pi, 180.0 / math.pi]
        end = np.where(np.isnan(end), here, end)
        arc = None
        if kind == mv.ARC:
            centre, normal, angle = out.arcs[row]
            arc = centre * 1e3, normal, angle
        mode = out.all_modes[out.mode_of[row]]
        feed = out.feeds[row] * mode.feed_unit * 1e3
        if mode.feed_mode == 93:
            feed *= float(np.linalg.norm(end[:3] - here[:3])) if arc is None else arc[2] * float(np.linalg.norm(here[:3] - arc[0])) / 1.0
            feed /= mode.feed_unit * 1e3
        canon.moves.append((kind, end, arc, feed))
        here = end
    return canon


def differences(expected: Canon, found: Canon) -> str:
    """The first difference in words; empty if there is none."""
    place = np.zeros(5)
    mine, theirs = ways(found.moves), ways(expected.moves)
    if not theirs and expected.messages and expected.filtered:
        mine = []
    for k, (a, b) in enumerate(zip(theirs, mine)):
        unit = a[4]
        if a[0] != b[0]:
            return f"move {k}: kind {KIND_NAMES[a[0]]}, here {KIND_NAMES[b[0]]} ({np.round(b[1], 4)})"
        if np.abs(a[1] - b[1]).max() > 3.0 * (PRINTED * unit + CLOSE):
            return f"move {k}: end {np.round(a[1], 4)}, here {np.round(b[1], 4)}"
        if a[0] != mv.RAPID and abs(a[3] - b[3]) > PRINTED * unit + CLOSE * max(1.0, a[3]) + 1e-6 * abs(a[3]):
            return f"move {k}: feed {a[3]:.6g}, here {b[3]:.6g}"
        if a[0] == mv.ARC:
            centre, rotation, (first, second) = a[2]
            here_centre, normal, angle = b[2]
            if max(abs(centre[i] - here_centre[i]) for i in (first, second)) > 3.0 * (PRINTED * unit + CLOSE):
                return f"move {k}: centre {np.round(centre, 4)}, here {np.round(here_centre, 4)}"
            if math.copysign(1.0, rotation) * normal.sum() < 0 or math.ceil(round(angle / (2 * math.pi), 6)) != abs(rotation):
                return f"move {k}: arc of {rotation:g} turns, here {angle:g} rad about {normal}"
        place = a[1]
    if len(theirs) != len(mine):
        return f"{len(theirs)} moves, here {len(mine)}; last common {place}"
    wanted = [re.sub(r"\s+", " ", m) for m in expected.messages]
    got = [re.sub(r"\s+", " ", m) for m in found.messages]
    wanted = [re.sub(r"-0\.000000", "0.000000", m) for m in wanted]
    got = [re.sub(r"-0\.000000", "0.000000", m) for m in got]
    if wanted and wanted != got[-len(wanted) :] and wanted != [g for g in got if g in wanted]:
        pairs = [(a, b) for a, b in zip(wanted, got) if a != b]
        return f"messages: {pairs[0] if pairs else (len(wanted), len(got))}"
    return ""


def ways(moves: list[tuple]) -> list[tuple]:
    """The moves that go somewhere."""
    out, here = [], np.zeros(5)
    for m in moves:
        if m[2] is not None or np.abs(m[1] - here).max() > 2e-4 * (25.4 if len(m) > 4 and m[4] > 1 else 1.0):
            out.append(m)
            here = m[1]
    return out


@dataclass
class Case:
    """One test: its programs in the order in which its script runs them, each with what is expected."""

    name: str
    runs: list[tuple[Path, list[str], bool]]
    table: Path | None


def cases(folder: Path) -> list[Case]:
    """Each test that has an expected output."""
    found = []
    for file in sorted(folder.rglob("*expected")):
        text = file.read_text(errors="replace").splitlines()
        if file.name != "expected":
            found.append(Case(file.name, [(file.with_name(file.name.removesuffix(".expected")), text, False)], None))
            continue
        name = str(file.parent.relative_to(folder))
        script = file.with_name("test.sh")
        body = script.read_text() if script.is_file() else ""
        for word in re.findall(r'(\w+)="([^"]*)"', body):
            stems = word[1].split()
            body = re.sub(
                rf"for t in \${word[0]}; do(.*?)done",
                lambda m, stems=stems: "".join(m[1].replace("${t}", s) for s in stems),
                body,
                flags=re.S,
            )
        runs = re.findall(r"^(.*)rs274 ([^|\n]*?)([^\s\"\']+\.ngc)", body, re.M)
        programs = [(file.parent / p, "!" in before or "illegal" in p, WITHOUT_M98 in options) for before, options, p in runs]
        programs = [p for p in programs if p[0].is_file()] or [(p, False, False) for p in sorted(file.parent.glob("*.ngc"))[:1]]
        starts = [
            i
            for i, line in enumerate(text)
            if "USE_LENGTH_UNITS(CANON_UNITS_MM)" in line and "SET_G5X_OFFSET(1, 0.0" in "".join(text[i + 1 : i + 2])
        ]
        parts = (
            [text[a:b] for a, b in zip(starts, [*starts[1:], len(text)])] if len(programs) > 1 and len(starts) == len(programs) else None
        )
        table = next((file.with_name(t) for t in re.findall(r"-t (\S+)", body)), None)
        keep = [(p, t, f) for (p, f, without), t in zip(programs, parts or [text] * len(programs)) if not without]
        if programs:
            found.append(Case(name, keep if parts else keep[:1], table))
    return found


def with_table(machine: Machine, table: Path, folder: Path) -> Machine:
    """The machine with the tools of a table of LinuxCNC.

    A table is in the length unit of the machine, and that of the interpreter without a configuration is the inch.
    """
    lines = []
    for line in table.read_text().splitlines():
        if match := re.match(r"\s*T(\d+)\s+P\d+.*?Z(\S+).*?D([\d.+-]+)", line):
            lines.append(f"[tool.T{match[1]}]\nlength_m = {float(match[2]) * INCH!r}\nradius_m = {0.5 * float(match[3]) * INCH!r}\n")
    path = folder / "machine.toml"
    write_machine(machine, path)
    path.write_text(path.read_text() + "\n" + "\n".join(lines))
    return load_machine(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--all", action="store_true", help="print each test, not only the sums")
    args = parser.parse_args()
    machine = load_machine()
    counts: Counter[str] = Counter()
    for case in cases(args.folder):
        results, difference = set(), ""
        with tempfile.TemporaryDirectory() as folder:
            equipped = with_table(machine, case.table, Path(folder)) if case.table and case.table.is_file() else machine
            for program, text, fails in case.runs:
                expected = replay(text)
                expected.filtered = case.name in MESSAGES_ONLY
                try:
                    difference = "must fail, was accepted" if fails else difference
                    found = differences(expected, ours(understand(program, equipped)))
                    results.add("differs" if found or fails else "agrees")
                    difference = found or difference
                except InputError as error:
                    results.add("agrees" if fails else "refused")
                    difference = difference or str(error).split(": ", 1)[-1]
        result = "differs" if "differs" in results else "refused" if "refused" in results else "agrees"
        counts[result] += 1
        if args.all or result == "differs":
            print(f"{result:8} {case.name:40} {difference[:170]}")
    total = sum(counts.values())
    print(f"\n{total} tests: " + ", ".join(f"{n} {k} ({n / total:.2f})" for k, n in counts.most_common()))
    bad = sorted(args.folder.glob("bad/*.ngc"))
    refused = 0
    for program in bad:
        try:
            understand(program, machine)
            print(f"accepted, must fail: {program.name}")
        except InputError as error:
            refused += 1
            if args.all:
                print(f"refused  {program.name:40} {str(error).split(': ', 1)[-1][:150]}")
    print(f"{refused} of {len(bad)} must-fail programs refused")


if __name__ == "__main__":
    main()
