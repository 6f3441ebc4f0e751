"""Check that a campaign belongs to the machine, and which conclusions its missing signals rule out."""

import math

import numpy as np

from twin.diagnose.settings import T
from twin.errors import InputError
from twin.machine.commented import guessed_values
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import Campaign
from twin.recordings.profile_speed import PROFILE
from twin.recordings.roughness import SECOND_DIFFERENCE, quiet_noise
from twin.recordings.trace import Trace
from twin.simulation.drive_setpoints import closed_on
from twin.simulation.gap import check_compared
from twin.simulation.setpoints import check_travel, setpoints_of
from twin.simulation.summary import listed
from twin.units import in_words


def check_campaign(campaign: Campaign, machine: Machine) -> None:
    """Refuse campaigns of another machine (set points outside the travel, motion that does not follow them), without signals or without motion."""
    check_compared(campaign, machine)
    if not any(run.trace.moves(axis) for run in campaign.runs for axis in run.trace.axes):
        raise InputError(f"{campaign.path}: no axis moves in any run; record runs that move the axes")
    guessed = guessed_controls(machine)
    for run in campaign.runs:
        check_travel(setpoints_of(run.trace, machine), machine, f"{campaign.path}: run {run.name}")
        for axis in run.trace.axes:
            _check_noise(run.trace, machine.axis(axis), f"{campaign.path}: run {run.name}: axis {axis}")
            closing = closed_on(run.trace, machine.axis(axis))  # the zero of the other encoder may be anywhere
            signal = next((s for s in (closing, "motor_position") if run.trace.has(axis, s)), None)
            if signal is None:
                continue
            setpoint, position = run.trace.get(axis, "setpoint"), run.trace.get(axis, signal)
            loops = machine.axis(axis).loops
            lag = loops.set_point_delay_s + 1.0 / loops.position_gain_per_s
            allowed = T.off_lag * lag * float(np.abs(np.gradient(setpoint, run.trace.period)).max()) + 1e-4
            largest = float(np.abs(setpoint - position).max())
            share = 1.0 if axis in guessed else T.off_set_point  # a guessed control does not say how far an axis stays behind
            if largest > max(allowed, share * float(np.ptp(setpoint))):
                raise InputError(
                    f"{campaign.path}: run {run.name}: axis {axis} is up to {largest * 1e3:.3g} {'mm' if machine.axis(axis).kind == 'linear' else 'mrad'} "
                    f"off its set point, more than any effect on machine {machine.name} can cause; check the machine file, and signs and units of the record"
                )


def guessed_controls(machine: Machine) -> set[str]:
    """Axes of whose control a number is only tried, bounded or assumed."""
    guessed = guessed_values(machine)
    return {a for a in machine.axis_names if any(key.startswith(f"axis.{a}.loops.") for key in guessed)}


def _check_noise(trace: Trace, axis: Axis, where: str) -> None:
    """Refuse set points whose white noise alone needs more acceleration than the axis has: no control commands such set points."""
    variance, white = quiet_noise(trace.get(axis.name, "setpoint"))
    acceleration = np.sqrt(SECOND_DIFFERENCE * variance) / trace.period**2
    if white and acceleration > axis.max_acceleration:
        scale, unit = (1e3, "m") if axis.kind == "linear" else (math.degrees(1e3), "deg")
        raise InputError(
            f"{where}: its set point scatters by {np.sqrt(variance) * scale:.3g} m{unit} from sample to sample, an acceleration of "
            f"{acceleration * scale / 1e3:.3g} {unit}/s2 where the axis has {axis.max_acceleration * scale / 1e3:.3g}; record the set point that the "
            "control gives to the axis, without noise"
        )


def _recorded(axis: Axis, signal: str, campaign: Campaign) -> bool:
    """Is a signal recorded in any run? The command of an axis without current loop counts as its current; one encoder is sufficient."""
    if signal == "position" and axis.encoder == "motor":
        return True
    signal = axis.effort if signal in axis.loops.within_law else signal
    return any(run.trace.has(axis.name, axis.recorded_as(signal)) for run in campaign.runs)


def _plain(name: str) -> str:
    """A name in lower case without punctuation: 'Mikron UCP 710' and 'mikron_ucp710' are the same."""
    return "".join(c for c in name.lower() if c.isalnum())


def _names(machine: Machine) -> set[str]:
    """Names of the machine that a campaign may use: its own, that of its file, that of its model."""
    files = [path.stem for path in (machine.path, machine.model_path) if path is not None]
    return {_plain(name) for name in (machine.name, *files)}


def same_machine(campaign: Campaign, machine: Machine) -> bool:
    """Does a campaign name this machine, or none, and have no other axes?"""
    other = {name for run in campaign.runs for name in run.trace.axes} - set(machine.axis_names)
    return not other and (not campaign.machine_name or _plain(campaign.machine_name) in _names(machine))


def notes_of(campaign: Campaign, machine: Machine) -> list[str]:
    """Notes on what the recorded signals leave open."""
    notes = []
    if not same_machine(campaign, machine):
        notes.append(f"campaign.toml names machine {campaign.machine_name}, it is compared with {machine.name}")
    recorded = {a for run in campaign.runs for a in run.trace.axes}
    axes = [a for a in machine.axis_names if a in recorded]
    for signal, lost in (
        ("motor_position", "transmission and measurement cannot be separated from the mechanics"),
        ("velocity_setpoint", "the position controller cannot be separated from the speed controller"),
        ("current", "faults of controller, motor and load cannot be separated"),
        ("velocity", "the speed controller cannot be isolated"),
        ("position", "the position of the load is unknown"),
    ):
        lacking: dict[str, list[str]] = {}
        for a in axes:
            if not _recorded(machine.axis(a), signal, campaign):
                lacking.setdefault(machine.axis(a).recorded_as(signal), []).append(a)
        notes += [f"no {in_words(name)} of {'axes' if len(of) > 1 else 'axis'} {listed(of)}: {lost}" for name, of in lacking.items()]
    if own := [a for a in axes if any(run.trace.follows_itself(a) for run in campaign.runs)]:
        notes.append(
            f"axis {', '.join(own)}: the set point is the recorded motion itself: only the force along it is compared, and nothing shows the position loop"
        )
    if profiles := [a for a in axes if any(a in run.profiles for run in campaign.runs)]:
        notes.append(f"axis {', '.join(profiles)}: {PROFILE}")
    guessed = guessed_controls(machine)
    if tried := [a for a in axes if a in guessed]:
        notes.append(
            f"axis {', '.join(tried)}: numbers of the control are only tried, bounded or assumed, and what they miss is a part of the gap; "
            "with an earlier recording, --since EARLIER shows what changed"
        )
    still = [a for a in axes if not any(run.trace.moves(a) for run in campaign.runs)]
    if still:
        notes.append(f"axis {', '.join(still)} does not move: it is not diagnosed")
    if len(campaign.runs) == 1:
        notes.append(f"single run: no run can be held out of the fit, and no probability exceeds {T.confidence_in_one_run:g}")
    return notes
