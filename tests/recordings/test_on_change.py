"""Recordings of servers that send a value only when it changes."""

from pathlib import Path

import numpy as np
import pytest

from twin.cli import main
from twin.recordings.campaign import read_campaign
from twin.recordings.formats.by_content import read_recording
from twin.recordings.signals import Clock, ReadOptions, Recording

STEP_S = 0.01


def strokes() -> dict[str, np.ndarray]:
    """Set point and position of strokes with rests (sample,) [mm], to 0.1 um."""
    t = np.arange(1200) * STEP_S
    path = 40.0 * np.clip(np.sin(1.3 * t), -0.8, 0.8)
    return {"SetPosition": np.round(path, 4), "ActPosition": np.round(np.interp(t - 0.03, t, path), 4)}


def changes(values: np.ndarray) -> np.ndarray:
    """Rows where a value is sent."""
    return np.flatnonzero(np.diff(values, prepend=values[0] - 1.0))


def read(file: Path) -> Recording:
    return read_recording(file, ReadOptions(Clock(), None, file.parent / "scratch"))


@pytest.mark.parametrize("layout", ["a value a row", "a column each"])
def test_a_value_holds_until_the_next_one(tmp_path: Path, layout: str) -> None:
    """A spline between the last sample of a stroke and the first of the next one would move the axis in each rest; without rows, it was refused."""
    signals, file = strokes(), tmp_path / "run.csv"
    sent = {name: {*changes(values).tolist()} for name, values in signals.items()}
    if layout == "a value a row":
        rows = [f"{k * STEP_S:.2f},ns=3;s={name},{signals[name][k]}" for k in range(1200) for name in signals if k in sent[name]]
        file.write_text("\n".join(["time [s],name,value", *rows]) + "\n", encoding="utf-8")
    else:
        rows = [",".join([f"{k * STEP_S:.2f}", *(str(signals[n][k]) if k in sent[n] else "" for n in signals)]) for k in range(1200)]
        file.write_text("\n".join(["time [s],SetPosition,ActPosition", *rows]) + "\n", encoding="utf-8")
    assert main(["import", str(file), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    (run,) = read_campaign(tmp_path / "out").runs
    assert run.trace.period == pytest.approx(STEP_S)
    for name, signal in (("SetPosition", "setpoint"), ("ActPosition", "position")):
        arrived = run.trace.get("X", signal) * 1e3
        assert np.abs(arrived - signals[name][: len(arrived)]).max() < 1e-9


def test_lost_samples_are_missing_in_all_signals(tmp_path: Path) -> None:
    """Two channels of their own rates with one gap in both: nothing is held in it."""
    t = np.r_[0:3.0:0.01, 3.2:6.0:0.01]
    rows = [f"{a:.2f};{np.sin(a):.9f};{np.cos(a) if k % 4 == 0 else float('nan'):.9f}".replace("nan", "") for k, a in enumerate(t)]
    (tmp_path / "run.csv").write_text("\n".join(["time [s];command [mm];actual [mm]", *rows]) + "\n", encoding="utf-8")
    found = read(tmp_path / "run.csv")
    assert [len(signal.values) for signal in found.signals.values()] == [len(t), -(-len(t) // 4)]
    assert not any("each holds" in note for note in found.notes)
