"""What the readers of all languages share: the control composed of its parts, plain blocks, subprograms beside the program, M codes."""

from __future__ import annotations

from collections.abc import Iterable
import math
from pathlib import Path
import re

from twin.machine.machine import Machine
from twin.program import moves as mv
from twin.program.collect import Collector
from twin.program.control import Control
from twin.program.corners import Corners
from twin.program.cycles import CycleError
from twin.program.expressions import WordError
from twin.program.flow import Flow
from twin.program.machine_file import moves_no_axis
from twin.program.source import Folder, Unit
from twin.program.state import State

NO_GROUP = "((?!))?"
ADD_CALL = "add it, or list it in [program] calls_without_motion of the machine file if it moves no axis"


class Reader:
    """One program under one control; a language adds its lines, values, words and calls."""

    plain_block: re.Pattern[str]
    """A block of coordinates alone; its groups: number, G0 or G1, x y z A C, the tool axis, F. `NO_GROUP` stands for a word that a language lacks."""

    def __init__(self, path: Path, machine: Machine, language: str, unit: Unit, frames: Iterable[str]) -> None:
        self.state = State(path, machine, language, frames)
        self.out: Collector = self.state.out
        self.control = Control(self.state)
        self.corners = Corners(self.control)
        self.flow = Flow(unit, self.state)
        self.folder = Folder(path)

    def run(self) -> None:
        """Read all blocks; `out` holds the moves."""
        self.flow.run()
        self.corners.release()
        self.control.compensate(0, 0.0)

    def words(self, text: str) -> None:
        """One block."""
        try:
            self.block(text)
        except CycleError as error:
            raise WordError(str(error), 1) from None

    def block(self, text: str) -> None:
        """Carry out the words of one block."""
        raise NotImplementedError

    def plain_now(self) -> bool:
        """Whether no mode of the language acts on a block of coordinates alone."""
        raise NotImplementedError

    def feed_word(self, value: float) -> float:
        """The feed of an F word."""
        return value

    def fast(self, text: str, line: int) -> bool:
        """Execute a block of coordinates alone; False if it must be read word by word."""
        state, out, corners = self.state, self.out, self.corners
        if not state.plain or corners.held is not None or not self.plain_now():
            return False
        match = self.plain_block.match(text)
        if not match:
            return False
        number, g, x, y, z, a, c, i, j, k, f = match.groups()
        motion = state.motion if g is None else int(g)
        if motion not in (0, 1) or (i is not None and not out.modes.traori):
            return False
        if f == "MAX":
            motion = 0
        elif f is not None:
            state.line = line
            state.set_feed(self.feed_word(float(f)))
        if g is not None:
            state.motion = motion
        if x is y is z is a is c is i is None:
            return True
        state.line, state.block = line, int(number) if number else -1
        kind = mv.LINE if motion else mv.RAPID
        if motion and not state.feed > 0.0:
            self.control.feed_given(state.feed)
        position = out.position
        corners.last = None
        tilt, turn = state.plain_place(x, y, z, a, c)
        tool_axis = None
        if i is not None:
            tool_axis = float(i), float(j), float(k)
            position[3] = position[4] = math.nan
        feed = state.feed if motion else math.inf
        out.add(kind, (position[0], position[1], position[2], tilt, turn), tool_axis, feed, line, state.block)
        return True

    def moves_nothing(self, *names: str) -> bool:
        """Whether the machine file lists a call, by one of its names, as one without motion; it is noted."""
        still = moves_no_axis(self.state.machine, names)
        if still:
            self.state.note(f"{names[0]}: the machine file lists it as moving no axis")
        return still
