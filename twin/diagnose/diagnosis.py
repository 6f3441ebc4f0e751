"""The diagnosis of a campaign: where, which, how far; and its contract, `diagnosis.json`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
import math
import os
from typing import Any

import numpy as np

from twin.campaign import Campaign, MeasuredRun
from twin.diagnose.found import Candidate, Found, closed, differs_between_runs, excess_of, expected_loss, is_systematic, settled_channels
from twin.diagnose.left_out import EVIDENCE, FOLDS, bounded, leave_out, retuned_within
from twin.diagnose.next_measurement import Proposal, propose
from twin.diagnose.observe import axis_groups, observe
from twin.diagnose.plausible import is_plausible
from twin.diagnose.search import search
from twin.diagnose.tolerance import LEAST_SHARE, NORMAL, SPRINGS, WIDEST, tuned, with_added
from twin.diagnose.tuning import PRIOR_WEIGHT
from twin.diagnose.view import view_of
from twin.diagnose.where import places
from twin.effects import Parameter, Setting, settings_of, with_effects
from twin.errors import InputError
from twin.gap import COMPARED, REALISATIONS, Prediction, SignalGap, gap_of, predict_campaign
from twin.machine import Axis, Machine
from twin.setpoints import check_travel, setpoints_of

TEMPERATURE = 3.0
"""Divides the evidence before it becomes a probability: models are never quite right."""

CONFIDENCE = 0.98
"""No probability is larger: what is not in the library cannot be ruled out."""

STANDS_IN = 0.3
"""Factor on the probability of an effect that leaves something unknown: it may stand in for a law that is not in the library."""

AMBIGUOUS = 10.0
"""Evidence by which a rival may lie behind and still be named as possible."""

REMAINING = 0.1
"""Share of the excess over noise that, left after all found effects, makes the verdict 'unknown'."""

NOTICED_EXCESS = 0.12
"""Mean square of the residual above noise from which something is there at all."""

MODEL_ERROR = 0.007
"""Relative standard deviation of a size that no amount of samples takes away: what else differs within the tolerance."""

BEYOND = 0.2
"""A position gap above this share of the motion belongs to another machine."""


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
    retuned_share: float
    seed: int
    notes: list[str] = field(default_factory=list)
    predictions: dict[str, dict[str, Prediction]] = field(default_factory=dict, repr=False)  # before/after -> run, as in the gaps

    def document(self) -> dict[str, Any]:
        """The contract."""
        before, after = self._pooled("before"), self._pooled("after")
        floor = self._floor()
        return {
            "verdict": self.verdict,
            "effects": [self._effect(s, f, p) for s, f, p in self.settings],
            "candidates": self._candidates(),
            "where": self.where,
            "gap": {
                "before": before,
                "after": after,
                "noise_floor": floor,
                "unit": "RMS over axes and signals, in multiples of what noise alone makes",
                "retuning_share": self.retuned_share,
                "held_out_runs": self.held_out,
                "axes": self._axis_gaps(),
            },
            "normal": [s.table() for s in normal_imperfections(self.machine, self.found)],
            "ambiguous_with": self._ambiguous(),
            "next_measurement": self.proposal.text,
            "notes": self.notes,
        }

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

    def explained(self, axis: str) -> float:
        """1 - (after^2 - floor^2) / (before^2 - floor^2) on one axis, on runs left out of the fit."""
        before, after = self.axis_level("before", axis), self.axis_level("after", axis)
        return max(0.0, min(1.0, 1.0 - max(after**2 - 1.0, 0.0) / max(before**2 - 1.0, 1e-9)))

    def _pooled(self, which: str) -> float:
        axes = sorted({name for axes in self.gaps[which].values() for name in axes})
        return float(np.sqrt(np.mean([self.axis_level(which, axis) ** 2 for axis in axes]))) if axes else 1.0

    def _floor(self) -> float:
        return 1.0

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
        axes = {setting.axis}
        if setting.effect.edits_bodies:
            axes |= set(found.group.axes)
        explained = float(np.mean([self.explained(a) for a in axes]))
        return {
            "effect": setting.effect.name,
            "axis": setting.axis,
            **({"from_axis": setting.from_axis} if setting.from_axis else {}),
            "block": setting.effect.block,
            "probability": probability,
            "explained": explained,
            "parameters": self._parameters(setting, found),
        }

    def _parameters(self, setting: Setting, found: Found) -> dict[str, Any]:
        """Values with 95 % intervals."""
        axis = self.machine.axis(setting.axis)
        index = next((i for i, s in enumerate(found.fit.settings) if s is setting or s == setting), None)
        out = {}
        # the same weight that keeps the tolerance from being pulled by many samples keeps the interval from shrinking with them
        covariance = found.fit.covariance(found.tuning, PRIOR_WEIGHT * found.inflation) if index is not None else np.zeros((0, 0))
        for parameter in setting.effect.parameters:
            if parameter.name not in setting.parameters:
                continue
            value = setting.parameters[parameter.name]
            low = high = value
            if index is not None:
                for i, f in enumerate(found.fit.free):
                    if f.setting == index and f.parameter.name == parameter.name:
                        known = MODEL_ERROR * self._deviation(f.parameter, value) / f.unit if not f.logarithmic else MODEL_ERROR / f.unit
                        half = 1.96 * math.hypot(math.sqrt(max(float(covariance[i, i]), 0.0)), known)
                        if f.logarithmic:
                            low, high = value * math.exp(-half * f.unit), value * math.exp(min(half * f.unit, 50.0))
                        else:
                            low, high = value - half * f.unit, value + half * f.unit
            out[parameter.name] = {"value": value, "low": low, "high": high, "unit": parameter.unit(axis)}
        return out

    @staticmethod
    def _deviation(parameter: Parameter, value: float) -> float:
        """How far a value is from doing nothing; an angle is known as an angle."""
        if parameter.periodic:
            return 1.0
        neutral = parameter.neutral if parameter.neutral is not None and math.isfinite(parameter.neutral) else 0.0
        return abs(value - neutral)

    def _candidates(self) -> list[dict[str, Any]]:
        """Every effect and axis tried, best first: fitted ones with their evidence, the others as screened."""
        rows: list[tuple[float, dict[str, Any]]] = []
        chosen = {(s.effect.name, s.axis, s.from_axis): p for s, _, p in self.settings}
        for found in self.found:
            seen = set()
            for candidates in found.rounds:
                probabilities = probabilities_of(candidates)
                for candidate, probability in zip(candidates, probabilities):
                    if candidate.key in seen:
                        continue
                    seen.add(candidate.key)
                    p = chosen.get(candidate.key, probability if candidate.plausible else 0.0)
                    row = self._candidate(candidate.setting, found, p, candidate.closes)
                    if candidate.fit.settings[:-1]:
                        row["beside"] = [f"{s.effect.name} {s.axis}" for s in candidate.fit.settings[:-1]]
                    rows.append((1e6 * (candidate.key in chosen) + candidate.evidence, row))
            for key, gain, setting, closes in found.screened:
                if key not in seen:
                    rows.append((min(gain, 0.0) - 1e3 + math.tanh(gain / 1e3), self._candidate(setting, found, 0.0, closes)))
        rows.sort(key=lambda row: -row[0])
        return [row for _, row in rows]

    def _candidate(self, setting: Setting, found: Found, probability: float, explained: float) -> dict[str, Any]:
        return {
            "effect": setting.effect.name,
            "axis": setting.axis,
            **({"from_axis": setting.from_axis} if setting.from_axis else {}),
            "probability": float(probability),
            "explained": explained,
            "parameters": self._parameters(setting, found),
        }

    def _ambiguous(self) -> list[dict[str, Any]]:
        """Rivals that this campaign cannot tell from what was found."""
        out = []
        for setting, found, _ in self.settings:
            for candidates in found.rounds:
                best = candidates[0] if candidates else None
                if best is None or (best.setting.effect.name, best.setting.axis) != (setting.effect.name, setting.axis):
                    continue
                for rival in candidates[1:]:
                    if rival.plausible and best.evidence - rival.evidence < AMBIGUOUS:
                        out.append(
                            {
                                "effect": rival.setting.effect.name,
                                "axis": rival.setting.axis,
                                "instead_of": setting.effect.name,
                                "evidence_behind": best.evidence - rival.evidence,
                            }
                        )
        return out


def probabilities_of(candidates: Sequence[Candidate]) -> list[float]:
    """Probability of each candidate of a round against its rivals and against none of them."""
    if not candidates:
        return []
    evidence = np.array([c.evidence if c.plausible else -1e3 for c in candidates] + [EVIDENCE])
    odds = np.exp(np.clip((evidence - evidence.max()) / TEMPERATURE, -700, 0))
    return (CONFIDENCE * odds / odds.sum())[:-1].tolist()


def diagnose(
    campaign: Campaign,
    machine: Machine,
    *,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Diagnose a campaign against a machine; deterministic for a seed. Raises InputError where the campaign is another machine's."""
    say = progress or (lambda _: None)
    machine_without = with_effects(machine, [])
    if machine.effects:
        raise InputError(f"machine {machine.name} already has effects; diagnose against the machine without them")
    check_campaign(campaign, machine)
    views = [view_of(machine_without, run) for run in campaign.runs]
    folds = folds_of(len(views))
    measured = sorted({axis for run in campaign.runs for axis in run.trace.axes})
    found = []
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:

        def mapper(function, items):  # type: ignore[no-untyped-def]
            return list(pool.map(function, items))

        for axes in axis_groups(machine_without, measured):
            say(f"{'+'.join(axes)}: what noise makes")
            group = observe(views, axes, seed)
            if group.size:
                found.append(search(group, machine_without, folds, mapper, say, quick))

    settings = _named(found, machine_without)
    corrected = corrected_machine(machine, found)
    say("simulating the runs left out")
    gaps, predictions = _held_out_gaps(campaign, machine_without, found, folds, quick)
    verdict = _verdict(found, settings)
    diagnosis = Diagnosis(
        campaign=campaign,
        machine=machine,
        corrected=corrected,
        verdict=verdict,
        found=found,
        settings=settings,
        where=[],
        gaps=gaps,
        held_out=[run.name for run in campaign.runs] if len(folds) > 1 else [],
        proposal=propose(machine, found, verdict),
        retuned_share=_retuned_share(found, machine.parameter_tolerance),
        seed=seed,
        notes=_notes(campaign, machine),
        predictions=predictions,
    )
    if verdict != "none":
        healthy = [tuned(f.tuning.nuisances, retuned_within(f, machine.parameter_tolerance).tuning * f.tuning.spread) for f in found]
        weights = {axis: max(diagnosis.axis_level("before", axis) ** 2 - 1.0, 0.0) for axis in machine.axis_names}
        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            diagnosis.where = places([f.group for f in found], [s for s, _, _ in settings], healthy, weights, pool.map)
    return diagnosis


