"""What a recording is judged by: the noise of the records, also where the machine file gives none, and the causes that are left once all are known."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.machine.test_from_recording import LAB_AXIS, recorded
from twin.history.columns import directions_of
from twin.history.contrast import Contrast
from twin.history.projection import Reference
from twin.history.since import _searched
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import read_campaign


def test_a_channel_whose_noise_the_file_lacks_has_that_of_the_record(tmp_path: Path) -> None:
    """A machine from a recording has no noise of speed and command: each of their samples counted as exact, and the next recording was called changed."""
    machine = load_machine(LAB_AXIS)
    (run,) = read_campaign(recorded(tmp_path / "campaign", machine, 1.0), machine).runs
    noise = 2e-4 * np.random.default_rng(0).standard_normal(len(run.trace.time))
    speed = np.gradient(run.trace.get("X", "motor_position"), run.trace.period) + noise
    run.trace.signals["X", "velocity"] = speed
    ((_, own),) = Reference(machine, map, lambda: [run]).linearised([run], ("X",))
    (channel,) = [level for name, level in own.noise.items() if "speed" in name or "velocity" in name]
    assert channel == pytest.approx(2e-4, rel=0.3)


def test_a_cause_goes_again_once_others_explain_what_it_did(mikron: Machine) -> None:
    """Two small changes look like a third at first; with both named, it is the noise alone that it explains."""
    directions = directions_of(mikron, ("X", "Y"))
    first, second, like_both = (
        next(k for k, d in enumerate(directions) if d.cause[0] == name) for name in ("inertia", "backlash", "loop_delay")
    )
    columns = 100.0 * np.eye(len(directions))
    columns[[first, second, like_both], like_both] = 70.0, 70.0, 10.0
    gram, seen = columns.T @ columns, columns[:, first] + 0.8 * columns[:, second]
    seen[like_both] += 2.0

    def rights_of(changes: list) -> dict[str, np.ndarray]:
        return {"X position": gram @ np.array([sum(theta for d, theta in changes if d is one) for one in directions])}

    runs, moved = [("run", SimpleNamespace(rights_of=rights_of))], columns.T @ seen
    contrast = Contrast(directions, runs, [gram[None]], [moved[None]], ["X position"], np.full(len(directions), 1e-6), 1.0, [])  # type: ignore[arg-type]
    found = _searched(contrast, ("X",)).found
    assert {one.cause[0]: one.size for one in found} == pytest.approx({"inertia": 1.0, "backlash": 0.8}, rel=1e-3)


def test_what_the_twin_errs_in_one_channel_hides_nothing_in_another(mikron: Machine) -> None:
    """One channel changes in a way that no cause does, a hundred times as much as another by a friction that shows there alone."""
    directions = directions_of(mikron, ("X",))
    k = next(k for k, d in enumerate(directions) if d.cause[0] == "coulomb_friction")
    random = np.random.default_rng(1)
    clear, rough = (random.standard_normal((400, len(directions))) for _ in range(2))
    rough[:, k] = 0.0
    grams = np.array([100.0 * clear.T @ clear, 100.0 * rough.T @ rough])
    error = 1000.0 * rough.T @ random.standard_normal(400)

    def rights_of(changes: list) -> dict[str, np.ndarray]:
        theta = np.array([sum(theta for d, theta in changes if d is one) for one in directions])
        return {"X current": grams[0] @ theta, "X position": grams[1] @ theta}

    moved = grams @ (0.3 * (np.arange(len(directions)) == k)) + np.array([np.zeros(len(directions)), error])
    runs, channels = [("run", SimpleNamespace(rights_of=rights_of))], ["X current", "X position"]
    contrast = Contrast(directions, runs, [grams], [moved], channels, np.full(len(directions), 1e-6), 1.0, [])  # type: ignore[arg-type]
    (one,) = _searched(contrast, ("X",)).found
    assert one.cause[0] == "coulomb_friction"
    assert one.size == pytest.approx(0.3, abs=0.01)
    assert contrast.explained(contrast.change, [k]).errors == pytest.approx([1.0, 1e4], rel=0.5)
