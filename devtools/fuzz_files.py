"""Spoilt files of every kind that a command reads: machine, model, campaign, map, study, suite, part, trace, mesh, height map, readings, options.

A sample that is in order is made small, one of its files spoilt (values that no code expects, keys and elements moved, bytes changed), and the command
carried out in this process. Done or refused in one line is right; all else is a fault. Driven by `scripts/fuzz`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import functools
import json
import os
from pathlib import Path
import random
import re
import struct
from typing import Any

from devtools import fuzz_programs
from devtools.fuzz_loop import Case, called

ROOT = Path(__file__).resolve().parents[1]
Files = Mapping[str, bytes]
"""Name below a folder -> content."""

VALUES = (
    "[]", "{}", '""', "[[1]]", "[1, 2]", '["X"]', '{ a = 1 }', "true", "false", "nan", "inf", "-inf", "0", "-1", "1e308", "-1e308", "1e-308",
    "1e9", "1e-9", "1e15", "9223372036854775807", "1" + "0" * 30, "1979-05-27", "07:32:00", '"\\u0000"', '"../../x"', '"/etc/hostname"', '"."',
    '"$x_{"', '"<b>&"', '"a/b"', '"' + "x" * 400 + '"', '"é\\n"', "12345678901234567890123", "0.5", "3", "1000000000", '"X"', '"-nan"',
)  # fmt: skip
"""What a value of a TOML file becomes."""
WORDS = (
    "",
    "nan",
    "inf",
    "-1",
    "0",
    "1e300",
    "1e-300",
    "1 2",
    "1 2 3 4 5",
    "x",
    "999999999",
    "../x",
    "/etc/hostname",
    "é",
    "-0",
    "1,5",
    "[]",
    "true",
)
"""What an attribute or a cell becomes."""


def replaced(line: str, value: str) -> str:
    """A line of TOML with another value; a name that is printed is never the word `nan`, which is looked for in what is printed."""
    key = line.split("=", 1)[0]
    return key + "= " + ("1" if key.strip() == "name" and value == "nan" else value)


def spoil_toml(text: str, rng: random.Random) -> str:
    """Another value, key, table or order."""
    lines = text.split("\n")
    settable = [i for i, line in enumerate(lines) if re.match(r"\s*[\w.\"*]+\s*=", line)]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        i = rng.choice(settable or [0])
        what = rng.randrange(10)
        if what < 6 and settable:
            lines[i] = replaced(lines[i], rng.choice(VALUES))
        elif what == 6:
            lines[i] = ""
        elif what == 7:
            lines.insert(i, rng.choice(lines))
        elif what == 8 and settable:
            key, _, value = lines[i].partition("=")
            lines[i] = rng.choice(("x" + key, key.strip() + ".a ", '"a b" ', "name ", "model ", "effect ", "axis ", key)) + "=" + value
        else:
            j = rng.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
    return "\n".join(lines)


def spoil_xml(text: str, rng: random.Random) -> str:
    """Another attribute, element or order."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        what = rng.randrange(8)
        attributes = list(re.finditer(r'(\w+)="([^"]*)"', text))
        elements = list(re.finditer(r"<(\w+)[^<>]*/>", text))
        if what < 4 and attributes:
            m = rng.choice(attributes)
            value = rng.choice((*WORDS, rng.choice(attributes)[2]))
            if value == "nan" and m[1] in _NAMES:  # is printed, and what is printed is looked at for it
                value = "x"
            text = text[: m.start(2)] + value + text[m.end(2) :]
        elif what == 4 and attributes:
            m = rng.choice(attributes)
            text = text[: m.start()] + text[m.end() :]
        elif what == 5 and elements:
            m, n = rng.choice(elements), rng.choice(elements)
            text = text[: n.start()] + m[0] + text[n.start() :]
        elif what == 6 and elements:
            m = rng.choice(elements)
            text = text[: m.start()] + text[m.end() :]
        elif elements:
            m = rng.choice(elements)
            text = text[: m.start()] + rng.choice(_ELEMENTS) + text[m.start() :]
    return text


