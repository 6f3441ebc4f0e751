"""The answers of a study: effects, indices and surrogate of each response, Pareto front, best variant, factors without effect."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
import fnmatch
import itertools
from pathlib import Path
import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from twin.documents import reading
from twin.errors import InputError, nearest
from twin.recordings.table_file import read_parquet
from twin.study.design import problem_of
from twin.study.factors import Factor
from twin.study.outcomes import (
    Effect,
    Surrogate,
    Swing,
    depends,
    effects_of,
    pareto_front,
    sobol_of,
    surrogate_of,
    swings_of,
    without_effect,
)
from twin.study.spec import LIMITS, MARGINS, Study

Row = tuple[int, list[float], dict[str, float], str | None]
"""Number, factors, responses, reason."""

TABLE = "table.parquet"
SHOWN = 4
"""Number of responses in the report if the study file names none."""
SOMETIMES = ("phase_margin_", "gain_margin_", "crossover_", "bandwidth_", "settling_time_", "first_mode_", "holding_", "electrical_energy_")
"""Prefixes of responses that only some variants have, for example because a loop never reaches a gain of 1 or an axis never settles."""
OF_RATINGS = "_used_"
"""Part of the names of shares of ratings, which not every motor of a catalogue has."""
PREFERRED = ("mark_depth_um", "contour_error_max_um", "control_deviation_max", "current_rms", "copper_loss", "cycle_time_s")


@dataclass(frozen=True)
class Response:
    """One response over the variants that have it: factors (variant, factor), values (variant,), and its analysis."""

    name: str
    table: np.ndarray
    y: np.ndarray
    effects: list[Effect]
    surrogate: Surrogate | None
    swings: list[Swing]
    sobol: dict[str, list[float]] | None


@dataclass(frozen=True)
class Answers:
    """All answers. Effects, `pareto` and `best` (least `minimised`, None if there is none) use only variants that keep the constraints."""

    factors: tuple[str, ...]
    rows: Sequence[Row]
    responses: list[Response]
    without_effect: list[str]
    pareto: list[int]
    fronts: dict[tuple[str, str], list[int]]
    minimised: str
    best: int | None
    definitions: tuple[Factor, ...] = ()
    looked: tuple[str, ...] = ()
    """Names of the reported responses."""

    def shown(self, values: Sequence[float]) -> list[str]:
        """The factors of a variant as text, catalogue entries by name."""
        return [factor.shown(value) for factor, value in zip(self.definitions, values)]

    def value_text_of(self, name: str, value: float) -> str:
        """A value of one factor with its unit."""
        return self.definitions[self.factors.index(name)].value_text(value)

    def design_of(self, number: int) -> str:
        """The factors of a variant with names and units: 'screw lead 0.02 m/rev, rotor inertia 0.8 times nominal'."""
        return ", ".join(f"{factor.name} {factor.value_text(value)}" for factor, value in zip(self.definitions, self.row(number)[1]))

    @property
    def headings(self) -> list[str]:
        """The factors with their units, for tables."""
        return [factor.titled for factor in self.definitions]

    @property
    def failed(self) -> int:
        """Variants that could not be run."""
        return sum(not responses for _, _, responses, _ in self.rows)

    @property
    def broken(self) -> int:
        """Variants that ran and broke a constraint."""
        return sum(bool(responses) and reason is not None for _, _, responses, reason in self.rows)

    def commonest(self, ran: bool) -> str:
        """The most common reason, without numbers, of the variants that broke a constraint (`ran`) or could not be run."""
        # a variant counts once for each constraint that it breaks; the rest of an error message is its remedy
        parts = ((r.split("; ") if ran else [r.split("; ")[0]]) for _, _, responses, r in self.rows if r and bool(responses) == ran)
        numbers = re.compile(r"(?<![A-Za-z_])-?\d+(\.\d+)?(e[+-]?\d+)?")
        reasons = Counter(numbers.sub("..", part) for several in parts for part in several)
        return reasons.most_common(1)[0][0] if reasons else ""

    def row(self, number: int) -> Row:
        """The row of a variant. Raises InputError if a damaged file lacks it."""
        if (found := next((row for row in self.rows if row[0] == number), None)) is None:
            raise InputError(f"variant {number}: its row is missing in the file of the study; give another --out, or run it again")
        return found

    def document(self) -> dict[str, Any]:
        """The content of study.json."""
        out: dict[str, Any] = {"variants": len(self.rows), "could_not_be_run": self.failed, "broke_a_limit": self.broken, "responses": {}}
        for r in self.responses:
            out["responses"][r.name] = {
                "least": float(r.y.min()),
                "largest": float(r.y.max()),
                "effects": [{"factors": list(e.factors), "half_change": e.value, "low": e.low, "high": e.high} for e in r.effects],
                "surrogate": r.surrogate and {"kind": r.surrogate.kind, "error": r.surrogate.error, "spread": r.surrogate.spread},
                "swings": [asdict(s) for s in r.swings],
                **({"sobol": r.sobol} if r.sobol else {}),
            }
        out["without_effect"], out["pareto"] = self.without_effect, self.pareto
        out["fronts"] = [{"of": list(pair), "variants": front} for pair, front in self.fronts.items()]
        if self.best is not None:
            number, factors, responses, _ = self.row(self.best)
            chosen = {f.name: f.shown(v) for f, v in zip(self.definitions, factors) if f.choices}
            out["best"] = {"variant": number, "minimises": self.minimised, "factors": dict(zip(self.factors, factors))}
            out["best"] |= {**({"choices": chosen} if chosen else {}), "responses": responses}
        return out


def known_responses(rows: Sequence[Row]) -> list[str]:
    """Names of all responses, in order of appearance."""
    return list(dict.fromkeys(name for _, _, found, _ in rows for name in found))


def looked_at(study: Study, rows: Sequence[Row]) -> list[str]:
    """Responses of the report: those of the study file, otherwise the preferred ones that vary."""
    known = known_responses(rows)
    if known:
        check_names(study, known)
    if study.answer:
        return list(study.answer)
    ranked = sorted(known, key=lambda n: next((i for i, p in enumerate(PREFERRED) if n.startswith(p)), len(PREFERRED)))
    return [name for name in ranked if depends(values_of(rows, name)[1])][:SHOWN]


def check_names(study: Study, known: Collection[str], some_variants: bool = False) -> None:
    """Raise InputError if `answer`, `pareto` or a constraint names an unknown response.

    `known` are the responses of all variants, or of `some_variants`: then names that other variants may have are accepted.
    """
    known = list(known)
    asked = [("answer", name) for name in study.answer] + [("pareto", name) for pair in study.pareto for name in pair]
    asked += [
        ("constraint", c.response) for c in study.constraints if c.response not in (MARGINS, LIMITS)
    ]  # the standing ones are not asked for
    for key, name in asked:
        found = fnmatch.filter(known, name) if key == "constraint" else name in known
        own = name.rpartition(".")[2]
        if found or (some_variants and (own.startswith((*SOMETIMES, "*")) or OF_RATINGS in own)):
            continue
        raise InputError(f"{study.path}: {key}: no response '{name}'; {nearest(name, known)}; correct it and continue with --resume")


def values_of(rows: Sequence[Row], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Factors (variant, factor) and values (variant,) of the variants that have this response."""
    kept = [(factors, found[name]) for _, factors, found, _ in rows if name in found]
    return np.array([f for f, _ in kept]), np.array([v for _, v in kept])


