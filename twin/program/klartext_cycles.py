"""Drilling cycles 200 to 209 of HEIDENHAIN Klartext as steps along the tool axis. Their parameters are Q parameters, which the definition sets."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import Control
from twin.program.cycles import ASIDE, BACK, DWELL, FEED, MOST_PECKS, RAPID, CycleError
from twin.program.klartext_lines import KlartextValues

CYCLES = {
    200: "drilling", 201: "reaming", 202: "boring, aside by 0.2 mm to Q214", 203: "universal drilling", 204: "back boring",
    205: "universal pecking", 206: "tapping with a compensating chuck", 207: "rigid tapping", 208: "bore milling on a helix",
    209: "tapping with chip breaking",
}  # fmt: skip
NEEDS = {
    200: "200 201 206 202 203", 201: "200 201 206 203", 202: "200 201 206 203", 203: "200 201 206 202 203", 204: "200 249 250 251 252 253 254 203",
    205: "200 201 206 202 203", 206: "200 201 206 203", 207: "200 201 239 203", 208: "200 201 206 334 203 335", 209: "200 201 239 203 257 256",
}  # fmt: skip
"""Parameters that a cycle cannot do without."""
ADVANCED_STOP = 0.2
"""Distance above the last depth at which feed begins again in cycle 200, and the step off the wall in cycle 202 [mm]."""
DIRECTIONS = {0: (0.0, 0.0), 1: (-1.0, 0.0), 2: (0.0, -1.0), 3: (1.0, 0.0), 4: (0.0, 1.0)}
Steps = list[tuple[str, float, float]]


class KlartextCycles:
    """The cycle that a call carries out; `number` is that of the last definition."""

    def __init__(self, control: Control, values: KlartextValues) -> None:
        self.control, self.state, self.values = control, control.state, values
        self.number: int | None = None
        self.modal = False  # M89

    def q(self, number: int, default: float | None = 0.0) -> float:
        """A parameter of the cycle."""
        return self.values.parameter(f"Q{number}", 1, default)

    def define(self, number: int) -> None:
        """Make a cycle the one to call."""
        missing = [f"Q{n}" for n in NEEDS[number].split() if math.isnan(self.q(int(n), math.nan))]
        if missing:
            raise CycleError(f"cycle {number} needs {' '.join(missing)}; add them")
        self.number = number

    def call(self) -> None:
        """Carry out the cycle at this place."""
        if self.number is None:
            raise CycleError("no cycle is defined that a call could carry out; add CYCL DEF before")
        q, number, state = self.q, self.number, self.state
        surface, clearance = q(203), q(200)
        safe, out = surface + clearance, surface + max(clearance, q(204))
        if number != 204 and not q(201) < 0.0:
            raise CycleError(f"cycle {number}: the depth Q201={q(201):g} must be below 0, as the control is set when delivered; correct it")
        bottom = surface + q(201)
        feed, mode = q(206), 94
        if number in (207, 209):
            feed = abs(q(239)) * state.out.modes.spindle * state.unit / state.out.modes.feed_unit
        elif number == 204:
            feed = q(254)
        if not feed > 0.0:
            raise CycleError(
                f"cycle {number} needs a feed above 0" + (": a pitch Q239 and a spindle speed S" if number in (207, 209) else "")
            )
        before, mode_before = state.feed, state.out.modes.feed_mode
        state.set_feed_mode(mode)
        state.feed = feed
        height = float(state.here()[arcs.PLANES[state.plane][2]]) / state.unit
        if abs(height - safe) > 1e-9:
            self.control.height(safe)
        make: Callable[[float, float], None] | None = {204: self._back_boring, 208: self._bore_milling}.get(number)
        if make is not None:
            make(safe, bottom)
        else:
            self.control.steps(self._steps(number, surface, safe, bottom), self._aside(ADVANCED_STOP * 1e-3 / state.unit))
        if out > safe + 1e-9:
            self.control.height(out)
        state.set_feed_mode(mode_before)
        state.feed = before

    def _aside(self, way: float) -> tuple[float, float]:
        u, v = DIRECTIONS.get(int(self.q(214)), (math.nan, math.nan)) if self.number in (202, 204) else (0.0, 0.0)
        if math.isnan(u):
            raise CycleError(f"Q214={self.q(214):g} is no direction; give 0 to 4")
        return u * way, v * way

    def _steps(self, number: int, surface: float, safe: float, bottom: float) -> Steps:
        """Steps from `safe` to `bottom` and back to `safe`."""
        q = self.q
        pause: Steps = [(DWELL, q(211), 1.0)] if q(211) > 0.0 else []
        out_share = q(208) / q(206) if q(208) > 0.0 and number in (201, 202, 203) else 1.0
        if number in (201, 206):
            return [(FEED, bottom, 1.0), *pause, (FEED, safe, out_share)]
        if number == 202:
            leave: Steps = [(ASIDE, bottom, 1.0)] if self._aside(1.0) != (0.0, 0.0) else []
            return [(FEED, bottom, 1.0), *pause, *leave, (FEED, safe, out_share), *([(BACK, safe, 1.0)] if leave else [])]
        if number == 207 or (number == 209 and not q(257) > 0.0):
            return [(FEED, bottom, 1.0), (FEED, safe, 1.0)]
        if number == 209:
            back = abs(q(256)) * abs(q(239))
            steps: Steps = []
            for level in self._levels(surface, bottom, abs(q(257))):
                steps += [(FEED, level, 1.0), (FEED, level + back if back and level > bottom else safe, abs(q(403, 1.0)) or 1.0)]
            return steps
        levels = self._levels(surface, bottom, q(202), q(212) if number in (203, 205) else 0.0, q(205) if number in (203, 205) else 0.0)
        unit = 1e-3 / self.state.unit
        first, last = (ADVANCED_STOP * unit,) * 2 if number != 205 else (q(258, ADVANCED_STOP * unit), q(259, ADVANCED_STOP * unit))
        if number == 205 and q(379):
            raise CycleError("cycle 205 with a deepened start Q379 is not supported; set Q379=0")
        breaks, out, at = int(q(213)) if number == 203 else 0, [], surface
        leave_at_feed = number == 203 and q(208) > 0.0
        for k, level in enumerate(levels):
            if k and breaks and k % (breaks + 1):
                out += [(FEED if leave_at_feed else RAPID, at + q(256, ADVANCED_STOP * unit), out_share)]
            elif k:
                share = (k - 1) / max(1, len(levels) - 2)
                out += [(FEED if leave_at_feed else RAPID, safe, out_share)]
                out += [(DWELL, q(210), 1.0)] if number != 205 and q(210) > 0.0 else []
                out += [(RAPID, at + first + share * (last - first), 1.0)]
            if number == 205 and q(257) > 0.0:
                for part in self._levels(at, level, q(257))[:-1]:
                    out += [(FEED, part, 1.0), (RAPID, part + q(256, ADVANCED_STOP * unit), 1.0)]
            out += [(FEED, level, 1.0)]
            at = level
        return [*out, *pause, (FEED if leave_at_feed else RAPID, safe, out_share)]

    @staticmethod
    def _levels(top: float, bottom: float, step: float, less: float = 0.0, least: float = 0.0) -> list[float]:
        """Heights of the infeeds, the last is the bottom; each step is `less` smaller than the one before, not below `least`."""
        levels, at = [], top
        step = step if step > 0.0 else top - bottom
        while at - step > bottom + 1e-9:
            at -= step
            levels.append(at)
            step = max(step - less, least if least > 0.0 else (step if less <= 0.0 else 1e-3 * step))
            if len(levels) > MOST_PECKS:
                raise CycleError(f"more than {MOST_PECKS} infeeds in one hole; give a larger step")
        return [*levels, bottom]

    def _back_boring(self, safe: float, _: float) -> None:
        """Cycle 204: aside through the hole, back to its axis, upwards at feed to the depth Q249, down, aside and out."""
        q = self.q
        edge = q(203) - q(250) - q(200) - q(252)  # of the tip, with the edge one clearance below the lower side of the part
        depth = q(203) - q(250) + q(249) - q(252)
        aside = self._aside(q(251))
        if aside == (0.0, 0.0) or not q(253) > 0.0:
            raise CycleError("cycle 204 needs the direction Q214 (1 to 4), the distance Q251 and the feed Q253; correct them")
        to = q(253) / q(254)
        pause: Steps = [(DWELL, q(255), 1.0)] if q(255) > 0.0 else []
        self.control.steps([(ASIDE, safe, 1.0), (FEED, edge, to), (BACK, edge, 1.0), (FEED, depth, 1.0), *pause, (FEED, edge, to)], aside)
        self.control.steps([(ASIDE, edge, 1.0), (FEED, safe, to), (BACK, safe, 1.0)], aside)

    def _bore_milling(self, safe: float, bottom: float) -> None:
        """Cycle 208: half a circle to the wall, a helix of Q334 a turn, one full turn at the bottom, half a circle back, out."""
        state, q, control = self.state, self.q, self.control
        radius = 0.5 * q(335) * state.unit - state.tools.radius(state.tools.name, 1)
        if not radius > 0.0 or not q(334) > 0.0:
            raise CycleError("cycle 208: the bore Q335 must be larger than the tool, and the infeed Q334 above 0; correct them")
        if q(342):
            raise CycleError("cycle 208 with a roughed bore Q342 is not supported; set Q342=0")
        state.note("cycle 208: the tool goes to the wall and back on half circles at the heights where the helix begins and ends")
        a, b, c = arcs.PLANES[state.plane]
        centre, nothing, down = state.here(), [math.nan, math.nan], q(351, 1.0) < 0.0
        turns = max(1, math.ceil((safe - bottom) / q(334) - 1e-9))

        def arc(to: float, height: float, middle: float, more: int) -> None:
            point, about = centre.copy(), centre.copy()
            point[a], point[c], about[a] = centre[a] + to, height * state.unit, centre[a] + middle
            control.go(mv.ARC, point, nothing, arc=(np.asarray(about), down, more))

        arc(radius, safe, 0.5 * radius, 0)
        arc(radius, bottom, 0.0, turns - 1)
        arc(radius, bottom, 0.0, 0)
        arc(0.0, bottom, 0.5 * radius, 0)
        control.height(safe)