def check_campaign(campaign: Campaign, machine: Machine) -> None:
    """Refuse what another machine recorded: set points outside the travel, motion that does not follow them; and what holds no signal."""
    if not any(run.trace.has(axis, signal) for run in campaign.runs for axis in run.trace.axes for signal in COMPARED):
        raise InputError(f"{campaign.path}: no run holds a measured signal ({', '.join(COMPARED)}); record at least the position")
    for run in campaign.runs:
        check_travel(setpoints_of(run.trace, machine), machine, f"{campaign.path}: run {run.name}")
        for axis in run.trace.axes:
            if not run.trace.has(axis, "position"):
                continue
            setpoint, position = run.trace.get(axis, "setpoint"), run.trace.get(axis, "position")
            loops = machine.axis(axis).loops
            lag = loops.position_delay_s + 1.0 / loops.position_gain_per_s
            allowed = 3.0 * lag * float(np.abs(np.gradient(setpoint, run.trace.period)).max()) + 1e-4
            largest = float(np.abs(setpoint - position).max())
            if largest > max(allowed, BEYOND * float(np.ptp(setpoint))):
                raise InputError(
                    f"{campaign.path}: run {run.name}: axis {axis} is up to {largest * 1e3:.3g} {'mm' if machine.axis(axis).kind == 'linear' else 'mrad'} "
                    f"off its set point, beyond any effect on machine {machine.name}; check the machine file, signs and units of the record"
                )


