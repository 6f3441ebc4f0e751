"""The direct route of identification on a recorded machine whose parameters are known."""

from pathlib import Path
import tomllib

import pytest

from twin.cli import main
from twin.machine import load_machine

CAMPAIGN = Path(__file__).parents[2].parent / "shared" / "campaigns" / "healthy"


@pytest.mark.skipif(not CAMPAIGN.is_dir(), reason="needs the recorded campaigns beside the repository (../shared/campaigns)")
def test_healthy_machine_is_identified(tmp_path, capsys):
    out = tmp_path / "machine.toml"
    assert main(["identify", str(CAMPAIGN), "--out", str(out), "--no-refine"]) == 0
    capsys.readouterr()
    truth = tomllib.loads((CAMPAIGN / "truth.toml").read_text(encoding="utf-8"))["parameter"]
    nominal, found = load_machine(), load_machine(out)
    for name in "XYZAC":
        before, after = nominal.axis(name), found.axis(name)
        # torque constant and friction come as a product; judge that
        for quantity, bound in (("coulomb_friction_nm", 0.01), ("viscous_friction_nm_s_per_rad", 0.03)):
            true = getattr(before, quantity) * truth[name][quantity.split("_nm")[0]] / truth[name]["torque_constant"]
            told = getattr(after, quantity) / (after.motor.torque_constant_nm_per_a / before.motor.torque_constant_nm_per_a)
            assert told == pytest.approx(true, rel=bound), (name, quantity)
        assert after.loops.position_gain_per_s == pytest.approx(50.0, rel=1e-3)
        assert after.loops.position_delay_s == pytest.approx(0.002, abs=20e-6)


def test_campaign_that_is_missing(tmp_path, capsys):
    assert main(["identify", str(tmp_path / "nowhere"), "--out", str(tmp_path / "m.toml")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