def answers_of(study: Study, rows: Sequence[Row]) -> Answers:
    """Answer a study from its rows; raises InputError if `answer` names an unknown response."""
    names = tuple(f.name for f in study.factors)
    listed = {i: [choice.name for choice in f.choices] for i, f in enumerate(study.factors) if f.choices}
    looked = looked_at(study, rows)
    kept = [row for row in rows if row[3] is None]  # at a limit, the limit determines the response, not the factor
    responses = []
    for name in looked:
        table, y = values_of(kept, name)
        if len(y) < 2 or not depends(y):
            continue
        surrogate = surrogate_of(table, y, listed)
        effects = effects_of(names, table, y, listed) if surrogate is None or surrogate.fits else []
        swings = swings_of(names, table, y, surrogate, listed) if surrogate else []
        sobol = sobol_of(problem_of(study), y) if study.design.kind == "sobol" and len(y) == len(rows) else None
        responses.append(Response(name, table, y, effects, surrogate, swings, sobol))
    minimised = looked[0] if looked else ""
    fine = [row for row in kept if all(name in row[2] for name in looked)]
    goal = np.array([row[2].get(minimised, 0.0) for row in fine])
    idle = without_effect(names, [values_of(kept, name) for name in known_responses(kept)], listed) if len(kept) > 1 else []
    fronts = {pair: _front(kept, pair) for pair in (study.pareto or tuple(itertools.pairwise(looked[:2])))}
    best = fine[int(np.argmin(goal))][0] if looked and fine and (len(fine) == 1 or depends(goal)) else None
    return Answers(names, rows, responses, idle, _front(kept, looked), fronts, minimised, best, study.factors, tuple(looked))


