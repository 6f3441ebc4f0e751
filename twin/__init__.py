"""Digital twin of a machine tool's feed drives on MuJoCo.

    program -> interpolator -> set points -> cascade + plant (one compiled loop) -> trace -> tool path -> cut surface
                                                  ^                              |
                          machine (+ effects) ----+---- identify <- campaign ----+-> gap -> diagnose -> corrected machine

The public names, each imported on first use:

    load_machine(file=None), write_machine(machine, file)      a machine file; the Mikron UCP 710 without one
    add_effects(machine, "backlash:X:clearance=15e-6")         a machine with one more imperfection
    read_trace(file), write_trace(trace, file)                 recorded or simulated signals of the axes
    interpolate(program_file, machine)                         set points of a part program
    simulate(machine, trace_or_setpoints)                      a Run: trace, errors, limits
    compare(a, b, machine)                                     two runs, aligned on their set points
    read_campaign(folder, machine)                             measured runs
    write_campaign({"stroke": run}, folder)                    runs as a campaign
    gap(campaign, machine)                                     measured minus simulated, signal by signal
    identify(campaign, machine)                                friction, inertia, gains, delays with intervals
    diagnose(campaign, machine)                                the effects behind a gap, with size and probability
    study(spec)                                                a design study
    cut(run_or_trace, part, machine)                           the cut surface of a part
    effects                                                    the package of effects; effects.EFFECTS lists them

All quantities are SI (m, rad, s, N, kg, A); arrays are (sample, axis) in the order of the machine's axes. Bad input raises `InputError`,
a diverging simulation `SimulationError`; both are `TwinError`. docs/python.md has an example of each function.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin import effects as effects
    from twin.compare.compare import Comparison as Comparison
    from twin.compare.compare import compare as compare
    from twin.diagnose.diagnosis import Diagnosis as Diagnosis
    from twin.diagnose.procedure import diagnose as diagnose
    from twin.effects.change import add_effects as add_effects
    from twin.errors import InputError as InputError
    from twin.errors import SimulationError as SimulationError
    from twin.errors import TwinError as TwinError
    from twin.identify.identify import identify as identify
    from twin.identify.result import Identification as Identification
    from twin.machine.machine import Machine as Machine
    from twin.machine.machine import load_machine as load_machine
    from twin.machine.machine import write_machine as write_machine
    from twin.program.interpolator import interpolate as interpolate
    from twin.recordings.campaign import Campaign as Campaign
    from twin.recordings.campaign import read_campaign as read_campaign
    from twin.recordings.trace import Trace as Trace
    from twin.recordings.trace import read_trace as read_trace
    from twin.recordings.trace import write_trace as write_trace
    from twin.simulation.campaign_file import write_campaign as write_campaign
    from twin.simulation.campaign_gap import CampaignGap as CampaignGap
    from twin.simulation.campaign_gap import gap as gap
    from twin.simulation.result import Run as Run
    from twin.simulation.run import simulate as simulate
    from twin.study.output import study as study
    from twin.surface.machining import cut as cut

__version__ = "0.1.0"

_PLACES = {
    name: module
    for module, names in {
        "compare.compare": ("Comparison",),
        "diagnose.diagnosis": ("Diagnosis",),
        "effects.change": ("add_effects",),
        "errors": ("InputError", "SimulationError", "TwinError"),
        "identify.result": ("Identification",),
        "machine.machine": ("Machine", "load_machine", "write_machine"),
        "program.interpolator": ("interpolate",),
        "recordings.campaign": ("Campaign", "read_campaign"),
        "recordings.trace": ("Trace", "read_trace", "write_trace"),
        "simulation.campaign_file": ("write_campaign",),
        "simulation.campaign_gap": ("CampaignGap", "gap"),
        "simulation.result": ("Run",),
        "simulation.run": ("simulate",),
        "surface.machining": ("cut",),
    }.items()
    for name in names
}
"""Public name -> the module that defines it."""

_CALLED_PACKAGES = {
    "compare": "compare.compare",
    "diagnose": "diagnose.procedure",
    "identify": "identify.identify",
    "study": "study.output",
}
"""Packages with a function of the same name, which makes them callable: twin.diagnose(campaign, machine)."""

__all__ = ["__version__", "effects", *_PLACES, *_CALLED_PACKAGES]


class _CalledPackage(ModuleType):
    """A callable package: `twin.diagnose(...)` and `twin.diagnose.report` both work."""

    @property
    def __wrapped__(self) -> Any:
        """The function of the package; `help` and `inspect.signature` show its arguments."""
        name = self.__name__.rpartition(".")[2]
        return getattr(importlib.import_module(f"twin.{_CALLED_PACKAGES[name]}"), name)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self.__wrapped__(*arguments, **options)


class _Front(ModuleType):
    """This package. It makes the packages of _CALLED_PACKAGES callable when Python binds them here after their import."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _CALLED_PACKAGES and isinstance(value, ModuleType):
            value.__class__ = _CalledPackage
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Front


def __getattr__(name: str) -> Any:
    if name in _CALLED_PACKAGES or name == "effects":
        return importlib.import_module(f"twin.{name}")
    if name in _PLACES:
        found = getattr(importlib.import_module(f"twin.{_PLACES[name]}"), name)
        globals()[name] = found
        return found
    raise AttributeError(f"module 'twin' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