_NAMES = ("name", "link", "joint", "body", "mesh", "model", "prefix")
_ELEMENTS = (
    '<replicate count="99999999"><geom size="1"/></replicate>', '<hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/>',
    '<texture name="t" type="2d" builtin="flat" width="99999" height="99999"/>', '<include file="m.xml"/>', '<include file="/etc/hostname"/>',
    '<mesh name="q" file="../a.stl"/>', "<freejoint/>", '<joint type="ball"/>', "<body/>", '<body name="a"/>', '<geom type="mesh" mesh="q"/>',
    '<flexcomp name="f" type="grid" count="99 99 99"/>', '<site name="s" size="nan"/>', '<camera name="c" resolution="99999 99999"/>',
    '<composite type="cable" count="9999 1 1"/>', '<joint name="j" type="slide" range="1 -1"/>', '<size memory="999G"/>', "<link/>", "<joint/>",
    '<default class="x"/>', '<option timestep="-1"/>', '<inertial pos="0 0 0" mass="1e300" diaginertia="1 1 1e-300"/>', '<mesh filename="package://../x"/>',
    '<numeric name="n" size="2000000000"/>', '<key name="k" qpos="1 2 3 4 5 6 7"/>', '<general joint="nothing"/>', '<attach model="m" body="b" prefix="p"/>',
)  # fmt: skip


def spoil_table(text: str, rng: random.Random) -> str:
    """Another cell, heading, row or delimiter."""
    rows = [line.split(",") for line in text.strip("\n").split("\n")]
    for _ in range(rng.choice((1, 1, 2, 3))):
        i = rng.choice((0, rng.randrange(len(rows))))
        j = rng.randrange(max(1, len(rows[i])))
        what = rng.randrange(8)
        if what < 4 and rows[i]:
            rows[i][min(j, len(rows[i]) - 1)] = rng.choice((*WORDS, "1e6", "18446744073709551615", "2024-01-01", "a$b_{c", "\u00fc"))
        elif what == 4:
            rows[i] = rows[i] + [rng.choice(WORDS)]
        elif what == 5:
            rows[i] = rows[i][:-1]
        elif what == 6 and len(rows) > 2:
            k = rng.randrange(len(rows))
            rows[i], rows[k] = rows[k], rows[i]
        else:
            rows = rows[: rng.randrange(len(rows)) + 1]
    return "\n".join(",".join(row) for row in rows) + "\n"


def spoil_json(text: str, rng: random.Random) -> str:
    """Another value somewhere."""
    document = json.loads(text)
    at, key = document, None
    for _ in range(8):
        if not isinstance(at, dict | list) or not at:
            break
        key, holder = (rng.choice(list(at)) if isinstance(at, dict) else rng.randrange(len(at))), at
        at = at[key]
        if rng.random() < 0.3:
            break
    if key is not None:
        holder[key] = rng.choice([None, [], {}, "", "x", -1, 1e308, 10**30, True, [[1]], {"a": 1}, "\0", 0])
    return json.dumps(document)


def spoil_bytes(content: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, the end cut off, or a number made large."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 2, 5, 20))):
        what = rng.randrange(5)
        at = rng.randrange(max(1, len(data)))
        if what == 0 and data:
            data[at] = rng.randrange(256)
        elif what == 1:
            del data[at : at + rng.randrange(64)]
        elif what == 2:
            data[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(16)))
        elif what == 3 and rng.random() < 0.3:
            del data[at:]
        elif len(data) > 8:
            data[at : at + 4] = struct.pack("<I", rng.choice((0, 0xFFFFFFFF, 0x7FFFFFFF, 1 << 20, 1 << 30)))
    return bytes(data)


SPOIL: dict[str, Callable[[str, random.Random], str]] = {
    ".toml": spoil_toml, ".xml": spoil_xml, ".urdf": spoil_xml, ".csv": spoil_table, ".json": spoil_json,
    ".mpf": fuzz_programs.mutate, ".ngc": fuzz_programs.mutate, ".nc": fuzz_programs.mutate, ".apt": fuzz_programs.mutate,
}  # fmt: skip


def spoil(file: Path, rng: random.Random) -> None:
    """Spoil one file in its way; now and then by its bytes."""
    by_text = SPOIL.get(file.suffix)
    content = file.read_bytes()
    if by_text is None or rng.random() < 0.1:
        file.write_bytes(spoil_bytes(content, rng))
    else:
        text = by_text(content.decode(errors="replace"), rng)
        file.write_bytes(text.encode(rng.choice(("utf-8",) * 12 + ("latin-1", "utf-16")), errors="replace"))


