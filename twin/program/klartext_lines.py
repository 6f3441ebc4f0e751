"""Lines and values of HEIDENHAIN Klartext: joined blocks, statements of the flow, Q parameters and their formulas."""

from __future__ import annotations

import math
import re

from twin.errors import nearest
from twin.program.expressions import COMPARE, FUNCTIONS, SUMS, Expression, Grammar, WordError
from twin.program.flow import Flow
from twin.program.reader import Values
from twin.program.source import Unit
from twin.program.state import State
from twin.program.structures import Statement

VALUE = r"[-+]?(?:\d+\.?\d*|\.\d+|Q[LR]?\d+)"
"""A number or a parameter with its sign, as it stands behind a letter."""
JOINT = " | "
_HEAD = re.compile(r"\A(\s*)(\d+)(?:\s+(?=[A-Z*;])|\s*\Z)")
_PART = re.compile(r"CYCL DEF (\d+)\.(\d+)\b")
_CONTOUR = re.compile(r"(?:L|LP|C|CP|CR|CT|CTP)\b")
_LABEL = r"(?:LBL\s*)?(\d+|\"[^\"]*\"|Q[LR]?\d+)"
_CALL = re.compile(rf"CALL LBL\s*{_LABEL}(?:\s+REP\s*(\d+|Q[LR]?\d+)(?:/\d+)?)?\s*\Z")
_JUMP = re.compile(rf"FN\s*(?:9|10|11|12)\s*:\s*IF\s+(.+?)\s+GOTO\s+{_LABEL}\s*\Z")
_FORMULA = re.compile(r"(?:FN\s*(?P<fn>\d+)\s*:\s*)?(?P<name>Q[LR]?\d+)\s*=(?P<text>.*)\Z")

KLARTEXT = Grammar(
    "(",
    ")",
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


class KlartextLines:
    """Reads lines that `joined` has made."""

    def clean(self, text: str) -> str:
        """The block, empty for a structure line (*)."""
        return "" if without_number(text)[0].lstrip()[:1] in ("", "*") else text.replace("\t", " ")

    def statement(self, text: str) -> Statement | None:
        """Labels, calls and jumps."""
        body, _ = without_number(text)
        column = len(body) - len(body.lstrip()) + 1
        body = body.strip()
        if match := re.match(rf"LBL\s*{_LABEL}\s*\Z", body):
            return Statement("lbl", match[1])
        if match := _CALL.match(body):
            if match[2]:
                return Statement("repeat_label", column=column, rest=("REPEAT", f"LBL {match[1]}", None, match[2]))
            return Statement("call_label", f"LBL {match[1]}", column=column)
        if match := _JUMP.match(body):
            return Statement("goto", column=column, rest=(match[1], "", f"LBL {match[2]}"))
        if match := re.match(r"CALL PGM\s*(.+)\Z", body):
            return Statement("call_program", match[1].strip(' "'), column=column)
        return Statement("end") if body.startswith("END PGM") else None

    def labels(self, unit: Unit) -> dict[str, list[int]]:
        """Lines by label."""
        found: dict[str, list[int]] = {}
        for i, line in enumerate(unit.lines):
            if (match := re.match(rf"LBL\s*{_LABEL}\s*\Z", without_number(line)[0].strip())) and match[1] != "0":
                found.setdefault(f"LBL {match[1]}", []).append(i)
        return found


class KlartextValues(Values):
    """Q parameters: Q and QR are common to all programs, QL belong to one."""

    def __init__(self, state: State, flow: Flow) -> None:
        super().__init__(state, flow, KLARTEXT)
        self.q: dict[str, float] = {}

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
        if (value := own.get(name, default)) is None:
            raise WordError(self.no_value(name), column)
        return value

    def variable(self, e: Expression, name: str, at: int) -> float:
        if not re.fullmatch(r"Q[LR]?\d+", name):
            hint = nearest(name, KLARTEXT.functions)
            raise e.fail(f"'{name}' is not a value; use Q parameters, numbers and functions" + (f"; {hint}" if "mean" in hint else ""), at)
        return self.parameter(name, e.column + at)

    def calculation(self, body: str, column: int) -> bool:
        """Carry out FN 0 to FN 8 and FN 13, or a formula; False if the block is none."""
        match = _FORMULA.match(body)
        if match is None or int(match["fn"] or 0) not in (0, 1, 2, 3, 4, 5, 6, 7, 8, 13):
            return False
        self.assign(match["name"], self.number_of(match["text"], column + match.start("text")), column)
        return True


def all_parts(text: str) -> list[str]:
    """The parts of a joined block."""
    return [part.strip() for part in text.split(JOINT.strip())]
