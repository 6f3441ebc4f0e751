"""Sentences and names of a diagnosis: effects with their axes, parameters with their intervals, the verdict."""

from typing import Any

from twin.diagnose.judgement import EVEN, LOUD
from twin.effects import EFFECTS
from twin.effects.readable import interval_text, parameter_label
from twin.simulation.summary import listed
from twin.units import LEAST_SHOWN, in_words, plain

MANY = 10
"""More effects of one axis are not listed one by one."""

FEW = 3
"""Largest number of effects in a sentence; of more effects, the sentence names this many, largest first."""


def parameters_of(entry: dict[str, Any]) -> list[dict[str, str]]:
    """The parameters of an effect of `diagnosis.json` as texts: name, value, interval."""
    rows, effect = [], EFFECTS.get(entry["effect"])
    known = {p.name: p for p in effect.parameters} if effect else {}  # an effect outside the library has none
    for name, p in entry["parameters"].items():
        value, interval = interval_text(p["unit"], p["value"], p["low"], p["high"], known.get(name))
        rows.append({"name": parameter_label(name), "value": value, "interval": interval})
    return rows


def parameters_text(entry: dict[str, Any]) -> str:
    """The parameters of an effect in one line: 'clearance 12.6 um (12.4 to 12.8 um)'."""
    return ", ".join(f"{p['name']} {p['value']}" + (f" ({p['interval']})" if p["interval"] else "") for p in parameters_of(entry))


def place_text(entry: dict[str, Any]) -> str:
    """The axis of an effect: 'X', 'X from Y'."""
    return entry["axis"] + (f" from {entry['from_axis']}" if entry.get("from_axis") else "")


def effect_title(entry: dict[str, Any]) -> str:
    """'backlash on axis X', 'cross axis coupling on axis X from Y'."""
    return f"{in_words(entry['effect'])} on axis {place_text(entry)}"


def verdict_sentence(document: dict[str, Any], numbers: bool = False) -> str:
    """The verdict in one sentence; with `numbers`, including the first parameter of each effect."""
    if document["verdict"] == "none":
        loud = [r for r in document["budget"]["unexplained"] if r["times_noise"] > LOUD]
        if not loud:
            said = calibration_text(document)
            how = f"once what the file had assumed is calibrated: {said}" if said else "within tolerance and noise"
            return f"No effect: the machine agrees with its file {how}."
        remains = listed([f"{times(r['times_noise'])} times the noise on axis {r['axis']}" for r in loud])
        return f"No effect found, but a gap remains, {remains}: the twin errs by so much there, or these runs hardly show the cause."
    if document.get("decided") is False:
        left = document["gap"]["after"]
        return f"Not decided: the quick look found no effect, but the gap is {times(left)} times the noise; diagnose without --quick."
    effects = [e for e in document["effects"] if document["verdict"] != "unknown" or e["probability"] > EVEN]
    named = effects[: FEW if len(effects) > FEW else None]
    names = listed([effect_title(e) + (f" ({headline_number(e)})" if numbers else "") for e in named])
    if len(effects) > FEW:
        names = f"{len(effects)} effects, the largest at the tool point being {names}"
    if document["verdict"] == "effect":
        return f"The gap comes from {names}."
    laws = listed([law["sentence"] for law in document.get("laws", ())])
    if document["verdict"] == "law":
        return f"A law that no effect describes: {laws}" + (f"; in addition {names}." if names else ".")
    place = document["where"][0] if document["where"] else None
    at = f" in the {place['block']} of axis {place['axis']}" if place else ""
    if place and place["scales_with"] != "-":
        at += f", scaling with {place['scales_with']}"
    parts = listed([part for part in (names, laws) if part])
    return f"Unknown: no known effect explains the gap{at}" + (f"; part of it is {parts}." if parts else ".")