def _front(rows: Sequence[Row], names: Sequence[str]) -> list[int]:
    """Numbers of the variants on the Pareto front of these responses."""
    able = [row for row in rows if all(name in row[2] for name in names)]
    values = np.array([[row[2][name] for name in names] for row in able]).reshape(len(able), len(names))
    return [row[0] for row, front in zip(able, pareto_front(values)) if front] if names else []


def table_of(study: Study, rows: Sequence[Row]) -> pa.Table:
    """Variant, factors, responses and reason, in the order of the design."""
    columns: dict[str, Any] = {"variant": pa.array([n for n, *_ in rows], pa.int64())}
    columns |= {f.name: pa.array([factors[i] for _, factors, _, _ in rows], pa.float64()) for i, f in enumerate(study.factors)}
    columns |= {
        f"{f.name}: choice": pa.array([f.shown(factors[i]) for _, factors, _, _ in rows]) for i, f in enumerate(study.factors) if f.choices
    }
    columns |= {name: pa.array([found.get(name) for _, _, found, _ in rows], pa.float64()) for name in known_responses(rows)}
    columns["reason"] = pa.array([reason for *_, reason in rows], pa.string())
    return pa.table(columns).replace_schema_metadata({"factors": "\n".join(f.name for f in study.factors)})


def surrogate_from(folder: str | Path, response: str) -> Callable[[Mapping[str, float | str]], tuple[float, float]]:
    """The surrogate of a finished study: a function from {factor: value or entry name} to (value, error).

    It is fitted to the variants that keep the constraints.
    """
    path = Path(folder) / TABLE
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the --out folder of a finished `twin study`")
    with reading(path, "table of a study", "run the study again with --resume"):
        table = read_parquet(path)
        names = table.schema.metadata[b"factors"].decode().split("\n")
    if response not in table.column_names:
        raise InputError(f"{path}: no response '{response}'; {nearest(response, table.column_names[len(names) + 1 : -1])}")
    columns = np.column_stack([table.column(name).to_numpy() for name in [*names, response]])
    kept = columns[np.isfinite(columns[:, -1]) & table.column("reason").is_null().to_numpy()]
    entries = {
        i: dict(zip(table.column(f"{name}: choice").to_pylist(), columns[:, i].tolist()))
        for i, name in enumerate(names)
        if f"{name}: choice" in table.column_names
    }
    surrogate = surrogate_of(kept[:, :-1], kept[:, -1], entries)
    if surrogate is None:
        raise InputError(f"{path}: {len(kept)} variants are too few for a surrogate of '{response}'; add some")

    def predict(factors: Mapping[str, float | str]) -> tuple[float, float]:
        for name in factors:
            if name not in names:
                raise InputError(f"{path}: no factor '{name}'; {nearest(name, names)}")
        missing = [name for name in names if name not in factors]
        if missing:
            raise InputError(f"{path}: factor '{missing[0]}' is missing; give a value for each of {', '.join(names)}")
        row = []
        for i, name in enumerate(names):
            value = factors[name]
            if isinstance(value, str) or i in entries:
                if value not in (known := entries.get(i, {})):
                    raise InputError(f"{path}: {name} = {value!r} was not simulated; {nearest(str(value), known)}")
                row.append(known[str(value)])
                continue
            low, high = kept[:, i].min(), kept[:, i].max()
            if not low <= value <= high:
                raise InputError(f"{path}: {name} = {value:g} lies outside what was simulated ({low:g} to {high:g})")
            row.append(value)
        return float(surrogate.predict(np.array([row]))[0]), surrogate.error

    return predict
