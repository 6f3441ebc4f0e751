"""Speed of the twin: the compiled loop against bare `mj_step`, real time and a plain Python loop.

Loop and engine alternate in blocks of a tenth of a second or less, and medians are compared, to cancel other loads on the computer.
The loop's time is that of the whole `simulate`: set points, control, engine, recording.

    scripts/benchmark                         the figures, once
    scripts/benchmark --runs 5 --page README.md    median and spread of five runs into README, with day, computer and load; minutes, on an idle computer
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import date
import json
import os
from pathlib import Path
import platform
import statistics
import subprocess
import sys
import tempfile
from time import perf_counter

import mujoco
from numba import njit
import numpy as np
import psutil

from devtools.pages import put_between
from tests.reference.cascade_reference import ReferenceSimulation
from twin.machine.machine import Machine, load_machine
from twin.simulation.engine_calls import call_address_2, engine_function_address
from twin.simulation.plant_spec import Plant, build_plant
from twin.simulation.prepared import STRETCH_TICKS
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PYTHON_TICKS = 1_600
ENGINE_BLOCK_TICKS = 1_600
"""The bare engine restarts from the moving state after this many ticks, so that no axis comes to rest."""


@dataclass(frozen=True)
class Speed:
    """Results; startup times are those of `twin run` on a short trace, from process start to exit (nan: not measured)."""

    loop_over_engine: float
    realtime_factor: float
    python_loop_over_engine: float
    engine_us_per_step: float
    loop_us_per_step: float
    counting_over_engine: float
    startup_cold_s: float = float("nan")
    startup_warm_s: float = float("nan")


@njit(cache=True, nogil=True)
def _bare_steps(step, model, data, count):  # type: ignore[no-untyped-def]
    for _ in range(count):
        call_address_2(step, model, data)


class BareEngine:
    """The machine's compiled model with all axes at steady speed, advanced by `mj_step` alone."""

    def __init__(self, machine: Machine, velocity: np.ndarray) -> None:
        self.plant: Plant = build_plant(machine)
        self.coulomb = np.array([axis.coulomb_friction for axis in machine.axes])
        model, data = self.plant.model, self.plant.data
        data.qvel[self.plant.load_dof] = velocity
        mujoco.mj_forward(model, data)
        ratio = np.array([axis.ratio for axis in machine.axes])
        # the motors balance gravity and friction, so that the speed stays constant
        friction = np.sign(velocity) * self.coulomb - data.qfrc_passive[self.plant.load_dof]
        data.ctrl[self.plant.actuator] = (data.qfrc_bias[self.plant.load_dof] + friction) * ratio
        self.start = mujoco.MjData(model)
        mujoco.mj_copyData(self.start, model, data)
        self.step = engine_function_address("mj_step")
        self.seconds(100)

    def seconds(self, ticks: int) -> float:
        """Time of this many steps, without resetting the state."""
        spent = 0.0
        for done in range(0, ticks, ENGINE_BLOCK_TICKS):
            mujoco.mj_copyData(self.plant.data, self.plant.model, self.start)
            begin = perf_counter()
            _bare_steps(self.step, self.plant.model._address, self.plant.data._address, min(ENGINE_BLOCK_TICKS, ticks - done))
            spent += perf_counter() - begin
        return spent


def moving_setpoints(machine: Machine, seconds: float, period: float = 1e-3) -> Setpoints:
    """All axes oscillate from rest, each at its own frequency."""
    t = np.arange(round(seconds / period) + 1) * period
    # amplitude and frequency: at most 6 m/min, 20 degrees a second
    swing = {"linear": 0.04, "rotary": 0.3}
    columns = []
    for a, axis in enumerate(machine.axes):
        omega = 2.0 * np.pi * (0.3 + 0.02 * a)
        middle = float(np.clip(0.0, axis.travel[0] + swing[axis.kind], axis.travel[1] - swing[axis.kind]))
        ease = np.minimum(t, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(t, 1.0))
        columns.append(middle + swing[axis.kind] * ease * np.sin(omega * t))
    return Setpoints(np.column_stack(columns), period)


def in_turns(machine: Machine, setpoints: Setpoints, engine: BareEngine, count_load: bool = False) -> tuple[list[float], list[float]]:
    """Seconds (stretch,) of the loop for STRETCH_TICKS ticks, and of the bare engine for as many steps right after."""
    simulate(machine, Setpoints(setpoints.position[:50], setpoints.period))  # compile first
    loop_times: list[float] = []
    engine_times: list[float] = []
    begin = perf_counter()

    def turn(_done: float) -> None:
        nonlocal begin
        loop_times.append(perf_counter() - begin)
        engine_times.append(engine.seconds(STRETCH_TICKS))
        begin = perf_counter()

    simulate(machine, setpoints, count_load=count_load, progress=turn)
    return loop_times[1:-1], engine_times[1:-1]  # the first stretch builds the model, the last one is shorter


