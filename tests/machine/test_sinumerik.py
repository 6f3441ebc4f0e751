"""SINUMERIK machine data: conversion in both directions, and contradictions with plain keys."""

from __future__ import annotations

from pathlib import Path
import tomllib

import pytest

from twin.errors import InputError
from twin.machine.machine import Machine, default_machine_path, load_machine
from twin.machine.sinumerik import DATA, control_cycles, machine_data, plain_values, read_machine_data

X = {"kind": "linear"}
EXPECTED = {  # datum of X of the Mikron on the control -> in its unit
    "POSCTRL_GAIN": 3.0,  # 50/s = 3 (m/min)/mm = 3 1000/min
    "MAX_AX_VELO": 30_000.0,  # mm/min
    "MAX_AX_ACCEL": 2.5,
    "MAX_AX_JERK": 5.0,
    "LEADSCREW_PITCH": 10.0,  # mm
    "POS_LIMIT_MINUS": -355.0,
    "POS_LIMIT_PLUS": 355.0,
    "VELO_FFW_WEIGHT": 1.0,
    "EQUIV_SPEEDCTRL_TIME": 0.002,  # s
    "SPEEDCTRL_GAIN_1": 3.4,
    "SPEEDCTRL_INTEGRATOR_TIME_1": 10.0,  # ms, the drive's default
    "CURRCTRL_GAIN": 16.0,
    "CURRCTRL_INTEGRATOR_TIME": 12_000.0,  # us
    "TORQUE_CURRENT_RATIO": 1.4,
    "MOTOR_MAX_CURRENT": 46.0,
    "AX_INERTIA": 0.00857312071374091,
    "FFW_MODE": 4.0,  # velocity and torque
}


def document() -> dict:
    return tomllib.loads(default_machine_path().read_text(encoding="utf-8"))


def test_values_on_the_control() -> None:
    found = {datum.name: value for datum, value in machine_data(document()["axis"]["X"])}
    assert found == pytest.approx(EXPECTED)


def test_rotary_axes_in_turns_and_degrees() -> None:
    found = {datum.name: (value, datum.unit) for datum, value in machine_data(document()["axis"]["A"])}
    assert found["MAX_AX_VELO"] == (15.0, "rev/min")
    assert found["MAX_AX_ACCEL"] == (pytest.approx(0.83), "rev/s2")
    assert found["POS_LIMIT_MINUS"] == (-100.0, "deg")
    assert found["DRIVE_AX_RATIO_NUMERA"] == (180.0, "1")


def with_machine_data(tmp_path: Path, take: bool, **changed: float) -> Path:
    """The Mikron with machine data of X in addition to the plain keys, or in place of them (`take`)."""
    import tomlkit

    written = tomlkit.parse(default_machine_path().read_text(encoding="utf-8"))
    axis = written["axis"]["X"]
    data = dict(machine_data(document()["axis"]["X"]))
    axis["sinumerik"] = {d.label if i % 2 else d.name: changed.get(d.name, v) for i, (d, v) in enumerate(data.items())}
    if take:
        for datum in data:
            *tables, key = datum.key.split(".")
            if key in ("0", "1") or not datum.key:
                axis.pop("travel_m", None)
                continue
            target = axis
            for name in tables:
                target = target[name]
            del target[key]
        del axis["loops"]["torque_feedforward"]
    path = tmp_path / "machine.toml"
    path.write_text(tomlkit.dumps(written), encoding="utf-8")
    (tmp_path / "mikron_ucp710.xml").write_bytes(default_machine_path().with_suffix(".xml").read_bytes())
    return path


@pytest.mark.parametrize("take", [False, True])
def test_the_same_machine_from_machine_data(mikron: Machine, tmp_path: Path, take: bool) -> None:
    import dataclasses

    axis = load_machine(with_machine_data(tmp_path, take)).axis("X")
    for field in dataclasses.fields(axis):
        if field.name not in ("motor", "loops"):
            assert getattr(axis, field.name) == pytest.approx(getattr(mikron.axis("X"), field.name)), field.name
    for part in ("motor", "loops"):
        assert dataclasses.asdict(getattr(axis, part)) == pytest.approx(dataclasses.asdict(getattr(mikron.axis("X"), part)))


def test_a_change_is_written_to_the_table_that_holds_the_number(tmp_path: Path) -> None:
    machine = load_machine(with_machine_data(tmp_path, take=True))
    changed = machine.with_values({"axis.X.loops.position_gain_per_s": 40.0, "axis.X.max_velocity_m_per_min": 24.0})
    assert changed.axis("X").loops.position_gain_per_s == pytest.approx(40.0)
    assert changed.axis("X").max_velocity == pytest.approx(0.4)
    table = changed.document["axis"]["X"]["sinumerik"]
    assert pytest.approx(2.4) in table.values()
    assert "position_gain_per_s" not in changed.document["axis"]["X"]["loops"]


@pytest.mark.parametrize(("enable", "delay_s"), [(None, 0.005), (1.0, 0.005), (0.0, None)])
def test_dynamic_stiffness_control(enable: float | None, delay_s: float | None) -> None:
    """The delay is used unless it is switched off, and is shown as a datum together with its switch."""
    data = {32644: 0.005} | ({} if enable is None else {32640: enable})
    assert plain_values(data, "linear").get("loops.dsc_delay_s") == delay_s
    back = {d.number: value for d, value in machine_data({"kind": "linear", "loops": {"dsc_delay_s": delay_s or 0.0}})}
    assert back.get(32640) == (1.0 if delay_s else None)


def test_two_values_that_disagree(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"position_gain_per_s = 50 and its machine datum .33.3333. disagree"):
        load_machine(with_machine_data(tmp_path, take=False, POSCTRL_GAIN=2.0))


