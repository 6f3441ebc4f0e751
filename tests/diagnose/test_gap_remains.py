"""When effects do not explain an axis: a large gap remains, or most of a moderate gap; and the verdict that follows."""

import pytest

from twin.diagnose.judgement import final_verdict, gap_remains
from twin.diagnose.procedure import notes_of_what_remains
from twin.diagnose.wording import verdict_sentence


@pytest.mark.parametrize(
    ("before", "after", "remains"),
    [(20.0, 8.0, True), (40.0, 3.5, False), (3.5, 2.9, True), (8.0, 2.5, False), (2.2, 1.9, False), (1.0, 1.0, False)],
)
def test_a_gap_remains_if_it_is_large_or_mostly_unexplained(before: float, after: float, remains: bool) -> None:
    assert gap_remains(before, after) is remains
    assert final_verdict("effect", {"X": before, "Y": 1.0}, {"X": after, "Y": 1.0}, has_laws=False) == ("unknown" if remains else "effect")


def test_a_machine_with_a_law_is_not_without_a_fault() -> None:
    """Whatever the levels: beside a law the verdict is never 'none', and it is 'law' only if all but a tenth is explained."""
    for before in (1.4, 2.0, 5.0, 100.0):
        for left in (0.0, 0.05, 0.2, 0.6, 1.0):
            after = (1.0 + left * (before**2 - 1.0)) ** 0.5
            for found in ("none", "effect", "unknown"):
                verdict = final_verdict(found, {"X": before}, {"X": after}, has_laws=True)
                assert verdict != "none"
                assert (verdict == "law") is (left < 0.1)
    assert final_verdict("none", {"X": 2.0}, {"X": 2.0}, has_laws=False) == "none"


def test_a_loud_gap_is_not_called_agreement() -> None:
    """Of one axis, while the others may agree: the level of all is then low."""
    rows = [[{"axis": "Z", "times_noise": level}] for level in (2.9, 4.7)]
    sentences = [verdict_sentence({"verdict": "none", "budget": {"unexplained": unexplained}}) for unexplained in rows]
    assert sentences[0] == "No effect: the machine agrees with its file within tolerance and noise."
    assert sentences[1].startswith("No effect found, but a gap remains, 4.70 times the noise on axis Z: ")


def test_a_large_remaining_gap_is_said_beside_a_probable_cause() -> None:
    """A backlash of 0.98 beside 4.7 x noise in motion: a hardening spring leaves that. At rest it is another matter."""
    notes = notes_of_what_remains({"X": 4.7, "Y": 1.2, "Z": 1.1}, {"X": 4.4, "Y": 14.0, "Z": 1.2})
    assert len(notes) == 2
    assert notes[0].startswith("axis X: 4.7 x noise remains in motion, which nothing named here explains")
    assert notes[1].startswith("axis Y: 1.2 x noise remains in motion and 14.0 x noise over whole runs")
