"""Layouts of exports and logs: names, units and times of each arrive as written. The files are made here in the layouts of the programs named."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from devtools import fuzz_layouts
from tests.builders.refused import refused
from twin.cli import main
from twin.recordings.formats.by_content import read_recording
from twin.recordings.signals import Clock, ReadOptions, Recording
from twin.recordings.trace import read_trace

ROWS = 60
T = np.arange(ROWS) * 2e-3
A = np.round(10.0 * np.sin(40.0 * T), 4)
B = np.round(400.0 * np.cos(40.0 * T), 3)


def rows(line: Callable[[int], str]) -> str:
    return "".join(line(k) + "\n" for k in range(ROWS))


def de(value: float, places: int = 4) -> str:
    return f"{value:.{places}f}".replace(".", ",")


def tausend(value: float, places: int) -> str:
    """1.234,5"""
    return f"{value:,.{places}f}".translate(str.maketrans(",.", ".,"))


LAYOUTS: dict[str, tuple[str, dict[str, str], float | None]] = {
    # program -> text, names with units, interval [s] (None: unknown)
    "MR Configurator": (
        "Axis1\nNumber of sampling data,60\nSampling time interval(ms),2\nTime,Analog 1,Analog 2,Analog 3,Analog 4\n"
        "ms,Servo motor speed,Torque,Not selected,Not selected\n" + rows(lambda k: f"{2.0 * k:.6f},{B[k]:.6f},{A[k]:.6f},0.000000,0.000000"),
        {"Servo motor speed": "", "Torque": ""},
        2e-3,
    ),
    "TwinCAT Scope": (
        "Name\tscope\nFile\tC:\\scope.csv\nStarttime of export\t132959733843760000\tMontag, 2. Mai 2022\t15:56:24.376\n\n"
        "Name\tActPos\tName\tActVelo\nData-Type\tREAL64\tData-Type\tREAL64\nSampleTime[ms]\t2\tSampleTime[ms]\t4\nUnit\tmm\tUnit\tmm/s (Velocity)\n\n"
        + rows(lambda k: f"{2 * k}\t{de(A[k])}\t" + (f"{4 * k}\t{de(B[2 * k])}" if k < 30 else " \t ")) + "EOF\n",
        {"ActPos": "mm", "ActVelo": "mm/s"},
        2e-3,
    ),
    "halscope": (
        "Sampling period is 2000000 nSec \n\n" + rows(lambda k: f"joint.0.pos-cmd {'+' if A[k] >= 0 else ''}{de(A[k])} joint.0.vel-cmd {de(B[k])} joint.0.pos-cmd {'+' if A[k] >= 0 else ''}{de(A[k])} "),
        {"joint.0.pos-cmd": "", "joint.0.vel-cmd": ""},
        2e-3,
    ),
    "CODESYS trace as text": (
        "CODESYS Trace\nD:\\project.pro\nCycle PLC.fActPos PLC.fActVelo\n" + rows(lambda k: f"{k} {A[k]} {B[k]}"),
        {"PLC.fActPos": "", "PLC.fActVelo": ""},
        None,
    ),
    "log of a PLC": (
        "Date;axis.position;axis.speed;\n" + rows(lambda k: f"2003-10-01 02:44:55.{2 * k:03d};{A[k]};{B[k]};"),
        {"axis.position": "", "axis.speed": ""},
        2e-3,
    ),
    "date and pairs": (
        rows(lambda k: f"2003-10-01 02:44:55.{2 * k:03d};axis.position;{A[k]};axis.speed;{B[k]};"),
        {"axis.position": "", "axis.speed": ""},
        2e-3,
    ),
    "EPICS camonitor": (
        rows(lambda k: f"IOC:m1.RBV 2024-05-14 08:21:07.{2000 * k:06d} {A[k]}\nIOC:m1.VELO 2024-05-14 08:21:07.{2000 * k:06d} {B[k]}"),
        {"IOC:m1.RBV": "", "IOC:m1.VELO": ""},
        2e-3,
    ),
    "historian": (
        "TagName,TimeStamp,Value,Unit,Quality\n"
        + rows(lambda k: f"X.Pos,14.05.2024 08:21:07.{2 * k:03d},{A[k]},mm,Good\nX.Speed,14.05.2024 08:21:07.{2 * k:03d},{B[k]},mm/s,Good"),
        {"X.Pos": "mm", "X.Speed": "mm/s"},
        2e-3,
    ),
    "scope with lines of meaning": (
        "Timestamp,2020-03-16 17:04:51,Timestamp,2020-03-16 17:04:51\nInterval,0.002,Interval,0.002\nChannel name,\"Force\",Channel name,\"Input 1\"\n"
        "Unit,\"V\",Unit,\"mA\"\n" + rows(lambda k: f"{T[k]:.4g},{A[k]},{T[k]:.4g},{B[k]}"),
        {"Force": "V", "Input 1": "mA"},
        2e-3,
    ),
    "names in two lines": (
        ";X;;Y;\nt / ms;soll;ist;soll;ist\n" + rows(lambda k: f"{2 * k};{de(A[k])};{de(B[k])};{de(A[k] + 1)};{de(B[k] + 1)}"),
        {"X soll": "", "X ist": "", "Y soll": "", "Y ist": ""},
        2e-3,
    ),
    "names with their units, aligned by spaces": (
        "# measured at the bench\n#  Zeit in s    Istposition mm    Drehzahl 1/min\n" + rows(lambda k: f"{T[k]:12.4f} {A[k]:15.4f} {B[k]:14.3f}"),
        {"Istposition": "mm", "Drehzahl": "rev/min"},
        2e-3,
    ),
    "rate above the numbers": (
        "Abtastrate: 500 Hz\nposition [mm];current [A]\n" + rows(lambda k: f"{de(A[k])};{de(B[k])}"),
        {"position": "mm", "current": "A"},
        2e-3,
    ),
    "LabVIEW measurement": (
        "LabVIEW Measurement\t\nWriter_Version\t2\nX_Columns\tOne\n***End_of_Header***\t\nChannels\t2\t\nX_Value\tposition\tspeed\tComment\n"
        + rows(lambda k: f"{T[k]:.6f}\t{A[k]}\t{B[k]}"),
        {"position": "", "speed": ""},
        2e-3,
    ),
    "LabVIEW measurement with its channels": (
        "LabVIEW Measurement\t\nDecimal_Separator\t,\nDate\t2023/05/04\n***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t60\t60\t\n"
        "Delta_X\t0,002\t0,002\t\n***End_of_Header***\t\t\t\nX_Value\tSollposition (mm)\tStrom (A)\tComment\n"
        + rows(lambda k: f"{de(T[k])}\t{de(A[k])}\t{de(B[k])}"),
        {"Sollposition": "mm", "Strom": "A"},
        2e-3,
    ),
    "messages of ROS": (
        "%time,field.header.seq,field.header.stamp,field.joint_names0,field.desired.positions0\n"
        + rows(lambda k: f"{1741076467250000000 + 2000000 * k},{k},{1741076467249000000 + 2000000 * k},shoulder,{A[k]}"),
        {"field.header.seq": "", "field.desired.positions0": ""},
        2e-3,
    ),
    "Chinese": ("时间(ms),X轴指令位置(mm),X轴电流(A)\n" + rows(lambda k: f"{2 * k},{A[k]},{B[k]}"), {"X轴指令位置": "mm", "X轴电流": "A"}, 2e-3),
    "Japanese": ("時間[ms],指令位置[mm],トルク[Nm]\n" + rows(lambda k: f"{2 * k},{A[k]},{B[k]}"), {"指令位置": "mm", "トルク": "Nm"}, 2e-3),
    "rows as JSON": ("[" + ",".join(f'{{"t": {T[k]:.4f}, "x": {{"pos": {A[k]}, "all": [1.0, {B[k]}]}}}}' for k in range(ROWS)) + "]",
        {"x.pos": "", "x.all[0]": "", "x.all[1]": ""}, 2e-3),
    "a JSON object a line": (rows(lambda k: f'{{"t": {T[k]:.4f}, "pos [mm]": {A[k]}}}'), {"pos": "mm"}, 2e-3),
    "columns as JSON": (f'{{"t": {np.round(T, 4).tolist()}, "pos": {A.tolist()}}}', {"pos": ""}, 2e-3),
    "clock across midnight": (
        "Uhrzeit;position\n" + rows(lambda k: f"{'23:59:59' if k < 30 else '00:00:00'}.{(940 + 2 * k) % 1000:03d};{A[k]}"),
        {"position": ""},
        2e-3,
    ),
    "date and time of day in two columns": (
        "Datum,Zeit,pos\n" + rows(lambda k: f"14.05.2024,08:21:07.{2 * k:03d},{A[k]}"),
        {"pos": ""},
        2e-3,
    ),
    "microseconds since 1970": (
        "stamp_id,timestamp,position\n" + rows(lambda k: f"{k},{1741076467250000 + 2000 * k},{A[k]}"),
        {"stamp_id": "", "position": ""},
        2e-3,
    ),
    "nanoseconds since 1970": (
        "timestamp,position\n" + rows(lambda k: f"{1741076467250000000 + 2000000 * k},{A[k]}"),
        {"position": ""},
        2e-3,
    ),
    "nothing but numbers": (rows(lambda k: f"{A[k]}\t{B[k]}\t"), {"column 1": "", "column 2": ""}, None),
    "rows numbered": (",pos,vel\n" + rows(lambda k: f"{k},{A[k]},{B[k]}"), {"pos": "", "vel": ""}, None),
    "a column that only counts seconds": (
        "time,timestamp,pos\n" + rows(lambda k: f"{int(T[k])},{1550.0 + T[k]:.4f},{A[k]}"),
        {"time": "", "pos": ""},
        2e-3,
    ),
    "row names of R": ("pos\tvel\n" + rows(lambda k: f"{k + 1}\t{A[k]}\t{B[k]}"), {"pos": "", "vel": ""}, None),
    "units in brackets between spaces": ("t [ms] pos [mm] vel (mm/s)\n" + rows(lambda k: f"{2 * k} {A[k]} {B[k]}"), {"pos": "mm", "vel": "mm/s"}, 2e-3),
    "UTF-16 with decimal commas": (
        "Zeit [ms]\tLageistwert [mm]\n" + rows(lambda k: f"{2 * k}\t{de(A[k])}"),
        {"Lageistwert": "mm"},
        2e-3,
    ),
    "tests one after the other": (
        "".join(f"*** test {n} ***\nv = {n} m/min\n\ntime [s];pos [mm];speed\n" + rows(lambda k: f"{de(T[k])};{de(A[k])};{de(B[k])}") + "\n" for n in (1, 2, 3)),
        {"pos": "mm", "speed": ""},
        2e-3,
    ),
    "closing lines": (
        "time [s];pos [mm]\n" + rows(lambda k: f"{de(T[k])};{de(A[k])}") + "\nMin;-10,0\nMax;10,0\n# by a scope\n", {"pos": "mm"}, 2e-3
    ),
    "separated thousands": (
        "Zeit [us];Lageistwert [um];n [0,1 1/min]\n" + rows(lambda k: f"{tausend(2000 * k, 1)};{tausend(A[k] * 1e3, 3)};{de(10 * B[k], 2)}"),
        {"Lageistwert": "um", "n": "rev/min"},
        2e-3,
    ),
    "separated thousands in quotation marks": (
        "Time (us),pos (um)\n" + rows(lambda k: f'"{2000.0 * k:,.1f}","{A[k] * 1e3:,.1f}"'), {"pos": "um"}, 2e-3
    ),
    "decimal commas in quotation marks": (
        '"Zeit","pos"\n"s","mm"\n' + rows(lambda k: f'"{de(T[k])}","{de(A[k])}"'), {"pos": "mm"}, 2e-3
    ),
    "lists in cells": ("timestamp,q,extra\n" + rows(lambda k: f'{T[k]:.4f},"[{A[k]}, {B[k]}]",{k % 3}'), {"q[0]": "", "q[1]": "", "extra": ""}, 2e-3),
    "names over names": (
        "axis,X,X,Y,Y\nsignal,cmd,act,cmd,act\ntime [s],,,,\n" + rows(lambda k: f"{T[k]:.4f},{A[k]},{B[k]},{A[k] + 1},{B[k] + 1}"),
        {"X cmd": "", "X act": "", "Y cmd": "", "Y act": ""},
        2e-3,
    ),
    "units between the names": (
        "Time,Position,Position\ns,mm,mm\n,Command,Actual\n" + rows(lambda k: f"{T[k]:.4f},{A[k]},{B[k]}"), {"Command": "mm", "Actual": "mm"}, 2e-3
    ),
    "quantities over units": ("Zeit/s;Weg X/mm;Strom X/A\n" + rows(lambda k: f"{de(T[k])};{de(A[k])};{de(B[k])}"), {"Weg X": "mm", "Strom X": "A"}, 2e-3),
    "signals in lines": (
        "\n".join(",".join(map(str, row)) for row in (("Time [s]", *np.arange(200) * 2e-3), ("pos [mm]", *np.resize(A, 200)), ("speed", *np.resize(B, 200)))) + "\n",
        {"pos": "mm", "speed": ""},
        2e-3,
    ),
    "query of a database": (
        "#datatype,string,long,dateTime,dateTime,double,string,string\n,result,table,_start,_time,_value,_field,axis\n"
        + rows(lambda k: "\n".join(f",,{n},2024-05-03T08:00:00Z,2024-05-03T08:00:00.{2 * k:03d}Z,{value},pos,{axis}" for n, (axis, value) in enumerate((("X", A[k]), ("Y", B[k]))))),
        {"X pos": "", "Y pos": ""},
        2e-3,
    ),
    "samples of MTConnect": (
        "sequence,timestamp,dataItemId,name,value\n"
        + rows(lambda k: "\n".join(f"{2 * k + n},2024-05-03T08:00:00.{2 * k:03d}Z,x{n},{name},{value}" for n, (name, value) in enumerate((("Xact", A[k]), ("Xload", B[k]))))),
        {"Xact": "", "Xload": ""},
        2e-3,
    ),
    "streams of MTConnect": (
        '<?xml version="1.0"?><MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:1.3"><Streams><ComponentStream name="X"><Samples>'
        + "".join(f'<{kind} dataItemId="{kind}" timestamp="2024-05-03T08:00:00.{2 * k:03d}Z" subType="ACTUAL">{value}</{kind}>' for kind, own in (("Position", A), ("Load", B)) for k, value in enumerate(own))
        + "</Samples></ComponentStream></Streams></MTConnectStreams>",
        {"X actual position": "", "X actual load": ""},
        2e-3,
    ),
    "archive of a panel": (
        '"VarName";"TimeString";"VarValue";"Validity";"Time_ms"\n'
        + rows(lambda k: "\n".join(f'"{name}";"03.05.2024 08:00:00";{de(value)};1;{de(45415e6 + (1e6 / 3) + k * 2e-3 / 0.0864, 7)}' for name, value in (("pos", A[k]), ("speed", B[k]))))
        + '"$RT_OFF$";"03.05.2024 08:00:01";0;2;45415333345,0\n',
        {"pos": "", "speed": ""},
        2e-3,
    ),
    "seconds and their parts": (
        "stamp.sec,stamp.nanosec,pos\n" + rows(lambda k: f"{1741076467 + (k >= 30)},{(940 + 2 * k) % 1000 * 10**6},{A[k]}"), {"pos": ""}, 2e-3
    ),
    "ticks of Windows": ("FileTime;pos\n" + rows(lambda k: f"{133591392000000000 + 20000 * k};{A[k]}"), {"pos": ""}, 2e-3),
    "days of a workbook": ("Date/Time;pos\n" + rows(lambda k: f"{45415.5 + 2e-3 * k / 86400:.11f};{A[k]}"), {"pos": ""}, 2e-3),
    "a name before each number": (rows(lambda k: f"t={T[k]:.4f} pos={A[k]}, speed={B[k]}"), {"pos": "", "speed": ""}, 2e-3),
    "a clock in brackets before pairs": (
        rows(lambda k: f"[10:11:12.{2 * k:03d}] pos={A[k]} speed={B[k]}"), {"pos": "", "speed": ""}, 2e-3
    ),
    "marks of cells without a sample": (
        "t_s,pos,n\n" + rows(lambda k: f"{T[k]:.4f},{A[k]},{'---' if k % 7 == 3 else B[k]}"), {"pos": "", "n": ""}, 2e-3
    ),
    "units behind the numbers": (
        "time;pos;load\n" + rows(lambda k: f"{2 * k} ms;{de(A[k])} mm;{de(B[k])} %"), {"pos": "mm", "load [%]": ""}, 2e-3
    ),
    "a table in bars": ("| t_ms | pos [mm] |\n|------|:-----|\n" + rows(lambda k: f"| {2 * k} | {A[k]} |"), {"pos": "mm"}, 2e-3),
    "time since the start as pandas writes it": ("elapsed,pos\n" + rows(lambda k: f"0 days 00:00:00.{2000 * k:06d},{A[k]}"), {"pos": ""}, 2e-3),
    "a Japanese period": ('"サンプリング周期","2","ms"\n"X軸 指令位置[mm]","Z軸 指令位置[mm]"\n' + rows(lambda k: f'"{A[k]}","{B[k]}"'),
        {"X軸 指令位置": "mm", "Z軸 指令位置": "mm"}, 2e-3),
    "units within the names": (
        "Time (µs);Axis 1 Position [mm] (18);Axis 1 Speed (mm/s) (4)\n" + rows(lambda k: f"{2000 * k};{A[k]};{B[k]}"),
        {"Axis 1 Position (18)": "mm", "Axis 1 Speed (4)": "mm/s"}, 2e-3,
    ),
    "an interval in the first row": ("pos,u,Ts\n" + rows(lambda k: f"{A[k]},{B[k]},{0.002 if k == 0 else ''}"), {"pos": "", "u": "", "Ts": ""}, 2e-3),
    "pieces with their headings": (
        "".join("time [s],pos,speed\n-,mm,-\n" + rows(lambda k: f"{T[k]:.4f},{A[k]},{B[k]}") for _ in range(3)),
        {"pos": "mm", "speed": ""},
        2e-3,
    ),
}  # fmt: skip


COUNTED = (
    "nanoseconds since 1970",
    "messages of ROS",
    "archive of a panel",
    "seconds and their parts",
    "ticks of Windows",
    "days of a workbook",
)
"""Times that count from a date: doubles of so many digits hold the time to a microsecond."""


def read(tmp_path: Path, text: str, ending: str = ".log", encoding: str = "utf-8") -> Recording:
    file = tmp_path / f"recording{ending}"
    file.write_bytes(text.encode(encoding))
    return read_recording(file, ReadOptions(Clock(), None, tmp_path / "scratch"))


def test_brackets_that_alone_tell_columns_apart_are_no_units(tmp_path: Path) -> None:
    text = "t [s];ax [S_SET (113)];ax [S_ACT (111)]\n" + rows(lambda k: f"{T[k]};{A[k]};{B[k]}")
    assert {name: s.stated_unit for name, s in read(tmp_path, text).signals.items()} == {"ax [S_SET (113)]": "", "ax [S_ACT (111)]": ""}


@pytest.mark.parametrize(
    ("heading", "names"),
    [
        ("signal,t_ms,value", {"X cmd": "", "X act": ""}),
        (",result,table,_start,_stop,_time,_value,_field,axis", {"X cmd": "", "X act": ""}),
        ("axis,time_s,cmd [mm],act [mm]", {"X cmd": "mm", "X act": "mm", "Y cmd": "mm", "Y act": "mm"}),
    ],
    ids=["historian", "InfluxDB", "one axis after the other"],
)
def test_tables_sorted_by_their_names(tmp_path: Path, heading: str, names: dict[str, str]) -> None:
    """The first lines, which show the layout, hold the first name alone."""
    t = np.arange(700) * 2e-3
    x = np.round(10.0 * np.sin(4.0 * t), 4)
    lines = [heading]
    for part, values in (("cmd", x), ("act", 2.0 * x)):
        for k, value in enumerate(values):
            clock = f"2026-10-02T10:11:{12.0 + t[k]:06.3f}Z"
            lines.append(
                {
                    "signal": f"X {part},{2 * k},{value}",
                    "": f",_result,0,2026-10-02T00:00:00Z,2026-10-03T00:00:00Z,{clock},{value},{part},X",
                    "axis": f"{'X' if part == 'cmd' else 'Y'},{t[k]:.4f},{value},{0.5 * value}",
                }[heading.partition(",")[0]]
            )
    recording = read(tmp_path, "\n".join(lines) + "\n")
    assert {name: signal.unit for name, signal in recording.signals.items()} == names
    assert np.allclose(np.asarray(recording.signals["X cmd"].values[:]), x)
    assert np.allclose(np.asarray(recording.signals["Y cmd" if "Y cmd" in names else "X act"].values[:]), 2.0 * x)
    assert recording.restarts == 0


def test_units_of_one_axis_a_row_are_those_of_their_columns(tmp_path: Path) -> None:
    text = "t_s,axis,cmd pos [um],pos [mm]\n" + "".join(f"{T[k]:.4f},{name},{A[k]},{B[k]}\n" for k in range(ROWS) for name in "XY")
    assert {name: s.unit for name, s in read(tmp_path, text).signals.items()} == {
        f"{axis} {column}": unit for axis in "XY" for column, unit in (("cmd pos", "um"), ("pos", "mm"))
    }


@pytest.mark.parametrize("case", LAYOUTS)
def test_layouts(tmp_path: Path, case: str) -> None:
    text, expected, interval = LAYOUTS[case]
    ending = (".log", ".txt", ".dat", ".trc", "")[len(case) % 5]
    recording = read(
        tmp_path, text, ending, {"UTF-16 with decimal commas": "utf-16", "Chinese": "gbk", "Japanese": "cp932"}.get(case, "utf-8")
    )
    assert {name: signal.unit for name, signal in recording.signals.items()} == expected
    assert recording.source.known == (interval is not None)
    signal = next(s for name, s in recording.signals.items() if name not in ("stamp_id", "time", "field.header.seq"))
    values = np.asarray(signal.values[0 : len(signal.values)])
    first = B if case == "MR Configurator" else 1e3 * A if case.startswith("separated") else A
    assert np.allclose(values[:ROWS], first[: len(values)], atol=1e-9, rtol=1e-9)
    assert signal.time is not None
    time = np.asarray(signal.time[0 : len(signal.time)])
    assert np.allclose(np.diff(time)[: ROWS - 1], interval or 1.0, rtol=1e-6, atol=3e-6 if case in COUNTED else 1e-9)
    assert recording.restarts == (2 if case.startswith(("pieces", "tests")) else 0)
    if case == "separated thousands":
        assert np.allclose(np.asarray(recording.signals["n"].values[:]), B, atol=1e-3)  # 0.1 1/min
    # what the file does not state is said
    assumed = (
        "a column that only counts seconds", "LabVIEW measurement", "LabVIEW measurement with its channels", "scope with lines of meaning",
        "rows as JSON", "a JSON object a line", "columns as JSON", "lists in cells", "a name before each number",
    )  # fmt: skip
    noted = (
        *COUNTED,
        "a Japanese period",
        "halscope",
        "rate above the numbers",
        "an interval in the first row",
        "microseconds since 1970",
        "nanoseconds since 1970",
        "messages of ROS",
    )
    assert recording.source.assumed == (case in assumed)
    assert bool(recording.source.text) == (interval is None or case in (*assumed, *noted))


def test_random_layouts_of_one_recording(tmp_path: Path) -> None:
    """A part of `devtools/fuzz_layouts.py`: nothing is wrong without a word, and what names suffice for is right."""
    counted: Counter[tuple[str, str]] = Counter()
    for number in range(40):
        case = fuzz_layouts.make(np.random.default_rng([7, number]))
        (folder := tmp_path / str(number)).mkdir()
        outcome, why = fuzz_layouts.judge(case, folder)
        assert outcome not in ("wrong", "fault"), f"{why}\n{case.choice}"
        counted[fuzz_layouts.enough(case), outcome] += 1
    named = sum(count for (kind, _), count in counted.items() if kind == "names")
    assert counted["names", "right"] >= 0.95 * named > 10


def test_what_the_user_gives_overrules_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`--columns` and `--interval-ms` stand in the map, so that the map alone imports the file again."""
    file = tmp_path / "bare.trc"
    t = np.arange(600) * 2e-3
    x = 20.0 * np.sin(6.0 * t)
    late = 20.0 * np.sin(6.0 * (t - 0.01))
    file.write_text("".join(f"{a:.6f}\t{b:.6f}\t\n" for a, b in zip(x, late)), encoding="utf-8")
    given = ["--columns", "set point [mm], position [mm]", "--interval-ms", "2"]
    assert main(["import", str(file), "--out", str(tmp_path / "one"), "--no-picture"]) == 2
    assert "--interval-ms" in capsys.readouterr().err
    assert main(["import", str(file), *given, "--out", str(tmp_path / "one"), "--no-picture"]) == 0
    assert main(["import", str(file), "--map", str(tmp_path / "one" / "map.toml"), "--out", str(tmp_path / "two"), "--no-picture"]) == 0
    for out in ("one", "two"):
        trace = read_trace(tmp_path / out / "bare.parquet")
        assert trace.period == pytest.approx(2e-3)
        assert np.abs(trace.get("X", "setpoint") * 1e3 - x).max() < 1e-5
    capsys.readouterr()
    for wrong, said in (
        (["--columns", "a"], "1 names in --columns, but the file has 2 columns"),
        (["--interval-ms", "0"], "--interval-ms: '0': give a number above 0"),
    ):
        assert said in refused(capsys, "import", str(file), *wrong)


