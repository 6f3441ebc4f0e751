"""The line on the origin of a report."""

from __future__ import annotations

from datetime import datetime

import twin


def made_line(machine: str = "", inputs: str = "", seed: int | None = None) -> str:
    """'Made by twin 0.1.0 on 2026-01-31 14:05 with Mikron UCP 710; input: circle; seed 3.'"""
    with_machine = f" with {machine}" if machine else ""
    given = f"; input: {inputs}" if inputs else ""
    drawn = "" if seed is None else f"; seed {seed}"
    return f"Made by twin {twin.__version__} on {datetime.now():%Y-%m-%d %H:%M}{with_machine}{given}{drawn}."
