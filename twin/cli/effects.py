"""`twin effects`: the effects that a machine can have beyond the nominal model."""

from __future__ import annotations

import argparse

from twin.cli.arguments import add_machine, machine_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="tell one effect's law, parameters, bounds and usual sizes")
    add_machine(parser)


def carry_out(args: argparse.Namespace) -> int:
    """List all effects, or tell one of them."""
    from twin.effects import EFFECTS
    from twin.effects.effect import find_effect
    from twin.simulation.summary import table

    machine = machine_of(args)
    if not args.name:
        rows = [[e.name, "".join(a.name for a in e.axes(machine)), e.block, e.summary] for e in EFFECTS.values()]
        print(table(["effect", "axes", "block", "what it is"], rows, left=4))
        return 0
    effect = find_effect(args.name, "twin effects")
    print(f"{effect.name} ({effect.block}; {effect.which_axes})\n\n{effect.law}\n")
    rows = []
    for axis in effect.axes(machine):
        for p in effect.parameters:
            low, high = p.usual_range(machine, axis)
            default = f"{p.default:g}" if p.default is not None else "computed" if p.shape else "must be given"
            rows.append(
                [axis.name, p.name, p.unit(axis), f"{p.low:g} .. {p.high:g}", "-" if p.shape else f"{low:.3g} .. {high:.3g}", default]
            )
    print(table(["axis", "parameter", "unit", "bounds", "usual size", "default"], rows, left=3))
    return 0
