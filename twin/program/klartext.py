"""Reader of HEIDENHAIN Klartext (.h): the blocks, composed of lines, Q parameters, frames, contour and cycles on the control that all languages share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

from twin.machine.machine import Machine
from twin.program import moves as mv
from twin.program.collect import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE
from twin.program.control import Control
from twin.program.corners import Corners
from twin.program.cycles import CycleError
from twin.program.expressions import WordError
from twin.program.flow import Flow, Frame
from twin.program.klartext_cycles import CYCLES, KlartextCycles
from twin.program.klartext_frames import KlartextFrames
from twin.program.klartext_lines import VALUE, KlartextLines, KlartextValues, all_parts, joined, without_number
from twin.program.klartext_moves import KlartextMoves
from twin.program.machine_file import moves_no_axis
from twin.program.source import Folder, Unit
from twin.program.state import INCH, State
from twin.program.structures import Statement
from twin.program.tables import KLARTEXT, REFUSED
from twin.program.words import NUMBER
from twin.units import rad_from_deg

_TOOL = re.compile(rf"\s*(?:(?P<axis>[XYZ])(?![-+\w.])|(?P<name>DL|DR2|DR|S|F|L|R)\s*(?P<value>{VALUE}))", re.A)
_PLANE_OF = {"Z": 17, "Y": 18, "X": 19}


class Klartext:
    """Reads the blocks of one Klartext program."""

    def __init__(self, path: Path, machine: Machine, unit: Unit) -> None:
        state = self.state = State(path, machine, "klartext")
        self.corners = Corners(Control(state))
        self.control, self.out = self.corners.control, state.out
        self.flow = Flow(joined(unit), state, KlartextLines())
        self.values = KlartextValues(state, self.flow)
        self.frames = KlartextFrames(state, self.values)
        self.cycles = KlartextCycles(self.control, self.values)
        self.moves = KlartextMoves(self.corners, self.flow, self.values, self.frames, self.cycles)
        self.folder = Folder(path)
        state.out.set_modes(replace(state.out.modes, workpiece_orientation=False, feed_of_all=True))
        state.out.mixed_feed = "F beside X Y Z with A B C: it counts all axes, a degree as a unit of length; M128 counts the tool tip"
        letters = "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        self.plain_block = re.compile(rf"\s*(\d*)\s+L\s+{letters}(?:R0\s*)?(?:F\s*(MAX|{NUMBER})\s*)?$", re.A)
        move, _moves = self.moves.move, self.moves
        self.heads: dict[str, Callable[[str, str, int], None]] = {
            **dict.fromkeys(("L", "LP", "LN", "C", "CP", "CR", "CT", "CTP", "M"), move),
            **{f"APPR {kind}": self.moves.begin_approach for kind in ("LT", "LN", "CT", "LCT")}, **{f"DEP {kind}": self.moves.depart for kind in ("LT", "LN", "CT", "LCT")},
            "CC": self.moves.pole, "TOOL CALL": self._tool_call, "TOOL DEF": self._tool_def, "CYCL DEF": self._cycle, "CYCL CALL": self._call_cycle,
            "PLANE SPATIAL": self._plane, "PLANE RESET": self._plane,
            "FUNCTION TCPM": self._tcpm, "FUNCTION RESET": self._tcpm, "TRANS DATUM": self._trans, "STOP": lambda h, t, c: self.moves.move("M", f"M0 {t}", c),
            **dict.fromkeys(("LBL", "CALL LBL", "CALL PGM", "END PGM"), self._stray), "BEGIN PGM": self._begin, "BLK FORM": lambda h, t, c: state.note(f"{h}: {KLARTEXT[h][1]}"), "FN": self._function,
            **dict.fromkeys(("Q", "QL", "QR"), self._function), "RND": self._stray, "CHF": self._stray,
        }  # fmt: skip
        self.frames.set_frames()

    def run(self) -> Any:
        """Read all blocks; `out` holds the moves."""
        self.flow.run(self, self.values, self)
        self.moves.settle()
        self.control.compensate(0, 0.0, along_next=True)
        return self.out

    # ------------------------------------------------------------------ blocks

    def fast(self, text: str, line: int) -> bool:
        """Execute a line with numbers alone; False if the block must be read word by word."""
        state = self.state
        if (
            not state.plain
            or self.moves.waiting is not None
            or self.corners.held is not None
            or self.cycles.modal
            or self.moves.shorter_way
        ):
            return False
        match = self.plain_block.match(text)
        if not match:
            return False
        number, x, y, z, a, c, f = match.groups()
        if (a or c) and not self.out.kinematics.names[3 if a else 4]:
            return False
        if f is not None and f != "MAX":
            state.set_feed(self.moves.feed(float(f)))
        if x is y is z is a is c is None:
            return True
        state.line, state.block = line, int(number) if number else -1
        kind = mv.RAPID if f == "MAX" else mv.LINE
        self.control.feed_given(kind)
        position = self.out.position
        self.moves.before, self.corners.tangent, self.moves.was_rapid = position[:3], None, kind == mv.RAPID
        tilt, turn = state.plain_place(x, y, z, a, c)
        feed = math.inf if kind == mv.RAPID else state.feed
        self.out.add(kind, (position[0], position[1], position[2], tilt, turn), None, feed, line, state.block)
        return True

    def words(self, text: str) -> None:
        """One block."""
        body, number = without_number(text)
        self.state.block = number
        column = len(body) - len(body.lstrip()) + 1
        body = body.strip()
        match = re.match(r"([A-Z]+)(?:\s+([A-Z]+))?", body)
        if match is None:
            raise WordError(f"'{body[:20]}' starts no block of Klartext", column)
        names = [f"{match[1]} {match[2]}", match[1]]
        if match[1] == "CYCL" and (cycle := re.match(r"CYCL DEF\s*(\d+)", body)):
            names.insert(0, f"CYCL DEF {cycle[1]}")
        name = next((n for n in names if n in KLARTEXT), None)
        if name is None or KLARTEXT[name][0] == REFUSED or (name.startswith("CYCL DEF ") and name not in KLARTEXT):
            what = KLARTEXT[name][1] if name else "let the CAM system output L, C or CR (docs/programs.md lists what is read)"
            shown = name or (names[0] if names[0].startswith("CYCL DEF ") else match[1] if len(match[1]) > 1 else body[:20])
            raise WordError(f"{shown} is not {'supported' if name else 'known'}: {what}", column)
        head = "CYCL DEF" if name.startswith("CYCL DEF") else name
        try:
            self.heads[head](
                head, body[len(head) :] if head not in ("M", "Q", "QL", "QR", "FN") else body, column + len(head) * (head not in ("M", "Q"))
            )
        except CycleError as error:
            raise WordError(str(error), column) from None

    # ------------------------------------------------------------------ moves

    def _stray(self, head: str, _: str, column: int) -> None:
        where = "stands behind a move in the plane and before another" if head in ("RND", "CHF") else "is incomplete"
        raise WordError(f"{head} {where}; correct it", column)

    # ------------------------------------------------------------------ modes

    def _tool_call(self, _: str, text: str, column: int) -> None:
        """TOOL CALL number or name, axis, S, F, DL, DR."""
        self.moves.settle()
        state = self.state
        match = re.match(rf"\s*(?:\"([^\"]*)\"|({VALUE}))?", text)
        assert match
        number, axis, values = match[1] or (match[2] and f"{self.values.number_of(match[2], column):g}"), "", {}
        at = match.end()
        while at < len(text.rstrip()):
            word = _TOOL.match(text, at)
            if not word:
                raise WordError(f"'{text[at:].strip()[:20]}' is not read in TOOL CALL; write its axis, S, F, DL, DR", column + at)
            at = word.end()
            if axis if word["axis"] else word["name"] in values:
                raise WordError(f"{word[0].strip()[:2]} occurs twice in TOOL CALL; keep one", column + word.start())
            axis = word["axis"] or axis
            if word["name"]:
                values[word["name"]] = self.values.number_of(word["value"], column + word.start())
        if axis:
            if state.comp is not None:
                raise WordError("the tool changes inside RL or RR; write R0 and a move before", column)
            state.plane = _PLANE_OF[axis]
        if "S" in values:
            state.set_spindle(values["S"])
        if "F" in values:
            self.moves.tool_feed = self.moves.feed(values["F"])
            state.set_feed(self.moves.tool_feed, column)
        if unread := [n for n in ("L", "R", "DR2") if values.get(n)]:
            raise WordError(f"{unread[0]} is not read in TOOL CALL; give the tool in [tool] of the machine file", column)
        if values.get("DL"):
            raise WordError("DL in TOOL CALL is not simulated; give the length in [tool] of the machine file", column)
        if number:
            self.moves.extra_radius = values.get("DR", 0.0) * state.unit
            state.tools.block({"T": (number, column), "M6": (6.0, column)})
            state.note("TOOL CALL: the program continues after an exact stop")
            self.control.stop(0.0)

    def _tool_def(self, _: str, text: str, column: int) -> None:
        """TOOL DEF number, L, R: the table of tools of the program."""
        match = re.match(rf"\s*({VALUE})", text)
        if match is None:
            raise WordError("TOOL DEF needs the number of the tool", column)
        name = f"{self.values.number_of(match[1], column):g}"
        if re.sub(rf"\s*[LR]\s*{VALUE}", "", text[match.end() :]).strip():
            raise WordError("TOOL DEF takes L and R; give the rest in [tool] of the machine file", column)
        for word in re.finditer(rf"([LR])\s*({VALUE})", text[match.end() :]):
            self.state.tools.set_value(
                name, "length" if word[1] == "L" else "radius", self.values.number_of(word[2], column) * self.state.unit
            )

    def _tcpm(self, head: str, text: str, column: int) -> None:
        """FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS or VECTOR; FUNCTION RESET TCPM."""
        self.moves.settle()
        wrong = re.sub(r"\b(?:TCPM|F TCP|AXIS POS|PATHCTRL (?:AXIS|VECTOR)|REFPNT TIP-TIP)\b", "", text).strip()
        if wrong or (head == "FUNCTION RESET") != (text.strip() == "TCPM" and head == "FUNCTION RESET"):
            raise WordError(f"'{wrong or text.strip()}' is not supported; write F TCP AXIS POS and PATHCTRL AXIS or VECTOR", column)
        self.out.set_modes(replace(self.out.modes, workpiece_orientation="VECTOR" in text))
        self.state.transform(head == "FUNCTION TCPM")

    def _plane(self, _: str, text: str, column: int) -> None:
        self.moves.settle()
        self.frames.plane(text, column)

    def _trans(self, _: str, text: str, column: int) -> None:
        """TRANS DATUM AXIS X.. or RESET."""
        self.moves.settle()
        text = text.strip()
        if not text.startswith(("AXIS", "RESET")):
            raise WordError("TRANS DATUM is read with AXIS or RESET; a datum table is not simulated", column)
        self.frames.datum("X0 Y0 Z0" if text == "RESET" else text[4:])

    def _begin(self, _: str, text: str, column: int) -> None:
        """BEGIN PGM name MM or INCH."""
        unit = text.split()[-1] if text.split() else ""
        if unit not in ("MM", "INCH"):
            raise WordError("BEGIN PGM ends in MM or INCH; add the unit", column)
        self.state.set_unit(INCH if unit == "INCH" else 1e-3, feed=True)
        if unit == "INCH":
            self.state.note("F in a program in inches counts tenths of an inch a minute, as on an iTNC 530")

    # ------------------------------------------------------------------ cycles and values

    def _cycle(self, _: str, text: str, column: int) -> None:
        """CYCL DEF: frames, dwell, tolerance at once; drilling for the next call."""
        self.moves.settle()
        head, *parts = all_parts(text)
        match = re.match(r"\s*(\d+)(?:\.\d+)?\s*(.*)", head)
        assert match
        number, state = int(match[1]), self.state
        parts = [re.sub(r"^CYCL DEF \d+\.\d+\s*", "", part) for part in parts]
        if number < 200 and number != 13 and (not parts or re.search(r"\d", match[2])):
            raise WordError(f"CYCL DEF {number} needs a part {number}.1, and no value in {number}.0; correct it", column)
        if number in CYCLES:
            name = re.match(r"[^=]*?(?=\s*Q\d|\Z)", match[2])
            if name is None or parts or not re.fullmatch(rf"(?:\s*Q\d+\s*=\s*{VALUE})*\s*", match[2][name.end() :]):
                raise WordError(f"CYCL DEF {number} takes parameters as Q201=-10; correct them", column)
            for word in re.finditer(rf"(Q\d+)\s*=\s*({VALUE})", text):
                self.values.assign(word[1], self.values.number_of(word[2], column), column)
            self.cycles.number = number
            self.cycles.modal = False
        elif number == 247:
            found = re.search(rf"Q339\s*=\s*({VALUE})", text)
            if found is None:
                raise WordError("cycle 247 needs Q339, the number of the preset", column)
            self.frames.preset = state.frame_table(f"PRESET{self.values.number_of(found[1], column):g}")
            self.frames.set_frames()
        elif number == 9:
            found = re.fullmatch(rf"[A-Z. ]*({VALUE})", " ".join(parts))
            if found is None:
                raise WordError("cycle 9 needs its time, e.g. CYCL DEF 9.1 DWELL 0.5", column)
            self.control.dwell(self.values.number_of(found[1], column))
        elif number == 32:
            given = dict(re.findall(rf"\b(TA|T)\s*({VALUE})", " ".join(parts)))
            if re.sub(rf"\b(?:TA|T)\s*{VALUE}|\bHSC-MODE:\s*\d", "", " ".join(parts)).strip():
                raise WordError("cycle 32 takes T, HSC-MODE and TA; correct it", column)
            state.tolerance = self.values.number_of(given["T"], column) * state.unit if "T" in given else DEFAULT_TOLERANCE
            state.tolerance = state.tolerance if state.tolerance > 0.0 else DEFAULT_TOLERANCE
            angle = self.values.number_of(given["TA"], column) if "TA" in given else 0.0
            state.angle_tolerance = rad_from_deg(angle) if angle > 0.0 else DEFAULT_ANGLE_TOLERANCE
            state.round_corners()
        elif number == 13:
            state.note(f"CYCL DEF 13: {KLARTEXT['CYCL DEF 13'][1]}")
        elif not self.frames.cycle(number, parts, column):
            raise WordError(f"CYCL DEF {number} is not known", column)

    def _call_cycle(self, _: str, text: str, column: int) -> None:
        """CYCL CALL, or at a place with POS."""
        self.moves.settle()
        at_place = text.split()[:1] == ["POS"]
        block = self.moves.scan(text.replace("POS", "   ", 1) if at_place else text, column)
        self.moves.modes(block.m, block)
        if block.side or block.sense or block.arg or (block.rapid and not at_place) or (block.words and not at_place):
            raise WordError("CYCL CALL takes a place behind POS only", column)
        if at_place:
            element, angles = self.moves.element("L", block, block.words, self.moves.start(), False, column)
            self.state.all_used(block.words)
            if element is not None:
                self.moves.emit(mv.RAPID if block.rapid else mv.LINE, element, angles)
        self.moves.cycle_here()
        self.moves.afterwards(block.m, column)

    def _function(self, head: str, text: str, column: int) -> None:
        """FN and formulas; printing is noted."""
        if self.values.calculation(text, column):
            return
        if match := re.match(r"FN\s*(15|16)\b", text):
            self.state.note(f"FN {match[1]}: it prints, without effect on the motion")
            return
        raise WordError(f"{text[:30]} is not supported: read are FN 0 to 13 and Q = formula; write its result", column)

    # ------------------------------------------------------------------ calls

    def other(self, s: Statement, frame: Frame) -> None:
        """Labels, calls, and the end of a program."""
        self.moves.settle() if s.kind != "lbl" else None
        if s.kind == "lbl" and s.key == "0" and frame.style == "lbl":
            self.flow.back()
        elif s.kind == "call_label":
            place = self.flow.place(frame, s.key, "", s.column)
            self.flow.call(frame.unit, place + 1, name=s.key, style="lbl", shared=True, column=s.column)
        elif s.kind == "call_program":
            name = s.key.replace("\\", "/").rsplit("/", 1)[-1].removesuffix(".H")
            unit = self.folder.find(name)
            if unit is not None:
                if not any("BEGIN PGM" in line for line in unit.lines[:50]):
                    raise WordError(f"CALL PGM {name}: {unit.path.name} is no Klartext program", s.column)
                unit = unit if unit.statements else joined(unit)
                self.flow.call(unit, 0, name=name, style="pgm", column=s.column)
            elif moves_no_axis(self.state.machine, [name]):
                self.state.note(f"{name}: the machine file lists it as moving no axis")
            else:
                where = "add it, or list it in [program] calls_without_motion of the machine file if it moves no axis"
                raise WordError(f"program {name} is not beside this one ({name}.h); {where}", s.column)
        elif s.kind == "end":
            if frame.style == "lbl":
                raise WordError("the subprogram runs on to END PGM; end it with LBL 0", s.column)
            if frame.style == "pgm":
                self.flow.back()
            else:
                self.flow.ended = True

    def runs_into(self, what: str, column: int) -> None:
        """The end of the file ends a program as END PGM does."""
