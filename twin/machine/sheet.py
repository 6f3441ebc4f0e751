"""The data sheet of a machine as text: axes, drives, loops, measuring systems."""

from collections.abc import Callable
import math

from twin.control.structures import IN_FLOW
from twin.machine.check import AxisCheck, Finding, unmeasured
from twin.machine.commented import UNSCALED
from twin.machine.machine import Axis, Machine
from twin.machine.sinumerik import CYCLE_UNIT_US, machine_data, with_plain_keys
from twin.simulation.summary import once, table
from twin.units import AXIS_UNITS


def sheet(machine: Machine) -> str:
    """All axes side by side, one number per row."""
    rows: list[list[str]] = []

    def row(name: str, unit: str, value: Callable[[Axis], str]) -> None:
        values = [value(axis) for axis in machine.axes]
        if any(v != "-" for v in values):
            rows.append([name, unit, *values])

    row("kind", "", lambda a: a.kind + (", direct" if a.drive == "direct" else ""))
    row("structure", "", lambda a: a.structure if a.actuator.winding else f"{a.structure} on a {a.effort}")
    row("travel", "mm, deg", _travel)
    to_degrees = {"linear": 1.0, "rotary": math.degrees(1.0)}
    row("highest speed", "m/min, deg/s", lambda a: _g(a.max_velocity * (60.0 if a.kind == "linear" else math.degrees(1.0))))
    row("acceleration", "m/s2, deg/s2", lambda a: _g(a.max_acceleration * to_degrees[a.kind]))
    row("jerk", "m/s3, deg/s3", lambda a: _g(a.max_jerk * to_degrees[a.kind]))
    row("lead, gear", "mm/rev, 1", _gear)
    if any(a.force_unit for a in machine.axes):
        row("unit of forces", "in place of N, Nm", lambda a: a.force_unit or "-")
    row("moving mass", "kg", lambda a: _g(a.moving_mass_kg))
    row("rotor inertia", "kg m2", lambda a: _g(a.rotor_inertia_kg_m2 or None))
    row("Coulomb friction", "N, Nm", lambda a: _g(a.coulomb_friction))
    row("viscous friction", "N s/m, Nm s/rad", lambda a: _g(a.viscous_friction))
    row("torque constant", "Nm/A (N, V)", lambda a: _g(a.motor.torque_constant_nm_per_a) if a.has_constant else "-")
    row("limit of the command", "A, V, Nm", lambda a: f"{_g(a.motor.peak_current_a)} {a.effort_unit}")
    row("bus voltage", "V", lambda a: _g(a.motor.bus_limit_v))
    for p in sorted((p for p in IN_FLOW if p.shown), key=lambda p: not p.bounds.above):  # gains, then weights and delays
        row(p.shown[0], p.shown[1], lambda a, p=p: p.text(a.loops))  # type: ignore[misc,index]
    row("loop closed on", "", lambda a: a.encoder)
    row(
        "friction on", "", lambda a: a.friction_side + (f", {a.other_side_friction:.0%} on the other side" if a.other_side_friction else "")
    )
    stiffness = {"linear": 1e-6, "rotary": 1e-3}
    row("pre-sliding stiffness", "N/um (Nm/mrad)", lambda a: _g(a.presliding_stiffness * stiffness[a.kind] or None))
    row("structural mode", "Hz", lambda a: _g(a.mode_frequency_hz) if a.mode_mass_share else "-")
    row("further blocks", "", lambda a: "; ".join(listed.text(a.kind) for listed in a.blocks) or "-")
    cycles = {"position": machine.position_cycle, "speed": machine.speed_cycle}
    if any(a.actuator.cycle for a in machine.axes):
        cycles["current"] = machine.current_cycle
    lines = [
        f"{machine.name}: {len(machine.axes)} axes, model {machine.model_path.name}, gravity {machine.gravity:g} m/s2",
        "cycles: " + ", ".join(f"{name} {value * 1e6:g} us" for name, value in cycles.items()),
        "",
        table(["", "unit", *machine.axis_names], rows, left=2),
        *(
            f"{word}{', not measured' * (word != UNSCALED)}: {axis and f'{axis}: '}{', '.join(names)}"
            for (word, axis), names in unmeasured(machine).items()
        ),
    ]
    return "\n".join(lines)