def folds_of(runs: int) -> list[list[int]]:
    """Runs left out together; a single run cannot be left out."""
    count = min(FOLDS, runs)
    return [[i for i in range(runs) if i % count == k] for k in range(count)]


def corrected_machine(machine: Machine, found: Sequence[Found]) -> Machine:
    """The machine file with re-tuned values and the effects found."""
    values: dict[str, Any] = {}
    for f in found:
        for nuisance, deviation in zip(f.tuning.nuisances, within(f, machine.parameter_tolerance)):
            for path in nuisance.paths(machine):
                old: Any = machine.document
                for key in path.split("."):
                    old = old[key]
                factor = 1.0 + float(deviation)
                values[path] = [factor * v for v in old] if isinstance(old, list) else factor * old
    return with_added(
        with_effects(machine.with_values(values), normal_imperfections(machine, found)), [s for f in found for s in f.fit.settings]
    )


def normal_imperfections(machine: Machine, found: Sequence[Found]) -> list[Setting]:
    """What every machine has a little of and this one shows, as settings of the effects that it would be if it were large."""
    for f in found:
        normal = [n.quantity in NORMAL for n in f.tuning.nuisances]
        shown = [n for n in f.tuning.nuisances if n.quantity in NORMAL]
        machine = tuned(shown, within(f, machine.parameter_tolerance)[normal])(machine)
    return list(settings_of(machine))