@functools.cache
def samples() -> dict[str, dict[str, bytes]]:
    """Kind -> files that are in order, small enough that a command takes a second at most; the first is spoilt most often."""
    import numpy as np

    from tests.builders.small_machine import MJCF, TOML

    examples = ROOT / "examples"
    # a move of 50 samples: U 1 mm to and fro
    swing = [f"{i * 1e-3:.3f},{0.5 * (1 - np.cos(2 * np.pi * i / 50)):.6f}" for i in range(51)]
    trace = "time [s],U.setpoint [mm]\n" + "\n".join(swing) + "\n"
    measured = (
        "time [s],U.setpoint [mm],U.position [mm],U.current [A]\n" + "\n".join(f"{row},{row.split(',')[1]},0.1" for row in swing) + "\n"
    )
    small = {"small.toml": TOML.encode(), "small.xml": MJCF.encode(), "move.csv": trace.encode()}
    study = (
        'machine = "small.toml"\n[[run]]\ninput = "move.csv"\n[[factor]]\nname = "mass"\npath = "axis.U.moving_mass_kg"\nrange = [60.0, 70.0]\n'
        '[[constraint]]\nresponse = "cycle_time_s"\nmost = 9.0\n[design]\nkind = "grid"\nlevels = 2\n'
    )
    suite = (
        '[[case]]\nname = "a"\nkind = "run"\nmachine = "small.toml"\ninput = "move.csv"\ncompare = ["position"]\nfeedforward = "off"\n'
        '[case.tolerance.position]\nrms = 1.0\nmax = 2.0\nunit = "um, arcsec"\nreason = "as much as an hour changes"\n[case.tolerance.summary]\nrelative = 0.01\nabsolute = 0.0\nreason = "as much as an hour changes"\n'
        '[case.tolerance.events]\ntime_s = 0.1\nreason = "as much as an hour changes"\n'
    )
    campaign = (
        'machine = "small"\n[[run]]\nfile = "a.csv"\nfeedforward = "velocity"\nstarted_at_s = 1.0\n[run.labels]\nload = 20.0\n'
        '[[run.channel]]\naxis = "U"\nsignal = "position"\nlatency_s = 0.0\n'
    )
    long = "time [s],U.setpoint [mm],U.position [mm],U.current [A]\n" + "".join(
        f"{i * 1e-3:.3f},{u:.6f},{u:.6f},{0.1 + 0.1 * np.sin(i / 9):.4f}\n" for i, u in enumerate(5.0 * (1 - np.cos(np.arange(700) / 60.0)))
    )
    turns = np.concatenate([np.linspace(0.0, 2.2 * np.pi, 200), np.linspace(2.2 * np.pi, 0.0, 200)])
    stops = np.concatenate([np.full(30, u) for u in (0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0, -1.0, 0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0)])
    circle, stairs = (
        "time [s],X.setpoint [mm],X.position [mm],Y.setpoint [mm],Y.position [mm]\n"
        + "".join(f"{i * 1e-2:.2f},{a:.6f},{a + 1e-3:.6f},{b:.6f},{b:.6f}\n" for i, (a, b) in enumerate(zip(x, y)))
        for x, y in ((10.0 * np.cos(turns), 10.0 * np.sin(turns)), (stops, 0.0 * stops))
    )
    numbers = np.arange(51, dtype=np.uint64)
    parquet = {"time [s]": numbers * 1e-3, "U.setpoint [mm]": numbers, "U.position [mm]": numbers.astype(np.int8)}
    part = (examples / "parts" / "part2_vertical_corner.toml").read_bytes()
    return {
        "machine": {**small},
        "model": {"small.xml": MJCF.encode(), "small.toml": TOML.encode(), "move.csv": trace.encode()},
        "model_new": {"m.xml": MJCF.encode()},
        "urdf": {"gantry.urdf": (examples / "gantry" / "gantry.urdf").read_bytes(), "spindle.stl": (examples / "gantry" / "spindle.stl").read_bytes()},
        "trace": {"move.csv": trace.encode(), **{k: v for k, v in small.items() if k != "move.csv"}},
        "campaign": {"campaign.toml": campaign.encode(), "a.csv": measured.encode(), **small},
        "diagnose": {"campaign.toml": campaign.encode(), "a.csv": measured.encode(), **small},
        "identify": {"campaign.toml": campaign.encode(), "a.csv": long.encode(), **small},
        "plan": {**small},
        "iso": {"circle.csv": circle.encode(), "stairs.csv": stairs.encode()},
        "table": {"t.parquet": _parquet(parquet), **small},
        "nc": {
            "p.mpf": b"G54 G90 G64\nDEF INT I\nR1=3\nFOR I=1 TO 2\nG1 X=I Y=R1 F5000\nG2 X=I+1 Y4 I0 J1 F3000\nENDFOR\nCYCLE83(5,0,2,-2,,-1,,1,0.1,0.1,1,1)\nG0 X0 Y0\nM30\n",
            "p.ngc": b"g21 g90 g17\n#1=2\ng0 x1 y1\ng1 x[#1*2] f3000\ng2 x5 y2 i0 j1\no1 if [#1 gt 1]\ng1 y0\no1 endif\nm2\n",
            "p.nc": b"%\nO1\nG21 G90 G17\n#100=2\nWHILE [#100 GT 0] DO1\nG1 X[#100*2.] F3000.\n#100=#100-1\nEND1\nG2 X2. Y4. R9.\nM30\n%\n",
            "p.apt": b"PARTNO/A\nUNITS/MM\nLOADTL/1\nFEDRAT/3000.0,MMPM\nRAPID\nGOTO/0,0,305\nGOTO/2.0,1.0,305.0\nDELAY/0.01\nGOTO/3.0,1.0,305.0\nFINI\n",
        },
        "map": {
            "map.toml": (examples / "traces" / "map.toml").read_bytes(),
            "x_feedforward_off.csv": b"".join((examples / "traces" / "x_feedforward_off.csv").read_bytes().splitlines(keepends=True)[:300]),
        },
        "study": {"study.toml": study.encode(), **small},
        "suite": {"suite.toml": suite.encode(), **small},
        "part": {"part.toml": part},
        "positions": {"positions.csv": (examples / "iso230" / "positions.csv").read_bytes()},
        "ballbar": {"ballbar.csv": (examples / "iso230" / "ballbar.csv").read_bytes()},
        "sinumerik": {"r.xml": (examples / "traces" / "x_velocity_feedforward.xml").read_bytes()},
    }  # fmt: skip


