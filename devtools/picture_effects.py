"""Pictures of what each effect looks like, and the page that explains all effects: docs/effects.md, docs/pictures/effects/.

    python devtools/picture_effects.py                     all pictures and the page
    python devtools/picture_effects.py --only backlash     one picture
    python devtools/picture_effects.py --text              the page alone (a test holds it to the library)

Each picture is a short telling move with the effect (colour of the axis) and without it (grey): following error without the
delay that the set point has on purpose, motor current, and motor minus scale, which a machine with two encoders shows.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
import math
from pathlib import Path

import numpy as np
from scipy.signal import chirp

from twin.effects import BLOCKS, EFFECTS, Effect, Parameter, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Axis, Machine, load_machine
from twin.recordings.trace import Trace
from twin.report.colours import SETPOINT_COLOUR, axis_colour, hexadecimal
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.units import ARCSEC, AXIS_UNITS

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "effects.md"
PICTURES = ROOT / "docs" / "pictures" / "effects"
BEGIN, END = "<!-- begin: written by devtools/picture_effects.py -->", "<!-- end -->"


@dataclass(frozen=True)
class Shown:
    """What a picture shows: axis, move, feedforward, sizes other than the middle of the usual range, and what to look at."""

    look: str
    move: str = "acceleration"
    axis: str = "X"
    feedforward: str | None = None
    sizes: dict[str, float] = field(default_factory=dict)
    also: dict[str, str] = field(default_factory=dict)
    with_axes: str = ""
    started_at: float = 0.0
    smooth_s: float = 0.002  # the staircase of the position cycle is taken out of the current


SHOWN = {
    "position_gain": Shown("Feedforward off: the lag at constant speed is v / Kv.", feedforward="off", sizes={"factor": 0.87}),
    "velocity_feedforward": Shown("An error in proportion to speed, only while feedforward is on.", sizes={"factor": 0.96}),
    "torque_feedforward": Shown("Errors where acceleration changes, which the speed controller has to make up for.", sizes={"factor": 0.6}),
    "loop_delay": Shown("v times the delay, with feedforward on and off.", sizes={"delay_s": 0.5e-3}),
    "speed_gain": Shown("Reversals and jerks are followed less tightly; constant speed shows nothing.", "reversal", sizes={"factor": 0.65}),
    "speed_integral_time": Shown("The friction's jump at a reversal is made up for more slowly.", "reversal", sizes={"factor": 2.0}),
    "set_point_filter": Shown(
        "v times the time constant, although feedforward is on: feedforward and set point part.", sizes={"time_constant_s": 3e-3}
    ),
    "current_filter": Shown("The speed loop loses phase: a reversal rings.", "reversal", sizes={"time_constant_s": 1.5e-3}),
    "torque_constant": Shown(
        "More current for the same motion wherever torque is needed, also at rest on Z.", axis="Z", sizes={"factor": 0.9}
    ),
    "current_limit": Shown("The current is cut off, the axis falls behind and catches up.", sizes={"limit_a": 9.5}),
    "inertia": Shown("More current in proportion to acceleration.", sizes={"added": 800.0}),
    "coulomb_friction": Shown(
        "Current shifted by the same amount at every speed, against the motion; larger error at reversal.",
        "reversal",
        sizes={"factor": 1.4},
    ),
    "viscous_friction": Shown("More current in proportion to speed.", "gentle", sizes={"factor": 1.6}),
    "stribeck": Shown(
        "More friction at low speed: the current peaks where the axis starts and stops.", "slow", sizes={"excess": 700.0, "velocity": 0.004}
    ),
    "presliding": Shown("Small moves: the friction builds up over micrometres instead of jumping.", "micro", smooth_s=0.004),
    "viscous_asymmetry": Shown(
        "One direction needs more current than the other, in proportion to speed.", "gentle", sizes={"fraction": 0.35}
    ),
    "position_dependent_friction": Shown(
        "Friction comes and goes along the travel and turns with the direction.", "constant speed", sizes={"wavelength": 0.02}
    ),
    "constant_force": Shown("Current shifted the same way in both directions.", "reversal", sizes={"force": 500.0}),
    "table_unbalance": Shown(
        "Torque of the weight, changing with the tilt.",
        "acceleration",
        "A",
        with_axes="C",
        sizes={"angle_rad": 1.2, "radius_m": 0.2, "mass_kg": 50.0},
    ),
    "backlash": Shown("Slow reversal: motor and scale part by the clearance, the load stands until the motor has crossed it.", "reversal"),
    "transmission_compliance": Shown(
        "A chirp from 10 to 70 Hz meets the resonance; motor minus scale is the wound-up spring.", "chirp", smooth_s=0.0005
    ),
    "frame_vibration": Shown(
        "Each change of acceleration rings in the scale, hardly in the motor.", "jerk", sizes={"frequency_hz": 28.0, "mass_ratio": 0.08}
    ),
    "torque_ripple": Shown(
        "Current waves locked to the motor's angle: here 6 a turn.", "constant speed", sizes={"amplitude_nm": 0.25, "periods_per_rev": 6.0}
    ),
    "lead_error": Shown("Motor and scale part in proportion to the way.", "constant speed", sizes={"fraction": 60e-6}),
    "cyclic_error": Shown("Once a motor turn between motor and scale; the speed loop shakes the axis with it.", "constant speed"),
    "encoder_eccentricity": Shown("Once a table turn between motor and scale, slowly.", "turn", "C"),
    "thermal_drift": Shown(
        "Motor and scale part with time, whatever the axis does; this run began 20 s into the campaign.",
        "again",
        sizes={"rate": 0.4e-6},
        started_at=20.0,
    ),
    "cross_axis_coupling": Shown(
        "X moves steadily; each acceleration of Y, out and back, pushes it.",
        "other axis",
        also={"from_axis": "Y"},
        with_axes="Y",
        sizes={"mass": 170.0},
    ),
    "periodic_disturbance": Shown(
        "A wave in time, at rest, in motion and at any speed the same.", sizes={"frequency_hz": 18.0, "force": 450.0}
    ),
}
"""One entry an effect; an effect without one is shown on an acceleration, on its first axis."""

_PERIOD = 1e-3


def setpoint(move: str, axis: Axis) -> np.ndarray:
    """(sample,) at 1 ms."""
    unit = 1.0 if axis.kind == "linear" else 6.0  # a rotary axis in rad moves that much further
    slow = {"slow": (0.004, 0.010), "reversal": (0.0015, 0.010)}
    if move in slow:
        distance, speed = slow[move]
        return moves_in_turn(0.0, [distance * unit, -distance * unit], speed * unit, 0.5 * unit, 20.0 * unit, 0.05, _PERIOD)[1]
    if move == "constant speed":
        return moves_in_turn(0.0, [0.04 * unit, -0.04 * unit], 0.05 * unit, 1.0 * unit, 40.0 * unit, 0.05, _PERIOD)[1]
    if move == "jerk":
        return moves_in_turn(0.0, [0.02 * unit], 0.1 * unit, 2.0 * unit, 2000.0 * unit, 0.15, _PERIOD)[1]
    if move == "turn":
        return moves_in_turn(0.0, [2 * math.pi], 2.0, 5.0, 50.0, 0.1, _PERIOD)[1]
    if move == "gentle":
        return moves_in_turn(0.0, [0.15 * unit, -0.15 * unit], 0.3 * unit, 1.0 * unit, 20.0 * unit, 0.08, _PERIOD)[1]
    if move == "again":
        return moves_in_turn(0.0, [0.0015 * unit, -0.0015 * unit] * 10, 0.010 * unit, 0.5 * unit, 20.0 * unit, 0.2, _PERIOD)[1]
    t = np.arange(1101) * _PERIOD
    if move == "micro":
        ease = np.minimum(t / 0.25, 1.0)
        return 25e-6 * unit * np.sin(2 * np.pi * 2.0 * t) * ease**3 * (10.0 - 15.0 * ease + 6.0 * ease**2)
    if move == "chirp":
        fade = np.clip(np.minimum(t, 1.0 - t) / 0.1, 0.0, 1.0)
        return 20e-6 * unit * fade * chirp(t, 10.0, 1.0, 70.0)
    return moves_in_turn(0.0, [0.05 * unit, -0.05 * unit], 0.25 * unit, axis.max_acceleration, 100.0 * unit, 0.08, _PERIOD)[1]


def sizes_of(effect: Effect, machine: Machine, axis: Axis, shown: Shown) -> dict[str, float]:
    """The picture's parameters: as given, else the middle of the usual range."""
    usual = {p.name: sum(p.usual_range(machine, axis)) / 2.0 for p in effect.parameters if not p.shape}
    return {**usual, **shown.sizes}


