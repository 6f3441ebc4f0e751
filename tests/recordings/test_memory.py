"""Files that are small on disk and large once read are refused before they are read, with estimate and limit; odd ones end in one line."""

from __future__ import annotations

from collections.abc import Callable
import gzip
import os
from pathlib import Path
import re
import tracemalloc
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest

from tests.builders.refused import refused
from twin import load_machine
from twin.cli import main
from twin.errors import InputError
from twin.recordings.campaign import MOST_RUNS, read_campaign
from twin.recordings.formats.by_content import read_recording
from twin.recordings.signals import Clock, ReadOptions
from twin.recordings.table_file import read_table
from twin.recordings.trace import Trace
from twin.simulation.setpoint_limits import limit_warnings
from twin.simulation.setpoints import setpoints_of

MEMORY = 800_000_000
"""Memory of the computer that these tests pretend to have: a file may take 100 MB."""
ROWS = 30_000_000
LIMIT = r"takes about [\d.]+ GB of memory once read, the limit is 0\.1 GB \(0\.125 of this computer's memory\)"
TIME = np.arange(4000) * 1e-3


@pytest.fixture(autouse=True)
def small_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.limits.memory_bytes", lambda: float(MEMORY))


def write(path: Path, **columns: object) -> Path:
    pyarrow.parquet.write_table(pa.table(columns), path, compression="zstd", store_schema=False)
    return path


def zeros(path: Path) -> Path:
    return write(path, **{"time [s]": np.zeros(ROWS), "X.setpoint [mm]": np.zeros(ROWS)})


def deflated_text(path: Path) -> Path:
    with gzip.open(path, "wb") as file:
        file.write(b"time [s],X.setpoint [mm]\n")
        for _ in range(30):
            file.write(b"0,0\n" * 1_000_000)
    return path


def deflated_mdf(path: Path) -> Path:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        time = np.arange(8_000_000) * 1e-6
        file.append([asammdf.Signal(np.zeros(8_000_000), time, name="a")])
        file.save(path, overwrite=True, compression=2)
    return path


def tdms(path: Path) -> Path:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("g", "a", np.zeros(16_000_000, np.int8), {"wf_increment": 1e-3})])
    return path


def deflated_mat(path: Path) -> Path:
    import scipy.io

    scipy.io.savemat(path, {"t": np.zeros(16_000_000, np.int8)}, do_compression=True)
    return path


def held_values(path: Path) -> Path:
    head = '<traceSession><traceData><dataFrame><dataSignal id="f1" name="a" interval="0.000001"/>'
    path.write_text(f'{head}<rec time="0" f1="1"/><rec time="30" f1="2"/></dataFrame></traceData></traceSession>')
    return path


def zipped_text(path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.csv", "w") as file:
        for _ in range(30):
            file.write(b"0,0\n" * 1_000_000)
    return path


def deflated_numpy(path: Path) -> Path:
    np.savez_compressed(path, t=np.zeros(16_000_000, np.int8))
    return path


def deflated_hdf5(path: Path) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("t", data=np.zeros(16_000_000, np.int8), compression="gzip")
    return path


def deflated_arrow(path: Path) -> Path:
    pyarrow.feather.write_feather(pa.table({"t": np.zeros(16_000_000)}), path, compression="zstd")
    return path


LARGE_ONCE_READ: dict[str, Callable[[Path], Path]] = {
    "zeros.parquet": zeros, "text.csv.gz": deflated_text, "a.mf4": deflated_mdf, "a.tdms": tdms, "a.mat": deflated_mat,
    "a.xml": held_values, "a.zip": zipped_text, "a.npz": deflated_numpy, "a.h5": deflated_hdf5, "a.arrow": deflated_arrow,
}  # fmt: skip


def test_a_list_is_not_read(tmp_path: Path) -> None:
    cell = pa.ListArray.from_arrays(pa.array([0, ROWS], pa.int32()), pa.nulls(ROWS, pa.int8()))
    path = write(tmp_path / "list.parquet", **{"time [s]": [0.0], "list": cell})
    taken = pa.default_memory_pool().bytes_allocated()
    assert list(read_table(path)) == ["time [s]"]
    assert pa.default_memory_pool().bytes_allocated() - taken < 1_000_000


@pytest.mark.parametrize("name", LARGE_ONCE_READ)
def test_what_comes_out_counts_not_what_lies_on_disk(name: str, tmp_path: Path) -> None:
    path = LARGE_ONCE_READ[name](tmp_path / name)
    taken = pa.default_memory_pool().bytes_allocated()
    of_trace, options = name.endswith((".parquet", ".gz")), ReadOptions(Clock(), None, tmp_path / "scratch")
    with pytest.raises(InputError, match=LIMIT):
        _ = read_table(path) if of_trace else read_recording(path, options)
    assert pa.default_memory_pool().bytes_allocated() - taken < MEMORY / 8


def test_limits_are_raised_by_the_factor_that_the_message_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.parquet", **{"time [s]": np.arange(7_000_000) * 1e-3, "X.setpoint [mm]": np.zeros(7_000_000)})
    with pytest.raises(InputError, match=r"--limits 2$"):
        read_table(path)
    monkeypatch.setenv("TWIN_LIMITS", "2")
    assert len(read_table(path)["time [s]"]) == 7_000_000


def test_one_long_text_in_many_rows_stays_one_text(tmp_path: Path) -> None:
    """A dictionary column of a text of 1 MB in 4000 rows: 4 GB if each row had its own."""
    note = pa.DictionaryArray.from_arrays(np.zeros(len(TIME), np.int32), ["x" * 1_000_000])
    path = write(tmp_path / "a.parquet", **{"time [s]": TIME, "X.setpoint [mm]": TIME, "note": note})
    before = pa.default_memory_pool().max_memory()
    recording = read_recording(path, ReadOptions(Clock(), None, tmp_path))
    assert len(recording.signals["X.setpoint"].values) == len(TIME)
    with pytest.raises(InputError, match="column 'note': row 1 holds 'xxx"):
        read_table(path)
    assert pa.default_memory_pool().max_memory() < before + MEMORY / 8


def campaign(folder: Path, runs: int = 1) -> Path:
    folder.mkdir()
    write(folder / "r0.parquet", **{"time [s]": TIME, "X.setpoint [mm]": 1e-3 * TIME})
    for i in range(1, min(runs, 1000)):
        os.link(folder / "r0.parquet", folder / f"r{i}.parquet")
    (folder / "campaign.toml").write_text("".join(f'[[run]]\nfile = "r{i % 1000}.parquet"\n' for i in range(runs)))
    return folder


def test_a_campaign_of_too_many_runs_is_refused_by_its_estimate(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "runs", 100_000)
    with pytest.raises(InputError, match=re.escape(f"about 1e+05 runs, the limit is {MOST_RUNS:.3g}")):
        read_campaign(folder)
    large = campaign(tmp_path / "large", 1000)
    write(large / "r0.parquet", **{"time [s]": np.zeros(2_000_000), "X.setpoint [mm]": np.zeros(2_000_000)})
    for i in range(1, 1000):
        (large / f"r{i}.parquet").unlink()
        os.link(large / "r0.parquet", large / f"r{i}.parquet")
    with pytest.raises(InputError, match=LIMIT):
        read_campaign(large)


def sparse_mat(path: Path) -> None:
    import scipy.io
    import scipy.sparse

    scipy.io.savemat(path, {"x": scipy.sparse.eye(10)})


def tdms_with_text(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("g", "a", np.zeros(10), {"wf_increment": "soon", "wf_start_offset": "later"})])


