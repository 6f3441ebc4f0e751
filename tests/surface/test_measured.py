"""Measured height maps: the same mark, shifted, tilted and noisy, is found again; X3P and CSV are read."""

from __future__ import annotations

from pathlib import Path
import struct
import zipfile

import numpy as np
import pytest

from examples.measured_surface.sur_writer import write_sur
from twin.errors import InputError
from twin.surface.measured import HeightMap, compare, read_height_map


def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A mark 20 um deep and a ripple [m]."""
    return -20e-6 * np.exp(-((u - 1e-3) ** 2 + ((v[:, None] - 0.5e-3) * 2) ** 2) / 2e-7) + 1e-6 * np.cos(u / 1e-4)


def test_shift_and_tilt_are_taken_out() -> None:
    u, v = np.arange(0.0, 3e-3, 1e-5), np.arange(0.0, 1.5e-3, 1e-5)
    simulated = HeightMap(u, v, surface(u, v))
    noise = np.random.default_rng(1).normal(0.0, 1e-7, (len(v), len(u)))
    shifted = surface(u + 2e-4, v - 1e-4) + 1e-3 * u + 2e-3 * v[:, None] + 5e-6 + noise
    found = compare(HeightMap(u + 7.0, v - 3.0, shifted), simulated)
    assert found.rms < 2e-7
    depths = found.depth(simulated.height)
    assert depths[1] == pytest.approx(depths[0], abs=1e-6)
    assert found.shift[0] == pytest.approx(-7.0 + 2e-4, abs=1.5e-5)


def test_files(tmp_path: Path) -> None:
    u, v = np.arange(20) * 1e-5, np.arange(10) * 2e-5
    height = surface(u, v)
    np.savez(tmp_path / "map.npz", u=u, v=v, height=height)
    rows = [f"{a * 1e3},{b * 1e3},{z * 1e6}" for b, line in zip(v, height) for a, z in zip(u, line)]
    (tmp_path / "map.csv").write_text("\n".join(["u [mm],v [mm],deviation [um]", *rows]), encoding="utf-8")
    axes = "".join(f"<C{n}><DataType>D</DataType><Increment>{d}</Increment></C{n}>" for n, d in (("X", 1e-5), ("Y", 2e-5), ("Z", 1.0)))
    xml = (
        f"<p><Record1><Axes>{axes}</Axes></Record1><Record3><MatrixDimension><SizeX>20</SizeX><SizeY>10</SizeY></MatrixDimension>"
        "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3></p>"
    )
    with zipfile.ZipFile(tmp_path / "map.x3p", "w") as archive:
        archive.writestr("main.xml", xml)
        archive.writestr("bindata/data.bin", height.astype("<f8").tobytes())
    write_sur(tmp_path / "map.sur", 1e-5, 2e-5, height)
    for ending in ("npz", "csv", "sur", "x3p"):
        found = read_height_map(tmp_path / f"map.{ending}")
        np.testing.assert_allclose(found.height, height, atol=1e-10 if ending == "sur" else 1e-12)
        np.testing.assert_allclose(found.v, v, atol=1e-9)


def sur_file(path: Path, numbers: np.ndarray, **changed: bytes) -> Path:
    """A .sur file of 16 bits, put together by hand from the published layout: a step of 2 nm, points 5 and 10 um apart."""
    head = bytearray(512)
    head[:12] = b"DIGITAL SURF"
    head[14:16], head[86:88], head[98:100] = struct.pack("<h", 1), struct.pack("<h", 1), struct.pack("<h", 16)
    head[100:108] = struct.pack("<ii", -500, 500)
    head[108:116] = struct.pack("<ii", numbers.shape[1], numbers.shape[0])
    head[120:132] = struct.pack("<fff", 5.0, 0.01, 2.0)
    for at, unit in ((180, "\u00b5m"), (196, "mm"), (212, "nm")):
        head[at : at + 16] = unit.encode("latin-1").ljust(16, b"\0")
    head[334:338] = struct.pack("<hh", 7, 3)
    head[474:478] = struct.pack("<f", 100.0)
    for place, value in changed.items():
        at = int(place.removeprefix("at_"))
        head[at : at + len(value)] = value
    path.write_bytes(bytes(head) + b"comment" + b"own" + numbers.astype("<i2").tobytes())
    return path


def test_a_sur_file_of_another_program(tmp_path: Path) -> None:
    """Units, increments, offset, comment zones and points that were not measured."""
    numbers = np.arange(-100, 100).reshape(10, 20)
    numbers[3, 4] = -502
    found = read_height_map(sur_file(tmp_path / "map.sur", numbers))
    assert np.isnan(found.height[3, 4])
    assert found.height[0, 1] == pytest.approx((-99 * 2.0 + 100.0) * 1e-9)
    assert (found.u[1], found.v[1]) == (pytest.approx(5e-6), pytest.approx(1e-5))


def test_sur_files_that_are_refused(tmp_path: Path) -> None:
    numbers = np.zeros((10, 20), int)
    for changed, says in (
        ({"at_0": b"DSCOMPRESSED"}, "packed"),
        ({"at_0": b"SOMETHING"}, "not a SUR file"),
        ({"at_14": b"\x02\x00"}, "2 objects"),
        ({"at_108": struct.pack("<i", 4000)}, "ends before"),
        ({"at_212": b"Kelvin".ljust(16, b"\0")}, "unit of z is 'Kelvin'"),
    ):
        with pytest.raises(InputError, match=says):
            read_height_map(sur_file(tmp_path / "map.sur", numbers, **changed))


def test_faults(tmp_path: Path) -> None:
    (tmp_path / "map.x3p").write_text("no archive", encoding="utf-8")
    for name, says in (("none.npz", "no such height map"), ("map.x3p", "not a readable height map")):
        with pytest.raises(InputError, match=says):
            read_height_map(tmp_path / name)


@pytest.mark.parametrize(
    ("u", "height", "says"),
    [
        (np.arange(20) * 1e-5, 1e300, "heights up to 1e.300 m, the limit is 10 m"),
        (np.arange(20) * 1.0, 1e-6, "u up to 19 m"),
        (np.zeros(20), 1e-6, "does not increase"),
        (np.full(20, np.nan), 1e-6, "u up to nan m"),
    ],
)
def test_coordinates_that_no_map_has(u: np.ndarray, height: float, says: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "map.npz", u=u, v=np.arange(10) * 1e-5, height=np.full((10, 20), height))
    with pytest.raises(InputError, match=says):
        read_height_map(tmp_path / "map.npz")


@pytest.mark.filterwarnings("error")
def test_a_map_that_hardly_lies_on_the_simulated_one() -> None:
    u, v = np.arange(0.0, 3e-3, 1e-5), np.arange(0.0, 1.5e-3, 1e-5)
    part = surface(u, v)
    part[:, : int(0.8 * len(u))] = np.nan
    with pytest.raises(InputError, match="covers 20%"):
        compare(HeightMap(u, v, part), HeightMap(u, v, surface(u, v)))
