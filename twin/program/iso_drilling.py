"""The drilling cycles of ISO programs, G73 to G89."""

from __future__ import annotations

import math
from typing import Any

from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import Control
from twin.program.cycles import ASIDE, BACK, DWELL, FEED, RAPID, Drilling
from twin.program.expressions import WordError
from twin.program.state import INDEX, LINEAR, OTHER, ROTARY, Item

CYCLES = {73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89}
USED_BY = {"P": {73, 74, 76, 82, 83, 84, 86, 87, 88, 89}, "Q": {73, 76, 83, 87}, "I": {76, 87}, "J": {76, 87}}
"""Word -> cycles that use it; its value is modal."""
MOST_REPEATS = 10_000


class IsoDrilling:
    """Drilling cycles and their modal words."""

    def __init__(self, control: Control) -> None:
        self.control, self.state = control, control.state
        self.cycle: dict[str, Any] | None = None
        self.sticky: dict[str, float] = {}
        self.given_absolute: dict[str, bool] = {}  # of the words in `sticky`: under G90
        self.initial = 0.0  # height at which the cycles began [m]

    def drill_holes(self, codes: set[float], coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """A drilling cycle at the holes of the block."""
        assert self.cycle is not None
        number = self.cycle["g"]
        turned = {n: coordinates.pop(n) for n in (*ROTARY, *OTHER) if n in coordinates}
        for name in turned if self.state.linuxcnc else ():
            if name in turned:
                raise WordError(f"Cannot put {name} in a canned cycle; move {name} in a block before", turned[name].column)
        a, b, across = arcs.PLANES[self.state.plane]
        named = {n: coordinates[n].value for n in coordinates}
        absolute = {n: self.state.absolute or coordinates[n].how == "AC" for n in coordinates}  # G16 gives places
        for name in "RPQIJ":
            if name in w:
                if number not in USED_BY.get(name, CYCLES) or (self.state.linuxcnc and name == "P" and number in (73, 83)):
                    self.state.note(f"G{number}: {name} is not used by this cycle; one that uses it finds it")
                self.sticky[name] = w.pop(name).value
                self.given_absolute[name] = self.state.absolute
        depth_axis = LINEAR[across]
        if depth_axis in named:
            self.sticky["Z"] = named.pop(depth_axis)
            self.given_absolute["Z"] = self.state.absolute
        repeats = 1
        for name in ("L", "K"):
            if name in w:
                word = w.pop(name)
                repeats = int(word.value)
                if repeats != word.value:
                    raise WordError(f"{name}{word.value:g} is not a whole number of repetitions; correct it", word.column)
        if not (coordinates or turned or codes & CYCLES or repeats != 1):
            return
        if "Z" not in self.sticky or "R" not in self.sticky:
            missing = depth_axis if "Z" not in self.sticky else "R"
            raise WordError(f"G{number} needs {missing}; add it", 1)
        if number in (73, 83) and not self.sticky.get("Q", 0.0) > 0.0:
            raise WordError(f"G{number} needs Q, the depth of one peck, above 0; add it", 1)
        if math.isnan(self.state.feed) or self.state.feed == 0.0:
            self.no_feed()
        if self.state.comp is not None:
            raise WordError("a drilling cycle is inside G41 or G42; write G40 before", 1)
        if repeats > MOST_REPEATS:
            raise WordError(f"the cycle repeats more than {MOST_REPEATS} times", 1)
        here = self.state.here() / self.state.unit
        start_height, initial = float(here[across]), self.initial / self.state.unit
        as_given = {"R": self.state.absolute, "Z": self.state.absolute} if self.state.linuxcnc else self.given_absolute
        safe = self.sticky["R"] + (0.0 if as_given["R"] else initial)
        depth = self.sticky["Z"] + (0.0 if as_given["Z"] else safe)
        if (as_given["R"], as_given["Z"]) != (self.given_absolute["R"], self.given_absolute["Z"]):
            self.state.note(
                "G90, G91 in an active cycle: R and Z are taken anew by the mode in force, as on LinuxCNC; other controls keep the levels"
            )
        elif not self.state.linuxcnc and not self.state.absolute == as_given["R"] == as_given["Z"]:
            self.state.note("G90, G91 in an active cycle: R and Z keep their levels, as on a Fanuc; in .ngc files they are taken anew")
        if self.state.linuxcnc and self.state.plane != 17 and number in (74, 84):
            raise WordError(f"G{number} outside G17 is not read: LinuxCNC itself moves other axes there; write the moves", 1)
        if (depth > safe) != (number == 87) and depth != safe:
            where = "below" if number == 87 else "above"
            raise WordError(f"G{number}: {depth_axis} {depth:g} lies {where} R {safe:g}; correct one", 1)
        clear = max(safe, initial) if self.state.retract_to_start else safe
        aside = (self.sticky.get("I", 0.0), self.sticky.get("J", 0.0)) if number in (76, 87) else (0.0, 0.0)
        if number in (76, 87) and not any(aside):
            aside = (abs(self.sticky.get("Q", 0.0)), 0.0)
            self.state.note("G76, G87: the tool steps aside by Q along the first axis, towards +; a parameter on the control")
        if number == 88:
            self.state.note("G88: the halt at the bottom is omitted")
        pause = self.sticky.get("P", 0.0) if number in USED_BY["P"] else 0.0
        if not self.state.linuxcnc:
            pause /= 1000.0
            self.state.note(
                "P of drilling cycles is a dwell in ms, as on a Fanuc; in .ngc files in s, and G81, G83 use none"
            ) if pause else None
        if number in (73, 83, 85, 81) and self.state.linuxcnc:
            pause = 0.0
        cycle = Drilling(
            safe, depth, clear, dwell=pause, peck=self.sticky.get("Q", 0.0) if number in (73, 83) else 0.0, break_chip=number == 73,
            back=0.254e-3 / self.state.unit, out=FEED if number in (74, 84, 85, 89) else RAPID, feed_all_the_way=self.state.linuxcnc, aside=aside,
        )  # fmt: skip
        if number in (73, 83):
            self.state.note("G73, G83: the tool backs off by 0.254 mm, a parameter on the control")
        _, angles = self.control.target(turned, False)
        if start_height < safe and number != 87:
            self.control.height(safe)
        for _ in range(repeats):
            point = self.state.here()
            for name, value in named.items():
                i = INDEX[name]
                point[i] = value * self.state.unit if absolute[name] else point[i] + value * self.state.unit
            self.control.go(mv.RAPID, point, angles)
            if number == 87:
                wait = [(DWELL, pause, 1.0)] if pause else []
                inward = [(ASIDE, start_height, 1.0), (RAPID, safe, 1.0), (BACK, safe, 1.0), (FEED, depth, 1.0), *wait]
                self.control.steps([*inward, (ASIDE, depth, 1.0), (RAPID, initial, 1.0), (BACK, initial, 1.0)], aside)
                continue
            if abs(self.state.here()[across] / self.state.unit - safe) > 1e-12:
                self.control.height(safe)
            self.control.drill(cycle)

    def no_feed(self) -> None:
        raise WordError("the feed is 0; give F a number above 0", 1)
