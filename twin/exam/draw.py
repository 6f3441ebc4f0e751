"""Draws cases and writes their campaigns without the truth.

    case = draw_case(seed, "single", machine)            # or pair, triple, healthy, outside, everyday
    write_campaign(case, folder, machine)                # Parquet and campaign.toml; neither reveals the truth
    truth = truth_of(case)                               # for the sealed file, kept elsewhere

The seed determines everything: parameter factors, effects and sizes, richness, programme, noise.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
import zlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .paths import PERIOD, limits_of, path_of, together
from .plant.effects import LIBRARY, DrawContext, apply_effect, draw_effect
from .plant.outside import OUTSIDE
from .plant.parameters import AXES, Richness, Settings, apply_richness, draw_factors, load_of, pair_of, settings_of
from .plant.plant import SUBSTEPS, PlantError, Trace, run
from .programme import TestRun, programme

COUNTS = {"healthy": 0, "single": 1, "outside": 1, "pair": 2, "triple": 3}  # kind of case -> number of effects

EFFECTS = LIBRARY | OUTSIDE
BACKGROUND = tuple(
    (name, axis)
    for name in (
        "viscous_asymmetry",
        "position_dependent_friction",
        "constant_force",
        "torque_ripple",
        "stribeck",
        "cyclic_error",
        "lead_error",
        "thermal_drift",
        "encoder_eccentricity",
    )
    for axis in LIBRARY[name].axes
)
"""Small effects of an everyday machine, on every axis that can have them."""
BACKGROUND_SCALE = (0.03, 0.15)  # share of the usual size, drawn for each effect
MOST_MAIN = 3  # most effects of usual size besides the background
ZEROS = ("each run", "kept")
RICH = Richness()
# run set -> kinds or names of the runs in it
RUN_SETS = {
    "all": ("test",),
    "short": ("constant_velocity", "acceleration", "reversal", "five_axis"),
    "program": ("program",),
    "exam": ("exam",),
}
SIGNALS = {
    "full": ("setpoint", "position", "motor_position", "velocity", "velocity_setpoint", "current"),
    "no motor position": ("setpoint", "position", "velocity", "velocity_setpoint", "current"),
    "no velocity set point": ("setpoint", "position", "motor_position", "velocity", "current"),
    "scale and current": ("setpoint", "position", "current"),
    "no scale": ("setpoint", "motor_position", "velocity", "velocity_setpoint", "current"),
}
_HOMES = (Path(__file__).resolve().parents[1] / "models", Path(__file__).resolve().parents[2] / "models")  # installed, checkout
SHIPPED_MACHINE = next((home / "mikron_ucp710.toml" for home in _HOMES if home.is_dir()), _HOMES[1] / "mikron_ucp710.toml")
PAUSE_S = 5.0  # between runs of a campaign
# decimals of a recorded column: (linear axes in mm, mm/s, A; rotary axes in deg, deg/s, A), as in the recorded campaigns
DECIMALS = {
    "setpoint": (7, 7),
    "position": (4, 6),
    "motor_position": (5, 7),
    "velocity": (3, 3),
    "velocity_setpoint": (3, 3),
    "current": (3, 3),
}


@dataclass(frozen=True)
class Case:
    """One machine to be examined; `dataclasses.replace` makes its variants (no effects, other richness, other noise)."""

    seed: int
    kind: str
    scale: float
    effects: tuple[dict, ...]  # as in a truth.toml, from the library and outside it
    factors: dict  # parameter factors, see parameters.unit_factors
    richness: Richness = field(default_factory=Richness)
    noise: bool = True
    noise_seed: int | None = None  # for another recording of the same machine
    wide: bool = False  # sizes and shapes from ranges three times as wide
    encoder_zero: str = "each run"  # lead and cyclic error start at zero in each run; "kept": encoders keep their zero
    budget: tuple[dict, ...] = ()  # change of the signals by each effect, see budget.py


def draw_case(
    seed: int,
    kind: str,
    machine: dict,
    *,
    effect: str | None = None,
    axis: str | None = None,
    scale: float = 1.0,
    spread: float | None = None,
    richness: Richness = RICH,
    run_set: str = "all",
    wide: bool = False,
) -> Case:
    """A case from its seed.

    effect, axis: fix them for the kinds "single" and "outside" (otherwise drawn). scale: 1 = usual size, 0.2 = a fifth.
    spread: parameter spread, by default the machine file's parameter_tolerance. run_set: the runs whose peak speeds and
    currents scale the sizes (a current limit must be reached in the runs that look for it). wide: draw sizes and shapes from
    ranges three times as wide. Everyday and wide machines may have motor encoders that keep their zero from run to run."""
    if kind not in (kinds := (*COUNTS, "everyday")):
        raise ValueError(f"no kind {kind!r}; there are: {', '.join(kinds)}")
    of_factors, of_effects = (np.random.default_rng(child) for child in np.random.SeedSequence([seed, 10]).spawn(2))
    factors = draw_factors(of_factors, machine["parameter_tolerance"] if spread is None else spread)
    peaks = peaks_of(machine, factors, runs_of(machine, seed, run_set))
    both = kind == "everyday" or wide
    zero = ZEROS[np.random.default_rng(np.random.SeedSequence([seed, 16])).integers(2)] if both else ZEROS[0]
    for _ in range(20):
        if kind == "everyday":
            chosen = _everyday(of_effects)
        else:
            chosen = [(name, on, scale) for name, on in _choose(kind, COUNTS[kind], of_effects, effect, axis)]
        s = settings_of(machine, factors)
        effects = tuple(
            draw_effect(name, on, DrawContext(of_effects, AXES.index(on), size, s, *peaks, wide), EFFECTS) for name, on, size in chosen
        )
        case = Case(seed, kind, scale, effects, factors, richness, wide=wide, encoder_zero=zero)
        if not effects or behaves(case, machine):
            return case
    raise PlantError(
        f"case {seed} ({kind}, {effect or 'any effect'} on {axis or 'any axis'}, scale {scale}): the control loops are unstable "
        "in all of 20 draws; use a smaller scale"
    )


def runs_of(machine: dict, seed: int, run_set: str) -> list[TestRun]:
    """Runs of a run set, in the order of the programme."""
    return [r for r in programme(machine, seed) if r.kind in RUN_SETS[run_set] or r.name in RUN_SETS[run_set]]


def _everyday(rng: np.random.Generator) -> list[tuple[str, str, float]]:
    """Names, axes and scales: up to three effects of usual size, then the background effects that they do not replace."""
    main = _choose("everyday", int(rng.integers(MOST_MAIN + 1)), rng, None, None)
    low, high = BACKGROUND_SCALE
    scales = low + (high - low) * rng.random(len(BACKGROUND))
    return [(*m, 1.0) for m in main] + [(*b, float(scale)) for b, scale in zip(BACKGROUND, scales) if b not in main]


def _choose(kind: str, count: int, rng: np.random.Generator, effect: str | None, axis: str | None) -> list[tuple[str, str]]:
    """Names and axes: every effect with the same probability, then every axis that it can be on."""
    library = OUTSIDE if kind == "outside" else LIBRARY
    chosen: list[tuple[str, str]] = []
    while len(chosen) < count:
        names = [n for n in library if (effect in (None, n)) and (axis is None or axis in library[n].axes)]
        if not names:
            raise ValueError(f"no effect {effect!r} on axis {axis!r} among: {', '.join(library)}")
        name = names[rng.integers(len(names))]
        on = axis or library[name].axes[rng.integers(len(library[name].axes))]
        if (name, on) not in chosen:
            chosen.append((name, on))
        elif effect is not None:
            raise ValueError("effect and axis can be fixed only for kinds with one effect (single, outside)")
    return chosen


def settings_for(case: Case, machine: dict, feedforward: str = "velocity+torque") -> Settings:
    """Plant settings of this case: factors, effects, richness, and the feedforward of a run."""
    s = settings_of(machine, case.factors)
    s.zero_kept = case.encoder_zero == "kept"
    for effect in case.effects:
        apply_effect(s, effect, EFFECTS)
    apply_richness(s, case.richness, np.random.default_rng(np.random.SeedSequence([case.seed, 15])))
    s.velocity_weight = s.velocity_weight * (feedforward != "off")
    s.torque_weight = s.torque_weight * (feedforward == "velocity+torque")
    return s


def simulate(case: Case, machine: dict, test: TestRun, started_at_s: float = 0.0, substeps: int = SUBSTEPS) -> Trace:
    """Simulate one run of a case, on set points rounded as they are recorded."""
    unit = np.array([1e3] * 3 + [180.0 / math.pi] * 2)
    every = round(sample_period_of(machine) / PERIOD) if test.period_s is None else 1
    points = np.round(test.set_points[::every] * unit, DECIMALS["setpoint"][0]) / unit
    base = case.seed if case.noise_seed is None else case.noise_seed
    noise = np.random.SeedSequence([base, 30, zlib.crc32(test.name.encode())])
    return run(settings_for(case, machine, test.feedforward), points, noise, started_at_s, substeps, case.noise, test.period_s)


def sample_period_of(machine: dict) -> float:
    """Sample period of the record [s], a multiple of PERIOD."""
    return float(machine["measurement"]["sample_period_us"]) * 1e-6


def behaves(case: Case, machine: dict) -> bool:
    """Are the control loops stable? In a short move of all axes the current must not oscillate, and it must settle at the end."""
    limits = limits_of(machine)
    start, reach = np.array([0.0, 0.0, 0.0, -0.6, 0.0]), np.array([0.06, 0.06, 0.06, 0.3, 0.5])
    columns = [
        path_of(
            start[k], [start[k] + reach[k], start[k]], [0.6 * limits.speed[k]] * 2, 0.7 * limits.acceleration[k], 0.97 * limits.jerk[k], 0.1
        )
        for k in range(len(AXES))
    ]
    move = TestRun("stability", "test", "velocity+torque", together(columns, tail=0.4))
    try:
        trace = simulate(replace(case, noise=False), machine, move, substeps=4)
    except PlantError:
        return False
    tail = round(0.4 / sample_period_of(machine))
    moving, standing = (np.diff(trace.true_current[part], axis=0).std(axis=0) for part in (slice(0, -tail), slice(-tail // 4, None)))
    peak = np.array([machine["axis"][a]["motor"]["peak_current_a"] for a in AXES])
    error = np.abs(trace.position - trace.setpoint).max(axis=0)
    return bool((standing < 0.01 * peak).all() and (moving < 0.05 * peak).all() and (error < [5e-3] * 3 + [math.radians(2.5)] * 2).all())


def what_lacks(machine: dict) -> str | None:
    """Why the plant cannot be built from a machine's table, or cannot play the programme; None if it can."""
    try:
        if not math.isclose(us := machine["measurement"]["sample_period_us"], 1e6 * PERIOD):
            return f"sample_period_us = {us:g}; the programme has set points every {1e6 * PERIOD:g} us"
        peaks_of(machine, draw_factors(np.random.default_rng(0), 0.0), runs_of(machine, 0, "all"))
    except (KeyError, ValueError) as error:
        return str(error)
    return None


