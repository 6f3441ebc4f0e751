"""`twin effects`: the effects that a machine can have beyond the nominal model."""

from twin.cli.arguments import MACHINE, Args, arg, machine_of, picture_file
from twin.errors import InputError
from twin.machine.machine import Machine

ARGUMENTS = (
    arg("name", "NAME", "effect to show: law, parameters, bounds, usual sizes (default: list all effects)", nargs="?"),
    arg("--picture", "FILE.png", "plot a short move with and without the effect NAME"),
    MACHINE,
)


def _law_page(machine: Machine, picture: str | None) -> None:
    """Print the variables, outputs and formulas of laws, and the laws of the machine."""
    from twin.effects import settings_of
    from twin.effects.law import OUTPUTS, VARIABLES, laws_in
    from twin.effects.law_shapes import SHAPES
    from twin.simulation.law_picture import draw_laws
    from twin.simulation.summary import table

    print("law (any block; any axis)\n\nThe output of a block as a function of one variable, y = f(x), that no other effect describes.\n")
    print(table(["variable", "meaning"], [[name, v.words] for name, v in VARIABLES.items()], left=2) + "\n")
    outputs = [[block, name, o.words] for block, of_block in OUTPUTS.items() for name, o in of_block.items()]
    print(table(["block", "output", "meaning"], outputs, left=3) + "\n")
    shapes = [[s.name, s.equation, ", ".join(n.name for n in s.numbers)] for s in SHAPES.values()]
    print(table(["formula", "equation", "numbers"], shapes, left=3))
    for setting in laws_in(settings_of(machine)):
        print(f"\non axis {setting.axis}: {setting.effect.summary}\n  {setting.table()}")
    if picture:
        print(f"written: {draw_laws(machine, picture_file(picture))}")


def carry_out(args: Args) -> None:
    """List all effects, or show one of them."""
    from twin.effects import BLOCKS, EFFECTS, find_effect
    from twin.effects.readable import readable_unit
    from twin.simulation.summary import table

    if args.picture and not args.name:
        raise InputError("--picture needs the name of an effect, e.g. twin effects backlash --picture backlash.png")
    machine = machine_of(args)
    if not args.name:
        effects = sorted(EFFECTS.values(), key=lambda e: BLOCKS.index(e.block))
        rows = [[e.name, "".join(a.name for a in e.axes(machine)), e.block, e.summary] for e in effects]
        rows.append(["law", "".join(machine.axis_names), "any", "A law that no listed effect describes, as a formula or a curve"])
        print(table(["effect", "axes", "block", "meaning"], rows, left=4))
        return
    if args.name == "law":
        return _law_page(machine, args.picture)
    effect = find_effect(args.name, "twin effects")
    rivals = f"Rivals: {effect.rivals}\n" if effect.rivals else ""
    print(f"{effect.name} ({effect.block}; {effect.which_axes})\n\n{effect.law}\n\n{rivals}")
    rows = []
    for axis in effect.axes(machine):
        for p in effect.parameters:
            usual, default = "-", f"{p.default:g}" if p.default is not None else "computed" if p.shape else "must be given"
            if not p.shape:
                low, high = p.usual_range(machine, axis)
                unit, factor, offset = readable_unit(p.unit(axis), high, p)
                usual = f"{factor * (low - offset):.3g} to {factor * (high - offset):.3g} {unit}".strip()
            rows.append([axis.name, p.name, p.unit(axis), f"{p.low:g} .. {p.high:g}", usual, default])
    print(table(["axis", "parameter", "unit", "bounds", "usual size", "default"], rows, left=3))
    if args.picture:
        from twin.simulation.effect_picture import draw_effect

        print(f"written: {draw_effect(effect, machine, picture_file(args.picture))}")
