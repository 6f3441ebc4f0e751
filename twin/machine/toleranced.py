"""Parameters of an axis that differ from machine to machine within the machine file's `parameter_tolerance`."""

from twin.machine.axis import Axis
from twin.machine.keys import numbers_of_axis
from twin.machine.parameters import SPREAD, key_of


def toleranced(axis: Axis) -> list[str]:
    """Names of the toleranced parameters that an axis has."""
    own = {p.field for p in numbers_of_axis(axis.structure, axis.effort)}
    given = {"rotor_inertia": axis.rotor_inertia_kg_m2 > 0.0, "moving_mass": axis.moving_mass_kg is not None}
    return [name for name, field in SPREAD.items() if field in own and given.get(name, True)]


def inertia_of(axis: Axis) -> str:
    """Name of the parameter that scales the whole inertia: the rotor's, or the moving mass of a drive without a rotor."""
    return "rotor_inertia" if axis.rotor_inertia_kg_m2 > 0.0 else "moving_mass"


def path_of(axis: Axis, parameter: str) -> str:
    """Path of a toleranced parameter with the key names of a screw or gear; `Machine.in_file` translates it to the file."""
    return f"axis.{axis.name}.{key_of(SPREAD[parameter], axis.kind)}"
