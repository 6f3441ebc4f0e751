"""Laws as compiled terms of the loop: variables, layout of the parameter row, evaluation, and one term for each output.

The row begins with the head below, followed by the parameters of the shape or filter. The state of a filter follows that of the law.
"""

from __future__ import annotations

import math

from twin.compiled_functions import compiled
from twin.effects.law_filters import FIRST_FREE, filtered
from twin.effects.law_shapes import JITTER, LAG, gaussian_of, value_of
from twin.simulation.loop_terms import (
    X_CURRENT,
    X_CURRENT_SETPOINT,
    X_FOLLOWING_ERROR,
    X_FRICTION_LEVEL,
    X_LOAD_ACCELERATION,
    X_LOAD_FORCE,
    X_LOAD_MIDDLE,
    X_LOAD_POSITION,
    X_LOAD_SPEED,
    X_MOTOR_POSITION,
    X_MOTOR_SPEED,
    X_MOTOR_TORQUE,
    X_NOISE,
    X_RECORDED_CURRENT,
    X_ROTOR_FORCE,
    X_ROTOR_MIDDLE,
    X_ROTOR_POSITION,
    X_SCALE,
    X_SETPOINT,
    X_SPEED_SETPOINT,
    X_STEP,
    X_TIME,
    X_TRANSMISSION_ERROR,
    X_VOLTAGE,
    arrays,
    term,
)

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

P_VARIABLE, P_SHAPE, P_AXIS, P_FACTOR, P_OFFSET, P_LENGTH, P_MEMORY, P_CYCLE, P_PERIOD = range(9)
HEAD = 9
S_STARTED, S_MEMORY, S_LAGGED, S_BEFORE, S_FIRST = range(FIRST_FREE)


@compiled
def law_value(p, s, x, axis, in_the_middle):  # type: ignore[no-untyped-def]
    """Current output y of the law; advances its memory by one call."""
    variable, row = int(p[P_VARIABLE]), x[int(p[P_AXIS])]
    h = row[X_STEP]
    speed = row[X_LOAD_SPEED] + (0.5 * h * row[X_LOAD_ACCELERATION] if in_the_middle else 0.0)
    if variable == V_POSITION:
        u = row[X_LOAD_MIDDLE] if in_the_middle else row[X_LOAD_POSITION]
    elif variable == V_TURN:
        u = row[X_ROTOR_MIDDLE] if in_the_middle else row[X_ROTOR_POSITION]
    elif variable == V_VELOCITY:
        u = speed
    elif variable == V_SPEED:
        u = abs(speed)
    elif variable == V_ACCELERATION:
        u = row[X_LOAD_ACCELERATION]
    elif variable == V_ACCELERATION_SIZE:
        u = abs(row[X_LOAD_ACCELERATION])
    elif variable == V_CURRENT:
        u = row[X_CURRENT]
    elif variable == V_TIME:
        u = row[X_TIME]
    elif variable == V_DIRECTION:  # exact for a constant speed over the cycle
        moved = abs(speed) * p[P_CYCLE] / p[P_LENGTH]
        if moved > 0.0:
            s[S_MEMORY] += (math.copysign(1.0, speed) - s[S_MEMORY]) * -math.expm1(-moved)
        u = s[S_MEMORY]
    elif variable == V_SLACK:
        s[S_MEMORY] = min(max(s[S_MEMORY] + speed * p[P_CYCLE] / p[P_LENGTH], -1.0), 1.0)
        u = s[S_MEMORY]
    elif variable == V_WINDUP:
        u = row[X_ROTOR_MIDDLE] + row[X_TRANSMISSION_ERROR] - row[X_LOAD_MIDDLE]
    elif variable == V_FOLLOWING_ERROR:
        u = row[X_FOLLOWING_ERROR]
    elif variable == V_SPEED_SETPOINT:
        u = row[X_SPEED_SETPOINT]
    else:
        u = row[X_CURRENT_SETPOINT]
    u = u * p[P_FACTOR] + p[P_OFFSET]
    if p[P_PERIOD] > 0.0:
        u -= p[P_PERIOD] * math.floor(u / p[P_PERIOD])
    shape = int(p[P_SHAPE])
    y = filtered(shape, u, p[HEAD:], s[FIRST_FREE:], s[S_STARTED] == 0.0) - u if shape >= LAG else value_of(shape, u, p[HEAD:])
    if shape == JITTER:  # an ideal sensor gives no digits: a fixed sequence, tick by tick, of its own on each axis
        digits = x[axis, X_NOISE] if x[axis, X_NOISE] != 0.0 else math.sin((round(row[X_TIME] / h) + 1.0) * math.sqrt(axis + 1.5))
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
def force_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] += law_value(p, s, x, axis, True)


@term
def spring_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """F += y on the load, -y on the rotor."""
    p, s, x = arrays(parameters, state, signals)
    y = law_value(p, s, x, axis, True)
    x[axis, X_LOAD_FORCE] += y
    x[axis, X_ROTOR_FORCE] -= y


@term
def friction_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Coulomb level += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_FRICTION_LEVEL] += law_value(p, s, x, axis, True)


@term
def torque_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """T += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_MOTOR_TORQUE] += law_value(p, s, x, axis, True)


@term
def voltage_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """u += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_VOLTAGE] += law_value(p, s, x, axis, False)


@term
def current_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """i* += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_CURRENT_SETPOINT] += law_value(p, s, x, axis, False)


@term
def speed_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """w* += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_SPEED_SETPOINT] += law_value(p, s, x, axis, False)


@term
def set_point_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """s += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_SETPOINT] += law_value(p, s, x, axis, False)


@term
def record_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Recorded current += y."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_RECORDED_CURRENT] += law_value(p, s, x, axis, False)


@term
def motor_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Motor encoder: q + y - y(0); its speed is the derivative."""
    p, s, x = arrays(parameters, state, signals)
    y = law_value(p, s, x, axis, False)
    x[axis, X_MOTOR_POSITION] += y - s[S_FIRST]
    x[axis, X_MOTOR_SPEED] += (y - s[S_BEFORE]) / x[axis, X_STEP]
    s[S_BEFORE] = y


@term
def scale_law(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """Scale: q + y - y(0)."""
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_SCALE] += law_value(p, s, x, axis, False) - s[S_FIRST]
