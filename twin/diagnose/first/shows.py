"""What a recording can show and what it cannot, from its signals, its period and its motion."""

from collections.abc import Collection, Sequence

import numpy as np

from twin.control.actuator import EFFORTS
from twin.diagnose.first.axis_facts import AxisFacts
from twin.diagnose.first.people import shown

GAIN_S = 0.01
"""Longest sample period that shows gains and delays of the loops [s]: a position loop of 100 1/s settles within a few such samples."""
VIBRATION_SAMPLES = 4
"""Samples of a vibration that is seen with its amplitude."""


def can_show(facts: Sequence[AxisFacts]) -> list[str]:
    """What the recording shows, one sentence for each group of axes."""
    out = []
    if (own := _names(f for f in facts if f.lags)) != "":
        out.append(f"following error and lag of {own}")
    if (own := _names(f for f in facts if f.friction)) != "":
        out.append(f"friction and inertia of {own}, in units of the recorded effort")
    if (own := _names(f for f in facts if f.transmission)) != "":
        out.append(f"lost motion between motor encoder and scale of {own}")
    if moving := [f for f in facts if f.rows is not None]:
        out.append(f"vibrations up to {1.0 / (VIBRATION_SAMPLES * moving[0].period):.3g} Hz")
    return out


def cannot_show(facts: Sequence[AxisFacts], with_gain: Collection[str] = ()) -> list[str]:
    """What the recording cannot show, each with what would: a signal, a period or a move. `with_gain`: axes whose gain was found."""
    out: list[str] = []
    if not facts:
        return ["nothing: no axis has a position in runs that are long enough; record longer"]

    def say(own: Sequence[AxisFacts], sentence: str) -> None:
        if own:
            out.append(f"{_names(own)}: {sentence}")

    moving = [f for f in facts if f.rows is not None]
    say([f for f in facts if f.rows is None], "does not move further than its noise; record a move")
    say([f for f in moving if "setpoint" not in f.signals], "no set point: no following error; record the commanded position")
    say(
        [f for f in moving if "setpoint" in f.signals and not f.lags],
        "the set point is the recorded motion itself: no following error, no gains; record the commanded position",
    )
    say(
        [f for f in moving if f.lags and f.period > GAIN_S],
        f"one sample each {facts[0].period * 1e3:g} ms: no gains or delays of the loops; record faster",
    )
    say(
        [f for f in moving if f.lags and f.period <= GAIN_S and "velocity_setpoint" not in f.signals and f.name not in with_gain],
        "no speed set point of the position controller: gain and delay are one number, the lag; record it",
    )
    say([f for f in moving if not any(s in f.signals for s in EFFORTS)], "no current or torque: no friction, no inertia; record one")
    say(
        [f for f in moving if any(s in f.signals for s in EFFORTS) and f.friction is None],
        "neither friction nor inertia exceeds its interval (unsigned, or too little motion): record it with its sign, in strokes of several speeds",
    )
    say(
        [f for f in moving if f.friction and min(f.strokes) == 0],
        "moves in one direction only: friction and weight are one number; move back as well",
    )
    say(
        [f for f in moving if f.friction and f.friction.at_speed.known and f.friction.coulomb is None and min(f.strokes) > 0],
        "the recorded speeds do not separate Coulomb from viscous friction: only their sum is known; add constant speeds from creeping to rapid",
    )
    say([f for f in moving if f.transmission is None], "one encoder: backlash and drive train stay hidden; record motor encoder and scale")
    return out


def speed_text(one: AxisFacts) -> str:
    """'up to 16.8 mm/s' or 'at 16.8 mm/s' for a single speed."""
    speed = shown("speed", one.kind)
    if one.rows is None or one.one_speed:
        return f"at {speed.text(one.speed)}"
    return f"up to {speed.text(float(np.percentile(np.abs(one.rows.speed), 98.0)))}"  # the largest slopes are noise and ends of ramps


def _names(facts: object) -> str:
    """'axis X' or 'axes X, Y'."""
    names = [one.name for one in facts]  # type: ignore[attr-defined]
    return f"{'axis' if len(names) == 1 else 'axes'} {', '.join(names)}" if names else ""