def calibration_text(document: dict[str, Any]) -> str:
    """The effects on numbers that the machine file had assumed or tried, and the measured ones that they contradict: 'velocity feedforward on axis X (1.32)'."""
    parts = []
    for e in document.get("calibrated", ()):
        against = f", which contradicts the file: {e['contradicts']}" if e.get("contradicts") else ""
        parts.append(f"{effect_title(e)} ({headline_number(e)}{against})")
    return listed(parts)


def where_text(place: dict[str, Any]) -> str:
    """A place in one line: 'axis X, mechanics, constant speed, scales with sign v, share 97 % (reversal, circle_xy)'."""
    known = [f"axis {place['axis']}", place["block"], "all regimes" if place["regime"] == "all" else place["regime"]]
    known += [f"scales with {place['scales_with']}"] if place["scales_with"] != "-" else []
    runs = f" ({', '.join(place['runs'][:3])})" if place["runs"] else ""
    return f"{', '.join(known)}, share {percent(place['share'])}{runs}"


def headline_number(entry: dict[str, Any]) -> str:
    """The first parameter of an effect: '12.6 um'."""
    return next((p["value"] for p in parameters_of(entry)), "")


def moves_text(row: dict[str, Any]) -> str:
    """What a contribution of a budget does to the part: 'moves the tool point by 1.2 um RMS, at most 3.4 um'."""
    if row["tool_point"] < LEAST_SHOWN:
        only_axis = row["position"] >= LEAST_SHOWN
        return (
            f"moves its axis by {plain(row['position'])} {row['position_unit']} RMS, but not the tool point"
            if only_axis
            else "does not move the tool point"
        )
    return f"moves the tool point by {plain(row['tool_point'])} um RMS, at most {plain(row['largest'])} um"


def effect_line(document: dict[str, Any], effect: dict[str, Any]) -> str:
    """Size, contribution and probability of an effect of `diagnosis.json`."""
    rows = [
        r for r in document["budget"]["rows"] if (r["kind"], r["effect"], place_text(r)) == ("effect", effect["effect"], place_text(effect))
    ]
    return "; ".join([parameters_text(effect), *map(moves_text, rows), f"probability {effect['probability']:.2f}"])


def closed_texts(document: dict[str, Any]) -> list[str]:
    """What `explained` states, for each axis with an effect: the share of its gap that all corrections close together."""
    shares = {e["axis"]: e["explained"] for e in document["effects"]}
    return [f"the corrected machine closes {percent(share)} of the gap of axis {axis}" for axis, share in shares.items()]


def percent(share: float) -> str:
    """A share in per cent, of either sign; never 0 % or 100 % by rounding."""
    if share < 0.0:
        return f"-{percent(-share).removeprefix('< ')}" if share <= -0.005 else "0 %"
    if 0.0 < share < 0.005:
        return "< 1 %"
    if 0.995 < share <= 1.0:
        return "> 99 %"
    return f"{100.0 * share:.0f} %"


def times(level: float) -> str:
    """A level in multiples of noise."""
    return f"{level:.2f}" if level < 10.0 else f"{level:.1f}" if level < 100.0 else f"{level:.0f}"


def sentence_case(text: str) -> str:
    """The text with an upper-case first letter."""
    return text[:1].upper() + text[1:]


def unseen_text(document: dict[str, Any]) -> str:
    """Effects that are not visible in these runs and signals, with their axes; axes with many of them are summarised."""
    by_axis: dict[str, set[str]] = {}
    unseen = document["not_visible"] or []
    for e in unseen:
        by_axis.setdefault(e["axis"], set()).add(e["effect"])
    still = sorted(axis for axis, effects in by_axis.items() if len(effects) > MANY)
    named: dict[str, list[str]] = {}
    for e in unseen:
        if e["axis"] not in still:
            named.setdefault(in_words(e["effect"]), []).append(place_text(e))
    parts = [f"{effect} on {', '.join(places)}" for effect, places in sorted(named.items())]
    return "; ".join([*parts, *([f"many effects on {', '.join(still)}"] if still else [])])
