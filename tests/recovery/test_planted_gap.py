"""A campaign made by the twin: the gap is noise without a planted error, and shows a planted one."""

from pathlib import Path

import pytest

from tests.conftest import swings
from twin.cli import main
from twin.machine.machine import Machine
from twin.recordings.trace import write_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

RUNS = {"slow": ("velocity", 0.7), "fast": ("velocity+torque", 1.0)}


def record(machine: Machine, folder: Path) -> Path:
    """Record two runs of a machine with measuring noise, as a campaign."""
    lines = ['machine = "mikron_ucp710"\n']
    for i, (name, (feedforward, size)) in enumerate(RUNS.items()):
        points = swings(machine, 1.2)
        points = Setpoints(points.position[0] + size * (points.position - points.position[0]), points.period)
        trace = simulate(machine.with_feedforward(feedforward), points, noise_seed=100 + i).trace
        write_trace(trace, folder / f"{name}.parquet")
        lines.append(f'[[run]]\nfile = "{name}.parquet"\nfeedforward = "{feedforward}"\n')
    (folder / "campaign.toml").write_text("".join(lines))
    return folder


def gaps(folder: Path) -> dict:  # type: ignore[type-arg]
    import json

    assert main(["gap", str(folder), "--json", str(folder / "gap.json")]) == 0
    return json.loads((folder / "gap.json").read_text())["runs"]  # type: ignore[no-any-return]


def test_without_planted_effects_the_gap_is_noise(mikron: Machine, tmp_path: Path) -> None:
    for run, axes in gaps(record(mikron, tmp_path)).items():
        for axis, signals in axes.items():
            for signal, gap in signals.items():
                assert 0.7 * gap["noise"] < gap["rms"] < 1.4 * gap["noise"], f"{run} {axis} {signal}"


@pytest.mark.parametrize(
    ("axis", "key", "value", "signal"),
    [
        ("X", "moving_mass_kg", 910.0, "motor_position"),
        ("C", "coulomb_friction_nm", 0.42, "current"),
        ("Y", "position_delay_s", 0.00215, "position"),
        ("A", "speed_gain_nm_s_per_rad", 0.55, "position"),
    ],
)
def test_a_planted_effect_shows_on_its_axis(mikron: Machine, tmp_path: Path, axis: str, key: str, value: float, signal: str) -> None:
    table = f"axis.{axis}.loops" if hasattr(mikron.axis(axis).loops, key) else f"axis.{axis}"
    planted = mikron.with_values({f"{table}.{key}": value})
    for run, axes in gaps(record(planted, tmp_path)).items():
        worst = {name: signals[signal]["rms"] / signals[signal]["noise"] for name, signals in axes.items()}
        assert worst[axis] > 1.5, f"{run}: {worst}"
        assert max(worst, key=lambda name: worst[name]) == axis, f"{run}: {worst}"
