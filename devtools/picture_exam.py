#!/usr/bin/env python3
"""Draws the pictures of docs/results.md from an examination: the score against its targets, and beside three simpler methods.

python devtools/picture_exam.py DIR      the folder that `twin exam --out DIR` wrote
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from twin.exam.report import sections_of  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("exam", type=Path, metavar="DIR", help="folder of an examination that has been opened")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures", metavar="DIR")
    args = parser.parse_args()
    score, beside, *_ = sections_of(json.loads((args.exam / "exam.json").read_text(encoding="utf-8")))
    for name, section in (("exam_score", score), ("exam_methods", beside)):
        (args.out / f"{name}.svg").write_text(section.figures[0].svg, encoding="utf-8")
        print(args.out / f"{name}.svg")


if __name__ == "__main__":
    main()