def test_factors_and_offsets_that_a_scope_states(tmp_path: Path) -> None:
    """TwinCAT's scope writes the numbers of the variable: its ScaleFactor and Offset, and those of the unit, come behind."""
    path = tmp_path / "scope.csv"
    keys = {
        "Name": ("ActPos", "ActTorque"),
        "SampleTime[ms]": (2, 2),
        "Offset": (0, "0,5"),
        "ScaleFactor": (1, "0,1"),
        "Unit": ("mm", "Nm"),
        "Unit ScaleFactor": (1, 2),
        "Unit Offset": (0, 1),
    }
    path.write_text(
        "".join(f"{key}\t{a}\t{key}\t{b}\n" for key, (a, b) in keys.items())
        + "\n"
        + rows(lambda k: f"{2 * k}\t{de(A[k])}\t{2 * k}\t{de(B[k])}")
    )
    found = read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert np.asarray(found.signals["ActPos"].values[0:ROWS]) == pytest.approx(A)
    assert np.asarray(found.signals["ActTorque"].values[0:ROWS]) == pytest.approx((0.1 * B + 0.5) * 2.0 + 1.0)
    assert any("ActTorque" in note and "scaled" in note for note in found.notes)


def test_a_clock_of_whole_seconds_with_as_many_rows_in_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows_of = 5 * 83
    t = 0.4 + np.arange(rows_of) * 0.012
    x = 30.0 * np.sin(3.0 * t)
    path = tmp_path / "run.csv"

    def written(at: np.ndarray) -> str:
        return "Timestamp,X_RIst,X_RSol\n" + "".join(
            f"2024-09-24 14:05:{int(s):02d},{a:.3f},{b:.3f}\n" for s, a, b in zip(at, np.roll(x, 4), x)
        )

    path.write_text(written(t))
    assert main(["import", str(path), "--out", str(tmp_path / "out")]) == 0
    trace = read_trace(tmp_path / "out" / "run.parquet")
    assert trace.time[1] - trace.time[0] == pytest.approx(0.012, rel=0.01)
    uneven = np.sort(np.random.default_rng(2).uniform(0.0, 5.0, rows_of))
    path.write_text(written(uneven))
    assert "stands still at" in refused(capsys, "import", str(path), "--out", str(tmp_path / "other"))


