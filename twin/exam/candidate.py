"""The examined process: it reads one campaign and one machine file and writes one diagnosis. It gets nothing else.

    python -m twin.exam.candidate CAMPAIGN MACHINE OUT [--quick]

Writes diagnosis.json and machine.toml as `twin diagnose` does.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from twin.diagnose import diagnose
from twin.errors import TwinError
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.stopping import end_with_parent

from .answer import write_answer


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m twin.exam.candidate", description="diagnose one campaign of an examination")
    parser.add_argument("campaign", type=Path)
    parser.add_argument("machine", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    end_with_parent()
    try:
        machine = load_machine(given.machine)
        diagnosis = diagnose(read_campaign(given.campaign, machine), machine, quick=given.quick, threads=1)  # one process per core
    except TwinError as error:
        print(f"twin.exam.candidate: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    write_answer(given.out, diagnosis.corrected, diagnosis.document())
    return 0


if __name__ == "__main__":
    sys.exit(main())
