"""Draws the pictures of docs/identify.md: a machine of the second plant, up to 30 % off its machine file, recorded and identified.

    python devtools/picture_identify.py [--seed 9000] [--keep out/drawn]

Writes docs/pictures/identify_*.png; with --keep the campaign is drawn there once (devtools/measure_identification.py shares the folder).
"""

from __future__ import annotations

import argparse
from pathlib import Path
import tempfile

from devtools.measure_identification import KNOWN, SPREAD, draw
from twin.identify import figures
from twin.identify.identify import identify
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign
from twin.report import save_png

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for drawn campaigns")
    args = parser.parse_args()
    machine = load_machine().with_values({"parameter_tolerance": SPREAD})
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.keep / str(args.seed) if args.keep else Path(scratch)
        draw(args.seed, folder)
        result = identify(read_campaign(folder, machine), machine, torque_constant_tolerance=KNOWN, progress=print)
    for name, figure in (
        ("friction", figures.friction_figure(result)),
        ("table", figures.gravity_figure(result)),
        ("gap", figures.gap_figure(result)),
    ):
        if figure is not None:
            save_png(figure, PICTURES / f"identify_{name}.png", 90)


if __name__ == "__main__":
    main()