def within(f: Found, tolerance: float) -> np.ndarray:
    """Deviations of the nuisances as fractions (nuisance,): the fit's, or where those leave the tolerance far behind the best inside it."""
    deviations = f.fit.tuning * f.tuning.spread
    if np.any(np.abs(deviations) > WIDEST * tolerance):
        deviations = bounded(f.tuning, f.group.residual - f.fit.response, f.fit.tuning, WIDEST * tolerance) * f.tuning.spread
    return f.tuning.base + deviations


def _named(found: Sequence[Found], machine: Machine) -> list[tuple[Setting, Found, float]]:
    """Effects of all groups, most certain first, with their probability in the round that accepted them."""
    out = []
    for f in found:
        for setting in f.fit.settings:
            probability = CONFIDENCE
            for candidates in f.rounds:
                for candidate, p in zip(candidates, probabilities_of(candidates)):
                    if candidate.key == (setting.effect.name, setting.axis, setting.from_axis):
                        probability = p
            if is_plausible(setting, machine):
                out.append((setting, f, probability * (STANDS_IN if is_unknown(f) else 1.0)))
    strength = {id(f): closed(f) for f in found}
    return sorted(out, key=lambda item: -strength[id(item[1])])


def is_unknown(f: Found) -> bool:
    """Is something left of a group of axes that no effect found explains, or is what was found one thing in one run and another in the next?"""
    excess_before, excess = excess_of(f.group, f.retuned), excess_of(f.group, f.fit)
    there = excess > NOTICED_EXCESS * expected_loss(f.group) or _localised(f)
    return (there and excess > REMAINING * max(excess_before, 1e-9)) or is_systematic(f) or differs_between_runs(f)


def _verdict(found: Sequence[Found], settings: Sequence[Any]) -> str:
    """'effect', 'none', or 'unknown' where something is left that no effect explains."""
    if any(is_unknown(f) for f in found):
        return "unknown"
    return "effect" if settings else "none"


def _localised(f: Found) -> bool:
    """Is something left in one channel of one run, although the whole looks like noise?"""
    for channel, u in settled_channels(f):
        if channel.name != "controller" and len(u) > 1000 and float(np.mean(u**2)) > 1.6:
            return True
        if channel.name == "controller" and float(np.mean(u**2)) > 4.0:
            return True
    return False


