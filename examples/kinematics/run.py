"""Four machines of other structures than the Mikron: table-table, head-table, head-head, and a three-axis mill with names of its own.

Each gets the Mikron's drives under its own axis names, is written as a machine file with its model, and interpolates one program with the
letters of its controls: `python examples/kinematics/run.py [--out DIR]`.
"""

import argparse
from dataclasses import replace
from pathlib import Path
import tempfile

import numpy as np

from twin.geometry.kinematics import kinematics_of
from twin.machine.machine import Machine, load_machine, write_machine
from twin.program import interpolate, read_program

HERE = Path(__file__).parent
STRUCTURES: dict[str, tuple[dict[str, str], dict[str, str]]] = {
    "table_table": ({"X": "X", "Y": "Y", "Z": "Z", "B": "A", "C": "C"}, {}),
    "head_table": ({"X": "X", "Y": "Y", "Z": "Z", "B": "A", "C": "C"}, {}),
    "head_head": ({"X": "X", "Y": "Y", "Z": "Z", "SWIVEL": "A", "ROTATION": "C"}, {"A": "SWIVEL", "C": "ROTATION"}),
    "three_axis": ({"LEFT_RIGHT": "X", "LENGTH": "Y", "LIFT": "Z"}, {}),
}
"""Axis of the machine -> axis of the Mikron whose drive it gets; letters of programs where the names do not say them."""
FIVE_AXIS = """G17 G54 G90
TRAORI
G0 X0 Y0 Z150 A3=0 B3=0 C3=1
G1 X5 Y3 Z148 A3=0.05 B3=0.02 C3=1 F3000
X20 Y8 Z147 A3=0.2 B3=-0.1 C3=1
X25 Y-5 Z149 A3=0.3 B3=0.15 C3=1
TRAFOOF
{tilt}=5 {turn}=20 F2000
M30
"""
THREE_AXIS = "G17 G54 G90\nG0 X0 Y0 Z20\nG1 X30 Y10 F3000\nG2 X40 Y20 CR=10\nG1 Z10\nM30\n"


def machine_of(name: str, base: Machine | None = None) -> Machine:
    """The machine of a structure with the drives of the Mikron (or of `base`, which has X Y Z A C)."""
    base = base or load_machine()
    axes, letters = STRUCTURES[name]
    document = {key: value for key, value in base.document.items() if key not in ("body", "geometry", "axis_order", "driven_axes")}
    document |= {"name": name, "structure": name, "model": f"{name}.xml", "axis_order": list(axes)}
    document["axis"] = {new: dict(base.document["axis"][old]) for new, old in axes.items()}
    for new, old in axes.items():
        if old == "A":
            document["axis"][new]["travel_deg"] = [-110.0, 110.0]
    if letters:
        document["program"] = {"axes": letters}
    return replace(base, document=document, model_path=HERE / f"{name}.xml", path=None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=None)
    folder = parser.parse_args().out or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    for name in STRUCTURES:
        write_machine(machine_of(name), folder / f"{name}.toml")
        machine = load_machine(folder / f"{name}.toml")
        kinematics = kinematics_of(machine)
        tilt, turn = kinematics.letters[3:]
        program = folder / f"{name}.mpf"
        program.write_text(THREE_AXIS if name == "three_axis" else FIVE_AXIS.format(tilt=tilt, turn=turn))
        trace = interpolate(read_program(program, machine), machine)
        q = np.column_stack([trace.get(axis, "setpoint") if axis else np.zeros(len(trace.time)) for axis in kinematics.names])
        tip, direction = kinematics.forward(q)
        back = kinematics.linear_axes(tip, q[:, 3:])
        print(
            f"{name:12s} letters {' '.join(kinematics.letters[: 3 if name == 'three_axis' else 5])}: {trace.time[-1]:.2f} s, "
            f"tool tilts to {np.degrees(np.arccos(np.clip(direction[:, 2], -1, 1))).max():.1f} deg, "
            f"forward and back {np.abs(back - q[:, :3]).max():.1e} m"
        )


if __name__ == "__main__":
    main()
