"""What of the known physics looks like a measured law: a sentence each, and what to measure to be sure.

An entry suits a law by its output and variable, and where given by its shape and the sign of its height. It names what is known to look like
that; it is no finding.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Known:
    """A piece of physics: which laws it looks like, what it is, what would tell."""

    name: str
    output: str
    variables: tuple[str, ...]
    sentence: str
    to_be_sure: str
    shapes: tuple[str, ...] = ()
    sign: int = 0


KNOWN = (
    Known("slide way with plastic lining", "friction", ("speed",), "Lined slide ways have less friction at creep than in motion.",
          "constant speeds from 0.1 mm/s up, before and after lubrication", ("gaussian", "exponential"), -1),
    Known("mixed lubrication", "friction", ("speed",), "At low speed the oil film breaks and the friction rises (Stribeck).",
          "constant speeds from 0.1 mm/s up, cold and warm", ("gaussian", "exponential"), 1),
    Known("drag that grows with speed", "friction", ("speed",),
          "Churned oil or grease, or air, brakes more than in proportion to the speed.", "constant speeds up to rapid traverse", ("power",)),
    Known("wiper seal or cover", "friction", ("position",), "A bellows, a cover plate or a seal rubs on a part of the travel.",
          "a slow stroke over the whole travel, with and without the cover"),
    Known("preload that changes along the screw", "friction", ("position", "turn"),
          "A screw that is worn or bent loads its nut differently along the travel.", "a slow stroke in both directions"),
    Known("friction under load", "friction", ("acceleration_size",), "Acceleration presses on the guides beside the centre of mass.",
          "the same stroke at several accelerations"),
    Known("warm-up", "friction", ("time",), "Grease thins as it warms: friction falls over minutes; preload grows as a screw warms: it rises.",
          "the same slow stroke each minute after a cold start", ("approach", "line", "exponential")),
    Known("cable chain", "force", ("direction", "position"), "A chain or hose pulls against the motion once it has turned over, after some travel.",
          "reversals after strokes of 1 to 200 mm, with the chain unhooked"),
    Known("gas spring or counterbalance", "force", ("position",), "An enclosed gas or a spring pushes by how far it is compressed.",
          "holding still at several positions", ("gas spring", "line")),
    Known("cogging", "force", ("turn",), "The rotor of a motor prefers some angles.", "constant speeds below one turn a second", ("sine",)),
    Known("coupling to another axis", "force", ("position", "velocity", "acceleration"), "What another axis does pushes on this one.",
          "the other axis alone in motion"),
    Known("drag in one direction", "force", ("speed", "time"), "Friction that differs by direction, or a force that drifts.",
          "the same stroke again after a pause"),
    Known("magnetic saturation", "torque", ("current",), "The iron of a motor saturates: at high current it makes less torque an ampere.",
          "accelerations from gentle to the limit", ("bending", "saturation", "power")),
    Known("dead time of the inverter", "voltage", ("current",),
          "Between two transistors of a bridge both are off for some microseconds: a voltage that turns with the current is missing.",
          "the drive's compensation of its dead time; a slow stroke, at which the current changes sign often", ("saturation", "stage"), -1),
    Known("spring that hardens", "force", ("windup",), "Balls and bearings grow stiffer the more they are pressed.",
          "motor minus scale over the current, at accelerations from gentle to the limit", ("power",), 1),
    Known("soft stage in the drive train", "force", ("windup",),
          "A worn coupling, a belt or a preload that is lost gives way easily before the stiff part takes over.",
          "motor minus scale over a slow reversal and over a hard one", ("stage", "saturation")),
    Known("loose encoder coupling", "displacement", ("slack",), "The scale follows only after a play when the motion turns round.",
          "micro-reversals of 1 to 50 um against a dial gauge or an interferometer"),
    Known("interpolation of the scale", "displacement", ("position",), "The two signals of a scale are unequal: a wave each line of its grating.",
          "a very slow stroke over a few lines", ("sine",)),
    Known("pitch or tilt of the carriage", "displacement", ("position",), "A carriage that pitches shows its scale another way than its tool.",
          "an interferometer at the tool point"),
    Known("scale that warms", "displacement", ("time",), "A scale or a screw grows as it warms.", "the same position each minute after a cold start"),
    Known("dead band of the control", "speed", ("following_error",), "A control that answers no following error below a band.",
          "steps of 1 to 20 um at rest", ("dead band",)),
    Known("filter in the drive", "current", ("current_setpoint",),
          "A drive filters its current set point, often against a resonance of the mechanics.",
          "the drive's list of current set point filters; the speed controller's frequency response", ("notch", "lag")),
    Known("computing time of the drive", "current", ("current_setpoint",), "A drive gives its current set point some cycles late.",
          "the speed controller's frequency response: a phase that falls in proportion to the frequency", ("dead time",)),
    Known("current that is recorded late", "current", ("current",), "The trace shows the current later than the other signals.",
          "a current and a position recorded by an oscilloscope, or a trace in the drive itself", ("dead time", "lag")),
    Known("smoothed speed set point", "received_speed", ("speed_setpoint",), "A drive smooths its speed set point.",
          "the drive's list of speed set point filters", ("lag",)),
    Known("transfer from control to drive", "received_speed", ("speed_setpoint",), "A speed set point arrives some cycles late in the drive.",
          "the bus cycle, and a trace of the set point on both sides", ("dead time",)),
    Known("speed limit in the drive", "speed", ("speed_setpoint",), "A limit of the speed set point that is set too low.",
          "a stroke at rapid traverse in both directions", ("clip above", "clip below", "clip")),
)  # fmt: skip


def looks_like(output: str, variable: str, shape: str | None, sign: int) -> tuple[Known, ...]:
    """The entries that suit a law, those of its very shape first."""
    suited = [k for k in KNOWN if k.output == output and variable in k.variables and k.sign in (0, sign)]
    exact = [k for k in suited if shape in k.shapes]
    return tuple(exact or [k for k in suited if not k.shapes or shape is None])
