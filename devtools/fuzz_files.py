"""Kinds of the fuzzer: corrupted files of every kind that a command reads, and unusual options.

A case writes a small sample of `fuzz_samples`, corrupts one of its files and runs a command in this process.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import functools
import os
from pathlib import Path
import random
import re

from devtools.fuzz_loop import Case, called
from devtools.fuzz_samples import ROOT, Files, samples
from devtools.fuzz_spoil import VALUES, replaced, spoil


def commands(kind: str, here: Path, rng: random.Random) -> tuple[object, ...]:
    """A random command that reads the files of a kind in the folder `here`."""
    small, out = ("--machine", here / "small.toml"), ("--out", here / "out")
    machine = [("machine", "check", here / "small.toml"), ("machine", "show", here / "small.toml"),
               ("run", here / "move.csv", *small, *out, "--no-recording")]  # fmt: skip
    table: dict[str, list[tuple[object, ...]]] = {
        "machine": machine,
        "model": machine,
        "model_new": [
            ("machine", "new", here / "m.xml", "--out", here / "out" / "n.toml"),
            ("replay", here / "m.xml", "--out", here / "x.rrd"),
        ],
        "urdf": [
            ("machine", "new", here / "gantry.urdf", "--out", here / "out" / "n.toml"),
            ("replay", here / "gantry.urdf", "--out", here / "x.rrd"),
        ],
        "trace": [
            ("run", here / "move.csv", *small, *out, "--no-recording"),
            ("replay", here / "move.csv", *small, "--out", here / "x.rrd"),
        ],
        "campaign": [("gap", here, *small, "--json", here / "gap.json"), ("compare", here, here, *out, *small)],
        "diagnose": [("diagnose", here, *small, *out, "--quick")] * 8 + [("exam", "--plan", here, *small, *out)],
        "identify": [
            ("identify", here, *small, "--out", here / "out" / "m.toml", "--no-refine"),
            ("gap", here, *small),
            ("iso", "230-2", here, *small, "--json", here / "i.json"),
            ("replay", here, *small, "--out", here / "x.rrd"),
        ],
        "plan": [
            *[("plan", *small, *out, "--minutes", "0.1")] * 12,
            ("plan", *small, *out, "--minutes", "1"),
            ("machine", "show", here / "small.toml"),
            ("effects", "backlash", *small),
            ("demo", *small, *out),
        ],
        "iso": [
            ("iso", "230-4", here / "circle.csv", "--no-predict", "--json", here / "i.json", "--campaign", here / "out"),
            ("iso", "230-2", here / "stairs.csv", "--json", here / "i.json", "--axis", "X"),
        ],
        "table": [
            ("run", here / "t.parquet", *small, *out, "--no-recording"),
            ("import", here / "t.parquet", *out, "--no-picture"),
            ("compare", here / "t.parquet", here / "t.parquet", *small, *out),
        ],
        "nc": [(*c, here / f) for f in ("p.mpf", "p.mpf", "p.ngc", "p.nc", "p.apt") for c in _PROGRAM],
        "map": [("import", here / "x_feedforward_off.csv", "--map", here / "map.toml", *out, "--no-picture")],
        "study": [("study", here / "study.toml", *out, "--no-replay", "--threads", "1")],
        "suite": [("regress", here / "suite.toml", "--list"), ("regress", here / "suite.toml", *out, "--jobs", "1", "--no-evidence")],
        "part": [("cut", ROOT / "examples" / "x_200mm.csv", "--part", here / "part.toml", "--level", "commanded", *out, "--no-files")],
        "positions": [("iso", "230-2", here / "positions.csv", "--json", here / "out.json")],
        "ballbar": [("iso", "230-4", here / "ballbar.csv", "--json", here / "out.json", "--radius-mm", "100", "--no-predict")],
        "sinumerik": [("import", here / "r.xml", *out, "--no-picture")],
        "effects": [
            ("run", here / "move.csv", "--machine", here / "effects.toml", *out, "--no-recording"),
            ("machine", "check", here / "effects.toml"),
            ("compare", here / "effects.toml", here / "small.toml", "--input", here / "move.csv", *out),
        ],
        "design": [("study", here / "design.toml", *out, "--no-replay", "--threads", "1")],
        "archive": [
            ("machine", "new", here / "m.xml", "--sinumerik", here / name, "--out", here / "out" / "n.toml")
            for name in ("nc.tea", "data.toml")
        ],
        "events": [
            ("gap", here, *small),
            ("replay", here, *small, "--out", here / "x.rrd"),
            ("compare", here / "a.parquet", here / "a.parquet", *small, *out),
        ],
        "lab_axis": [
            *(("machine", action, here / "axis.toml") for action in ("check", "show")),
            ("run", here / "strokes.csv", "--machine", here / "axis.toml", *out, "--no-recording"),
        ],
        "mikron": [
            *(("machine", action, here / "mikron.toml") for action in ("check", "show")),
            *[("check", here / "p.mpf", "--machine", here / "mikron.toml")] * 2,
        ],
        "suites": [
            ("regress", here / "suites.toml", "--list"),
            ("regress", here / "suites.toml", *out, "--jobs", "1", "--no-evidence", "--update", "--reason", "the first result"),
        ],
        "height": [
            (
                "cut",
                here / "dip.csv",
                "--part",
                here / "dip.toml",
                "--measured",
                here / f"map.{ending}",
                "--level",
                "commanded",
                *out,
                "--no-files",
            )
            for ending in ("csv", "npz", "sur", "x3p")
        ],
    }
    command = rng.choice(table[kind])
    if command[0] == "interpolate":
        return (*command, "--out", here / "o.csv")
    return (*command, *out, "--no-recording") if command[0] == "run" and kind == "nc" else command


_PROGRAM: tuple[tuple[object, ...], ...] = (*[("check",)] * 3, *[("interpolate",)] * 3, ("run",))


def laid(files: Files, folder: Path) -> None:
    """Write the files of a sample to a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def told(name: str, command: tuple[object, ...], folder: Path, fault: str) -> str:
    """A fault with the file and the command that led to it."""
    return f"{name}: twin {' '.join(str(a).replace(str(folder), '.') for a in command)}: {fault}" if fault else ""


