"""The numbers of a study do not depend on earlier studies in the process, the order of variants, or the number of threads."""

from dataclasses import replace
import json
from pathlib import Path
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tests.builders.study_files import rows_of, write_spec
from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.machine.check import check_machine
from twin.machine.machine import Machine
from twin.recordings.trace import Trace, write_trace
from twin.study.design import machine_of, variants_of
from twin.study.evaluate import _planning_key, evaluate, work_of
from twin.study.execution import FILE, fingerprint
from twin.study.paths import inertia_at_motor, with_numbers
from twin.study.spec import read_study

GEOMETRY = '[[factor]]\nname = "offset"\npath = "geometry.a_axis_to_c_axis_y_m"\nvalues = [0.0, 0.05]\n'
LIMIT = '[[factor]]\nname = "jerk"\npath = "axis.X.max_jerk_m_per_s3"\nvalues = [5.0, 20.0]\n'
ELSEWHERE = '[fixed]\n"geometry.a_axis_to_c_axis_y_m" = 0.02\n"body.workpiece.mass_kg" = 25.0\n"axis.Y.coulomb_friction_nm" = 3.0\n'
"""Another machine with the same axes and limits, to detect caches with incomplete keys."""
MASS = '[[factor]]\nname = "load"\npath = "added_mass.workpiece"\nvalues = [0.0, 40.0]\n'
RUN = '[[run]]\ninput = "tilt.mpf"\n'
DESIGN = '[design]\nkind = "grid"\n'
PROGRAM = "G17 G71 G90 G94\nTRAORI\nG1 X0 Y0 Z200 A3=0 B3=0 C3=1 F5000\nX2 A3=0 B3=-0.05 C3=1\nM30\n"


def spec_in(folder: Path, factors: str) -> Path:
    folder.mkdir()
    (folder / "tilt.mpf").write_text(PROGRAM, encoding="utf-8")
    return write_spec(folder, factors + DESIGN, RUN)


def test_other_studies_before_change_no_bit(tmp_path: Path) -> None:
    """Workers cache models, plans, margins and weights, which must not be used for another machine."""
    spec, other = spec_in(tmp_path / "a", GEOMETRY + MASS), spec_in(tmp_path / "b", ELSEWHERE + LIMIT + MASS)
    command = [sys.executable, "-m", "twin", "study", str(spec), "--out", str(tmp_path / "fresh"), "--threads", "1", "--no-replay"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with sqlite3.connect(tmp_path / "fresh" / FILE) as database:
        fresh = [json.loads(row[0]) for row in database.execute("SELECT responses FROM variant ORDER BY number")]
    assert len({row["contour_error_max_um"] for row in fresh}) == 4
    rows_of(other, tmp_path / "other", threads=2)
    study = read_study(spec)
    work, variants = work_of(study), variants_of(study).tolist()
    backwards = [evaluate(work, tuple(row)).responses for row in variants[::-1]][::-1]
    assert backwards == fresh
    assert [found for _, _, found, _ in rows_of(spec, tmp_path / "again", threads=3)] == fresh


def test_blas_threads_change_no_bit(tmp_path: Path) -> None:
    """BLAS splits long dot products among its threads; a study must not depend on their number."""
    time, x = moves_in_turn(0.0, [0.01, -0.01] * 30, 0.1, 2.0, 50.0, 0.06, 1e-3)
    assert len(time) > 12_000
    write_trace(Trace(time, {("X", "setpoint"): x}, {"X": "linear"}), tmp_path / "move.csv")
    spec, found = write_spec(tmp_path), []
    for threads in (1, 2, 3):
        with threadpool_limits(limits=threads, user_api="blas"):
            found.append(rows_of(spec, tmp_path / f"{threads}", threads=2))
            assert {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"} == {threads}  # given back
    assert found[0] == found[1] == found[2]
    assert all(responses["following_error_rms_X_um"] > 0.0 for _, _, responses, _ in found[0])


def test_every_loop_below_the_margin_is_marked(tmp_path: Path) -> None:
    """As `twin machine check` sees the loops, on its finer grid."""
    factors = "".join(
        f'[[factor]]\nname = "{name}"\npath = "axis.X.{path}"\nrange = {span}\n'
        for name, path, span in (
            ("gain", "loops.position_gain_per_s", "[30, 700]"),
            ("speed gain", "loops.speed_gain_nm_s_per_rad", "[0.4, 30]"),
            ("spring", "loops.speed_integral_time_s", "[0.002, 0.02]"),
        )
    )
    spec = write_spec(tmp_path, factors + '[design]\nkind = "latin_hypercube"\ncount = 24\n')
    study = read_study(spec)
    marked = 0
    for _, row, responses, reason in rows_of(spec, tmp_path / "out"):
        (check, *_), _ = check_machine(machine_of(study, np.array(row)))
        least = min(m.phase if m.stable else 0.0 for m in check.margins)
        if responses:
            assert min(v for k, v in responses.items() if k.startswith("phase_margin_") and k.endswith("_X_deg")) == pytest.approx(
                least, abs=1e-6
            )
            assert ("phase margin" in (reason or "")) == (least < 30.0)
        else:
            assert reason
        marked += least < 30.0
    assert 3 <= marked <= 21


def test_half_the_inertia_is_half_the_inertia(mikron: Machine) -> None:
    half = with_numbers(mikron, {f"inertia.{a.name}": 0.5 * inertia_at_motor(mikron, a) for a in mikron.axes})
    for before, after in zip(mikron.axes, half.axes):
        assert inertia_at_motor(half, after) == pytest.approx(0.5 * inertia_at_motor(mikron, before), rel=1e-9)
        assert after.moving_mass_kg == before.moving_mass_kg
    with pytest.raises(InputError, match=r"its load alone has 0\.001773 at the motor"):
        with_numbers(mikron, {"inertia.X": 0.001})


def test_a_run_is_named_after_no_other_folder(tmp_path: Path) -> None:
    for name in ("../out", "a/b", "/tmp/x", ".hidden", "a\\\\b"):
        spec = write_spec(tmp_path, run=f'[[run]]\ninput = "move.csv"\nname = "{name}"\n')
        with pytest.raises(InputError, match="becomes part of file names"):
            read_study(spec)


def test_the_fingerprint_counts_what_the_numbers_depend_on(tmp_path: Path) -> None:
    study = read_study(write_spec(tmp_path))
    variants = variants_of(study)
    other = replace(study, machine=study.machine.with_values({"geometry.tool_length_m": 0.13}))
    assert fingerprint(study, variants) != fingerprint(other, variants)


@pytest.mark.parametrize(
    ("path", "value", "other_plan"),
    [
        ("axis.X.loops.position_gain_per_s", 20.0, True),  # the lowest gain sets how fast an exact stop settles
        ("axis.X.max_jerk_m_per_s3", 2.0, True),
        ("geometry.tool_length_m", 0.13, True),
        ("axis.X.coulomb_friction_nm", 3.0, False),
        ("axis.X.moving_mass_kg", 800.0, False),
    ],
)
def test_variants_share_a_plan_only_if_it_is_the_same(mikron: Machine, path: str, value: float, other_plan: bool) -> None:
    assert (_planning_key(mikron.with_values({path: value})) != _planning_key(mikron)) == other_plan
