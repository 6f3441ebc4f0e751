"""G-code of the Sinumerik 840D, and plain ISO blocks, into moves.

Blocks of coordinates alone (`N10 G1 X1.5 Y2 Z-3 A3=0.1 B3=0 C3=0.99 F1000`) take a fast way; everything else is split into
words, each of which is understood or reported. Comments begin with `;` (in `.ngc` files also in brackets).
"""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
import re

import numpy as np

from twin.errors import InputError, nearest
from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program.collect import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE, NO_RADIUS_COMPENSATION, Collector
from twin.program.flow import Flow, Source
from twin.program.tools import Tools
from twin.program.words import NUMBER, Arithmetic, Word, WordError
from twin.units import rad_from_deg

# one block of coordinates in the usual order; what does not match is read word by word
_PLAIN = re.compile(
    r"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?"
    + "".join(rf"(?:{axis}=?({NUMBER})\s*)?" for axis in "XYZ")
    + rf"(?:A=?({NUMBER})\s*)?(?:C=?({NUMBER})\s*)?(?:A3=({NUMBER})\s*B3=({NUMBER})\s*C3=({NUMBER})\s*)?(?:F({NUMBER})\s*)?$",
    re.A,
)
_LINEAR, _ROTARY = ("X", "Y", "Z"), ("A", "C")
_AXES = (*_LINEAR, *_ROTARY)
_INDEX = {name: i for i, name in enumerate(_AXES)}
_BRACKET_COMMENT = re.compile(r"\([^)]*\)")
_WRAPPED = re.compile(r"\s*(AC|IC|DC|ACP|ACN)\s*\((.*)\)\s*\Z", re.S)
INCH = 0.0254

# understood, and without effect on the motion that is simulated: said once
_NO_EFFECT_G = {40, 49, 80, 450, 451, 461, 462, 97}
_NO_EFFECT_M = {3, 4, 5, 7, 8, 9, 40, 41, 42, 43, 44, 45}
_END_M = {2, 17, 30}
_NO_EFFECT_NAMES = {
    "NORM", "KONT", "CFC", "CFTCP", "CFIN", "CUT2D", "CUT2DF", "DIAMOF", "DIAMON", "FNORM", "COMPON", "COMPCURV", "COMPCAD", "COMPOF",
    "UPATH", "SPATH", "FIFOCTRL", "STARTFIFO", "STOPFIFO", "STOPRE", "WALIMOF", "FGREF", "DYNNORM", "DYNFINISH", "DYNSEMIFIN", "DYNROUGH",
    "RTLION",
}  # fmt: skip
_ADVICE = {
    41: NO_RADIUS_COMPENSATION,
    42: NO_RADIUS_COMPENSATION,
    43: "use T and D with a table [tool] in the machine file; G43 H is for .ngc files",
    33: "threading is not simulated",
    331: "threading is not simulated",
    332: "threading is not simulated",
    96: "constant cutting speed is not simulated; use G97",
    74: "reference point approach is not simulated; program the axis positions",
    75: "fixed point approach is not simulated; program the axis positions",
    28: "reference point approach is not simulated; program the axis positions",
    643: "use G642, G641 or CYCLE832",
    644: "use G642, G641 or CYCLE832",
    645: "use G642, G641 or CYCLE832",
}


def read_gcode(path: Path, machine: Machine) -> mv.Program:
    """Read a Sinumerik program (.mpf .spf) or a plain ISO one (.ngc)."""
    return GcodeReader(path, machine).read()


