#!/usr/bin/env python3
"""docs/pictures/regress_failed.png: what a failed case leaves, on a machine whose X friction is 2 % up."""

from pathlib import Path
import sys
import tempfile

from twin.machine.machine import load_machine
from twin.regress.compare import compare
from twin.regress.evidence import write_evidence
from twin.regress.golden import read_golden
from twin.regress.run_suite import sentence
from twin.regress.runners import run_case
from twin.regress.suite import Case, read_suite
from twin.regress.where import place_of

HERE = Path(__file__).resolve().parents[1]
CASE = "x_feedforward_torque"


def main() -> int:
    case = next(c for c in read_suite(HERE / "examples/regression/nominal.toml") if c.name == CASE)
    golden = read_golden(case)
    friction = load_machine().document["axis"]["X"]["coulomb_friction_nm"]
    changed = Case(case.name, case.kind, case.file, {**case.table, "values": {"axis.X.coulomb_friction_nm": 1.02 * friction}})
    outcome = run_case(changed)
    checks = compare(case, golden, outcome)
    assert golden.trace is not None
    assert outcome.trace is not None
    assert outcome.machine is not None
    place = place_of(outcome.machine, golden.trace, outcome.trace, checks)
    assert place is not None
    text = sentence(case, checks, place, outcome.failed)
    with tempfile.TemporaryDirectory() as folder:
        write_evidence(Path(folder), case, golden, outcome, checks, place, text)
        out = HERE / "docs/pictures/regress_failed.png"
        out.write_bytes((Path(folder) / "plot.png").read_bytes())
    print(f"{out}: {text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
