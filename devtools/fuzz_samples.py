"""Small valid files of every kind that a command reads, for `fuzz_files` to corrupt."""

from __future__ import annotations

from collections.abc import Mapping
import functools
import io
from pathlib import Path
import tempfile
from typing import Any
import zipfile

import numpy as np

from tests.builders.small_machine import MJCF, TOML

ROOT = Path(__file__).resolve().parents[1]
Files = Mapping[str, bytes]
"""Content by name below a folder."""


@functools.cache
def samples() -> dict[str, dict[str, bytes]]:
    """Valid files by kind, so small that a command takes a second at most. The first file of a kind is corrupted most often."""
    examples = ROOT / "examples"
    # 51 samples of axis U moving 1 mm out and back
    swing = [f"{i * 1e-3:.3f},{0.5 * (1 - np.cos(2 * np.pi * i / 50)):.6f}" for i in range(51)]
    trace = "time [s],U.setpoint [mm]\n" + "\n".join(swing) + "\n"
    measured = (
        "time [s],U.setpoint [mm],U.position [mm],U.current [A]\n" + "\n".join(f"{row},{row.split(',')[1]},0.1" for row in swing) + "\n"
    )
    small = {"small.toml": TOML.encode(), "small.xml": MJCF.encode(), "move.csv": trace.encode()}
    study = (
        'machine = "small.toml"\n[[run]]\ninput = "move.csv"\n[[factor]]\nname = "mass"\npath = "axis.U.moving_mass_kg"\nrange = [60.0, 70.0]\n'
        '[[constraint]]\nresponse = "cycle_time_s"\nmost = 9.0\n[design]\nkind = "grid"\nlevels = 2\n'
    )
    suite = (
        '[[case]]\nname = "a"\nkind = "run"\nmachine = "small.toml"\ninput = "move.csv"\ncompare = ["position"]\nfeedforward = "off"\n'
        '[case.tolerance.position]\nrms = 1.0\nmax = 2.0\nunit = "um, arcsec"\nreason = "as much as an hour changes"\n[case.tolerance.summary]\nrelative = 0.01\nabsolute = 0.0\nreason = "as much as an hour changes"\n'
        '[case.tolerance.events]\ntime_s = 0.1\nreason = "as much as an hour changes"\n'
    )
    campaign = (
        'machine = "small"\n[[run]]\nfile = "a.csv"\nfeedforward = "velocity"\nstarted_at_s = 1.0\n[run.labels]\nload = 20.0\n'
        '[[run.channel]]\naxis = "U"\nsignal = "position"\nlatency_s = 0.0\n'
    )
    long = "time [s],U.setpoint [mm],U.position [mm],U.current [A]\n" + "".join(
        f"{i * 1e-3:.3f},{u:.6f},{u:.6f},{0.1 + 0.1 * np.sin(i / 9):.4f}\n" for i, u in enumerate(5.0 * (1 - np.cos(np.arange(700) / 60.0)))
    )
    turns = np.concatenate([np.linspace(0.0, 2.2 * np.pi, 200), np.linspace(2.2 * np.pi, 0.0, 200)])
    stops = np.concatenate([np.full(30, u) for u in (0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0, -1.0, 0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0)])
    circle, stairs = (
        "time [s],X.setpoint [mm],X.position [mm],Y.setpoint [mm],Y.position [mm]\n"
        + "".join(f"{i * 1e-2:.2f},{a:.6f},{a + 1e-3:.6f},{b:.6f},{b:.6f}\n" for i, (a, b) in enumerate(zip(x, y)))
        for x, y in ((10.0 * np.cos(turns), 10.0 * np.sin(turns)), (stops, 0.0 * stops))
    )
    numbers = np.arange(51, dtype=np.uint64)
    parquet = {"time [s]": numbers * 1e-3, "U.setpoint [mm]": numbers, "U.position [mm]": numbers.astype(np.int8)}
    part = (examples / "parts" / "part2_vertical_corner.toml").read_bytes()
    return {
        "machine": {**small},
        "model": {"small.xml": MJCF.encode(), "small.toml": TOML.encode(), "move.csv": trace.encode()},
        "model_new": {"m.xml": MJCF.encode()},
        "urdf": {"gantry.urdf": (examples / "gantry" / "gantry.urdf").read_bytes(), "spindle.stl": (examples / "gantry" / "spindle.stl").read_bytes()},
        "trace": {"move.csv": trace.encode(), **{k: v for k, v in small.items() if k != "move.csv"}},
        "campaign": {"campaign.toml": campaign.encode(), "a.csv": measured.encode(), **small},
        "diagnose": {"campaign.toml": campaign.encode(), "a.csv": measured.encode(), **small},
        "identify": {"campaign.toml": campaign.encode(), "a.csv": long.encode(), **small},
        "plan": {**small},
        "iso": {"circle.csv": circle.encode(), "stairs.csv": stairs.encode()},
        "table": {"t.parquet": _parquet(parquet), **small},
        "nc": {
            "p.mpf": b"G54 G90 G64\nDEF INT I\nR1=3\nFOR I=1 TO 2\nG1 X=I Y=R1 F5000\nG2 X=I+1 Y4 I0 J1 F3000\nENDFOR\nCYCLE83(5,0,2,-2,,-1,,1,0.1,0.1,1,1)\nG0 X0 Y0\nM30\n",
            "p.ngc": b"g21 g90 g17\n#1=2\ng0 x1 y1\ng1 x[#1*2] f3000\ng2 x5 y2 i0 j1\no1 if [#1 gt 1]\ng1 y0\no1 endif\nm2\n",
            "p.nc": b"%\nO1\nG21 G90 G17\n#100=2\nWHILE [#100 GT 0] DO1\nG1 X[#100*2.] F3000.\n#100=#100-1\nEND1\nG2 X2. Y4. R9.\nM30\n%\n",
            "p.apt": b"PARTNO/A\nUNITS/MM\nLOADTL/1\nFEDRAT/3000.0,MMPM\nRAPID\nGOTO/0,0,305\nGOTO/2.0,1.0,305.0\nDELAY/0.01\nGOTO/3.0,1.0,305.0\nFINI\n",
        },
        "map": {
            "map.toml": (examples / "traces" / "map.toml").read_bytes(),
            "x_feedforward_off.csv": b"".join((examples / "traces" / "x_feedforward_off.csv").read_bytes().splitlines(keepends=True)[:300]),
        },
        "study": {"study.toml": study.encode(), **small},
        "suite": {"suite.toml": suite.encode(), **small},
        "part": {"part.toml": part},
        "positions": {"positions.csv": (examples / "iso230" / "positions.csv").read_bytes()},
        "ballbar": {"ballbar.csv": (examples / "iso230" / "ballbar.csv").read_bytes()},
        "sinumerik": {"r.xml": (examples / "traces" / "x_velocity_feedforward.xml").read_bytes()},
        "effects": {"effects.toml": TOML.replace("[axis.U]", EFFECTS + "[axis.U]", 1).encode(), **small},
        "design": {"design.toml": DESIGN.encode(), "motors.toml": CATALOGUE.encode(), "corner.mpf": b"G1 U1 F3000\nB5 U0\nM30\n", **small},
        "archive": {"nc.tea": ARCHIVE.encode(), "data.toml": b"[U]\nMD32200 = 3.0\nSPEEDCTRL_GAIN_1 = 3.4\n[B]\nMD32300 = 0.8\n", "m.xml": MJCF.encode()},
        "events": {
            "events.parquet": _parquet({"run": ["a"] * 2, "time": [0.0, 0.02], "channel": [1, 1], "block": ["N1", "N2"], "text": ["G0", "G1 U1"]}),
            "a.parquet": _parquet({h: [float(row.split(",")[c]) for row in swing] for c, h in enumerate(("time [s]", "U.setpoint [mm]"))} | {"U.position [mm]": [0.0] * 51}),
            "campaign.toml": b'machine = "small"\n[[run]]\nfile = "a.parquet"\nfeedforward = "off"\n', **small,
        },
        "lab_axis": {
            "axis.toml": (examples / "lab_axis" / "axis.toml").read_bytes(),
            "axis.xml": (examples / "lab_axis" / "axis.xml").read_bytes(),
            "strokes.csv": b"".join((examples / "lab_axis" / "strokes.csv").read_bytes().splitlines(keepends=True)[:300]),
        },
        "mikron": {
            "mikron.toml": (ROOT / "models" / "mikron_ucp710.toml").read_bytes() + FOR_PROGRAMS.encode(),
            "mikron_ucp710.xml": (ROOT / "models" / "mikron_ucp710.xml").read_bytes(),
            "p.mpf": b"G54 T1 D1 M6\nG0 X0 Y0 Z50\nTRAORI\nG1 X5 Y1 A1 C2 F2000\nTRAFOOF\nTOOLCHECK(1)\nG75 FP=1 Z0\nM30\n",
        },
        "suites": {"suites.toml": SUITES.encode(), "campaign/campaign.toml": campaign.encode(), "campaign/a.csv": long.encode(), **small},
        "height": {"map.csv": _height_csv(), "map.npz": _height_npz(), "map.sur": _height_sur(), "map.x3p": _height_x3p(), "dip.toml": DIP.encode(), "dip.csv": DIP_MOVE.encode()},
    }  # fmt: skip


