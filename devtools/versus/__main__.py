"""The twin beside other methods on the same inputs; see docs/versus.md.

    python -m devtools.versus --out DIR [--data ../shared/data] [--only NAME ...] [--peers]

Each input makes DIR/NAME.json, method by method; a later call keeps what is there and makes table and picture. Methods whose library is not
installed (pip install "twin[versus]") are left out and named.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import importlib.util
import json
from pathlib import Path
import sys
from typing import Any

from twin.errors import TwinError

from .answer import Answer, marked, timed
from .inputs import Input, Known, emps, kr300, made, recorded, simulated
from .picture import draw
from .simulated_fits import evolution_fit, least_squares_fit
from .sindy import sindy_fit
from .sysid import sysid_fit
from .table import put_into, results_in, table_text
from .twin_answers import diagnosed, identified

LIBRARY = {"mujoco.sysid": "absl", "CMA-ES (PACE)": "cma", "SINDy": "pysindy"}
"""Method -> module without which it cannot run (mujoco.sysid: from its extra)."""

RIVALS: dict[str, Callable[[Input], Answer]] = {
    "mujoco.sysid": sysid_fit,
    "CMA-ES (PACE)": evolution_fit,
    "least squares": least_squares_fit,
    "SINDy": sindy_fit,
}

DIAGNOSE, QUICK = "twin diagnose", "twin diagnose --quick"

CHANGES = {"inertia": 1.03, "coulomb_friction": 0.95, "viscous_friction": 1.04}
SIMULATED = {"numbers": (), "asymmetry": ({"name": "viscous_asymmetry", "axis": "X", "fraction": 0.15},)}
"""Effects of the small axes that the twin simulates itself, with CHANGES of their numbers; the tests use them, too."""

RECORDED = {  # name -> recording, axis, text
    "sinumerik": ("sinumerik/recording.json", "1", "SINUMERIK, axis 1"),
    "lorenz": ("recordings/lorenz_axis/Lorenz_Bm_1.txt", "X", "servo axis on a motion card"),
    "grinder": ("recordings/ideko_grinder/electrical_20230911.csv", "X", "grinder, axis X"),
}

MADE = {  # name -> kind, seed, axis
    "healthy": ("healthy", 5701, "X"),
    "one_effect": ("single", 5702, "X"),
    "outside": ("outside", 5703, "X"),
    "everyday": ("everyday", 5704, "X"),
    "one_effect_y": ("single", 5705, "Y"),
    "outside_y": ("outside", 5706, "Y"),
}


def inputs_of(data: Path | None, out: Path) -> dict[str, Callable[[], tuple[Input, Known]]]:
    """How each input is made, by name."""
    found: dict[str, Callable[[], tuple[Input, Known]]] = {}
    if data is not None and (data / "emps" / "DATA_EMPS.mat").is_file():
        found["emps"] = lambda: emps(data, out / "work" / "emps")
    if data is not None and (data / "kr300" / "FF_A.mat").is_file():
        found["kr300"] = lambda: kr300(data, out / "work" / "kr300")
    for name, (file, axis, text) in RECORDED.items():
        if data is not None and (data / file).is_file():
            found[name] = lambda name=name, file=file, axis=axis, text=text: recorded(data / file, axis, text, out / "work" / name)
    for name, effects in SIMULATED.items():
        found[name] = lambda name=name, effects=effects: simulated(out / "work" / name, CHANGES, effects)
    for name, (kind, seed, axis) in MADE.items():
        found[name] = lambda name=name, kind=kind, seed=seed, axis=axis: made(kind, seed, axis, out / "work" / name)
    return found


def missing() -> dict[str, str]:
    """Methods that cannot run here, with the reason."""
    return {m: f"{m}: {lib} is not installed" for m, lib in LIBRARY.items() if importlib.util.find_spec(lib) is None}


def compared(one: Input, known: Known, file: Path, work: Path, quick: bool) -> None:
    """All rows of an input, written to `file` one by one; rows that it holds are kept."""
    true = list(known.causes) if known.causes is not None else None
    result: dict[str, Any] = {"text": known.text, "causes": true, "outside": known.outside, "numbers": known.numbers, "rows": {}}
    if file.exists():
        result["rows"] = json.loads(file.read_text(encoding="utf-8"))["rows"]
    methods: dict[str, Callable[[], Answer]] = {"machine file": lambda: Answer(one.machine, {}, "")}
    methods |= {name: lambda method=method: timed(method, one) for name, method in RIVALS.items() if name not in missing()}
    methods |= {
        "twin identify": lambda: identified(one, work),
        QUICK if quick else DIAGNOSE: lambda: diagnosed(one, work, *["--quick"] * quick),
    }
    for name, method in methods.items():
        if name in result["rows"]:
            continue
        try:
            result["rows"][name] = marked(method(), known)
        except TwinError as error:
            result["rows"][name] = {"failed": str(error)}
        print(f"  {name}: {result['rows'][name].get('gap') or result['rows'][name]['failed']}", file=sys.stderr, flush=True)
        file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m devtools.versus", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the results; those that it holds are kept")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the public recordings; without it only made machines")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="only these inputs")
    parser.add_argument("--quick", action="store_true", help="twin diagnose --quick, which searches no law")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the tables into this page, and the picture beside it")
    parser.add_argument("--peers", action="store_true", help="only the speed of simulation and planning beside that of other libraries")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    if args.peers:
        from .peers import peers, peers_text

        measured = peers()
        (args.out / "peers.json").write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
        print(peers_text(measured))
        return 0
    for line in missing().values():
        print(f"left out: {line}", file=sys.stderr)
    for name, make in inputs_of(args.data, args.out).items():
        file = args.out / f"{name}.json"
        if args.only and name not in args.only:
            continue
        print(name, file=sys.stderr, flush=True)
        compared(*make(), file, args.out / "work" / name, args.quick)
    if results_in(args.out):
        draw(args.out, args.page.parent / "pictures" / "versus.png" if args.page else args.out / "versus.png")
    if args.page:
        put_into(args.page, args.out)
    print(table_text(args.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
