"""Picture of the loops of an axis: open and closed frequency response of each loop, with its margins."""

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from twin.control.linear import Loop
from twin.machine.check import AxisCheck
from twin.machine.loops import Margins
from twin.report.figure import AMBER, BLUE, INK, RED, SOFT, new_figure

_LOWEST_DB, _HIGHEST_DB = -50.0, 50.0


def loop_figure(check: AxisCheck, machine: str) -> Figure:
    """One column per loop, innermost first: magnitude above, phase below."""
    figure, cells = new_figure(2, len(check.loops), width=4.4 * len(check.loops), height=2.9, sharex="col", height_ratios=[1.25, 1.0])
    for column, (loop, margins) in enumerate(zip(check.loops, check.margins)):
        _draw(cells[0, column], cells[1, column], loop, margins)
    cells[0, 0].set_ylabel("magnitude [dB]")
    cells[1, 0].set_ylabel("phase of the open loop [°]")
    handles, labels = cells[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.suptitle(f"{machine}, axis {check.axis.name} ({check.axis.structure}): its loops", fontsize=12, x=0.01, ha="left", color=INK)
    return figure


def _draw(magnitude: Axes, phase: Axes, loop: Loop, margins: Margins) -> None:
    centre = margins.crossover if math.isfinite(margins.crossover) else 0.05 / loop.period
    nyquist = 0.5 / loop.period
    f = np.geomspace(max(centre / 100.0, 1e-2), nyquist * 0.995, 1500)
    response = loop.open_response(f)
    magnitude.axhline(0.0, color=SOFT, linewidth=0.8)
    magnitude.semilogx(f, 20.0 * np.log10(np.abs(response)), color=BLUE, label="open")
    magnitude.semilogx(f, 20.0 * np.log10(np.abs(loop.closed_response(f))), color=AMBER, label="closed")
    angle = np.degrees(np.unwrap(np.angle(response)))
    angle -= 360.0 * np.round((angle[np.argmin(np.abs(f - centre))] + 120.0) / 360.0)
    phase.semilogx(f, angle, color=BLUE)
    phase.axhline(-180.0, color=SOFT, linewidth=0.8)
    lines = []
    if math.isfinite(margins.phase):
        phase.plot([margins.crossover] * 2, [-180.0, margins.phase - 180.0], color=RED, linewidth=2.2)
        lines.append(f"phase margin {margins.phase:.0f}° at {_hz(margins.crossover)}")
    if math.isfinite(margins.gain):
        db = -20.0 * math.log10(margins.gain)
        magnitude.plot([margins.phase_crossing] * 2, [min(db, 0.0), max(db, 0.0)], color=RED, linewidth=2.2, label="margins")
        lines.append(f"gain margin {-db:.1f} dB at {_hz(margins.phase_crossing)}")
    lines.append(f"bandwidth {_hz(margins.bandwidth)}" if math.isfinite(margins.bandwidth) else "closed loop never falls to -3 dB")
    if not margins.stable:
        lines.append("UNSTABLE")
    magnitude.set_title(
        f"{loop.name} loop, every {loop.period * 1e6:g} µs\n" + "\n".join(lines), fontsize=9, loc="left", fontweight="normal"
    )
    magnitude.set_ylim(_LOWEST_DB, _HIGHEST_DB)
    phase.set_ylim(-300.0, 100.0)
    phase.set_yticks([-270, -180, -90, 0, 90])
    phase.set_xlabel("frequency [Hz]")
    for ax in (magnitude, phase):
        ax.set_xlim(f[0], nyquist)


def _hz(value: float) -> str:
    return f"{value:.3g} Hz" if value < 1000.0 else f"{value / 1000.0:.3g} kHz"