ODD: dict[str, Callable[[Path], object]] = {
    "sparse.mat": sparse_mat,
    "text.tdms": tdms_with_text,
    **{
        f"{i}.xml": lambda path, lost=lost: path.write_text(  # type: ignore[misc]
            f'<traceSession><traceData><dataFrame><frameHeader dropOuts="{lost}"/><dataSignal id="f" name="a" interval="1"/>'
            '<rec time="0" f="1"/><rec time="1" f="2"/></dataFrame></traceData></traceSession>'
        )
        for i, lost in enumerate(("inf", "nan", "1e999", "x", "9" * 5000))
    },
}


@pytest.mark.parametrize("name", ODD)
def test_whatever_a_reader_raises_is_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ODD[name](tmp_path / name)
    assert name in refused(capsys, "import", str(tmp_path / name))


@pytest.mark.parametrize(
    "encoding", ["idna", "punycode", "undefined", "unicode_escape", "rot13", "base64", "utf-7", "zlib", "mbcs", "x" * 500]
)
def test_an_encoding_of_any_name_is_one_line(encoding: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text("time [s],x [mm]\n" + "".join(f"{i / 1000},{i}\n" for i in range(50)))
    text = f'[csv]\nencoding = "{encoding}"\n[[column]]\nname = "x"\naxis = "X"\nsignal = "setpoint"\nunit = "mm"\n'
    (tmp_path / "map.toml").write_text(text)
    code = main(["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out"), "--no-picture"])
    said = capsys.readouterr().err
    assert code == 0 or (code == 2 and said.count("\n") == 1 and said.startswith("twin: ") and "defect" not in said), said


def test_an_import_removes_what_a_killed_one_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").write_text(
        "time [s],X.setpoint [mm],X.position [mm]\n" + "".join(f"{i / 1000},{np.sin(i / 50)},{np.sin(i / 50 - 0.1)}\n" for i in range(400))
    )
    left = tmp_path / "out" / ".import_killed" / "0"
    left.mkdir(parents=True)
    (left / "column0").write_bytes(b"x" * 1000)
    assert main(["import", str(tmp_path / "a.csv"), "--out", str(tmp_path / "out"), "--no-picture"]) == 0
    capsys.readouterr()
    assert not [p.name for p in (tmp_path / "out").iterdir() if p.name.startswith(".")]


def test_set_points_take_little_more_memory_than_themselves() -> None:
    """No array is made for forces and commands that are not recorded, and limits are judged in blocks."""
    machine, count = load_machine(), 4_000_000
    trace = Trace(np.arange(count) * 1e-3, {("X", "setpoint"): np.zeros(count)}, machine.kinds)
    own = 8 * count * len(machine.axes)
    tracemalloc.start()
    limit_warnings(setpoints_of(trace, machine), machine)
    assert tracemalloc.get_traced_memory()[1] < 2.5 * own
    tracemalloc.stop()
