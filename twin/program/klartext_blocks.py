"""The reader of HEIDENHAIN Klartext (.h): lines, words of a block, Q parameters, what waits for the next block; `twin.program.klartext` has the words."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
import math
from pathlib import Path
import re

import numpy as np

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program.control import Move
from twin.program.expressions import COMPARE, FUNCTIONS, NUMBER, SUMS, Expression, Grammar, WordError, needed, no_value
from twin.program.flow import Call, Forms, Statement, statement_of
from twin.program.reader import ADD_CALL, NO_GROUP, Reader
from twin.program.source import Unit
from twin.program.state import NOTE, REFUSED, UNKNOWN, Item, Word
from twin.program.state import Block as Words

VALUE = r"[-+]?(?:\d+\.?\d*|\.\d+|Q[LR]?\d+)"
"""A number or a parameter with its sign, as it stands behind a letter."""
JOINT = " | "
_HEAD = re.compile(r"\A(\s*)(\d+)(?:\s+(?=[A-Z*;])|\s*\Z)")
_PART = re.compile(r"CYCL DEF (\d+)\.(\d+)\b")
_CONTOUR = re.compile(r"(?:L|LP|C|CP|CR|CT|CTP)\b")
_NAME = r"(?:LBL\s*)?(?P<target>\d+|\"[^\"]*\"|Q[LR]?\d+)"
FORMS: Forms = (
    ("lbl", LABEL := re.compile(rf"\s*LBL\s*{_NAME}\s*\Z")),
    ("repeat_label", re.compile(rf"\s*CALL LBL\s*{_NAME}\s+REP\s*(?P<times>\d+|Q[LR]?\d+)(?:/\d+)?\s*\Z")),
    ("call_label", re.compile(rf"\s*CALL LBL\s*{_NAME}\s*\Z")),
    ("goto", re.compile(rf"\s*FN\s*(?:9|10|11|12)\s*:\s*IF\s+(?P<text>.+?)\s+GOTO\s+{_NAME}\s*\Z")),
    ("call_program", re.compile(r"\s*CALL PGM\s*(?P<target>.+)\Z")),
    ("end", re.compile(r"\s*END PGM")),
)
FORMULA = re.compile(r"(?:FN\s*(?P<fn>\d+)\s*:\s*)?(?P<name>Q[LR]?\d+)\s*=(?P<text>.*)\Z")

_WORD = re.compile(
    rf"\s*(?:M\s*(?P<m>\d+)|(?P<alone>R[0LR](?![\w.])|DR\s*[-+](?![\d.Q])|F\s*(?:MAX|AUTO)|MB\s*MAX)|(?P<inc>I(?!F|MB|LA|BT))?"
    rf"(?P<name>PA|PR|CCA|CC[XYZ]|LEN|ABST|DIST|DR2|DR|DL|ROT|SCL|SP[ABC]|TA|[NT][XYZ]|MB|LA|BT|[A-CFLR-Z])\s*(?P<value>{VALUE}))",
    re.A,
)
SIDE, SENSE = "RL or RR", "DR+ or DR-"
_ALONE = {
    "R0": (SIDE, 0.0), "RL": (SIDE, 1.0), "RR": (SIDE, -1.0), "DR+": (SENSE, 1.0), "DR-": (SENSE, -1.0), "FMAX": ("F", math.inf),
    "FAUTO": ("F", math.nan), "MBMAX": ("MB", math.inf),
}  # fmt: skip
"""Words without a number: the name that they have in a block, and the number that they stand for."""

FORMULAS = Grammar(
    "()",
    {
        **{name: (1, COMPARE[sign]) for name, sign in (("EQU", "=="), ("NE", "<>"), ("GT", ">"), ("LT", "<"))},
        "+": (2, SUMS["+"]), "-": (2, SUMS["-"]), "*": (3, SUMS["*"]), "/": (3, SUMS["/"]), "DIV": (3, SUMS["/"]), "^": (4, lambda a, b: a**b),
        "LEN": (3, math.hypot), "ANG": (3, lambda a, b: math.degrees(math.atan2(a, b)) % 360.0),
    },
    {name: work for name, work in FUNCTIONS.items() if name != "ROUND"}
    | {
        "SQ": lambda x: x * x, "ATAN": lambda x: math.degrees(math.atan(x)), "LOG": math.log10, "NEG": lambda x: -x, "INT": math.trunc,
        "FRAC": lambda x: x - math.trunc(x), "SGN": lambda x: (x > 0) - (x < 0),
    },
    {"PI": math.pi},
    bare=True,
)  # fmt: skip


def bare(line: str) -> str:
    """A line in capitals without comment, `~` and decimal commas."""
    text = line.split(";")[0].rstrip().rstrip("~").rstrip().upper()
    return re.sub(r"(?<=\d),(?=\d)", ".", text)


def joined(unit: Unit) -> Unit:
    """The program with each block in one line: continued lines (~), the lines of a cycle (7.0, 7.1), and RND or CHF behind their move."""
    lines = [bare(line) for line in unit.lines]
    goes_on = [line.rstrip().endswith("~") for line in unit.lines]
    last, cycle = -1, ""
    for k, line in enumerate(lines):
        body = _HEAD.sub("", line, count=1).strip()
        part = _PART.match(body)
        previous = lines[last] if last >= 0 else ""
        more = k > 0 and goes_on[k - 1]
        corner = body.startswith(("RND", "CHF")) and _CONTOUR.match(_HEAD.sub("", previous, count=1).strip()) and JOINT not in previous
        if last >= 0 and (more or corner or (part and part[1] == cycle and part[2] != "0")):
            lines[last], lines[k] = previous + (" " if more else JOINT) + body, ""
        elif body:
            last = k
        cycle = part[1] if part else cycle if more else ""
    unit.lines = lines
    return unit


def without_number(text: str) -> tuple[str, int]:
    """The block without its number, which keeps its length; the number, -1 if there is none."""
    match = _HEAD.match(text)
    return (" " * match.end() + text[match.end() :], int(match[2])) if match else (text, -1)


@dataclass
class Block(Words):
    """The first word of a block, the text behind it that begins at `column`, and the words of that text.

    F is infinite for FMAX and NaN for F AUTO.
    """

    head: str = ""
    text: str = ""

    def side(self) -> int | None:
        """Take R0, RL or RR away: 0, 1 or -1; None without one."""
        return int(self.take(SIDE)) if SIDE in self.w else None


class Klartext(Reader):
    """Reads the blocks of one Klartext program."""

    grammar = FORMULAS

    def __init__(self, path: Path, machine: Machine, unit: Unit, table: Mapping[str, Word], m_table: Mapping[int, Word]) -> None:
        super().__init__(path, machine, "klartext", joined(unit), ("preset", "shift", "plane", "inner", "mirror", "turn", "scale"))
        state, self.table, self.m_table = self.state, table, m_table
        self.q: dict[str, float] = {}  # Q and QR are common to all programs, QL belong to one
        self.pole: np.ndarray | None = None  # CC (3,)
        self.pole_plane = 17  # of its coordinates
        self.tool_feed, self.extra_radius = math.nan, 0.0  # F and DR of TOOL CALL
        self.shorter_way = False  # M126
        self.waiting: tuple[np.ndarray, Callable[[Move], None]] | None = None  # APPR: its point, and how it makes its moves
        self.tilt_angles: dict[str, float] = {}
        self.turn_to: tuple[float, float] | None = None  # A and C that the next move goes to (SEQ)
        self.cycle: int | None = None  # that a call carries out
        self.cycle_everywhere = False  # M89
        state.out.change(workpiece_orientation=False, feed_of_all=True)
        state.out.mixed_feed = "F beside X Y Z with A B C: it counts all axes, a degree as a unit of length; M128 counts the tool tip"
        letters = "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        self.plain_block = re.compile(rf"\s*(\d*)\s+L\s+{NO_GROUP}{letters}{3 * NO_GROUP}(?:R0\s*)?(?:F\s*(MAX|{NUMBER})\s*)?$", re.A)

    # ------------------------------------------------------------------ Q parameters

    def assign(self, name: str, value: float, column: int) -> None:
        """Set a parameter."""
        (self.flow.frame.variables if name.startswith("QL") else self.q)[name] = value

    def parameter(self, name: str, column: int, default: float | None = None) -> float:
        """The value of a parameter, also one that the control or the machine file gives."""
        state = self.state
        found = self.flow.frame.variables.get(name, self.q.get(name, state.given(name)))
        if isinstance(found, float):
            return found
        if name == "Q108":
            return state.tools.radius(state.tools.name, column) / state.unit
        own = {"Q109": {19: 0.0, 18: 1.0, 17: 2.0}[state.plane], "Q113": float(state.unit != 1e-3)}
        return needed(own.get(name, default), no_value(name), column)

    def variable(self, e: Expression, name: str, at: int) -> float:
        if not re.fullmatch(r"Q[LR]?\d+", name):
            hint = nearest(name, FORMULAS.functions)
            raise e.fail(f"'{name}' is not a value; use Q parameters, numbers and functions" + (f"; {hint}" if "mean" in hint else ""), at)
        return self.parameter(name, e.column + at)

    # ------------------------------------------------------------------ lines

    def clean(self, text: str) -> str:
        """The block, empty for a structure line (*)."""
        return "" if without_number(text)[0].lstrip()[:1] in ("", "*") else text.replace("\t", " ")

    def statement(self, text: str) -> Statement | None:
        """Labels, calls and jumps."""
        return statement_of(FORMS, without_number(text)[0])

    def labels_of(self, line: str) -> Iterator[str]:
        """The label of a line."""
        if (match := LABEL.match(without_number(line)[0])) and match["target"] != "0":
            yield match["target"]

    # ------------------------------------------------------------------ blocks

    def plain_now(self) -> bool:
        return not (self.waiting or self.cycle_everywhere or self.shorter_way)

    def words(self, text: str) -> None:
        body, self.state.block = without_number(text)
        column = len(body) - len(body.lstrip()) + 1
        body = body.strip()
        match = needed(re.match(r"(CYCL DEF)\s*(\d+)|([A-Z]+)(?:\s+[A-Z]+)?", body), f"'{body[:20]}' starts no block of Klartext", column)
        names = [f"{match[1]} {match[2]}"] if match[1] else [" ".join(match[0].split()), match[3]]
        head = next((n for n in names if n in self.table), None)
        word = self.table.get(head or "")
        if head is None or word is None or word.kind == REFUSED:
            what = word.meaning if word else "let the CAM system output L, C or CR (docs/program_words.md lists what is read)"
            shown = head or (names[0] if match[1] else names[-1] if len(names[-1]) > 1 else body[:20])
            raise WordError(f"{shown} is not {'supported' if word else 'known'}: {what}", column)
        begin = match.start(2) if match[1] else 0 if head in ("M", "Q", "QL", "QR", "FN") else len(head)
        block = Block(column=column + begin, head=head, text=body[begin:])
        if match[1]:
            self._define_cycle(block, int(match[2]))
        if word.kind == NOTE:
            self.state.note(f"{head}: {word.meaning}")
        elif word.handler is not None:
            word.handler(self, block)

    def _define_cycle(self, block: Block, number: int) -> None:
        """The text of CYCL DEF: the parts 7.1, 7.2 .. of an old cycle, or what stands behind the number of a new one."""
        self.settle()
        first, *parts = all_parts(block.text)
        text = re.sub(r"\A\d+(?:\.\d+)?\s*", "", first)
        if number < 200 and number != 13 and (not parts or re.search(r"\d", text)):
            raise WordError(f"CYCL DEF {number} needs a part {number}.1, and no value in {number}.0; correct it", block.column)
        if number >= 200 and (parts or not re.fullmatch(rf"(?:(?!Q\d)[^=])*(?:\s*Q\d+\s*=\s*{VALUE})*\s*", text)):
            raise WordError(f"{block.head} takes parameters as Q201=-10; correct them", block.column)
        block.text = text if number >= 200 else " ".join(re.sub(r"^CYCL DEF \d+\.\d+\s*", "", part) for part in parts)

    def scan(self, block: Block, where: str = "here; docs/program_words.md lists the words") -> None:
        """All words of the text of a block. F behind M128 or M140 is that of its own motion: the words F128 and F140."""
        at, text = 0, block.text.rstrip()
        while at < len(text):
            match = needed(_WORD.match(text, at), f"'{text[at:].strip()[:20]}' is not read {where}", block.column + at)
            at, place = match.end(), block.column + match.start()
            if match["m"]:
                block.m.append(int(match["m"]))
                continue
            if match["alone"]:
                name, number = _ALONE[match["alone"].replace(" ", "")]
            else:
                name, number = str(match["name"]), self.number_of(match["value"], place)
                name = self.state.slot_of.get(name, name)
            if name == "F" and block.m and block.m[-1] in (128, 140):
                name = f"F{block.m[-1]}"
            block.put(name, Item(number, "IC" if match["inc"] else "", place))

    def only_words(self, block: Block, names: str, hint: str = "", added: bool = False) -> dict[str, Item]:
        """The words of a block that takes these names alone, and in addition (I) if `added`."""
        where, column = f"in {block.head}, which takes {names}{hint}", block.column
        self.scan(block, where)
        words = block.pick(*names.split())
        increments = [f"I{name}" for name, item in words.items() if item.how and not added]
        for what in (*block.w, *(f"M{number}" for number in block.m), *increments):
            raise WordError(f"{what} is not read {where}", column)
        return words

    def feed_word(self, value: float) -> float:
        """An inch program counts tenths of an inch a minute."""
        return value if self.state.unit == 1e-3 or self.out.modes.feed_mode != 94 else 0.1 * value

    def feed_of(self, item: Item) -> float:
        """The feed of an F word: F AUTO is that of TOOL CALL."""
        if math.isnan(item.value) and math.isnan(self.tool_feed):
            raise WordError("F AUTO is the feed of TOOL CALL, which gave none; give F there or here", item.column)
        return self.tool_feed if math.isnan(item.value) else self.feed_word(item.value)

    def modes(self, block: Block) -> None:
        """The M codes that act before the move of their block, then its feed; FMAX is left to the move, since it holds for it alone."""
        state = self.state
        for number in block.m:
            state.check_word(f"M{number}", self.m_table.get(number, UNKNOWN), 1)
            if number in (128, 129):
                self.settle()
                state.transform(number == 128)
            elif number in (126, 127):
                self.shorter_way = number == 126
            elif number in (136, 137):
                state.set_feed_mode(95 if number == 136 else 94)
            elif number == 89:
                self.cycle_everywhere = True
            elif number in (101, 120):
                block.pick("LA", "BT")
        if block.pick("F128"):
            state.note("F behind M128 is that of its own motion")
        if "F" in block.w and not math.isinf(block.w["F"].value):
            item = block.w.pop("F")
            state.set_feed(self.feed_of(item), item.column)

    # ------------------------------------------------------------------ moves

    def start(self) -> np.ndarray:
        """Start (3,) of the next element."""
        return self.corners.start() if self.waiting is None else self.waiting[0]

    def emit(self, move: Move, corner: tuple[str, float] | None = None) -> None:
        """Make a move, or hold it until the next one defines its corner."""
        if self.turn_to is not None and move.vector is None and all(map(math.isnan, move.angles)):
            move, self.turn_to = move._replace(angles=self.turn_to), None
        self.corners.queue(move, corner)

    def settle(self) -> None:
        """Emit what waits for the next element."""
        if self.waiting is not None:
            raise WordError("behind APPR there is no contour; add an element in the plane")
        self.corners.release()

    def radius(self, column: int) -> float:
        """Radius of the tool [m]."""
        return self.state.tools.radius(self.state.tools.name, column) + self.extra_radius

    def compensate(self, side: int, column: int) -> None:
        """R0, RL or RR from the next move on."""
        if side or self.state.comp is not None:
            self.corners.release()
            self.control.compensate(side, self.radius(column) if side else 0.0)

    # ------------------------------------------------------------------ calls

    def other(self, s: Statement, frame: Call) -> None:
        """Labels, calls, and the end of a program."""
        if s.kind != "lbl":
            self.settle()
        elif s.target == "0" and frame.style == "lbl":
            self.flow.back()
        if s.kind == "call_label":
            place = self.flow.place(frame, s.target, "", s.column)
            self.flow.call(frame.unit, place + 1, frame.variables, f"LBL {s.target}", style="lbl", column=s.column)
        elif s.kind == "call_program":
            name = s.target.strip(' "').replace("\\", "/").rsplit("/", 1)[-1].removesuffix(".H")
            unit = self.folder.find(name)
            if unit is not None:
                if not any("BEGIN PGM" in line for line in unit.lines[:50]):
                    raise WordError(f"CALL PGM {name}: {unit.path.name} is no Klartext program", s.column)
                self.flow.call(unit if unit.statements else joined(unit), 0, {}, name, style="pgm", column=s.column)
            elif not self.moves_nothing(name):
                raise WordError(f"program {name} is not beside this one ({name}.h); {ADD_CALL}", s.column)
        elif s.kind == "end" and frame.style == "lbl":
            raise WordError("the subprogram runs on to END PGM; end it with LBL 0", s.column)
        elif s.kind == "end" and frame.style == "pgm":
            self.flow.back()
        elif s.kind == "end":
            self.flow.ended = True


def all_parts(text: str) -> list[str]:
    """The parts of a joined block."""
    return [part.strip() for part in text.split(JOINT.strip())]
