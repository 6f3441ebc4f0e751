"""The corrected machine, and its predictions of held-out runs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import functools
from typing import Any

import numpy as np

from twin.diagnose.columns import Columns
from twin.diagnose.cross_validation import bounded, leave_out
from twin.diagnose.fit import no_effect
from twin.diagnose.settings import T
from twin.diagnose.setup import Setup
from twin.diagnose.simulations import Variant
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import SPRINGS, least_share, tuned, with_added
from twin.diagnose.tuning import tuning_from
from twin.documents import value_at
from twin.effects import Setting, settings_of, with_effects
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.decoupled_plant import Motion
from twin.simulation.encoder_zeros import aligned
from twin.simulation.gap import REALISATIONS, Job, Prediction, gap_of, predict_each
from twin.simulation.gap_level import Gaps

FEWER_REALISATIONS = 2
"""Realisations of noise in a quick look, which uses the decoupled plant only."""


def uncorrected(state: GroupState) -> GroupState:
    """The state of a group whose axes keep the values of the machine file, because the correction predicts held-out runs worse."""
    group = state.rigid
    nothing = tuning_from((), Columns([], group.size), 0.0)
    fit = no_effect(group, nothing)
    return replace(state, group=group, tuning=nothing, fit=fit, accepted=(), unknown=True)


def corrected_machine(machine: Machine, states: Sequence[GroupState]) -> Machine:
    """The machine file with re-tuned values and the effects found."""
    values: dict[str, Any] = {}
    for f in states:
        for nuisance, deviation in zip(f.tuning.nuisances, limited_deviations(f)):
            for path in nuisance.paths(machine):
                old = value_at(machine.document, path)
                factor = 1.0 + float(deviation)
                values[path] = [factor * v for v in old] if isinstance(old, list) else factor * old
    retuned = with_effects(machine.with_values(values), normal_imperfections(machine, states))
    return with_added(retuned, [s for f in states for s in f.fit.settings])


def corrected_by(state: GroupState, left_out: Sequence[Setting] = ()) -> Variant:
    """Maps the nominal machine of a run to the corrected machine of the search, without the effects `left_out`."""
    of_tuning = tuned(state.tuning.nuisances, limited_deviations(state))
    settings = [s for s in state.fit.settings if s not in left_out]
    return lambda machine: with_added(of_tuning(machine), settings)


def normal_imperfections(machine: Machine, states: Sequence[GroupState]) -> list[Setting]:
    """Normal imperfections found on this machine, as settings of the effects that they are if they are large."""
    for f in states:
        shown = [n for n in f.tuning.nuisances if n.is_imperfection]
        machine = tuned(shown, limited_deviations(f)[f.tuning.are_imperfections])(machine)
    return list(settings_of(machine))


def limited_deviations(state: GroupState) -> np.ndarray:
    """Deviations of the nuisances as fractions (nuisance,): those of the fit, or the best ones within `widest` tolerances if the fit exceeds them.
    A spring stays near the size that was simulated: its response is not linear, and twice as stiff it may ring with another one.
    """
    machine, tolerance = state.group.machine, state.group.machine.parameter_tolerance
    deviations = state.fit.theta * state.tuning.spread
    springs = np.array([n.quantity in SPRINGS for n in state.tuning.nuisances], bool)
    most = np.where(springs, np.minimum(T.spring_step * state.tuning.base, T.widest * tolerance), T.widest * tolerance)
    if np.any(np.abs(deviations) > most):
        inside = bounded(state.tuning, state.group.residual - state.fit.response, most)
        deviations = inside[: len(deviations)] * state.tuning.spread
    deviations = state.tuning.base + deviations
    too_stiff = [n.quantity == "slip" and d < least_share(machine, n) * tolerance for n, d in zip(state.tuning.nuisances, deviations)]
    return np.where(too_stiff, 0.0, deviations)


@dataclass(frozen=True)
class HeldOut:
    """Predictions of the recorded runs, `before` and `after` correction, by run; and the names of the held-out runs.

    The zeros of the encoders of `runs` are those of the predictions after correction.
    """

    machine: Machine
    runs: tuple[MeasuredRun, ...]
    predictions: dict[str, dict[str, Prediction]] = field(repr=False)
    names: list[str]

    @property
    def traces(self) -> dict[str, Trace]:
        """Predicted trace of each run after correction."""
        return {name: prediction.trace for name, prediction in self.predictions["after"].items()}

    @functools.cached_property
    def gaps(self) -> dict[str, Gaps]:
        """Gaps `before` and `after` correction: run -> axis -> signal."""
        return {
            which: {run.name: gap_of(self.machine, run, predictions[run.name]) for run in self.runs}
            for which, predictions in self.predictions.items()
        }


def held_out_predictions(
    setup: Setup,
    runs: Sequence[MeasuredRun],
    motions: Sequence[Motion],
    states: Sequence[GroupState],
    before: dict[str, Prediction] | None = None,
) -> HeldOut:
    """Predictions of each run by the nominal machine and by the machine fitted without that run, in MuJoCo.

    `motions` are the nominal motions of the runs, for the realisations of noise. A quick look simulates the decoupled plant only. If the
    machine fitted without a fold cannot be simulated (it is nearly unstable), the machine fitted to all runs predicts that fold. `before` are the
    predictions by the nominal machine, if they are known.
    """
    machine, folds = setup.machine, setup.folds
    realisations = FEWER_REALISATIONS if setup.quick else REALISATIONS

    def predicted(by: Sequence[tuple[Machine, Sequence[int]]]) -> dict[str, Prediction]:
        jobs = [Job(one, runs[i], realisations, motion=motions[i], engine=not setup.quick) for one, some in by for i in some]
        return {job.run.name: prediction for job, prediction in zip(jobs, predict_each(jobs, threads=setup.threads))}

    left_out = [list(fold) if len(folds) > 1 else [] for fold in folds]
    before = before or predicted([(machine, range(len(runs)))])
    try:
        after = predicted([(fitted_without(machine, states, without), fold) for without, fold in zip(left_out, folds)])
    except TwinError:  # unstable, or too stiff for the simulation step: find the folds
        after = {}
        for k, fold in enumerate(folds):
            try:
                after |= predicted([(fitted_without(machine, states, left_out[k]), fold)])
            except TwinError:
                left_out[k] = []
                after |= predicted([(fitted_without(machine, states, []), fold)])
    names = [runs[i].name for i in sorted(i for without in left_out for i in without)]
    held_out = HeldOut(machine, tuple(runs), {"before": before, "after": after}, names)
    return replace(held_out, runs=aligned(runs, machine, held_out.traces))


def fitted_without(machine: Machine, states: Sequence[GroupState], fold: Sequence[int]) -> Machine:
    """The corrected machine with the runs of a fold held out of the fit."""
    settings: list[Setting] = []
    variant, tolerance = machine, machine.parameter_tolerance
    for f in states:
        shift, tuning_shift = leave_out(f, fold) if fold else (np.zeros(len(f.fit.free)), np.zeros(len(f.fit.coefficients)))
        moved = f.fit.settings
        for free, step in zip(f.fit.free, np.clip(shift, -3.0, 3.0)):
            moved = free.moved(moved, float(step))
        settings += moved
        deviations = limited_deviations(f)
        # an imperfection that is absent in the fit to all runs stays absent
        absent = [n.quantity in SPRINGS and d < T.doubt * tolerance for n, d in zip(f.tuning.nuisances, deviations)]
        deviations = deviations + np.where(absent, 0.0, tuning_shift[: len(deviations)] * f.tuning.spread)
        variant = tuned(f.tuning.nuisances, np.clip(deviations, -T.widest * tolerance, T.widest * tolerance))(variant)
    return with_added(variant, settings)
