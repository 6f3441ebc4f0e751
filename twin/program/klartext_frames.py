"""The frames of HEIDENHAIN Klartext: preset (247), datum shift (7, TRANS DATUM), mirror (8), rotation (10), scale (11, 26), tilted plane (19, PLANE).

Program coordinates x become those of the machine by

    preset + shift + T (shift within the plane + M R S x)        T tilt, M mirror, R rotation, S scale

A shift that is changed to something else while M, R or S is in force is refused: whether it is turned by them depends on the control.
"""

from __future__ import annotations

import math
import re

import numpy as np

from twin.program import arcs
from twin.program.expressions import WordError
from twin.program.klartext_lines import VALUE, KlartextValues
from twin.program.orientation import choose_angles
from twin.program.state import INDEX, LINEAR, ROTARY, State, rotation

_AXIS = re.compile(rf"\s*(I?)([A-CXYZ])\s*({VALUE})", re.A)
_SPATIAL = re.compile(rf"\s*SP([ABC])\s*({VALUE})", re.A)


class KlartextFrames:
    """Frames and the words that change them."""

    def __init__(self, state: State, values: KlartextValues) -> None:
        self.state, self.values = state, values
        state.set_frames = self.set_frames
        self.preset, self.shift, self.inner_shift = np.zeros(5), np.zeros(5), np.zeros(5)
        self.mirror: set[str] = set()
        self.angles: dict[str, float] = {}  # of the tilt
        self.turn_to: list[float] | None = None  # A and C that the next move goes to (SEQ)
        self.angle, self.scale, self.scale_centre = 0.0, np.ones(3), np.zeros(3)

    def set_frames(self) -> None:
        """The frame in force, outermost first: preset, shift, tilt, shift within the plane, mirror, rotation, scale."""
        state = self.state
        matrix, offset = np.eye(3), self.preset + self.shift
        state.fixed_axis = None
        if state.swivelled is not None:
            matrix = state.swivelled[0]
            offset[:3] += state.to_part()
            state.fixed_axis = matrix[:, arcs.PLANES[state.plane][2]].copy()
        offset += np.concatenate([matrix @ self.inner_shift[:3], self.inner_shift[3:]])
        flat = np.diag([-1.0 if n in self.mirror else 1.0 for n in LINEAR]) @ rotation(arcs.PLANES[state.plane][2], self.angle)
        matrix = matrix @ flat
        offset[:3] += matrix @ (self.scale_centre - self.scale * self.scale_centre)
        state.set_frame(matrix @ np.diag(self.scale), offset)

    def value(self, text: str) -> float:
        return self.values.number_of(text, 1)

    def datum(self, text: str) -> None:
        """Axes of a datum shift, absolute or in addition (I)."""
        target = self.inner_shift if self.state.swivelled is not None else self.shift
        new, at = target.copy(), 0
        for match in _AXIS.finditer(text):
            name = self.state.slot_of.get(str(match[2]), str(match[2]))
            if text[at : match.start()].strip():
                break
            at = match.end()
            value = self.state.si(name, self.value(match[3]))
            if name not in INDEX:
                raise WordError(f"a datum shift of {match[2]} cannot be set on this machine", 1)
            new[INDEX[name]] = value + (target[INDEX[name]] if match[1] else 0.0)
        if text[at:].strip():
            raise WordError(
                f"'{text[at:].strip()[:20]}' is not read in a datum shift; write axes and values, a datum table is not simulated", 1
            )
        if np.any(new[:3] != target[:3]) and np.any(new[:3]) and (self.mirror or self.angle or np.any(self.scale != 1.0)):
            raise WordError("a datum shift while mirror, rotation or scale is in force is not simulated; write it before them", 1)
        if np.any(new[3:] != target[3:]):
            self.state.out.settle()
        target[:] = new
        self.set_frames()

    def cycle(self, number: int, parts: list[str], column: int) -> bool:
        """Cycles 7, 8, 10, 11, 19, 26 from the texts of their parts .1, .2 and so on; False for another."""
        text = " ".join(parts)
        if number == 7:
            self.datum(text)
        elif number == 8:
            self.mirror = set(text.split())
            if self.mirror - set(LINEAR):
                raise WordError("a mirror of rotary axes is not supported; let the CAM system output the final coordinates", column)
        elif number == 10:
            match = re.fullmatch(rf"(I?)ROT\s*({VALUE})", text)
            if not match:
                raise WordError("cycle 10 needs its angle, e.g. CYCL DEF 10.1 ROT+35", column)
            self.angle = self.value(match[2]) + (self.angle if match[1] else 0.0)
        elif number == 11:
            match = re.fullmatch(rf"SCL\s*({VALUE})", text)
            if not match or not self.value(match[1]) > 0.0:
                raise WordError("cycle 11 needs a factor above 0, e.g. CYCL DEF 11.1 SCL 0.5", column)
            self.scale, self.scale_centre = np.full(3, self.value(match[1])), np.zeros(3)
        elif number == 26:
            self.scale, self.scale_centre = np.ones(3), np.zeros(3)
            rest = re.sub(
                rf"\bCC([XYZ])\s*({VALUE})", lambda m: self._set(self.scale_centre, m[1], self.value(m[2]) * self.state.unit), text
            )
            rest = re.sub(rf"\b([XYZ])\s*({VALUE})", lambda m: self._set(self.scale, m[1], self.value(m[2])), rest)
            if rest.strip() or not np.all(self.scale > 0.0):
                raise WordError("cycle 26 needs axes with factors above 0, and CCX CCY as their centre", column)
        elif number == 19:
            if re.sub(rf"(?:F|ABST|DIST)\s*{VALUE}|[A-C]\s*{VALUE}", "", text).strip():
                raise WordError("cycle 19 takes A B C, F and ABST; correct it", column)
            given = {m[2]: self.value(m[3]) for m in _AXIS.finditer(text)}
            self.tilt({**self.angles, **given} if given else {}, column)  # an angle that is left out keeps its value
        else:
            return False
        self.set_frames()
        return True

    @staticmethod
    def _set(values: np.ndarray, axis: str, value: float) -> str:
        values[LINEAR.index(axis)] = value
        return ""

    def tilt(self, angles: dict[str, float], column: int, sequence: str = "") -> None:
        """A plane by its spatial angles A, B, C: turns about the fixed axes X, Y, Z, in this order; none or zeros end it."""
        state = self.state
        state.unswivel()
        self.inner_shift, self.angles = np.zeros(5), angles
        chosen, self.turn_to = np.zeros(2), None
        if any(angles.values()):
            if self.mirror or self.angle or np.any(self.scale != 1.0):
                raise WordError("a tilted plane while mirror, rotation or scale is in force is not simulated; reset them before", column)
            matrix = rotation(2, angles.get("C", 0.0)) @ rotation(1, angles.get("B", 0.0)) @ rotation(0, angles.get("A", 0.0))
            state.swivel(matrix, np.zeros(3))
            axis = matrix[:, arcs.PLANES[state.plane][2]]
            now = np.array(state.out.settle())
            chosen = choose_angles(state.out.kinematics, axis, now).angles[-1]
            if sequence:
                chosen = self._solution(axis, now, 1.0 if sequence == "+" else -1.0, chosen, column)
                self.turn_to = list(map(float, chosen))
            state.note("PLANE SPATIAL, cycle 19: A and C turn with the next move to the nearest solution, the tool tip keeps its place")
        for slot, angle in zip(ROTARY, chosen):
            letter = next((own for own, place in state.slot_of.items() if place == slot), slot)
            self.values.q[{"A": "Q120", "B": "Q121", "C": "Q122"}.get(letter, "Q120")] = math.degrees(float(angle))

    def _solution(self, axis: np.ndarray, now: np.ndarray, sign: float, chosen: np.ndarray, column: int) -> np.ndarray:
        """The solution (2,) of the rotary axes whose tilting axis has a sign (SEQ); the turning axis goes the shorter way."""
        pairs, _ = self.state.out.kinematics.angles(axis)
        for tilt, turn in pairs[:, 0]:
            if tilt * sign > 1e-9 and not math.isnan(turn):
                return np.array([tilt, now[1] + (turn - now[1] + math.pi) % (2.0 * math.pi) - math.pi])
        if abs(chosen[0]) > 1e-9:
            raise WordError("SEQ asks for a solution that the rotary axes of this machine do not have; remove it", column)
        return chosen

    def plane(self, text: str, column: int) -> None:
        """PLANE SPATIAL SPA SPB SPC and how it turns, or PLANE RESET; `text` follows the first word."""
        how = _SPATIAL.sub("", text)
        match = re.fullmatch(
            rf"\s*(STAY|TURN|MOVE)?(?:\s*(?:DIST|MB)\s*(?:MAX|{VALUE}))?(?:\s*F\s*(?:MAX|AUTO|{VALUE}))?\s*(?:SEQ([-+]))?\s*(?:COORD ROT|TABLE ROT)?\s*",
            how,
        )
        if match is None:
            raise WordError(f"'{how.strip()[:20]}' is not read in PLANE; write SPA SPB SPC, STAY, TURN or MOVE, SEQ", column)
        self.tilt({m[1]: self.value(m[2]) for m in _SPATIAL.finditer(text)}, column, match[2] or "")
