"""The twin by its commands: `twin identify` for numbers with intervals, `twin diagnose` for causes and the corrected machine."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import subprocess
import sys
from typing import Any

from twin.machine.machine import load_machine
from twin.simulation.plant_spec import with_commissioned_inertia

from .answer import Answer
from .inputs import Input
from .numbers import MECHANICS


def ran(*words: str | Path) -> tuple[float, str]:
    """Run a command of the twin; processor time of its process [s] and what it said to stderr. Raises CalledProcessError."""
    import resource  # not on Windows

    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-m", "twin", *map(str, words)], capture_output=True, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stderr


def identified(one: Input, out: Path) -> Answer:
    """The machine of `twin identify`."""
    file, result = out / "identified" / "machine.toml", out / "identified.json"
    try:
        seconds, _ = ran("identify", one.campaign, "--machine", one.file, "--out", file, "--json", result)
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()[-1].removeprefix("twin: ").replace(f"{file}: ", "").split("; see ")[0]
        return Answer(one.machine, {}, f"refused: {said}", lines=1)
    document = json.loads(result.read_text(encoding="utf-8"))
    machine = with_commissioned_inertia(load_machine(file))
    says = "; ".join(f["text"] for f in document["findings"]) or "no finding"
    return Answer(machine, intervals_of(document, one), says, cpu_s=seconds, lines=1)


def intervals_of(document: dict[str, Any], one: Input) -> dict[str, tuple[float, float, float] | None]:
    """The identified numbers at the axis with their intervals."""
    (axis,) = one.machine.axes
    names = {"constant_torque": "constant_force"}
    factor = {
        "inertia": axis.ratio**-2,
        "viscous_friction": axis.ratio**-2,
        "coulomb_friction": 1 / axis.ratio,
        "constant_force": 1 / axis.ratio,
    }
    found: dict[str, tuple[float, float, float] | None] = {}
    for p in document["parameters"]:
        name = names.get(p["name"], p["name"])
        if name in MECHANICS and p["axis"] == axis.name and p.get("value") is not None:
            found[name] = tuple(factor[name] * p[key] for key in ("value", "low", "high"))  # type: ignore[assignment]
    return found


def diagnosed(one: Input, out: Path, *options: str) -> Answer:
    """The corrected machine of `twin diagnose`."""
    seconds, _ = ran("diagnose", one.campaign, "--machine", one.file, "--out", out / "diagnosis", *options)
    document = json.loads((out / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    causes = tuple(e["effect"] for e in document["effects"])
    laws = [f"a law over {', '.join(law['variables'])}" for law in document.get("laws", ())]
    machine = with_commissioned_inertia(load_machine(out / "diagnosis" / "machine.toml"))
    parts = [f"{e['effect']} {e['probability']:.2f}" for e in document["effects"]] + laws
    says = f"verdict {document['verdict']}: {', '.join(parts) or 'nothing added'}"
    return replace(Answer(machine, {}, says, causes, cpu_s=seconds, lines=1), verdict=document["verdict"])
