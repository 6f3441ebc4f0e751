"""Marks one answer: named effects against the true ones, and the remaining gap on runs that the diagnosis did not get.

Of an everyday machine the stated budget is marked against the true one. Effects below `VISIBLE` times the noise need not be named, and their
probabilities are not scored. Naming them is no error either, because they are present.
"""

from collections.abc import Mapping, Sequence
import contextlib
from dataclasses import replace
import hashlib
import json
import math
from pathlib import Path
from typing import Any

from scipy.stats import kendalltau

from twin.documents import read_json, read_toml
from twin.effects import EFFECTS, with_effects
from twin.effects.truth import true_machine
from twin.errors import InputError, TwinError
from twin.files import write_whole
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.simulation.encoder_zeros import aligned
from twin.simulation.gap import Prediction, gap_of, predict_campaign
from twin.simulation.gap_level import levels, overall

from .candidate import FAILED, MACHINE, read_answer
from .draw import Case, truth_of, write_campaign
from .mark_law import laws_of_fault, shape_agreement
from .questions import Question
from .session import write_machine_of

NO_ANSWER: dict[str, Any] = {"verdict": "not diagnosed", "effects": [], "ambiguous_with": [], "where": [], "gap": {}}
"""What a case without a diagnosis is marked as: wrong in every respect."""

VISIBLE = 3.0
"""Above this multiple of the noise an effect must be named."""

LARGEST = 5
"""Number of largest contributions whose order is marked."""

What = tuple[str, str, str]
"""Effect, axis, and source axis ('' if none)."""


def what_of(e: Mapping[str, Any]) -> What:
    """The identity of an effect in a truth, an answer or a budget."""
    return e.get("effect") or e["name"], e["axis"], e.get("from_axis", "")


def mark(question: Question, case: Case, folder: str, machine_file: str) -> dict[str, Any]:
    """The mark of one case, kept in `mark.json`."""
    place = Path(folder)
    kept = place / "mark.json"
    if (before := kept_mark(kept)) is not None:
        return before
    truth = truth_of(case)
    machine_file = str(write_machine_of(question, machine_file, place))
    result: dict[str, Any] = {
        "case": question.name,
        "stratum": question.stratum.name,
        "scale": case.scale,
        "true": [[e["name"], e["axis"]] for e in truth["effect"]],
        "outside": [[e["name"], e["axis"], e["block"]] for e in truth["outside"]],
    }
    failure = place / "answer" / FAILED
    answer = NO_ANSWER if failure.exists() else read_answer(place / "answer")
    result |= mark_answer(truth, answer)
    result["shape"] = min((shape_agreement(e, answer, load_machine(machine_file)) for e in truth["outside"]), default=None)
    if failure.exists():
        result["failed"] = failure.read_text(encoding="utf-8", errors="replace").strip()
    result["gap"] = _exam_gap(case, truth, place, machine_file)
    write_whole(kept, json.dumps({**result, "sha256": digest_of(result)}, indent=1) + "\n")
    return result


def kept_mark(file: Path) -> dict[str, Any] | None:
    """The mark of an earlier call; None if it is missing or was changed since, so that it is made again."""
    try:
        result = read_json(file)
    except InputError:
        return None
    return result if result.pop("sha256", None) == digest_of(result) else None


def digest_of(result: Mapping[str, Any]) -> str:
    """SHA-256 of a mark."""
    return hashlib.sha256(json.dumps(result).encode()).hexdigest()


