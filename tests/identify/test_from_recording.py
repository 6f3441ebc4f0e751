"""A machine from a recording alone is identified as by `twin identify`, and never follows worse than its first values."""

from pathlib import Path

from tests.builders.other_structures import machine_text, write_slides
from tests.machine.test_from_recording import recorded
from twin.identify import from_recording
from twin.identify.from_recording import machine_from_recording
from twin.machine.machine import load_machine


def test_a_new_machine_follows_like_an_identified_one(tmp_path: Path) -> None:
    for name in ("slides", "campaign"):
        (tmp_path / name).mkdir()
    machine = load_machine(write_slides(tmp_path / "slides", machine_text("Z", cycles_us=(250, 1000)))).with_feedforward("off")
    folder = recorded(tmp_path / "campaign", machine)
    first = machine_from_recording(folder, tmp_path / "first.toml", identified=False)
    made = machine_from_recording(folder, tmp_path / "made.toml")
    assert made.followed["Z"].merit < 0.7 * first.followed["Z"].merit
    text = (tmp_path / "made.toml").read_text(encoding="utf-8")
    assert "# tried" in (tmp_path / "first.toml").read_text(encoding="utf-8")
    assert "# tried" not in text
    assert "[identified]" in text


def test_the_first_machine_stays_if_the_fit_follows_worse(tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    for name in ("slides", "campaign"):
        (tmp_path / name).mkdir()
    machine = load_machine(write_slides(tmp_path / "slides", machine_text("Z", cycles_us=(250, 1000)))).with_feedforward("off")
    folder = recorded(tmp_path / "campaign", machine, 1.0)
    first = machine_from_recording(folder, tmp_path / "made.toml", identified=False)
    text = (tmp_path / "made.toml").read_text(encoding="utf-8")
    for file in ("made.toml", "made.xml"):
        (tmp_path / file).unlink()
    monkeypatch.setattr(
        from_recording, "write_identified", lambda _result, out: out.write_text(text.replace("position_gain", "_"), encoding="utf-8")
    )
    made = machine_from_recording(folder, tmp_path / "made.toml")
    assert made.followed == first.followed
    assert (tmp_path / "made.toml").read_text(encoding="utf-8") == text
