"""The diagnosis of a campaign: where, which, how far; and its contract, `diagnosis.json`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
import math
import os
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from twin.diagnose.budget import Budget, budget_of, document_of, noise_of, positions_left
from twin.diagnose.check import check_campaign, notes_of
from twin.diagnose.corrected import HeldOut, as_filed, corrected_machine, held_out_gaps, is_worse, normal_imperfections
from twin.diagnose.cross_validation import FOLDS
from twin.diagnose.encoder_zeros import at_rest_without_zeros, notes_of_zeros, with_common_zeros, without_zeros, zeros_left
from twin.diagnose.fit import Sizes
from twin.diagnose.law.laws import LEAST_CLOSED, Law, Laws
from twin.diagnose.law.step import ALL_BUT, explained_by_many, keeps_its_gap, laws_beside, predictions_with
from twin.diagnose.law.wording import entry
from twin.diagnose.next_measurement import Proposal, propose
from twin.diagnose.observe import axis_groups, observe, on_threads
from twin.diagnose.plausible import normal_spread
from twin.diagnose.search import search
from twin.diagnose.settings import DEFAULT, Thresholds
from twin.diagnose.state import Found
from twin.diagnose.verdict import judged, named, probabilities_of, verdict_of
from twin.diagnose.view import view_of
from twin.diagnose.waterfall import retuning_share, waterfall
from twin.diagnose.where import left_of, places
from twin.effects import Setting, settings_of, with_effects
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.simulation.gap import COMPARED, Prediction, SignalGap, gap_of

UNDECIDED = 6.0
"""Gap over noise, on runs left out, above which a diagnosis that finds no effect is no answer; a control that interpolates in its own way between
its cycles leaves 3."""


@dataclass
class Diagnosis:
    """Everything that was found; `document()` is `diagnosis.json`."""

    campaign: Campaign
    machine: Machine
    corrected: Machine
    verdict: str
    found: list[Found]
    settings: list[tuple[Setting, Found, float]]
    where: list[dict[str, Any]]
    gaps: dict[str, dict[str, dict[str, dict[str, SignalGap]]]]  # before/after -> run -> axis -> signal
    held_out: list[str]
    proposal: Proposal
    notes: list[str] = field(default_factory=list)
    thresholds: Thresholds = DEFAULT
    budget: Budget | None = None
    on_program: tuple[str, Budget] | None = None  # name of a program, and the budget there
    predictions: dict[str, dict[str, Prediction]] = field(default_factory=dict, repr=False)  # before/after -> run, as in the gaps
    laws: tuple[Law, ...] = ()
    decided: bool = True  # False: a quick look found no effect, and left a gap

    def document(self) -> dict[str, Any]:
        """The contract."""
        before, after = self._pooled("before"), self._pooled("after")
        return {
            "verdict": self.verdict,
            **({} if self.decided else {"decided": False}),
            "effects": [self._effect(s, f, p) for s, f, p in self.settings],
            "candidates": self._candidates(),
            "where": self.where,
            "gap": {
                "before": before,
                "after": after,
                "noise_floor": 1.0,  # what the others are multiples of
                "unit": "RMS over axes and signals, in multiples of what noise alone makes",
                "retuning_share": retuning_share(self.waterfall),
                "held_out_runs": self.held_out,
                "axes": self._axis_gaps(),
            },
            "budget": self._budget(),
            **({"budget_on_program": self._budget_on_program(*self.on_program)} if self.on_program else {}),
            "normal": [s.table() for s in normal_imperfections(self.machine, self.found)],
            "ambiguous_with": self._ambiguous(),
            "not_visible": self._not_visible(),
            "next_measurement": self.proposal.text,
            "laws": [entry(law, self.machine) for law in self.laws],
            "notes": self.notes,
        }

    def _budget(self) -> dict[str, Any] | None:
        return None if self.budget is None else {**self._contributions(self.budget), "unexplained": self._unexplained()}

    def _budget_on_program(self, program: str, budget: Budget) -> dict[str, Any]:
        """The contributions on a program that was not measured: what is left there nobody knows."""
        document = self._contributions(budget)
        return {"program": program, "unit": document["unit"], "change": document["before"], "rows": document["rows"]}

    def _contributions(self, budget: Budget) -> dict[str, Any]:
        halves = {}
        for setting, found, _ in self.settings:
            size = setting.effect.size
            shown = self._parameters(setting, found).get(size.name)
            if shown is not None and (deviation := size.deviation(shown["value"])) > 0.0:
                halves[setting.key] = 0.5 * abs(shown["high"] - shown["low"]) / deviation
        return document_of(budget, self.machine, {s.key: p for s, _, p in self.settings}, halves)

    def _unexplained(self) -> list[dict[str, Any]]:
        """What the corrected machine leaves of each axis on runs left out, above noise."""
        rows = []
        for found in self.found:
            for axis in found.group.axes:
                level = self.axis_level("after", axis)
                if axis in self.axes and level > self.thresholds.left_over and self.budget is not None:
                    block, law = left_of(found, axis)
                    tool = 1e6 * self.budget.left_by_axis.get(axis, 0.0)
                    rows.append({"axis": axis, "block": block, "tool_point": tool, "times_noise": level, "scales_with": law})
        return sorted(rows, key=lambda row: -row["times_noise"])

    def axis_level(self, which: str, axis: str) -> float:
        """RMS over runs and signals of gap over noise, on one axis."""
        values = [
            (g.rms / g.noise) ** 2
            for run, axes in self.gaps[which].items()
            for name, signals in axes.items()
            if name == axis
            for g in signals.values()
            if g.noise > 0 and g.rms > 0
        ]
        return float(np.sqrt(np.mean(values))) if values else 1.0

    def explained(self, axes: Collection[str]) -> float:
        """1 - (after^2 - floor^2) / (before^2 - floor^2) summed over the axes on which an effect acts, on runs left out of the fit.

        From 0 to 1: a gap below the floor, or one that grew, is no share.
        """
        before, after = (sum(max(self.axis_level(which, axis) ** 2 - 1.0, 0.0) for axis in axes) for which in ("before", "after"))
        return max(0.0, min(1.0, 1.0 - after / max(before, 1e-9)))

    def keeps_its_gap(self, axis: str) -> bool:
        """Does correction leave so much of an axis' gap that effects are no answer?"""
        return keeps_its_gap(self.axis_level("before", axis), self.axis_level("after", axis))

    @property
    def axes(self) -> list[str]:
        """Axes of which something was measured."""
        return sorted({name for axes in self.gaps["before"].values() for name in axes}, key=self.machine.axis_names.index)

    @cached_property
    def waterfall(self) -> list[tuple[str, float]]:
        """Levels of the gap step by step, see `twin.diagnose.waterfall`."""
        ends = {axis: (self.axis_level("before", axis) ** 2, self.axis_level("after", axis) ** 2) for axis in self.axes}
        return waterfall(self.found, ends, self.machine.parameter_tolerance)

    def _pooled(self, which: str) -> float:
        return float(np.sqrt(np.mean([self.axis_level(which, axis) ** 2 for axis in self.axes]))) if self.axes else 1.0

    def _axis_gaps(self) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for axis in self.machine.axis_names:
            for signal in COMPARED:
                rows = [
                    (b, self.gaps["after"][run][axis][signal])
                    for run, axes in self.gaps["before"].items()
                    if axis in axes and (b := axes[axis].get(signal)) is not None and b.rms > 0
                ]
                if rows:
                    out.setdefault(axis, {})[signal] = {
                        "before": float(np.sqrt(np.mean([b.rms**2 for b, _ in rows]))),
                        "after": float(np.sqrt(np.mean([a.rms**2 for _, a in rows]))),
                        "noise_floor": float(np.sqrt(np.mean([b.noise**2 for b, _ in rows]))),
                        "unit": rows[0][0].unit,
                    }
        return out

    def _effect(self, setting: Setting, found: Found, probability: float) -> dict[str, Any]:
        shown_by = found.group.axes if setting.effect.edits_bodies else (setting.axis,)
        axes = [a for a in self.axes if a in shown_by]
        return {
            "effect": setting.effect.name,
            "axis": setting.axis,
            **({"from_axis": setting.from_axis} if setting.from_axis else {}),
            "block": setting.effect.block,
            "probability": probability,
            "explained": self.explained(axes),
            "parameters": self._parameters(setting, found),
        }

    def _parameters(self, setting: Setting, found: Found, sizes: Sizes | None = None) -> dict[str, Any]:
        """Values with 95 % intervals: of what was found those of the final fit, of other candidates those of `sizes`.

        One that was screened only has no width: nothing was fitted.
        """
        axis = self.machine.axis(setting.axis)
        of = found.fit.sizes() if setting.key in found.keys else sizes if sizes is not None and setting in sizes.settings else None
        index = [s.key for s in of.settings].index(setting.key) if of is not None else None
        out = {}
        covariance = of.covariance(found.inflation) if of is not None else np.zeros((0, 0))
        for parameter in setting.effect.parameters:
            if parameter.name not in setting.parameters:
                continue
            value = setting.parameters[parameter.name]
            low = high = value
            free_of = of.free if of is not None else ()
            i = next((i for i, f in enumerate(free_of) if (f.setting, f.parameter.name) == (index, parameter.name)), None)
            if i is not None:
                free = free_of[i]
                step = free.unit * (abs(value) if free.logarithmic else 1.0)
                fitted = math.sqrt(max(float(covariance[i, i]), 0.0)) * step
                law = self.thresholds.model_error * (abs(value) if free.logarithmic else parameter.deviation(value))
                half = 1.96 * max(math.hypot(fitted, law), normal_spread(setting, parameter, self.machine))
                if free.logarithmic:
                    half /= abs(value)
                    low, high = value * math.exp(-half), value * math.exp(min(half, 50.0))
                else:
                    low, high = value - half, value + half
            out[parameter.name] = {"value": value, "low": low, "high": high, "unit": parameter.unit(axis)}
        return out

    def _candidates(self) -> list[dict[str, Any]]:
        """Every effect and axis tried, best first: fitted ones with their evidence, the others as screened."""
        rows: list[tuple[tuple[bool, float, float], dict[str, Any]]] = []
        chosen = {s.key: (s, p) for s, _, p in self.settings}
        for found in self.found:
            seen = set()
            for candidates in found.rounds:
                for candidate, probability in zip(candidates, probabilities_of(candidates, found)):
                    if candidate.key in seen:
                        continue
                    seen.add(candidate.key)
                    setting, p = chosen.get(candidate.key, (candidate.setting, probability))
                    row = self._candidate(setting, p, candidate.closes, self._parameters(setting, found, candidate.sizes))
                    if candidate.sizes.settings[:-1]:
                        row["beside"] = [f"{s.effect.name} {s.axis}" for s in candidate.sizes.settings[:-1]]
                    rows.append(((candidate.key in chosen, p, candidate.evidence), row))
            for key, gain, setting, closes in found.screened:
                if key not in seen:
                    rows.append(((False, -1.0, gain), self._candidate(setting, 0.0, closes, self._parameters(setting, found))))
        rows.sort(key=lambda row: row[0], reverse=True)
        return [row for _, row in rows]

    def _candidate(self, setting: Setting, probability: float, explained: float, parameters: dict[str, Any]) -> dict[str, Any]:
        return {
            "effect": setting.effect.name,
            "axis": setting.axis,
            **({"from_axis": setting.from_axis} if setting.from_axis else {}),
            "probability": float(probability),
            "explained": explained,
            "parameters": parameters,
        }

    def _not_visible(self) -> list[dict[str, Any]] | None:
        """Effects that these runs and signals would not show if the machine had them: by how much they would have to be larger than usual.

        `usual_sizes` None: whatever their size. None at all: not asked, in a quick look.
        """
        if any(found.unseen is None for found in self.found):
            return None
        named = {setting.key for setting, _, _ in self.settings}
        return [
            {
                "effect": effect,
                "axis": axis,
                **({"from_axis": source} if source else {}),
                "usual_sizes": sizes if math.isfinite(sizes) else None,
            }
            for found in self.found
            for (effect, axis, source), sizes in sorted((found.unseen or {}).items(), key=lambda item: str(item[0]))
            if (effect, axis, source) not in named
        ]

    def _ambiguous(self) -> list[dict[str, Any]]:
        """Rivals that this campaign cannot separate from what was found."""
        out = []
        for setting, found, _ in self.settings:
            for candidates in found.rounds:
                best = candidates[0] if candidates else None
                if best is None or (best.setting.effect.name, best.setting.axis) != (setting.effect.name, setting.axis):
                    continue
                for rival in candidates[1:]:
                    if rival.plausible and best.evidence - rival.evidence < self.thresholds.ambiguous:
                        out.append(
                            {
                                "effect": rival.setting.effect.name,
                                "axis": rival.setting.axis,
                                **({"from_axis": rival.setting.from_axis} if rival.setting.from_axis else {}),
                                "instead_of": setting.effect.name,
                                "instead_of_axis": setting.axis,
                                "evidence_behind": best.evidence - rival.evidence,
                            }
                        )
        return out