class GcodeReader:
    """The state of the control while the blocks are read."""

    def __init__(self, path: Path, machine: Machine):
        self.source = Source(path)
        self.iso = path.suffix.lower() in (".ngc", ".nc", ".iso")
        self.out = Collector(path, machine)
        self.machine = machine
        self.arithmetic = Arithmetic()
        self.motion = 1
        self.feed = math.nan
        self.plane = 17
        self.absolute = True
        self.unit = 1e-3
        self.adis = self.adispos = 0.0
        self.tolerance, self.angle_tolerance = DEFAULT_TOLERANCE, DEFAULT_ANGLE_TOLERANCE
        self.rounding = 64
        self.frame = self._frame_table("G500")
        self.shift = np.zeros(5)  # TRANS
        self.offset = [0.0] * 5  # both together
        self.tools = Tools(self.out, machine, self.iso, self._value)
        self.ended = False
        self.line, self.block = 0, -1

    # ------------------------------------------------------------------ blocks

    def read(self) -> mv.Program:
        """All blocks in the order in which the control runs them."""
        flow = Flow(self.source, self)
        fast, advance = self._fast, flow.advance
        lines = self.source.lines
        at = 0
        while at < len(lines) and not self.ended:
            text = lines[at]
            if fast(text, at + 1):
                at = advance(at)
                continue
            self.line, self.block = at + 1, -1
            try:
                at = flow.run(at, self._clean(text))
            except WordError as error:
                raise self.out.fail(self.line, self.block, str(error), error.column) from None
            except arcs.ArcError as error:
                raise self.out.fail(self.line, self.block, str(error)) from None
        return self.out.finish()

    def _clean(self, text: str) -> str:
        """The block in capitals without comment; texts in quotes keep their length."""
        semicolon = text.find(";")
        if semicolon >= 0 and text.count('"', 0, semicolon) % 2 == 0:
            text = text[:semicolon]
        if self.iso:
            text = _BRACKET_COMMENT.sub(lambda m: " " * len(m[0]), text)
        return text.upper().rstrip()

    def _fast(self, text: str, line: int) -> bool:
        """Take a plain block of coordinates; False if it must be read word by word."""
        match = _PLAIN.match(text)
        if not match or not self.absolute:
            return False
        number, g, x, y, z, a, c, i, j, k, f = match.groups()
        motion = self.motion if g is None else int(g)
        if motion > 1:
            return False
        out = self.out
        traori = out.modes.traori
        if i is not None and not traori:
            return False
        if f is not None:
            self.feed = float(f)
        self.motion = motion
        block = int(number) if number else -1
        if x is None and y is None and z is None and a is None and c is None and i is None:
            return True
        position, frame, unit = out.position, self.offset, self.unit
        if x is not None:
            position[0] = float(x) * unit + frame[0]
        if y is not None:
            position[1] = float(y) * unit + frame[1]
        if z is not None:
            position[2] = float(z) * unit + frame[2]
        tilt = turn = math.nan
        if a is not None:
            position[3] = tilt = rad_from_deg(float(a)) + frame[3]
        if c is not None:
            position[4] = turn = rad_from_deg(float(c)) + frame[4]
        axis = None
        if i is not None:
            axis = (float(i), float(j), float(k))
            position[3] = position[4] = math.nan
        self._move(mv.LINE if motion else mv.RAPID, (position[0], position[1], position[2], tilt, turn), axis, line, block)
        return True

    def _move(self, kind: int, target: tuple[float, ...], axis: tuple[float, float, float] | None, line: int, block: int) -> None:
        feed = math.inf if kind == mv.RAPID else self.feed
        if math.isnan(feed):
            raise self.out.fail(
                line, block, "no feed is programmed yet; give F (mm/min, deg/min for A and C alone) in or before this block"
            )
        self.out.add(kind, target, axis, feed, line, block)

    # ------------------------------------------------------------------ words

    def words(self, words: list[Word]) -> None:
        """Everything that stands in one block: first the modes, then the move."""
        coordinates: dict[str, tuple[str, float]] = {}
        centre: dict[str, tuple[str, float]] = {}
        axis: dict[str, float] = {}
        extra: dict[str, float] = {}
        tool: dict[str, Word] = {}
        dwell = exact = suppress = trans = False
        pause: float | None = None
        turns = 0
        motion_word = False
        for word in words:
            name = word.name
            if word.assigned and re.fullmatch(r"R\d+", name):
                self.arithmetic.parameters[int(name[1:])] = self._value(word)
            elif name == "N" and word.value is not None:
                self.block = int(word.value)
            elif name == "G" and (word.value is not None or word.assigned):
                number = self._value(word)
                if number in (0, 1, 2, 3):
                    self.motion, motion_word = int(number), True
                elif number == 4:
                    dwell = True
                elif number == 9:
                    exact = True
                elif number in (53, 153):
                    suppress = True
                elif number in (43, 49) and self.iso:
                    tool[f"G{number:g}"] = word
                else:
                    self._g(number, word)
            elif name in _INDEX:
                coordinates[name] = self._wrapped(word)
            elif name in ("I", "J", "K"):
                centre[name] = self._wrapped(word)
            elif name in ("A3", "B3", "C3"):
                axis[name] = self._value(word)
            elif name == "F":
                extra["F"] = self._value(word)
            elif name == "S":
                extra["S"] = self._value(word)
            elif name in ("CR", "TURN", "ADIS", "ADISPOS", "CTOL", "OTOL") or (name == "P" and (self.iso or dwell)):
                extra[name] = self._value(word)
            elif name == "R" and self.iso:
                extra["CR"] = self._value(word)
            elif name == "M":
                number = self._value(word)
                pause = self._m(number, word, pause)
                if number == 6:
                    tool["M6"] = word
            elif name in ("T", "D", "H"):
                tool[name] = word
            elif name in ("TRANS", "ATRANS"):
                trans = True
                if name == "TRANS":
                    self.shift = np.zeros(5)
            elif name == "SUPA":
                suppress = True
            else:
                self._name(word)
        if tool:
            self.tools.block(tool)
        if dwell:
            if trans or coordinates or centre or axis or extra.keys() not in ({"F"}, {"S"}, {"P"}):
                raise WordError("G4 stands alone in its block with one time, e.g. G4 F<seconds>; give the rest a block of its own", 1)
            self._dwell(extra)
        else:
            self._settings(extra)
        if trans:
            for key, (_, value) in coordinates.items():
                self.shift[_INDEX[key]] += self._si(key, value)
            self._set_offset()
            return
        if coordinates or axis or (centre and self.motion > 1) or (motion_word and self.motion > 1 and "CR" in extra):
            turns = int(extra.get("TURN", 0))
            self._block_move(coordinates, centre, axis, extra, suppress, turns)
            if exact:
                self.out.stops[len(self.out.kinds) - 1] = 0.0
        elif centre or "CR" in extra or "TURN" in extra:
            raise WordError("I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add the motion and its end point", 1)
        if pause is not None and self.out.kinds:
            self.out.stops[len(self.out.kinds) - 1] = pause

    def _value(self, word: Word) -> float:
        if word.assigned:
            return self.arithmetic.value(word.text or "", word.text_column)
        if word.value is None:
            raise WordError(f"'{word.name}' needs a number", word.column)
        return word.value

    def _wrapped(self, word: Word) -> tuple[str, float]:
        """A coordinate and how it counts: '', AC, IC, DC, ACP, ACN."""
        if word.assigned and (match := _WRAPPED.match(word.text or "")):
            if match[1] in ("DC", "ACP", "ACN") and word.name not in _ROTARY:
                raise WordError(f"{match[1]}() is for rotary axes; use AC() or IC()", word.column)
            return match[1], self.arithmetic.value(match[2], word.text_column + match.start(2))
        if word.text is not None and not word.assigned:
            raise WordError(f"'{word.name}({word.text})' is not a coordinate; write {word.name}=AC(..) or {word.name}=IC(..)", word.column)
        return "", self._value(word)

    def _si(self, name: str, value: float) -> float:
        return rad_from_deg(value) if name in _ROTARY else value * self.unit

    def _block_move(self, coordinates, centre, axis, extra, suppress, turns) -> None:  # type: ignore[no-untyped-def]
        """One motion block: target, tool axis and circle."""
        out = self.out
        offset = np.zeros(5) if suppress else np.array(self.offset)
        if axis and not out.modes.traori:
            raise WordError("A3= B3= C3= need TRAORI; switch it on before, or program A= and C=", 1)
        if axis and len(axis) < 3:
            lacking = [k for k in ("A3", "B3", "C3") if k not in axis]
            axis = {**dict.fromkeys(lacking, 0.0), **axis}  # as on the control: a component not programmed is zero
        if axis and ("A" in coordinates or "C" in coordinates):
            raise WordError("the tool axis is given twice, by A3= B3= C3= and by A= C=; keep one", 1)
        if any((n in coordinates and coordinates[n][0] not in ("", "AC")) or (n in coordinates and not self.absolute) for n in _ROTARY):
            out.position[3:] = [float(v) for v in out.settle()]
        start = np.array(out.position)
        target = start.copy()
        for name, (how, value) in coordinates.items():
            i, si = _INDEX[name], self._si(name, value)
            if how == "IC" or (how == "" and not self.absolute):
                target[i] = start[i] + si
            elif how in ("DC", "ACP", "ACN"):
                way = (si + offset[i] - start[i]) % (2.0 * math.pi)
                if (how == "ACN" and way > 0.0) or (how == "DC" and way > math.pi):
                    way -= 2.0 * math.pi
                target[i] = start[i] + way
            else:
                target[i] = si + offset[i]
        angles = [target[3] if "A" in coordinates else math.nan, target[4] if "C" in coordinates else math.nan]
        kind = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[self.motion]
        if kind == mv.ARC:
            self._arc(start, target, centre, extra, offset, turns)
        elif centre or "CR" in extra or turns:
            raise WordError("I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add it to the block", 1)
        vector = (axis["A3"], axis["B3"], axis["C3"]) if axis else None
        self._move(kind, (*map(float, target[:3]), *angles), vector, self.line, self.block)
        out.position[:] = [float(v) for v in target]
        if vector:
            out.position[3:] = [math.nan, math.nan]

    def _arc(self, start, target, centre, extra, offset, turns) -> None:  # type: ignore[no-untyped-def]
        clockwise = self.motion == 2
        if "CR" in extra and centre:
            raise WordError("the circle is given twice, by its centre (I J K) and by its radius; keep one", 1)
        if "CR" in extra:
            middle = arcs.centre_from_radius(start, target, extra["CR"] * self.unit, self.plane, clockwise)
        elif centre:
            a, b, _ = arcs.PLANES[self.plane]
            middle = start.copy()
            for name, (how, value) in centre.items():
                i = "IJK".index(name)
                if i not in (a, b):
                    raise WordError(f"{name} does not lie in the plane G{self.plane}; select the plane with G17, G18 or G19", 1)
                middle[i] = value * self.unit + (offset[i] if how == "AC" else start[i])
        else:
            raise WordError("a circle needs its centre (I J K) or radius (CR=, in .ngc files R); add it to the block", 1)
        self.out.arcs[len(self.out.kinds)] = arcs.from_centre(start[:3], target[:3], middle[:3], self.plane, clockwise, turns)

    def _dwell(self, extra: dict[str, float]) -> None:
        time = extra.get("F", extra.get("P", 0.0))
        if "S" in extra:
            if not self.out.modes.spindle:
                raise WordError("G4 S<turns> needs a spindle speed before; give S or use G4 F<seconds>", 1)
            time = extra["S"] * 60.0 / self.out.modes.spindle
        if not 0.0 <= time <= 3600.0:
            raise WordError(f"a dwell of {time:g} s is out of range; give 0 to 3600 s", 1)
        out = self.out
        self.out.pauses[len(out.kinds)] = time
        out.add(mv.DWELL, (*out.position[:3], math.nan, math.nan), None, math.inf, self.line, self.block)

    # ------------------------------------------------------------------ modes

    def _settings(self, extra: dict[str, float]) -> None:
        """F, S and the tolerances of the block."""
        if "F" in extra:
            if not 0.0 <= extra["F"] < 1e9:
                raise WordError(f"F{extra['F']:g} is no feed; give a number above 0", 1)
            self.feed = extra["F"]
        if "S" in extra:
            self.out.set_modes(replace(self.out.modes, spindle=extra["S"]))
            self.out.notes["S: the spindle is not simulated; its speed only serves G95"] = None
        if "CTOL" in extra:
            self.tolerance = extra["CTOL"] * self.unit if extra["CTOL"] > 0 else DEFAULT_TOLERANCE
        if "OTOL" in extra:
            self.angle_tolerance = rad_from_deg(extra["OTOL"]) if extra["OTOL"] > 0 else DEFAULT_ANGLE_TOLERANCE
        if "P" in extra and self.iso and self.rounding == 64 and extra["P"] > 0:
            self.tolerance = extra["P"] * self.unit
        if "ADIS" in extra:
            self.adis = max(0.0, extra["ADIS"]) * self.unit
        if "ADISPOS" in extra:
            self.adispos = max(0.0, extra["ADISPOS"]) * self.unit
        if extra.keys() & {"CTOL", "OTOL", "P", "ADIS", "ADISPOS"}:
            self._rounding()

    def _rounding(self, **changes: object) -> None:
        """The modes of corner rounding from the G code in force and its words."""
        by_distance = self.rounding == 641
        adis, adispos = (self.adis or math.inf, self.adispos or math.inf) if by_distance else (math.inf, math.inf)
        wide = by_distance and self.adis > 0.0
        modes = replace(
            self.out.modes,
            exact_stop=self.rounding == 60,
            tolerance=self.adis if wide else self.tolerance,
            angle_tolerance=self.angle_tolerance,
            distance=adis,
            rapid_distance=adispos,
        )
        self.out.set_modes(replace(modes, **changes))  # type: ignore[arg-type]

    def _g(self, number: float, word: Word) -> None:
        out = self.out
        if number in (17, 18, 19):
            self.plane = int(number)
        elif number in (20, 70, 21, 71, 700, 710):
            self.unit = INCH if number in (20, 70, 700) else 1e-3
            if number in (20, 21, 700, 710):
                out.set_modes(replace(out.modes, feed_unit=self.unit))
        elif number in (90, 91):
            self.absolute = number == 90
        elif number in (93, 94, 95):
            if number != out.modes.feed_mode:
                out.set_modes(replace(out.modes, feed_mode=int(number)))
                self.feed = math.nan  # a feed in other units does not carry over
        elif number in (60, 61, 64, 641, 642) or (number == 61.1 and self.iso):
            self.rounding = 60 if number in (61, 61.1) else int(number)
            self._rounding()
        elif number in (601, 602, 603):
            out.set_modes(replace(out.modes, stop_window=f"G{int(number)}"))
        elif number == 500 or (54 <= number <= 59 and number == int(number)) or 505 <= number <= 599:
            self.frame = self._frame_table(f"G{int(number)}")
            self._set_offset()
        elif number in _NO_EFFECT_G:
            out.notes[f"G{number:g}: understood, without effect on the motion"] = None
        elif number == int(number) and int(number) in _ADVICE:
            raise WordError(f"G{number:g} is not supported: {_ADVICE[int(number)]}", word.column)
        else:
            raise WordError(
                f"G{number:g} is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
            )

    def _m(self, number: float, word: Word, pause: float | None) -> float | None:
        if number in _END_M:
            self.ended = True
        elif number in (0, 1, 6):
            self.out.notes[f"M{number:g}: the program goes on after an exact stop"] = None
            return 0.0
        elif number in _NO_EFFECT_M:
            self.out.notes[f"M{number:g}: understood, without effect on the motion"] = None
        else:
            raise WordError(f"M{number:g} is not known; remove it if it moves no axis", word.column)
        return pause

    def _name(self, word: Word) -> None:
        """Words without a number: transformation, feedforward, acceleration, messages, cycles."""
        name, out = word.name, self.out
        if name == "TRAORI":
            if not out.modes.traori:
                out.change_frame(replace(out.modes, traori=True))
        elif name == "TRAFOOF":
            if out.modes.traori:
                out.change_frame(replace(out.modes, traori=False))
        elif name in ("ORIWKS", "ORIVECT", "ORIPLANE"):
            out.set_modes(replace(out.modes, workpiece_orientation=True))
        elif name in ("ORIMKS", "ORIAXES"):
            out.set_modes(replace(out.modes, workpiece_orientation=False))
        elif name in ("FFWON", "FFWOF"):
            if out.feedforward is None:
                out.feedforward = "velocity+torque" if name == "FFWON" else "off"
            out.set_modes(replace(out.modes, feedforward=name == "FFWON"))
        elif name in ("SOFT", "BRISK"):
            out.set_modes(replace(out.modes, brisk=name == "BRISK"))
        elif name == "R":
            raise WordError("R is an R-parameter here (X=R1, R1=5); the radius of an arc is CR=, R in .ngc files only", word.column)
        elif name == "MSG":
            out.messages.append((word.text or "").strip().strip('"'))
        elif name == "CYCLE832":
            self._cycle832(word)
        elif name == "ROT" or name == "AROT" or name == "SCALE" or name == "MIRROR":
            raise WordError(
                f"{name} is not supported: turned, scaled or mirrored frames; let the CAM system put out the final coordinates", word.column
            )
        elif name in _NO_EFFECT_NAMES:
            out.notes[f"{name}: understood, without effect on the motion"] = None
        else:
            known = (
                *_NO_EFFECT_NAMES,
                "TRAORI",
                "TRAFOOF",
                "ORIWKS",
                "ORIMKS",
                "FFWON",
                "FFWOF",
                "SOFT",
                "BRISK",
                "MSG",
                "CYCLE832",
                "TRANS",
                "REPEAT",
            )
            hint = nearest(name, known) if len(name) > 1 else ""
            if not hint.startswith("did you"):
                hint = "remove it or replace it by moves (docs/programs.md lists what is read)"
            raise WordError(f"word '{name}' is not known; {hint}", word.column)

    def _cycle832(self, word: Word) -> None:
        """CYCLE832(tolerance, machining, orientation tolerance): G642 with that tolerance, SOFT and FFWON; 0 switches off."""
        numbers = []
        for part in (word.text or "").split(","):
            try:
                numbers.append(self.arithmetic.value(part, word.text_column))
            except WordError:
                numbers.append(math.nan)  # names such as _FINISH
        tolerance = numbers[0] if numbers else 0.0
        if math.isnan(tolerance) or tolerance < 0.0:
            raise WordError("CYCLE832 needs a tolerance in mm first, e.g. CYCLE832(0.01,3)", word.column)
        self.tolerance = tolerance * self.unit or DEFAULT_TOLERANCE
        angle = numbers[2] if len(numbers) > 2 else math.nan
        self.angle_tolerance = rad_from_deg(angle) if angle > 0.0 else DEFAULT_ANGLE_TOLERANCE
        self.rounding = 642 if tolerance else 64
        if tolerance and self.out.feedforward is None:
            self.out.feedforward = "velocity+torque"
        self._rounding(**({"brisk": False, "feedforward": True} if tolerance else {}))

    # ------------------------------------------------------------------ frames

    def _set_offset(self) -> None:
        self.offset = [float(v) for v in self.frame + self.shift]

    def _frame_table(self, name: str) -> np.ndarray:
        """Zero offset (5,) of a settable frame from the table [frame.G54] of the machine file; zero if there is none."""
        tables = self.machine.document.get("frame", {})
        table = tables.get(name, {}) if isinstance(tables, dict) else {}
        offset = np.zeros(5)
        for key, value in table.items():
            axis, _, unit = key.partition("_")
            if axis.upper() not in _INDEX or unit != ("deg" if axis.upper() in _ROTARY else "m") or not isinstance(value, int | float):
                raise InputError(
                    f"{self.machine.path or self.machine.name}: [frame.{name}]: unknown key '{key}'; use x_m, y_m, z_m, a_deg, c_deg"
                )
            offset[_INDEX[axis.upper()]] = rad_from_deg(value) if unit == "deg" else float(value)
        return offset
