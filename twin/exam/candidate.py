"""The examined process: it reads one campaign and one machine file and writes one diagnosis. It gets nothing else.

    python -m twin.exam.candidate CAMPAIGN MACHINE OUT [--quick]

Writes diagnosis.json and machine.toml as `twin diagnose` does.
"""

from pathlib import Path
import sys

from twin.diagnose import diagnose
from twin.errors import TwinError
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.stopping import end_with_parent

from .answer import write_answer


def main() -> int:
    campaign, machine_file, out, *quick = sys.argv[1:]
    end_with_parent()
    try:
        machine = load_machine(machine_file)
        diagnosis = diagnose(read_campaign(campaign, machine), machine, quick=bool(quick), threads=1)  # one process per core
    except TwinError as error:
        print(f"twin.exam.candidate: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    write_answer(Path(out), diagnosis.corrected, diagnosis.document())
    return 0


if __name__ == "__main__":
    sys.exit(main())
