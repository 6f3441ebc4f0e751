"""Read APT / CL data (.apt .cls .ncl .aptsource), the output of CATIA, NX and Creo between CAM system and postprocessor.

CL data describe the tool tip and the tool axis in the part frame, so everything runs under TRAORI with corner rounding (G642).
A line that ends in `$` continues on the next, `$$` starts a comment. RAPID holds for the next move only; a GOTO with three
values keeps the tool axis of TLAXIS or of the GOTO before. MSYS and CSYS set the frame of the following points in the part frame.
"""

from collections.abc import Iterator
import math
import re

import numpy as np

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program import apt_words as words
from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import KEPT, Control
from twin.program.expressions import WordError, needed
from twin.program.frames import Frame
from twin.program.source import ProgramText
from twin.program.state import INCH, REFUSED, State

UNITS = {"MM": 1e-3, "CM": 1e-2, "M": 1.0, "INCH": INCH, "INCHES": INCH, "IN": INCH}
LONGEST_STATEMENT = 20_000
"""Largest number of characters of one statement over all its lines."""

OFF_AXIS = 1e-3
"""Largest deviation of the axes of a frame from right angles and unit length."""


class AptReader:
    """Tool, frames and feeds while statements are read."""

    def __init__(self, source: ProgramText, machine: Machine) -> None:
        self.source, self.reading = source, source.path
        self.state = State(source.path, machine, "apt", ("system",))
        self.state.feed_word = "FEDRAT/ before this GOTO"
        self.control, self.out = Control(self.state), self.state.out
        self.state.transform(True)
        self.spindle = math.nan  # rev/min
        self.turn_feed: tuple[list[str], str] | None = None  # FEDRAT per revolution, which a later SPINDL changes
        self.rapid = self.rapid_feed = False  # of the next move; of all moves
        self.axis = np.array([0.0, 0.0, 1.0])
        self.arc: tuple[np.ndarray, np.ndarray, float | None, float | None] | None = None  # centre, axis, radius [m], angle [rad]
        self.world = False  # True: points are in the part frame, independent of CSYS
        self.direction: np.ndarray | None = None  # of the start of a driven arc
        self.cycle: words.Strokes | None = None
        self.ended = False
        self.on_profile = False  # Creo marks that its points are not those of the tool centre
        self.words = {
            "GOTO": self._goto, "FROM": self._goto, "GODLTA": self._step, "FEDRAT": self._feed, "CIRCLE": self._circle,
            "UNITS": self._units, "UNIT": self._units, "DELAY": self._delay, "DWELL": self._delay,
            "INDIRV": self._direction, "INDIRP": self._direction, "TLON,GOFWD": self._driven, "GOFWD": self._driven, "CYCLE": self._cycle,
            "CUTCOM": self._compensation, "SPINDL": self._spindle, "MSYS": self._system, "CSYS": self._system,
            "GOHOME": self._goto, "MOVARC": self._circle, "TRNTYP": self._transformation_type,
            "MCSYS": self._system,
        }  # fmt: skip

    def run(self) -> None:
        """Read all statements in order; `out` holds the moves."""
        for line, text in self._statements():
            self.state.line = line
            self._statement(text)
            if self.ended:
                break

    def _statements(self) -> Iterator[tuple[int, str]]:
        """First line and text of each statement; a statement whose '$' is the last of the file ends there."""
        text, first, remark = "", 0, False
        for number, raw in enumerate(self.source.lines, start=1):
            part = raw.split("$$")[0].upper().rstrip()
            self.on_profile |= "OUTPUT_ON_PROFILE" in raw
            if remark or (not text and not part):  # a remark that ends in '$' goes on, too
                remark = raw.rstrip().endswith("$") and not raw.rstrip().endswith("$$")
                continue
            first = first or number
            text += part.removesuffix("$")
            if not part.endswith("$"):
                yield first, text.strip()
                text, first = "", 0
            elif len(text) > LONGEST_STATEMENT:
                raise self.out.fail(first, -1, "a statement continues over too many lines; remove the '$' at their ends")
            else:
                text += " "
        yield first, text.strip()

    def _statement(self, text: str) -> None:
        if not text or text == "%":
            return
        word, values = needed(words.word_and_values(text), f"'{text[:40]}' is not an APT statement; expected WORD/ values", 0)
        first = word.split()[0].split(",")[0]
        if word == "RAPID":
            self.rapid = True
        elif word == "FINI":
            self.ended = True
        elif word == "TLAXIS":
            self.axis = np.array(words.numbers_of(values, word, (3,)))
        elif word in self.words:
            self.words[word](word, values)
        elif words.moves_nothing(word, values):
            self.state.note(f"{word}/0,0,0: a shift by zero")
        elif (entry := words.WORDS.get(word, words.WORDS.get(first))) is not None:
            if entry.kind == REFUSED:
                raise WordError(f"{word}/ is not simulated: {entry.meaning}", 0)
            self.state.note(f"{word}: {entry.meaning}")
        elif "_" in word:
            self.state.note(f"{word}: a word of the CAM system outside the standard of CL data, assumed to have no effect on the motion")
        else:
            hint = nearest(word, {*words.WORDS, *self.words, "RAPID", "FINI", "TLAXIS"})
            if not hint.startswith("did you"):
                hint = "let the CAM system output points (GOTO) instead, or remove it if it moves nothing"
            raise WordError(f"statement '{word}' is not known; {hint}", 0)

    # frames and modes

    def _units(self, word: str, values: str) -> None:
        unit = needed(UNITS.get(values.strip()), f"{word}/{values}: use {word}/MM or {word}/INCHES", 0)
        self.state.set_unit(unit, feed=True)

    def _system(self, word: str, values: str) -> None:
        """The frame of the points that follow.

        MSYS/ origin, x axis, y axis (NX); CSYS/ three rows of a 3 x 4 matrix (Creo); MCSYS/ NUM, n, POINT, x,y,z, VECTOR, (x axis), VECTOR, (y axis) (DMG MORI).
        """
        if word == "CSYS":
            m = np.array(words.numbers_of(values, word, (12,))).reshape(3, 4)
            if self.world:
                self.axis = m[:, 2] / (np.linalg.norm(m[:, 2]) or 1.0)
                return
            if np.linalg.norm(np.cross(m[:, 0], m[:, 1]) - m[:, 2]) > OFF_AXIS:
                raise WordError(f"{word}/: its third axis is not that of a right-handed frame; correct it", 0)
            n = [*m[:, 3], *m[:, 0], *m[:, 1]]
        elif word == "MSYS":
            n = words.numbers_of(values, word, (9,))
        else:
            _, *n = [float(v) for v in words.listed(values) if words.is_number(v)] or [0.0]
            if len(n) != 9 or words.listed(values).count("VECTOR") != 2:
                raise WordError(f"{word}/ is not read; give NUM, n, POINT, x, y, z, VECTOR, (x axis), VECTOR, (y axis)", 0)
            self.axis = np.array([0.0, 0.0, 1.0])
        origin, x, y = (np.array(n[k : k + 3]) for k in (0, 3, 6))
        if abs(np.linalg.norm(x) - 1.0) > OFF_AXIS or abs(np.linalg.norm(y) - 1.0) > OFF_AXIS or abs(float(x @ y)) > OFF_AXIS:
            raise WordError(f"{word}/ is not a frame: its axes must have length 1 and be at a right angle; correct it", 0)
        x = x / np.linalg.norm(x)
        y = y - x * (x @ y)
        rotation = np.column_stack([x, y / np.linalg.norm(y), np.cross(x, y / np.linalg.norm(y))])
        self.state.set_frames(system=Frame(rotation, np.array([*origin * self.state.unit, 0.0, 0.0])))
        if not np.allclose(rotation, np.eye(3), atol=1e-9) or np.any(np.abs(origin * self.state.unit) > 1e-12):
            self.state.note(f"{word}: the points that follow stand in this frame; they are brought to the part frame")

    def _transformation_type(self, word: str, values: str) -> None:
        """TRNTYP/WORLD,0,0,0: points stand in the part frame; the CSYS after it gives the tool axis only (RhinoCAM, VisualCAD)."""
        parts = words.listed(values)
        if parts[:1] != ["WORLD"] or any(not words.is_number(v) or float(v) for v in parts[1:]):
            raise WordError(f"{word}/{values[:40]} is not read; use {word}/WORLD,0,0,0", 0)
        self.world = True
        self.state.note(f"{word}/WORLD: the points stand in the part frame; CSYS gives the tool axis of a GOTO without one")

    def _spindle(self, word: str, values: str) -> None:
        """SPINDL/ speed, RPM, CLW in any order: for feeds per revolution."""
        parts = words.listed(values)
        numbers = [words.numbers_of(v, word, (1,))[0] for v in parts if re.fullmatch(r"[-+.\d]+", v, re.A)]
        if numbers and not {"SFM", "SMM"} & set(parts):
            self.spindle = numbers[0]
            if self.turn_feed:
                self.state.feed = self._feed_of(*self.turn_feed)
        self.state.note("SPINDL: the speed is used for feeds per revolution only")

    def _compensation(self, word: str, values: str) -> None:
        if values.strip() in ("OFF", ""):
            return
        if self.on_profile:
            text = "cutter radius compensation is not simulated; let the CAM system output the path of the tool centre"
            raise WordError(f"{word}/{values[:30]} is not supported, since the points are those of the profile: {text}", 0)
        self.state.note(f"{word}: the points are those of the tool centre, so the compensation is only for wear, which is assumed to be 0")

    # feeds

    def _feed(self, word: str, values: str) -> None:
        """FEDRAT/ value [, unit], or unit first; FEDRAT/RAPID until the next one."""
        parts = words.listed(values)
        if parts == ["RAPID"]:
            self.rapid_feed = True
            return
        self.turn_feed = (parts, word) if set(parts) & words.PER_REVOLUTION else None
        self.state.feed = math.nan if self.turn_feed and math.isnan(self.spindle) else self._feed_of(parts, word)
        self.rapid = self.rapid_feed = False

    def _feed_of(self, parts: list[str], word: str) -> float:
        """A feed in units of the file per minute, the unit of the collector."""
        units = [v for v in parts if v in words.FEED_UNITS]
        value = words.numbers_of(",".join(v for v in parts if v not in units), word, (1,))[0]
        unit = units[0] if units else "PERMIN"
        metres = words.FEED_UNITS[unit]
        if unit in words.PER_REVOLUTION:
            if math.isnan(self.spindle):
                raise WordError("a feed per revolution needs a spindle speed; give SPINDL/ in RPM before it, or a feed per minute", 0)
            value *= self.spindle
        return value if metres is None else value * metres / self.state.unit

    # moves

    def _goto(self, word: str, values: str) -> None:
        """GOTO/ place [, tool axis], where the cycle in force is carried out; FROM/ and, with its place, GOHOME/ (NX) are rapid moves."""
        if word == "GOHOME" and not values.strip():
            raise WordError(f"{word} without its place is not simulated; give it as GOHOME/ x, y, z or as a GOTO", 0)
        self.rapid |= word != "GOTO"
        numbers = np.array(words.numbers_of(values, word, (3, 6)))
        if len(numbers) == 6:
            self.axis = numbers[3:]
        place = numbers[:3] * self.state.unit
        if self.cycle is None:
            self._move(place)
            return
        feed = self.state.feed
        for kind, height, at_feed in self.cycle:
            self.state.feed = at_feed
            self._add(kind, place + height * self.axis / (np.linalg.norm(self.axis) or 1.0))
        self.state.feed, self.rapid = feed, False

    def _step(self, word: str, values: str) -> None:
        step = words.numbers_of(values, word, (1, 3))
        way = np.array(step) if len(step) == 3 else step[0] * self.axis / (np.linalg.norm(self.axis) or 1.0)
        self._move(self.state.here() + way * self.state.unit)

    def _move(self, target: np.ndarray) -> None:
        rapid = self.rapid or self.rapid_feed
        arc = words.arc_to(self.state.here(), target, *self.arc) if self.arc and not rapid else None
        self._add(mv.RAPID if rapid else mv.ARC if arc else mv.LINE, target, arc)
        self.rapid, self.arc = False, None

    def _add(self, kind: int, target: np.ndarray, arc: arcs.Arc | None = None) -> None:
        if kind != mv.RAPID and math.isnan(self.state.feed) and self.turn_feed:
            self._feed_of(*self.turn_feed)
        x, y, z = map(float, self.axis)
        self.control.make(self.control.move(kind, target, KEPT, (x, y, z), arc))

    def _circle(self, word: str, values: str) -> None:
        """CIRCLE/ centre, axis [, radius]; MOVARC/ centre, axis, radius [, ANGLE, degrees] (Fusion), or CENTER, .., AXIS, .., RADIUS, r.

        The arc leads to the next point.
        """
        parts, degrees = words.listed(values), math.nan
        if word == "CIRCLE":
            numbers = words.numbers_of(values, word, (6, 7, 8, 9, 10, 11))
        else:
            numbers = [float(v) for v in parts if words.is_number(v)]
            unknown = [v for v in parts if not words.is_number(v) and v not in ("CENTER", "AXIS", "RADIUS", "ANGLE")]
            degrees = numbers.pop() if "ANGLE" in parts and len(numbers) == 8 else degrees
            if len(numbers) != 7 or unknown:
                raise WordError(f"{word}/{values[:60]} is not read; give centre, axis, radius, ANGLE, degrees", 0)
        normal, unit = np.array(numbers[3:6]), self.state.unit
        if not np.linalg.norm(normal) > 0.0:
            raise WordError(f"{word} needs the axis of the circle as 4th to 6th value; correct it", 0)
        radius = numbers[6] * unit if len(numbers) > 6 else None
        sweep = None if math.isnan(degrees) else math.radians(degrees)
        self.arc = np.array(numbers[:3]) * unit, normal / np.linalg.norm(normal), radius, sweep

    def _direction(self, word: str, values: str) -> None:
        given = np.array(words.numbers_of(values, word, (3,)))
        self.direction = given if word == "INDIRV" else given * self.state.unit - self.state.here()

    def _driven(self, word: str, values: str) -> None:
        direction = needed(self.direction, f"{word}/ needs the direction of its start; give INDIRV/ before it", 0)
        arc, end = words.driven_arc(values, self.state.here(), direction, self.axis, self.state.unit)
        self._add(mv.ARC, end, arc)
        self.rapid, self.direction = False, None

    def _delay(self, word: str, values: str) -> None:
        parts = words.listed(values)
        turns = "REV" in parts
        seconds = words.numbers_of(",".join(v for v in parts if v not in ("REV", "SEC")), word, (1,))[0]
        if turns:
            if not self.spindle > 0.0:
                raise WordError(f"{word}/ in revolutions needs a spindle speed; give SPINDL/ before it", 0)
            seconds *= 60.0 / self.spindle
        self.control.dwell(seconds)

    # drilling

    def _cycle(self, word: str, values: str) -> None:
        """CYCLE/ kind, depth, feed, unit, clearance (CATIA), or with words FEDTO, RTRCTO, RAPTO, CLEAR (NX, Creo); OFF, ON."""
        parts = words.listed(values)
        kind = parts[0] if parts else ""
        if kind in ("OFF", "NOMORE"):
            self.cycle = None
            return
        if kind in ("ON", "INIT"):
            return
        if kind not in words.CYCLES:
            raise WordError(f"{word}/{kind} is not simulated; let the CAM system output points (GOTO) instead", 0)
        found = words.cycle_of(kind, parts, self.state.unit, self.state.feed, lambda feed: self._feed_of(feed, word))
        self.cycle = needed(found, f"{word}/{kind} needs a depth and a feed; give CYCLE/{kind},depth,feed,MMPM,clearance", 0)
        self.state.note(f"CYCLE/{kind}: one straight stroke to the depth; pecks and dwells are omitted")
