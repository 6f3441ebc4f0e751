"""Draws a picture of each effect and writes the page of all effects: docs/pictures/effects/, docs/effects.md.

    python devtools/picture_effects.py                     all pictures and the page
    python devtools/picture_effects.py --only backlash     one picture
    python devtools/picture_effects.py --text              the page alone (a test holds it to the library)

Each effect defines its own picture (`twin.effects.effect.Picture`); `twin.simulation.effect_picture` draws it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.effects import BLOCKS, EFFECTS, Effect, Parameter
from twin.machine.machine import Machine, load_machine
from twin.simulation.effect_picture import axes_shown, draw_effect, sizes_of

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "effects.md"
PICTURES = ROOT / "docs" / "pictures" / "effects"
BEGIN, END = "<!-- begin: written by devtools/picture_effects.py -->", "<!-- end -->"


def page_text(machine: Machine) -> str:
    """The part of the page between the markers: one section per effect, by block."""
    lines = []
    for block in BLOCKS:
        effects = [e for e in EFFECTS.values() if e.block == block and e.axes(machine)]
        lines += [f"## {block[0].upper()}{block[1:]}", ""] if effects else []
        for effect in effects:
            lines += section(effect, machine)
    return "\n".join(lines).rstrip()


def section(effect: Effect, machine: Machine) -> list[str]:
    shown, (axis, pushing) = effect.picture, axes_shown(effect, machine)
    summary, _, law = effect.law.partition("\n\n")
    axes = " ".join(a.name for a in effect.axes(machine))
    lines = [f"### {effect.name}", "", f"{summary} On the Mikron: {axes}.", "", law.replace("*", "\\*"), ""]
    kinds = {axis.kind: axis for axis in reversed(effect.axes(machine))}
    values = [f"from_axis={pushing.name}"] if pushing else []
    values += [f"{k}={v:.4g}" for k, v in sizes_of(effect, machine, axis).items()]
    lines += [f"    --effect {effect.name}:{axis.name}:{','.join(values)}", ""]
    lines += ["| parameter | unit | bounds | usual size | default |", "|---|---|---|---|---|"]
    for p in effect.parameters:
        unit = " or ".join(dict.fromkeys(p.unit(a) for _, a in sorted(kinds.items())))
        default = f"{p.default:g}" if p.default is not None else "computed" if p.shape else "must be given"
        lines.append(f"| `{p.name}` | {unit} | {number(p.low)} to {number(p.high)} | {usual(p, machine, effect)} | {default} |")
    if effect.from_axis:
        lines.append("| `from_axis` | | another axis | | must be given |")
    texts = [text for text in (effect.rivals and f"Rivals: {effect.rivals}", shown.look) if text]
    return [*lines, "", *(line for text in texts for line in (text, "")), f"![{effect.name}](pictures/effects/{effect.name}.png)", ""]


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
        for name in args.only or [name for name, effect in EFFECTS.items() if effect.axes(machine)]:
            print(draw_effect(EFFECTS[name], machine, args.out / f"{name}.png"))
    PAGE.write_text(page(machine, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
