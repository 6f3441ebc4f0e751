"""Responses named in a study file: unknown ones are refused at the first variant, and constraints may change without a new simulation."""

from pathlib import Path

import pytest

from tests.builders.study_files import FACTOR, GRID, rows_of, write_spec
from twin.errors import InputError
from twin.study import execution
from twin.study.design import variants_of
from twin.study.evaluate import Answer
from twin.study.execution import Store, carry_out, fingerprint, simulated, threads_here
from twin.study.results import check_names
from twin.study.spec import read_study


def bound(pattern: str, most: float) -> str:
    return f'[[constraint]]\nresponse = "{pattern}"\nmost = {most}\n'


@pytest.mark.parametrize(
    "asked",
    ['answer = ["cycle_tim_s"]\n', 'pareto = [["cycle_time_s", "error_um"]]\n', bound("current_limit_used", 0.8), bound("curent_*", 0.8)],
)
def test_an_unknown_name_is_refused_at_the_first_variant(asked: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every design would fulfil a constraint that matches no response."""
    study = read_study(write_spec(tmp_path, asked + FACTOR + GRID.replace("3", "40")))
    variants = variants_of(study)
    monkeypatch.setattr(execution, "evaluate", lambda _work, _row: Answer({"cycle_time_s": 1.0, "current_limit_used_X": 0.5}))
    store = Store(tmp_path / "out", fingerprint(study, variants), resume=False)
    try:
        with (
            pytest.raises(InputError, match=r"no response '(cycle_tim_s|error_um|current_limit_used|curent_\*)'"),
            threads_here(1) as workers,
        ):
            carry_out(study, variants, store, workers, lambda _: None)
        assert 1 <= len(store.done()) < 10
    finally:
        store.close()


def test_names_that_other_variants_may_provide_are_checked_later(tmp_path: Path) -> None:
    text = 'answer = ["first_mode_X_hz"]\n' + bound("torque_rms_used_*", 1.0) + bound("phase_margin_speed_*", 90.0)
    study = read_study(write_spec(tmp_path, text + FACTOR + GRID))
    check_names(study, ["cycle_time_s"], some_variants=True)
    with pytest.raises(InputError, match="first_mode_X_hz"):
        check_names(study, ["cycle_time_s"])


def test_a_changed_bound_does_not_repeat_simulations(tmp_path: Path) -> None:
    spec = write_spec(tmp_path)
    before = rows_of(spec, tmp_path / "out")
    largest = sorted(row[2]["current_max_X_a"] for row in before)
    assert [row[3] for row in before] == [None] * 3
    study = read_study(write_spec(tmp_path, bound("current_max_X_a", 0.5 * (largest[1] + largest[2])) + FACTOR + GRID))
    after, _ = simulated(study, variants_of(study), tmp_path / "out", threads_here(1), resume=True)
    assert [row[:3] for row in after] == [row[:3] for row in before]
    assert [row[3] is None for row in after] == [True, True, False]
    assert "largest current of X is" in str(after[2][3])