SEVERAL = ("nc", "iso", "archive", "height")
"""Kinds in which each command reads another file of the sample; in the other kinds every command reads the first one."""


def case_of(kind: str) -> Case:
    """The case function of a kind."""

    def case(seed: int, folder: Path) -> str:
        rng = random.Random(f"{kind} {seed}")
        files = samples()[kind]
        laid(files, folder)
        names = list(files)
        command = commands(kind, folder, rng)
        named = [name for name in names if folder / name in command]
        name = rng.choice(names) if rng.random() > 0.7 else named[0] if kind in SEVERAL else names[0]
        spoil(folder / name, rng)
        return told(name, command, folder, called(command)[1])

    return case


COMMANDS = (("run", "move.csv"), ("interpolate", "p.mpf"), ("check", "p.mpf"), ("check", "."), ("cut", "p.mpf"), ("replay", "move.csv"),
            ("compare", ".", "."), ("effects", "backlash"), ("machine", "check"), ("machine", "show"), ("machine", "new"), ("import", "move.csv"),
            ("plan", "--minutes", "0.1"), ("identify", "."), ("gap", "."), ("iso", "230-2", "move.csv"), ("iso", "230-4", "move.csv"), ("diagnose", "."),
            ("study", "s.toml"), ("regress", "s.toml"), ("completion", "bash"), ("desk", "none"),
            ("exam", "--plan", "."), ("exam", "--cases", "0"))  # fmt: skip