def mark_answer(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Mark of a `diagnosis.json` against the truth."""
    true = [what_of(e) for e in truth["effect"]]
    named = [what_of(e) for e in answer["effects"]]
    places = {(e["axis"], e["block"]) for e in truth["outside"]} or {(e["axis"], EFFECTS[e["name"]].block) for e in truth["effect"]}
    if truth["outside"]:
        right = answer["verdict"] in ("unknown", "law")
    elif "budget" in truth:
        visible = {what_of(row) for row in truth["budget"] if row["times_noise"] >= VISIBLE}
        right = answer["verdict"] == ("effect" if visible else "none") and visible <= set(named) <= set(true)
    else:
        right = answer["verdict"] == ("effect" if true else "none") and sorted(named) == sorted(true)
    rivals = [
        what_of(r) for r in answer["ambiguous_with"] if named and (r["instead_of"], r.get("instead_of_axis", named[0][1])) == named[0][:2]
    ]
    # one effect is named, and the true one is among its rivals
    rightly_ambiguous = answer["verdict"] == "effect" and len(named) == 1 and any(r in true for r in rivals)
    located = [(e["axis"], e["block"]) for e in [*answer["effects"], *answer.get("laws", ())]] or [
        (w["axis"], w["block"]) for w in answer["where"][:1]
    ]
    return {
        "verdict": answer["verdict"],
        "named": [list(n[:2]) for n in named],
        "ambiguous": sorted(list(r[:2]) for r in rivals),
        "first": bool(named and named[0] in true) if true else right,
        "first_or_ambiguous": bool(right or rightly_ambiguous) if true else right,
        "exact": bool(right),
        "place": bool(located and located[0] in places) if places else right,
        "law": any(laws_of_fault(e, answer) for e in truth["outside"]) if truth["outside"] else None,
        "probabilities": [[e["probability"], what_of(e) in true] for e in answer["effects"]],
        "parameters": _parameters(truth, answer),
        "retuning_share": answer["gap"].get("retuning_share"),
        "budget": mark_budget(truth, answer) if "budget" in truth else None,
    }


def mark_budget(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Marks of one case; `recall` and `precision` are pairs (right, of), `order` is Kendall's tau (None for fewer than two effects)."""
    true = {what_of(row): float(row["times_noise"]) for row in truth["budget"]}
    named = {what_of(e) for e in answer["effects"]}
    visible = {what for what, size in true.items() if size >= VISIBLE}
    rows = (answer.get("budget") or {}).get("rows", [])
    said = {what_of(row): float(row["times_noise"]) for row in rows if row.get("kind", "effect") == "effect"}
    largest = sorted(true, key=lambda what: -true[what])
    return {
        "recall": [len(visible & named), len(visible)],
        "precision": [len(named & set(true)), len(named)],
        "largest": bool(largest[0] in named) if visible else None,
        "order": _order([true[w] for w in largest[:LARGEST]], [said.get(w, 0.0) for w in largest[:LARGEST]]),
        "contributions": [{"effect": w[0], "axis": w[1], "true": true[w], "said": said.get(w) if w in named else None} for w in largest],
        "candidates": [[p, there] for p, there in _candidates(true, answer)],
    }


def _order(true: Sequence[float], said: Sequence[float]) -> float | None:
    """Kendall's tau of two rankings; 0 if all stated values are equal."""
    if len(true) < 2:
        return None
    tau = float(kendalltau(true, said).statistic)
    return tau if math.isfinite(tau) else 0.0


def _candidates(true: Mapping[What, float], answer: Mapping[str, Any]) -> list[tuple[float, bool]]:
    """(probability, is present) of every candidate; a visible effect that was neither tried nor named has probability 0."""
    stated: dict[What, float] = {}
    for e in answer.get("candidates", []):
        stated[what_of(e)] = max(stated.get(what_of(e), 0.0), float(e["probability"]))
    stated |= {what_of(e): float(e["probability"]) for e in answer["effects"]}
    asked = sorted(set(stated) | {w for w, size in true.items() if size >= VISIBLE})
    return [(stated.get(w, 0.0), w in true) for w in asked if w not in true or true[w] >= VISIBLE]


def _parameters(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Error and coverage of every scored parameter of the correctly named effects."""
    rows = []
    effects = {what_of(e): e for e in truth["effect"]}
    for said in answer["effects"]:
        e = effects.get(what_of(said), {})
        for parameter in EFFECTS[e["name"]].parameters if e else ():
            if parameter.shape or parameter.name not in e or parameter.name not in said["parameters"]:
                continue
            value, true = said["parameters"][parameter.name], float(e[parameter.name])
            off = _apart(value["value"], true, parameter.periodic)
            size = math.pi if parameter.periodic else parameter.deviation(true)
            half, middle = 0.5 * (value["high"] - value["low"]), 0.5 * (value["high"] + value["low"])
            row = {"effect": e["name"], "axis": e["axis"], "parameter": parameter.name, "true": true, "value": value["value"]}
            rows.append({**row, "error": abs(off) / size, "covered": bool(abs(_apart(middle, true, parameter.periodic)) <= half)})
    return rows


def _apart(a: float, b: float, periodic: bool) -> float:
    return (a - b + math.pi) % (2.0 * math.pi) - math.pi if periodic else a - b


def _exam_gap(case: Case, truth: Mapping[str, Any], place: Path, machine_file: str) -> dict[str, Any]:
    """Gap on the exam's own runs, as a multiple of noise: `before` and `after` correction, and for comparison:

    floor         difference of two recordings of this machine, divided by sqrt 2
    true_effects  gap of the twin with the true parameters and effects
    size          change of the twin's signals by the true effects alone

    `after` is missing if the corrected machine cannot be simulated. Differences of the encoders' zeros are no gap, as in a diagnosis.
    """
    machine = load_machine(machine_file)
    other_noise = replace(case, noise_seed=case.seed + 1)
    runs, again = (_recorded(c, place / name, machine, machine_file) for c, name in ((case, "exam runs"), (other_noise, "exam runs again")))

    def predicted(of: Machine) -> dict[str, Prediction]:
        return predict_campaign(of, runs, realisations=2)

    def level_of(made: Mapping[str, Prediction | MeasuredRun]) -> float:
        traces = {name: one.trace for name, one in made.items()}
        gaps = {r.name: gap_of(machine, r, replace(before[r.name], trace=traces[r.name])) for r in aligned(runs, machine, traces)}
        return overall(levels(gaps))

    before = predicted(machine)
    out: dict[str, Any] = {"before": level_of(before), "floor": level_of({run.name: run for run in again}) / math.sqrt(2.0)}
    answer = place / "answer" / MACHINE
    if answer.exists():
        with contextlib.suppress(TwinError):
            out["after"] = level_of(predicted(load_machine(answer)))
    if not truth["outside"]:
        out["true_effects"] = level_of(predicted(true_machine(machine, truth)))
    if truth["effect"]:
        with_effect = predicted(with_effects(machine, truth["effect"]))
        alone = {run.name: gap_of(machine, replace(run, trace=with_effect[run.name].trace), before[run.name]) for run in runs}
        axes = {e["axis"] for e in truth["effect"]}
        of_them = {axis: level for axis, level in levels(alone).items() if axis in axes}
        out["size"] = overall(of_them) if of_them else 0.0
    return out


def _recorded(case: Case, folder: Path, machine: Machine, machine_file: str) -> tuple[MeasuredRun, ...]:
    if not (folder / "campaign.toml").exists():
        write_campaign(case, folder, read_toml(Path(machine_file)), runs="exam")
    return read_campaign(folder, machine).runs
