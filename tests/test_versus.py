"""The twin beside other methods: each method finds the numbers of a small made axis, and the marks are right."""

from collections.abc import Callable
from dataclasses import replace
import importlib.util
from pathlib import Path
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from devtools.versus import answer, peers, table
from devtools.versus.__main__ import CHANGES, LIBRARY, RIVALS, SIMULATED, compared
from devtools.versus.answer import Answer, code_lines, marked, timed
from devtools.versus.inputs import FITTED_SHARE, Input, Known, recorded, simulated
from devtools.versus.numbers import numbers_of, with_numbers
from devtools.versus.simulated_fits import evolution_fit
from tests.conftest import ROOT

# what each method reaches on the small inputs: largest error of a number, gap left out in times noise; without and with the effect
REACHED = {
    "mujoco.sysid": ((0.01, 12.0), (0.10, 90.0)),
    "CMA-ES (PACE)": ((0.001, 3.0), (0.10, 90.0)),
    "least squares": ((0.001, 3.0), (0.15, 60.0)),
    "SINDy": ((0.08, 90.0), (0.08, 90.0)),
}


@pytest.fixture(scope="module")
def numbers_only(tmp_path_factory: pytest.TempPathFactory) -> tuple[Input, Known]:
    return simulated(tmp_path_factory.mktemp("numbers"), CHANGES)


@pytest.fixture(scope="module")
def one_effect(tmp_path_factory: pytest.TempPathFactory) -> tuple[Input, Known]:
    return simulated(tmp_path_factory.mktemp("effect"), CHANGES, SIMULATED["asymmetry"])


def installed(method: str) -> Callable[[Input], Answer]:
    library = LIBRARY.get(method)
    if library and importlib.util.find_spec(library) is None:
        pytest.skip(f"{method}: {library} is not installed; it is in the extra 'versus'")
    return RIVALS[method]


SLOW = ("mujoco.sysid", "CMA-ES (PACE)")


@pytest.mark.parametrize("method", [pytest.param(m, marks=pytest.mark.slow if m in SLOW else ()) for m in RIVALS])
def test_each_method_reaches_its_numbers(method: str, numbers_only: tuple[Input, Known], one_effect: tuple[Input, Known]) -> None:
    """The right model: errors of the numbers and gap. One effect more: nobody claims success, but the gap stays many times the noise."""
    fit = installed(method)
    for (one, known), (worst, most) in zip((numbers_only, one_effect), REACHED[method]):
        row = marked(timed(fit, one), known)
        assert max(n["error"] for n in row["numbers"].values()) < worst
        assert row["gap"]["times_noise"] < most
    assert row["gap"]["times_noise"] > 10.0


