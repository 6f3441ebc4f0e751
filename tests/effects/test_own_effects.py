"""`--effects FILE`: every command and every process knows the effects of a user file, and none afterwards."""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
import json
import multiprocessing
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from tests.builders.one_axis import follow, there_and_back
from tests.builders.script import carried_out
from tests.conftest import ROOT
from twin.cli import main
from twin.cli.parser import build_parser
from twin.effects import EFFECTS
from twin.effects.user_files import effects_of, loaded_files

EXAMPLE = ROOT / "examples" / "own_effect" / "load_friction.py"

LAW = '''
from twin.effects.effect import Parameter, effect
from twin.simulation.loop_terms import FORCE, X_LOAD_FORCE, arrays, term

@effect(block="mechanics", parameters=(Parameter("force", "force", 0.0, 1e4, (100.0, 500.0), neutral=0.0),))
def own_push(change, axis, force):
    """A push of my own.

    F = 1 x force.
    """
    change.add_term(push, FORCE, axis, [force])

@term
def push(parameters, state, signals, axis):
    p, s, x = arrays(parameters, state, signals)
    x[axis, X_LOAD_FORCE] += 1.0 * p[0]
'''


def names_in_worker() -> list[str]:
    from twin.effects import EFFECTS

    return list(EFFECTS)


def test_a_file_is_known_inside_the_block_only():
    before = list(EFFECTS)
    with effects_of([EXAMPLE, EXAMPLE]):
        assert list(EFFECTS) == [*before, "load_friction"]
        with effects_of([EXAMPLE]):
            assert len(loaded_files()) == 1
        assert "load_friction" in EFFECTS
    assert list(EFFECTS) == before
    assert "TWIN_EFFECTS" not in os.environ


def test_worker_processes_know_it_too():
    with effects_of([EXAMPLE]), ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert "load_friction" in pool.submit(names_in_worker).result()


def test_a_changed_law_is_compiled_anew(tmp_path: Path):
    """Even with equal size and time of the file, the only properties that numba checks."""
    file = tmp_path / "own.py"
    move = there_and_back(0.002, 0.05)
    pushed = []
    for law in (LAW, LAW.replace("+= 1.0", "+= 2.0")):
        file.write_text(law, encoding="utf-8")
        os.utime(file, (1e9, 1e9))
        with effects_of([file]):
            pushed.append(follow("X", move, [{"name": "own_push", "force": 300.0}]).get("X", "current").mean())
    plain = follow("X", move).get("X", "current").mean()
    np.testing.assert_allclose(pushed[1] - plain, 2.0 * (pushed[0] - plain), rtol=0.05)


def parsers(parser: argparse.ArgumentParser, name: str):
    """(name, parser) of every command and sub-command."""
    subs = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not subs:
        yield name, parser
    for action in subs:
        for word, sub in action.choices.items():
            yield from parsers(sub, f"{name} {word}".strip())


def test_every_command_that_takes_a_machine_takes_effects():
    for name, parser in parsers(build_parser(), ""):
        options = {a.dest for a in parser._actions}
        assert ("machine" in options) == ("effects" in options), name
        if name in ("run", "gap", "diagnose", "identify", "exam", "study", "cut", "effects", "machine check"):
            assert "effects" in options, name


def test_listed_shown_and_drawn(tmp_path: Path, capsys):
    assert main(["effects", "--effects", str(EXAMPLE)]) == 0
    assert "load_friction" in capsys.readouterr().out
    picture = tmp_path / "load_friction.png"
    assert main(["effects", "load_friction", "--effects", str(EXAMPLE), "--picture", str(picture)]) == 0
    assert "Fc + coefficient M |a|" in capsys.readouterr().out
    assert picture.stat().st_size > 5000
    assert main(["effects", "load_friction"]) == 2
    assert "give --effects FILE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "there is no such file; give a Python file"),
        ("", "the file has no effect; write @effect(...)"),
        ("import twin.nothing_there\n", "cannot be imported (line 1): ModuleNotFoundError"),
        ("x = 1\ndef f(:\n", "cannot be imported (line 2): SyntaxError"),
        ("raise SystemExit(0)\n", "cannot be imported (line 1): SystemExit"),
        (LAW.replace("own_push", "backlash"), "effect backlash: an effect of that name exists already; use another name"),
        (LAW.replace('"mechanics"', '"mechanic"'), "no block 'mechanic'; did you mean 'mechanics'?"),
        (LAW.replace('"force", 0.0', '"forse", 0.0'), "unknown quantity 'forse'; did you mean 'force'?"),
        (LAW.replace(", neutral=0.0", ""), "no parameter has a neutral value"),
        (LAW + "raise ValueError('late')\n", "cannot be imported (line 17): ValueError: late"),
    ],
)
def test_a_bad_file_gives_one_line(tmp_path: Path, capsys, content, said):
    before = dict(EFFECTS)
    file = tmp_path / "own.py"
    if content is not None:
        file.write_text(content, encoding="utf-8")
    assert main(["effects", "--effects", str(file)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"twin: --effects {file}: ")
    assert said in error
    assert before == EFFECTS


def test_a_bad_file_in_the_environment_is_one_line(tmp_path: Path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TWIN_EFFECTS": str(tmp_path / "none.py")}
    done = subprocess.run([sys.executable, "-m", "twin", "effects"], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(f"twin: TWIN_EFFECTS {tmp_path / 'none.py'}: there is no such file")


@pytest.mark.slow
def test_the_example_is_named_by_a_diagnosis(tmp_path: Path):
    """One file: simulated, listed, drawn, searched and named, with its size."""
    carried_out("examples/own_effect/run.py", "--out", tmp_path)
    document = json.loads((tmp_path / "diagnosis.json").read_text())
    assert document["verdict"] == "effect"
    (effect,) = document["effects"]
    assert (effect["effect"], effect["axis"]) == ("load_friction", "X")
    assert effect["parameters"]["coefficient"]["value"] == pytest.approx(0.3, rel=0.1)
    assert (tmp_path / "load_friction.png").exists()
    assert 'name = "load_friction"' in (tmp_path / "machine.toml").read_text()
