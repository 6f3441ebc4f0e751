"""When effects do not explain an axis: a large gap remains, or most of a moderate gap."""

from types import SimpleNamespace

import pytest

from twin.diagnose.diagnosis import Diagnosis


@pytest.mark.parametrize(
    ("before", "after", "remains"),
    [(20.0, 8.0, True), (40.0, 3.5, False), (3.5, 2.9, True), (8.0, 2.5, False), (2.2, 1.9, False), (1.0, 1.0, False)],
)
def test_a_gap_remains_if_it_is_large_or_mostly_unexplained(before: float, after: float, remains: bool) -> None:
    levels = {
        ("before", True): before,
        ("after", True): after,
        ("before", False): 50.0,
        ("after", False): 49.0,
    }  # at rest it sticks elsewhere
    of = SimpleNamespace(axis_level=lambda which, axis, in_motion=False: levels[which, in_motion])
    assert Diagnosis.gap_remains(of, "X") is remains
