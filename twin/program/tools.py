"""Which tool is in the spindle and which length TRAORI works with: the words T, D, H, M6, G43 and G49."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program.collect import Collector
from twin.program.words import Word, WordError


class Tools:
    """Tool changes of a program; lengths are those of the table [tool] of the machine file.

    T changes the tool at once; from the first M6 on it prepares the tool that the next M6 brings. The Sinumerik takes
    D1 with a tool and no length with D0; the ISO dialect takes a length with G43 and none with G49.
    """

    def __init__(self, out: Collector, machine: Machine, iso: bool, value: Callable[[Word], float]):
        self.out = out
        self.table: Mapping[str, Mapping[str, float]] = machine.document.get("tool", {})
        self.iso = iso
        self.value = value
        self.prepared = out.modes.spindle_tool_length  # of the tool that the next change brings
        self.changes_by_m6 = False

    def block(self, words: Mapping[str, Word]) -> None:
        """The words of one block: tool and length from here on.

        Raises:
            WordError: a tool or an edge that the machine file does not know, or H without G43.
        """
        modes = self.out.modes
        if "T" in words:
            self.prepared = self._length(words["T"])
        self.changes_by_m6 |= "M6" in words
        changed = "M6" in words or ("T" in words and not self.changes_by_m6)
        spindle = self.prepared if changed else modes.spindle_tool_length
        length = self._iso(words, spindle) if self.iso else self._sinumerik(words, spindle, changed)
        if (new := replace(modes, tool_length=length, spindle_tool_length=spindle)) != modes:
            self.out.change_frame(new)

    def _iso(self, words: Mapping[str, Word], spindle: float) -> float:
        if "D" in words:
            self.out.notes["D: a tool radius in .ngc files; understood, without effect on the motion"] = None
        if "G43" in words:
            self.out.notes["G43: its length counts under TRAORI; without it X Y Z are positions of the axes"] = None
            return self._length(words["H"]) if "H" in words else spindle
        if "G49" in words:
            return 0.0
        if "H" in words:
            raise WordError("H chooses a tool length together with G43; write G43 H.. in one block", words["H"].column)
        return self.out.modes.tool_length

    def _sinumerik(self, words: Mapping[str, Word], spindle: float, changed: bool) -> float:
        if "H" in words:
            self.out.notes["H: understood, without effect on the motion"] = None
        if "D" in words:
            return spindle if self._edge(words["D"]) else 0.0
        return spindle if changed else self.out.modes.tool_length

    def _length(self, word: Word) -> float:
        """Length [m] of the tool that T or H names; T0 and H0 have none."""
        text = (word.text or "").strip()
        name = text.strip('"') if text.startswith('"') else f"{self.value(word):.10g}"
        if name == "0":
            return 0.0
        if not self.table:
            self.out.notes["T, H: the machine file has no table [tool]; the tool of the model is used"] = None
            return self.out.kinematics.tool_length
        key = name if name in self.table else f"T{name}"
        if key not in self.table:
            raise WordError(f"tool {name} is not in the table [tool] of the machine file; {nearest(key, self.table)}", word.column)
        return float(self.table[key]["length_m"])

    def _edge(self, word: Word) -> float:
        """Number of the cutting edge that D names, 0 for none; a tool of the table has only D1."""
        number = self.value(word)
        if number not in (0, 1) and self.table:
            raise WordError(f"D{number:g}: a tool of the table [tool] has one length, that of D1; use D1 or D0", word.column)
        return number
