"""The law of a control whose command is recorded: current, voltage or torque u(k) from set point s and position x at its own cycle Ts.

    w*   = Kv (s(t - d) - x) + a_v ds/dt                 position controller with speed feedforward
    u_ff = M d2s/dt2                                     feedforward of the acceleration, added to the command
    w    = sum_j b_j (x(k-j) - x(k-j-1)) / Ts            speed by differences, sum b = 1; or the recorded speed
    P    u = Kp (w* - w) + u_ff                          which is a PD controller of the position
    PI   u = Kp (w* - w) + Kp / Tn int (w* - w) dt + u_ff

Written over the recorded signals both are linear: u = c_e (s - x) + sum a_j ds(k-j) - sum b_j dx(k-j) + c_i int (s - x) + c_x x + c, with
c_i = c_x = 0 for P; M is the moment of the a_j. The speed is one difference over n cycles (equal b_j), or else the steps of x take up any filter of the control. Signals of
the law may be whole cycles older than the command, as where the actual current is recorded. At a limit of the command the integrator goes on or
holds, and the law is that of the command below it. The law with the fewest terms that the held-out pieces of the motion support is taken. Set points may
reach the control whole cycles after their record, or behind a filter (`command_run`); d is then a delay of all terms of s.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
import math

import numpy as np
from scipy.special import chdtri

from twin.control.command_columns import (
    AHEAD,
    ANY_SPEED,
    EARLIEST,
    FED,
    FIRST,
    LATEST,
    LONGEST_DIFFERENCE,
    NO_SPEED,
    ROUNDED,
    STEPS_AHEAD,
    Form,
    answers_of,
    asked_of,
    blocks_of,
    columns_of,
    rounding_of,
    roundings_of,
    sums_apart,
    with_held,
)
from twin.control.command_run import PROMPT, RESOLVED_CYCLES, CommandRun, SetPointPath, set_point_path
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.noise_of_signals import BY_CHANCE, is_noise
from twin.estimate.regression import Fit, regress, solved

LARGEST_LEFT = 0.02
"""The command follows a law if less than this share (RMS) is left on the held-out pieces: rounding, and a tick within the cycle."""

BEYOND_LIMIT = 0.01
"""The largest command is a limit if the law asks for more than this share more there: a command within AT_LIMIT of it cannot, but for rounding."""

PASSES = 50
"""Rounds of the correction for the lag of an integrator by a cycle."""

SAME_LAW = 0.02
"""With full feedforward Kv and 1/Tn can be exchanged: the smaller one is taken as Kv, unless the other way fits better by this share of their sum."""

NUMBERS = (
    *("position_gain_per_s", "speed_gain", "speed_integral_time_s", "velocity_feedforward", "position_delay_s"),
    *("speed_mean_cycles", "acceleration"),
)
"""Numbers of a law, by the names of a machine file but for those per unit of the command."""

FILTER_TIME = "filter_time"
"""Name of the half interval of the time of a filter of the set points [s]."""


@dataclass(frozen=True)
class CommandLaw:
    """Position gain [1/s], speed gain [command per m/s or rad/s], integral time [s] (inf: P), feedforward weight, delay of the set point [s],
    feedforward of the acceleration M [command per m/s2 or rad/s2].

    `speed_mean_cycles`: the position is differentiated over so many cycles, 0 if the recorded speed is used. `left`: share of the command (RMS)
    that the law leaves on held-out pieces. `half`: 95 % half intervals of NUMBERS. `late`: whole cycles from the signals to the command that answers
    them; None if a part of a cycle more is not excluded. `exact`: it leaves no more than rounding; noise may hide what the control does between two cycles.
    `path`: how the set points reach it; `half` has the interval of the time of a filter [s] under FILTER_TIME. `limited`: the largest command is a limit.
    """

    position_gain_per_s: float
    speed_gain: float
    speed_integral_time_s: float
    velocity_feedforward: float
    position_delay_s: float
    speed_mean_cycles: int
    left: float
    late: int | None = 0
    exact: bool = False
    acceleration: float = 0.0
    path: SetPointPath = PROMPT
    limited: bool = False
    half: Mapping[str, float] = field(default_factory=dict)


def command_law(runs: Sequence[CommandRun], nearly: bool = False) -> CommandLaw | None:
    """The law that the recorded command follows, or None; with `nearly` the P law that leaves the least of one that follows none, as one with noise.

    Of the laws that differ by less than the rounding of the signals, that with the fewest terms gives the values; the intervals cover all.
    """
    runs = [r for r in runs if len(r.command) > 4 * FIRST]
    if not runs:
        return None
    path = set_point_path(runs, 4 * FIRST, _left_by)
    paths = [(path, 0)]
    if path.filter is None:  # a command that is recorded late is late behind set points and positions alike
        paths += [(SetPointPath(path.delay - late), late) for late in range(1, min(LATEST, path.delay) + 1)]
    laws = [(one, late, _law_of_prompt(one.of(runs), nearly)) for one, late in paths]
    found = [(one, law) for one, late, law in laws if law and late in (0, law.late)]
    if not found:
        return None
    # of laws that leave rounding alone that of the least lateness, else that which leaves least
    path, law = min(found, key=lambda one: (not one[1].exact, one[1].exact * (one[0].delay + (one[1].late or 0)), one[1].left))
    if path.filter is not None:  # delay and feedforward may make up for its time
        time = _half_of_time(runs, path) if law.exact else math.inf
        half = {**law.half, "velocity_feedforward": math.inf, "position_delay_s": math.inf, FILTER_TIME: time}
        law = replace(law, half=half)
    return replace(law, position_delay_s=law.position_delay_s + path.delay * runs[0].period, path=path)


def _half_of_time(runs: Sequence[CommandRun], path: SetPointPath) -> float:
    """95 % half interval [s] of the time of a filter, beside all numbers of a law with any speed; a change of the command by ROUNDED is unseen."""
    here, there = (path.at(cycles).of(runs) for cycles in (path.cycles, path.cycles + RESOLVED_CYCLES))
    y, _, use = asked_of(here)
    y, columns, blocks = y[use], columns_of(here, ANY_SPEED)[use], blocks_of(here)[use]
    change = (columns_of(there, ANY_SPEED)[use] - columns) @ solved(columns, y) / RESOLVED_CYCLES
    own = change - columns @ solved(columns, change)
    fit = regress(np.column_stack([change, columns]), y, blocks)
    unseen = ROUNDED * float(np.linalg.norm(y)) / max(float(np.linalg.norm(own)), 1e-300)
    return math.hypot(fit.quantile * fit.deviations[0], unseen) * runs[0].period


def _left_by(runs: Sequence[CommandRun], single: bool) -> np.ndarray:
    """Mean squares of the pieces that a law with any speed leaves of the command, at least those of rounding; a `single` step of the set point."""
    y, pieces, use = asked_of(runs)
    others = [1 + k for k in range(FED) if k != AHEAD] if single else []
    laws = (np.delete(columns_of(runs, form), others, axis=1) for form in with_held([ANY_SPEED], runs))
    left = min((held_out(law, y, pieces, use) for law in laws), key=lambda squares: float(np.sum(squares)))
    return np.maximum(left, (ROUNDED * np.sqrt(np.mean(y[use] ** 2))) ** 2)


def _law_of_prompt(runs: Sequence[CommandRun], nearly: bool) -> CommandLaw | None:
    """The law as in `command_law` of set points that the control has at most two cycles late."""
    y, pieces, use = asked_of(runs)
    size = float(np.sqrt(np.mean(y[use] ** 2)))
    measured = [Form(0, False, True)] if all(r.speed is not None for r in runs) else []
    differences = range(1, LONGEST_DIFFERENCE + 1)
    forms = [Form(n, False, True, late) for late in sorted(range(EARLIEST, LATEST + 1), key=abs) for n in differences]
    forms += [Form(NO_SPEED, False, False), *(Form(n, False, False) for n in differences[1:]), *measured]
    # the integral of a difference over several cycles has a weight of its own at each
    forms += [form._replace(integral=True) for form in forms if not form.even or form.n < 2]
    forms = [form for form in forms if not form.integral and form.n != NO_SPEED] if nearly else with_held(forms, runs)
    squares = [held_out(columns_of(runs, form), y, pieces, use) for form in forms]
    best = 0
    for i in range(1, len(forms)):
        if is_better(squares[i], squares[best], ROUNDED * size):
            best = i
    left = [float(np.mean(square)) for square in squares]
    if not nearly and (not math.sqrt(left[best]) < LARGEST_LEFT * size or forms[best].n == NO_SPEED):
        return None

    @functools.cache
    def fit_of(i: int) -> Fit:
        return regress(columns_of(runs, forms[i])[use], y[use], blocks_of(runs)[use])

    def law_of(i: int, b: np.ndarray, exchanged: bool = False) -> CommandLaw | None:
        return _read(b, forms[i], runs[0].period, math.sqrt(left[i]) / size, exchanged, sums_apart(runs, forms[i]))

    if nearly:
        law = law_of(best, fit_of(best).values)
        return law and replace(law, acceleration=_as_if_prompt(fit_of(best).values, forms[best], runs[0].period))

    def rounding(i: int) -> float:
        """Mean square of the command that rounding makes."""
        return max(math.hypot(*rounding_of(runs, fit_of(i).values, forms[i])), ROUNDED * size) ** 2

    def is_as_good(i: int) -> bool:
        """Whether a law of no more terms than the best one leaves as little, but for rounding or by chance."""
        of_rounding = left[i] - left[best] <= min(left[best], rounding(best))
        return of_rounding or not is_better(squares[best], squares[i], ROUNDED * size)

    of_one_length = [i for i in range(len(forms)) if i <= best or (forms[i].even and forms[i].integral == forms[best].integral)]
    likely = [i for i in of_one_length if forms[i].n != NO_SPEED and is_as_good(i)]
    first = likely[0]
    fit, form = fit_of(first), forms[first]
    square = float(np.mean(fit.residual**2))
    answers, share = answers_of(runs, fit.values, form), rounding(first) / max(square, 1e-300)
    noises = ((answers[:1], [math.inf], 0.0), (answers[1:], [max(run.noise[i] for run in runs) for i in range(len(answers) - 1)], share))
    if share < 1.0 and not any(is_noise(fit.residual, *one) for one in noises):
        return None
    law = law_of(first, fit.values)
    if law is None:
        return None

    def is_other(i: int) -> bool:
        """Whether a law may hold in place of the first. One of any weights contains one of a late difference, and its first weight is then below 0."""
        backwards = fit_of(i).values[1 + FED] > fit_of(i).quantile * fit_of(i).deviations[1 + FED]
        of_command = max(max(run.steps[0] for run in runs) / math.sqrt(12.0), ROUNDED * size)
        return forms[i].even or not form.even or not (backwards or square <= of_command**2)

    others = [law_of(i, fit_of(i).values) for i in likely if is_other(i)] + [law_of(first, fit.values, exchanged=True)]
    others += [law_of(first, fit.values + change) for change in _attenuations(runs, columns_of(runs, form)[use], fit, form)]
    cycle = law.position_gain_per_s * runs[0].period
    ahead = float(STEPS_AHEAD @ fit.values[1 : 1 + FED]) / law.speed_gain
    if 0.5 * cycle < ahead < LATEST * law.velocity_feedforward:  # a set point that is recorded late acts like a feedforward ahead
        others.append(replace(law, velocity_feedforward=max(law.velocity_feedforward - (LATEST + 1) * cycle, 0.0)))
    if form.integral:
        shares = (1.0,) if form.n else (0.0, 1.0)  # a recorded speed may be that of a shorter cycle
        others += [law_of(first, _summed_later(fit.values, runs[0].period, share)) for share in shares]
    exact = form.even and square <= rounding(first)
    beyond = columns_of(runs, form)[~use] @ fit.values * np.sign(y[~use])  # that a law asks for more is the evidence of a limit
    limited = exact and bool(np.median(beyond) > (1.0 + BEYOND_LIMIT) * np.abs(y).max())
    if not exact:  # noise may hide that signals are late by a part of a cycle, at most as much as the difference
        others.append(law_of(first, _earlier(fit.values, 0.5 * max(form.n - 1, 0) * runs[0].period)))
    law = _with_intervals(
        replace(law, exact=exact, limited=limited),
        [other for other in others if other],
        fit,
        functools.partial(law_of, first),
        runs[0].period,
    )
    speed = fit.values[1 + FED : 1 + FED + form.width]
    share = SAME_LAW + form.n * runs[0].period / law.speed_integral_time_s  # an integrator that is a cycle behind is in the first weight
    unequal = np.abs(speed - speed.mean()) > fit.quantile * fit.deviations[1 + FED : 1 + FED + form.width] + share * abs(speed.mean())
    return replace(law, half={**law.half, "speed_mean_cycles": math.inf}) if unequal.any() else law  # a filter is no difference


def _with_intervals(
    law: CommandLaw, others: Sequence[CommandLaw], fit: Fit, read: Callable[[np.ndarray], CommandLaw | None], period: float
) -> CommandLaw:
    """The law with its intervals: the scatter, what `others` that may hold differ by, and what a record does not show of any law."""
    half = _half_intervals(fit, read)
    apart = {
        name: max(abs(getattr(other, name) - getattr(law, name)) for other in others)
        for name in NUMBERS
        if math.isfinite(getattr(law, name))
    }
    half = {name: max(half[name] + off, ROUNDED * abs(getattr(law, name)) * (half[name] > 0.0)) for name, off in apart.items()}
    if law.acceleration:  # the speed that is fed forward may be that of the profile
        half["acceleration"] += AHEAD * period * law.speed_gain * law.velocity_feedforward
    if math.isfinite(law.speed_integral_time_s):  # what a sum of the speed between the samples differs by
        half["acceleration"] += period**2 * law.speed_gain / law.speed_integral_time_s
    if _is_prompt(fit):
        return replace(law, half=half)
    # a late set point, or signals that are late by a part of a cycle, as by the lag of a drive whose current is recorded
    half |= dict.fromkeys(("velocity_feedforward", "position_delay_s") if law.exact else half, math.inf)
    return replace(law, half=half, late=law.late if law.exact else None)


def _as_if_prompt(b: np.ndarray, form: Form, period: float) -> float:
    """Feedforward of the acceleration, with what a late speed adds to it: a controller that has its speed at once then needs this one."""
    speed = -b[1 + FED : 1 + FED + form.width]
    late = 0.5 * form.n * speed[0] if form.even else (np.arange(form.n) + 0.5) @ speed
    return max(float(STEPS_AHEAD @ b[1 : 1 + FED] + late), 0.0) * period


def _is_prompt(fit: Fit) -> bool:
    """Whether the set point acts by one step as feedforward, by none, or by several that are not late, as the speed of a profile.

    A lateness spreads a step over later ones, or turns its sign where there is no feedforward.
    """
    fed = slice(1, 1 + FED)
    steps, covariance = fit.values[fed], fit.covariance[fed, fed] + (ROUNDED * fit.values[1 + FED]) ** 2 * np.eye(FED)
    if not np.all(np.isfinite(covariance)):  # a record that does not determine the steps does not show that none is late
        return False
    if steps.sum() > 0.0 and STEPS_AHEAD @ steps > -fit.quantile * math.sqrt(max(STEPS_AHEAD @ covariance @ STEPS_AHEAD, 0.0)):
        return True
    for j in range(FED):
        others = np.arange(FED) != j
        inverse = np.linalg.pinv(covariance[np.ix_(others, others)])
        share = covariance[j, others] @ inverse
        deviation = math.sqrt(max(covariance[j, j] - share @ covariance[others, j], 0.0))
        misfit = steps[others] @ inverse @ steps[others]
        if misfit < chdtri(FED - 1, BY_CHANCE) and steps[j] - share @ steps[others] > -fit.quantile * deviation:
            return True
    return False


def _earlier(b: np.ndarray, late: float) -> np.ndarray:
    """Coefficients of the law whose signals are late [s] altogether: the steps take up the change of the error in this time."""
    b = b.copy()
    b[1] += b[0] * late
    b[1 + FED] -= b[0] * late
    return b


def _summed_later(b: np.ndarray, period: float, share: float) -> np.ndarray:
    """Coefficients of the law if the integrator holds the speed of its own cycle, and this share of its error: 1 in the cycle of the record, less in a shorter one."""
    b = b.copy()
    b[0] -= share * period * b[-2]
    b[1 + FED] -= period * b[-1]
    return b


def _attenuations(runs: Sequence[CommandRun], columns: np.ndarray, fit: Fit, form: Form) -> list[np.ndarray]:
    """Change of the coefficients if the control has one of its signals without the rounding of the record, at most that of the whole residual.

    Columns Z = X + E with independent errors give b = (Z'Z)^-1 Z'y, and (Z'Z - n C)^-1 Z'y is the law of X, with C the covariance of E of a row.
    """
    of_signals = roundings_of(form, runs[0].period, runs[0].motor is not None)
    steps = [max(run.steps[i] for run in runs) for i in range(1, 1 + len(of_signals))]
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv(np.linalg.qr(columns / size, mode="r"))
    changes = []
    for step, each in zip(steps, of_signals):
        k = len(each)
        made = step**2 / 12.0 * float(np.sum((fit.values[:k] @ each) ** 2))
        share = min(float(np.mean(fit.residual**2)) / made, 1.0) if made > 0.0 else 0.0
        covariance = np.zeros((len(size), len(size)))
        covariance[:k, :k] = share * len(columns) * step**2 / 12.0 * each @ each.T / np.outer(size[:k], size[:k])
        lost = inverse @ inverse.T @ covariance
        changes.append(np.linalg.solve(np.eye(len(lost)) - lost, lost @ (fit.values * size)) / size)
    return changes


def _half_intervals(fit: Fit, read: Callable[[np.ndarray], CommandLaw | None]) -> dict[str, float]:
    """95 % half intervals of gains and times, along the principal directions of the covariance of their coefficients."""
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)  # a column of zeros
    variances, directions = np.linalg.eigh(covariance)
    sums = np.zeros(len(NUMBERS))
    for step in (directions * np.sqrt(np.maximum(variances, 0.0))).T:
        ends = [read(fit.values + step), read(fit.values - step)]
        values = [[getattr(law, name) if law else math.inf for name in NUMBERS] for law in ends]
        sums += np.array([0.25 * (a - b) ** 2 if a != b else 0.0 for a, b in zip(*values)])
    return {name: fit.quantile * math.sqrt(square) for name, square in zip(NUMBERS, sums.tolist())}


def _read(b: np.ndarray, form: Form, period: float, share: float, exchanged: bool = False, apart: bool = False) -> CommandLaw | None:
    """Gains and times from the coefficients of `columns_of`; None if they are those of no controller.

    `exchanged`: with the other of both ways to read Kv and 1/Tn, None if the set point separates them. `apart`: the integral of the feedforward has a column.
    """
    on_error, on_setpoint, gain = float(b[0]), float(b[1 : 1 + FED].sum()), -float(b[1 + FED : 1 + FED + form.width].sum())
    if on_error <= 0.0 or gain <= 0.0 or (exchanged and not form.integral):
        return None
    # a set point that acts late takes from the weight of its slope what the position gain adds in this time
    steps, weight, position_gain, rate = gain, on_setpoint / gain, on_error / gain, 0.0
    for _ in range(PASSES if form.integral else 0):
        # the position sees Kv + 1/Tn and Kv / Tn; the set point sees Kv + a_v / Tn, which separates both unless a_v is 1; apart it sees a_v / Tn
        whole, product = (on_error - float(b[-1])) / gain, float(b[-2]) / gain
        if product <= 0.0 or whole <= 0.0:
            return None
        square = whole**2 - 4.0 * product
        spread = math.copysign(math.sqrt(abs(square)), square)  # below 0 by an error: its size counts in the interval
        low, high = 0.5 * (whole - spread), 0.5 * (whole + spread)
        fed = float(b[-3]) / gain if apart else 0.0
        misfit = [abs(kv + weight * y - on_error / gain) + apart * abs(weight * y - fed) for kv, y in ((low, high), (high, low))]
        clear = abs(misfit[1] - misfit[0]) > SAME_LAW * whole
        if clear and exchanged:
            return None
        position_gain, rate = (high, low) if exchanged or (clear and misfit[1] < misfit[0]) else (low, high)
        # the integrator is a cycle behind, and the mean of n differences (n - 1) / 2 more: part of the steps is its lag
        late, fed_late = rate * period, 0.0 if apart else rate * period
        gain = steps / (1.0 - late * 0.5 * max(form.n - 1, 0) - fed_late * weight)
        weight = on_setpoint / (gain * (1.0 - fed_late))
    delay = max(-weight, 0.0) / position_gain
    delay = delay if delay > 0.1 * period else 0.0
    # steps ahead are those of the speed of a profile, or the acceleration
    ahead = float(STEPS_AHEAD @ b[1 : 1 + FED])
    acceleration = ahead * period if ahead > AHEAD * max(on_setpoint, 0.0) else 0.0
    time = 1.0 / rate if rate > 0.0 else math.inf
    return CommandLaw(position_gain, gain, time, max(weight, 0.0), delay, form.n, share, form.late, acceleration=acceleration)
