"""Modes set by the words of a SINUMERIK block: G and M codes, names of modes, feeds and tolerances, cycles by MCALL."""

from __future__ import annotations

from dataclasses import replace

from twin.program.collect import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE
from twin.program.expressions import WordError
from twin.program.frames import ROTARY
from twin.program.sinumerik_calls import SinumerikCalls
from twin.program.sinumerik_cycles import SinumerikCycles
from twin.program.source import plain_name
from twin.program.state import INCH, Item
from twin.program.tables import NOTE, REFUSED, SINUMERIK_NAMES
from twin.program.words import Word, split_arguments
from twin.units import rad_from_deg

WITHOUT_VALUE = frozenset(
    [
        "TRAFOOF",
        "ORIWKS",
        "ORIVECT",
        "ORIPLANE",
        "ORIMKS",
        "ORIAXES",
        "ORIEULER",
        "ORIRPY",
        "ORIVIRT1",
        "ORIRPY2",
        "FFWON",
        "FFWOF",
        "SOFT",
        "BRISK",
    ]
)
"""Names of modes, which take no value."""


class SinumerikModes:
    """Modes and calls of one block."""

    def __init__(self, calls: SinumerikCalls, cycles: SinumerikCycles) -> None:
        self.calls, self.cycles, self.values, self.moves, self.flow = calls, cycles, calls.values, calls.moves, calls.flow
        self.state, self.corners, self.control, self.frames = calls.state, calls.corners, calls.corners.control, calls.values.frames

    def settings(self, extra: dict[str, Item], numbers: set[float]) -> None:
        """F, S and the tolerances of the block."""
        for number in (93, 94, 95):
            if number in numbers:
                self.state.set_feed_mode(number)
        for number in (70, 71, 700, 710):
            if number in numbers:
                self.state.set_unit(INCH if number in (70, 700) else 1e-3, feed=number in (700, 710))
        if "F" in extra:
            item = extra.pop("F")
            self.state.set_feed(item.value, item.column)
        if "OVR" in extra:
            self.state.override = extra.pop("OVR").value / 100.0
            if not 0.0 < self.state.override <= 2.0:
                raise WordError(f"OVR={100 * self.state.override:g} is out of range; give 1 to 200 percent", 1)
        if "S" in extra:
            self.state.set_spindle(extra.pop("S").value)
        changed = False
        if "CTOL" in extra:
            value = extra.pop("CTOL").value
            self.state.tolerance = value * self.state.unit if value > 0 else DEFAULT_TOLERANCE
            changed = True
        if "OTOL" in extra:
            value = extra.pop("OTOL").value
            self.state.angle_tolerance = rad_from_deg(value) if value > 0 else DEFAULT_ANGLE_TOLERANCE
            changed = True
        for name in ("ADIS", "ADISPOS"):
            if name in extra:
                setattr(self.state, name.lower(), max(0.0, extra.pop(name).value) * self.state.unit)
                changed = True
        if changed:
            self.state.round_corners()

    def g_code(self, number: float, word: Word) -> None:
        out = self.state.out
        if number in (0, 1, 2, 3):
            self.state.motion = int(number)
        elif number in (17, 18, 19):
            if self.state.comp is not None and self.state.plane != number:
                raise WordError("the plane changes inside G41 or G42; write G40 before", word.column)
            self.corners.release()
            self.state.plane = int(number)
        elif number in (90, 91):
            self.state.absolute = number == 90
            self.state.settle_plain()
        elif number in (60, 64, 641, 642, 643, 644, 645, 646):
            self.state.rounding = int(number) if number in (60, 64, 641) else 642
            self.state.round_corners()
        elif number in (601, 602, 603):
            out.set_modes(replace(out.modes, stop_window=f"G{int(number)}"))
        elif number in (40, 41, 42):
            self.compensation(int(number), word)
        elif number in (450, 451):
            self.moves.corners_meet = number == 451
        elif number == 500 or 54 <= number <= 57 or 505 <= number <= 599:
            self.frames.choose(f"G{int(number)}")

    def compensation(self, number: int, word: Word) -> None:
        self.corners.release()
        if number == 40:
            self.control.compensate(0, 0.0)
            return
        radius = self.state.tools.radius(self.state.tools.name, word.column)
        self.control.compensate(1 if number == 41 else -1, radius, along_next=True, corners_meet=self.moves.corners_meet)

    def name(self, word: Word, calls: list[Word], cycle: Word | None) -> None:
        """Words without a number: transformation, feedforward, acceleration, messages, cycles."""
        name, out = word.name, self.state.out
        kind, meaning, *_ = SINUMERIK_NAMES[name]
        given = (word.text or "").strip()
        if kind == REFUSED:
            raise WordError(f"{name} is not supported: {meaning}", word.column)
        if kind == NOTE:
            self.state.note(f"{name}: {meaning}")
        elif name in WITHOUT_VALUE and given:
            raise WordError(f"{name} takes no value; remove '{given[:20]}'", word.column)
        elif name in ("TRAORI", "TRAFOOF"):
            if given:
                self.state.note("TRAORI: its number is ignored; the transformation is that of the model")
            self.corners.release()
            self.state.untilt()
            self.state.transform(name == "TRAORI")
        elif name in ("ORIWKS", "ORIVECT", "ORIPLANE", "ORIMKS", "ORIAXES"):
            out.set_modes(replace(out.modes, workpiece_orientation=name not in ("ORIMKS", "ORIAXES")))
        elif name in ("ORIEULER", "ORIRPY", "ORIVIRT1", "ORIRPY2"):
            self.moves.angles_are_rpy = {"ORIRPY": True, "ORIEULER": False}.get(name)
        elif name in ("FFWON", "FFWOF"):
            if out.feedforward is None:
                out.feedforward = "velocity+torque" if name == "FFWON" else "off"
            out.set_modes(replace(out.modes, feedforward=name == "FFWON"))
        elif name == "FGROUP":
            axes = {self.state.slot_of.get(t, t) for t, _ in split_arguments(word.text or "")} - {""}
            out.set_modes(replace(out.modes, feed_of_all=bool(axes & set(ROTARY))))
            self.state.note("FGROUP: F counts X Y Z alone, or with A or C all axes, a degree as a mm (FGREF as delivered)")
        elif name in ("SOFT", "BRISK"):
            out.set_modes(replace(out.modes, brisk=name == "BRISK"))
        elif name == "MSG":
            text = (word.text or "").strip()
            out.messages.append(text.strip('"') if text.count('"') <= 2 else text)
        elif name == "MCALL":
            self.corners.release()
            self._modal(calls, cycle)
        elif name in ("CALL", "PCALL", "EXTCALL"):
            text = (word.text or "").strip()
            if not text and calls:
                if isinstance(held := (self.values.store_of(calls[0].name) or {}).get(()), str):
                    calls[0] = Word(plain_name(held), word.column)
                return
            calls.append(Word(plain_name(str(self.values.value_of(text, word.text_column))), word.column))
        elif name in ("RET", "ENDPROC"):
            self.corners.release()
        elif meaning == SINUMERIK_NAMES["OFFN"][1]:
            if self.values.value(word):
                raise WordError(f"{name}={self.values.value(word):g} is not supported: {meaning}", word.column)
            self.state.note(f"{name}: {meaning}")
        elif name.startswith(("CYCLE", "HOLES")):
            self.corners.release()
            self.cycles.carry_out(word)
        else:
            raise WordError(f"{name} needs a value, e.g. {name}=1", word.column)

    def _modal(self, calls: list[Word], cycle: Word | None) -> None:
        """MCALL: a cycle or subprogram after each block with motion; without arguments it ends."""
        if cycle is not None:
            self.cycles.modal = self.cycles.drilling(cycle.name, self.cycles.values_of(cycle), cycle)
            return
        if not calls:
            self.cycles.modal = None
            return
        word = calls.pop(0)
        unit = self.calls.find(word.name if word.name != "L" else f"L{word.value:g}")
        if unit is None:
            raise WordError(f"MCALL: there is no cycle or subprogram '{word.name}'; add {word.name}.SPF", word.column)
        variables, first = self.calls.arguments(unit, [(t, c + word.text_column) for t, c in split_arguments(word.text or "")], word)

        def call() -> None:
            if frame := self.flow.call(unit, first, name=unit.name, column=word.column):
                frame.variables = {k: dict(v) for k, v in variables.items()}

        self.cycles.modal = call
