"""Check a folder of programs: whether each is understood, fits the machine and keeps its limits."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.errors import InputError, TwinError
from twin.machine.machine import Machine
from twin.program.build import MovesNothing
from twin.program.interpolator import set_point_blocks
from twin.program.moves import Program
from twin.program.part_placement import OutsideTravel, placed
from twin.program.read import PROGRAM_ENDINGS, is_program, read_program, understand
from twin.program.source import ProgramText
from twin.simulation.setpoint_limits import LimitWatch
from twin.simulation.setpoints import setpoints_of
from twin.units import AXIS_UNITS

NO_MOVE = "the program moves no axis"
MOST_WORDS = 8
"""Words that are looked for in one refused program."""
_UNREAD = re.compile(
    r": (?:word |statement )?'?([A-Z$#][^':=(]{0,30}?)'?(?:=\S+)?(?: between .*)? is not (?:known|supported|simulated)\b(?! and there is no subprogram)"
)


@dataclass(frozen=True)
class Checked:
    """Result for one program: whether it is understood and fits, its duration [s], and the reason if it is refused."""

    path: Path
    understood: bool
    fits: bool
    moves: int = 0
    duration_s: float | None = None
    reach: dict[str, tuple[float, float]] = field(default_factory=dict)  # axis -> lowest and highest position [m, rad]
    limits: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    reason: str = ""
    unread: tuple[str, ...] = ()  # words without which it would be understood; empty where data are missing or more is wrong

    @property
    def verdict(self) -> str:
        """One word."""
        if not self.understood:
            return "refused"
        if not self.fits:
            return "too large"
        return "above limits" if self.limits else "ok"


def programs_in(path: Path) -> list[Path]:
    """The programs in a folder and its subfolders, or the named file."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"{path}: no such program or folder; give a part program or a folder of them")
    found = sorted(p for p in path.rglob("*") if p.is_file() and is_program(p))
    if not found:
        raise InputError(f"{path}: holds no part program; their names end in {', '.join(PROGRAM_ENDINGS)}, or .txt or nothing")
    return found


def check_program(path: Path, machine: Machine, *, place: bool = False, plan: bool = True) -> Checked:
    """Read one program and, with `plan`, interpolate it block by block; `place` shifts a part that lies outside the travel."""
    program: Program | None = None
    try:
        try:
            program = read_program(path, machine)
        except OutsideTravel as error:
            program = error.program
            if not place:
                raise
            program = placed(program)
        if not plan:
            return Checked(path, True, True, moves=len(program), notes=program.notes)
        watch, end = LimitWatch(machine, machine.position_cycle), 0.0
        low, high = np.full(len(machine.axes), np.inf), np.full(len(machine.axes), -np.inf)
        for block in set_point_blocks(program, machine):
            position = setpoints_of(block, machine).position
            watch.add(position)
            low, high = np.minimum(low, position.min(axis=0)), np.maximum(high, position.max(axis=0))
            end = float(block.time[-1])
    except MovesNothing as nothing:
        return Checked(path, True, True, duration_s=0.0, notes=(*nothing.notes, NO_MOVE), reason=NO_MOVE)
    except TwinError as error:
        reason = str(error).removeprefix(f"{path}: ")
        if program is None:
            return Checked(path, False, False, reason=reason, unread=unread_words(path, machine, str(error)))
        return Checked(path, True, False, len(program), notes=program.notes, reason=reason)
    reach = {axis.name: (float(a), float(b)) for axis, a, b in zip(machine.axes, low, high) if b > a}
    return Checked(path, True, True, len(program), end, reach, tuple(watch.warnings()), program.notes)


def unread_words(path: Path, machine: Machine, reason: str) -> tuple[str, ...]:
    """All words that keep a program from being understood: the line of each is left out until the rest is read.

    Empty where the program then still lacks something else, such as a subprogram.
    """
    words: dict[str, None] = {}
    source: ProgramText | None = None
    while (word := _UNREAD.search(reason)) and (line := re.match(re.escape(str(path)) + r": line (\d+)", reason)):
        source = source or ProgramText(path)
        words[word[1]] = None
        if len(words) > MOST_WORDS or not source.lines[int(line[1]) - 1]:
            return ()
        source.lines[int(line[1]) - 1] = ""
        try:
            understand(source, machine)
            return tuple(words)
        except InputError as error:
            reason = str(error)
    return ()


def opening_words(checked: Sequence[Checked]) -> list[tuple[str, int, int]]:
    """Unknown words: how many programs could be read with this word alone, and how many it stops; the most useful word first."""
    opens = Counter(one.unread[0] for one in checked if len(one.unread) == 1)
    stops = Counter(word for one in checked for word in one.unread)
    return sorted(((word, opens[word], n) for word, n in stops.items()), key=lambda w: (-w[1], -w[2], w[0]))


def reasons(checked: Sequence[Checked]) -> list[tuple[str, int, str]]:
    """Reasons for refusal without their numbers, the count of each, and its first place; the commonest first."""
    count: Counter[str] = Counter()
    first: dict[str, str] = {}
    for one in checked:
        if one.reason:
            plain = re.sub(r"^line \d+(, (block|column) \S+)*: ", "", one.reason)
            kind = re.sub(r"(?<![A-Za-z\d.])-?\d+(\.\d+)?( \.\. -?\d+(\.\d+)?)?", "..", plain)  # a range is one
            count[kind] += 1
            first.setdefault(kind, f"{one.path.name}: {one.reason}")
    return [(kind, n, first[kind]) for kind, n in count.most_common()]


def document(checked: Sequence[Checked], machine: Machine) -> dict[str, Any]:
    """The content of the JSON file; positions in mm and degrees."""
    programs = []
    for one in checked:
        reach = {}
        for name, ends in one.reach.items():
            unit, factor = AXIS_UNITS[machine.axis(name).kind].position
            reach[name] = {"low": ends[0] * factor, "high": ends[1] * factor, "unit": unit}
        same = {name: getattr(one, name) for name in ("verdict", "understood", "fits", "moves", "duration_s", "reason")}
        programs.append({"file": str(one.path), **same, "reach": reach, "limits": list(one.limits), "notes": list(one.notes)})
    verdicts = Counter(one.verdict for one in checked)
    return {
        "machine": machine.name,
        "programs": programs,
        "verdicts": dict(verdicts),
        "words": [{"word": word, "opens": opens, "stops": stops} for word, opens, stops in opening_words(checked)],
        "reasons": [{"reason": r, "count": n, "first": f} for r, n, f in reasons(checked)],
    }
