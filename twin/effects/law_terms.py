"""Laws as compiled terms of the loop: variables, layout of the parameter row, evaluation, and one term for each output.

The row begins with the head below, followed by the parameters of the shape or filter. The state of a filter follows that of the law.
"""

from __future__ import annotations

import math

from twin.compiled_functions import compiled
from twin.effects.law_filters import FIRST_FREE, filtered
from twin.effects.law_shapes import JITTER, LAG, gaussian_of, value_of
from twin.simulation import loop_terms
from twin.simulation.loop_terms import arrays, term

(
    V_POSITION,
    V_TURN,
    V_VELOCITY,
    V_SPEED,
    V_ACCELERATION,
    V_ACCELERATION_SIZE,
    V_CURRENT,
    V_TIME,
    V_DIRECTION,
    V_SLACK,
    V_FOLLOWING_ERROR,
    V_SPEED_SETPOINT,
    V_CURRENT_SETPOINT,
    V_WINDUP,
) = range(14)

P_VARIABLE, P_SHAPE, P_AXIS, P_FACTOR, P_OFFSET, P_LENGTH, P_MEMORY, P_CYCLE, P_PERIOD, P_OUTPUT, P_IN_THE_MIDDLE, P_FROM_START = range(12)
HEAD = 12
S_STARTED, S_MEMORY, S_LAGGED, S_BEFORE, S_FIRST = range(FIRST_FREE)


@compiled
def law_value(p, s, x, axis):  # type: ignore[no-untyped-def]
    """Current output y of the law, of a force in the middle of the step; advances its memory by one call."""
    in_the_middle = p[P_IN_THE_MIDDLE] > 0.0
    variable, row = int(p[P_VARIABLE]), x[int(p[P_AXIS])]
    h = row[loop_terms.X_STEP]
    speed = row[loop_terms.X_LOAD_SPEED] + (0.5 * h * row[loop_terms.X_LOAD_ACCELERATION] if in_the_middle else 0.0)
    if variable == V_POSITION:
        u = row[loop_terms.X_LOAD_MIDDLE] if in_the_middle else row[loop_terms.X_LOAD_POSITION]
    elif variable == V_TURN:
        u = row[loop_terms.X_ROTOR_MIDDLE] if in_the_middle else row[loop_terms.X_ROTOR_POSITION]
    elif variable == V_VELOCITY:
        u = speed
    elif variable == V_SPEED:
        u = abs(speed)
    elif variable == V_ACCELERATION:
        u = row[loop_terms.X_LOAD_ACCELERATION]
    elif variable == V_ACCELERATION_SIZE:
        u = abs(row[loop_terms.X_LOAD_ACCELERATION])
    elif variable == V_CURRENT:
        u = row[loop_terms.X_CURRENT]
    elif variable == V_TIME:
        u = row[loop_terms.X_TIME]
    elif variable == V_DIRECTION:  # exact for a constant speed over the cycle
        moved = abs(speed) * p[P_CYCLE] / p[P_LENGTH]
        if moved > 0.0:
            s[S_MEMORY] += (math.copysign(1.0, speed) - s[S_MEMORY]) * -math.expm1(-moved)
        u = s[S_MEMORY]
    elif variable == V_SLACK:
        s[S_MEMORY] = min(max(s[S_MEMORY] + speed * p[P_CYCLE] / p[P_LENGTH], -1.0), 1.0)
        u = s[S_MEMORY]
    elif variable == V_WINDUP:
        u = row[loop_terms.X_ROTOR_MIDDLE] + row[loop_terms.X_TRANSMISSION_ERROR] - row[loop_terms.X_LOAD_MIDDLE]
    elif variable == V_FOLLOWING_ERROR:
        u = row[loop_terms.X_FOLLOWING_ERROR]
    elif variable == V_SPEED_SETPOINT:
        u = row[loop_terms.X_SPEED_SETPOINT]
    else:
        u = row[loop_terms.X_CURRENT_SETPOINT]
    u = u * p[P_FACTOR] + p[P_OFFSET]
    if p[P_PERIOD] > 0.0:
        u -= p[P_PERIOD] * math.floor(u / p[P_PERIOD])
    shape = int(p[P_SHAPE])
    y = filtered(shape, u, p[HEAD:], s[FIRST_FREE:], s[S_STARTED] == 0.0) - u if shape >= LAG else value_of(shape, u, p[HEAD:])
    if shape == JITTER:  # an ideal sensor gives no digits: a fixed sequence, tick by tick, of its own on each axis
        digits = (
            x[axis, loop_terms.X_NOISE]
            if x[axis, loop_terms.X_NOISE] != 0.0
            else math.sin((round(row[loop_terms.X_TIME] / h) + 1.0) * math.sqrt(axis + 1.5))
        )
        y *= gaussian_of(digits)
    if p[P_MEMORY] > 0.0:
        if s[S_STARTED] == 0.0:
            s[S_LAGGED] = y
        s[S_LAGGED] += (y - s[S_LAGGED]) * -math.expm1(-p[P_CYCLE] / p[P_MEMORY])
        y = s[S_LAGGED]
    if s[S_STARTED] == 0.0:
        s[S_STARTED], s[S_FIRST], s[S_BEFORE] = 1.0, y, y
    return y


@term
def added_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Signal number P_OUTPUT += y, or y - y(0) of a displacement from the start."""
    p, s, x = arrays(parameters, state, signals)
    y = law_value(p, s, x, axis)
    x[axis, int(p[P_OUTPUT])] += y - s[S_FIRST] * p[P_FROM_START]


@term
def spring_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += y on the load, -y on the rotor."""
    p, s, x = arrays(parameters, state, signals)
    y = law_value(p, s, x, axis)
    x[axis, loop_terms.X_LOAD_FORCE] += y
    x[axis, loop_terms.X_ROTOR_FORCE] -= y


@term
def motor_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Motor encoder: q + y - y(0); its speed is the derivative."""
    p, s, x = arrays(parameters, state, signals)
    y = law_value(p, s, x, axis)
    x[axis, loop_terms.X_MOTOR_POSITION] += y - s[S_FIRST]
    x[axis, loop_terms.X_MOTOR_SPEED] += (y - s[S_BEFORE]) / x[axis, loop_terms.X_STEP]
    s[S_BEFORE] = y