def peaks_of(machine: dict, factors: dict, runs: list[TestRun]) -> tuple[np.ndarray, np.ndarray]:
    """(largest current [A], largest positive speed) of each axis over the runs, from inertia, friction and gravity alone."""
    s = settings_of(machine, factors)
    mass, pair = load_of(s) + s.motor_mass, pair_of(machine, factors)
    current, speed = np.zeros(5), np.zeros(5)
    for r in runs:
        if r.name == "chirp":  # its high frequencies exceed the bandwidth of the loops
            continue
        v = np.gradient(r.set_points, PERIOD, axis=0)
        force = mass * np.gradient(v, PERIOD, axis=0) + s.viscous * v + s.coulomb * np.sign(np.round(v, 7))
        force[:, 2] += s.load_mass[2] * s.gravity
        a, c = r.set_points[:, 3], r.set_points[:, 4]
        dx, dy = pair[5] * np.cos(c) - pair[6] * np.sin(c), pair[5] * np.sin(c) + pair[6] * np.cos(c)
        force[:, 3] += s.gravity * (np.cos(a) * (pair[2] + pair[8] * pair[4] + dy) - np.sin(a) * (pair[3] + pair[7]))
        force[:, 4] += s.gravity * np.sin(a) * dx
        current = np.maximum(current, np.abs(force * s.ratio / s.kt).max(axis=0))
        speed = np.maximum(speed, v.max(axis=0))
    return current, speed