def test_cycles_do_not_belong_to_an_axis(tmp_path: Path) -> None:
    path = with_machine_data(tmp_path, take=False)
    text = path.read_text(encoding="utf-8").replace("[axis.X.sinumerik]\n", "[axis.X.sinumerik]\nMD10050 = 0.004\nMD10060 = 1\n")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"axis.X.sinumerik.: MD10050 belongs to the whole control"):
        load_machine(path)


def test_feedforward_mode() -> None:
    weights = {mode: plain_values({32620: float(mode), 32610: 0.9}, "linear") for mode in range(5)}
    assert [w["loops.velocity_feedforward"] for w in weights.values()] == [0.0, 0.9, 0.9, 0.9, 0.9]
    assert [w["loops.torque_feedforward"] for w in weights.values()] == [0.0, 0.0, 1.0, 0.0, 1.0]


def test_gear_before_a_screw() -> None:
    """A pitch of 20 mm behind a 4 : 2 gear is 10 mm per motor revolution."""
    assert plain_values({31030: 20.0, 31060: 4.0, 31050: 2.0}, "linear")["screw_lead_m_per_rev"] == pytest.approx(0.010)
    assert plain_values({31060: 360.0, 31050: 2.0}, "rotary")["gear_ratio"] == pytest.approx(180.0)


ARCHIVE = """\
; part of an archive
N10000 $MN_AXCONF_MACHAX_NAME_TAB[0]="X1"
N10000 $MN_AXCONF_MACHAX_NAME_TAB[1]="A1"
N10050 $MN_SYSCLOCK_CYCLE_TIME=0.002
N10060 $MN_POSCTRL_SYSCLOCK_TIME_RATIO=1
N10070 $MN_IPO_SYSCLOCK_TIME_RATIO=4
N1000 $MD_CURRCTRL_CYCLE_TIME=4
N1001 $MD_SPEEDCTRL_CYCLE_TIME=4
N32200 $MA_POSCTRL_GAIN[0,AX1]=3 '
N32200 $MA_POSCTRL_GAIN[1,AX1]=1 '
N32200 $MA_POSCTRL_GAIN[0,AX2]=1.5
N32300 $MA_MAX_AX_ACCEL[AX2]=0.83
N34000 $MA_REFP_CAM_IS_ACTIVE[AX1]=1
"""


def test_an_archive_of_the_control(tmp_path: Path) -> None:
    (tmp_path / "nc.tea").write_text(ARCHIVE, encoding="utf-8")
    data, left = read_machine_data(tmp_path / "nc.tea", {"X": "linear", "A": "rotary"})
    assert plain_values(data["X"], "linear") == {"loops.position_gain_per_s": pytest.approx(50.0)}
    assert plain_values(data["A"], "rotary") == {
        "loops.position_gain_per_s": pytest.approx(25.0),
        "max_acceleration_rev_per_s2": pytest.approx(0.83),
    }
    assert control_cycles(data[""]) == pytest.approx(
        {"current_cycle_us": 125.0, "speed_cycle_us": 125.0, "position_cycle_us": 2000.0, "interpolation_cycle_us": 8000.0}
    )
    assert left == ["MD34000"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.toml", "[X]\nPOSCTRL_GAINS = 3", "did you mean 'POSCTRL_GAIN'"),
        ("x.toml", "[X]\nMD32200 = 'much'", "expected a number"),
        ("x.toml", "[X]\nMD32200 = 3\nPOSCTRL_GAIN = 3", "is given twice"),
        ("x.toml", "[Q]\nMD32200 = 3", "no such axis"),
        ("x.toml", "[X", "not a valid TOML file"),
        ("x.tea", "nothing here", "no line like N32200"),
        *(("x.toml", f"[X]\nMD{md} = 0", f"[X].: MD{md} = 0: impossible; give a number above 0") for md in (1113, 31030, 31050, 31060)),
        ("x.tea", "N31050 $MA_DRIVE_AX_RATIO_DENOM[0,AX1]=0", "axis X: MD31050 = 0: impossible; give a number above 0"),
        ("x.toml", "[X]\nMD10050 = 0.004", r"MD10050 belongs to the whole control, not to an axis; .* in .control. of the machine file"),
        ("x.toml", "[X]\nPOSCTRL_SYSCLOCK_TIME_RATIO = 2", "POSCTRL_SYSCLOCK_TIME_RATIO belongs to the whole control"),
    ],
)
def test_bad_machine_data(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message.replace("'", ".")) as error:
        read_machine_data(tmp_path / name, {"X": "linear"})
    assert "\n" not in str(error.value)


def test_each_datum_once() -> None:
    for kind in DATA:
        for what in ("number", "name", "key"):
            values = [getattr(d, what) for d in DATA[kind]]
            assert len(values) == len(set(values)), what


def test_machine_data_of_a_spindle_belong_to_no_axis(tmp_path: Path) -> None:
    lines = [f'N10000 $MN_AXCONF_MACHAX_NAME_TAB[{i}]="{name}"' for i, name in enumerate(("X1", "SP1", "Y1"))]
    lines += [f"N32000 $MA_MAX_AX_VELO[AX{i}]={speed}" for i, speed in ((1, 10000), (3, 15000), (2, 500))]
    (tmp_path / "nc.tea").write_text("\n".join(lines) + "\n", encoding="utf-8")
    found, _ = read_machine_data(tmp_path / "nc.tea", {"X": "linear", "Y": "linear"})
    assert {axis: data[32000] for axis, data in found.items()} == {"X": 10000.0, "Y": 15000.0}
