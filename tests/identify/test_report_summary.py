"""The first words of the report of an identification: what changed and what is left of the gap, no caveats."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from twin.estimate.regression import Range
from twin.identify.check_recording import Finding, in_sentences
from twin.identify.report import parameters_table, summary
from twin.identify.result import Identification, Outcome, Parameter


def identified(before: float, left_um: float = 0.08) -> Any:
    """An identification that took one friction of 1.9 +- 0.05 Nm where the file had `before`, and its gap after it."""
    taken = Range(1.9, 1.85, 1.95)
    parameter = SimpleNamespace(axis="X", name="coulomb_friction", before=before, unit="Nm", refined=None)
    gap = {"X": {"position": {"rms": 3.0, "noise": 0.07, "unit": "um"}}}
    after = {"X": {"position": {"rms": left_um, "noise": 0.07, "unit": "um"}}}
    result = SimpleNamespace(
        parameters=(parameter,),
        taken=lambda p: taken,
        refused="",
        training=("one",),
        held_out=(),
        chosen="regression",
        stage=lambda _axis: "regression",
        gaps={"before": gap, "regression": after},
    )
    result.unexplained = lambda: Identification.unexplained(result)  # type: ignore[arg-type]
    return result


def test_changed_values_are_listed_first() -> None:
    section = summary(identified(before=1.4))
    assert "Position gap on held-out motion, RMS: X 3.00 to 0.0800 um (noise 0.0700)." in section.paragraphs
    assert section.paragraphs[-1] == "1 value of the old machine file lies outside the identified 95 % interval:"
    assert section.items == ["X: Coulomb friction from 1.4 to 1.9 Nm (± 2.6 %)"]


def test_intervals_of_an_axis_that_the_model_does_not_explain_are_not_left_unsaid() -> None:
    """Magnetic saturation made an inertia 16 % wrong, with an interval of 11 %."""
    assert not [line for line in summary(identified(before=1.4)).paragraphs if "lacks" in line]
    (said,) = [line for line in summary(identified(before=1.4, left_um=0.3)).paragraphs if "lacks" in line]
    assert said.startswith("The model lacks something on X (position 4.29 x noise): the 95 % intervals")


def test_a_summary_without_changed_values() -> None:
    section = summary(identified(before=1.92))
    assert section.items == []
    assert section.paragraphs[-1] == "No value of the old machine file lies outside the identified 95 % interval."


@pytest.mark.parametrize(
    ("value", "half", "shown"),
    [
        (0.00856756, 7e-5, "0.008568"),
        (1.66082, 2.2, "1.7"),
        (5.46458, 0.0, "5.46458"),
        (2.0, float("inf"), "2"),
        (1.23456789, 1e-9, "1.23457"),
    ],
)
def test_a_value_has_the_digits_that_its_interval_justifies(value: float, half: float, shown: str) -> None:
    assert Range(value, value - half, value + half).number == shown


def test_an_interval_of_a_logarithm_is_a_range() -> None:
    """63.7 kN/m known within a factor of 2.5 are not 63.7 +- 67 kN/m: the interval does not hold zero."""
    assert Range(63.7, 25.5, 159.0).interval == "25.5 to 159"
    assert Range(3.995, 3.9919, 4.0088).interval == "3.992 to 4.009"  # not "4 to 4"
    assert Range(1.0, 1.0, math.inf).interval == "1 to inf"
    assert Range(63.7, 60.0, 67.4).interval == "+- 3.7"
    assert Range(-2.0, -2.2, -1.8).interval == "+- 0.2"


def test_what_is_true_of_several_axes_is_said_once() -> None:
    found = [
        Finding("no current", "X"),
        Finding("late", "X", "a"),
        Finding("no current", "Y"),
        Finding("late", "Y", "b"),
        Finding("too short", run="a"),
    ]
    assert in_sentences(found) == ["axes X and Y: no current", "run a axis X: late", "run b axis Y: late", "run a: too short"]


def test_the_terminal_shows_the_digits_that_intervals_justify_and_what_is_only_bounded() -> None:
    def parameter(name: str, before: float, value: float, half: float) -> Parameter:
        found = Range.around(value, half)
        return Parameter("A", name, "kg m", before, found, found, True, 1.0, False)

    known, wide = parameter("coulomb_friction", 0.5, 0.498145, 0.01), parameter("moment_y", 3.15, 2.68034, 6.8)
    result = SimpleNamespace(parameters=(known, wide), taken=lambda p: p.value, outcome=lambda p: Outcome.WRITTEN)
    table = parameters_table(result)  # type: ignore[arg-type]
    assert table.rows == [
        ["A", "Coulomb friction", "kg m", "0.5", "0.498", "± 2 %", "0.498 ± 2 %", "identified"],
        ["A", "first moment about A, y", "kg m", "3.15", "2.7", "± 6.8", "2.7 ± 6.8", "bounded"],
    ]