@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    campaign: Campaign,
    machine: Machine,
    *,
    quick: bool = False,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
    thresholds: Thresholds = DEFAULT,
    program: MeasuredRun | None = None,
) -> Diagnosis:
    """Diagnose a campaign against a machine; deterministic for a seed, on one thread for each core by default.

    `program`: set points of a program, on which the budget is asked as well.

    Raises InputError where the campaign is another machine's, holds no measured signal or no motion, or where the machine has effects.
    """
    say = progress or (lambda _: None)
    machine_without = with_effects(machine, [])
    if machine.effects:
        raise InputError(f"machine {machine.name} already has effects; diagnose against the machine without them")
    runs, zeros = with_common_zeros(campaign.runs, machine_without, thresholds)
    campaign = replace(campaign, runs=runs)
    check_campaign(campaign, machine, thresholds)
    folds = folds_of(len(campaign.runs))
    measured = sorted({axis for run in campaign.runs for axis in run.trace.axes})
    threads = threads or os.cpu_count() or 1
    # groups are searched side by side, each asking the same workers for its simulations
    with ThreadPoolExecutor(threads) as workers, ThreadPoolExecutor(threads) as searches:
        mapper = on_threads(workers)

        def search_group(axes: tuple[str, ...]) -> Found | None:
            say(f"{'+'.join(axes)}: what noise makes")
            group = observe(views, axes, seed, thresholds)
            if not group.size:
                return None
            return judged(search(group, machine_without, folds, mapper, say, quick), machine_without, mapper, quick)

        views = mapper(lambda run: view_of(machine_without, run, thresholds), campaign.runs)
        groups = axis_groups(machine_without, measured, [run.ballbar.axes for run in campaign.runs if run.ballbar is not None])
        longest_first = sorted(groups, key=len, reverse=True)
        results = dict(zip(longest_first, searches.map(search_group, longest_first)))
    found = [result for axes in groups if (result := results[axes])]

    offsets = {key: offset for f in found for key, offset in f.zeros.items()}
    runs, fitted_zeros = without_zeros(campaign.runs, machine_without, offsets)
    campaign, zeros = replace(campaign, runs=runs), fitted_zeros | zeros
    views = [replace(view, trace=run.trace) for view, run in zip(views, runs)]
    say("simulating the runs left out")
    motions = [view.motion for view in views]
    zeroed = {axis for axis, _ in offsets}

    def aligned(runs: Sequence[MeasuredRun], of: HeldOut, with_laws: Collection[str] = ()) -> tuple[MeasuredRun, ...]:
        """The runs without the zeros of encoders that a prediction leaves: at rest, and in every run of axes `with_laws`."""
        beside = zeros_left(runs, machine_without, of.traces, with_laws)
        return at_rest_without_zeros(without_zeros(runs, machine_without, beside)[0], machine_without, of.traces, zeroed)

    held_out = held_out_gaps(campaign.runs, motions, machine_without, found, folds, engine=not quick, threads=threads)
    runs = aligned(campaign.runs, held_out)
    before, after = (held_out.levels(machine, runs, which) for which in ("before", "after"))
    if any(harmed := [is_worse(f.group.axes, before, after) for f in found]):
        found = [as_filed(f) if worse else f for f, worse in zip(found, harmed)]
        held_out = held_out_gaps(campaign.runs, motions, machine_without, found, folds, engine=not quick, threads=threads)
        runs = aligned(campaign.runs, held_out)
        after = held_out.levels(machine, runs, "after")
    found = [replace(f, unknown=f.unknown and not explained_by_many(f, before, after)) for f in found]
    settings = named(found)
    corrected = corrected_machine(machine, found)
    laws: Laws | None = None
    best = without_laws = held_out.left(machine, runs)
    with ThreadPoolExecutor(threads) as workers:
        loudest = held_out.loudest(machine, runs)
        for tried in laws_beside(found, before, after, loudest, machine_without, corrected, folds, on_threads(workers), say):
            if tried.laws:
                with_laws = predictions_with(tried, held_out, campaign.runs, motions, folds, engine=not quick, threads=threads)
                if with_laws is None:
                    continue
                of_laws = {law.axis for law in tried.laws}
                rezeroed, alike = aligned(campaign.runs, with_laws, of_laws), aligned(campaign.runs, held_out, of_laws)
                # what does not shrink the gap on runs left out by more than their zeros do is no law of this machine
                known = min(best, held_out.left(machine, alike))
                if (now := with_laws.left(machine, rezeroed)) - 1.0 < (1.0 - LEAST_CLOSED) * (known - 1.0):
                    laws, predicted, best, runs = tried, with_laws, now, rezeroed
            if best - 1.0 < ALL_BUT * (without_laws - 1.0):
                break
    if laws is not None:
        corrected, held_out = laws.corrected, predicted
        settings = kept_in(corrected, settings)
    traces = held_out.traces
    gaps = {which: {run.name: gap_of(machine, run, of_run[run.name]) for run in runs} for which, of_run in held_out.predictions.items()}
    campaign = replace(campaign, runs=runs)
    notes = [*notes_of(campaign, machine), *notes_of_zeros(zeros, machine)]
    if quick:
        notes.append("a quick look: gaps are the decoupled plant's, not MuJoCo's; which effects these runs would not show was not asked")
    if unstable := [run.name for run in campaign.runs if len(folds) > 1 and run.name not in held_out.runs]:
        notes.append(f"fitted without {', '.join(unstable)} the machine is unstable; there its gap is that of the fit to all runs")
    verdict = verdict_of(found, settings)
    diagnosis = Diagnosis(
        campaign=campaign,
        machine=machine,
        corrected=corrected,
        verdict=verdict,
        found=found,
        settings=settings,
        where=[],
        gaps=gaps,
        held_out=held_out.runs,
        proposal=propose(machine, found, verdict),
        notes=notes,
        thresholds=thresholds,
        predictions=held_out.predictions,
        laws=laws.laws if laws else (),
    )
    loud = [axis for axis in diagnosis.axes if diagnosis.axis_level("after", axis) > UNDECIDED]
    if (verdict == "none" and loud) or (verdict == "effect" and any(diagnosis.keeps_its_gap(axis) for f in found for axis in f.group.axes)):
        # the fit hides what runs left out still show; a quick look leaves axes out that are quiet where the blocks are cut
        diagnosis.decided = not (quick and verdict == "none")
        diagnosis.verdict = verdict = "unknown"
        diagnosis.proposal = propose(machine, found, verdict) if found else diagnosis.proposal
    if diagnosis.laws and diagnosis.explained(diagnosis.axes) >= 1.0 - ALL_BUT:
        diagnosis.verdict = verdict = "law"
    left = [positions_left(run.trace, traces[run.name], machine) for run in runs]
    say("what each effect is worth")
    noise = noise_of(gaps["before"], machine)
    with ThreadPoolExecutor(threads) as pool:
        diagnosis.budget = budget_of(machine, corrected, found, views, left, noise, on_threads(pool))
        if program is not None:
            view = view_of(machine_without, program, thresholds)
            diagnosis.on_program = program.name, budget_of(machine, corrected, found, [view], [None], noise, on_threads(pool))
    order = [row.setting.key for row in diagnosis.budget.rows if row.setting is not None]
    diagnosis.settings = sorted(settings, key=lambda item: order.index(item[0].key) if item[0].key in order else len(order))
    if verdict != "none":
        weights = {axis: max(diagnosis.axis_level("before", axis) ** 2 - 1.0, 0.0) for axis in machine.axis_names}
        say("where the gap lies")
        leading = [*(law.setting for law in diagnosis.laws), *(s for s, _, _ in settings)]
        diagnosis.where = places(found, leading, machine, weights, threads)
    return diagnosis


def kept_in(corrected: Machine, settings: Sequence[tuple[Setting, Found, float]]) -> list[tuple[Setting, Found, float]]:
    """The effects that the corrected machine holds, with its sizes: a law may have taken the place of some."""
    held = {s.key: s for s in settings_of(corrected)}
    return [(held[setting.key], found, p) for setting, found, p in settings if setting.key in held]


def folds_of(runs: int) -> list[list[int]]:
    """Runs left out together; a single run cannot be left out."""
    count = min(FOLDS, runs)
    return [[i for i in range(runs) if i % count == k] for k in range(count)]
