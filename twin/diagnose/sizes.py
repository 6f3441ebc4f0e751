"""Final fit of the sizes of the effects found, with less weight where the twin does not follow the record.

If an axis breaks away a few milliseconds earlier than predicted, a few samples have large residuals and depend steeply on every parameter.
A fit that follows them biases all sizes. The final fit therefore adds the residual around a sample to the model error, which is correlated
over many samples (`Channel.weight`). It also re-tunes the machine with its effects: a current filter, for example, trades off against the
damping of a drive train.
"""

import contextlib
from dataclasses import replace

from twin.diagnose.fit import fit_effects, slopes_of_linear_effects
from twin.diagnose.plausible import is_plausible, normal_deviation
from twin.diagnose.settings import T
from twin.diagnose.state import GroupState, is_isolated
from twin.diagnose.tuning import linearised
from twin.errors import TwinError
from twin.estimate.regression import NORMAL_95
from twin.machine.machine import Machine


def with_final_sizes(state: GroupState, quick: bool = False) -> GroupState:
    """The state with its effects fitted with this model error; unchanged without effects. A quick look takes one step with the slopes it has."""
    if not state.fit.settings:
        return state
    state = replace(state, response_cache={})
    rounds, steps = (1, 1) if quick else (T.size_rounds, T.refit_steps)
    if not quick:
        with contextlib.suppress(TwinError):  # nearly unstable: keep the tuning linearised without effects
            state = replace(state, tuning=linearised(state.fit.about, state.group, state.fit.settings, state.fit.response))
    change = state.fit.response / state.group.weights
    for _ in range(rounds):
        state = state.with_model_error(change * state.group.weights, state.fit.residual(state.group))
        known = state.fit.slopes if quick else slopes_of_linear_effects(state.fit.slopes, state.fit.settings)
        fit = fit_effects(state.group, state.tuning, state.fit.settings, steps, narrowest=1.0, known=known)
        if fit is None:
            break
        state = state.with_fit(fit)
    return without_implausible(state.inflated())


def without_implausible(state: GroupState) -> GroupState:
    """The state without effects whose final size is implausible or too uncertain."""
    if not state.fit.settings:
        return state
    machine = state.group.machine
    determined = _sizes_are_determined(state, machine)
    kept = [s for s, known in zip(state.fit.settings, determined) if known and is_plausible(s, machine, is_isolated(state.group, s))]
    if len(kept) == len(state.fit.settings):
        return state
    fit = fit_effects(state.group, state.tuning, kept, T.refit_steps)
    if fit is None:
        return state
    return state.with_fit(fit).inflated()


def _sizes_are_determined(state: GroupState, machine: Machine) -> list[bool]:
    """For each effect: is its 95 % interval beyond zero and beyond what the tolerance explains? That of a logarithmic size is taken as linear."""
    settings = state.fit.settings
    determined = [True] * len(settings)
    for free, deviation in state.fit.sizes().deviations(state.inflation).values():
        setting = settings[free.setting]
        size = setting.effect.size
        if free.parameter is size:
            half = NORMAL_95 * deviation * free.step(setting.size)
            determined[free.setting] = size.deviation(setting.size) - half > normal_deviation(setting, machine)
    return determined
