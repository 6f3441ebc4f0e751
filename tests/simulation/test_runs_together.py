"""Several machines in one loop: each run is bit-identical to a run alone."""

from __future__ import annotations

from collections.abc import Sequence
import itertools

import numpy as np
import pytest

from tests.conftest import swings
from twin.effects import with_effects
from twin.errors import InputError, SimulationError
from twin.machine.machine import Machine
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.prepared import prepared_run
from twin.simulation.run import MOST_AXES, Run, SimulationJob, _batches, all_or_raise, simulate, simulate_each
from twin.simulation.setpoints import Setpoints

BACKLASH = {"name": "backlash", "axis": "X", "clearance": 12e-6}
PUSHED = {"name": "cross_axis_coupling", "axis": "X", "from_axis": "Y", "mass": 40.0}
FILTER = {"name": "current_filter", "axis": "Y", "time_constant_s": 1e-3}
SLIP = {"name": "presliding", "axis": "Y", "stiffness": 3e8}
LATE = {"name": "set_point_filter", "axis": "X", "time_constant_s": 2e-3}


def job(machine: Machine, seconds: float, effects: Sequence[dict] = (), seed: int | None = None) -> SimulationJob:
    """X, Y and A of the machine with these effects on oscillations of that duration."""
    part = with_effects(machine.with_axes(["X", "Y", "A"]), effects)
    points = swings(part, seconds)
    speed = np.gradient(points.position, points.period, axis=0)
    motion = Motion(points.position, speed, np.gradient(speed, points.period, axis=0), points.period)
    return SimulationJob(part, points, lambda change: DecoupledPlant(change, motion), noise_seed=seed, started_at=seconds)


def alone(of: SimulationJob) -> Run:
    return simulate(
        of.machine, of.setpoints, plant_of=of.plant_of, sample_period=of.sample_period, started_at=of.started_at, noise_seed=of.noise_seed
    )


def assert_same(found: Run, expected: Run) -> None:
    for one, other in ((found.trace, expected.trace), (found.without_noise, expected.without_noise)):
        assert one.signals.keys() == other.signals.keys()
        for key, values in other.signals.items():
            np.testing.assert_array_equal(one.signals[key], values, err_msg=str(key))
    assert found.current_limited_s == expected.current_limited_s
    assert found.voltage_limited_s == expected.voltage_limited_s


@pytest.mark.parametrize("seeds", [[None], [5], [None, 5, 6]], ids=["ideal", "with noise", "ideal beside noise"])
def test_each_run_equals_that_of_the_machine_alone(mikron: Machine, seeds: list[int | None], monkeypatch) -> None:
    # different terms, separate rotors, coupled axes, runs of different lengths in one loop, which they leave at their ends
    monkeypatch.setattr("twin.simulation.run.cores", lambda: 1)
    monkeypatch.setattr("twin.simulation.prepared.STRETCH_TICKS", 1_600)
    jobs = [
        job(mikron, seconds, effects, seed)
        for (seconds, effects), seed in zip(
            ((0.9, []), (0.9, [BACKLASH, PUSHED]), (0.7, [FILTER, SLIP]), (0.9, [LATE, BACKLASH]), (0.6, [PUSHED])), itertools.cycle(seeds)
        )
    ]
    for found, one in zip(all_or_raise(simulate_each(jobs)), jobs):
        assert_same(found, alone(one))


def test_noise_realisations_in_one_loop_equal_those_alone(mikron: Machine) -> None:
    jobs = [job(mikron, 0.5, [], seed) for seed in (1, 2, 1)]
    first, second, again = all_or_raise(simulate_each(jobs))
    assert_same(first, again)
    assert_same(second, alone(jobs[1]))
    assert not np.array_equal(first.trace.get("X", "position"), second.trace.get("X", "position"))


def test_a_divergence_does_not_affect_the_other_machines(mikron: Machine) -> None:
    jobs = [job(mikron, 0.6), job(mikron.with_axis("X", max_velocity=0.01), 0.6), job(mikron, 0.6, [BACKLASH])]
    first, bad, last = simulate_each(jobs)
    assert isinstance(bad, SimulationError)
    with pytest.raises(SimulationError) as expected:
        alone(jobs[1])
    assert str(bad) == str(expected.value)
    assert_same(first, alone(jobs[0]))
    assert_same(last, alone(jobs[2]))


def test_a_machine_that_cannot_be_held_returns_its_error(mikron: Machine) -> None:
    heavy = {"name": "constant_force", "axis": "X", "force": 1e5}
    first, bad = simulate_each([job(mikron, 0.4), job(mikron, 0.4, [heavy])])
    assert isinstance(first, Run)
    assert isinstance(bad, InputError)
    assert "cannot be held" in str(bad)
    with pytest.raises(InputError, match="cannot be held"):
        all_or_raise([first, bad])


def test_a_result_function_receives_number_and_run(mikron: Machine) -> None:
    jobs = [job(mikron, seconds) for seconds in (0.3, 0.5, 0.4)]
    assert simulate_each(jobs, of=lambda i, run: (i, len(run.trace.time))) == [(0, 301), (1, 501), (2, 401)]


def test_batches_hold_compatible_runs_up_to_the_maximum(mikron: Machine) -> None:
    def one(of: SimulationJob, plant_of=None):
        return prepared_run(of.machine, of.setpoints, plant_of or of.plant_of, noise_seed=of.noise_seed)

    axes = len(job(mikron, 0.5).machine.axes)
    prepared = [one(job(mikron, seconds)) for seconds in (0.5, 0.4, 0.3, 0.2, 0.1, 0.5, 0.5)]
    prepared += [one(job(mikron, 0.5), MujocoPlant), one(job(mikron, 0.5), MujocoPlant)]
    *shared, first_alone, second_alone = _batches(dict(enumerate(prepared)))
    assert (first_alone, second_alone) == ([7], [8])
    assert sorted(i for batch in shared for i in batch) == list(range(7))
    assert all(len(batch) * axes <= MOST_AXES for batch in shared)
    ticks = [[prepared[i].ticks for i in batch] for batch in shared]
    assert all(batch == sorted(batch, reverse=True) for batch in ticks)
    assert max(map(sum, ticks)) < 1.2 * min(map(sum, ticks))


def test_few_axes_are_spread_over_the_processors_only_if_each_has_enough(mikron: Machine, monkeypatch) -> None:
    monkeypatch.setattr("twin.simulation.run.cores", lambda: 2)
    of = job(mikron, 0.2)
    alone, points = mikron.with_axes(["X"]), of.setpoints.part((0,))
    motion = nominal_motion(alone, points)
    prepared = {i: prepared_run(alone, points, lambda change: DecoupledPlant(change, motion)) for i in range(5)}
    assert [len(batch) for batch in _batches(prepared)] == [3, 2]
    assert len(_batches({i: prepared[i] for i in range(3)})) == 1


def test_mujoco_runs_are_simulated_one_by_one(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])
    points = Setpoints(swings(mikron, 0.3).position[:, :1], 1e-3)
    both = all_or_raise(simulate_each([SimulationJob(machine, points, MujocoPlant)] * 2))
    for found in both:
        assert_same(found, simulate(machine, points))
