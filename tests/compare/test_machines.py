"""Two machine files compared: a faulty one is refused."""

from pathlib import Path

import pytest

from tests.builders.refused import refused
from tests.builders.small_machine import TOML, write_small_machine


@pytest.mark.parametrize(
    ("line", "says"),
    [('[[effect]]\naxis = "U"\nclearance = 1e-5\n', "an effect needs a name"), ('name = ["small"]\n', "name = ['small'] is not text")],
)
def test_a_faulty_machine_is_not_compared(line: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = write_small_machine(tmp_path)
    text = TOML.replace("[axis.U]", line + "[axis.U]", 1) if line[0] == "[" else TOML.replace('name = "small"\n', line)
    (tmp_path / "other.toml").write_text(text, encoding="utf-8")
    assert says in refused(capsys, "compare", str(machine), str(tmp_path / "other.toml"), "--out", str(tmp_path / "out"))
