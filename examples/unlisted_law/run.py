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
import tomllib

import pyarrow.parquet as pq

from twin.cli import main as twin
from twin.exam.draw import SHIPPED_MACHINE, draw_case, write_campaign

SEED, EFFECT, AXIS = 7101, "windage", "Y"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/unlisted_law"), metavar="DIR", help="folder for campaign and diagnosis")
    parser.add_argument("--record-only", action="store_true", help="record the campaign and stop")
    args = parser.parse_args()
    out = args.out
    campaign = out / "campaign"
    sheet = tomllib.loads(SHIPPED_MACHINE.read_text(encoding="utf-8"))
    case = draw_case(SEED, "outside", sheet, effect=EFFECT, axis=AXIS, run_set="short")
    print("recording on the second plant, which is compiled first", flush=True)
    write_campaign(case, campaign, sheet, runs="short")
    for file in campaign.glob("*.parquet"):
        table = pq.read_table(file)
        pq.write_table(table.select([c for c in table.column_names if c.startswith(("time", f"{AXIS}."))]), file)
    if args.record_only:
        return
    if code := twin(["diagnose", str(campaign), "--out", str(out / "diagnosis")]):
        sys.exit(code)
    document = json.loads((out / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    for law in document["laws"]:
        for known in law["looks_like"]:
            print(f"looks like: {known['name']}. {known['sentence']} To be sure, measure {known['to_be_sure']}.")
    print(f"the truth: {EFFECT} on {AXIS}, {case.effects[0]['drag']:.0f} N s2/m2 times the square of the speed")


if __name__ == "__main__":
    main()
