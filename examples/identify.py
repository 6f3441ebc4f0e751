"""Does a planned campaign find a machine's parameters? A campaign is planned, recorded on a machine 10 % off, identified, and compared.

    python examples/identify.py [--axes X] [--seed 1] [--out out/identify]

The recorded machine is the examination's plant, which shares no law with the twin: elastic drive trains, pre-sliding, cogging and
Stribeck friction, measuring noise and rounding. Its torque constants are known, everything else is up to 10 % off the machine file.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.exam.draw import SIGNALS, Case, columns_of, draw_case, simulate
from twin.exam.plant.parameters import AXES
from twin.exam.programme import TestRun
from twin.identify.identify import identify
from twin.identify.plan import Plan, plan_campaign, write_plan
from twin.identify.report import write_report
from twin.identify.write import write_identified
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign
from twin.simulation.summary import table

OFF = 0.1


def hidden_machine(seed: int, document: dict) -> Case:
    """A machine of the second plant, everything but its torque constants up to OFF away from the machine file."""
    case = draw_case(seed, "healthy", document, spread=OFF)
    factors = {name: {k: 1.0 if k == "torque_constant" else f for k, f in values.items()} for name, values in case.factors.items()}
    return replace(case, factors=factors)


def record(case: Case, plan: Plan, axes: str, folder: Path, document: dict) -> None:
    """Run the plan on the hidden machine; the columns of the planned axes go where the plan's campaign.toml expects them."""
    for run in plan.runs:
        points = np.zeros((len(run.setpoints.position), len(AXES)))
        points[:, [AXES.index(a) for a in axes]] = run.setpoints.position
        columns = columns_of(simulate(case, document, TestRun(run.name, "test", run.feedforward, points)), SIGNALS["full"])
        seen = {name: values for name, values in columns.items() if name.startswith("time") or name[0] in axes}
        pq.write_table(pa.table(seen), folder / f"{run.name}.parquet")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--axes", default="X", help="axes to plan for, e.g. XYZ or XYZAC")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--precision", type=float, default=0.05, help="wanted half interval of each parameter")
    parser.add_argument("--out", type=Path, default=Path("out/identify"), metavar="DIR")
    args = parser.parse_args()
    document = tomllib.loads(default_machine_path().read_text(encoding="utf-8"))
    machine = load_machine().with_axes(list(args.axes)).with_values({"parameter_tolerance": OFF})

    plan = plan_campaign(machine, args.precision)
    write_plan(plan, machine, args.out)
    case = hidden_machine(args.seed, document)
    record(case, plan, args.axes, args.out / "recordings", document)

    campaign = read_campaign(args.out / "recordings", machine)
    result = identify(campaign, machine, refine=False, torque_constant_tolerance=0.0)
    write_identified(result, args.out / "machine.toml")
    files = write_report(result, args.out / "machine.html")

    rows = []
    for p in plan.predicted:
        found = result.parameter(p.axis, p.name).value
        key = {"coulomb_friction": "coulomb_friction", "viscous_friction": "viscous_friction"}.get(p.name)
        true = f"{p.value * case.factors[p.axis][key]:.6g}" if key else ""
        achieved = f"+- {100 * found.half / abs(found.value):.2g} %"
        rows.append([p.axis, p.name, f"{p.value:.6g}", f"{found.value:.6g}", true, f"+- {100 * p.half:.2g} %", achieved])
    print(table(["axis", "parameter", "machine file", "identified", "true", "planned", "achieved"], rows, left=2))
    print(f"report: {files[0]}; identified machine: {args.out / 'machine.toml'}")


if __name__ == "__main__":
    main()
