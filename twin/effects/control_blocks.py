"""Effects of the control blocks that a machine file lists: a friction pulse, a table or a part of `pid` that the control lacks or holds with
another number. Each strength that a block declares is an effect, also in a block of a user's file."""

from dataclasses import dataclass

from twin.control.block import Block
from twin.control.library import BLOCKS
from twin.effects.change import Change
from twin.effects.effect import EFFECTS, Effect, factor_of
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import CURRENT, DRIVE, VOLTAGE
from twin.units import in_words


@dataclass(frozen=True)
class Strength:
    """Strength of a block of the control off nominal.

    Its numbers = factor x those of the machine file; 0 is a control without them. Source: the block's file in `twin.control`.
    """

    numbers: tuple[str, ...]  # fields as 'block.NAME.NUMBER'

    def __call__(self, change: Change, axis: Axis, factor: float) -> None:
        """Multiply the numbers on this axis."""
        change.scale(axis, **dict.fromkeys(self.numbers, factor))

    def acts_on(self, _machine: Machine, axis: Axis) -> bool:
        """Whether the axis lists the block with one of these numbers."""
        return any(axis.number(field) for field in self.numbers)


def _effect_of(block: Block, numbers: tuple[str, ...], name: str) -> Effect:
    strength = Strength(tuple(f"block.{block.name}.{number}" for number in numbers))
    place = {DRIVE: "speed controller", CURRENT: "current loop", VOLTAGE: "current loop"}.get(block.stage, "position controller")
    summary = f"{in_words(block.name).capitalize()} of the control: {in_words(', '.join(numbers))} off nominal"
    factor = factor_of(strength.numbers[0], 0.0, 2.0, (0.5, 1.5), any_size=True)
    able = f"axes whose control has the block {block.name}"
    return Effect(name, place, summary, (factor,), strength, strength.acts_on, able, sets=strength.numbers)


def add_effects_of_blocks() -> None:
    """Add the effects of the blocks that have none yet."""
    for block in BLOCKS.values():
        for numbers in block.strengths:
            name = block.name if len(block.strengths) == 1 else f"{block.name}_{numbers[0]}"
            if name not in EFFECTS:
                EFFECTS[name] = _effect_of(block, numbers, name)
