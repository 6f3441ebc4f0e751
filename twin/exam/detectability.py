"""Detectability: the effects that a campaign can show, and the smallest size of each, given its runs, signals and noise. No truth is needed.

The twin simulates how each effect of usual size changes the signals of this campaign: the response d, in multiples of noise and with
the toleranced parameters projected out. Its log likelihood against noise is s = |d|^2 / 2. Against the nearest rival, whose size is
free, the rival's response is projected out of d as well. To first order s grows with the square of the size:

    smallest size found           = usual size * sqrt(evidence / s)
    smallest size separated       = usual size * sqrt(evidence / s_rival)
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import math
from pathlib import Path

import numpy as np

from twin.diagnose.axis_groups import axis_groups
from twin.diagnose.columns import Columns
from twin.diagnose.fit import simulated_response
from twin.diagnose.next_measurement import KINDS, move_of
from twin.diagnose.observe import Group, observe
from twin.diagnose.screen import eliminated
from twin.diagnose.settings import T
from twin.diagnose.simulations import Mapper
from twin.diagnose.starts import Start, middle_starts, starts_of
from twin.diagnose.tuning import tuning_of
from twin.diagnose.view import view_of
from twin.errors import TwinError
from twin.files import output_folder, write_json
from twin.machine.machine import Machine, load_machine
from twin.progress import Progress
from twin.recordings.campaign import Campaign, MeasuredRun, read_campaign
from twin.recordings.trace import Trace
from twin.report import Section, Table, write_page
from twin.simulation.recorded_noise import with_recorded_noise
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of
from twin.simulation.summary import table
from twin.system import cores
from twin.units import in_words

CHANNEL_SETS: dict[str, tuple[str, tuple[str, ...]]] = {
    "as recorded": ("scale", ("controller", "motor_minus_scale", "position", "velocity", "current")),
    "without speed set point": ("scale", ("motor_minus_scale", "position", "velocity", "current")),
    "scale and current": ("scale", ("position", "current")),
    "motor encoder and current": ("motor", ("position", "velocity", "current")),
    "motor encoder alone": ("motor", ("position", "velocity")),
    "no scale at all, with current": ("indirect", ("position", "velocity", "current")),
    "no scale at all": ("indirect", ("position", "velocity")),
}
"""Variant -> recorded position and compared channels. Recorded is the scale; or only the motor encoder while the position loop is
closed on the scale (`motor`); or the motor encoder of a machine without scales, which closes the position loop (`indirect`)."""

USELESS = 1.0
"""Above this multiple of its usual size an effect counts as invisible."""

Key = tuple[str, str, str | None]


@dataclass(frozen=True)
class Outlook:
    """One effect on one axis: smallest size found and separated (multiples of the usual size), and the nearest rival."""

    effect: str
    axis: str
    found: float
    apart: float
    rival: str


@dataclass(frozen=True)
class Answers:
    """Inner products of the responses to toleranced parameters and effects in some runs, by channel. They add up over runs.

    What each run has for itself, the zeros of its encoders, is eliminated from them.
    """

    nuisances: int
    places: dict[Key, slice]  # columns of each effect on each axis
    products: dict[str, np.ndarray]  # channel -> (column, column)

    def over(self, channels: Sequence[str]) -> np.ndarray:
        """Products summed over channels (column, column)."""
        nothing = np.zeros_like(next(iter(self.products.values())))
        return sum((p for name, p in self.products.items() if name in channels), nothing)


def answers_of(group: Group, starts: Mapping[Key, Start], mapper: Mapper) -> Answers:
    """Simulate the response to every toleranced parameter and every start on the runs of a group."""
    tuning = tuning_of(replace(group, mapper=mapper))
    simulated = mapper(lambda start: _columns(group, start), starts.values())
    at = len(tuning.nuisances)
    everything = [tuning.of_nuisances]
    places: dict[Key, slice] = {}
    for key, columns in zip(starts, simulated):
        places[key] = slice(at, at + len(columns))
        at += len(columns)
        everything.append(Columns(columns, group.size))
    matrix = Columns([], group.size).beside(*everything, tuning.others)
    products: dict[str, np.ndarray] = {}
    for channel in group.channels:
        rows = matrix.part(channel.rows)
        products[channel.name] = products.get(channel.name, 0.0) + rows.T @ rows
    zeros = np.arange(at, len(matrix))  # encoder zeros belong to these runs alone
    return Answers(len(tuning.nuisances), places, {name: eliminated(p, zeros, tuning.further)[:at, :at] for name, p in products.items()})


def _columns(group: Group, start: Start) -> list[np.ndarray]:
    """The response to each setting of a start; none where the twin cannot run one of them."""
    try:
        return [simulated_response(group, [s]).astype(np.float32) for s in start.settings]
    except TwinError:
        return [np.zeros(group.size, np.float32)] * len(start.settings)


def outlooks(products: np.ndarray, like: Answers) -> list[Outlook]:
    """Outlook of every effect on every axis, from summed products (column, column) after projecting out re-tuning."""
    k = like.nuisances
    free = eliminated(products, np.arange(k), np.full(k, T.prior_weight)) if k else products
    out = []
    for key, mine in like.places.items():
        rivals = {other: _apart(free, mine, theirs) for other, theirs in like.places.items() if other != key and free[theirs, theirs].any()}
        nearest = min(rivals, key=lambda r: rivals[r]) if rivals else None
        alone = _apart(free, mine, slice(0, 0))
        apart = rivals[nearest] if nearest else alone
        out.append(Outlook(_title(key), key[1], _smallest(alone), _smallest(apart), f"{_title(nearest)} {nearest[1]}" if nearest else ""))
    return out


def _apart(free: np.ndarray, mine: slice, theirs: slice) -> float:
    """Half the smallest residual square after fitting a rival of free size; for an effect of unknown phase, of the weaker column."""
    inner, cross = free[theirs, theirs], free[theirs, mine]
    left = free[mine, mine] - cross.T @ np.linalg.pinv(inner, rcond=1e-9, hermitian=True) @ cross if inner.size else free[mine, mine]
    return max(0.5 * float(np.diag(left).min()), 0.0)


def _title(key: Key) -> str:
    return key[0] + (f" from {key[2]}" if key[2] else "")


def _smallest(square: float) -> float:
    return math.sqrt(T.evidence / square) if square > 1e-9 else math.inf


def without_scale(run: MeasuredRun) -> MeasuredRun:
    """The run without recorded scales; the position loop stays closed on them."""
    return replace(run, trace=replace(run.trace, signals={k: v for k, v in run.trace.signals.items() if k[1] != "position"}))


def added_run(machine: Machine, kind: str, axes: Sequence[str], like: MeasuredRun) -> MeasuredRun:
    """A proposed move of these axes as the twin would record it, with noise and the signals of the run `like`."""
    trace = move_of(kind, [machine.axis(a) for a in axes])
    simulated = simulate(
        machine.with_feedforward(like.feedforward), setpoints_of(trace, machine), sample_period=trace.period, noise_seed=1
    ).trace
    signals = {s for _, s in like.trace.signals}
    kept = {(a, s): v[: len(trace.time)] for (a, s), v in simulated.signals.items() if s in signals and a in axes}
    kept |= {(a, "setpoint"): trace.get(a, "setpoint") for a in axes}
    return MeasuredRun(kind, Trace(trace.time, kept, {a: machine.kinds[a] for a in axes}), like.feedforward, like.started_at)


def detectability_of(campaign: Campaign, machine: Machine, say: Callable[[str], None]) -> dict[str, list[Outlook]]:
    """Outlooks by variant of the campaign: as recorded, with fewer signals, and with each further run."""
    axes = sorted({a for run in campaign.runs for a in run.trace.axes}, key=machine.axis_names.index)
    motor = all(run.trace.has(a, "motor_position") for run in campaign.runs for a in run.trace.axes)
    names = [n for n, (seen, _) in CHANNEL_SETS.items() if seen == "scale" or motor] + [f"and {kind}" for kind in KINDS]
    out: dict[str, list[Outlook]] = {name: [] for name in names}
    indirect = machine  # every position loop is closed on the motor encoder
    for axis in machine.axis_names:
        indirect = indirect.with_axis(axis, encoder="motor")
    with ThreadPoolExecutor(max_workers=cores()) as pool:
        mapper = pool.map

        def answers(runs: Sequence[MeasuredRun], group_axes: tuple[str, ...], actual: Machine, starts: Mapping[Key, Start]) -> Answers:
            return answers_of(observe([view_of(actual, run) for run in runs], group_axes), starts, mapper)

        further = {kind: added_run(machine, kind, axes, campaign.runs[0]) for kind in KINDS}
        for group_axes in axis_groups(machine, axes):
            group = observe([view_of(machine, run) for run in campaign.runs], group_axes)
            if not group.size:
                continue
            say(f"{'+'.join(group_axes)}: as recorded")
            starts = middle_starts(starts_of(group, np.zeros(group.size)))
            own = answers_of(group, starts, mapper)
            seen = {"scale": own}
            if motor:
                say(f"{'+'.join(group_axes)}: motor encoder")
                blind = [without_scale(run) for run in campaign.runs]
                seen["motor"] = answers(blind, group_axes, machine, starts)
                seen["indirect"] = answers(blind, group_axes, indirect, starts)
            for name, (position, channels) in CHANNEL_SETS.items():
                if position in seen:
                    out[name] += outlooks(seen[position].over(channels), seen[position])
            for kind, run in further.items():
                say(f"{'+'.join(group_axes)}: with {kind}")
                extra = answers([run], group_axes, machine, starts)
                everything = CHANNEL_SETS["as recorded"][1]
                out[f"and {kind}"] += outlooks(own.over(everything) + extra.over(everything), own)
    return out


def detectability_command(args: argparse.Namespace) -> int:
    """`twin exam --plan CAMPAIGN --out DIR`: print the tables, write plan.json and report.html."""
    machine = load_machine(args.machine)
    campaign = read_campaign(args.plan, machine)
    machine, _ = with_recorded_noise(machine, campaign.runs)
    with Progress("detectability", total=None) as bar:
        outlooks_of = detectability_of(campaign, machine, bar.say)
    out = output_folder(args.out)
    write_json({name: [vars(o) for o in rows] for name, rows in outlooks_of.items()}, out / "plan.json", "detectability")
    write_plan_report(campaign, outlooks_of, out / "report.html")
    for one in (effects_table(outlooks_of["as recorded"]), campaigns_table(outlooks_of)):
        print(f"{one.caption}\n{table(one.heading, one.rows, left=one.left)}\n".lstrip())
    print(f"written to {out}: plan.json, report.html")
    return 0


def effects_table(rows: Sequence[Outlook]) -> Table:
    """The smallest sizes of every effect, and its nearest rival."""
    lines = [[in_words(o.effect), o.axis, size_text(o.found), size_text(o.apart), in_words(o.rival)] for o in rows]
    caption = "The smallest size that is found, and that is separated from its nearest rival, in shares of the usual size of each effect."
    return Table(["effect", "axis", "found at", "separated at", "nearest rival"], lines, left=2, words=frozenset({4}), caption=caption)


def campaigns_table(outlooks_of: Mapping[str, Sequence[Outlook]]) -> Table:
    """How many effects of usual size each variant of the campaign finds and separates, and which it does not."""
    lines = []
    for name, rows in outlooks_of.items():
        lost = sorted({in_words(o.effect) for o in rows if o.apart > USELESS})
        found, apart = sum(o.found <= USELESS for o in rows), sum(o.apart <= USELESS for o in rows)
        lines.append([name, f"{found} of {len(rows)}", f"{apart} of {len(rows)}", ", ".join(lost[:6]) + (" ..." if len(lost) > 6 else "")])
    return Table(["campaign", "found", "separated", "invisible or not separated at usual size"], lines, left=1)


def size_text(share: float) -> str:
    """A multiple of the usual size in words."""
    if share >= 1.0:
        return f"{share:.2g} x usual" if share <= 100.0 else "not at all"
    return f"{100 * share:.2g} %" if share >= 0.01 else "below 1 %"


def write_plan_report(campaign: Campaign, outlooks_of: Mapping[str, Sequence[Outlook]], path: Path) -> None:
    """Write the report page."""
    own = outlooks_of["as recorded"]
    apart = sum(o.apart <= USELESS for o in own)
    helps = max(
        (n for n in outlooks_of if n.startswith("and ")), key=lambda n: sum(math.log(1 + 1 / o.apart) for o in outlooks_of[n]), default=""
    )
    lead = f"Of {len(own)} effects of usual size this campaign finds and separates {apart}. " + (
        f"The further run that would help most: {helps[4:]}." if helps else ""
    )
    sections = [
        Section("Smallest visible sizes", tables=[effects_table(own)]),
        Section("Other sensors, further runs", tables=[campaigns_table(outlooks_of)]),
    ]
    write_page(path, f"What {campaign.path.name} can show", lead, sections)