EFFECTS = """[[effect]]
name = "backlash"
axis = "U"
clearance = 5.0e-6
[[effect]]
name = "law"
axis = "U"
block = "mechanics"
output = "friction"
variables = ["speed"]
formula = "gaussian"
height = -40.0
width = 0.009
[[effect]]
name = "law"
axis = "B"
variables = ["position"]
between = "cubic"
points = [[-0.2, 0.0], [0.0, 1.0], [0.15, 0.5]]
period = 0.5
"""
FOR_PROGRAMS = """
[variables]
"$MC_EXAMPLE" = 1.0
[tool.T1]
length_m = 0.08
radius_m = 0.005
[frame.G54]
X = 0.01
[program]
calls_without_motion = ["TOOLCHECK"]
feed_mm_min = 1000.0
"""
SUITES = """[tolerance.gap]
growth = 0.02
above_noise = 0.05
reason = "what another draw of the noise would change"
[tolerance.parameters]
relative = 1e-3
of_interval = 0.5
reason = "the same records give the same numbers"
[[case]]
name = "gap"
kind = "campaign"
machine = "small.toml"
why = "the small machine against its recording"
campaign = "campaign"
[[case]]
name = "fit"
kind = "identify"
machine = "small.toml"
why = "friction of one axis from its own recording"
campaign = "campaign"
axes = ["U"]
"""
DESIGN = """seed = 1
machine = "small.toml"
answer = ["following_error_rms_U_um"]
recommission = true
retune = "same margins"
least_phase_margin_deg = 5
[fixed]
"axis.*.loops.torque_feedforward" = 0.0
[[run]]
input = "move.csv"
name = "move"
feedforward = "velocity"
[[factor]]
name = "mass"
paths = ["axis.U.moving_mass_kg"]
relative = true
range = [0.9, 1.2]
[[factor]]
name = "motor"
catalogue = "motors.toml"
axis = "U"
installed = "A"
values = ["A", "B"]
[[tied]]
path = "axis.U.loops.speed_gain_nm_s_per_rad"
to = "inertia.U"
exponent = 1.0
[design]
kind = "latin_hypercube"
count = 3
"""
CATALOGUE = "".join(
    f"""[[motor]]
name = "{name}"
torque_constant_nm_per_a = {constant}
back_emf_v_s_per_rad = 0.3
resistance_ohm = 1.0
inductance_h = 5.0e-3
peak_current_a = 20.0
bus_limit_v = 200.0
inertia_kg_m2 = {inertia}
"""
    for name, constant, inertia in (("A", 0.5, 1e-4), ("B", 0.6, 1.5e-4))
)
ARCHIVE = """; part of an archive
N10000 $MN_AXCONF_MACHAX_NAME_TAB[0]="U1"
N10000 $MN_AXCONF_MACHAX_NAME_TAB[1]="B1"
N10050 $MN_SYSCLOCK_CYCLE_TIME=0.002
N10060 $MN_POSCTRL_SYSCLOCK_TIME_RATIO=1
N1000 $MD_CURRCTRL_CYCLE_TIME=4
N32200 $MA_POSCTRL_GAIN[0,AX1]=3 '
N32200 $MA_POSCTRL_GAIN[0,AX2]=1.5
N32300 $MA_MAX_AX_ACCEL[AX2]=0.83
N34000 $MA_REFP_CAM_IS_ACTIVE[AX1]=1
"""
DIP = (ROOT / "examples" / "measured_surface" / "dip.toml").read_text(encoding="utf-8").replace("zone_um = 20", "zone_um = 100")
DIP_MOVE = "time [s],X.setpoint [mm]\n" + "".join(
    f"{i * 4e-3:.3f},{-6.0 + 12.0 * (1 - np.cos(np.pi * i / 100)) / 2:.6f}\n" for i in range(101)
)


