"""Known physical causes of measured laws, each with a sentence and a measurement that confirms it.

An entry matches a law by output and variable, and optionally by shape and sign of its height. It is a possible cause, not a result
of the diagnosis.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Known:
    """A physical cause: the laws that it matches, its description, and the measurement that confirms it."""

    name: str
    output: str
    variables: tuple[str, ...]
    sentence: str
    to_be_sure: str
    shapes: tuple[str, ...] = ()
    sign: int = 0


KNOWN = (
    Known("slide way with plastic lining", "friction", ("speed",), "Plastic-lined slide ways have less friction at low speed than at high speed.",
          "constant speeds from 0.1 mm/s up, before and after lubrication", ("gaussian", "exponential"), -1),
    Known("mixed lubrication", "friction", ("speed",), "At low speed the oil film breaks down and friction rises (Stribeck).",
          "constant speeds from 0.1 mm/s up, cold and warm", ("gaussian", "exponential"), 1),
    Known("drag that grows with speed", "friction", ("speed",),
          "Churning of oil or grease, or air drag, grows more than linearly with speed.", "constant speeds up to rapid traverse", ("power",)),
    Known("wiper seal or cover", "friction", ("position",), "A bellows, cover plate or seal rubs on part of the travel.",
          "a slow stroke over the whole travel, with and without the cover"),
    Known("preload that changes along the screw", "friction", ("position", "turn"),
          "The preload of the nut on a worn or bent screw varies along the travel.", "a slow stroke in both directions"),
    Known("friction under load", "friction", ("acceleration_size",), "Acceleration loads the guides, because the drive force does not act at the centre of mass.",
          "the same stroke at several accelerations"),
    Known("warm-up", "friction", ("time",), "Warming grease lowers friction over minutes; a warming screw raises preload and friction.",
          "the same slow stroke each minute after a cold start", ("approach", "line", "exponential")),
    Known("cable chain", "force", ("direction", "position"), "A cable chain or hose pulls against the motion; after a reversal, the force builds up over some travel.",
          "reversals after strokes of 1 to 200 mm, with the chain unhooked"),
    Known("gas spring or counterbalance", "force", ("position",), "The force of an enclosed gas or a spring depends on its compression.",
          "holding still at several positions", ("gas spring", "line")),
    Known("cogging", "force", ("turn",), "The detent torque of a motor depends on the rotor angle.", "constant speeds below one turn a second", ("sine",)),
    Known("coupling to another axis", "force", ("position", "velocity", "acceleration"), "The motion of another axis exerts a force on this axis.",
          "a run in which only the other axis moves"),
    Known("drag in one direction", "force", ("speed", "time"), "Friction depends on the direction, or a force drifts.",
          "the same stroke again after a pause"),
    Known("magnetic saturation", "torque", ("current",), "The iron of a motor saturates: torque per ampere falls at high current.",
          "accelerations from gentle to the limit", ("bending", "saturation", "power")),
    Known("dead time of the inverter", "voltage", ("current",),
          "Both transistors of a half bridge are off for some microseconds: the voltage error has the sign of the current.",
          "the dead time compensation of the drive; a slow stroke with many sign changes of the current", ("saturation", "stage"), -1),
    Known("spring that hardens", "force", ("windup",), "The stiffness of balls and bearings rises with the load.",
          "motor minus scale over the current, at accelerations from gentle to the limit", ("power",), 1),
    Known("soft stage in the drive train", "force", ("windup",),
          "A worn coupling, a belt or a lost preload is soft until the stiff part carries the load.",
          "motor minus scale over a slow and a fast reversal", ("stage", "saturation")),
    Known("loose encoder coupling", "displacement", ("slack",), "After a reversal, the scale follows only when the play is taken up.",
          "micro-reversals of 1 to 50 um against a dial gauge or an interferometer"),
    Known("interpolation of the scale", "displacement", ("position",), "The two signals of a scale are unequal: an error with the period of the grating.",
          "a very slow stroke over a few lines", ("sine",)),
    Known("pitch or tilt of the carriage", "displacement", ("position",), "A pitching carriage moves the scale and the tool by different distances.",
          "an interferometer at the tool point"),
    Known("scale that warms", "displacement", ("time",), "A scale or a screw expands as it warms up.", "the same position each minute after a cold start"),
    Known("irregular sampling of the scale", "displacement", ("speed",),
          "The control reads the scale at irregular times; the error is speed times the deviation in time.",
          "the clock of the encoder interface; strokes at several constant speeds", ("jitter",)),
    Known("dead band of the control", "speed", ("following_error",), "The control does not react to a following error below a band.",
          "steps of 1 to 20 um at rest", ("dead band",)),
    Known("filter in the drive", "current", ("current_setpoint",),
          "A drive filters its current set point, often against a resonance of the mechanics.",
          "the drive's list of current set point filters; the speed controller's frequency response", ("notch", "lag")),
    Known("computing time of the drive", "current", ("current_setpoint",), "A drive outputs its current set point some cycles late.",
          "the speed controller's frequency response: a phase that falls in proportion to the frequency", ("dead time",)),
    Known("current that is recorded late", "current", ("current",), "The trace records the current later than the other signals.",
          "a current and a position recorded by an oscilloscope, or a trace in the drive itself", ("dead time", "lag")),
    Known("response of the drive", "torque", ("current",), "The drive delivers the commanded torque late: its own current loop takes time.",
          "the motor current beside the command, by an oscilloscope or a trace in the drive", ("lag", "dead time")),
    Known("smoothed speed set point", "received_speed", ("speed_setpoint",), "A drive smooths its speed set point.",
          "the drive's list of speed set point filters", ("lag",)),
    Known("transfer from control to drive", "received_speed", ("speed_setpoint",), "The speed set point reaches the drive some cycles late.",
          "the bus cycle, and a trace of the set point on both sides", ("dead time",)),
    Known("speed limit in the drive", "speed", ("speed_setpoint",), "The limit of the speed set point is too low.",
          "a stroke at rapid traverse in both directions", ("clip above", "clip below", "clip")),
)  # fmt: skip


def known_causes(output: str, variable: str, shape: str | None, sign: int) -> tuple[Known, ...]:
    """Entries that match a law: those with its shape, or else those without a shape."""
    suited = [k for k in KNOWN if k.output == output and variable in k.variables and k.sign in (0, sign)]
    exact = [k for k in suited if shape in k.shapes]
    return tuple(exact or [k for k in suited if not k.shapes or shape is None])
