"""The active tool: tool in the spindle, length for TRAORI and radius for G41, from T, D, H, M6, G43 and G49."""

from collections.abc import Mapping

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program.build import Collector
from twin.program.expressions import Value, WordError, as_text, needed


class Tools:
    """Tool changes of a program; lengths and radii are those of the table [tool] of the machine file.

    T changes the tool at once; from the first M6 on it selects the tool for the next M6. The Sinumerik uses D1 with a tool, and no length
    with D0; the ISO dialect uses a length with G43 and none with G49.
    """

    def __init__(self, out: Collector, machine: Machine, iso: bool) -> None:
        self.out = out
        self.table: Mapping[str, Mapping[str, float]] = machine.document.get("tool", {})
        self.iso = iso
        self.prepared = out.modes.spindle_tool_length  # of the tool that the next change brings
        self.prepared_name = self.name = ""
        self.changes_by_m6 = False
        self.modal_h = False  # a later H alone chooses another length while G43 is in force (Fanuc)
        self.length_on = False
        self.written: dict[tuple[str, str, bool], float] = {}  # by the program itself [m]: tool, radius or length, whether it is wear

    def block(self, words: Mapping[str, tuple[Value, int]], change: bool, on: bool = False, off: bool = False) -> None:
        """The words T, D, H of one block as value and column, and whether it has M6, G43 and G49; they set the active tool and length.

        Raises:
            WordError: a tool or an edge that the machine file does not know, or H without G43.
        """
        if not (words or change or on or off):
            return
        modes, length = self.out.modes, self.out.modes.tool_length
        if "T" in words:
            self.prepared, self.prepared_name = self._length(words["T"]), as_text(words["T"][0])
        self.changes_by_m6 |= change
        changed = change or ("T" in words and not self.changes_by_m6)
        spindle = self.prepared if changed else modes.spindle_tool_length
        if changed:
            self.name = self.prepared_name
        if self.iso:
            length = self._iso(words, spindle, on, off)
        elif "D" in words:
            edge, column = words["D"]
            if not isinstance(edge, float) or (edge not in (0, 1) and self.table):
                raise WordError(f"D{as_text(edge)}: a tool of the table [tool] has one length, that of D1; use D1 or D0", column)
            length = spindle if edge else 0.0
        elif changed:
            length = spindle
        if "H" in words and not self.iso:
            self.out.notes["H: understood, no effect on the motion"] = None
        self.out.change_frame(tool_length=length, spindle_tool_length=spindle)

    def radius(self, name: str, column: int) -> float:
        """Radius [m] of a tool with its wear, from the program ($TC_DP6, G10, #13001) or the machine file."""
        give = f"which G41 and G42 need; give [tool.T{name or 1}] radius_m in the machine file"
        radius = needed(self.value(name, "radius"), f"the radius of tool {name or '?'} is not known, {give}", column)
        return radius + (self.value(name, "radius", wear=True) or 0.0)

    def value(self, name: str, what: str, *, wear: bool = False) -> float | None:
        """The `radius` or `length` [m] of a tool, or its wear; None if neither the program nor the machine file gives it."""
        if (name, what, wear) in self.written or wear:
            return self.written.get((name, what, wear))
        entry = next((self.table[k] for k in (name, f"T{name}") if k in self.table), {})
        return float(entry[f"{what}_m"]) if f"{what}_m" in entry else None

    def set_value(self, name: str, what: str, value: float, *, wear: bool = False) -> None:
        """A `radius` or `length` [m], or its wear, that the program writes."""
        self.written[name, what, wear] = value

    def _iso(self, words: Mapping[str, tuple[Value, int]], spindle: float, on: bool, off: bool) -> float:
        if on:
            self.out.notes["G43: its length is used under TRAORI or G43.4; without it X Y Z are positions of the axes"] = None
            self.length_on = self.modal_h
            return self._length(words["H"]) if "H" in words else spindle
        if off:
            self.length_on = False
            return 0.0
        if "H" in words and self.length_on:
            return self._length(words["H"])
        if "H" in words:
            raise WordError("H chooses a tool length together with G43; write G43 H.. in one block", words["H"][1])
        return self.out.modes.tool_length

    def _length(self, word: tuple[Value, int]) -> float:
        """Length [m] of the tool that T or H names; T0 and H0 have none."""
        name, column = as_text(word[0]), word[1]
        if name == "0":
            return 0.0
        if (length := self.value(name, "length")) is None and self.table:
            raise WordError(f"tool {name} is not in the table [tool] of the machine file; {nearest(f'T{name}', self.table)}", column)
        if length is None:
            self.out.notes["T, H: the machine file has no table [tool]; the tool of the model is used"] = None
            length = self.out.kinematics.tool_length
        return length + (self.value(name, "length", wear=True) or 0.0)
