"""Another machine of the examination: its file is valid, its loops are stable, and plant and twin agree on it, whichever encoder closes its loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import tomllib

import numpy as np
import pytest

from twin.exam.draw import SHIPPED_MACHINE, draw_case, write_campaign
from twin.exam.other_machine import NEEDS_A_SCALE, NOISE_KEYS, another_machine, arrangement_of, with_noise_keys
from twin.exam.plant.parameters import Richness, unit_factors
from twin.exam.questions import ANOTHER, HEALTHY_EVERY, questions_of
from twin.exam.session import machine_of, write_machine_of
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.campaign_gap import gap

GIVEN = tomllib.loads(SHIPPED_MACHINE.read_text())
SEEDS = {arrangement_of(seed, None): seed for seed in range(40)}


def test_questions_of_another_machine_are_seen_by_their_sensors() -> None:
    questions = questions_of(3, 30, short=True, only=ANOTHER)
    assert sum(q.effect is None for q in questions) == 30 // HEALTHY_EVERY
    assert all(q.stratum.kind == ("healthy" if q.effect is None else "single") for q in questions)
    assert {q.stratum.signals for q in questions} == {"full", "no scale"}
    assert not any(q.effect in NEEDS_A_SCALE for q in questions if q.stratum.signals == "no scale")
    assert {machine_of(q, str(SHIPPED_MACHINE))["axis"]["X"]["encoder"] for q in questions} == {"motor", "scale"}


@pytest.mark.parametrize("keys", NOISE_KEYS)
def test_the_candidate_reads_the_machine_with_the_noise_that_it_is_told(keys: str, tmp_path: Path) -> None:
    question = next(q for q in questions_of(3, 30, only=ANOTHER))
    true, shown = (load_machine(write_machine_of(question, str(SHIPPED_MACHINE), tmp_path / k, k)) for k in ("given", keys))
    factor = NOISE_KEYS[keys] or 0.0
    assert vars(shown.noise(shown.axis("X"))) == pytest.approx({k: factor * v for k, v in vars(true.noise(true.axis("X"))).items()})
    assert shown.axis("X").loops == true.axis("X").loops


@pytest.mark.parametrize(("encoder", "signals"), SEEDS)
def test_plant_and_twin_agree(encoder: str, signals: str, tmp_path: Path) -> None:
    """With the same parameters only two independent noises remain."""
    seed = SEEDS[encoder, signals]
    table = another_machine(GIVEN, seed)
    case = replace(draw_case(seed, "healthy", table, richness=Richness.off(), run_set="short"), factors=unit_factors())
    write_campaign(case, tmp_path, table, runs="short", signals=signals)
    machine = Machine(with_noise_keys(table, "absent"), load_machine().model_path)
    assert all(axis.encoder == encoder for axis in machine.axes)
    campaign = read_campaign(tmp_path, machine)
    five_axis = replace(campaign, runs=tuple(run for run in campaign.runs if run.name == "five_axis"))
    ratios = [row.times_noise for row in gap(five_axis, machine).rows()]
    assert np.sqrt(np.mean(np.square(ratios))) < 1.15
    assert max(ratios) < 1.6
