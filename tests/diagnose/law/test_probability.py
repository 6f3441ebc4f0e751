"""A law is no more probable than the correction is complete."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tests.diagnose.law.test_closed_loop import PLAY, X
from twin.diagnose.law.laws import FoundLaw, Laws
from twin.diagnose.procedure import _as_probable_as_complete
from twin.diagnose.validation import Validated
from twin.effects import settings_of, with_effects
from twin.simulation.gap import SignalGap


@pytest.mark.parametrize(("after", "probability"), [(1.0, 0.98), (2.0, 0.98), (10.0, 0.75), (30.0, 0.0)])
def test_a_law_beside_a_large_unexplained_gap_is_not_probable(after: float, probability: float) -> None:
    nothing: Any = None
    law = FoundLaw(settings_of(with_effects(X, [PLAY]))[0], nothing, nothing, 0.5, 0.98, {})
    held_out: Any = SimpleNamespace(gaps={"after": {"run": {"X": {"position": SignalGap(after, after, 1.0, 1.0, "um", after)}}}})
    correction = Validated([], held_out, {"X": 20.0}, {"X": 20.0}, X, Laws((law,), (), X, {}))
    _, found = _as_probable_as_complete(correction, [])
    assert found[0].probability == pytest.approx(probability, abs=0.01)
