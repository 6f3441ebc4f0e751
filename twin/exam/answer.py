"""The answer to a case. The examined process seals it with a hash, so that a later change is noticed."""

from collections.abc import Mapping
import hashlib
import json
from pathlib import Path
from typing import Any

from twin.documents import read_json
from twin.errors import InputError
from twin.files import stamped, write_whole
from twin.machine.machine import Machine, write_machine

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