def _retuned_share(found: Sequence[Found], tolerance: float) -> float:
    """Share of the squared gap above noise that re-tuning within the tolerance closes by itself."""
    before = after = 0.0
    for f in found:
        theta = retuned_within(f, tolerance).tuning
        left = f.group.residual - f.retuned.about.jacobian @ theta
        noise = sum(len(c.residual) / c.correlation for c in f.group.channels)
        was, now = (float(np.sum(f.group.in_noise(rows) ** 2)) for rows in (f.group.residual, left))
        before += max(was - noise, 0.0)
        after += max(now - noise, 0.0)
    return float(np.clip(1.0 - after / before, 0.0, 1.0)) if before > 0 else 0.0


def _held_out_gaps(
    campaign: Campaign, machine: Machine, found: Sequence[Found], folds: Sequence[Sequence[int]], quick: bool
) -> tuple[dict[str, dict[str, dict[str, dict[str, SignalGap]]]], dict[str, dict[str, Prediction]]]:
    """Gap of every run with the nominal machine and with the machine fitted without that run, in MuJoCo; and what was simulated for it."""
    realisations = 2 if quick else REALISATIONS
    before = predict_campaign(machine, campaign.runs, realisations=realisations)
    predictions: dict[str, dict[str, Prediction]] = {"before": before, "after": {}}
    gaps: dict[str, dict[str, dict[str, dict[str, SignalGap]]]] = {"before": {}, "after": {}}
    for run in campaign.runs:
        gaps["before"][run.name] = gap_of(machine, run, before[run.name])
    for fold in folds:
        variant = machine
        settings: list[Setting] = []
        for f in found:
            shift, tuning_shift = leave_out(f, fold) if len(folds) > 1 else (np.zeros(len(f.fit.free)), np.zeros(len(f.fit.tuning)))
            moved = f.fit.settings
            for free, step in zip(f.fit.free, np.clip(shift, -3.0, 3.0)):
                moved = free.moved(moved, float(step))
            settings += moved
            deviations = within(f, machine.parameter_tolerance)
            # what all runs together say is not there does not appear because the one that says so is left out
            absent = [
                n.quantity in SPRINGS and d < LEAST_SHARE * machine.parameter_tolerance for n, d in zip(f.tuning.nuisances, deviations)
            ]
            deviations = deviations + np.where(absent, 0.0, tuning_shift * f.tuning.spread)
            most = WIDEST * machine.parameter_tolerance
            variant = tuned(f.tuning.nuisances, np.clip(deviations, -most, most))(variant)
        runs: list[MeasuredRun] = [campaign.runs[i] for i in fold]
        after = predict_campaign(with_added(variant, settings), runs, realisations=1 if quick else realisations)
        if quick:  # one realisation has no scatter of its own
            after = {name: replace(prediction, scatter=before[name].scatter) for name, prediction in after.items()}
        predictions["after"] |= after
        for run in runs:
            gaps["after"][run.name] = gap_of(machine, run, after[run.name])
    return gaps, predictions


def _recorded(axis: Axis, signal: str, campaign: Campaign) -> bool:
    """Is a signal recorded in any run? The command of an axis without current loop stands for its current; one encoder is enough."""
    if signal == "position" and axis.encoder == "motor":
        return True
    if signal in ("velocity", "velocity_setpoint") and not axis.has_speed_integral and axis.loops.speed_mean_cycles:
        signal = axis.effort  # the law of both controllers is seen in the command as a whole
    return any(run.trace.has(axis.name, axis.effort if signal == "current" else signal) for run in campaign.runs)


def _notes(campaign: Campaign, machine: Machine) -> list[str]:
    """What the recorded signals leave open."""
    notes = []
    axes = sorted({a for run in campaign.runs for a in run.trace.axes})
    for signal, lost in (
        ("motor_position", "transmission and measurement cannot be cut from the mechanics"),
        ("velocity_setpoint", "the position controller cannot be cut from the speed controller"),
        ("current", "controller, motor and load cannot be told apart"),
        ("velocity", "the speed controller cannot be cut"),
        ("position", "what the scale sees is not known"),
    ):
        lacking = [a for a in axes if not _recorded(machine.axis(a), signal, campaign)]
        if lacking:
            notes.append(f"no {signal} of axis {', '.join(lacking)}: {lost}")
    if len(campaign.runs) == 1:
        notes.append("a single run: nothing could be left out of the fit")
    return notes