def measure(machine: Machine | None = None, seconds: float = 60.0) -> Speed:
    """Compare loop, engine and Python loop on `seconds` of machine time."""
    machine = machine or load_machine()
    setpoints = moving_setpoints(machine, seconds)
    engine = BareEngine(machine, np.array([0.05 if axis.kind == "linear" else 0.2 for axis in machine.axes]))
    loop_times, engine_times = in_turns(machine, setpoints, engine)
    loop_us = statistics.median(loop_times) / STRETCH_TICKS * 1e6
    engine_us = statistics.median(engine_times) / STRETCH_TICKS * 1e6

    counting = [a / b for a, b in zip(*in_turns(machine, setpoints, engine, count_load=True))]
    # the same law as a Python loop, also in turns
    reference = ReferenceSimulation(machine, Setpoints(setpoints.position, setpoints.period), 10 * PYTHON_TICKS)
    python_ratios = []
    for block in range(10):
        begin = perf_counter()
        reference.run(block * PYTHON_TICKS, PYTHON_TICKS)
        python_ratios.append((perf_counter() - begin) / engine.seconds(PYTHON_TICKS))
    return Speed(
        loop_over_engine=statistics.median(a / b for a, b in zip(loop_times, engine_times)),
        realtime_factor=machine.base_tick / (loop_us * 1e-6),
        python_loop_over_engine=statistics.median(python_ratios),
        engine_us_per_step=engine_us,
        loop_us_per_step=loop_us,
        counting_over_engine=statistics.median(counting),
    )


def startup_seconds() -> tuple[float, float]:
    """Duration of `twin run` on a short trace [s]: with an empty and with a filled cache of compiled functions."""
    from twin.cli.demo import paper_test
    from twin.recordings.trace import write_trace

    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "x_200mm.csv"
        write_trace(paper_test(load_machine()), source)
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(folder) / "numba")}
        times = []
        for _ in range(3):
            begin = perf_counter()
            command = [sys.executable, "-m", "twin", "run", str(source), "--out", str(Path(folder) / "out")]
            subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
            times.append(perf_counter() - begin)
    return times[0], min(times[1:])


TEXTS = {
    "loop_over_engine": "the whole loop, relative to the same number of bare `mj_step` calls",
    "counting_over_engine": "the same with drive loads counted, as in studies",
    "python_loop_over_engine": "the same law as a Python loop, relative to bare `mj_step`",
    "realtime_factor": "times real time",
    "engine_us_per_step": "bare `mj_step` [us]",
    "loop_us_per_step": "the whole loop, a step [us]",
    "startup_cold_s": "first short `twin run`, nothing compiled yet [s]",
    "startup_warm_s": "the next one [s]",
}


def page_text(runs: Sequence[dict[str, float]], load: float) -> str:
    """The figures as a table in Markdown (median, smallest and largest), below the day, the computer and its load before the first run."""
    cpuinfo = Path("/proc/cpuinfo")
    names = (
        [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        if cpuinfo.is_file()
        else []
    )
    computer = f"{names[0] if names else platform.processor() or platform.machine()}, {os.cpu_count()} cores, load average {load:.1f}"
    lines = [
        f"{date.today()}, {computer}, Python {platform.python_version()}, MuJoCo {mujoco.__version__}: median of {len(runs)} (smallest to largest).",
        "\n| | |\n|---|---|",
    ]
    for key in runs[0]:
        values = [run[key] for run in runs]
        lines.append(f"| {TEXTS[key]} | {statistics.median(values):.3g} ({min(values):.3g} to {max(values):.3g}) |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="scripts/benchmark", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="machine time to simulate (default: 60, at least 8)")
    parser.add_argument("--no-startup", action="store_true", help="do not measure the start-up times")
    parser.add_argument("--runs", type=int, default=1, metavar="N", help="measure so often (default: 1)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table into this page, between its marks `benchmark`")
    args = parser.parse_args(arguments)
    load = psutil.getloadavg()[0]
    runs = []
    for _ in range(max(args.runs, 1)):
        found = asdict(measure(seconds=max(args.seconds, 8.0)))
        if not args.no_startup:
            found["startup_cold_s"], found["startup_warm_s"] = startup_seconds()
        runs.append({key: round(found[key], 4) for key in TEXTS if found[key] == found[key]})
    if args.page:
        put_between(args.page, "benchmark", page_text(runs, load))
    for run in runs:
        print(json.dumps(run) if args.json else "\n".join(f"{value:8.2f}  {TEXTS[key]}" for key, value in run.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
