"""The answer to a case: what the examined process wrote, sealed by itself, so that no answer is changed after it was given."""

from __future__ import annotations

from collections.abc import Mapping
import hashlib
import json
from pathlib import Path
from typing import Any

from twin.documents import read_json_table
from twin.errors import InputError
from twin.files import stamped, write_whole
from twin.machine.machine import Machine, write_machine

MACHINE, BASELINES, DIAGNOSIS, SEAL = "machine.toml", "baselines.json", "diagnosis.json", "answer.sha256"


def write_answer(folder: Path, corrected: Machine, baselines: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> None:
    """Write the corrected machine, what simpler methods say, the seal of all, and the diagnosis last: with it the case is answered."""
    folder.mkdir(parents=True, exist_ok=True)
    write_machine(corrected, folder / MACHINE)
    write_whole(folder / BASELINES, json.dumps(baselines, indent=1) + "\n")
    text = json.dumps(stamped(diagnosis, "diagnosis"), indent=1) + "\n"
    write_whole(folder / SEAL, _digest(folder, text.encode()) + "\n")
    write_whole(folder / DIAGNOSIS, text)


def read_answer(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """(diagnosis, baselines) as they were given.

    Raises:
        InputError: a file is not what was sealed.
    """
    try:
        same = (folder / SEAL).read_bytes().strip().decode("ascii", "replace") == _digest(folder, (folder / DIAGNOSIS).read_bytes())
    except OSError:
        same = False
    if not same:
        raise InputError(f"{folder}: this answer is not what was sealed; remove the folder, and the case is asked again")
    return read_json_table(folder / DIAGNOSIS), read_json_table(folder / BASELINES)


def _digest(folder: Path, diagnosis: bytes) -> str:
    files = ((folder / name).read_bytes() for name in (MACHINE, BASELINES))
    return hashlib.sha256(b"\0".join([*files, diagnosis])).hexdigest()
