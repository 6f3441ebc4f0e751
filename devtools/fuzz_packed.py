"""Kind `packed` of the fuzzer: files that are small on disk and large once read, in all formats, odd names, and words of any length.

Each case draws a builder; the command may refuse the file or read it, in one line and within the memory of a small computer.
"""

from __future__ import annotations

from collections.abc import Callable
import gzip
from pathlib import Path
import random
from unittest import mock

import numpy as np

from devtools.fuzz_loop import called

MEMORY = 4e9
"""Memory of the computer that a case pretends to have [bytes]: the content of a file may take an eighth."""
STEERING = ("\x1b[2J", "\x1b]0;x\x07", "\x9b31m", "\u202e", "\r", "\x08", "\x7f", "", "", "")


def name(rng: random.Random) -> str:
    """A name with control characters, of up to 3000 letters."""
    return (
        rng.choice(("X.setpoint", "time", "x", "é", "a b"))
        + rng.choice(STEERING)
        + "n" * rng.choice((0, 0, 5, 300, 3000))
        + rng.choice(STEERING)
    )


def parquet(path: Path, rng: random.Random) -> None:
    """Columns of zeros, of one text, of one list, of other types, with names of any kind."""
    import pyarrow as pa
    import pyarrow.parquet

    rows = 10 ** rng.randrange(1, 8)
    cells: list[Callable[[int], object]] = [
        lambda n: pa.array(np.zeros(n)),
        lambda n: pa.array(np.arange(n) * 1e-3),
        lambda n: pa.DictionaryArray.from_arrays(np.zeros(n, np.int32), ["x" * rng.choice((1, 1000, 1_000_000))]),
        lambda n: pa.ListArray.from_arrays(pa.array(np.linspace(0, n, n + 1).astype(np.int32)), pa.nulls(n, pa.int8())),
        lambda n: pa.nulls(n, pa.float32()),
        lambda n: pa.array(np.zeros(n, bool)),
    ]
    names = ["time [s]", "X.setpoint [mm]", *(name(rng) for _ in range(rng.randrange(4)))]
    columns = [cells[1](rows), cells[0](rows), *(rng.choice(cells)(rows) for _ in names[2:])]
    pyarrow.parquet.write_table(
        pa.Table.from_arrays(columns, names), path, compression=rng.choice(("zstd", "snappy", "gzip", "none")), store_schema=False
    )


def text(path: Path, rng: random.Random) -> None:
    """A text of equal rows, also compressed under its ending."""
    row = rng.choice((b"0,0\n", b",\n", b"1e3,1e3\n", b"0;0\n", b"x,y\n"))
    content = f"time [s],{name(rng)} [mm]\n".encode() + row * rng.choice((10, 10_000, 3_000_000))
    path.write_bytes(gzip.compress(content, 1) if path.suffix == ".gz" else content)


def mat(path: Path, rng: random.Random) -> None:
    """Vectors, sparse matrices, structs in structs, long ones compressed."""
    import scipy.io
    import scipy.sparse

    values: list[object] = [
        np.zeros(10 ** rng.randrange(1, 9), np.int8),
        scipy.sparse.eye(9),
        {"a": {"b": np.arange(9)}},
        "text",
        1j * np.ones(9),
    ]
    scipy.io.savemat(path, {"t": np.arange(9) * 1e-3, **{f"v{i}": rng.choice(values) for i in range(3)}}, do_compression=True)


def tdms(path: Path, rng: random.Random) -> None:
    """Channels whose properties are of other types."""
    import nptdms

    odd: list[object] = [1e-3, "soon", -1.0, 0, True, 2**62]
    given = {key: rng.choice(odd) for key in ("wf_increment", "wf_start_offset", "unit_string", "wf_start_time")}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("g", name(rng)[:99], np.zeros(10 ** rng.randrange(1, 8), np.int8), given)])


def mdf(path: Path, rng: random.Random) -> None:
    """Deflated channels."""
    import asammdf

    rows = 10 ** rng.randrange(1, 7)
    with asammdf.MDF(version=rng.choice(("4.10", "4.00", "3.30"))) as file:
        file.append([asammdf.Signal(np.zeros(rows), np.arange(rows) * 1e-3, name="a", unit=rng.choice(("mm", "", "x" * 99)))])
        file.save(path, overwrite=True, compression=rng.choice((0, 1, 2)))


def xml(path: Path, rng: random.Random) -> None:
    """Attributes of a SINUMERIK trace that are no numbers, and long spans."""
    odd = ("0", "1", "inf", "nan", "1e999", "x", "9" * 5000, "-1", "", "1e-300", "30")
    head = f'<frameHeader startTime="2024" dropOuts="{rng.choice(odd)}"/><dataSignal id="f" name="a" interval="{rng.choice((*odd, "1e-6", "0.002"))}"/>'
    records = "".join(f'<rec time="{rng.choice((i, i, rng.choice(odd)))}" f="{rng.choice(odd)}"/>' for i in range(9))
    path.write_text(f"<traceSession><traceData><dataFrame>{head}{records}</dataFrame></traceData></traceSession>")


def campaign(path: Path, rng: random.Random) -> None:
    """Many runs, runs of long names, events of long texts."""
    path.mkdir()
    parquet(path / "r.parquet", rng)
    runs = [f"{rng.choice(('r', 'r', 'y' * 300, name(rng)))}.parquet" for _ in range(rng.choice((1, 2, 30)))] * rng.choice((1, 1, 1000))
    quoted = [run.encode("unicode_escape").decode().replace("\\x", "\\u00") for run in runs]
    (path / "campaign.toml").write_text("".join(f'[[run]]\nfile = "{run}"\n' for run in quoted))
    if rng.random() < 0.3:
        parquet(path / "events.parquet", rng)


def program(path: Path, rng: random.Random) -> None:
    """Numbers and words of any length."""
    words = [
        rng.choice("MGHTDLFSXNPRZACIJKQ") + rng.choice(("9" * 400, "0" * 400, "1." + "3" * 400, "1", "-", "=" + "9" * 400))
        for _ in range(6)
    ]
    path.write_text("G1 X1 F1000\n" + rng.choice((" ", "\n")).join(words) + f"\nQQ{rng.choice(STEERING)}=1\nM30\n")


BUILDERS: dict[str, Callable[[Path, random.Random], None]] = {
    "a.parquet": parquet, "a.csv": text, "a.csv.gz": text, "a.mat": mat, "a.tdms": tdms, "a.mf4": mdf, "a.xml": xml, "c": campaign, "p.mpf": program,
    "p.ngc": program, "p.nc": program,
}  # fmt: skip


def packed(seed: int, folder: Path) -> str:
    """One file of this kind, given to a command that reads it."""
    rng = random.Random(f"packed {seed}")
    file = rng.choice(list(BUILDERS))
    path = folder / file
    BUILDERS[file](path, rng)
    if path.is_dir():
        command: tuple[object, ...] = ("gap", path)
    elif file.startswith("p."):
        command = ("check", path)
    else:
        command = rng.choice(
            (("import", path), ("import", path, "--out", folder / "out", "--no-picture"), ("run", path, "--out", folder / "out"))
        )
    if rng.random() < 0.1:
        command = tuple(f"{word}{'y' * rng.choice((300, 3000))}" if word is path else word for word in command)
    with mock.patch("twin.limits.memory_bytes", return_value=MEMORY):
        return called(command)[1]
