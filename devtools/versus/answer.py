"""What a method answers, and its marks against what is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import inspect
import io
import time
import tokenize
from typing import Any

import numpy as np

from twin.control.actuator import EFFORTS
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import LOADS
from twin.simulation.gap import gap_of, predict
from twin.simulation.gap_level import levels, overall

from .inputs import Input, Known
from .numbers import numbers_of

REALISATIONS = 2
"""Simulations of each run left out, with noise in the loop."""

Load = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Force [N, Nm] that the drive has to give beyond the machine's own law, of position, speed and acceleration (sample,)."""


@dataclass(frozen=True)
class Answer:
    """The machine that a method found; numbers with their claimed 95 % interval (None: none claimed); causes, None if it names none; what it says."""

    machine: Machine
    intervals: Mapping[str, tuple[float, float, float] | None]
    says: str
    causes: tuple[str, ...] | None = None
    load: Load | None = None
    cpu_s: float = 0.0
    lines: int = 0
    verdict: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)


def timed(method: Callable[[Input], Answer], one: Input) -> Answer:
    """The answer with the processor time of all threads, and the lines of the method that a user would write."""
    begin = time.process_time()
    answer = method(one)
    return replace(answer, cpu_s=time.process_time() - begin, lines=lines_of(method))


def lines_of(function: Callable[..., Any]) -> int:
    """Lines of code of the functions marked as what a user writes (`written_by_user`): without comments, docstrings and blank lines."""
    return sum(code_lines(inspect.getsource(part)) for part in getattr(function, "written_by_user", (function,)))


def code_lines(source: str) -> int:
    """Lines of a source that hold code: no comment, docstring or blank line."""
    at: set[int] = set()
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER, tokenize.ENCODING)
    first = True
    for token in tokenize.generate_tokens(io.StringIO(inspect.cleandoc(source) + "\n").readline):
        if token.type in skipped:
            first = first or token.type == tokenize.NEWLINE
            continue
        if not (first and token.type == tokenize.STRING):
            at |= set(range(token.start[0], token.end[0] + 1))
        first = False
    return len(at)


def gap_on(answer: Answer, known: Known) -> dict[str, float]:
    """Gap on the runs left out: RMS of position [um, arcsec] and effort [A, V, Nm], those that are compared, and the level in times noise, which is that
    of the machine file given to all methods."""
    found, gaps = answer.machine, {}
    machine = Machine({**found.document, "measurement": known.machine.document["measurement"]}, found.model_path, found.path)
    for run in known.held_out:
        seen = run if answer.load is None else with_load(run, machine, answer.load)
        # a stiff loop that shakes with its encoder would lower its own gap in times noise
        scatter = predict(known.machine, run, realisations=REALISATIONS).scatter
        gaps[run.name] = gap_of(machine, run, replace(predict(machine, seen, realisations=REALISATIONS), scatter=scatter))
    signals = [signal for axes in gaps.values() for one in axes.values() for signal in one.items()]

    position = "position" if any(name == "position" for name, _ in signals) else "motor_position"
    names = {"position": (position,), "effort": tuple(EFFORTS)}
    squares = {what: [gap.rms**2 for name, gap in signals if name in some] for what, some in names.items()}
    rms = {what: float(np.sqrt(np.mean(some))) for what, some in squares.items() if some}
    return {**rms, "times_noise": overall(levels(gaps))}


def with_load(run: MeasuredRun, machine: Machine, load: Load) -> MeasuredRun:
    """The run with a force law as a known outside load, evaluated along the motion that the machine makes without it."""
    (axis,) = machine.axes
    q = predict(machine, run, realisations=1).trace.get(axis.name, "position")
    v = np.gradient(q, run.trace.period)
    force = -load(q, v, np.gradient(v, run.trace.period))
    unit = "N" if axis.kind == "linear" else "Nm"
    return replace(run, trace=replace(run.trace, signals={**run.trace.signals, (axis.name, LOADS[unit]): force}))


def marked(answer: Answer, known: Known) -> dict[str, Any]:
    """The row of a method: gap after, error of each number, whether its interval contains the truth, causes, processor time, lines."""
    found = numbers_of(answer.machine)
    rows = {}
    for name, true in known.numbers.items():
        claimed = answer.intervals.get(name)
        if name not in answer.intervals:
            continue
        value = claimed[0] if claimed else found[name]
        size = max(abs(true), known.numbers["coulomb_friction"] if name == "constant_force" else 0.0)
        rows[name] = {
            "value": value,
            "true": true,
            "error": abs(value - true) / size,
            "low": claimed[1] if claimed else None,
            "high": claimed[2] if claimed else None,
            "holds": bool(claimed[1] <= true <= claimed[2]) if claimed else None,
        }
    return {
        "gap": gap_on(answer, known),
        "numbers": rows,
        "causes": list(answer.causes or ()),
        "verdict": answer.verdict,
        "right": None if None in (known.causes, answer.causes) else right(answer, known),
        "says": answer.says,
        "cpu_s": round(answer.cpu_s, 2),
        "lines": answer.lines,
        **answer.extra,
    }


def right(answer: Answer, known: Known) -> bool:
    """Is what the method names what is there? Nothing for a healthy machine; "unknown" or a law for an effect outside the library."""
    if known.outside:
        return answer.verdict in ("unknown", "law")
    return set(answer.causes or ()) == set(known.causes or ())