def _heights() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u [m], v [m] and heights (row, column) [m] of a shallow dip."""
    u, v = np.linspace(-6.5e-3, 6.5e-3, 66), np.linspace(-0.6e-3, 0.6e-3, 9)
    return u, v, -5e-6 * np.exp(-((u[None, :] / 2e-3) ** 2)) + 0.0 * v[:, None]


def _height_csv() -> bytes:
    u, v, z = _heights()
    rows = [f"{a * 1e3:.4f},{b * 1e3:.4f},{z[j, i] * 1e6:.4f}" for j, b in enumerate(v) for i, a in enumerate(u)]
    return "\n".join(["u [mm],v [mm],deviation [um]", *rows, ""]).encode()


def _height_npz() -> bytes:
    u, v, z = _heights()
    np.savez(out := io.BytesIO(), u=u, v=v, height=z)
    return out.getvalue()


def _height_sur() -> bytes:
    from examples.measured_surface.sur_writer import write_sur

    u, v, z = _heights()
    with tempfile.TemporaryDirectory() as folder:
        write_sur(Path(folder) / "m.sur", u[1] - u[0], v[1] - v[0], z)
        return (Path(folder) / "m.sur").read_bytes()


def _height_x3p() -> bytes:
    u, v, z = _heights()
    axes = "".join(
        f"<{n}><AxisType>{kind}</AxisType><DataType>D</DataType><Increment>{step:g}</Increment></{n}>"
        for n, kind, step in (("CX", "I", u[1] - u[0]), ("CY", "I", v[1] - v[0]), ("CZ", "A", 1.0))
    )
    size = f"<MatrixDimension><SizeX>{len(u)}</SizeX><SizeY>{len(v)}</SizeY><SizeZ>1</SizeZ></MatrixDimension>"
    with zipfile.ZipFile(out := io.BytesIO(), "w") as archive:
        archive.writestr("main.xml", f"<r>{axes}{size}<PointDataLink>bindata/data.bin</PointDataLink></r>")
        archive.writestr("bindata/data.bin", z.astype("<f8").tobytes())
    return out.getvalue()


def _parquet(columns: dict[str, Any]) -> bytes:
    """A Parquet file with these columns."""
    import pyarrow as pa
    import pyarrow.parquet

    sink = pa.BufferOutputStream()
    pyarrow.parquet.write_table(pa.table(columns), sink)
    return bytes(sink.getvalue())
