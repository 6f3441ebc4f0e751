"""The files of a diagnosis: JSON, corrected machine, report, recording, and next measurement."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.next_measurement import Proposal
from twin.diagnose.recording import write_recording_of
from twin.diagnose.report import write_report
from twin.diagnose.wording import (
    calibration_text,
    closed_texts,
    effect_line,
    percent,
    place_text,
    unseen_text,
    verdict_sentence,
    where_text,
)
from twin.files import output_folder, write_json
from twin.machine.machine import write_machine
from twin.recordings.trace import write_trace
from twin.system import shell_word
from twin.units import plain


def write_diagnosis(diagnosis: Diagnosis, out: Path) -> dict[str, Any]:
    """Write all files to a folder; returns the document of `diagnosis.json`."""
    document = diagnosis.document()
    for name in ("next_measurement.csv", "machine.toml"):  # commands are printed as they can be given, from the present folder
        document["next_measurement"] = document["next_measurement"].replace(name, shell_word(out / name))
    output_folder(out)
    write_json(document, out / "diagnosis.json", "diagnosis")
    write_machine(diagnosis.corrected, out / "machine.toml")
    write_proposal(diagnosis.proposal, out / "next_measurement.csv")
    with ThreadPoolExecutor(max_workers=1) as pool:  # the recording mostly waits for compiled code and files
        recording = pool.submit(write_recording_of, diagnosis, document, out / "diagnosis.rrd")
        write_report(diagnosis, document, out / "report.html")
        recording.result()
    return document


def write_proposal(proposal: Proposal, path: Path) -> None:
    """Write the move of a next measurement; without one, delete the file of an earlier diagnosis."""
    path.unlink(missing_ok=True)
    if proposal.move is not None:
        write_trace(proposal.move, path)


def summary_text(document: dict[str, Any]) -> str:
    """The verdict in a few lines for the terminal."""
    gap = document["gap"]
    lines = [verdict_sentence(document)]
    lines += [f"  {e['effect']} on {place_text(e)} ({e['block']}): {effect_line(document, e)}" for e in document["effects"]]
    lines += [f"  {closed}" for closed in closed_texts(document)]
    for law in document.get("laws", ()):
        lines.append(
            f"  law on {law['axis']} ({law['block']}): {law['sentence']}; {law['formula']}; probability {law['probability']:.2f}, "
            f"explains {percent(law['explained'])} of the gap of the axis that the effects leave"
        )
    if document["calibrated"]:
        lines.append(
            f"  calibrated, because the file had only assumed or tried it or its controller, or has it in its interval: {calibration_text(document)}"
        )
    lines += [f"  where: {where_text(place)}" for place in document["where"][:3]]
    lines.append(
        f"  gap over noise {plain(gap['before'])} before and {plain(gap['after'])} after correction; re-tuning within tolerance closes {percent(gap['retuning_share'])} of it"
    )
    for rival in document["ambiguous_with"]:
        lines.append(f"  could also be: {rival['effect']} on {place_text(rival)} instead of {rival['instead_of']}")
    if document["not_visible"]:
        lines.append(f"  not visible in this campaign at usual size: {unseen_text(document)}")
    lines += [f"  note: {note}" for note in document["notes"]]
    lines.append(f"  next measurement: {document['next_measurement']}")
    return "\n".join(lines)
