"""A campaign written from Python is the campaign that is read; `simulate` takes what people give it or says what it takes."""

from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine
from twin.recordings.campaign import ChannelFact, MeasuredRun, read_campaign, without_copies
from twin.recordings.trace import Trace, write_trace
from twin.simulation.campaign_file import write_campaign
from twin.simulation.run import simulate


def short_move(mikron: Machine) -> Trace:
    time, position = moves_in_turn(0.0, [0.002], 0.05, 2.0, 50.0, 0.06, 2e-3)
    return Trace(time, {("X", "setpoint"): position}, mikron.kinds)


def test_runs_come_back_as_they_were_written(mikron: Machine, tmp_path: Path) -> None:
    run = simulate(mikron, short_move(mikron), noise_seed=1)
    facts = {
        ("X", "position"): ChannelFact(
            axis="X",
            signal="position",
            latency=3e-3,
            latency_deviation=2e-5,
            taken_back=3e-3,
            offset_m=1.2e-4,
            offset_taken_out=True,
            sign=-1,
        ),
        ("X", "current"): ChannelFact(axis="X", signal="current", against=True),
    }
    measured = MeasuredRun("third", run.trace, "off", 12.5, facts, {"load": 20.0})
    folder = write_campaign({"first": run, "second": run.trace, "third": measured}, tmp_path / "out", feedforward="velocity")
    back = read_campaign(folder, mikron)
    assert [r.name for r in back.runs] == ["first", "second", "third"]
    assert [r.feedforward for r in back.runs] == ["velocity", "velocity", "off"]
    third = back.runs[2]
    assert (third.started_at, third.labels, dict(third.facts)) == (12.5, {"load": 20.0}, facts)
    for one in back.runs:
        for key, values in run.trace.signals.items():
            assert np.allclose(one.trace.signals[key], values, rtol=1e-12, atol=1e-15), key
    # written again: the same folder
    again = write_campaign({r.name: r for r in back.runs}, tmp_path / "again")
    assert (again / "campaign.toml").read_text() == (folder / "campaign.toml").read_text()


def test_a_run_that_repeats_another_one_is_a_copy(mikron: Machine, tmp_path: Path) -> None:
    noisy = [simulate(mikron, short_move(mikron), noise_seed=seed).trace for seed in (1, 2)]
    part = noisy[0].samples(slice(100))
    runs = {"part": part, "first": noisy[0], "same motion": noisy[1], "again": noisy[0]}
    once, copies = without_copies(read_campaign(write_campaign(runs, tmp_path), mikron))
    assert [r.name for r in once.runs] == ["first", "same motion"]
    assert copies == {"part": "first", "again": "first"}


def test_a_campaign_without_noise_is_written_with_a_warning(mikron: Machine, tmp_path: Path) -> None:
    run = simulate(mikron, short_move(mikron))
    with pytest.warns(UserWarning, match="run ideal has no measuring noise; simulate it with noise_seed"):
        write_campaign({"ideal": run}, tmp_path)
    with pytest.raises(InputError, match="no run; give at least one"):
        write_campaign({}, tmp_path)
    with pytest.raises(InputError, match=r"'\.\./x' cannot name a file"):
        write_campaign({"../x": run.trace}, tmp_path)


def test_simulate_takes_a_file_of_set_points_and_says_what_else_it_takes(mikron: Machine, tmp_path: Path) -> None:
    trace = short_move(mikron)
    write_trace(trace, tmp_path / "move.parquet")
    of_file, of_trace = simulate(mikron, tmp_path / "move.parquet"), simulate(mikron, trace)
    assert np.allclose(of_file.trace.get("X", "position"), of_trace.trace.get("X", "position"), atol=1e-15)
    with pytest.raises(InputError, match=r"part\.mpf: a part program becomes set points with twin\.interpolate"):
        simulate(mikron, "part.mpf")
    with pytest.raises(InputError, match="not ndarray"):
        simulate(mikron, np.zeros((3, 5)))  # type: ignore[arg-type]
