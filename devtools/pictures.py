"""Draws pictures of the documentation. `python -m devtools.pages --pictures` makes all of them, by the list RECIPES.

python devtools/pictures.py exam DIR       docs/results.md, from the folder that `twin exam --out DIR` wrote
python devtools/pictures.py program        docs/programs.md: feed over the path, error budget
python devtools/pictures.py regress        docs/regression.md: a failed case
python devtools/pictures.py law            docs/laws.md: a friction that no effect describes, measured; a minute
python devtools/pictures.py surface        docs/paper.md: the paper's three parts; about two minutes
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
import fnmatch
import json
import os
from pathlib import Path
import shlex
import shutil
import subprocess
import sys
import tempfile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from twin.machine.machine import load_machine  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"


@dataclass(frozen=True)
class Recipe:
    """Commands that make pictures of the pages, run in a folder that has the checkout's examples, models and devtools.

    `made` are names below docs/pictures, as patterns; `copies` are the files that the commands leave in that folder, by the picture that
    each becomes (others write their pictures themselves); `needs` says what a computer has to have beside the checkout.
    """

    made: tuple[str, ...]
    commands: tuple[str, ...]
    copies: dict[str, str] = field(default_factory=dict)
    needs: str = ""


def copied(commands: Sequence[str], needs: str = "", **files: str) -> Recipe:
    """A recipe of one picture for each keyword; `__` in it is the slash of a folder."""
    copies = {f"{name.replace('__', '/')}.png": file for name, file in files.items()}
    return Recipe(tuple(copies), tuple(commands), copies, needs)


TRACES = "twin import examples/traces/x_*.csv examples/traces/x_*.xml --map examples/traces/map.toml --out out/traces"
CHROMIUM, VULKAN, DATA = "a Chromium", "a Vulkan driver", "data that are not part of the repository"
WORN_CIRCLE = (
    "python examples/iso230/worn_machine.py out/worn",
    "twin diagnose out/worn --out out/worn_diagnosis",
    "twin iso 230-4 out/worn --diagnosis out/worn_diagnosis --json out/worn.json",
)
CIRCLE = ("python -m devtools.picture_gallery --only none --out out", "twin iso 230-4 out/worn_machine --json out/circle.json")
LOAD_FRICTION = "twin effects load_friction --effects examples/own_effect/load_friction.py --picture out/load_friction.png"
RECIPES = (
    copied(["twin demo --out out/demo"], x_200mm="out/demo/x_200mm.png"),
    copied(["twin machine check --out out/check"], loops="out/check/loops_X.png"),
    copied([LOAD_FRICTION], own_effect="out/load_friction.png"),
    copied(["twin iso 230-2 examples/iso230/positions.csv --json out/positions.json"], iso230__positioning="out/positions.png"),
    copied([TRACES], **{"import": "out/traces/x_velocity_feedforward.png"}),
    copied(CIRCLE, iso230__circle="out/circle.png"),
    copied(WORN_CIRCLE, iso230__worn="out/worn.png"),
    Recipe(("budget_*.png", "feed_*.png"), ("python -m devtools.pictures program",)),
    Recipe(("regress_failed.png",), ("python -m devtools.pictures regress",)),
    Recipe(("law.png",), ("python -m devtools.pictures law",)),
    Recipe(("surface/part*.png",), ("python -m devtools.pictures surface",)),
    copied(["python examples/mark_depth_study.py --out out/mark_depth.png"], surface__mark_depth_study="out/mark_depth.png"),
    Recipe(("machine.png",), ("python devtools/picture_machine.py",)),
    Recipe(("effects/*.png",), ("python devtools/picture_effects.py",)),
    Recipe(("identify_*.png",), ("python devtools/picture_identify.py",)),
    Recipe(("remedy.png",), ("python -m devtools.picture_remedy",)),
    Recipe(("diagnosis_*.png",), ("python devtools/picture_diagnosis.py",)),
    Recipe(("gallery/*.png",), ("python -m devtools.picture_gallery",), needs=CHROMIUM),
    copied(["python examples/half_inertia/run.py --out out/half"], study__half_inertia="out/half/half_inertia.png"),
    Recipe(("study/*.png",), ("python -m devtools.picture_study",), needs=VULKAN),
    copied(["python examples/replay_run.py --one --screenshot out/replay.png --at 5.5"], VULKAN, replay="out/replay.png"),
    copied(["python examples/replay_urdf.py --screenshot out/urdf.png --size 1280x720 --at 6.2"], VULKAN, replay_urdf="out/urdf.png"),
    copied(
        [
            "twin cut examples/parts/part1_tangent_planes.mpf --part examples/parts/part1_tangent_planes.toml --out out/part1",
            "twin replay out/part1 --screenshot out/cut.png",
        ],
        VULKAN,
        surface__cut_viewer="out/cut.png",
    ),
    Recipe(("paper/assumptions.png",), ("python -m devtools.paper_assumptions",)),
    Recipe(("paper/*.png",), ("python -m devtools.paper",), needs="the paper's recordings"),
    Recipe(("emps_*.png",), ("python examples/emps/run.py DATA_EMPS.mat --out out/emps",), needs=DATA),
    Recipe(("import_sinumerik_edge.png",), ("python examples/real/sinumerik/run.py recording.json --out out/edge",), needs=DATA),
    copied(
        ["python -m devtools.versus --data ../shared/data --out out/versus --quick"],
        needs=f"the extra 'versus' and {DATA}",
        versus="out/versus/versus.png",
    ),
    Recipe(("watch.png", "since.png"), ("python examples/watch/run.py --out out/watch", "python -m devtools.pictures watch")),
    Recipe(
        ("histories.png",),
        (f"python -m devtools.histories --count 100 --seed 731840225 --out out/histories --picture {PICTURES}/histories.png",),
    ),
    Recipe(("growth.png",), (f"python -m devtools.measure_growth --out out/growth --picture {PICTURES}/growth.png",)),
    Recipe(("exam_*.svg",), ("python -m devtools.pictures exam DIR",), needs="the folder of an examination"),
)
"""Every picture of the pages is made by the first recipe that names it."""


def recipe_of(picture: str) -> Recipe | None:
    """The recipe of a picture, by its name below docs/pictures."""
    return next((r for r in RECIPES if any(fnmatch.fnmatch(picture, pattern) for pattern in r.made)), None)


def make_all(only: Sequence[str] | None = None) -> int:
    """Run every recipe, or those of the named pictures, and report which ran; exit code 1 if one failed."""
    wanted = [r for r in RECIPES if not only or any(name in made for name in only for made in r.made)]
    failed = 0
    for recipe in wanted:
        with tempfile.TemporaryDirectory() as folder:
            for name in ("examples", "models", "devtools", "docs"):
                (Path(folder) / name).symlink_to(ROOT / name)
            (Path(folder) / "out").mkdir()
            ok = all(_command(line, Path(folder)) for line in recipe.commands)
            for name, file in recipe.copies.items() if ok else ():
                shutil.copyfile(Path(folder) / file, PICTURES / name)
        print(f"{'made' if ok else 'NOT made'}: {', '.join(recipe.made)}{'' if ok or not recipe.needs else f' (needs {recipe.needs})'}")
        failed += not (ok or recipe.needs)
    return 1 if failed else 0


def _command(line: str, folder: Path) -> bool:
    words = [file for word in shlex.split(line) for file in (map(str, sorted(folder.glob(word))) if "*" in word else [word])]
    words = words[1:] if words[0] == "python" else ["-m", *words]
    done = subprocess.run([sys.executable, *words], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    if done.returncode:
        print(f"{line}: {(done.stderr.strip() or done.stdout.strip()).splitlines()[-1]}")
    return done.returncode == 0


def exam(folder: Path) -> None:
    """The score of an examination against its targets."""
    from twin.exam.report import sections_of

    score, *_ = sections_of(json.loads((folder / "exam.json").read_text(encoding="utf-8")))
    (PICTURES / "exam_score.svg").write_text(score.figures[0].svg, encoding="utf-8")


def watch() -> None:
    """The machine of examples/watch, from out/watch: sizes over time from its history, and its backlash since the first week."""
    from twin.history.document import sparklines
    from twin.history.since_output import change_figure, diagnosed_since
    from twin.recordings.campaign import read_campaign
    from twin.report import save_png

    machine = load_machine()
    last, first = (read_campaign(Path("out/watch/weeks") / day, machine) for day in ("2026-04-20", "2026-01-05"))
    *_, shown = diagnosed_since(last, [first], machine, Path("out/since"), False, 0, lambda _: None)
    save_png(change_figure(shown[0]), PICTURES / "since.png", 90)
    save_png(sparklines(json.loads(Path("out/watch/history/history.json").read_text(encoding="utf-8"))), PICTURES / "watch.png", 90)


def plot_budget(budget, path: Path, title: str) -> None:  # type: ignore[no-untyped-def]
    """The errors of both levels [um] over path length [mm], one panel below the other."""
    from twin.program.budget import QUANTITIES
    from twin.report.figure import AMBER, BLUE, new_figure, save_png

    figure, grid = new_figure(2, 1, height=2.8, sharex=True)
    length = budget.path_length * 1e3
    groups = (("level 1: interpolator", ("rounding", "chord")), ("level 2: drives; and what the part sees", ("drives", "contour")))
    for axes, (name, quantities) in zip(grid[:, 0], groups):
        for quantity, colour in zip(quantities, (BLUE, AMBER)):
            words = QUANTITIES[quantity][1].replace(", ", ",\n")
            axes.plot(length, getattr(budget, quantity) * 1e6, color=colour, linewidth=1.1, label=f"{quantity}:\n{words}")
        axes.set_ylabel("error in um")
        axes.set_title(name, loc="left", weight="bold")
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8.5)
    grid[1, 0].set_xlabel("programmed path length in mm")
    figure.suptitle(title)
    save_png(figure, path)


def program() -> None:
    """Feed over the path and error budget of two example programs."""
    from twin.program import error_budget, interpolate, plot_feed, read_program
    from twin.simulation.run import simulate
    from twin.simulation.setpoints import setpoints_of

    machine = load_machine()
    for name in ("five_axis", "two_planes"):
        read = read_program(ROOT / "examples" / f"{name}.mpf", machine)
        setpoints = interpolate(read, machine)
        plot_feed(setpoints, PICTURES / f"feed_{name}.png", f"{name}.mpf")
        run = simulate(machine.with_feedforward(read.feedforward), setpoints_of(setpoints, machine))
        plot_budget(error_budget(read, setpoints, run.trace, machine), PICTURES / f"budget_{name}.png", f"{name}.mpf")


def regress() -> None:
    """Evidence of a case that fails because the friction of X is 2 % up."""
    from dataclasses import replace

    from twin.regress.golden import read_golden
    from twin.regress.run_suite import compared
    from twin.regress.suite import read_suite

    case = next(c for c in read_suite(ROOT / "examples/regression/nominal.toml") if c.name == "x_feedforward_torque")
    golden = read_golden(case)
    friction = load_machine().document["axis"]["X"]["coulomb_friction_nm"]
    changed = replace(case, table={**case.table, "values": {"axis.X.coulomb_friction_nm": 1.02 * friction}})
    with tempfile.TemporaryDirectory() as folder:
        verdict = compared(changed, golden, Path(folder))
        (PICTURES / "regress_failed.png").write_bytes((Path(folder) / case.name / "plot.png").read_bytes())
    print(verdict.text)


def law() -> None:
    """The drag that examples/unlisted_law hides in a machine of the second plant, as the diagnosis measures it."""
    from twin.diagnose import diagnose
    from twin.diagnose.law.figures import laws_figure
    from twin.recordings.campaign import read_campaign
    from twin.report import save_png

    machine = load_machine()
    with tempfile.TemporaryDirectory() as folder:
        _command(f"python examples/unlisted_law/run.py --record-only --out {folder}", ROOT)
        found = diagnose(read_campaign(Path(folder) / "campaign", machine), machine)
    print(*(f"{law['sentence']}" for law in found.document()["laws"]), sep="\n")
    save_png(laws_figure(found.laws, machine), PICTURES / "law.png", 90)


def surface() -> None:
    """The paper's three parts as cut by the twin, with feedforward off and level by level."""
    from examples.parts.paper_parts import PARTS
    from twin.surface.levels import LEVELS, levels_of_program
    from twin.surface.machining import machine_part
    from twin.surface.part import read_part
    from twin.surface.picture import draw_cut, draw_levels

    for name in PARTS:
        file = ROOT / "examples" / "parts" / f"{name}.toml"
        part = read_part(file)
        levels = levels_of_program(file.with_suffix(".mpf"), load_machine(), part.tool, LEVELS, ("velocity+torque", "off"))
        machining = machine_part(part, levels)
        draw_cut(machining, machining.cuts[-1], PICTURES / "surface" / f"{name}_off.png")
        draw_levels(machining, part.surfaces[0].name, PICTURES / "surface" / f"{name}_levels.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="what")
    commands.add_parser("exam").add_argument("folder", type=Path, metavar="DIR")
    makers = {"law": law, "program": program, "regress": regress, "surface": surface, "watch": watch}
    for name in makers:
        commands.add_parser(name)
    args = parser.parse_args()
    if args.what == "exam":
        exam(args.folder)
    else:
        makers[args.what]()


if __name__ == "__main__":
    main()