def traces_of(effect: Effect, machine: Machine) -> tuple[Axis, Trace, Trace, dict[str, float]]:
    """The shown axis, the run without and with the effect, and its parameters."""
    shown = SHOWN.get(effect.name, Shown("", axis=effect.axes(machine)[0].name))
    axis = machine.axis(shown.axis)
    few = machine.with_axes([axis.name, *shown.with_axes])
    if shown.feedforward:
        few = few.with_feedforward(shown.feedforward)
    if shown.move == "other axis":
        pushing = setpoint("acceleration", few.axis(shown.with_axes))
        steady = setpoint("constant speed", axis)
        moves = {axis.name: steady, shown.with_axes: np.pad(pushing, (200, len(steady) - 200 - len(pushing)), mode="edge")}
    else:
        moves = {axis.name: setpoint(shown.move, axis)}
    position = np.column_stack([moves.get(a.name, np.zeros(len(moves[axis.name]))) for a in few.axes])
    sizes = sizes_of(effect, few, axis, shown)
    affected = with_effects(few, [{"name": effect.name, "axis": axis.name, **shown.also, **sizes}])
    points = Setpoints(position, _PERIOD)
    without, having = (simulate(m, points, started_at=shown.started_at).trace for m in (few, affected))
    return axis, without, having, sizes