def test_where_no_position_can_be_compared_the_evolution_fits_the_effort(
    numbers_only: tuple[Input, Known], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A path that is the recorded motion itself tells nothing of the position: the numbers come from the voltage. A simplex stands in for CMA-ES."""

    def fmin2(objective: Callable[[np.ndarray], float], start: list[float], _size: float, options: dict[str, Any]) -> tuple[Any, Any]:
        far = [(-options["bounds"][1], options["bounds"][1])] * len(start)
        found = minimize(
            objective, start, method="Nelder-Mead", bounds=far, options={"maxfev": 200, "initial_simplex": corners(len(start))}
        )
        return found.x, SimpleNamespace(stop=lambda: {"maxfevals": 200})

    def corners(n: int) -> np.ndarray:
        return np.vstack([np.zeros(n), 0.3 * np.eye(n)])

    monkeypatch.setitem(sys.modules, "cma", SimpleNamespace(fmin2=fmin2))
    one, known = numbers_only
    run = one.fitted[0]
    signals = {**run.trace.signals, ("X", "motor_position"): run.trace.get("X", "setpoint")}
    same = replace(one, fitted=(replace(run, trace=replace(run.trace, signals=signals)),))
    fitted = evolution_fit(same)
    found = numbers_of(fitted.machine)
    assert {n: found[n] for n in CHANGES} == pytest.approx({n: known.numbers[n] for n in CHANGES}, rel=0.02)
    assert answer.gap_on(fitted, replace(known, held_out=same.fitted)).keys() == {"effort", "times_noise"}


def test_a_recording_without_data_sheet_is_cut_by_its_travel(tmp_path: Path) -> None:
    one, known = recorded(ROOT / "examples" / "traces" / "x_feedforward_off.csv", "X", "a stroke", tmp_path)
    travel = [sum(float(np.abs(np.diff(run.trace.get("X", "setpoint"))).sum()) for run in runs) for runs in (one.fitted, known.held_out)]
    assert travel[0] / sum(travel) == pytest.approx(FITTED_SHARE, abs=0.01)
    assert one.machine.axis_names == ("X",)


def test_marks_tell_right_from_wrong(one_effect: tuple[Input, Known]) -> None:
    """The true machine leaves noise; a number is in its interval or not; a cause is named or not; a load moves the prediction."""
    one, known = one_effect
    true = with_numbers(one.machine, known.numbers)
    narrow = {n: (v, 0.999 * v, 1.001 * v) for n, v in known.numbers.items() if v}
    good = Answer(true, narrow, "", ("viscous_asymmetry",))
    wrong = Answer(true, {n: (1.1 * v, 1.09 * v, 1.11 * v) for n, (v, _, _) in narrow.items()}, "", ("stribeck",))
    of_good, of_wrong = marked(good, known), marked(wrong, known)
    assert of_good["right"]
    assert not of_wrong["right"]
    assert all(n["holds"] for n in of_good["numbers"].values())
    assert not any(n["holds"] for n in of_wrong["numbers"].values())
    assert max(n["error"] for n in of_wrong["numbers"].values()) == pytest.approx(0.1)
    # the effect that is missing, as a force along the motion
    d = known.numbers["viscous_friction"]
    loaded = marked(replace(good, load=lambda q, v, a: 0.15 * d * np.abs(v)), known)
    other = marked(replace(good, load=lambda q, v, a: -0.15 * d * np.abs(v)), known)
    assert min(loaded["gap"]["times_noise"], other["gap"]["times_noise"]) < 0.3 * of_good["gap"]["times_noise"]
    outside = replace(known, outside=True)
    assert answer.right(replace(good, verdict="unknown"), outside)
    assert not answer.right(replace(good, verdict="none"), outside)


def test_numbers_go_into_the_machine_and_come_back(numbers_only: tuple[Input, Known]) -> None:
    machine = numbers_only[0].machine
    wanted = {n: 1.07 * v for n, v in numbers_of(machine).items()} | {"constant_force": -2.5}
    assert numbers_of(with_numbers(machine, wanted)) == pytest.approx(wanted)


def test_lines_are_those_of_code() -> None:
    source = '''
def fit(x):
    """Two
    lines."""
    # a comment

    y = (x +
         1)
    return "text"
'''
    assert code_lines(source) == 4


def test_the_table_is_made_from_stored_results(numbers_only: tuple[Input, Known], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failed method is a row, not the end; what is not claimed stays blank."""
    from twin.errors import InputError

    def fails(_one: Input) -> Answer:
        raise InputError("cannot")

    one, known = numbers_only
    monkeypatch.setattr("devtools.versus.__main__.RIVALS", {"mine": lambda one: Answer(one.machine, {}, "said"), "other": fails})
    monkeypatch.setattr("devtools.versus.__main__.identified", lambda one, _out: Answer(one.machine, {"inertia": (1.0, 0.9, 1.1)}, ""))
    monkeypatch.setattr(
        "devtools.versus.__main__.diagnosed", lambda one, _out: Answer(one.machine, {}, "backlash 0.98", ("backlash",), verdict="effect")
    )
    compared(one, known, tmp_path / "small.json", tmp_path, quick=False)
    monkeypatch.setattr("devtools.versus.__main__.identified", fails)  # what is stored is not done again
    compared(one, known, tmp_path / "small.json", tmp_path, quick=False)
    results = table.results_in(tmp_path)
    gaps = table.gaps_table(results)
    assert "failed" in gaps
    assert gaps.count("**") == 8  # four methods left the same machine as it was
    answers = {line.split(" | ")[0].strip("| "): line for line in table.answers_table(results).splitlines()}
    assert "0 of 1" in answers["twin identify"]
    assert "| 0 of 1 |" in answers["twin diagnose"]
    assert "names none" in answers["mine"]
    says = table.says_table(results)
    assert "backlash" in says
    assert "failed: cannot" in says
    page = tmp_path / "page.md"
    page.write_text(
        "a\n<!-- gaps -->\nold\n<!-- end gaps -->\n<!-- answers -->\n<!-- end answers -->\n<!-- says -->\n<!-- end says -->\nz\n"
    )
    for _ in range(2):
        table.put_into(page, tmp_path)
    assert page.read_text().startswith("a\n<!-- gaps -->\n\n| gap left out")
    assert page.read_text().endswith("<!-- end says -->\nz\n")
    assert page.read_text().count("failed: cannot") == 1
    assert "old" not in page.read_text()


def test_simulation_and_planning_beside_their_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The peers simulate the same law: within their sampling of the twin."""
    monkeypatch.setattr(peers, "seconds", lambda work: (1.0, work()))  # a benchmark measures times
    measured = peers.peers()
    rows = measured["simulation"]
    assert rows["the twin, decoupled plant"]["off_um"] < 0.02
    assert rows["solve_ivp (LSODA)"]["off_um"] < 10.0
    if "python-control (no friction)" in rows:
        assert rows["python-control (no friction)"]["off_um"] < 20.0
    if "planning" in measured:
        assert measured["planning"]["path_time_ratio"] < 1.1
    assert "over the twin" in peers.peers_text(measured)
