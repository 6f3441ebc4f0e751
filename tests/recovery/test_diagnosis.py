"""Hidden effects found on machines that are not the twin: the examination's plant records, the search names.

One axis, two short runs each; the whole library is a candidate every time. The long examination is a command.
"""

from concurrent.futures import ThreadPoolExecutor
import tomllib

import pytest

from examples.diagnose import record, short_runs
from twin.campaign import read_campaign
from twin.diagnose.observe import observe, view_of
from twin.diagnose.search import search
from twin.exam.draw import draw_case
from twin.exam.parameters import Richness
from twin.machine import default_machine_path, load_machine

SEED = 41


def found_on(folder, kind, effect, axis):
    """Draw a machine, record it, search the axis; (found, truth)."""
    table = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    case = draw_case(SEED, kind, table, effect=effect, axis=axis if effect else None, richness=Richness.off())
    record(case, short_runs(axis), axis, folder, table)
    machine = load_machine()
    campaign = read_campaign(folder, machine)
    group = observe([view_of(machine, run) for run in campaign.runs], (axis,))
    with ThreadPoolExecutor(2) as pool:
        return search(group, machine, [[0], [1]], lambda f, items: list(pool.map(f, items)), lambda _: None), case


@pytest.mark.parametrize(
    ("effect", "parameter", "accuracy"),
    [
        ("loop_delay", "delay_s", 0.05),
        ("set_point_filter", "time_constant_s", 0.05),
        ("coulomb_friction", "factor", 0.1),
        ("backlash", "clearance", 0.05),
    ],
)
def test_hidden_effect_is_named_with_its_size(tmp_path, effect, parameter, accuracy):
    found, case = found_on(tmp_path, "single", effect, "Y")
    assert [s.effect.name for s in found.fit.settings] == [effect]
    truth = case.effects[0]["parameters"][parameter] if "parameters" in case.effects[0] else case.effects[0][parameter]
    value = found.fit.settings[0].parameters[parameter]
    neutral = 1.0 if parameter == "factor" else 0.0
    assert abs(value - truth) < accuracy * abs(truth - neutral)


def test_healthy_machine_has_none(tmp_path):
    found, _ = found_on(tmp_path, "healthy", None, "Y")
    assert found.fit.settings == ()
