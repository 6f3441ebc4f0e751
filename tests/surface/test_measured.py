"""Measured height maps: the same mark, shifted, tilted and noisy, is found again; X3P and CSV are read."""

from __future__ import annotations

from pathlib import Path
import zipfile

import numpy as np
import pytest

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
    for ending in ("npz", "csv", "x3p"):
        found = read_height_map(tmp_path / f"map.{ending}")
        np.testing.assert_allclose(found.height, height, atol=1e-12)
        np.testing.assert_allclose(found.v, v, atol=1e-9)


def test_faults(tmp_path: Path) -> None:
    (tmp_path / "map.x3p").write_text("no archive", encoding="utf-8")
    for name, says in (("none.npz", "no such height map"), ("map.x3p", "cannot be read as a height map")):
        with pytest.raises(InputError, match=says):
            read_height_map(tmp_path / name)
