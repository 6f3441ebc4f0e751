"""`twin import`: every bad file and every wrong map gives one line on standard error and exit code 2."""

from collections.abc import Callable, Mapping
import gzip
from pathlib import Path
import re
import struct
import zipfile
import zlib

import numpy as np
import pyarrow as pa
from pyarrow import parquet
import pytest
from scipy.io import savemat

from tests.builders.recorded_files import MAP, Array, move, write_csv, write_mdf, write_tdms, write_xml
from twin.cli import main

TIME = np.arange(2000) * 1e-3


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that the command prints when it refuses."""
    code = main(list(arguments))
    out, err = capsys.readouterr()
    assert code == 2, err or out
    assert err.startswith("twin: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def importing(capsys: pytest.CaptureFixture[str], tmp_path: Path, file: Path, text: str = MAP) -> str:
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    line = refused(capsys, "import", str(file), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out"), "--no-picture")
    assert not (tmp_path / "out" / "campaign.toml").exists()
    return line


MAPS: dict[str, tuple[Callable[[str], str], tuple[str, ...]]] = {
    "no TOML": (lambda m: m + "[[", ("map.toml", "not a valid TOML file")),
    "unknown key": (lambda m: "feedfoward = 'off'\n" + m, ("unknown key 'feedfoward'", "did you mean 'feedforward'")),
    "unknown column": (lambda m: m.replace('"strom"', '"stromm"'), ("run.csv", "no column 'stromm'", "did you mean 'strom'")),
    "unknown signal": (lambda m: m.replace('"setpoint"', '"setpiont"'), ("column 1 ('soll')", "'setpiont'", "did you mean 'setpoint'")),
    "unknown unit": (lambda m: m.replace('"mm/s"', '"mmm/s"'), ("column 3", "unknown unit [mmm/s]", "did you mean 'mm/s'")),
    "unit of another signal": (lambda m: m.replace('"mm/s"', '"mm"'), ("'speed'", "[mm] is not a unit of a velocity", "[mm/s]")),
    "angle and length on one axis": (lambda m: m.replace('"mm/s"', '"deg/s"'), ("'speed'", "makes axis X rotary", "makes it linear")),
    "motor turns without a pitch": (lambda m: m.replace('"mm/s"', '"rpm"'), ("[rev/min] is a unit of the motor", "mm_per_rev")),
    "unknown column key": (lambda m: m.replace("axis =", "axes =", 1), ("column 1", "unknown key 'axes'", "did you mean 'axis'")),
    "column key missing": (lambda m: m.replace('axis = "X"\n', "", 1), ("column 1", "'axis' is missing")),
    "signal twice": (lambda m: m.replace('"position"', '"setpoint"'), ("two columns are X.setpoint",)),
    "all columns optional and absent": (
        lambda m: m.replace('name = "', 'name = "no_').replace("unit =", "optional = true\nunit ="),
        ("run run", "the map has no [[column]] for its files"),
    ),
    "feedforward": (lambda m: m.replace('"off"', '"on"'), ("feedforward = 'on'", "off, velocity, velocity+torque")),
    "scale zero": (lambda m: m + "scale = 0\n", ("column 4", "scale = 0")),
    "scale as text": (lambda m: m + 'scale = "ten"\n', ("column 4", "scale = 'ten'", "give a number")),
    "sign": (lambda m: m + "sign = 2\n", ("sign = 2", "1 or -1")),
    "period": (lambda m: "period_ms = 0\n" + m, ("period_ms = 0", "above 0")),
    "gaps": (lambda m: 'gaps = "ignore"\n' + m, ("gaps = 'ignore'", "split, fill, refuse")),
    "time column": (lambda m: m + '[time]\ncolumn = "tt"\n', ("no time column 'tt'", "did you mean 't'")),
    "unit of time": (lambda m: m + '[time]\ncolumn = "t"\nunit = "mm"\n', ("time column 't'", "not a unit of time")),
    "column and interval": (lambda m: m + '[time]\ncolumn = "t"\ninterval_ms = 1\n', ("a column and an interval_ms",)),
    "CSV key": (lambda m: m + '[csv]\ndelimeter = ";"\n', ("[csv] delimeter", "did you mean 'delimiter'")),
    "run of no file": (
        lambda m: m + '[[run]]\nfile = "rum.csv"\n',
        ("run 1", "'rum.csv' is not among the FILES", "did you mean 'run.csv'"),
    ),
    "run key": (lambda m: m + '[[run]]\nfile = "run.csv"\nfeed = 1\n', ("run 1", "unknown key 'feed'")),
    "run name leaves the folder": (lambda m: m + '[[run]]\nfile = "run.csv"\nname = "../x"\n', ("name = '../x'", "cannot be a file name")),
    "run backwards": (lambda m: m + '[[run]]\nfile = "run.csv"\nfrom_s = 2\nto_s = 1\n', ("from_s = 2 is not before to_s = 1",)),
    "part outside the recording": (lambda m: m + '[[run]]\nfile = "run.csv"\nfrom_s = 7\n', ("run run", "no 0.2 s in common")),
    "machine lacks the axis": (lambda m: 'machine = "mikron_ucp710"\n' + m.replace('"X"', '"U"'), ("has no axis U", "A, C, X, Y, Z")),
    "machine file missing": (lambda m: 'machine = "mine.toml"\n' + m, ("mine.toml",)),
}


@pytest.mark.parametrize("case", MAPS)
def test_wrong_map(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    change, expected = MAPS[case]
    file = write_csv(tmp_path / "run.csv", {"t": TIME, **move(TIME)})
    line = importing(capsys, tmp_path, file, change(MAP))
    assert all(part in line for part in expected), line


def test_two_files_that_make_one_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(write_csv(tmp_path / name, {"t": TIME, **move(TIME)})) for name in ("a b.csv", "a_b.csv")]
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    line = refused(capsys, "import", *files, "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out"), "--no-picture")
    assert "two runs are named 'a_b', those of 'a b.csv' and 'a_b.csv'; give each its own name" in line
    assert not (tmp_path / "out").exists()


SWAPPED: dict[str, tuple[Callable[[dict[str, Array]], dict[str, Array]], tuple[str, ...]]] = {
    "position in m": (lambda c: {**c, "ist": c["ist"] / 1e3}, ("X.position moves 0.001 times", "m taken as mm", 'units = "report"')),
    "set point in um": (lambda c: {**c, "soll": c["soll"] * 1e3}, ("X.position moves 0.001 times",)),
    "speed in m/min": (lambda c: {**c, "speed": c["speed"] * 0.06}, ("X.velocity is 0.06 times", "recorded in m/min, taken as mm/s?")),
    "speed per minute": (lambda c: {**c, "speed": c["speed"] * 60.0}, ("X.velocity is 60 times", "per minute, taken as per second?")),
    "speed of another pitch": (lambda c: {**c, "speed": c["speed"] * 2.5}, ("X.velocity is 2.5 times", "travel of a motor turn")),
    "speed the other way": (lambda c: {**c, "speed": -c["speed"]}, ("X.velocity is -1 times", "sign = -1?")),
    "all in um": (
        lambda c: {**c, **{k: c[k] * 1e3 for k in ("soll", "ist", "speed")}},
        ("X.setpoint moves at 108.9 m/s", "wrong unit"),
    ),
    "time in 0.1 ms": (lambda c: {**c, "t": c["t"] * 1e4}, ("X.velocity is 10 times",)),
    "current in mA": (lambda c: {**c, "strom": c["strom"] * 1e3}, ("X.current reaches", "mA?")),
}


@pytest.mark.parametrize("case", SWAPPED)
def test_swapped_units_are_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    change, expected = SWAPPED[case]
    file = write_csv(tmp_path / "run.csv", change({"t": TIME, **move(TIME)}))
    line = importing(capsys, tmp_path, file)
    assert all(part in line for part in expected), line
    for word in ("report", "say"):  # "say" is the word of older maps
        (tmp_path / "map.toml").write_text(f'units = "{word}"\n' + MAP, encoding="utf-8")
        assert main(["import", str(file), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / word), "--no-picture"]) == 0
        assert expected[0] in capsys.readouterr().out


def test_the_unit_of_the_file_against_that_of_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = move(TIME)
    file = write_csv(
        tmp_path / "run.csv", {"t [s]": TIME, "soll [m]": columns["soll"] / 1e3, **{k: columns[k] for k in ("ist", "speed", "strom")}}
    )
    line = importing(capsys, tmp_path, file)
    assert "'soll': the unit is [m] in the file, [mm] in the map" in line
    volts = write_csv(
        tmp_path / "run.csv", {"t": TIME, **{k: columns[k] for k in ("soll", "ist", "speed")}, "strom [V]": columns["strom"] / 10}
    )
    line = importing(capsys, tmp_path, volts)
    assert "the unit is [V] in the file, [A] in the map" in line
    assert "scale = ... [A per V]" in line


TABLES: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "empty": (lambda p: p.write_bytes(b""), ("the file is empty",)),
    "heading only": (lambda p: p.write_text("t,soll,ist,speed,strom\n"), ("no rows of numbers",)),
    "one row": (lambda p: p.write_text("t,soll,ist,speed,strom\n0,1,2,3,4\n"), ("only 1 row",)),
    "prose": (lambda p: p.write_text("Dear all,\nplease find attached, as said, the trace.\n"), ("no rows of numbers",)),
    "binary": (lambda p: p.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"), ("not a text file",)),
    "last row cut off": (lambda p: p.write_text(p.read_text()[:-30]), ("of 5 cells", "cut off")),
    "row cut off early": (lambda p: p.write_text(_line(p, 40, "0.04,1.0")), ("line 41 has 2 of 5 cells", "'0.04,1.0'")),
    "NaN": (lambda p: p.write_text(_cell(p, 40, 2, "NaN")), ("column 'ist'", "line 41 (0.039 s) holds NaN")),
    "infinite": (lambda p: p.write_text(_cell(p, 40, 2, "-inf")), ("column 'ist'", "holds -inf")),
    "text in a cell": (lambda p: p.write_text(_cell(p, 1500, 2, "broken")), ("column 'ist' holds 'broken'", "not a number")),
    "no time in a row": (lambda p: p.write_text(_cell(p, 40, 0, "")), ("column 't'", "has no time")),
    "time goes back": (lambda p: p.write_text(_cell(p, 40, 0, "0.02")), ("time goes back at row 40",)),
    "time stands still": (lambda p: p.write_text(_stalled(p)), ("time stands still at 9 of ",)),
    "column twice": (
        lambda p: p.write_text(p.read_text().replace("speed", "ist", 1)),
        ("no column 'ist'", "ist (column 3), ist (column 4)"),
    ),
    "mixed intervals": (lambda p: p.write_text(_slower(p)), ("the interval changes from 1 ms to 2 ms at", "period_ms")),
    "faster later": (lambda p: p.write_text(_faster(p)), ("the interval changes from 2 ms to 1 ms at", "period_ms")),
}


def _line(path: Path, number: int, text: str) -> str:
    lines = path.read_text().splitlines()
    lines[number] = text
    return "\n".join(lines) + "\n"


def _cell(path: Path, number: int, column: int, text: str) -> str:
    cells = path.read_text().splitlines()[number].split(",")
    cells[column] = text
    return _line(path, number, ",".join(cells))


def _slower(path: Path) -> str:
    lines = path.read_text().splitlines()
    return "\n".join([*lines[:1000], *lines[1000::2]]) + "\n"


def _faster(path: Path) -> str:
    lines = path.read_text().splitlines()
    return "\n".join([lines[0], *lines[1:1500:2], *lines[1501:]]) + "\n"


def _stalled(path: Path) -> str:
    lines = path.read_text().splitlines()
    for i in range(41, 50):
        lines[i] = ",".join([lines[40].split(",")[0], *lines[i].split(",")[1:]])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("case", TABLES)
def test_bad_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    damage, expected = TABLES[case]
    file = write_csv(tmp_path / "run.csv", {"t": TIME, **move(TIME)})
    damage(file)
    line = importing(capsys, tmp_path, file)
    assert "run.csv" in line
    assert all(part in line for part in expected), line


def _signals() -> dict[str, tuple[float, float, Array]]:
    return {name: (0.0, 1e-3, values) for name, values in move(TIME).items()}


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
XMLS: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "bomb": (lambda p: write_xml(p, _signals(), head=BOMB), ("refused", "declares its own")),
    "external entity": (lambda p: write_xml(p, _signals(), head='<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'), ("refused",)),
    "external DTD": (lambda p: write_xml(p, _signals(), head='<!DOCTYPE x SYSTEM "http://127.0.0.1/x.dtd">'), ("refused",)),
    "cut off": (lambda p: p.write_text(write_xml(p, _signals()).read_text()[:-4000]), ("not a complete XML file", "cut off")),
    "other XML": (lambda p: p.write_text("<svg><g/></svg>"), ("not a trace of a SINUMERIK", "<svg>")),
    "no XML": (lambda p: p.write_bytes(b"none\x00\x01"), ("not a text file",)),
    "no number": (
        lambda p: p.write_text(re.sub('f2="[^"]*"', 'f2="9221120237041090560"', write_xml(p, _signals()).read_text(), count=1)),
        ("not a number at",),
    ),
    "time goes back": (
        lambda p: p.write_text(write_xml(p, _signals()).read_text().replace('time="0.500000"', 'time="0.100000"')),
        ("time does not increase",),
    ),
}


@pytest.mark.parametrize("case", XMLS)
def test_bad_xml(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    make, expected = XMLS[case]
    make(tmp_path / "run.xml")
    line = importing(capsys, tmp_path, tmp_path / "run.xml")
    assert all(part in line for part in expected), line


def _mat_7_3(path: Path) -> None:
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(600))


def _with_nan() -> dict[str, Array]:
    columns = move(TIME)
    columns["ist"][700] = np.nan
    return columns


def _cut(path: Path, part: float) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * part)])


def _patched(path: Path, at: int, data: bytes) -> None:
    content = bytearray(path.read_bytes())
    content[at : at + len(data)] = data
    path.write_bytes(content)


def _zip(path: Path, files: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def _parquet(path: Path, *names: str) -> Path:
    parquet.write_table(pa.table([TIME] * len(names), names=list(names)), path)
    return path


BINARIES: dict[str, tuple[str, Callable[[Path], object], tuple[str, ...]]] = {
    "TDMS is none": ("run.tdms", lambda p: p.write_bytes(b"\x00none"), ("not a TDMS file",)),
    "TDMS cut off": ("run.tdms", lambda p: _cut(write_tdms(p, move(TIME), 1e-3), 0.5), ("cut off",)),
    "TDMS with NaN": ("run.tdms", lambda p: write_tdms(p, _with_nan(), 1e-3), ("'axis/ist'", "sample 701 (0.7 s) holds NaN")),
    "TDMS without times": ("run.tdms", lambda p: write_tdms(p, move(TIME), 0.0), ("no time", "--interval-ms")),
    "MDF is none": ("run.mf4", lambda p: p.write_bytes(bytes(100)), ("not an MDF file",)),
    "MDF cut off": (
        "run.mf4",
        lambda p: _cut(write_mdf(p, [(TIME, {n: (v, "") for n, v in move(TIME).items()})]), 0.3),
        ("not a readable MDF file",),
    ),
    "MDF of a version that does not exist": (
        "run.mf4",
        lambda p: _patched(write_mdf(p, [(TIME, {n: (v, "") for n, v in move(TIME).items()})]), 8, b"9.99\xff\xff\xff\xff" + bytes(20)),
        ("not a readable MDF file",),
    ),
    "number beyond measure": (
        "run.tdms",
        lambda p: write_tdms(p, {**move(TIME), "ist": np.full(len(TIME), 1e200)}, 1e-3),
        ("holds 1e+200",),
    ),
    "MAT is none": ("run.mat", lambda p: p.write_bytes(b"none" + bytes(200)), ("not a readable MATLAB file",)),
    "MAT cut off": ("run.mat", lambda p: (savemat(p, {"t": TIME, **move(TIME)}), _cut(p, 0.5)), ("not a readable MATLAB file",)),
    "MAT that crashes scipy": ("run.mat", lambda p: (savemat(p, {"t": TIME, **move(TIME)}), _patched(p, 145, b"\x08")), ("MATLAB file",)),
    "MAT 7.3": ("run.mat", _mat_7_3, ("MATLAB",)),
    "MAT of other lengths": (
        "run.mat",
        lambda p: savemat(p, {"t": TIME, **move(TIME), "ist": np.zeros(7)}),
        ("'ist'", "has 7 samples", "differs from the time column"),
    ),
    "Parquet is none": ("run.parquet", lambda p: p.write_bytes(bytes(100)), ("not a Parquet file",)),
    "Parquet with a heading that is no text": (
        "run.parquet",
        lambda p: p.write_bytes(_parquet(p, "t", "soll", "ist").read_bytes().replace(b"soll", b"so\xffl")),
        ("not a readable Parquet file",),
    ),
    "Parquet with a column twice": ("run.parquet", lambda p: _parquet(p, "t", "soll", "soll"), ("column 'soll' occurs twice",)),
    "ZIP cut off": ("run.xlsx", lambda p: p.write_bytes(b"PK\x03\x04" + zlib.compress(struct.pack("<I", 1))), ("not a readable archive",)),
    "old workbook": ("run.xls", lambda p: p.write_bytes(b"\xd0\xcf\x11\xe0" + bytes(99)), ("an old workbook: save it as .xlsx",)),
    "workbook of nothing": ("run.xlsx", lambda p: _zip(p, {"xl/workbook.xml": b"<workbook/>"}), ("not a readable archive",)),
    "ZIP of two": ("run.zip", lambda p: _zip(p, {"a.csv": b"1", "b.csv": b"2"}), ("an archive of 2 files; unpack it",)),
    "ZIP of a ZIP": ("run.zip", lambda p: _zip(p, {"a.zip": b"PK\x03\x04"}), ("an archive in an archive",)),
    "ZIP of a damaged text": (
        "run.zip",
        lambda p: _zip(p, {"a.csv": b"t,soll,ist,speed,strom\n" + b"0,7,7,7,7\n" * 50 + b"1,2"}),
        ("run.zip: ", "line 52"),
    ),
    "gzip cut off": ("run.csv.gz", lambda p: p.write_bytes(gzip.compress(bytes(range(256)) * 99)[:300]), ("not a readable archive",)),
    "gzip of zeros": ("run.csv.gz", lambda p: p.write_bytes(gzip.compress(b"0" * 100_000)), ("run.csv.gz",)),
    "npz with code": ("run.npz", lambda p: np.savez(p, t=np.array([{}, {}], dtype=object)), ("not a readable archive",)),
    "npy of another size": (
        "run.npy",
        lambda p: (np.save(p, TIME), p.write_bytes(p.read_bytes().replace(b"(2000,)", b"(9000,)"))),
        ("not a readable array of numpy",),
    ),
    "Arrow cut off": ("run.arrow", lambda p: p.write_bytes(b"ARROW1\0\0" + bytes(99)), ("not a readable Arrow file",)),
    "no such file": ("run.csv", lambda p: None, ("no such file",)),
}


@pytest.mark.parametrize("case", BINARIES)
def test_bad_binary_file(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    name, make, expected = BINARIES[case]
    make(tmp_path / name)
    line = importing(capsys, tmp_path, tmp_path / name)
    assert name in line
    assert all(part in line for part in expected), line


def test_gaps_are_refused_if_the_map_asks_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = np.r_[0:800, 830:2000]
    file = write_csv(tmp_path / "run.csv", {k: v[kept] for k, v in {"t": TIME, **move(TIME)}.items()})
    line = importing(capsys, tmp_path, file, 'gaps = "refuse"\n' + MAP)
    assert "samples are missing (31 ms after 0.799 s)" in line


def test_a_campaign_of_others_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_csv(tmp_path / "run.csv", {"t": TIME, **move(TIME)})
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "campaign.toml").write_text('machine = "x"\n')
    line = refused(capsys, "import", str(file), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out"))
    assert "not imported; give another --out" in line
    assert "--out is missing" in refused(capsys, "import", str(file), "--map", str(tmp_path / "map.toml"))
