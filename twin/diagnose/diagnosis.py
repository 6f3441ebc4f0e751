"""The diagnosis of a campaign and its document, `diagnosis.json`."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
import math
from typing import Any

import numpy as np

from twin.diagnose.budget import Budget, document_of
from twin.diagnose.corrected import HeldOut, normal_imperfections
from twin.diagnose.fit import Sizes
from twin.diagnose.judgement import explained
from twin.diagnose.law.laws import FoundLaw
from twin.diagnose.law.wording import entry
from twin.diagnose.next_measurement import Proposal
from twin.diagnose.plausible import normal_spread
from twin.diagnose.settings import T
from twin.diagnose.state import SHOWS_IN, GroupState
from twin.diagnose.tuning import moved_by
from twin.diagnose.verdict import Named, probabilities_of
from twin.diagnose.waterfall import retuning_share, waterfall
from twin.diagnose.where import largest_remaining_block
from twin.documents import value_at
from twin.effects import Setting
from twin.estimate.regression import NORMAL_95
from twin.machine.commented import guessed_values, measured_interval
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign
from twin.simulation.campaign_gap import AS_EXPECTED
from twin.simulation.gap import COMPARED
from twin.simulation.gap_level import levels, overall


@dataclass(frozen=True)
class Diagnosis:
    """All results of a diagnosis; `document()` is `diagnosis.json`."""

    campaign: Campaign
    machine: Machine
    corrected: Machine
    verdict: str
    states: list[GroupState]
    named: list[Named]
    where: list[dict[str, Any]]
    held_out: HeldOut
    proposal: Proposal
    notes: list[str] = field(default_factory=list)
    budget: Budget | None = None
    on_program: tuple[str, Budget] | None = None  # name of a program, and the budget there
    laws: tuple[FoundLaw, ...] = ()
    without_laws: Mapping[str, float] = field(default_factory=dict)  # level of each axis after correction without laws
    decided: bool = True  # False: a quick look found no effect but a gap remains

    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects found, as in `diagnosis.json`: name, axis, probability, parameters with intervals, block."""
        return [self._effect(s, f, p) for s, f, p in self.named if s.key not in self.calibrated]

    def document(self) -> dict[str, Any]:
        """The document of `diagnosis.json`."""
        before, after = (overall(self.levels[which]) for which in ("before", "after"))
        return {
            "verdict": self.verdict,
            **({} if self.decided else {"decided": False}),
            "effects": self.effects,
            "calibrated": [self._calibration(s, f, p) for s, f, p in self.named if s.key in self.calibrated],
            "candidates": self._candidates(),
            "where": self.where,
            "gap": {
                "before": before,
                "after": after,
                "noise_floor": 1.0,  # unit of the other gaps
                "unit": "RMS over axes and signals in motion, in multiples of what noise alone makes",
                "retuning_share": retuning_share(self.waterfall),
                "held_out_runs": self.held_out.names,
                "axes": self._axis_gaps(),
            },
            "budget": self._budget(),
            **({"budget_on_program": self._budget_on_program(*self.on_program)} if self.on_program else {}),
            "normal": [s.table() for s in normal_imperfections(self.machine, self.states)],
            "ambiguous_with": self._ambiguous(),
            "not_visible": self._not_visible(),
            "next_measurement": self.proposal.text,
            "laws": [entry(law, self.machine) for law in self.laws],
            "notes": self.notes,
        }

    @cached_property
    def calibrated(self) -> frozenset[Any]:
        """Keys of the effects on what the machine file had assumed, tried or bounded: no findings, but a calibration.

        So is an effect that leaves a measured number within its interval. Behind an assumed position controller the loop of an axis moves as nobody
        measured. There an effect is a finding only if a channel isolates its block from the loop: any other takes up the errors of the controller.
        """
        guessed = guessed_values(self.machine)

        def is_calibration(s: Setting, state: GroupState) -> bool:
            within = [low <= s.parameters[name] * value <= high for name, _, value, (low, high) in _measured(s, self.machine)]
            if not guessed.keys().isdisjoint(s.paths(self.machine)) or (within and all(within)):
                return True
            isolating = SHOWS_IN.get(s.effect.block)
            isolated = s.axis in state.group.on_own_path or state.group.has(s.axis, isolating)
            return f"axis.{s.axis}.loops.position_gain_per_s" in guessed and not isolated

        return frozenset(s.key for s, state, _ in self.named if is_calibration(s, state))

    def _budget(self) -> dict[str, Any] | None:
        return None if self.budget is None else {**self._contributions(self.budget), "unexplained": self._unexplained()}

    def _budget_on_program(self, program: str, budget: Budget) -> dict[str, Any]:
        """The contributions on a program that was not measured. The unexplained gap is not known there."""
        document = self._contributions(budget)
        return {"program": program, "unit": document["unit"], "change": document["before"], "rows": document["rows"]}

    def _contributions(self, budget: Budget) -> dict[str, Any]:
        halves = {}
        for setting, state, _ in self.named:
            size = setting.effect.size
            shown = self._parameters(setting, state).get(size.name)
            if shown is not None and (deviation := size.deviation(shown["value"])) > 0.0:
                halves[setting.key] = 0.5 * abs(shown["high"] - shown["low"]) / deviation
        return document_of(budget, self.machine, {s.key: p for s, _, p in self.named}, halves, self.calibrated)

    def _unexplained(self) -> list[dict[str, Any]]:
        """Gap above noise of each axis that the corrected machine leaves on held-out runs."""
        rows = []
        for state in self.states:
            for axis in state.group.axes:
                level = self.levels["after"].get(axis, 1.0)
                if level > AS_EXPECTED and self.budget is not None:
                    block, law = largest_remaining_block(state, axis)
                    tool = 1e6 * self.budget.left_by_axis.get(axis, 0.0)
                    rows.append({"axis": axis, "block": block, "tool_point": tool, "times_noise": level, "scales_with": law})
        return sorted(rows, key=lambda row: -row["times_noise"])

    @cached_property
    def levels(self) -> dict[str, dict[str, float]]:
        """Level of each diagnosed axis, 'before' and 'after' correction. How an axis rests that never moves is chance."""
        diagnosed = {axis for state in self.states for axis in state.group.seen_axes} or set(self.machine.axis_names)
        return {
            which: {axis: level for axis, level in levels(gaps).items() if axis in diagnosed} for which, gaps in self.held_out.gaps.items()
        }

    def explained(self, axes: Collection[str]) -> float:
        """Share of the gap on these axes that the correction closes on held-out runs."""
        return explained(self.levels["before"], self.levels["after"], axes)

    @property
    def axes(self) -> list[str]:
        """Measured axes."""
        return sorted({name for axes in self.held_out.gaps["before"].values() for name in axes}, key=self.machine.axis_names.index)

    @cached_property
    def waterfall(self) -> list[tuple[str, float]]:
        """Gap after each step of the correction, see `twin.diagnose.waterfall`."""
        before, after = ({axis: level**2 for axis, level in self.levels[which].items()} for which in ("before", "after"))
        with_laws = {law.axis: after[law.axis] for law in self.laws if law.axis in after}
        ends = {axis: (before[axis], self.without_laws[axis] ** 2 if axis in with_laws else after[axis]) for axis in before}
        return waterfall(self.states, ends, {s.key for s, _, _ in self.named}, with_laws)

    def _axis_gaps(self) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for axis in self.machine.axis_names:
            for signal in COMPARED:
                rows = [
                    (b, self.held_out.gaps["after"][run][axis][signal])
                    for run, axes in self.held_out.gaps["before"].items()
                    if axis in axes and (b := axes[axis].get(signal)) is not None and b.rms > 0
                ]
                if rows:
                    out.setdefault(axis, {})[signal] = {
                        "before": float(np.sqrt(np.mean([b.rms**2 for b, _ in rows]))),
                        "after": float(np.sqrt(np.mean([a.rms**2 for _, a in rows]))),
                        "noise_floor": float(np.sqrt(np.mean([a.noise**2 for _, a in rows]))),
                        "unit": rows[0][0].unit,
                    }
        return out

    def _effect(self, setting: Setting, state: GroupState, probability: float) -> dict[str, Any]:
        shown_by = moved_by([setting], state.group.axes)
        explained = self.explained([a for a in self.axes if a in shown_by])
        head = {**_head(setting.effect.name, setting.axis, setting.from_axis), "block": setting.effect.block}
        return {**head, **self._candidate(setting, state, probability, explained)}

    def _calibration(self, setting: Setting, state: GroupState, probability: float) -> dict[str, Any]:
        """An effect with the measured numbers that it contradicts: then it takes up an error of the controller, or the machine has changed since."""
        found = self._effect(setting, state, probability)
        against = contradicted(setting, found["parameters"], self.machine)
        return {**found, **({"contradicts": against} if against else {})}

    def _parameters(self, setting: Setting, state: GroupState, sizes: Sizes | None = None) -> dict[str, Any]:
        """Values with 95 % intervals: from the final fit for effects found, from `sizes` for other candidates.

        A candidate that was only screened has no interval.
        """
        axis = self.machine.axis(setting.axis)
        of = state.fit.sizes() if setting.key in state.keys else sizes if sizes is not None and setting in sizes.settings else None
        deviations = of.deviations(state.inflation) if of is not None else {}
        out = {}
        for parameter in setting.effect.parameters:
            if parameter.name not in setting.parameters:
                continue
            value = setting.parameters[parameter.name]
            low = high = value
            if (fitted := deviations.get((setting.key, parameter.name))) is not None:
                free, deviation = fitted
                law = T.model_error * (abs(value) if free.logarithmic else parameter.deviation(value))
                half = NORMAL_95 * max(math.hypot(deviation * free.step(value), law), normal_spread(setting, parameter, self.machine))
                if free.logarithmic:
                    half /= abs(value)
                    low, high = value * math.exp(-half), value * math.exp(min(half, 50.0))
                else:
                    low, high = value - half, value + half
            out[parameter.name] = {"value": value, "low": low, "high": high, "unit": parameter.unit(axis)}
        return out

    def _candidates(self) -> list[dict[str, Any]]:
        """All effects and axes tried, best first: fitted ones with their evidence, the others with their gain in screening."""
        rows: list[tuple[tuple[bool, float, float], dict[str, Any]]] = []
        chosen = {s.key: (s, p) for s, _, p in self.named}
        for state in self.states:
            seen = set()
            for candidates in state.rounds:
                for candidate, probability in zip(candidates, probabilities_of(candidates, state)):
                    if candidate.key in seen:
                        continue
                    seen.add(candidate.key)
                    setting, p = chosen.get(candidate.key, (candidate.setting, probability))
                    row = self._candidate(setting, state, p, candidate.closes, candidate.sizes)
                    if others := candidate.sizes.settings[:-1]:
                        row["beside"] = [f"{s.effect.name} {s.axis}" for s in others]
                    rows.append(((candidate.key in chosen, p, candidate.evidence), row))
            for key, gain, setting, closes in state.screened:
                if key not in seen:
                    rows.append(((False, -1.0, gain), self._candidate(setting, state, 0.0, closes)))
        rows.sort(key=lambda row: row[0], reverse=True)
        return [row for _, row in rows]

    def _candidate(
        self, setting: Setting, state: GroupState, probability: float, explained: float, sizes: Sizes | None = None
    ) -> dict[str, Any]:
        return {
            **_head(setting.effect.name, setting.axis, setting.from_axis),
            "probability": probability,
            "explained": explained,
            "parameters": self._parameters(setting, state, sizes),
        }

    def _not_visible(self) -> list[dict[str, Any]] | None:
        """Effects that would not be visible in these runs and signals, with the smallest multiple of their usual size that would.

        `usual_sizes` None: at no size. None instead of the list: not computed, in a quick look.
        """
        if any(state.not_visible is None for state in self.states):
            return None
        named = {setting.key for setting, _, _ in self.named}
        return [
            {**_head(effect, axis, source), "usual_sizes": sizes if math.isfinite(sizes) else None}
            for state in self.states
            for (effect, axis, source), sizes in sorted((state.not_visible or {}).items(), key=lambda item: str(item[0]))
            if (effect, axis, source) not in named
        ]

    def _ambiguous(self) -> list[dict[str, Any]]:
        """Rivals that the campaign does not separate from the effects found."""
        out = []
        for setting, state, _ in self.named:
            for candidates in state.rounds:
                best = candidates[0] if candidates else None
                if best is None or (best.setting.effect.name, best.setting.axis) != (setting.effect.name, setting.axis):
                    continue
                for rival in candidates[1:]:
                    if rival.plausible and (behind := best.evidence - rival.evidence) < T.evidence:
                        head = _head(rival.setting.effect.name, rival.setting.axis, rival.setting.from_axis)
                        named = {"instead_of": setting.effect.name, "instead_of_axis": setting.axis}
                        out.append({**head, **named, "evidence_behind": behind})
        return out


def contradicted(setting: Setting, shown: Mapping[str, Mapping[str, Any]], machine: Machine) -> str:
    """The measured intervals of the machine file that the factors of an effect, as in its document, exclude, in words; "" if there are none."""
    return "; ".join(
        f"{path} is measured, {low:.4g} to {high:.4g}"
        for name, path, value, (low, high) in _measured(setting, machine)
        if name in shown and (shown[name]["high"] * value < low or shown[name]["low"] * value > high)
    )


def _measured(setting: Setting, machine: Machine) -> Iterator[tuple[str, str, float, tuple[float, float]]]:
    """Each factor of an effect on a measured number of the machine file: its name, and path, value and 95 % interval of the number."""
    for p in (p for p in setting.effect.parameters if p.multiplies):
        path = setting.path_of(p.multiplies, machine)
        if (interval := measured_interval(machine, path)) is not None:
            yield p.name, path, float(value_at(machine.document, path) or 0.0), interval


def _head(effect: str, axis: str, from_axis: str | None) -> dict[str, Any]:
    """First entries of an effect in the document."""
    return {"effect": effect, "axis": axis, **({"from_axis": from_axis} if from_axis else {})}
