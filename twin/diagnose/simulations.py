"""Simulations for the diagnosis: axes of a measured run on variants of its machine, batched in the decoupled plant."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from twin.diagnose.tolerance import with_added
from twin.diagnose.view import RunView
from twin.effects import Setting, settings_of, with_effects
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.ballbar import Ballbar
from twin.simulation.decoupled_plant import DecoupledPlant
from twin.simulation.recorded_times import as_recorded, simulated_period
from twin.simulation.run import Run, SimulationJob, all_or_raise, simulate_each

Variant = Callable[[Machine], Machine]
"""Maps the machine of a run to another machine."""

Mapper = Callable[..., Iterable[Any]]
"""`map`, or that of a thread pool."""


class SimulationRequest(NamedTuple):
    """Axes of a run to simulate on a variant of the run's machine with added effects. Axes that push them are added."""

    view: RunView
    axes: Sequence[str]
    machine_of: Variant | None = None
    settings: Sequence[Setting] = ()
    noise_seed: int | None = None


def simulate_group(view: RunView, axes: Sequence[str], machine_of: Variant | None = None, *, noise_seed: int | None = None) -> Run:
    """Simulate one request, see `simulate_groups`. Raises TwinError if it cannot be simulated."""
    one: Run = all_or_raise(simulate_groups([SimulationRequest(view, axes, machine_of, noise_seed=noise_seed)]))[0]
    return one


def simulate_groups(
    requests: Sequence[SimulationRequest], mapper: Mapper = map, of: Callable[[int, Run], Any] = lambda i, run: run
) -> list[Any]:
    """Simulate each request in the decoupled plant at the sample times of its run, batched; the result or its error.

    `of` extracts the result from the index of the request and its run; `mapper` maps over batches.
    """
    jobs, bars, outcomes = [], [], {}
    for i, request in enumerate(requests):
        try:
            job, bar = _job_of(request)
        except TwinError as error:
            outcomes[i] = error
            continue
        jobs.append(job)
        bars.append((i, bar))

    def recorded(at: int, run: Run) -> Any:
        (i, bar), request = bars[at], requests[bars[at][0]]
        times = request.view.trace.time
        quiet = as_recorded(run.without_noise, times, bar)
        trace = quiet if request.noise_seed is None else as_recorded(run.trace, times, bar, request.noise_seed)
        return of(i, replace(run, trace=trace, without_noise=quiet))

    for (i, _), outcome in zip(bars, simulate_each(jobs, mapper, recorded)):
        outcomes[i] = outcome
    return [outcomes[i] for i in range(len(requests))]


def _job_of(request: SimulationRequest) -> tuple[SimulationJob, Ballbar | None]:
    """The simulation job of a request, and the ballbar that measures it."""
    view, machine = request.view, request.view.machine if request.machine_of is None else request.machine_of(request.view.machine)
    changed = with_added(machine, request.settings)
    hidden = settings_of(changed)
    rotary = [axis.name for axis in machine.axes if axis.kind == "rotary"]
    # a mass clamped on the table acts on every rotary axis
    clamped = any(s.effect.edits_bodies for s in hidden) and any(name in rotary for name in request.axes)
    needed = {*request.axes, *(rotary if clamped else ())}
    bar = view.ballbar if view.ballbar is not None and needed.intersection(view.ballbar.axes) else None
    if bar is not None:
        needed.update(bar.axes)
    while pushing := {s.from_axis for s in hidden if s.from_axis and s.axis in needed} - needed:
        needed |= pushing
    driven = [name for name in machine.axis_names if name in needed]
    index = [machine.axis_names.index(name) for name in driven]
    part = with_effects(changed.with_axes(driven), [s for s in hidden if s.axis in driven])
    # gravity and inertia of a rotary axis depend on the positions of the others, simulated or not
    turning = any(axis.kind == "rotary" for axis in part.axes)
    carrying = [axis.name for axis in machine.axes if axis.name in driven or (turning and axis.kind == "rotary")]
    motion = view.motion.part(tuple(machine.axis_names.index(name) for name in carrying))
    job = SimulationJob(
        part,
        view.setpoints.part(tuple(index)),
        lambda change: DecoupledPlant(change, motion, machine.with_axes(carrying)),
        simulated_period(machine, view.trace.period, bar),
        view.started_at,
        request.noise_seed,
    )
    return job, bar
