"""What is known about each effect: what helps at the machine, what in the control, what gets worse, and what no setting cures.

Facts from manuals of controls and publications; the grade is that of the control remedy: A manual or source code, B secondary source,
C general knowledge. `with_scale` and `with_motor_encoder` say which functions of a control can help, by where the position loop measures:
with a direct scale play, lead and wind-up are inside the loop, and a backlash value or a lead table would move the table by what was never
wrong.
"""

from dataclasses import dataclass

from twin.effects import Effect

SET_BACK = "set_back"
"""The function that undoes a deviation of the control from its commissioned value."""
PULSE, BACKLASH, TABLE, GAIN = "friction_pulse", "backlash_value", "position_correction", "position_gain"
OFFSET = "touch the zero of the part again once the value is entered, or half of it stays as an offset"
"""Consequence of a backlash value for a part that is clamped already."""


@dataclass(frozen=True)
class Advice:
    """Advice on one effect.

    machine     what to do at the machine, and how to check it by hand; '' for nothing
    with_scale, with_motor_encoder   functions of the control that can help
    refused     why no setting of the control cures it, if none does
    worse       what gets worse
    """

    machine: str
    with_scale: tuple[str, ...] = ()
    with_motor_encoder: tuple[str, ...] = ()
    refused: str = ""
    worse: str = ""
    grade: str = "C"

    def functions(self, encoder: str) -> tuple[str, ...]:
        """Functions that can help where this encoder closes the position loop: 'scale' or 'motor'."""
        return self.with_scale if encoder == "scale" else self.with_motor_encoder


def _control(worse: str, machine: str = "", grade: str = "A") -> Advice:
    return Advice(machine, (SET_BACK,), (SET_BACK,), "", worse, grade)


LUBRICATION = "lubrication, preload of the guides, wipers and covers; push the axis by hand or compare the holding current at creeping speed in both directions"

ADVICE: dict[str, Advice] = {
    "position_gain": _control("too high: overshoot and vibration; all axes that interpolate need the same gain"),
    "velocity_feedforward": _control("above 1: overshoot at a stop"),
    "torque_feedforward": _control("too much: error of the other sign and more excitation; the inertia changes with the workpiece"),
    "loop_delay": _control("a delay below the true one of the loop overshoots; all axes alike, or contours suffer"),
    "set_point_filter": _control("less filter excites vibrations; unequal filters of axes give contour errors"),
    "speed_gain": _control("too high: noise and resonance; filters first", "check coupling and mounting of the motor"),
    "speed_integral_time": _control("too short: overshoot; the decay of a friction pulse must follow"),
    "current_filter": _control("the resonance that it hides returns: check it first", "find and damp the resonance"),
    "current_limit": Advice(
        "power module, cooling and motor: read their limit on the nameplate",
        (SET_BACK,), (SET_BACK,), worse="a limit above that of the hardware destroys it; lower acceleration or jerk instead", grade="C",
    ),
    "torque_constant": Advice(
        "motor data, temperature and magnets: compare the holding current of a known weight",
        refused="the motor is weaker than its data; correct the motor data after checking them", worse="wrong gains after the motor is replaced",
    ),
    "coulomb_friction": Advice(LUBRICATION, (PULSE,), (PULSE,), worse="when friction falls the pulse is too large: dents after reversals", grade="A"),
    "stribeck": Advice(f"way oil, stick-slip inserts, seals; {LUBRICATION}", (PULSE,), (PULSE,), worse="fast reversals are overcompensated", grade="A"),
    "presliding": Advice("preload of rollers, seals", (PULSE,), (PULSE,), worse="a pulse over time fits one acceleration: overshoot at other feeds", grade="A"),
    "viscous_friction": Advice("viscosity of the oil, warm-up; compare the current at rapid, cold and warm", refused="the integrator of the speed controller carries it at constant speed"),
    "viscous_asymmetry": Advice("hoses, hydraulics, lubrication by side", refused="no control in reach has a viscous term by direction"),
    "position_dependent_friction": Advice(
        "screw, nut, guide, bellows at the place of the largest current; move the axis slowly over its travel and plot the current",
        (PULSE,), (PULSE,), worse="one amplitude over- and undercompensates along the travel", grade="C",
    ),
    "constant_force": Advice(
        "pressure of the counterbalance, cable chain; compare the current up and down", refused="the integrator carries it: it costs current, not contour"
    ),
    "inertia": Advice("lighter fixture or carriage", (SET_BACK,), (SET_BACK,), worse="other workpieces need another parameter set", grade="A"),
    "table_unbalance": Advice("balance the fixture: turn the table slowly and read the current over its angle", refused="sine of the angle is in no constant; the static part is integrated away"),
    "torque_ripple": Advice("motor, calibration of the current sensors", refused="above the bandwidth no setting helps; a cogging table of the drive may"),
    "backlash": Advice(
        "preload of the nut, bearings, coupling, gear: hold a dial gauge against the table and push it both ways",
        (PULSE,), (BACKLASH,), worse="where nothing holds one flank the table wanders through the play; after wear the entered numbers are wrong again", grade="A",
    ),
    "transmission_compliance": Advice("stiffer screw, bearings, coupling; shorter path of force", refused="the first mode caps the gains; only lower gains or a bandstop avoid exciting it"),
    "lead_error": Advice("screw; measure with a laser or length gauges, warm", (), (TABLE,), refused="the scale is in the loop: the table moves as commanded", worse="a cold table on a warm machine", grade="A"),
    "cyclic_error": Advice("bearings and wobble of the screw, worm", (), (TABLE,), refused="the scale is in the loop; what remains is above its bandwidth", worse="wrong after the encoder is mounted again", grade="A"),
    "encoder_eccentricity": Advice("centre the disc, or use two reading heads", (TABLE,), (), worse="wrong after the encoder is mounted again", grade="A"),
    "frame_vibration": Advice("levelling, anchors, mass of the bed", refused="the scale sees it and the motor cannot stop it; less jerk only avoids exciting it"),
    "thermal_drift": Advice("warm-up, cooling, scale instead of motor encoder", refused="needs a temperature that the PLC reads, not a time; which side drifts must be known"),
    "cross_axis_coupling": Advice("drive at the centre of mass, guides", refused="no acceleration coupling between axes on this control; less jerk"),
    "periodic_disturbance": Advice("find pump, fan or neighbour by switching them off one by one", refused="above the bandwidth no setting helps"),
    "law": Advice("look for the cause where the diagnosis puts it", refused="a law without a known cause has no known remedy"),
}  # fmt: skip
"""Advice by effect. Every effect of the library has an entry (a test keeps it so); the effects of the blocks of a control share OF_A_BLOCK."""

OF_A_BLOCK = _control("a compensation that was tuned for another state of the machine is wrong again: check it on a circle")
OF_A_USER = Advice("", refused="an effect of your own has no known remedy")


def advice_on(effect: Effect) -> Advice:
    """The advice on an effect."""
    return OF_A_BLOCK if effect.block_of_control else ADVICE.get(effect.name, OF_A_USER)