def test_tests_of_a_drive_below_each_other_in_json(tmp_path: Path) -> None:
    """Rows without names under the name of each test; the first number rises like a clock that jitters."""
    jitter = np.random.default_rng(3).uniform(-2e-4, 2e-4, ROWS)

    def test(begin: float, sign: float) -> str:
        return "[" + ",".join(f"[{begin + 5e-3 * k + jitter[k]:.6f},{sign * A[k]},{sign * B[k]}]" for k in range(ROWS)) + "]"

    path = tmp_path / "run.json"
    path.write_text(f'{{"slow": {test(90.0, -1.0)}, "fast": {test(20.0, 1.0)}, "sysid": true, "units": "Rotations"}}')
    found = read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert {*found.signals} == {"column 2", "column 3"}
    assert np.asarray(found.signals["column 2"].values[0 : 2 * ROWS]) == pytest.approx(np.concatenate([A, -A]))
    assert found.source.column == "column 1"


@pytest.mark.parametrize("style", ["ros2", "ros1"])
def test_messages_of_ros_as_the_command_line_prints_them(tmp_path: Path, capsys: pytest.CaptureFixture[str], style: str) -> None:
    def message(k: int) -> str:
        lists = {
            "name": ["elbow_joint", "wrist_1_joint"],
            "position": [A[k] / 10.0, 0.5],
            "velocity": [B[k] / 10.0, 0.0],
            "effort": [".nan"] * 2,
        }
        sec, part = ("sec", "nanosec") if style == "ros2" else ("secs", "nsecs")
        head = f"header: \n  seq: {k}\n  stamp:\n    {sec}: {1747356931 + k // 50}\n    {part}: {20_000_000 * (k % 50)}\n  frame_id: ''\n"
        if style == "ros1":
            return head + "".join(f"{key}: [{', '.join(map(str, own))}]\n" for key, own in lists.items()) + "---\n"
        return head + "".join(f"{key}:\n" + "".join(f"- {one}\n" for one in own) for key, own in lists.items()) + "---\n"

    path = tmp_path / "joint_states.txt"
    path.write_text(rows(message).replace("\n\n", "\n"))
    found = read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))
    position = found.signals["elbow_joint/position"]
    assert position.time is not None
    assert np.diff(position.time[0:ROWS]) == pytest.approx(0.02)
    assert np.asarray(position.values[0:ROWS]) == pytest.approx(A / 10.0)
    path.write_text(message(0))
    assert "only 1 message" in refused(capsys, "import", str(path))


