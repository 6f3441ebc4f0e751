"""Pictures of the three worked studies, simulated and in closed form.

    python devtools/picture_study.py [--studies FOLDER]     runs missing studies into FOLDER (default out/studies)
    python devtools/picture_study.py --only side_by_side    one picture

Writes docs/pictures/study/*.png. The viewer draws the two designs side by side and needs a Vulkan driver.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
import math
from pathlib import Path
import tempfile
from typing import Any

import numpy as np

from devtools.worked_studies import carried_out, payload_currents, rapid_time, table_of
from twin.machine.machine import load_machine
from twin.replay.side_by_side import write_side_by_side
from twin.replay.viewer import screenshot
from twin.report import new_figure, save_png
from twin.report.figure import AMBER, BLUE, GREEN, INK, RED, SOFT
from twin.study.design import machine_of
from twin.study.duty import duty_of
from twin.study.evaluate import work_of
from twin.study.results import surrogate_from
from twin.study.spec import read_study

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "pictures" / "study"
COLOURS = (GREEN, BLUE, RED)


def from_zero(panel: Any) -> None:
    """The vertical axis from 0, with room above the points."""
    panel.set_ylim(0.0, 1.08 * panel.dataLim.y1)


def legend(panel: Any, place: str) -> None:
    panel.legend(loc=place, frameon=False, fontsize=8.5)


def corner(folder: Path) -> Any:
    """Deviation of X and contour error against the masses, one colour for each position gain."""
    t, x = table_of(folder), load_machine().axis("X")
    figure, ((left, middle, right),) = new_figure(1, 3, width=11.5, height=3.5)
    slope = x.ratio**2 * x.loops.speed_integral_time_s * x.max_jerk / x.loops.speed_gain_nm_s_per_rad * 1e6
    for gain, colour in zip(np.unique(t["position gain"]), COLOURS):
        here = t["position gain"] == gain
        label = f"position gain x {gain:g}"
        left.plot(t["X mass"][here], t["control_deviation_max_X_um"][here], ".", color=colour, label=label)
        first = t["control_deviation_max_X_um"][here & (t["X mass"] == 500.0)][0]
        mass = np.array([500.0, 900.0])
        left.plot(mass, first + slope / (gain * x.loops.position_gain_per_s) * (mass - 500.0), "--", color=SOFT, linewidth=1.2)
        for panel, factor, other in ((middle, "X mass", "Y saddle"), (right, "Y saddle", "X mass")):
            rows = here & (t[other] == np.median(t[other]))
            panel.plot(t[factor][rows], t["contour_error_max_um"][rows], ".-", color=colour, label=label)
    left.plot([], [], "--", color=SOFT, label="r² Tn jerk / (Kp Kv) a kilogram")
    from_zero(left)
    left.set_xlabel("mass that X moves [kg]")
    left.set_ylabel("largest deviation of X [um]")
    legend(left, "lower left")
    for panel, name in ((middle, "mass that X moves [kg]"), (right, "mass that Y moves, at 700 kg on X [kg]")):
        from_zero(panel)
        panel.set_xlabel(name)
        panel.set_ylabel("largest contour error [um]")
    return figure


def payload(folder: Path) -> Any:
    """Current of A against that of rigid bodies, and the deviations of A and C against it."""
    t = table_of(folder)
    found, theory = payload_currents(folder)
    figure, axes = new_figure(1, 3, width=11.5, height=3.5)
    ends = np.array([0.0, 1.05 * theory.max()])
    axes[0][0].plot(ends, ends, "--", color=SOFT, linewidth=1.2, label="rigid bodies")
    for panel, y, label in (
        (axes[0][0], found, "largest current of A, study [A]"),
        (axes[0][1], t["control_deviation_max_A_arcsec"], "largest deviation of A [arcsec]"),
        (axes[0][2], t["control_deviation_max_C_arcsec"], "largest deviation of C [arcsec]"),
    ):
        points = panel.scatter(theory, y, c=t["payload mass"], cmap="viridis", s=22)
        panel.set_xlabel("largest current of A, rigid bodies [A]")
        panel.set_ylabel(label)
        from_zero(panel)
    legend(axes[0][0], "lower right")
    figure.colorbar(points, ax=axes[0][2], label="payload [kg]")
    return figure


def matching(folder: Path) -> Any:
    """Current and time of the rapid move against the lead, one colour for each rotor, with the matched leads."""
    t, x = table_of(folder), load_machine().axis("X")
    figure, ((left, right),) = new_figure(1, 2, width=10.5, height=3.8)
    for rotor, colour in zip((0.5, 1.0, 2.0), COLOURS):
        here = t["rotor inertia"] == rotor
        leads = t["screw lead"][here]
        fine = np.linspace(leads.min(), leads.max(), 300)
        for panel, response in ((left, "set_points.current_smooth_max_X_a"), (right, "rapid.cycle_time_s")):
            predict = surrogate_from(folder, response)
            panel.plot(leads * 1e3, t[response][here], ".", color=colour, label=f"rotor and screw x {rotor:g}")
            panel.plot(fine * 1e3, [predict({"screw lead": v, "rotor inertia": rotor})[0] for v in fine], color=colour, linewidth=1.0)
        right.plot(fine * 1e3, [rapid_time(load_machine(), rotor, v) for v in fine], "--", color=colour, linewidth=1.0)
        matched = 2.0 * math.pi * math.sqrt(rotor * x.rotor_inertia_kg_m2 / x.moving_mass_kg) * 1e3
        left.axvline(matched, color=colour, linestyle="--", linewidth=1.0)
        left.text(matched, 11.2, f" {matched:.1f}", color=colour, fontsize=8.5)
    left.plot([], [], "--", color=INK, linewidth=1.0, label="2π sqrt(J / m)")
    left.set_ylim(0.0, 12.0)
    left.set_ylabel("largest current of X, same set points [A]")
    right.plot([], [], "--", color=INK, linewidth=1.0, label="the moves alone, without 0.23 s of pauses")
    right.set_ylim(0.0, 4.4)
    right.set_ylabel("600 mm out and back [s]")
    for panel in (left, right):
        panel.axvline(10.0, color=AMBER, linewidth=3.0, alpha=0.35, label="the machine")
        panel.set_xlabel("screw lead [mm]")
        legend(panel, "lower right")
    return figure


def side_by_side(picture: Path) -> None:
    """Screenshot of the viewer with the present machine and half the inertia of X at the same margins, on the five-axis program."""
    study = read_study(ROOT / "examples" / "half_inertia" / "study.toml")
    study = replace(study, runs=study.runs[-1:])
    (run,) = study.runs
    work = work_of(study)
    duties = [
        duty_of(work, machine_of(study, np.array([inertia, *[1.0] * 6])), label) for label, inertia in (("as it is", 1.0), ("half X", 0.5))
    ]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "compare.rrd"
        write_side_by_side(file, {duty.label: (duty.machine, duty.runs[run.name].trace) for duty in duties if duty})
        screenshot(file, picture, at_s=4.2, size=(1600, 900))


DRAWN = {"corner_mass": corner, "table_payload": payload, "inertia_matching": matching}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--studies", type=Path, default=Path("out") / "studies", metavar="FOLDER")
    parser.add_argument("--only", choices=(*DRAWN, "side_by_side"))
    args = parser.parse_args()
    for name in [args.only] if args.only else (*DRAWN, "side_by_side"):
        picture = PICTURES / f"{name}.png"
        if name in DRAWN:
            save_png(DRAWN[name](carried_out(name, args.studies)), picture)
        else:
            side_by_side(picture)
        print(picture)


if __name__ == "__main__":
    main()
