"""The examined process: it reads one campaign and one machine file and writes one diagnosis. It gets nothing else.

    python -m twin.exam.candidate CAMPAIGN MACHINE OUT [--quick]

Writes diagnosis.json and machine.toml as `twin diagnose` does, and seals this answer with a hash, so that a later change is noticed.
"""

from collections.abc import Mapping
import hashlib
import json
from pathlib import Path
import sys
from typing import Any

from twin.documents import read_json
from twin.errors import InputError, TwinError
from twin.files import stamped, write_whole
from twin.machine.machine import Machine, load_machine, write_machine
from twin.recordings.campaign import read_campaign
from twin.stopping import end_with_parent

MACHINE, DIAGNOSIS, SEAL, FAILED = "machine.toml", "diagnosis.json", "answer.sha256", "failed.txt"


def write_answer(folder: Path, corrected: Machine, diagnosis: Mapping[str, Any]) -> None:
    """Write corrected machine, seal and, last, the diagnosis: a case counts as answered when the diagnosis exists."""
    write_machine(corrected, folder / MACHINE)
    text = json.dumps(stamped(diagnosis, "diagnosis"), indent=1) + "\n"
    write_whole(folder / SEAL, _digest(folder, text.encode()) + "\n")
    write_whole(folder / DIAGNOSIS, text)


def read_answer(folder: Path) -> dict[str, Any]:
    """The diagnosis of a sealed answer.

    Raises:
        InputError: a file differs from the sealed one.
    """
    try:
        same = (folder / SEAL).read_bytes().strip().decode("ascii", "replace") == _digest(folder, (folder / DIAGNOSIS).read_bytes())
    except OSError:
        same = False
    if not same:
        raise InputError(f"{folder}: this answer is not what was sealed; remove the folder to have the case diagnosed again")
    return read_json(folder / DIAGNOSIS)


def _digest(folder: Path, diagnosis: bytes) -> str:
    return hashlib.sha256(b"\0".join([(folder / MACHINE).read_bytes(), diagnosis])).hexdigest()


def main() -> int:
    from twin.diagnose import diagnose

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