def truth_of(case: Case) -> dict:
    """The truth: [[effect]] of the library, [[outside]] with their block, [parameter.*] factors, [case], and [[budget]] if present."""
    known = [dict(e) for e in case.effects if e["name"] in LIBRARY]
    other = [dict(e, block=OUTSIDE[e["name"]].block) for e in case.effects if e["name"] in OUTSIDE]
    return {
        "case": {"seed": case.seed, "kind": case.kind, "scale": case.scale, "wide": case.wide, "encoder_zero": case.encoder_zero},
        "effect": known,
        "outside": other,
        "parameter": {name: dict(table) for name, table in case.factors.items()},
        **({"budget": [dict(row) for row in case.budget]} if case.budget else {}),
    }


def columns_of(trace: Trace, signals: tuple[str, ...], axes: Collection[str] = AXES) -> dict[str, np.ndarray]:
    """Columns as recorded: mm, deg, A, rounded; `time [s]` first, then axis by axis."""
    columns = {"time [s]": np.round(trace.time, 6)}
    for k, axis in enumerate(AXES):
        unit, factor, place = ("mm", 1e3, 0) if k < 3 else ("deg", 180.0 / math.pi, 1)
        for signal in signals if axis in axes else ():
            unit_of = {"velocity": f"{unit}/s", "velocity_setpoint": f"{unit}/s", "current": "A"}.get(signal, unit)
            values = getattr(trace, signal)[:, k] * (1.0 if signal == "current" else factor)
            columns[f"{axis}.{signal} [{unit_of}]"] = np.round(values, DECIMALS[signal][place])
    return columns


def write_campaign(
    case: Case, folder: Path, machine: dict, *, runs: str | Sequence[TestRun] = "all", signals: str = "full", axes: Collection[str] = AXES
) -> list[str]:
    """Simulate a run set, or some runs, and write these axes of them to `folder` as a campaign without the truth; returns the file names."""
    folder.mkdir(parents=True, exist_ok=True)
    packing = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    lines, at, files = ['machine = "mikron_ucp710"\n'], 0.0, []
    for test in runs_of(machine, case.seed, runs) if isinstance(runs, str) else runs:
        trace = simulate(case, machine, test, at)
        files.append(f"{test.name}.parquet")
        pq.write_table(pa.table(columns_of(trace, SIGNALS[signals], axes)), folder / files[-1], **packing)
        lines.append(f'[[run]]\nfile = "{files[-1]}"\nfeedforward = "{test.feedforward}"\nstarted_at_s = {at:.3f}\n')
        at = round(at + len(trace.time) * sample_period_of(machine) + PAUSE_S, 3)
    partial = folder / "campaign.toml.partial"  # written last and whole: its presence marks a complete campaign
    partial.write_text("\n".join(lines), encoding="utf-8", newline="\n")
    partial.replace(folder / "campaign.toml")
    return files
