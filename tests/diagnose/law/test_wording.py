"""The sentence of a law states its direction."""

from types import SimpleNamespace

import pytest

from twin.diagnose.law.wording import sentence
from twin.effects import check_setting
from twin.machine.machine import Machine

BELL = {"name": "law", "axis": "X", "block": "mechanics", "formula": "gaussian", "variables": ["position"], "width": 0.17, "at": 0.14}


@pytest.mark.parametrize(
    ("output", "height", "said"),
    [
        ("friction", -3.6, "(3.6 +- 0.2) N lower around (140 +- 4) mm"),
        ("friction", 3.6, "(3.6 +- 0.2) N higher around (140 +- 4) mm"),
        ("force", -3.6, "height (-3.6 +- 0.2) N"),
        ("force", 3.6, "height (3.6 +- 0.2) N"),
    ],
)
def test_the_sentence_of_a_gaussian_states_its_sign(mikron: Machine, output: str, height: float, said: str) -> None:
    setting = check_setting({**BELL, "output": output, "height": height}, mikron, "a test")
    law = SimpleNamespace(axis="X", setting=setting, deviations={"height": 0.1, "at": 0.002, "width": 0.001})
    assert said in sentence(law, mikron)
