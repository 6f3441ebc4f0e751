"""The table of a tuning: the values in the file, the symmetrical optimum and the tuned values side by side, and the page with it."""

from collections.abc import Sequence
import math
from pathlib import Path

from twin.control.structures import INTEGRAL
from twin.machine.check import Asked
from twin.remedy.control_data import datum_lines
from twin.remedy.tune import Tuned, changed_numbers, mode_needed
from twin.report import Section, Table, write_page
from twin.units import AXIS_UNITS, LEAST_SHOWN

HEADING = (
    "axis", "values", "Kp", "Tn", "Kv [1/s]", "delays", "speed loop", "position loop", "bandwidth",
    "error", "quadrant", "current",
)  # fmt: skip

WORDS = (
    "Kp of a rotary axis or a screw in Nm s/rad. Delays: of the position controller, of the feedforward. Loops: phase and gain margin. Error: RMS behind the "
    "delayed set point; quadrant: its largest value after a reversal. Current: largest share of the limit, with noise."
)


def rows_of(found: Sequence[Tuned]) -> list[list[str]]:
    """One row for each axis and set of values, see WORDS."""
    rows = []
    for name in found[0].margins:
        for tuned in found:
            axis = tuned.machine.axis(name)
            loops, (speed, position), errors = axis.loops, tuned.margins[name], tuned.errors[name]
            unit, to = AXIS_UNITS[axis.kind].error
            peak = errors.reversal_peak
            rows.append(
                [
                    name,
                    tuned.name,
                    f"{loops.speed_gain_nm_s_per_rad:.3g}",
                    f"{1e3 * loops.speed_integral_time_s:.3g} ms" if loops.has(INTEGRAL) else "-",
                    f"{loops.position_gain_per_s:.3g}",
                    f"{1e3 * loops.position_delay_s:.2f}, {1e3 * loops.feedforward_delay_s:.2f} ms",
                    *(f"{m.phase:.0f} deg, {20 * math.log10(m.gain):.1f} dB" if m.stable else "unstable" for m in (speed, position)),
                    f"{position.bandwidth:.0f} Hz" if math.isfinite(position.bandwidth) else "-",
                    f"{to * errors.without_delay_rms:.2f} {unit}" if to * errors.without_delay_rms > LEAST_SHOWN else "-",
                    "-" if peak is None else f"{to * peak:.2f} {unit}",
                    f"{100.0 * tuned.tool.shares[name]:.0f} %" if name in tuned.tool.shares else "-",
                ]
            )
    return rows


def mode_sentences(tuned: Tuned, asked: Asked) -> list[str]:
    """The first mode that the gains need of the mechanics, in words, for axes whose stiffness is not in the file."""
    needed = {name: mode_needed(tuned.machine, tuned.machine.axis(name), asked) for name in tuned.margins}
    modes = ", ".join(f"{name} {hz:.0f} Hz" for name, hz in needed.items() if hz is not None)
    if not modes:
        return []
    return [
        f"The machine file has no stiffness between motor and load for these axes. The tuned gains keep half of the margins only if the first mode "
        f"lies above: {modes}. Measure it before you enter them, or give it with --effect transmission_compliance:AXIS:stiffness=..."
    ]


def sentence_of(found: Sequence[Tuned], motion: str) -> str:
    """RMS contour error on the motion with each set of values, in words."""
    before, textbook, after = (f"{1e6 * tuned.tool.rms:.2f} um" for tuned in found)
    return f"{motion}: {before} RMS at the tool point with the values in the file, {textbook} by the symmetrical optimum, {after} tuned"


def write_tune_report(found: Sequence[Tuned], motion: str, modes: Sequence[str], path: Path) -> None:
    """Write the page."""
    after = found[-1]
    lead = f"On {sentence_of(found, motion)}. Contour error, without effects of wear; simulated on the decoupled plant."
    moved = changed_numbers(found[0].machine, after.machine)
    sections = [
        Section("Side by side", tables=[Table(HEADING, rows_of(found), left=2, caption=WORDS)], paragraphs=[*modes]),
        Section(
            "What to enter",
            tables=[Table(("axis", "number", "SINUMERIK", "unit", "old", "new"), datum_lines(after.machine, moved), left=4)],
        ),
    ]
    write_page(path, f"Tuning: {after.machine.name}", lead, sections)
