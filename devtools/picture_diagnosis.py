#!/usr/bin/env python3
"""Draws the pictures of docs/diagnosis.md: records and diagnoses a machine with two hidden effects and saves the figures of the report.

python devtools/picture_diagnosis.py [--seed 24] [--quick]
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import tempfile
import tomllib

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from twin.diagnose import diagnose  # noqa: E402
from twin.diagnose.output import summary_text  # noqa: E402
from twin.diagnose.report_contents import blocks_map, stretches  # noqa: E402
from twin.diagnose.report_figures import map_figure, stretch_figure, waterfall_figure  # noqa: E402
from twin.exam.draw import draw_case, write_campaign  # noqa: E402
from twin.exam.plant.parameters import Richness  # noqa: E402
from twin.machine.machine import default_machine_path, load_machine  # noqa: E402
from twin.recordings.campaign import read_campaign  # noqa: E402
from twin.report import save_png  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=24, help="seed of the drawn machine")
    parser.add_argument("--quick", action="store_true", help="a shorter search")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures", metavar="DIR")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    table = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    case = draw_case(args.seed, "pair", table, richness=Richness.small())
    machine = load_machine()
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(case, Path(folder) / "campaign", table, runs="all")
        diagnosis = diagnose(read_campaign(Path(folder) / "campaign", machine), machine, quick=args.quick)
    document = diagnosis.document()
    print(summary_text(document))
    for effect in case.effects:
        print(f"hidden: {effect}")

    save_png(waterfall_figure(diagnosis.waterfall), args.out / "diagnosis_waterfall.png")
    save_png(map_figure(*blocks_map(diagnosis, document)), args.out / "diagnosis_map.png")
    for stretch in stretches(diagnosis, document)[:1]:
        save_png(stretch_figure(diagnosis, stretch), args.out / "diagnosis_stretch.png")


if __name__ == "__main__":
    main()
