"""Traces keep their values through Parquet and CSV in any unit."""

from pathlib import Path
import re
import tempfile

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from twin.errors import InputError
from twin.recordings.campaign import read_campaign
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.system import shell_word
from twin.units import UNITS

KINDS = {"X": "linear", "A": "rotary"}
ONE_ROUNDING = 4e-16
"""Relative error of one multiplication and one division by a unit's factor."""

numbers = st.floats(-1e3, 1e3, allow_subnormal=False)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=2, max_size=20), st.sampled_from(["parquet", "csv", "PARQUET", "CSV"]))
def test_written_and_read_again_is_the_same(rows: list[tuple[float, float, float]], ending: str) -> None:
    values = np.array(rows)
    time = np.arange(len(values)) * 0.001
    signals = {("X", "setpoint"): values[:, 0], ("A", "velocity"): values[:, 1], ("A", "current"): values[:, 2]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"trace.{ending}"
        write_trace(Trace(time, signals, KINDS), path)
        read = read_trace(path)
    assert list(read.signals) == list(signals)
    assert read.kinds == KINDS
    np.testing.assert_array_equal(read.time, time)
    for key, expected in signals.items():
        np.testing.assert_allclose(read.get(*key), expected, rtol=ONE_ROUNDING, atol=0)


@pytest.mark.parametrize("unit", [u for u in UNITS if UNITS[u][0] in ("length", "angle")])
def test_heading_decides_the_unit(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(f"time [ms],Q.setpoint [{unit}]\n0,1\n1,2\n2,4\n")
    trace = read_trace(path)
    np.testing.assert_allclose(trace.get("Q", "setpoint"), np.array([1, 2, 4]) * UNITS[unit][1], rtol=1e-15)
    np.testing.assert_allclose(trace.time, [0, 1e-3, 2e-3], rtol=1e-15)
    assert trace.kinds["Q"] == ("linear" if UNITS[unit][0] == "length" else "rotary")


def test_select_decimate_and_matrix_keep_the_order() -> None:
    time = np.arange(10) * 0.5
    trace = Trace(time, {("X", "setpoint"): time, ("A", "setpoint"): -time, ("program", "block"): time}, KINDS)
    assert trace.axes == ("X", "A")
    assert trace.period == pytest.approx(0.5)
    np.testing.assert_array_equal(trace.matrix("setpoint"), np.column_stack([time, -time]))
    assert trace.select(["A"]).axes == ("A",)
    assert trace.select(["A"]).has("program", "block")
    assert trace.decimated(3).time.tolist() == [0, 1.5, 3, 4.5]


def test_the_message_about_a_missing_signal_lists_the_recorded_ones() -> None:
    trace = Trace(np.arange(2.0), {("X", "setpoint"): np.zeros(2)}, KINDS)
    with pytest.raises(InputError, match=r"no X\.position; axis X has: setpoint"):
        trace.get("X", "position")


def test_printed_times_may_be_rounded(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    times = np.round(np.arange(50) / 300.0, 5)
    path.write_text("time [s],X.setpoint [mm]\n" + "".join(f"{t},0\n" for t in times))
    assert read_trace(path).period == pytest.approx(1 / 300, rel=1e-3)


def test_a_trace_in_latin_1_is_read(tmp_path: Path) -> None:
    """German controls write Latin-1; a degree sign or a non-ASCII name must not end the reading."""
    (tmp_path / "a.csv").write_bytes("time [s],X.setpoint [mm],X.pr\u00fcfkraft [N]\n0,0,1\n0.001,0,2\n".encode("latin-1"))
    assert read_trace(tmp_path / "a.csv").get("X", "pr\u00fcfkraft").tolist() == [1.0, 2.0]


def test_whole_numbers_beyond_a_float_are_rounded(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    table = {"time [s]": [0.0, 0.001], "X.setpoint [mm]": [0.0, 0.0], "X.counter [1]": pa.array([2**64 - 1, 2**64 - 2], pa.uint64())}
    pyarrow.parquet.write_table(pa.table(table), tmp_path / "a.parquet")
    assert read_trace(tmp_path / "a.parquet").get("X", "counter")[0] == 2.0**64


def test_two_columns_of_an_axis_must_agree_on_its_kind(tmp_path: Path) -> None:
    table = pa.table({"time [s]": [0.0, 1e-3, 2e-3], "X.setpoint [mm]": [0.0, 1.0, 2.0], "X.position [deg]": [0.0, 1.0, 2.0]})
    pq.write_table(table, tmp_path / "t.parquet")
    with pytest.raises(InputError, match=re.escape("X.position [deg]")):
        read_trace(tmp_path / "t.parquet")


def test_a_trace_with_only_a_current_is_written_again(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time [s]": [0.0, 1e-3, 2e-3], "X.current [A]": [0.0, 1.0, 2.0]}), tmp_path / "t.parquet")
    assert "X.current [A]" in read_trace(tmp_path / "t.parquet").to_table().column_names


def test_a_command_in_a_message_can_be_typed_in(tmp_path: Path) -> None:
    """A path with a blank is one word of it."""
    path = tmp_path / "of a control.csv"
    path.write_text("time [ms],X.setpoint [mm]\n0,1\n1,2\n")
    with pytest.raises(InputError, match=re.escape(f"twin import {shell_word(path)} --out")):
        read_campaign(path)
