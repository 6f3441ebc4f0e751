"""Diagnose an unlisted law: record a machine of the second plant with such a law and diagnose it.

    python examples/unlisted_law/run.py [--out out/unlisted_law]

The second plant shares no code with the twin. Its Y axis has a drag proportional to the square of the speed (churning grease), which no
effect of the library describes. Only the Y axis is recorded. The example prints the truth at the end; the diagnosis does not read it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys

import pyarrow.parquet as pq

from twin.cli import main as twin
from twin.exam.draw import main as draw

SEED, EFFECT, AXIS = "7101", "windage", "Y"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/unlisted_law"), metavar="DIR", help="folder for campaign and diagnosis")
    out = parser.parse_args().out
    campaign, truth = out / "campaign", out / "truth.toml"
    words = [
        "--seed",
        SEED,
        "--kind",
        "outside",
        "--effect",
        EFFECT,
        "--axis",
        AXIS,
        "--runs",
        "short",
        "--out",
        str(campaign),
        "--truth",
        str(truth),
    ]
    if code := draw(words):
        sys.exit(code)
    for file in campaign.glob("*.parquet"):
        table = pq.read_table(file)
        pq.write_table(table.select([c for c in table.column_names if c.startswith(("time", f"{AXIS}."))]), file)
    if code := twin(["diagnose", str(campaign), "--out", str(out / "diagnosis")]):
        sys.exit(code)
    document = json.loads((out / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    for law in document["laws"]:
        for known in law["looks_like"]:
            print(f"looks like: {known['name']}. {known['sentence']} To be sure, measure {known['to_be_sure']}.")
    print(
        "\nthe truth:", *[line for line in truth.read_text(encoding="utf-8").split("[[outside]]")[1].splitlines()[1:5] if line], sep="\n  "
    )


if __name__ == "__main__":
    main()
