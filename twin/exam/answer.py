"""The answer to a case. The examined process seals it with a hash, so that a later change is noticed."""

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

MACHINE, BASELINES, DIAGNOSIS, SEAL, FAILED = "machine.toml", "baselines.json", "diagnosis.json", "answer.sha256", "failed.txt"


def write_answer(folder: Path, corrected: Machine, baselines: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> None:
    """Write corrected machine, baselines, seal and, last, the diagnosis: a case counts as answered when the diagnosis exists."""
    write_machine(corrected, folder / MACHINE)
    write_whole(folder / BASELINES, json.dumps(baselines, indent=1) + "\n")
    text = json.dumps(stamped(diagnosis, "diagnosis"), indent=1) + "\n"
    write_whole(folder / SEAL, _digest(folder, text.encode()) + "\n")
    write_whole(folder / DIAGNOSIS, text)


def read_answer(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """(diagnosis, baselines) of a sealed answer.

    Raises:
        InputError: a file differs from the sealed one.
    """
    try:
        same = (folder / SEAL).read_bytes().strip().decode("ascii", "replace") == _digest(folder, (folder / DIAGNOSIS).read_bytes())
    except OSError:
        same = False
    if not same:
        raise InputError(f"{folder}: this answer is not what was sealed; remove the folder to have the case diagnosed again")
    return read_json_table(folder / DIAGNOSIS), read_json_table(folder / BASELINES)


def _digest(folder: Path, diagnosis: bytes) -> str:
    files = ((folder / name).read_bytes() for name in (MACHINE, BASELINES))
    return hashlib.sha256(b"\0".join([*files, diagnosis])).hexdigest()