def test_a_semicolon_that_ends_each_row(tmp_path: Path) -> None:
    path = tmp_path / "run.m"
    path.write_text("% measured\nData = [\n" + rows(lambda k: f" {2e-3 * k:.4f}, {A[k]}, {B[k]};") + "];\n")
    found = read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert np.asarray(found.signals["column 3"].values[0:ROWS]) == pytest.approx(B)


@pytest.mark.parametrize(
    "lines",
    [
        "Channel A: position set point [mm]\nChannel B: motor current [A]\nSample time: 2 ms\n",
        "Sample time: 2 ms\n1: position set point [mm]\n2: motor current [A]\n",
    ],
)
def test_lines_that_say_what_each_column_is(tmp_path: Path, lines: str) -> None:
    path = tmp_path / "run.txt"
    path.write_text(f"Recording of drive 1\n{lines}\n" + rows(lambda k: f"{A[k]:.4f}\t{B[k]:.4f}"))
    found = read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert {n: s.unit for n, s in found.signals.items()} == {"position set point": "mm", "motor current": "A"}
    assert found.source.interval == pytest.approx(2e-3)


def test_names_with_an_interval_among_them_are_names(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time[s],dt[s],cmd1,position[mm]\n" + rows(lambda k: f"{2e-3 * k:.4f},0.002,{B[k]},{A[k]}"))
    found = read_recording(path, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert {"cmd1", "position"} <= {*found.signals}
