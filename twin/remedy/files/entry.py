"""A datum to enter in a control."""

from typing import NamedTuple


class Entry(NamedTuple):
    """One datum to enter: name on the control, new value, old value (None: unknown), unit, grade of the source."""

    name: str
    value: float
    old: float | None
    unit: str
    grade: str

    @property
    def graded(self) -> str:
        """What a file says of a grade below A."""
        return "" if self.grade == "A" else f"grade {self.grade}: check before use"

    @property
    def was(self) -> str:
        """The old value in words."""
        return "old value unknown" if self.old is None else f"was {self.old:.9g}"