def commands(kind: str, here: Path, rng: random.Random) -> tuple[object, ...]:
    """A command that reads the files of a kind."""
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
    }
    command = rng.choice(table[kind])
    if command[0] == "interpolate":
        return (*command, "--out", here / "o.csv")
    return (*command, *out, "--no-recording") if command[0] == "run" and kind == "nc" else command


_PROGRAM: tuple[tuple[object, ...], ...] = (*[("check",)] * 3, *[("interpolate",)] * 3, ("run",))


def _parquet(columns: dict[str, Any]) -> bytes:
    """A Parquet file of columns, each in its own type."""
    import pyarrow as pa
    import pyarrow.parquet

    sink = pa.BufferOutputStream()
    pyarrow.parquet.write_table(pa.table(columns), sink)
    return bytes(sink.getvalue())


def laid(files: Files, folder: Path) -> None:
    """Write the files of a sample into a folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def told(name: str, command: tuple[object, ...], folder: Path, fault: str) -> str:
    """A fault with what led to it."""
    return f"{name}: twin {' '.join(str(a).replace(str(folder), '.') for a in command)}: {fault}" if fault else ""


def case_of(kind: str) -> Case:
    """The case of a kind: its files, one of them spoilt, through a command."""

    def case(seed: int, folder: Path) -> str:
        rng = random.Random(f"{kind} {seed}")
        files = samples()[kind]
        laid(files, folder)
        names = list(files)
        command = commands(kind, folder, rng)
        named = [name for name in names if folder / name in command]
        name = rng.choice(names) if rng.random() > 0.7 else named[0] if kind in ("nc", "iso") else names[0]
        spoil(folder / name, rng)
        return told(name, command, folder, called(command)[1])

    return case


OPTIONS = ("--out", "--machine", "--feedforward", "--json", "--seed", "--cases", "--zone-um", "--threads", "--jobs", "--precision", "--minutes",
           "--noise-seed", "--sample-period-ms", "--axis", "--plane", "--effect", "--only", "--size", "--at", "--limits", "--structure", "--part",
           "--level", "--place", "--radius-mm", "--resume", "--richness", "--program", "--input", "--update", "--reason", "--campaign", "--diagnosis", "--rate-hz", "--workers", "--html", "--plot", "--effects", "--map", "--torque-constant-within")  # fmt: skip
COMMANDS = (("run", "move.csv"), ("interpolate", "p.mpf"), ("check", "p.mpf"), ("cut", "p.mpf"), ("replay", "move.csv"), ("compare", ".", "."),
            ("effects", "backlash"), ("machine", "check"), ("machine", "new"), ("import", "move.csv"), ("plan", "--minutes", "0.1"), ("identify", "."), ("gap", "."),
            ("iso", "230-2", "move.csv"), ("iso", "230-4", "move.csv"), ("diagnose", "."), ("study", "s.toml"), ("regress", "s.toml"),
            ("demo", "--setpoints", "d.csv"), ("completion", "bash"), ("desk", "none"), ("exam", "--plan", "."), ("exam", "--cases", "0"))  # fmt: skip
ARGUMENTS = ("", "nan", "inf", "-1", "0", "1e300", "x", "é", "/dev/null/x", ".", "move.csv", "a=b", "backlash:X:clearance=nan", "backlash", "XY", "99999999999",
             "x" * 300, "1e-300", "*", "$HOME", "<b>", "none.toml", "a\nb", "backlash X clearance 1e300", "X", "programmed", "off")  # fmt: skip


def options(seed: int, folder: Path) -> str:
    """A command with options that nobody gives."""
    rng = random.Random(f"options {seed}")
    os.chdir(folder)  # what is given relative is written there
    (folder / "move.csv").write_text("time [s],X.setpoint [mm]\n0,0\n0.001,0\n0.002,0\n")
    (folder / "p.mpf").write_text("G1 X1 F100\nM30\n")
    (folder / "s.toml").write_text("x = 1\n")
    command = [str(folder / w) if "." in w and i else w for i, w in enumerate(rng.choice(COMMANDS))]
    for _ in range(rng.randrange(1, 4)):
        value = rng.choice(ARGUMENTS)
        command += [rng.choice(OPTIONS), str(folder / value) if value in ("move.csv", "none.toml") else value]
    if "--out" not in command and command[0] not in ("effects", "machine", "check", "gap", "iso"):
        command += ["--out", str(folder / ("o.csv" if command[0] == "interpolate" else "out"))]
    _, fault = called(tuple(command))
    return f"twin {' '.join(command)}: {fault}" if fault else ""


@functools.cache
def places() -> list[tuple[str, str, int, str]]:
    """(kind, file, line, value): every value that no code expects in the place of every value of every TOML file, in an order that mixes them."""
    files = [(kind, next(iter(files))) for kind, files in samples().items() if next(iter(files)).endswith(".toml")]
    found = []
    for kind, name in files:
        for i, line in enumerate(samples()[kind][name].decode().split("\n")):
            if re.match(r"\s*[\w.\"*]+\s*=", line):
                found += [(kind, name, i, value) for value in VALUES]
    random.Random(0).shuffle(found)
    return found


def every_value(seed: int, folder: Path) -> str:
    """One of `places`: seeds 0 to len(places()) - 1 are all of them."""
    kind, name, i, value = places()[seed % len(places())]
    for other, content in samples()[kind].items():
        (folder / other).write_bytes(content)
    lines = (folder / name).read_text(encoding="utf-8").split("\n")
    lines[i] = replaced(lines[i], value)
    (folder / name).write_text("\n".join(lines), encoding="utf-8")
    command = commands(kind, folder, random.Random(f"every value {seed}"))
    _, fault = called(command)
    return f"{name}: {lines[i][:80]}: twin {command[0]}: {fault}" if fault else ""


def all_kinds() -> dict[str, Case]:
    """Every kind of file, and the options."""
    return {**{kind: case_of(kind) for kind in samples()}, "options": options, "every_value": every_value}
