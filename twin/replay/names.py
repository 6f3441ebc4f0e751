"""Names in a recording: the timeline, and the entity paths that blueprint, tests and users rely on."""

import rerun as rr

TIMELINE = "time"
"""The timeline: seconds since the start of the run."""
APPLICATION = "twin_replay"
SUMMARY = "/summary"
EVENTS = "/events"
LEGEND = "/legend"
STATES = "/states"
KEY = "/key"
CONTOUR_ERROR = "/contour_error"
STEPS = "/steps"


def entity(parent: str, *parts: str) -> str:
    """Path of an entity below another; reserved characters are escaped."""
    return "/".join([parent.rstrip("/"), *(rr.escape_entity_path_part(part) for part in parts)])


def axis_entity(axis: str, *parts: str) -> str:
    """Path of a curve of one axis: /axes/X/following_error/simulated."""
    return entity("/axes", axis, *parts)
