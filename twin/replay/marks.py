"""Events in the viewer: a clickable list, marks on the errors, and a lane per axis with limits and sticking."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from twin.control.actuator import EFFORTS
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.replay.curves import position_errors
from twin.replay.events import TELLING, WORST, Event
from twin.replay.names import CONTOUR_ERROR, EVENTS, STATES, TIMELINE, axis_entity, entity
from twin.report.colours import LIMIT_COLOUR, SETPOINT_COLOUR, Colour, axis_colour, mixed
from twin.units import AXIS_UNITS

MOST_MARKS = 60
"""Most marks of one kind on a curve; the list has all."""
_MARKS: dict[str, Any] = {
    **{f"{effort} limit": "cross" for effort in EFFORTS},
    "speed limit": "plus",
    "reversal": "diamond",
    "sticking": "circle",
    "block": "up",
    WORST: "asterisk",
    TELLING: "square",
}
_STATES = {
    "follows": mixed(SETPOINT_COLOUR, 0.65),
    "sticking": (240, 150, 10),
    **{f"{effort} limit": LIMIT_COLOUR for effort in EFFORTS},
    "speed limit": (176, 92, 220),
    TELLING: (235, 60, 150),
}


def log_events(
    recording: rr.RecordingStream, machine: Machine, trace: Trace, contour_error: np.ndarray | None, events: Sequence[Event]
) -> tuple[str, ...]:
    """Log the list of events, their marks in the plots, and a lane of states per axis. Returns the entities of the lanes.

    Events of an axis are marked on its errors with and without the delay, events of the program on the contour error (sample,) [m].
    """
    colour_of = {axis.name: axis_colour(axis.name, i) for i, axis in enumerate(machine.axes)}
    colours = [LIMIT_COLOUR if "limit" in e.kind else colour_of.get(e.axis, SETPOINT_COLOUR) for e in events]
    levels = ["WARN" if "limit" in e.kind else "INFO" for e in events]
    texts = rr.TextLog.columns(text=[f"{e.kind}: {e.text}" for e in events], level=levels, color=colours)
    recording.send_columns(EVENTS, [rr.TimeColumn(TIMELINE, duration=[e.start for e in events])], texts)
    lanes = []
    for axis in machine.axes:
        mine = [e for e in events if e.axis == axis.name]
        for group, error in position_errors(trace, axis).items():
            root, values = axis_entity(axis.name, group), error * AXIS_UNITS[axis.kind].error[1]
            _log_marks(recording, root, f"{axis.name} ", mine, trace.time, values, colour_of[axis.name])
        lasting = [e for e in mine if e.end > e.start]
        if lasting:
            lanes.append(_log_lane(recording, axis.name, trace, lasting))
    if contour_error is not None:
        _log_marks(recording, CONTOUR_ERROR, "", [e for e in events if not e.axis], trace.time, contour_error * 1e6, SETPOINT_COLOUR)
    return tuple(lanes)


def _log_marks(
    recording: rr.RecordingStream, root: str, whose: str, events: Sequence[Event], time: np.ndarray, values: np.ndarray, colour: Colour
) -> None:
    """Log a series of marks on a curve (sample,) for each kind of event."""
    for kind in dict.fromkeys(e.kind for e in events):
        if sum(e.kind == kind for e in events) > MOST_MARKS:
            continue
        times = np.unique([e.start for e in events if e.kind == kind])
        path = entity(root, f"event_{kind.replace(' ', '_')}")
        own = LIMIT_COLOUR if "limit" in kind or kind == WORST else colour
        style = rr.SeriesPoints(colors=[own], names=[f"{whose}{kind}"], markers=[_MARKS[kind]], marker_sizes=[4.0])
        recording.log(path, style, static=True)
        recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times)], rr.Scalars.columns(scalars=np.interp(times, time, values)))


def _log_lane(recording: rr.RecordingStream, axis: str, trace: Trace, events: Sequence[Event]) -> str:
    """Log the states of an axis between start and end of its events; returns the entity."""
    path = entity(STATES, axis)
    changes = {float(trace.time[0]): "follows"}
    for event in events:
        changes.setdefault(event.end, "follows")
        changes[event.start] = event.kind
    times = sorted(changes)
    states = list(_STATES)
    labels = [f"{axis} {state}" for state in states]
    recording.log(path, rr.StateConfiguration(values=states, labels=labels, colors=list(_STATES.values())), static=True)
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=times)], rr.StateChange.columns(state=[changes[t] for t in times]))
    return path
