"""APT / CL data (.apt .cls) into moves: GOTO with tool axis, RAPID, FEDRAT, FROM, GODLTA, CIRCLE, UNITS.

CL data describe the tool tip and the tool axis in the part frame, so everything runs under TRAORI with corner rounding (G642).
A line that ends in `$` continues on the next, `$$` starts a comment. CIRCLE/ x,y,z,i,j,k,r gives centre, axis and
radius of the arc to the next GOTO, right-handed about its axis (as NX writes it). RAPID holds for the next move only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import math
from pathlib import Path
import re

import numpy as np

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program.collect import NO_RADIUS_COMPENSATION, Collector
from twin.program.flow import Source

INCH = 0.0254
_STATEMENT = re.compile(r"\s*([A-Z][A-Z0-9_-]*(?:\s+[A-Z-]+)*)\s*(?:/\s*(.*?))?\s*\Z", re.S | re.A)
_NO_EFFECT = {
    "PARTNO", "PPRINT", "MULTAX", "SPINDL", "COOLNT", "LOADTL", "LOAD", "CUTTER", "TLCOM", "INTOL", "OUTTOL", "TOLER", "CUTCOM", "MACHIN",
    "TOOL PATH", "END-OF-PATH", "TLDATA", "MSYS", "PAINT", "SELECT", "CLEARP", "REMARK", "INSERT", "OPSKIP", "TPRINT", "CALSUB",
    "SET", "MODE",
}  # fmt: skip
_FEED_UNITS = {"MMPM": 1.0, "IPM": 25.4, "PERMIN": None, "MMPR": 1.0, "IPR": 25.4, "PERREV": None}


def read_apt(path: Path, machine: Machine) -> mv.Program:
    """Read CL data; every fault names line and statement."""
    return AptReader(path, machine).read()


class AptReader:
    """The state of the tool while statements are read."""

    def __init__(self, path: Path, machine: Machine):
        self.source = Source(path)
        self.out = Collector(path, machine)
        self.out.change_frame(replace(self.out.modes, traori=True))
        self.unit = 1e-3
        self.feed = math.nan
        self.rapid = False
        self.axis = (0.0, 0.0, 1.0)
        self.arc: tuple[np.ndarray, np.ndarray, float] | None = None
        self.ended = False
        self.line = 0

    def read(self) -> mv.Program:
        """All statements in order."""
        for line, text in self._statements():
            self.line = line
            try:
                self._statement(text)
            except arcs.ArcError as error:
                raise self._fail(str(error)) from None
            if self.ended:
                break
        return self.out.finish()

    def _statements(self) -> Iterator[tuple[int, str]]:
        """First line and text of each statement; one that the end of the file cuts off after its '$' ends there."""
        text, first = "", 0
        for number, raw in enumerate(self.source.lines, start=1):
            part = raw.split("$$")[0].upper().rstrip()
            first = first or number
            text += part.removesuffix("$")
            if not part.endswith("$"):
                yield first, text.strip()
                text, first = "", 0
            elif len(text) > 20_000:
                raise self.out.fail(first, -1, "a statement goes on over too many lines; remove the '$' at their ends")
            else:
                text += " "
        yield first, text.strip()

    def _fail(self, text: str) -> Exception:
        return self.out.fail(self.line, -1, text)

    def _statement(self, text: str) -> None:
        if not text:
            return
        match = _STATEMENT.match(text)
        if not match:
            raise self._fail(f"'{text[:40]}' is no APT statement; expected WORD/ values")
        word, values = match[1], match[2] or ""
        if word in ("GOTO", "FROM"):
            self._goto(word, self._numbers(values, word, (3, 6)))
        elif word == "GODLTA":
            step = self._numbers(values, word, (3,))
            self._move(np.array(self.out.position[:3]) + np.array(step) * self.unit)
        elif word == "RAPID":
            self.rapid = True
        elif word == "FEDRAT":
            self._feed(values)
        elif word == "CIRCLE":
            numbers = self._numbers(values, word, (7, 8, 9, 10, 11))
            normal = np.array(numbers[3:6])
            if not np.linalg.norm(normal) > 0.0:
                raise self._fail("CIRCLE needs the axis of the circle as 4th to 6th value; correct it")
            self.arc = np.array(numbers[:3]) * self.unit, normal / np.linalg.norm(normal), numbers[6] * self.unit
        elif word == "UNITS":
            if values.strip() not in ("MM", "INCH", "INCHES"):
                raise self._fail(f"UNITS/{values}: use UNITS/MM or UNITS/INCHES")
            self.unit = 1e-3 if values.strip() == "MM" else INCH
            self.out.set_modes(replace(self.out.modes, feed_unit=self.unit))
        elif word == "DELAY":
            self.out.pauses[len(self.out.kinds)] = self._numbers(values, word, (1,))[0]
            self.out.add(mv.DWELL, (*self.out.position[:3], math.nan, math.nan), None, math.inf, self.line, -1)
        elif word in ("FINI", "END", "STOP"):
            self.ended = word == "FINI"
        elif word == "CUTCOM" and values.strip() != "OFF":
            raise self._fail(f"{text[:40]} is not supported: {NO_RADIUS_COMPENSATION}")
        elif word in _NO_EFFECT or word.split()[0] in _NO_EFFECT:
            self.out.notes[f"{word}: understood, without effect on the motion"] = None
        else:
            known = {*_NO_EFFECT, "GOTO", "FROM", "GODLTA", "RAPID", "FEDRAT", "CIRCLE", "UNITS", "DELAY", "FINI"}
            hint = nearest(word, known)
            if not hint.startswith("did you"):
                hint = "let the CAM system put out points (GOTO) instead, or remove it if it moves nothing"
            raise self._fail(f"statement '{word}' is not known; {hint}")

    def _numbers(self, values: str, word: str, counts: tuple[int, ...]) -> list[float]:
        try:
            numbers = [float(v) for v in values.split(",")]
        except ValueError:
            raise self._fail(f"{word}/{values[:60]}: not all values are numbers; correct them") from None
        if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
            raise self._fail(f"{word}/ has {len(numbers)} values, expected {' or '.join(map(str, counts))} finite numbers; correct it")
        return numbers

    def _feed(self, values: str) -> None:
        """FEDRAT/ value [, unit], or unit first; MMPR and IPR need a spindle speed, which CL data seldom carry."""
        parts = [v.strip() for v in values.split(",") if v.strip()]
        units = [v for v in parts if v in _FEED_UNITS]
        numbers = [v for v in parts if v not in _FEED_UNITS]
        if any(u in ("MMPR", "IPR", "PERREV") for u in units):
            raise self._fail("a feed per revolution is not supported in CL data; give FEDRAT/ in MMPM or IPM")
        value = self._numbers(",".join(numbers), "FEDRAT", (1,))[0]
        scale = next((_FEED_UNITS[u] for u in units if _FEED_UNITS[u]), None)
        self.feed = value if scale is None else value * scale * 1e-3 / self.unit
        self.rapid = False

    def _goto(self, word: str, numbers: list[float]) -> None:
        if len(numbers) == 6:
            self.axis = (numbers[3], numbers[4], numbers[5])
        self.rapid = self.rapid or word == "FROM"
        self._move(np.array(numbers[:3]) * self.unit)

    def _move(self, target: np.ndarray) -> None:
        out = self.out
        kind = mv.RAPID if self.rapid else mv.LINE
        if self.arc and not self.rapid:
            kind = mv.ARC
            out.arcs[len(out.kinds)] = self._arc_to(target)
        if kind != mv.RAPID and math.isnan(self.feed):
            raise self._fail("no feed is programmed yet; give FEDRAT/ before this GOTO")
        feed = math.inf if kind == mv.RAPID else self.feed
        out.add(kind, (*map(float, target), math.nan, math.nan), self.axis, feed, self.line, -1)
        out.position[:] = [*map(float, target), math.nan, math.nan]
        self.rapid, self.arc = False, None

    def _arc_to(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Centre, axis and angle of the arc from here to the target."""
        assert self.arc
        centre, normal, radius = self.arc
        arms = [p - centre - normal * ((p - centre) @ normal) for p in (np.array(self.out.position[:3]), target)]
        for arm, place in zip(arms, ("start", "end")):
            if abs(np.linalg.norm(arm) - radius) > arcs.CLOSING_TOLERANCE:
                raise arcs.ArcError(
                    f"the arc does not close: its {place} lies {np.linalg.norm(arm) * 1e3:.4f} mm from the axis of CIRCLE/, "
                    f"the radius is {radius * 1e3:.4f} mm; correct it"
                )
        angle = math.atan2(float(np.cross(arms[0], arms[1]) @ normal), float(arms[0] @ arms[1])) % (2.0 * math.pi)
        return centre, normal, angle if angle > 1e-9 else 2.0 * math.pi