ARGUMENTS = ("", "nan", "inf", "-1", "0", "1e300", "x", "é", "/dev/null/x", ".", "move.csv", "a=b", "backlash:X:clearance=nan", "backlash", "XY", "99999999999",
             "x" * 300, "1e-300", "*", "$HOME", "<b>", "none.toml", "a\nb", "backlash X clearance 1e300", "X", "programmed", "off")  # fmt: skip
NOT_HERE = ("--open", "--serve", "--screenshot", "--scheduler")
"""Options that start a browser or a viewer, or connect to another computer."""


def flags_of(parser: argparse.ArgumentParser) -> Iterator[tuple[str, bool]]:
    """Options of a command and of its actions, each as (option, takes a value)."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in dict.fromkeys(action.choices.values()):
                yield from flags_of(sub)
        elif action.option_strings and action.option_strings[-1] not in NOT_HERE:
            yield action.option_strings[-1], action.nargs != 0


@functools.cache
def flags() -> dict[str, tuple[tuple[str, bool], ...]]:
    """`flags_of` every command, by its name."""
    from twin.cli.parser import build_parser

    commands = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return {name: tuple(dict.fromkeys(flags_of(sub))) for name, sub in commands.choices.items()}


def options(seed: int, folder: Path) -> str:
    """A command with unusual options and values, most of them its own options."""
    rng = random.Random(f"options {seed}")
    os.chdir(folder)  # relative paths lead here
    (folder / "move.csv").write_text("time [s],X.setpoint [mm]\n0,0\n0.001,0\n0.002,0\n")
    (folder / "p.mpf").write_text("G1 X1 F100\nM30\n")
    (folder / "s.toml").write_text("x = 1\n")
    command = [str(folder / w) if "." in w and i else w for i, w in enumerate(rng.choice(COMMANDS))]
    for _ in range(rng.randrange(1, 4)):
        option, takes = rng.choice(flags()[command[0] if rng.random() < 0.8 else rng.choice(list(flags()))])
        value = rng.choice(ARGUMENTS)
        command += [option, *([str(folder / value) if value in ("move.csv", "none.toml") else value] if takes else [])]
    if "--out" not in command and "--out" in dict(flags()[command[0]]) and command[0] != "machine":
        command += ["--out", str(folder / ("o.csv" if command[0] == "interpolate" else "out"))]
    _, fault = called(tuple(command))
    return f"twin {' '.join(command)}: {fault}" if fault else ""


@functools.cache
def places() -> list[tuple[str, str, int, str]]:
    """Every unexpected value at every place of every TOML sample, shuffled: (kind, file, line, value)."""
    files = [(kind, next(iter(files))) for kind, files in samples().items() if next(iter(files)).endswith(".toml")]
    found = []
    for kind, name in files:
        for i, line in enumerate(samples()[kind][name].decode().split("\n")):
            if re.match(r"\s*[\w.\"*]+\s*=", line):
                found += [(kind, name, i, value) for value in VALUES]
    random.Random(0).shuffle(found)
    return found


def every_value(seed: int, folder: Path) -> str:
    """One of `places`; the seeds from 0 to len(places()) - 1 cover all of them."""
    return value_at(*places()[seed % len(places())], random.Random(f"every value {seed}"), folder)


def value_at(kind: str, name: str, i: int, value: str, rng: random.Random, folder: Path) -> str:
    """The fault, or "", after line `i` of a file got another value."""
    laid(samples()[kind], folder)
    lines = (folder / name).read_text(encoding="utf-8").split("\n")
    lines[i] = replaced(lines[i], value)
    (folder / name).write_text("\n".join(lines), encoding="utf-8")
    command = commands(kind, folder, rng)
    return told(f"{name}: {lines[i][:80]}", command, folder, called(command)[1])


def all_kinds() -> dict[str, Case]:
    """All kinds of this module."""
    return {**{kind: case_of(kind) for kind in samples()}, "options": options, "every_value": every_value}
