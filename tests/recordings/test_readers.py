"""Every reader returns the values and times of an independent writer to the last bit."""

from collections.abc import Callable, Mapping
import gzip
import json
from pathlib import Path
import tomllib
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from tests.builders.recorded_files import MAP, Array, move, write_csv, write_mdf, write_tdms, write_xml
from twin.cli import main
from twin.documents import toml_key, toml_text
from twin.recordings.formats.by_content import read_recording
from twin.recordings.formats.delimited import find_layout
from twin.recordings.formats.parquet import read as read_parquet
from twin.recordings.propose import propose
from twin.recordings.signals import Clock, ReadOptions
from twin.recordings.time_column import share_time
from twin.recordings.trace import Trace, read_trace

TIME = np.arange(3000) * 1e-3
ROOT = Path(__file__).resolve().parents[2]
TRACES = ROOT / "examples" / "traces"
EMPS = ROOT.parent / "shared" / "data" / "emps" / "DATA_EMPS.mat"
EMPS_MAP = "".join(
    f'[[column]]\nname = "{name}"\naxis = "X"\nsignal = "{signal}"\nunit = "{unit}"\n'
    for name, signal, unit in (("qg", "setpoint", "m"), ("qm", "motor_position", "m"), ("vir", "voltage", "V"))
)


