"""Meaning of column names as controls and instruments write them: axis, signal, unit.

Known names: SINUMERIK (Edge: `DES_POS|1`; trace: `nckServoDataCmdPos64 [u1, 1]`; `Lagesollwert X`), HEIDENHAIN's oscilloscope
(`s noml`, `V (ACT RPM)`, `I nominal`), LinuxCNC's halscope (`joint.0.motor-pos-cmd`), drives with their parameter numbers (`r63: Actual speed value`,
`0x6064 Position actual value`), plain words in English, German, French, Chinese and Japanese. A name is split into words, German compounds into their
parts, accents are dropped. A single unknown word makes the name unknown. Of a path (`MAIN.axis.fActPos`, `/reference/joint_1/position`) the last part
counts; the parts before it state the axis, and whether the value is commanded or measured. The data decide what a name leaves open (mm or deg).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
import re
import unicodedata

from twin.recordings.signals import known_unit
from twin.recordings.words import ARRAYS, EXACT, LETTERS, MEANS, PARTS, TERM, TERMS
from twin.units import dimension_recorded

_TYPE = re.compile(r"^(?:lr|[fnrx])(?=[A-Z][a-z])")
"""Type of a variable of a PLC before its name: fActPos, lrSetVelo."""
_CODE = re.compile(r"^(?:[rp]\d{2,5}(?:\[\d+\])?|[SP]-\d-\d{4}|0x[0-9A-Fa-f]{4}|[0-9A-Fa-f]{4}h)(?::\d+)?\s*[:,._ -]\s*(?=\S)")
"""Number of a parameter of a drive (SINAMICS, SERCOS), or of an object of CiA 402, before its name."""
_NODE = re.compile(r'^ns=\d+;[isgb]=|(?<![^.;=])"|"(?![^.])')
"""Name space of a node of OPC UA, and the quotes about each part of its path: ns=3;s="DB_X"."SetPosition"."""
_SIGNALS = {
    "pos": ("setpoint", "position"), "vel": ("velocity_setpoint", "velocity"), "current": ("current", "current"),
    "torque": ("torque_setpoint", "torque"), "voltage": ("voltage", "voltage"), "acceleration": ("acceleration", "acceleration"),
}  # fmt: skip
"""Quantity -> signal if it is a set point, signal else."""

_OF_UNITS = {"speed": "vel", "angular speed": "vel", "turning speed": "vel", "current": "current", "torque": "torque", "voltage": "voltage"}
"""Dimension of a unit -> quantity, where the name gives none: 'VL.CMD (rpm)', 'Y1_I [A]'."""

_UNIT_ENDING = re.compile(
    r"_(deg_per_s|rad_per_s|mm_per_s|m_per_s|mm_per_min|deg_s|mm_s|deg|rad|mm|um|nm|rpm|ma|mv|m|a|v|n)$", re.IGNORECASE
)
_INDEX = re.compile(r"\s*(?:\(\s*(\d+)\s*\)|\|\s*(\w+)|\[\s*u?\d+\s*,\s*(\d+)\s*\]|\[\s*(\d+)\s*\])\s*$")
_COMPOUND = re.compile(rf"(?:{'|'.join(PARTS)}){{2,}}", re.IGNORECASE)
"""German compounds: Lagesollwert, Istdrehzahl, Motorstrom."""
_PART = re.compile("|".join(PARTS), re.IGNORECASE)
_AXIS = re.compile(r"[XYZABCUVW]\d?", re.IGNORECASE)
_OF_AXIS = re.compile(rf"(.+\)) ({_AXIS.pattern})", re.IGNORECASE)
"""A name in brackets, then its axis: 'V (N ACT) X'."""


_NUMBERED = "axis|achse|axe|joint|drive|antrieb|motor|ax|j"
_LABELS = (
    re.compile(r"[(\[|]\s*(?:u\d+\s*,\s*)?(\d{1,2})\s*[)\]]?\s*$"),  # pos (5), tau[3], DES_POS|12
    re.compile(r"\[([XYZABCUVW]\d?)\](?=$|[./])"),  # aaAxis[X].sActualPos
    re.compile(r"^[^\d]*[./]([XYZABCUVW]\d?)$", re.IGNORECASE),  # A.FLWE.X
    re.compile(r"^([XYZABCUVWS]\d?)[_. ]", re.IGNORECASE),  # X1_ActualPosition
    re.compile(rf"(?:{_NUMBERED})[_. \[]?(\d{{1,2}})(?=[_. \]]|$)", re.IGNORECASE),  # axis2.speed, Motor[1].DesPos.a
    re.compile(r"[_. ]([XYZABCUVW]\d?)$", re.IGNORECASE),  # speed_X
    re.compile(r"[_.](\d{1,2})$"),  # target_q_0
)
"""Where the name of a column may state its axis: 'X1_ActualPosition', 'pos (5)', 'target_q_0', 'DES_POS|3', 'axis2.speed'."""

_BEHIND = re.compile(r"\s*[\[(][^\])]*[^\])\d][\])]\s*$")
"""Brackets behind a name that hold no index: 'DCOM(0) [%]'."""

_PATH_AXIS = re.compile(
    r"(?:(?:^|[._/])(?:(?:mc_)?axis|axes|achse|axe|joint|drive|antrieb|antriebsachse|motor)?[_ \[]?0{0,2}|\[(?=[A-Z]))(\d{1,2}|[XYZABCUVW]\d?)(?=$|[._/\]])",
    re.IGNORECASE,
)
_AXIS_WORD = re.compile(rf"(?:^|[^a-z])(?:{_NUMBERED}|axes|antriebsachse)[._ \[]*$", re.IGNORECASE)


@dataclass(frozen=True)
class Meaning:
    """Meaning of a column: axis, signal ("" for a known name that is not a signal of the twin), unit ("" if the name gives none).

    `rank`: of two columns with the same meaning, the lower rank is used. `plain`: the name says neither commanded nor measured.
    """

    axis: str
    signal: str
    unit: str
    rank: float = 0.0
    plain: bool = False


def english(text: str) -> str:
    """A name without the signs of an address, with its Chinese and Japanese terms in English."""
    return TERM.sub(lambda term: f" {TERMS[term[0]]} ", _NODE.sub("", text)).strip()


def without_shared_words(names: Collection[str]) -> dict[str, str]:
    """Name -> name without the unknown words that all of several names hold: ROBOT in `ROBOT_TARGET_POSITION_1` says nothing of one column.

    Names of nothing but unknown words, such as `Time`, do not count.
    """
    strange = {
        name: {w for w in _words(name) if len(w) > 1 and w.isalpha() and not _roles(w) and w.lower() not in LETTERS} for name in names
    }
    said = [own for name, own in strange.items() if _without(own, name)]
    shared = set.intersection(*said) if len(said) > 1 else set[str]()
    return {name: _without(shared, name) for name in names}


def _without(words: Collection[str], name: str) -> str:
    """A name without whole words: Left in 'left_torque', 'LeftTorque'."""
    whole = rf"(?<![A-Za-z])(?:{'|'.join(sorted(words))})(?![a-z])"
    return re.sub(whole, "", name).strip(" _-") if words else name


def compared(meanings: Mapping[str, Meaning], others: Mapping[str, str], only_axis: str) -> dict[str, Meaning]:
    """Column -> meaning, with what only the other names show. `others`: columns with names that mean nothing alone, and their units.

    Axis: where a signal occurs twice without one, it is the part of the names that stands with each signal once: `elbow/position`, `left_pos_cmd`, `position0`.
    Set point: of 'Position' and 'ActualPosition' it is the first.
    """
    bare = {name: (m, {*re.split(r"[./]", name)[:-1]} - {""}) for name, m in meanings.items() if not m.axis}
    for name, given in others.items():
        bare_name, unit = (name, given) if given else _without_unit(name)
        strange, last = _unknown_words(bare_name), re.split(r"[./]", bare_name)[-1]
        number = re.search(r"(?<=[a-z])\d{1,2}$", last) if not _unknown_words(last) else None
        part = number[0] if number else "_".join(strange)
        stem = re.sub("|".join(strange), "", bare_name.removesuffix(part) if number else bare_name)
        if part and not label_of(name) and (found := meaning_of(stem, unit, "")) and not found.axis:
            bare[name] = found, {part}
    under: dict[str, list[str]] = {}
    for name, (_, parts) in bare.items():
        for part in parts:
            under.setdefault(part, []).append(bare[name][0].signal)
    joints = {part: len(own) for part, own in under.items() if len(set(own)) == len(own) > 1}
    axes = {name: max(parts & joints.keys(), key=joints.__getitem__, default="") for name, (_, parts) in bare.items()}
    shared = [bare[name][0].signal for name, axis in axes.items() if axis]
    if len({*axes.values()} - {""}) < 2 or len({*shared}) == len(shared):  # 'PL.CMD', 'VL.CMD': the loops of one axis
        axes = {}
    out = {name: replace(m, axis=m.axis or axes.get(name) or only_axis) for name, m in meanings.items()}
    if only_axis and not any(m.signal in ("current", "torque") for m in meanings.values()):  # 'i' beside 'cmd' and 'act'
        out |= {name: Meaning(only_axis, "current", unit) for name, unit in others.items() if name.lower() == "i"}
    out |= {name: replace(bare[name][0], axis=axes[name]) for name in others if axes.get(name) and bare[name][0].signal}
    for signal, commanded in (("position", "setpoint"), ("velocity", "velocity_setpoint")):
        for axis in {m.axis for m in out.values()}:
            own = [n for n, m in out.items() if m.axis == axis and m.signal in (signal, commanded)]
            if len(own) == 2 and [out[n].signal for n in own] == [signal] * 2 and len(plain := [n for n in own if out[n].plain]) == 1:
                out[plain[0]] = replace(out[plain[0]], signal=commanded)
    return out


def _unknown_words(name: str) -> list[str]:
    """Words of a name that mean nothing here, single letters aside."""
    words = re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name))
    return [word for word in words if len(word) > 1 and not all(len(part) == 1 or _roles(part) for part in _words(word))]


def meaning_of(name: str, unit: str = "", only_axis: str = "X") -> Meaning | None:
    """Meaning of a name, or None. `unit` is given by the file. `only_axis`: axis of names that give none."""
    name = re.sub(r"(?i)(torque|drehmoment)[ -]*/[ -]*(?:force|kraft)", r"\1", _CODE.sub("", english(name)))
    path, last = _path_and_last(name)
    named = _axis_in(path)
    if path and _AXIS.fullmatch(last) and not (named and named[1].isdigit()):  # A.POS.X, but Motor[1].ActPos.a
        of_path = meaning_of(path, unit, "")
        return of_path and replace(of_path, axis=last.upper())
    axis = named[1].upper() if named else only_axis
    said = {part: [_roles(word) for word in _words(part)] for part in re.split(r"[./]", path)}
    before = [part for part, own in said.items() if all(own) and {"-"} < {"-"}.union(*own) <= {"set", "act", "error", "-"}]
    within = path and last[:1].isalpha()  # a variable of a program, a field of a message
    tries = [] if within and before else [name, _BEHIND.sub("", name)]  # brackets without a known unit belong to the name
    last = _CODE.sub("", last)
    if within:
        tries += [last] * (last.lower() in EXACT)
    if within or not path:
        tries.append(" ".join([*before, _TYPE.sub("", last)]))
    return next((found for one in tries if (found := _meaning_of(one, unit, axis)) is not None), None)


def _meaning_of(name: str, unit: str, only_axis: str) -> Meaning | None:
    plain = name.rpartition("/")[2].strip()
    index = _INDEX.search(plain)
    axis = ""
    if index:
        plain, axis = plain[: index.start()].strip(), next(filter(None, index.groups()))
    elif (of_axis := _OF_AXIS.fullmatch(plain)) is not None and of_axis[1].lower() in EXACT:  # the V is a speed, no axis
        plain, axis = of_axis[1], of_axis[2].upper()
    if (exact := EXACT.get(plain.lower())) is not None:
        # 'CURRENT|1' is of a SINUMERIK, 'current' of anyone
        return Meaning(axis or only_axis, exact[0], unit or (exact[1] if index or exact[0] not in ("current", "torque") else ""))
    if not unit:
        plain, unit = _without_unit(plain)
    words = _words(plain)
    if (by_word := EXACT.get(" ".join(w for w in words if not _AXIS.fullmatch(w)).lower())) is not None and len(words) > 1:
        letters = [w for w in words if _AXIS.fullmatch(w)]
        return Meaning(axis or (letters[-1].upper() if letters else only_axis), by_word[0], unit or by_word[1])
    return _of_words(words, axis, unit, only_axis)


def _words(text: str) -> list[str]:
    """Words of a name: 'nckServoDataCmdPos64', 'motor-pos-cmd', 'Lagesollwert X', 'rec.act_pos_mot'."""
    text = unicodedata.normalize("NFKD", text.replace("%", " percent ").replace("ü", "ue").replace("ö", "oe").replace("ä", "ae"))
    text = "".join(c for c in text if not unicodedata.combining(c))
    text = _COMPOUND.sub(lambda m: f" {' '.join(_PART.findall(m[0]))} ", text)
    text = re.sub(r"(?i)set[ _-]point", "setpoint", text)
    text = re.sub(r"(?i)torque[ -](?:generating|producing)", "", text)
    text = re.sub(r"(?i)f[ _-]error", "ferror", text)
    encoder = r"(?i)(?:(?:mess|measuring )system ?([12])|geber ?([12])|([12])(?:st|nd)enc)"  # first and second one of a SINUMERIK
    text = re.sub(encoder, lambda m: " motor " if "1" in m.groups() else " load ", text)
    text = re.sub(r"\b([XYZABCUVW]\d?)(?=(?:act|cmd|com|set|soll|ist|pos|vel|cur|frt|load)[a-z]{0,5}\b)", r"\1 ", text)  # Xact
    text = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=\d\d)", " ", text)
    return [w for w in re.split(r"[^A-Za-z0-9]+", text) if w]


def _roles(word: str) -> set[str]:
    """What a word says, also in the plural; empty for an unknown one."""
    low = word.lower()
    return next((MEANS[w] for w in (low, low.removesuffix("s"), re.sub("ies$", "y", low)) if w in MEANS), set())


def _of_words(words: list[str], axis: str, unit: str, only_axis: str) -> Meaning | None:
    roles: set[str] = set()
    letters: list[str] = []
    plain: list[str] = []
    for word in words:
        if known := _roles(word):
            roles |= known
        elif (array := re.fullmatch(r"([a-z]+)_?(\d{0,2})", word)) and array[1] in ARRAYS:
            roles.add(ARRAYS[array[1]])
            axis = axis or array[2]
        elif (numbered := re.fullmatch(rf"(?:{_NUMBERED})(\d{{1,2}})", word, re.IGNORECASE)) is not None:
            axis = axis or numbered[1]  # joint1_cmd
        elif word.isdigit():
            if len(word) == 1:
                axis = axis or word  # joint.0.motor-pos-cmd; two digits (64) are a number width
        elif (word.lower() in LETTERS and word.islower()) or (word in ("I", "M", "U") and not letters):
            letters.append(word.lower())
        elif _AXIS.fullmatch(word):
            axis = axis or word.upper()
        else:
            plain.append(word)
    if plain or len(letters) > 2:
        return None
    # a letter is a quantity if no word is one, else an axis: 'v actual', 'pos cmd a'
    measured = _of_unit(unit)
    quantity = LETTERS[letters[0]] if letters else ""
    alone = bool(axis) and not roles and quantity == "current"  # 'x_i' beside 'x_cmd'
    if letters and not roles & set(_SIGNALS) and (roles & {"set", "act", "ffw"} or alone or (measured and measured == quantity)):
        roles.add(LETTERS[letters.pop(0)])
        letters = [letter for letter in letters if LETTERS.get(letter) not in roles]  # 'v (n act)'
    for letter in letters:
        if axis or not _AXIS.fullmatch(letter):
            return None
        axis = letter.upper()
    return _meaning(roles, axis or only_axis, unit, words)


def _of_unit(unit: str) -> str:
    """The quantity that a unit alone states; "" for a position, and without a unit."""
    return _OF_UNITS.get(dimension_recorded(unit), "") if unit else ""


def _meaning(roles: set[str], axis: str, unit: str, words: list[str]) -> Meaning | None:
    quantities = [q for q in _SIGNALS if q in roles]
    spoken = {w.lower() for w in words}
    relative = 2 if spoken & {"rel", "relative"} else 0
    if "limit" in roles:  # 'f-error-lim', 'max_velocity'
        return Meaning(axis, "", unit)
    if "injected" in roles:  # 'injected_current', 'excitation'
        return Meaning(axis, "injected_command", unit) if not roles & {"disturbance", "pos", "vel", "acceleration"} else None
    if "disturbance" in roles:
        return Meaning(axis, "disturbance", unit) if set(quantities) <= {"torque", "current", "voltage"} else None
    if "error" in roles:
        return Meaning(axis, "following_error", unit) if set(quantities) <= {"pos"} else Meaning(axis, "", unit)
    if not quantities and roles & {"set", "act"} and not roles & {"motor", "load", "ffw"} and not roles >= {"set", "act"}:
        quantities = [_of_unit(unit) or "pos"]  # 'command', 'feedback', 'Istwert'
    if not quantities and "load" in roles and spoken & {"percent", "pct"}:  # 'servo load [%]'
        quantities = ["torque"]
    if set(quantities) == {"pos", "vel"} and "set" in roles:  # 'position command speed'
        return Meaning(axis, "velocity_feedforward", unit)
    if len(quantities) != 1 or roles >= {"set", "act"}:
        return None
    quantity = quantities[0]
    if "ffw" in roles:
        if quantity == "torque":
            return Meaning(axis, "torque_feedforward", unit)
        return Meaning(axis, "velocity_feedforward" if quantity == "vel" else "", unit)
    commanded, actual = _SIGNALS[quantity]
    signal = commanded if "set" in roles else actual
    if signal == "position" and "motor" in roles:
        signal = "motor_position"
    elif signal == "velocity" and "load" in roles:
        signal = ""
    # a control may show only the nominal current; its current loop is faster than the recording
    ranks = {"torque": relative, "acceleration": int("set" not in roles), "current": 0.5 * ("set" in roles), "voltage": int("act" in roles)}
    rank = ranks.get(quantity, int(signal == "setpoint" and "motor" in roles))
    return Meaning(axis, signal, unit, rank, plain=not roles & {"set", "act"})


def _path_and_last(name: str) -> tuple[str, str]:
    """'MAIN.axis' and 'fActPos' of 'MAIN.axis.fActPos'; no path in a plain name."""
    *path, last = re.split(r"[./](?=[^./]*$)", name)
    return "".join(path), last


def _axis_in(path: str) -> re.Match[str] | None:
    """The innermost part of a path that can name an axis: of 'hm2.0.encoder.01' the last number."""
    return max(_PATH_AXIS.finditer(path), key=re.Match.start, default=None)


def stem_and_axis(name: str) -> tuple[str, str, bool]:
    """Path before the axis without words for set point and actual value, the axis, and whether it is one: a bare number may be a board or an input."""
    path, last = _path_and_last(english(name))
    if (named := _axis_in(path)) is None or not (named[1].isdigit() or not _AXIS.fullmatch(last)):
        label = last.upper() if path and _AXIS.fullmatch(last) else ""
        return "", label, bool(label)
    before = path[: named.start(1)].lower()
    stem = "/".join(part for part in re.split(r"[./]", before) if not MEANS.get(part, set()) & {"set", "act", "error"})
    return stem, named[1].upper(), not named[1].isdigit() or bool(_AXIS_WORD.search(before))


def names_output(name: str) -> bool:
    """True if a name says that it is what a controller gives, and not of which quantity: 'pid.x.output', 'Reglerausgang'."""
    return any(word.lower() in ("out", "output", "stellgroesse", "sortie") or word.lower().endswith("ausgang") for word in _words(name))


def names_no_position(name: str) -> bool:
    """True if a name says that it is another quantity than a position, whatever else it says: 'leftSpeed', 'wheel current'."""
    roles = set[str]().union(*map(_roles, _words(name)))
    return bool(roles & _SIGNALS.keys()) and "pos" not in roles


def label_of(name: str) -> str:
    """Name of the axis in the name of a column; "" if there is none."""
    plain = _BEHIND.sub("", name).strip()
    return next((found[1].upper() for pattern in _LABELS if (found := pattern.search(plain))), "")


def _without_unit(name: str) -> tuple[str, str]:
    """'pos' and 'mm' of 'pos_mm'; no unit in a name without one."""
    if (ending := _UNIT_ENDING.search(name)) is None:
        return name, ""
    return name[: ending.start()], known_unit(re.sub("_(per_)?", "/", ending[1].lower()))


def axis_alone(name: str, unit: str) -> Meaning | None:
    """The position of an axis whose name says nothing else: 'joint_1', 'J2', 'elbow_joint', 'X', 'j1_rad'. `unit` is given by the file."""
    plain, of_name = (name, unit) if unit else _without_unit(name)
    found = re.fullmatch(rf"(?:{_NUMBERED})[_. \[]*(\d{{1,2}})\]?|(\w+?)[_ ]?joint|(?-i:([XYZxyzABCUVW]))", plain, re.IGNORECASE)
    if found is None or (of_name and dimension_recorded(of_name) not in ("length", "angle", "turns")):
        return None
    return Meaning(found[1] or found[2] or found[3].upper(), "position", of_name)


def groups(names: Sequence[str], known: Mapping[str, str]) -> dict[str, list[str]]:
    """Axis -> columns. `known`: axis of the columns whose names are understood; the others join by their label, or the only axis there is.

    Columns that belong to no axis are under "".
    """
    axes = dict.fromkeys(known.values())
    out: dict[str, list[str]] = {axis: [] for axis in axes}
    labels = {name: label_of(name) for name in names if name not in known}
    if not known and len(set(labels.values())) == len(names) > 1 and all(label.isdigit() for label in labels.values()):
        labels = dict.fromkeys(labels, "")  # they number the columns of a matrix
    for name in names:
        axis = known.get(name) or labels[name]
        if axis not in out and axes and name not in known:
            axis = next(iter(axes)) if not labels[name] and len(axes) == 1 else ""
        out.setdefault(axis, []).append(name)
    return out
