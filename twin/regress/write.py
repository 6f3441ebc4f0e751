"""Writes verdicts as a table, JUnit XML and JSON."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from twin.files import write_json, write_whole
from twin.regress.failed_case import check_table
from twin.regress.golden import versions
from twin.regress.run_suite import BROKEN, FAILED, SKIPPED, Verdict
from twin.simulation.summary import table

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def verdict_table(verdicts: Sequence[Verdict]) -> str:
    """One line per case, then a sentence for each that did not pass."""
    rows = []
    for v in verdicts:
        worst = v.worst
        nearest = f"{worst.quantity} {min(worst.excess, 1e6):.2g}" if worst else "-"
        rows.append([v.case.name, v.case.kind, v.status, f"{v.seconds:.1f} s", str(len(v.checks)), nearest])
    lines = [table(["case", "kind", "verdict", "time", "checks", "largest difference over tolerance (1 = limit)"], rows, left=3)]
    for v in verdicts:
        if v.status != "passed":
            lines.append(f"{v.status}: {v.case.name}: {v.text}" + (f" [{v.written}]" if v.written else ""))
    lines += filter(None, [lead_sentence(verdicts)])
    notes = {v.note for v in verdicts if v.note}
    lines += [f"note: {note}" for note in sorted(notes)]
    return "\n".join(lines)


def most_named(verdicts: Sequence[Verdict], what: str) -> tuple[str, int]:
    """The axis or the block (`what`) that most failed cases name, and their number; ('', 0) if none names one."""
    named = Counter(word for v in verdicts if v.place and (word := getattr(v.place, what)))
    return next(iter(named.most_common(1)), ("", 0))


def lead_sentence(verdicts: Sequence[Verdict]) -> str:
    """What most failed cases name, in words; '' if no case failed."""
    (axis, of_axis), (block, of_block) = (most_named(verdicts, what) for what in ("axis", "block"))
    failed = sum(v.place is not None for v in verdicts)
    named = [f"axis {axis} in {of_axis}"] * bool(axis) + [f"{block} in {of_block}"] * bool(block)
    return f"most named in {failed} failed cases: {', '.join(named)}" if named else ""


def counts(verdicts: Sequence[Verdict]) -> str:
    """'31 passed, 1 failed, 1 skipped'."""
    found = Counter(v.status for v in verdicts)
    return ", ".join(f"{found[status]} {status}" for status in ("passed", FAILED, BROKEN, SKIPPED) if found[status])


def document(verdicts: Sequence[Verdict], seconds: float) -> dict[str, Any]:
    """The content of regress.json."""
    return {
        "verdict": "failed" if any(v.status in (FAILED, BROKEN) for v in verdicts) else "passed",
        "versions": versions(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": seconds,
        "first": {what: most_named(verdicts, what)[0] for what in ("axis", "block")},
        "cases": [
            {
                "name": v.case.name,
                "kind": v.case.kind,
                "status": v.status,
                "seconds": v.seconds,
                "text": v.text,
                "note": v.note,
                "place": asdict(v.place) if v.place else None,
                "evidence": str(v.written) if v.written else None,
                "checks": [check_table(c) for c in v.checks],
            }
            for v in verdicts
        ],
    }


def junit(verdicts: Sequence[Verdict], seconds: float) -> ElementTree.Element:
    """`<testsuites><testsuite><testcase>` for CI servers."""
    number = Counter(v.status for v in verdicts)
    totals = {
        "tests": str(len(verdicts)),
        "failures": str(number[FAILED]),
        "errors": str(number[BROKEN]),
        "skipped": str(number[SKIPPED]),
        "time": f"{seconds:.3f}",
    }
    root = ElementTree.Element("testsuites", {"name": "twin regress", **{k: v for k, v in totals.items() if k != "skipped"}})
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    suite = ElementTree.SubElement(root, "testsuite", {"name": "twin.regress", **totals, "timestamp": stamp})
    properties = ElementTree.SubElement(suite, "properties")
    for name, value in versions().items():
        ElementTree.SubElement(properties, "property", {"name": name, "value": value})
    for v in verdicts:
        attributes = {"name": v.case.name, "classname": f"twin.regress.{v.case.kind}", "time": f"{v.seconds:.3f}"}
        one = ElementTree.SubElement(suite, "testcase", attributes)
        if v.status == SKIPPED:
            ElementTree.SubElement(one, "skipped", {"message": _plain(v.text)})
        elif v.status in (FAILED, BROKEN):
            tag, kind = ("failure", "regression") if v.status == FAILED else ("error", "cannot run")
            element = ElementTree.SubElement(one, tag, {"message": _plain(v.text), "type": kind})
            failed = sorted((c for c in v.checks if not c.ok), key=lambda c: -c.excess)
            element.text = _plain("\n".join(c.text for c in failed))
        if v.note:
            ElementTree.SubElement(one, "system-out").text = _plain(v.note)
    ElementTree.indent(root)
    return root


def write_results(verdicts: Sequence[Verdict], seconds: float, junit_file: Path, json_file: Path) -> None:
    """Write the JUnit XML and the JSON file."""
    write_whole(junit_file, ElementTree.tostring(junit(verdicts, seconds), encoding="unicode", xml_declaration=True) + "\n")
    write_json(document(verdicts, seconds), json_file, "regress")


def _plain(text: str) -> str:
    """Replace characters that XML does not allow."""
    return _NOT_XML.sub("?", text)