def imported(tmp_path: Path, files: list[Path], text: str = MAP, run: str | None = None) -> Trace:
    """Import into tmp_path/out by the command line and read the trace back."""
    map_file = tmp_path / "map.toml"
    map_file.write_text(text, encoding="utf-8")
    assert main(["import", *map(str, files), "--map", str(map_file), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    return read_trace(tmp_path / "out" / f"{run or files[0].stem}.parquet")


def same(trace: Trace, columns: Mapping[str, Array], tolerance: float = 0.0) -> None:
    """The trace holds the columns: mm, mm/s, A."""
    for name, signal, factor in (
        ("soll", "setpoint", 1e3),
        ("ist", "position", 1e3),
        ("speed", "velocity", 1e3),
        ("strom", "current", 1.0),
    ):
        got = trace.get("X", signal) * factor
        assert len(got) == len(columns[name])
        assert np.abs(got - columns[name]).max() <= tolerance + 4e-16 * np.abs(columns[name]).max()


@pytest.mark.parametrize(
    ("delimiter", "decimal", "before", "encoding", "units"),
    [
        (",", ".", "", "utf-8", None),
        (";", ",", "Messung 12;\nDatum;14.05.2024\n\n", "latin-1", ["ms", "mm", "mm", "mm/s", "A"]),
        ("\t", ",", "# scope 7\n", "utf-8-sig", None),
        ("\t", ".", "", "utf-16", ["[ms]", "[mm]", "[mm]", "[mm/s]", "[A]"]),
        ("|", ".", "a line\nanother | line\n", "utf-8", None),
        (" ", ".", "", "utf-8", None),
    ],
)
def test_csv_of_any_dialect(tmp_path: Path, delimiter: str, decimal: str, before: str, encoding: str, units: list[str] | None) -> None:
    columns = move(TIME)
    table = {"Zeit": TIME * 1e3, **columns}
    file = write_csv(tmp_path / "run.csv", table, delimiter=delimiter, decimal=decimal, before=before, encoding=encoding, units=units)
    found = find_layout(file, ReadOptions(Clock(), None, tmp_path))
    assert (found.rows.delimiter, found.rows.decimal) == (delimiter, decimal)
    assert found.names == tuple(table)
    unit = "" if units else '[time]\ncolumn = "Zeit"\nunit = "ms"\n'
    trace = imported(tmp_path, [file], MAP + unit)
    assert trace.period == pytest.approx(1e-3, rel=1e-12)
    same(trace, columns)


def test_csv_units_from_headings_empty_cells_and_dates(tmp_path: Path) -> None:
    columns = move(TIME)
    slow = np.where(np.arange(len(TIME)) % 4 == 0, columns["ist"], np.nan)
    stamps = np.datetime64("2024-05-14T08:21:07.250000000") + np.rint(TIME * 1e9).astype("timedelta64[ns]")
    with open(tmp_path / "edge.csv", "w", encoding="utf-8") as file:
        file.write("timestamp,soll [mm],ist (mm),speed [mm/s],strom [A]\n")
        for row in range(len(TIME)):
            position = "" if np.isnan(slow[row]) else repr(float(slow[row]))
            stamp = str(stamps[row]).replace("T", " ")
            file.write(
                f"{stamp},{float(columns['soll'][row])!r},{position},{float(columns['speed'][row])!r},{float(columns['strom'][row])!r}\n"
            )
    trace = imported(tmp_path, [tmp_path / "edge.csv"], "\n".join(line for line in MAP.splitlines() if not line.startswith("unit")))
    # the last sample of the slow column ends the trace; a cubic is exact to nanometres here
    rows = len(trace.time)
    assert rows == len(TIME) - 3
    assert np.abs(trace.get("X", "position") * 1e3 - columns["ist"][:rows]).max() < 2e-6
    assert np.abs(trace.get("X", "position") * 1e3 - slow[:rows])[::4].max() < 1e-13
    assert np.abs(trace.get("X", "setpoint") * 1e3 - columns["soll"][:rows]).max() < 1e-13


def test_sinumerik_signals_have_their_own_intervals(tmp_path: Path) -> None:
    fast, slow = np.arange(1500) * 2e-3, 2e-3 + np.arange(740) * 4e-3
    columns = move(fast)
    columns["soll"][:300] = columns["soll"][0]  # held values, which the records omit
    positions = move(slow)["ist"]
    names = {
        "soll": "/Nck/!SD/nckServoDataCmdPos64 [u1, 1]",
        "speed": "/Nck/!SD/nckServoDataActVelMot64 [u1, 1]",
        "strom": "/Nck/!SD/nckServoDataActCurr64 [u1, 1]",
    }
    signals = {names[n]: (0.0, 2e-3, columns[n]) for n in names}
    signals["/Nck/!SEMA/measPos2 [u1, 1]"] = (2e-3, 4e-3, positions)
    file = write_xml(tmp_path / "trace.xml", signals)
    assert file.read_text(encoding="utf-8").count("f1=") < 1250  # held values are not written
    text = MAP.replace('"ist"', '"/Nck/!SEMA/measPos2 [u1, 1]"').replace('unit = "mm"', 'unit = "mm"')
    for short, name in names.items():
        text = text.replace(f'"{short}"', f'"{name}"')
    trace = imported(tmp_path, [file], 'units = "report"\n' + text)
    assert trace.period == pytest.approx(2e-3, rel=1e-9)
    rows = np.rint(slow / 2e-3).astype(int)
    first = round(slow[0] / 2e-3)
    assert np.abs(trace.get("X", "position")[rows[: len(trace.time) // 2] - first] * 1e3 - positions[: len(trace.time) // 2]).max() < 1e-6
    assert np.abs(trace.get("X", "setpoint") * 1e3 - columns["soll"][first : first + len(trace.time)]).max() <= 5.1e-7
    assert np.abs(trace.get("X", "position") * 1e3 - columns["ist"][first : first + len(trace.time)]).max() < 2e-5


def test_tdms(tmp_path: Path) -> None:
    columns = move(TIME)
    units = {"soll": "mm", "ist": "mm", "speed": "mm/s", "strom": "A"}
    file = write_tdms(tmp_path / "run.tdms", columns, 1e-3, units)
    same(imported(tmp_path, [file]), columns)


def test_mdf_with_two_rates(tmp_path: Path) -> None:
    slow = np.arange(1500) * 2e-3
    columns, half = move(TIME), move(slow)
    fast_group = {"soll": (columns["soll"], "mm"), "ist": (columns["ist"], "mm"), "speed": (columns["speed"], "mm/s")}
    file = write_mdf(tmp_path / "run.mf4", [(TIME, fast_group), (slow, {"strom": (half["strom"], "A")})])
    trace = imported(tmp_path, [file])
    rows = len(trace.time)
    assert rows == 2999  # the slow group ends 1 ms earlier
    assert np.abs(trace.get("X", "position") * 1e3 - columns["ist"][:rows]).max() < 1e-13
    assert np.abs(trace.get("X", "current")[::2] - half["strom"]).max() < 1e-12
    assert np.abs(trace.get("X", "current") - columns["strom"][:rows]).max() < 1e-3


def test_matlab_vectors_and_struct_fields(tmp_path: Path) -> None:
    columns = move(TIME)
    savemat(
        tmp_path / "run.mat",
        {
            "t": TIME[:, None],
            "rec": {"soll": columns["soll"], "ist": columns["ist"]},
            "speed": columns["speed"],
            "strom": columns["strom"][:, None],
            "kp": 160.0,
        },
    )
    text = MAP.replace('"soll"', '"rec.soll"').replace('"ist"', '"rec.ist"')
    same(imported(tmp_path, [tmp_path / "run.mat"], text), columns)


def test_matlab_arrays_of_signals(tmp_path: Path) -> None:
    """As Simulink's scopes and dSPACE save them."""
    fields: list[tuple[str, object]] = [("values", object), ("label", object)]
    signals = np.zeros((1, 2), fields)
    signals[0, 0], signals[0, 1] = (TIME[:, None] ** 2, "x_ref [mm]"), (TIME, "i_q")
    savemat(tmp_path / "a.mat", {"ScopeData": {"time": TIME[:, None], "signals": signals}})
    recording = read_recording(tmp_path / "a.mat", ReadOptions(Clock(), None, tmp_path))
    assert {name: signal.unit for name, signal in recording.signals.items()} == {"x_ref": "mm", "i_q": ""}
    assert np.array_equal(np.asarray(recording.signals["x_ref"].values[:]), TIME**2)


def test_parquet_lists_are_one_column_for_each_element(tmp_path: Path) -> None:
    """As recordings of robots hold their joints; lists of many lengths, or of more elements than any machine has axes, are none."""
    joints = np.column_stack([TIME, TIME**2])
    ragged = [[0.0] * (1 + k % 2) for k in range(len(TIME))]
    pq.write_table(
        pa.table({"timestamp": TIME, "action": joints.tolist(), "ragged": ragged, "image": [[0.0] * 100] * len(TIME)}),
        tmp_path / "a.parquet",
    )
    recording = read_recording(tmp_path / "a.parquet", ReadOptions(Clock(), None, tmp_path))
    assert list(recording.signals) == ["action[0]", "action[1]"]
    assert np.array_equal(np.asarray(recording.signals["action[1]"].values[:]), TIME**2)


def _compound(columns: Mapping[str, Array]) -> Array:
    return np.rec.fromarrays(list(columns.values()), names=",".join(columns))


def _hdf5(path: Path, columns: Mapping[str, Array], kind: str) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        if kind == "datasets":
            for name, values in columns.items():
                file[f"run/{name}"] = values
        elif kind == "compound":
            file["run"] = _compound(columns)
        else:
            file["run"] = np.column_stack(list(columns.values()))
            file["run"].attrs["columns"] = list(columns)


def _workbook(path: Path, columns: Mapping[str, Array]) -> None:
    openpyxl, _ = pytest.importorskip("openpyxl"), pytest.importorskip("python_calamine")
    book = openpyxl.Workbook(write_only=True)
    book.create_sheet("About").append(["Machine", "UCP"])
    sheet = book.create_sheet("Trace")
    for row in ([f"{name} [s]" if name == "t" else name for name in columns], *zip(*(values.tolist() for values in columns.values()))):
        sheet.append(row)
    book.save(path)


def _zipped(path: Path, columns: Mapping[str, Array]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(write_csv(path.with_suffix(".csv"), columns), "folder/run.csv")
        archive.writestr("__MACOSX/._run.csv", "of the system")


def _gzipped(path: Path, columns: Mapping[str, Array]) -> None:
    path.write_bytes(gzip.compress(write_csv(path.with_suffix(".text"), columns).read_bytes()))


CONTAINERS: dict[str, tuple[str, Callable[[Path, Mapping[str, Array]], object]]] = {
    "npz": ("run.npz", lambda p, c: np.savez_compressed(p, **c)),
    "npy of records": ("run.npy", lambda p, c: np.save(p, _compound(c))),
    "Feather": ("run.feather", lambda p, c: pyarrow.feather.write_feather(pa.table(dict(c)), p)),
    "Arrow": ("run.arrow", lambda p, c: pyarrow.feather.write_feather(pa.table(dict(c)), p, compression="uncompressed")),
    "HDF5 datasets": ("run.h5", lambda p, c: _hdf5(p, c, "datasets")),
    "HDF5 compound": ("run.h5", lambda p, c: _hdf5(p, c, "compound")),
    "HDF5 table with names": ("run.hdf5", lambda p, c: _hdf5(p, c, "table")),
    "Excel": ("run.xlsx", _workbook),
    "ZIP": ("run.zip", _zipped),
    "gzip": ("run.csv.gz", _gzipped),
}


@pytest.mark.parametrize("case", CONTAINERS)
def test_one_recording_in_any_container(tmp_path: Path, case: str) -> None:
    name, write = CONTAINERS[case]
    columns = {"t": TIME, **move(TIME)}
    write(tmp_path / name, columns)
    recording = read_recording(tmp_path / name, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert recording.path == tmp_path / name
    assert recording.source.column.endswith("t")
    for key, values in move(TIME).items():
        [signal] = [one for own, one in recording.signals.items() if own.split(".")[-1] == key]
        np.testing.assert_allclose(signal.values[:], values, rtol=1e-15)  # openpyxl writes 16 digits
        assert signal.time is not None
        np.testing.assert_allclose(signal.time[:], TIME, atol=1e-12)


def test_matlab_7_3(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="MATLAB 7.3 is read where h5py is installed")
    columns = move(TIME)
    with h5py.File(tmp_path / "run.mat", "w", userblock_size=512) as file:
        for name, values in {"t": TIME, **columns}.items():
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    with open(tmp_path / "run.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    same(imported(tmp_path, [tmp_path / "run.mat"]), columns)


@pytest.mark.filterwarnings("error")
def test_datasets_with_rates_of_their_own(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    columns = move(TIME)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name, values in columns.items():
            every = 2 if name in ("soll", "ist") else 1
            made = file.create_dataset(f"X/{name}", data=values[::every])
            made.attrs["sample_rate"] = 1000.0 / every
        file["X/other"] = np.arange(7.0) ** 2
    found = read_recording(tmp_path / "run.h5", ReadOptions(Clock(), None, tmp_path / "scratch"))
    times = {name: signal.time for name, signal in found.signals.items()}
    assert times["X.ist"] is not None
    assert times["X.strom"] is not None
    assert times["X.ist"][1] == pytest.approx(2e-3)
    assert times["X.strom"][1] == pytest.approx(1e-3)
    assert "7 samples" in propose([found]).unknown["X.other"]


def test_attributes_convert_counts(tmp_path: Path) -> None:
    """A position in counts was taken as mm or um, although the file states the counts of a turn and the lead."""
    h5py = pytest.importorskip("h5py")
    place = move(TIME)["ist"]
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.attrs["sample_rate_hz"] = 1.0 / (TIME[1] - TIME[0])
        for name, lead in (("X", {"lead_mm": 10.0}), ("C", {})):
            made = file.create_dataset(f"{name}/ist", data=np.rint(place / 10.0 * 4096.0).astype(int))
            made.attrs.update({"unit": "counts", **lead})
        file.create_dataset("X/status", data=np.rint(place).astype(int))
        file.attrs["counts_per_revolution"] = 4096
    found = read_recording(tmp_path / "run.h5", ReadOptions(Clock(), None, tmp_path / "scratch"))
    for name, unit, factor in (("X.ist", "mm", 1.0), ("C.ist", "rev", 0.1), ("X.status", "", 1.0)):
        assert found.signals[name].unit == unit
        np.testing.assert_allclose(found.signals[name].values, place * factor, atol=0.51 if name == "X.status" else 2e-3)
    assert "X.ist.counts_per_revolution = 4096" in found.notes[0]


def test_a_column_that_is_not_a_clock_is_ignored() -> None:
    columns = {"time": (np.array([np.inf, np.inf, 1.0]), "s"), "t": (np.array([0.0, 1.0, 2.0]), "s"), "x": (np.zeros(3), "mm")}
    signals, _, _ = share_time(columns, Clock(), "file")
    assert signals["x"].time is not None
    assert list(signals["x"].time) == [0.0, 1.0, 2.0]


def test_a_trace_of_the_twin_is_read_too(tmp_path: Path) -> None:
    from twin.recordings.trace import write_trace

    columns = move(TIME)
    trace = Trace(
        TIME,
        {
            ("X", s): columns[n] * f
            for n, s, f in (("soll", "setpoint", 1e-3), ("ist", "position", 1e-3), ("speed", "velocity", 1e-3), ("strom", "current", 1.0))
        },
        {"X": "linear"},
    )
    write_trace(trace, tmp_path / "run.parquet")
    text = (
        MAP.replace('"soll"', '"X.setpoint"')
        .replace('"ist"', '"X.position"')
        .replace('"speed"', '"X.velocity"')
        .replace('"strom"', '"X.current"')
    )
    same(imported(tmp_path, [tmp_path / "run.parquet"], text), columns)


def test_files_recorded_together_make_one_run(tmp_path: Path) -> None:
    columns = move(TIME)
    control = write_csv(tmp_path / "control.csv", {"t": TIME, "soll": columns["soll"], "ist": columns["ist"]})
    scope = write_tdms(tmp_path / "scope.tdms", {"speed": columns["speed"], "strom": columns["strom"]}, 1e-3)
    text = MAP + '[[run]]\nfiles = ["control.csv", "scope.tdms"]\nname = "together"\nfeedforward = "velocity"\nstarted_at_s = 12.5\n'
    same(imported(tmp_path, [control, scope], text, "together"), columns)
    campaign = (tmp_path / "out" / "campaign.toml").read_text(encoding="utf-8")
    assert 'feedforward = "velocity"' in campaign
    assert "started_at_s = 12.5" in campaign


def test_without_a_map_the_files_are_listed_and_a_map_begun(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_csv(tmp_path / "run.csv", {"t": TIME, **move(TIME)})
    assert main(["import", str(file)]) == 0
    out = capsys.readouterr().out
    assert "strom" in out
    assert "1 ms" in out
    assert out.count("[[column]]") == 4


def test_the_example_of_the_documentation(tmp_path: Path) -> None:
    from twin.machine.machine import load_machine
    from twin.recordings.campaign import read_campaign

    files = sorted(str(f) for f in TRACES.glob("x_*"))
    assert main(["import", *files, "--map", str(TRACES / "map.toml"), "--out", str(tmp_path / "out")]) == 0
    campaign = read_campaign(tmp_path / "out", load_machine())
    assert [(r.name, r.feedforward, len(r.trace.time)) for r in campaign.runs] == [
        ("x_feedforward_off", "off", 1548),
        ("x_velocity_feedforward", "velocity", 1547),
    ]
    for run in campaign.runs:
        # both recordings show one move: 200 mm at 15 m/min; 5.5 mm following error without feedforward, 2 ms with it
        trace = run.trace
        error = trace.get("X", "setpoint") - trace.get("X", "position")
        assert np.abs(error).max() == pytest.approx(5.5e-3 if run.feedforward == "off" else 0.5e-3, rel=0.02)
        assert np.abs(trace.get("X", "motor_position") - trace.get("X", "position")).max() < 2e-6
        assert (tmp_path / "out" / f"{run.name}.png").stat().st_size > 10_000


@pytest.mark.skipif(not EMPS.is_file(), reason="needs the EMPS recording, which is not in the repository")
def test_a_measured_axis(tmp_path: Path) -> None:
    from scipy.io import loadmat

    trace = imported(tmp_path, [EMPS], EMPS_MAP)
    record = loadmat(EMPS)
    for name, signal in (("qg", "setpoint"), ("qm", "motor_position"), ("vir", "voltage")):
        # conversion to mm rounds
        assert np.abs(trace.get("X", signal) - record[name].ravel()).max() <= 4e-16 * np.abs(record[name]).max()
    assert trace.period == pytest.approx(1e-3, rel=1e-12)


def test_parquet_columns_that_differ_in_their_unit_are_two(tmp_path: Path) -> None:
    table = pa.table({"time [s]": [0.0, 1e-3, 2e-3], "X.disturbance [N]": [1.0, 2.0, 3.0], "X.disturbance [A]": [4.0, 5.0, 6.0]})
    pq.write_table(table, tmp_path / "r.parquet")
    found = read_parquet(tmp_path / "r.parquet", ReadOptions(Clock(), None, tmp_path)).signals
    assert {"X.disturbance [N]", "X.disturbance [A]"} <= set(found)


@pytest.mark.parametrize("name", ["\U00020bb7", "a\x7fb", 'quote " and \\', "line\nbreak"])
def test_any_name_is_a_toml_string_and_key(name: str) -> None:
    assert tomllib.loads(f"{toml_key(name)} = {toml_text(name)}") == {name: name}


ROWS = TIME[:300]
DATES = np.datetime64("2024-05-03T08:00:00") + np.rint(ROWS * 1e9).astype("timedelta64[ns]")


def _rows_of_words(columns: Mapping[str, Array]) -> pa.Table:
    """One value a row, under its name."""
    names = [name for _ in DATES for name in columns]
    return pa.table(
        {"timestamp": np.repeat(DATES, len(columns)), "signal": names, "value": np.column_stack(list(columns.values())).ravel()}
    )


def _attributes(path: Path, columns: Mapping[str, Array]) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.attrs["sample_rate_hz"] = 1.0 / ROWS[1]
        for name, values in columns.items():
            file.create_dataset(f"X/{name}", data=values).attrs["unit"] = "mm"


def _json(content: object) -> Callable[[Path], object]:
    return lambda path: path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _tables(columns: Mapping[str, Array]) -> dict[str, tuple[str, Callable[[Path], object]]]:
    """Writers of a table whose time or interval the file states, in shapes of other tools."""
    dated = pa.table({"time": DATES, **columns})
    lists = {name: values.tolist() for name, values in columns.items()}
    matrix = np.column_stack([ROWS, *columns.values()])
    heads = np.array(["t [s]", *columns], dtype=object)
    return {
        "Parquet with dates": ("run.parquet", lambda p: pq.write_table(dated, p)),
        "Feather with dates": ("run.feather", lambda p: pyarrow.feather.write_feather(dated, p)),
        "Parquet with names in its rows": ("run.parquet", lambda p: pq.write_table(_rows_of_words(columns), p)),
        "names and rows": ("run.json", _json({"columns": list(heads), "data": matrix.tolist()})),
        "channels": ("run.json", _json({"sample_interval_ms": 1.0, "channels": [{"name": n, "data": v} for n, v in lists.items()]})),
        "columns and a rate": ("run.json", _json({"meta": {"fs": 1000.0, "by": "us"}, "run": lists})),
        "objects with dates": (
            "run.json",
            _json([{"ts": str(t), "a": {"b": dict(zip(columns, row.tolist()))}} for t, row in zip(DATES, matrix[:, 1:])]),
        ),
        "matrix with names beside it": ("run.mat", lambda p: savemat(p, {"data": matrix, "names": heads})),
        "vectors and their interval": ("run.mat", lambda p: savemat(p, {"Ts": ROWS[1], **columns})),
        "tables with the time in their first column": (
            "run.mat", lambda p: savemat(p, {name: np.column_stack([ROWS, own]) for name, own in columns.items()})
        ),
        "HDF5 with attributes": ("run.h5", lambda p: _attributes(p, columns)),
    }  # fmt: skip


@pytest.mark.parametrize("case", _tables({}))
def test_tables_in_shapes_of_other_tools(tmp_path: Path, case: str) -> None:
    columns = move(ROWS)
    name, write = _tables(columns)[case]
    write(tmp_path / name)
    recording = read_recording(tmp_path / name, ReadOptions(Clock(), None, tmp_path / "scratch"))
    assert recording.path == tmp_path / name
    assert recording.source.known
    assert recording.source.assumed == case.startswith("tables with")  # no unit of the time
    for key, values in columns.items():
        [signal] = [one for own, one in recording.signals.items() if own.split(".")[-1] == key]
        np.testing.assert_allclose(signal.values[:], values, rtol=1e-15)
        assert signal.unit == ("mm" if case.startswith("HDF5") else "")
        assert signal.time is not None
        np.testing.assert_allclose(signal.time[:], ROWS, atol=1e-6)


def test_columns_of_a_matrix_are_no_axes(tmp_path: Path) -> None:
    columns = move(TIME)
    np.save(tmp_path / "run.npy", np.column_stack([TIME, *columns.values()]))
    found = propose([read_recording(tmp_path / "run.npy", ReadOptions(Clock(), None, tmp_path))])
    assert {(c.name, c.axis, c.signal) for c in found.used} == {
        (f"[{i}]", "X", signal) for i, signal in enumerate(("setpoint", "position", "velocity", "current"), start=1)
    }
    assert found.time is not None
    assert found.time.column == "[0]"


@pytest.mark.parametrize("seed", range(6))
def test_turns_are_counted_on(tmp_path: Path, seed: int) -> None:
    """x mod M of any motion gives x back, but for whole turns that set point and position share; nothing else is changed."""
    rng = np.random.default_rng(seed)
    unit, turn = [("deg", 360.0), ("rad", 2.0 * np.pi), ("rev", 1.0), ("", 360.0), ("", 4096.0), ("mm", 0.0)][seed]
    motion = move(TIME)
    scale = 0.04 * (turn or 360.0)
    begin = float(rng.uniform(-3.0, 3.0)) * (turn or 360.0)
    truth = {key: begin + scale * motion[key] for key in ("soll", "ist")}
    if turn == 4096.0:
        truth = {key: np.rint(values) for key, values in truth.items()}
    low = float(rng.choice([0.0, -0.5])) * turn
    table = {key: (values - low) % turn + low if turn else values for key, values in truth.items()}
    square, slow = np.where(np.sin(TIME) > 0.0, 0.0, 1.0), TIME % 1.0
    other = {"switch": turn * square, "steps": 0.97 * turn * square, "saw": 0.96 * turn * slow, "strom": motion["strom"]}
    names = {"soll": "C soll", "ist": "C ist", "strom": "C Strom"} | {key: f"C {key}" for key in ("switch", "steps", "saw")}
    heads = {key: f"{name} [{unit}]" if unit and key in truth else name for key, name in names.items()}
    file = write_csv(tmp_path / "run.csv", {"t [s]": TIME, **{heads[key]: values for key, values in {**table, **other}.items()}})
    recording = read_recording(file, ReadOptions(Clock(), None, tmp_path / "scratch"))
    found = {key: np.asarray(recording.signals[names[key]].values[:]) for key in names}
    turns = {round((found[key][0] - truth[key][0]) / (turn or 1.0)) for key in truth}
    assert len(turns) == 1
    for key, values in truth.items():
        np.testing.assert_allclose(found[key], values + turns.copy().pop() * turn, atol=1e-9 * max(turn, 360.0))
    for key, values in other.items():
        np.testing.assert_array_equal(found[key], values)
    assert any("turns counted on" in note for note in recording.notes) == bool(turn)