def sinumerik_sheet(machine: Machine) -> str:
    """Machine data of all axes as a TOML for `twin machine new --sinumerik` and `[axis.X.sinumerik]`."""
    lines = [
        f"# {machine.name}: machine data of a SINUMERIK 840D with 611D drives",
        f"# MD1000 CURRCTRL_CYCLE_TIME = {machine.current_cycle * 1e6 / CYCLE_UNIT_US:g}, MD1001 SPEEDCTRL_CYCLE_TIME = "
        f"{machine.speed_cycle * 1e6 / CYCLE_UNIT_US:g} (in 31.25 us); position cycle {machine.position_cycle * 1e3:g} ms",
    ]
    for axis in machine.axes:
        lines += ["", f"[{axis.name}]"]
        if not axis.actuator.winding:
            lines.append(f"# {axis.structure} on a {axis.effort}: not a drive of a SINUMERIK")
            continue
        plain = machine.document["axis"][axis.name]
        data = machine_data(with_plain_keys(plain, f"[axis.{axis.name}]") if "sinumerik" in plain else plain)
        width = max(len(f"{d.label} = {v:.10g}") for d, v in data)
        lines += [f"{f'{d.label} = {v:.10g}':{width}}  # {d.name} [{d.unit}]" for d, v in data]
    return "\n".join(lines)


def check_text(checks: list[AxisCheck], findings: list[Finding]) -> str:
    """Margins of all loops, numbers of the drives, and the findings."""
    rows = []
    for c in checks:
        for loop, m in zip(c.loops, c.margins):
            rows.append(
                [
                    c.axis.name,
                    loop.name,
                    _g(m.crossover),
                    f"{m.phase:.0f} deg" if math.isfinite(m.phase) else "-",
                    f"{20.0 * math.log10(m.gain):.1f} dB" if math.isfinite(m.gain) else "-",
                    _g(m.bandwidth),
                    f"{m.peak:.2f}",
                    "yes" if m.stable else "NO",
                ]
            )
    drives = [
        [
            c.axis.name,
            f"{c.inertia:.3g}",
            f"{c.inertia_ratio:.2f}" if math.isfinite(c.inertia_ratio) else "-",
            f"{c.holding:.3g} {c.axis.effort_unit}",
            f"{c.accelerating:.3g} of {c.axis.motor.peak_current_a:g} {c.axis.effort_unit}",
            f"{c.voltage:.3g} of {c.axis.motor.bus_limit_v:g} V" if math.isfinite(c.axis.motor.bus_limit_v) else "-",
            f"{c.first_mode_hz:.0f} Hz" if c.first_mode_hz else "unknown",
        ]
        for c in checks
    ]
    parts = [
        table(["axis", "loop", "crossover [Hz]", "phase margin", "gain margin", "bandwidth [Hz]", "peak", "stable"], rows, left=2),
        table(
            ["axis", "inertia at the motor [kg m2, kg]", "load/rotor", "holding", "full acceleration", "highest speed", "first mode"],
            drives,
        ),
    ]
    said = once(((f.level, f.text), f.axis) for f in findings)
    lines = [f"{level}: {axes and f'{axes}: '}{text}" for (level, text), axes in said.items()]
    parts.append("\n".join(lines) or "nothing is missing, impossible or unusual")
    return "\n\n".join(parts)


def _travel(axis: Axis) -> str:
    factor = AXIS_UNITS[axis.kind].position[1]
    return f"{axis.travel[0] * factor:.6g} .. {axis.travel[1] * factor:.6g}" if math.isfinite(axis.travel[0]) else "endless"


def _gear(axis: Axis) -> str:
    if axis.kind == "linear":
        return "-" if axis.drive == "direct" else _g(axis.ratio * 2.0 * math.pi * 1e3)
    return _g(1.0 / axis.ratio)


def _g(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.4g}"
