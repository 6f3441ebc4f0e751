"""Words and whole names of columns in the languages and controls that `names` reads, by what they mean."""

import re

WORDS = {
    "pos": "pos position positional lage weg winkel angle joint_position posn posizione posicion posicao",
    "vel": "vel velo velocity speed geschwindigkeit geschw drehzahl rpm vitesse velocita velocidad velocidade",
    "current": "current curr cur amp strom iq isq amps courant corrente corriente",
    "torque": "torque moment momenten drehmoment drehmomenten trq couple effort coppia",
    "voltage": "voltage volt spannung tension tensione tensao voltaje",
    "acceleration": "acc accel acceleration beschleunigung",
    "set": "set setpoint soll rsol sollwert cmd com command commanded des desired ref reference target nominal noml nom demand demanded control vorgabe fuehrung consigne commande profile comandata consigna goal referencia riferimento",
    "act": "act actual actl ist rist istwert enc encoder meas measured fb feedback geber fbk fdbk gemessen mesure mesuree reel reelle retour reale real present",
    "ffw": "ffw feedforward ff vorsteuerung precontrol",
    "error": "error err lag deviation following foll schleppfehler schleppabstand schlepp fehler abstand ferror diff regelabweichung lageabweichung erreur ecart poursuite errore erro",
    "motor": "mot motor moteur indirect rpm",
    "load": "se load direct second secondary scale",
    "disturbance": "disturbance pulses pulse stoerung storung",
    "limit": "lim limit limits limite grenze max maximum",
    "injected": "injected injection excitation anregung",
    "-": "after before filter filtered smoothed nach geglaettet gefiltert pct percent rec data record signal value val all active axis achse achs axe ax joint nck sd sema servo drive antrieb trace abs side stage slide carriage table simple amount amplifier all rel relative pid lr intern internal sctrl ictrl "
    "the wert werte momentenbildender momentenbildend drehmomentbildender de du la le l",
}  # fmt: skip
MEANS: dict[str, set[str]] = {}
for _role, _listed in WORDS.items():
    for _word in _listed.split():
        MEANS.setdefault(_word, set()).add(_role)
ARRAYS = {"positions": "pos", "velocities": "vel", "accelerations": "acceleration", "efforts": "torque", "effort": "torque"}
"""Arrays of the joints of a robot in the messages of ROS: `desired.positions0`."""
TERMS = {
    "指令": "command", "指令值": "command", "命令": "command", "目标": "target", "目標": "target", "设定": "set", "設定": "set", "给定": "set", "实际": "actual", "実": "actual",
    "反馈": "feedback", "フィードバック": "feedback", "位置": "position", "速度": "speed", "转速": "speed", "電流": "current", "电流": "current",
    "转矩": "torque", "扭矩": "torque", "力矩": "torque", "トルク": "torque", "电压": "voltage", "電圧": "voltage", "跟随误差": "following error",
    "偏差": "error", "误差": "error", "誤差": "error", "回授": "feedback", "回馈": "feedback", "电机": "motor", "モータ": "motor", "时间": "time", "時間": "time", "轴": "axis", "軸": "axis", "值": "value", "値": "value",
}  # fmt: skip
"""Chinese and Japanese terms of drives in English, which also identify the encoding of a text."""
TERM = re.compile("|".join(sorted(TERMS, key=len, reverse=True)))
LETTERS = {"s": "pos", "q": "pos", "qd": "vel", "qdd": "acceleration", "v": "vel", "n": "vel", "i": "current", "m": "torque", "tau": "torque",
            "u": "voltage", "a": "acceleration"}  # fmt: skip
"""Letters for a quantity; valid only beside a word for set point, actual value or feedforward."""
EXACT = {
    # SINUMERIK Edge
    "des_pos": ("setpoint", ""), "enc_pos": ("position", ""), "enc1_pos": ("motor_position", ""), "enc2_pos": ("position", ""),
    "cmd_speed": ("velocity_setpoint", ""), "vel_ffw": ("velocity_feedforward", ""), "torque_ffw": ("torque_feedforward", "Nm"),
    "torque": ("torque", "Nm"), "current": ("current", "A"), "load": ("", ""), "power": ("", ""), "cont_dev": ("", ""),
    # SINUMERIK trace: first (motor) and second (direct) encoder
    "measpos1": ("motor_position", ""), "measpos2": ("position", ""),
    # HEIDENHAIN oscilloscope
    "v (act rpm)": ("velocity", "mm/min"), "v (nom rpm)": ("velocity_setpoint", "mm/min"), "v (n act)": ("velocity", "mm/min"),
    "v (n noml)": ("velocity_setpoint", "mm/min"), "i (int rpm)": ("", ""), "s diff": ("following_error", ""), "pos. diff.": ("", ""),
    "pos. diff": ("", ""), "feed rate": ("", ""), "lag": ("following_error", "um"), "droop pulses": ("following_error", ""), "p mech.": ("", ""),
    # ODrive: turns of the motor
    "input_pos": ("setpoint", "rev"), "pos_estimate": ("position", "rev"), "vel_estimate": ("velocity", "rev/s"), "iq_setpoint": ("current_setpoint", "A"),
    # B&R: units of the axis, turns of the motor
    "pctrl s set": ("setpoint", ""), "pctrl s act": ("position", ""), "pctrl lag error": ("following_error", ""),
    # robots
    "tau": ("torque", ""), "q_d": ("setpoint", ""), "dq": ("velocity", ""), "dq_d": ("velocity_setpoint", ""), "tau_j": ("torque", "Nm"), "tau_j_d": ("torque_setpoint", "Nm"),
    # KUKA RSI
    "aspos": ("setpoint", "deg"), "aipos": ("position", "deg"), "macur": ("current", ""),
    # FANUC SERVO GUIDE
    "posf": ("position", ""), "vcmd": ("velocity_setpoint", ""), "tcmd": ("torque_setpoint", ""),
    # currents that make the torque, and those that do not
    "i q": ("current", ""), "i d": ("", ""), "q_a": ("current", "A"), "d_a": ("", ""),
    # EMPS benchmark: names used in robot identification
    "qg": ("setpoint", "m"), "qm": ("motor_position", "m"), "vir": ("voltage", "V"),
}  # fmt: skip
PARTS = (
    "drehmomenten", "drehmoment", "momenten", "moment", "geschwindigkeits", "geschwindigkeit", "drehzahl", "beschleunigungs", "beschleunigung",
    "positions", "position", "winkel", "lage", "strom", "spannungs", "spannung", "motor", "achs", "soll", "ist", "werte", "wert", "schlepp", "abstand", "fehler",
)  # fmt: skip