def draw(effect: Effect, machine: Machine, folder: Path) -> Path:
    """Set point's speed, following error, current, motor minus scale."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    axis, without, having, sizes = traces_of(effect, machine)
    shown = SHOWN.get(effect.name, Shown(""))
    units = AXIS_UNITS[axis.kind]
    error_unit, error_factor = units.error
    speed_unit, speed_factor = units.speed
    moving = shown.with_axes if shown.move == "other axis" else axis.name
    rows = (
        (f"speed of {moving}\n{speed_unit}", lambda t: speed_factor * np.gradient(t.get(moving, "setpoint"), t.period)),
        (f"error less delay\n{error_unit}", lambda t: error_factor * (delayed(t, axis) - t.get(axis.name, "position"))),
        ("motor current\nA", lambda t: smoothed(t.get(axis.name, "current"), shown.smooth_s, t.period)),
        (f"motor − scale\n{error_unit}", lambda t: error_factor * (t.get(axis.name, "motor_position") - t.get(axis.name, "position"))),
    )
    grey, colour = hexadecimal(SETPOINT_COLOUR), hexadecimal(axis_colour(axis.name))
    style = {
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e4e6ea",
        "axes.titlesize": 10,
    }
    with plt.rc_context(style):
        figure, places = plt.subplots(4, 1, figsize=(8.6, 6.2), sharex=True, layout="constrained", height_ratios=(0.7, 1, 1, 1))
        for place, (label, of) in zip(places, rows):
            # the same without the effect lies below, wider, so that both are seen where they agree
            place.plot(without.time, of(without), color=grey, linewidth=2.6, alpha=0.75)
            if place is not places[0]:
                place.plot(having.time, of(having), color=colour, linewidth=1.1)
            place.set_ylabel(label)
            place.margins(x=0.0)
            floor(place, 1e-3 * (1.0 if "current" not in label else 10.0))
        figure.legend(places[-1].lines, ["without", "with"], loc="lower right", ncols=2, frameon=False, borderaxespad=0.1)
        places[-1].set_xlabel("time in s")
        figure.align_ylabels(places)
        told = ", ".join(f"{n} = {readable(sizes[n], effect.parameter(n).unit(axis))}" for n in sizes)
        source = f" from {shown.also['from_axis']}" if "from_axis" in shown.also else ""
        figure.suptitle(f"{effect.name} on {axis.name}{source}: {told}", x=0.01, ha="left", size=11, weight="bold")
        path = folder / f"{effect.name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=80)
        plt.close(figure)
    quantised(path)
    return path


def smoothed(values: np.ndarray, width: float, period: float) -> np.ndarray:
    """Running mean; the ends keep their values."""
    count = max(1, round(width / period))
    padded = np.pad(values, (count // 2, count - 1 - count // 2), mode="edge")
    return np.convolve(padded, np.full(count, 1.0 / count), "valid")


def floor(place, smallest: float) -> None:  # type: ignore[no-untyped-def]
    """Values that are nothing are drawn as nothing: no scale below `smallest`."""
    low, high = place.get_ylim()
    if high - low < smallest:
        middle = (low + high) / 2.0
        place.set_ylim(middle - smallest, middle + smallest)


def quantised(path: Path) -> None:
    """Few colours: a third of the file."""
    from PIL import Image

    Image.open(path).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)


def delayed(trace: Trace, axis: Axis) -> np.ndarray:
    """Set points one nominal position delay earlier: what a perfect axis would show."""
    return np.interp(trace.time - axis.loops.position_delay_s, trace.time, trace.get(axis.name, "setpoint"))


READABLE = {
    "m": ((1e-3, 1e6, "um"), (1.0, 1e3, "mm")),
    "rad": ((1e-2, 1.0 / ARCSEC, "arcsec"),),
    "s": ((0.1, 1e3, "ms"),),
    "m/s": ((1e-4, 1e6, "um/s"), (1.0, 1e3, "mm/s")),
    "N/m": ((math.inf, 1e-6, "N/um"),),
}
"""Units in which people say small values: (up to, factor, name)."""


def readable(value: float, unit: str) -> str:
    """A value as it stands in a title."""
    for below, factor, name in READABLE.get(unit, ()):
        if abs(value) < below:
            return f"{value * factor:.3g} {name}"
    return f"{value:.4g} {unit}" if unit != "1" else f"{value:.6g}"


# --- the page ------------------------------------------------------------------------------------------------------------------------


def page_text(machine: Machine) -> str:
    """The part of the page between the markers: one section an effect, by block."""
    lines = []
    for block in BLOCKS:
        effects = [e for e in EFFECTS.values() if e.block == block]
        lines += [f"## {block[0].upper()}{block[1:]}", ""] if effects else []
        for effect in effects:
            lines += section(effect, machine)
    return "\n".join(lines).rstrip()


def section(effect: Effect, machine: Machine) -> list[str]:
    shown = SHOWN.get(effect.name, Shown(""))
    summary, _, law = effect.law.partition("\n\n")
    axes = " ".join(a.name for a in effect.axes(machine))
    lines = [f"### {effect.name}", "", f"{summary} On the Mikron: {axes}.", "", law.replace("*", "\\*"), ""]
    kinds = {axis.kind: axis for axis in reversed(effect.axes(machine))}
    example = ",".join(
        [
            *(f"{k}={v}" for k, v in shown.also.items()),
            *(f"{k}={v:.4g}" for k, v in sizes_of(effect, machine, machine.axis(shown.axis), shown).items()),
        ]
    )
    lines += [f"    --effect {effect.name}:{shown.axis}:{example}", ""]
    lines += ["| parameter | unit | bounds | usual size | default |", "|---|---|---|---|---|"]
    for p in effect.parameters:
        unit = " or ".join(dict.fromkeys(p.unit(a) for _, a in sorted(kinds.items())))
        default = f"{p.default:g}" if p.default is not None else "computed" if p.shape else "must be given"
        lines.append(f"| `{p.name}` | {unit} | {number(p.low)} to {number(p.high)} | {usual(p, machine, effect)} | {default} |")
    if effect.from_axis:
        lines.append("| `from_axis` | | another axis | | must be given |")
    return [*lines, "", *([shown.look, ""] if shown.look else []), f"![{effect.name}](pictures/effects/{effect.name}.png)", ""]


def usual(parameter: Parameter, machine: Machine, effect: Effect) -> str:
    """Usual sizes on the first linear and the first rotary axis that can have it."""
    if parameter.shape and parameter.usual is None:
        return ""
    texts: dict[str, tuple[str, str]] = {}
    for axis in effect.axes(machine):
        low, high = parameter.usual_range(machine, axis)
        texts.setdefault(axis.kind, (f"{number(low)} to {number(high)}", axis.name))
    sizes = [size for size, _ in texts.values()]
    if not callable(parameter.usual) or (len(sizes) > 1 and len(set(sizes)) == 1):
        return sizes[0]
    return ", ".join(f"{size} ({name})" for size, name in texts.values())


def number(value: float) -> str:
    return f"{value:.3g}"


def page(machine: Machine, before: str) -> str:
    """The page with its generated part replaced."""
    head, _, rest = before.partition(BEGIN)
    tail = rest.partition(END)[2]
    return f"{head}{BEGIN}\n\n{page_text(machine)}\n\n{END}{tail}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=list(EFFECTS), metavar="EFFECT", help="only these pictures")
    parser.add_argument("--text", action="store_true", help="only the page")
    parser.add_argument("--out", type=Path, default=PICTURES, metavar="DIR", help="folder of the pictures")
    args = parser.parse_args()
    machine = load_machine()
    if not args.text:
        for name in args.only or EFFECTS:
            print(draw(EFFECTS[name], machine, args.out))
    PAGE.write_text(page(machine, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
