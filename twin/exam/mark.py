"""Marking one answer: what was named against what was there, and how far the gap shrinks on runs that only the examination knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import json
import math
from pathlib import Path
import tomllib
from typing import Any

import numpy as np

from twin.campaign import MeasuredRun, read_campaign
from twin.effects import EFFECTS, with_effects
from twin.effects.truth import true_machine
from twin.gap import SignalGap, gap_of, predict_campaign
from twin.machine import Machine, load_machine

from .draw import Case, truth_of, write_campaign
from .questions import Question

REALISATIONS = 2

Gaps = dict[str, dict[str, dict[str, SignalGap]]]


def mark(question: Question, case: Case, folder: str, machine_file: str) -> dict[str, Any]:
    """The mark of one case, kept in `mark.json`."""
    place = Path(folder)
    kept = place / "mark.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))  # type: ignore[no-any-return]
    truth = truth_of(case)
    result: dict[str, Any] = {
        "case": question.name,
        "stratum": question.stratum.name,
        "scale": case.scale,
        "true": [[e["name"], e["axis"]] for e in truth["effect"]],
        "outside": [[e["name"], e["axis"], e["block"]] for e in truth["outside"]],
    }
    failure = place / "answer" / "failed.txt"
    if failure.exists():
        result["failed"] = failure.read_text(encoding="utf-8").strip()
    else:
        answer = json.loads((place / "answer" / "diagnosis.json").read_text(encoding="utf-8"))
        result |= mark_answer(truth, answer)
        result["baselines"] = {
            name: _marked_baseline(truth, said)
            for name, said in json.loads((place / "answer" / "baselines.json").read_text(encoding="utf-8")).items()
        }
        result["gap"] = _exam_gap(case, truth, place, machine_file)
    kept.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def mark_answer(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """What a `diagnosis.json` says against a truth."""
    true = {(e["name"], e["axis"]) for e in truth["effect"]}
    named = [(e["effect"], e["axis"]) for e in answer["effects"]]
    if truth["outside"]:
        right = answer["verdict"] == "unknown"
        places = {(e["axis"], e["block"]) for e in truth["outside"]}
    else:
        right = answer["verdict"] == ("effect" if true else "none") and set(named) == true
        places = {(e["axis"], EFFECTS[e["name"]].block) for e in truth["effect"]}
    rivals = {(r["effect"], r["axis"]) for r in answer["ambiguous_with"] if named and r["instead_of"] == named[0][0]}
    located = [(e["axis"], e["block"]) for e in answer["effects"]] or [(w["axis"], w["block"]) for w in answer["where"][:1]]
    return {
        "verdict": answer["verdict"],
        "named": [list(n) for n in named],
        "ambiguous": sorted(list(r) for r in rivals),
        "first": bool(named and named[0] in true) if true else right,
        "first_or_ambiguous": bool((named and named[0] in true) or rivals & true) if true else right,
        "exact": bool(right),
        "place": bool(located and located[0] in places) if places else right,
        "probabilities": [[e["probability"], (e["effect"], e["axis"]) in true] for e in answer["effects"]],
        "parameters": _parameters(truth, answer),
        "retuning_share": answer["gap"].get("retuning_share"),
    }


def _parameters(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Error and coverage of every scored parameter of the effects that were rightly named."""
    rows = []
    for said in answer["effects"]:
        for e in truth["effect"]:
            if (e["name"], e["axis"]) != (said["effect"], said["axis"]):
                continue
            for parameter in EFFECTS[e["name"]].parameters:
                if parameter.shape or parameter.name not in e or parameter.name not in said["parameters"]:
                    continue
                value, true = said["parameters"][parameter.name], float(e[parameter.name])
                off = _apart(value["value"], true, parameter.periodic)
                size = math.pi if parameter.periodic else abs(true - 1.0) if parameter.name == "factor" else abs(true)
                half = 0.5 * (value["high"] - value["low"])
                middle = 0.5 * (value["high"] + value["low"])
                rows.append(
                    {
                        "effect": e["name"],
                        "axis": e["axis"],
                        "parameter": parameter.name,
                        "true": true,
                        "value": value["value"],
                        "error": abs(off) / size,
                        "covered": bool(abs(_apart(middle, true, parameter.periodic)) <= half),
                    }
                )
    return rows


def _apart(a: float, b: float, periodic: bool) -> float:
    return (a - b + math.pi) % (2.0 * math.pi) - math.pi if periodic else a - b


def _marked_baseline(truth: Mapping[str, Any], said: Mapping[str, Any]) -> dict[str, Any]:
    true = {(e["name"], e["axis"]) for e in truth["effect"]}
    named = (said["effect"], said["axis"])
    first = named in true if true else said["verdict"] == ("unknown" if truth["outside"] else "none")
    return {**said, "first": bool(first), "exact": bool(first and len(true) <= 1)}


def _exam_gap(case: Case, truth: Mapping[str, Any], place: Path, machine_file: str) -> dict[str, Any]:
    """Gap on the exam's own runs, in multiples of what noise makes: nominal, corrected, and with the truth in the twin (the floor).

    `size` is what the effects alone change of the twin, in the same unit: how far they stand out of the noise."""
    machine = load_machine(machine_file)
    folder = place / "exam runs"
    if not (folder / "campaign.toml").exists():
        write_campaign(case, folder, tomllib.loads(Path(machine_file).read_text(encoding="utf-8")), runs="exam")
    runs = read_campaign(folder, machine).runs
    corrected = load_machine(place / "answer" / "machine.toml")
    exact = true_machine(machine, truth)
    before = predict_campaign(machine, runs, realisations=REALISATIONS)
    out: dict[str, Any] = {"before": _level(_gaps(machine, runs, before)), "noise": 1.0}
    out["after"] = _level(_gaps(machine, runs, predict_campaign(corrected, runs, realisations=REALISATIONS)))
    true_gaps = _gaps(machine, runs, predict_campaign(exact, runs, realisations=REALISATIONS))
    if not truth["outside"]:
        out["floor"] = _level(true_gaps)
    if not truth["outside"] and not truth["effect"]:
        out["same_parameters"] = _position_um(true_gaps)
    if truth["effect"]:
        with_effect = predict_campaign(with_effects(machine, truth["effect"]), runs, realisations=REALISATIONS)
        alone = {run.name: gap_of(machine, replace(run, trace=with_effect[run.name].trace), before[run.name]) for run in runs}
        axes = {e["axis"] for e in truth["effect"]}
        levels = [g.rms / g.noise for run in alone.values() for axis, s in run.items() if axis in axes for g in s.values() if g.noise > 0]
        out["size"] = float(np.sqrt(np.mean(np.square(levels)))) if levels else 0.0
    return out


def _gaps(machine: Machine, runs: tuple[MeasuredRun, ...], predictions: Mapping[str, Any]) -> Gaps:
    return {run.name: gap_of(machine, run, predictions[run.name]) for run in runs}


def _level(gaps: Gaps) -> float:
    """RMS over runs, axes and signals of gap over noise."""
    ratios = [g.rms / g.noise for run in gaps.values() for signals in run.values() for g in signals.values() if g.noise > 0 and g.rms > 0]
    return float(np.sqrt(np.mean(np.square(ratios))))


def _position_um(gaps: Gaps) -> dict[str, float]:
    """RMS of the scale position over the runs, by axis [um or arcsec]."""
    axes = sorted({axis for run in gaps.values() for axis in run})
    return {
        a: float(np.sqrt(np.mean([run[a]["position"].rms ** 2 for run in gaps.values() if a in run and "position" in run[a]])))
        for a in axes
    }
