"""The source of a remedy: a diagnosis with the intervals of its effects, or a machine file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.documents import read_json
from twin.errors import InputError
from twin.remedy.predict import NORMAL_95
from twin.remedy.remedy import Deviations


def machine_file_of(source: Path) -> tuple[Path, Mapping[str, Any]]:
    """(machine file with effects, document of the diagnosis or empty). Raises InputError for anything else."""
    if source.suffix == ".toml" and source.is_file():
        return source, {}
    document = source / "diagnosis.json" if source.is_dir() else source
    if not document.is_file() or document.suffix != ".json":
        raise InputError(f"{source}: give the folder of a diagnosis, its diagnosis.json, or a machine file (.toml)")
    machine = document.parent / "machine.toml"
    if not machine.is_file():
        raise InputError(f"{document.parent}: the corrected machine.toml is missing; diagnose again")
    return machine, read_json(document)


def deviations_of(document: Mapping[str, Any]) -> Deviations:
    """Standard deviations of the parameters of the effects of a diagnosis, from their 95 % intervals."""
    out: dict[tuple[str, str, str | None], dict[str, float]] = {}
    for effect in document.get("effects", []):
        own = {
            name: (p["high"] - p["low"]) / (2.0 * NORMAL_95)
            for name, p in effect.get("parameters", {}).items()
            if isinstance(p.get("low"), int | float) and isinstance(p.get("high"), int | float)
        }
        out[effect["effect"], effect["axis"], effect.get("from_axis")] = own
    return out
