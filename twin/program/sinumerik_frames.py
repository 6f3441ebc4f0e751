"""The frames of SINUMERIK programs: settable (G54 to G599), programmable (TRANS, ROT, SCALE, MIRROR), tilted planes (CYCLE800)."""

from __future__ import annotations

import numpy as np

from twin.program import arcs
from twin.program.corners import Corners
from twin.program.expressions import WordError
from twin.program.state import INDEX, LINEAR, OTHER, ROTARY, Item, rotation
from twin.program.words import Word


class SinumerikFrames:
    """Frames and the words that change them."""

    def __init__(self, corners: Corners) -> None:
        self.corners, self.state = corners, corners.state
        self.state.set_frames = self.set_frames
        self.shifted: dict[int, float] = {}  # axis whose offset has changed -> its position then
        self.settable: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.chosen = "G500"
        self.basic = np.eye(3), np.zeros(5)
        self.program_matrix, self.program_offset, self.fine = np.eye(3), np.zeros(5), np.zeros(5)

    def settable_frame(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        if name not in self.settable:
            self.settable[name] = np.eye(3), self.state.frame_table(name)
        return self.settable[name]

    @staticmethod
    def frame_number(name: str) -> int:
        number = int(name[1:])
        return 0 if number == 500 else number - 53 if number < 60 else number - 500

    def set_frames(self) -> None:
        """Basic frame, settable frame, programmable frame, tilted plane: in this order."""
        matrix, offset = self.basic
        for inner, shift in (self.settable_frame(self.chosen), (self.program_matrix, self.program_offset + self.fine)):
            offset = np.concatenate([offset[:3] + matrix @ shift[:3], offset[3:] + shift[3:]])
            matrix = matrix @ inner
        self.state.fixed_axis = None
        if self.state.swivelled is not None:
            inner, origin, _ = self.state.swivelled
            offset = np.concatenate([offset[:3] + matrix @ origin + self.state.to_part(), offset[3:]])
            matrix = matrix @ inner
            self.state.fixed_axis = matrix[:, arcs.PLANES[self.state.plane][2]].copy()
        if self.state.out.kinds:
            self.shifted |= {i: self.state.out.position[i] for i in range(5) if abs(offset[i] - self.state.offset[i]) > 1e-12}
        self.state.set_frame(matrix, offset)

    def note_increments(self, coordinates: dict[str, Item]) -> None:
        """State the assumption where an axis goes on by an increment behind a change of its offset."""
        for name, (_, how, _) in coordinates.items():
            i = INDEX.get(name)
            if (
                i in self.shifted
                and (how == "IC" or (how == "" and not self.state.absolute))
                and self.shifted[i] == self.state.out.position[i]
            ):
                self.state.note(
                    "G91, IC() behind a change of the frame: the increment alone is moved, not the change (SD42440 0; with 1 the control adds it)"
                )

    def frame_words(self, word: Word | None, shift: int | None, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """TRANS, ROT, SCALE, MIRROR and their additions; G58, G59."""
        self.corners.release()
        values = {n: i.value for n, i in coordinates.items()}
        for name in OTHER:
            if values.pop(name, 0.0):
                raise WordError(f"a shift of {name} cannot be set on this machine", 1)
        name = word.name if word else ""
        if word is not None and word.text is not None and word.text.strip():
            raise WordError(f"{name} takes its axes as words, e.g. {name} X10", word.column)
        if word is not None and not name.startswith("A"):
            self.program_matrix, self.program_offset, self.fine = np.eye(3), np.zeros(5), np.zeros(5)
        shifted = np.zeros(5)
        inner = np.eye(3)
        if shift is not None:
            target = self.program_offset if shift == 58 else self.fine
            target = target.copy()
            for axis, value in values.items():
                target[INDEX[axis]] = self.state.si(axis, value)
            if shift == 58:
                self.program_offset = target
            else:
                self.fine = target
        elif name.endswith("TRANS"):
            for axis, value in values.items():
                shifted[INDEX[axis]] = self.state.si(axis, value)
        elif name in ("ROT", "AROT"):
            if "RPL" in extra:
                inner = rotation(arcs.PLANES[self.state.plane][2], extra.pop("RPL").value)
            else:
                inner = rotation(2, values.get("Z", 0.0)) @ rotation(1, values.get("Y", 0.0)) @ rotation(0, values.get("X", 0.0))
        elif name.endswith("SCALE"):
            if not all(values.values()):
                raise WordError(f"{name} by 0 leaves nothing; give factors other than 0", 1)
            inner = np.diag([values.get(n, 1.0) for n in LINEAR])
        elif name.endswith("MIRROR"):
            inner = np.diag([-1.0 if n in values else 1.0 for n in LINEAR])
        elif values:
            raise WordError(f"{name} is not supported: a turn by angles in space; use ROT with X Y Z", 1)
        if not name.endswith("TRANS") and shift is None and set(values) & set(ROTARY):
            raise WordError(f"{name} of A or C is not supported; let the CAM system output the final coordinates", 1)
        self.program_offset = np.concatenate(
            [self.program_offset[:3] + self.program_matrix @ shifted[:3], self.program_offset[3:] + shifted[3:]]
        )
        self.program_matrix = self.program_matrix @ inner
        self.state.set_frames()
