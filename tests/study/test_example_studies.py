"""The studies of examples/studies: one variant of each is simulated, with its programs, and gives what the study asks for."""

from __future__ import annotations

import math

import pytest

from tests.conftest import ROOT
from twin.study.design import variants_of
from twin.study.evaluate import evaluate, work_of
from twin.study.spec import broken_by, read_study

STUDIES = sorted((ROOT / "examples" / "studies").glob("*.toml"))


def test_there_are_studies() -> None:
    assert len(STUDIES) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("spec", STUDIES, ids=lambda spec: spec.stem)
def test_a_variant_gives_the_requested_responses(spec) -> None:  # type: ignore[no-untyped-def]
    study = read_study(spec)
    row = variants_of(study)[0]
    found = evaluate(work_of(study), tuple(float(value) for value in row))
    assert found.reason is None
    assert list(broken_by(study.constraints, found.responses)) == []
    assert study.answer
    for name in study.answer:
        assert math.isfinite(found.responses[name]), name
