"""Columns that belong to one axis, by their names: 'X1_ActualPosition', 'pos (5)', 'target_q_0', 'DES_POS|3', 'axis2.speed'."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import re

_AXIS = (
    re.compile(r"[(\[|]\s*(?:u\d+\s*,\s*)?(\d{1,2})\s*[)\]]?\s*$"),  # pos (5), tau[3], DES_POS|12
    re.compile(r"^([XYZABCUVWS]\d?)[_. ]", re.IGNORECASE),  # X1_ActualPosition
    re.compile(r"[_. ]([XYZABCUVW]\d?)$", re.IGNORECASE),  # speed_X
    re.compile(r"(?:axis|achse|axe|joint|drive|antrieb|ax|j)[_. ]?(\d{1,2})(?=[_. ]|$)", re.IGNORECASE),  # axis2.speed
    re.compile(r"[_.](\d{1,2})$"),  # target_q_0
)


def label_of(name: str) -> str:
    """Name of the axis in the name of a column; "" if there is none."""
    for pattern in _AXIS:
        if (found := pattern.search(name.strip())) is not None:
            return found[1].upper()
    return ""


def groups(names: Sequence[str], known: Mapping[str, str]) -> dict[str, list[str]]:
    """Axis -> columns. `known`: axis of the columns whose names are understood; the others join by their label, or the only axis there is.

    Columns that belong to no axis are under "".
    """
    axes = dict.fromkeys(known.values())
    out: dict[str, list[str]] = {axis: [] for axis in axes}
    labels = {name: label_of(name) for name in names if name not in known}
    for name in names:
        axis = known.get(name) or labels[name]
        if axis not in out and axes and name not in known:
            axis = next(iter(axes)) if not labels[name] and len(axes) == 1 else ""
        out.setdefault(axis, []).append(name)
    return out
