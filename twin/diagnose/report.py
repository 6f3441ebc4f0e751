"""The report of a diagnosis: one self-contained page, verdict first, evidence below."""

from __future__ import annotations

from pathlib import Path
import shlex
from typing import Any

import jinja2

from twin.diagnose.budget import overlap_text
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.evidence import blocks_map, retuned_values, run_levels, stretches
from twin.diagnose.law.figures import laws_figure
from twin.diagnose.report_figures import as_image, budget_figure, map_figure, stretch_figure, waterfall_figure
from twin.diagnose.wording import (
    calibration_text,
    effect_title,
    parameters_of,
    percent,
    sentence_case,
    times,
    unseen_text,
    verdict_sentence,
)
from twin.effects import EFFECTS
from twin.files import write_whole
from twin.report.stamp import made_line
from twin.units import ARCSEC, plain

CANDIDATES_SHOWN = 12
STRETCHES_SHOWN = 3


def write_report(diagnosis: Diagnosis, document: dict[str, Any], path: Path) -> None:
    """Write the page. Raises InputError if the file cannot be written."""
    write_whole(path, report_page(diagnosis, document, path.parent))


def report_page(diagnosis: Diagnosis, document: dict[str, Any], folder: Path = Path()) -> str:
    """The page as HTML; `folder` holds the corrected machine."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("twin.diagnose", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters.update(
        percent=percent, plain=plain, times=times, effect_title=effect_title, parameters=parameters_of, sentence_case=sentence_case
    )
    axes, blocks = blocks_map(diagnosis, document)
    run_axes, runs = run_levels(diagnosis)
    return environment.get_template("report.html.j2").render(
        document=document,
        made=made_line(),
        campaign=diagnosis.campaign,
        corrected=shlex.quote(str(folder / "machine.toml")),
        machine=diagnosis.machine,
        seconds=sum(float(run.trace.time[-1] - run.trace.time[0]) for run in diagnosis.campaign.runs),
        verdict=verdict_sentence(document, numbers=True),
        unseen=unseen_text(document),
        calibration=calibration_text(document),
        numbers=gap_sentence(document),
        summaries={name: effect.summary for name, effect in EFFECTS.items()},
        telling=telling_gaps(document),
        overlap=overlap_text(document["budget"]) if document["budget"] else "",
        budget=as_image(budget_figure(document["budget"])) if document["effects"] else "",
        program_picture=as_image(budget_figure(document["budget_on_program"])) if document["effects"] and diagnosis.on_program else "",
        waterfall=as_image(waterfall_figure(diagnosis.waterfall)),
        map=as_image(map_figure(axes, blocks)),
        curves=[(s, as_image(stretch_figure(diagnosis, s))) for s in stretches(diagnosis, document)[:STRETCHES_SHOWN]],
        run_axes=run_axes,
        runs=runs,
        candidates=document["candidates"][:CANDIDATES_SHOWN],
        retuned=_retuned_table(diagnosis),
        stiffness=lambda table: _stiffness(diagnosis, table),
        laws_picture=as_image(laws_figure(diagnosis.laws, diagnosis.machine)) if diagnosis.laws else "",
    )


def gap_sentence(document: dict[str, Any]) -> str:
    """How far the gap shrinks, in multiples of noise."""
    gap = document["gap"]
    where = "held-out runs" if gap["held_out_runs"] else "the runs of the fit"
    if not document["effects"] and not document.get("laws"):
        return f"The gap is {times(gap['before'])} times the noise, after re-tuning within tolerance {times(gap['after'])} times."
    return f"The correction reduces the gap from {times(gap['before'])} to {times(gap['after'])} times the noise, on {where}."


def telling_gaps(document: dict[str, Any]) -> list[dict[str, Any]]:
    """For each axis with an effect its worst signal over noise: axis, signal, before, after, noise_floor, unit."""
    rows = []
    for axis in dict.fromkeys(e["axis"] for e in document["effects"]):
        signals = {name: g for name, g in document["gap"]["axes"].get(axis, {}).items() if g["noise_floor"] > 0}
        if signals:
            name = max(signals, key=lambda s: signals[s]["before"] / signals[s]["noise_floor"])
            rows.append({"axis": axis, "signal": name.replace("_", " "), **signals[name]})
    return rows


def _stiffness(diagnosis: Diagnosis, table: dict[str, Any]) -> str:
    """Stiffness of a normal imperfection in data-sheet units."""
    linear = diagnosis.machine.axis(table["axis"]).kind == "linear"
    return f"{plain(table['stiffness'] * 1e-6)} N/um" if linear else f"{plain(table['stiffness'] * ARCSEC)} Nm/arcsec"


def _retuned_table(diagnosis: Diagnosis) -> dict[str, Any]:
    """Deviations by owner (row) and quantity (column), as text; empty where a parameter is not re-tuned."""
    values = retuned_values(diagnosis)
    quantities = list(dict.fromkeys(quantity for _, quantity, _ in values))
    owners = list(dict.fromkeys(owner for owner, _, _ in values))
    cells = {(owner, quantity): deviation for owner, quantity, deviation in values}
    return {"quantities": quantities, "rows": [(owner, [_signed_percent(cells.get((owner, q))) for q in quantities]) for owner in owners]}


def _signed_percent(fraction: float | None) -> str:
    """A deviation in percent with its sign; 0 has none."""
    if fraction is None:
        return ""
    rounded = round(100.0 * fraction, 2)
    return f"{rounded:+.2f} %" if rounded else "0.00 %"
