"""Numbers of a machine by path: read, change, and find by pattern.

axis.X.moving_mass_kg                    a number of the machine file, in the file's unit
body.workpiece.centre_of_mass_m.0        an element of a list
axis.*.loops.position_gain_per_s         * matches any one part
effect.backlash.X.clearance              parameter of an effect, in SI; added to a machine without the effect
added_mass.X                             kg added to the moving mass of X and of every linear axis that carries X
added_mass.workpiece                     kg added to a body of the file; its inertia is scaled alike, and the moving mass of every linear axis
                                         that carries it increases
inertia.X                                total inertia at the motor of X in the home pose [kg m2]; set by changing rotor and screw (or gear)
"""

from collections.abc import Mapping
import copy
import fnmatch
from typing import Any

from twin.control.number import unit_of_key
from twin.documents import flat, value_at
from twin.effects.change import total_inertia
from twin.effects.effect import find_effect
from twin.errors import InputError, nearest
from twin.machine.axis import Axis
from twin.machine.machine import Machine
from twin.machine.parameters import key_of
from twin.simulation.plant_spec import load_spec
from twin.tables import is_number

ADDED_MASS = "added_mass."
INERTIA = "inertia."


def matching_paths(pattern: str, machine: Machine, where: str) -> list[str]:
    """Paths of all numbers that match a pattern; an InputError with the nearest one if there is none."""
    if pattern.startswith("effect."):
        return [_effect_path(pattern, machine, where)]
    if pattern.startswith(ADDED_MASS):
        carrying_axes(pattern, machine, where)
        return [pattern]
    if pattern.startswith(INERTIA):
        name = pattern.removeprefix(INERTIA)
        if name not in machine.axis_names:
            raise InputError(f"{where}: '{pattern}': no axis {name}; {nearest(name, machine.axis_names)}")
        if not machine.axis(name).rotor_inertia_kg_m2 > 0.0:
            raise InputError(f"{where}: '{pattern}': axis {name} has no inertia of rotor and screw or gear; vary its masses")
        return [pattern]
    known, wanted = numbers_of(machine.document), pattern.split(".")
    parts = {path: path.split(".") for path in known}
    found = [path for path in known if len(parts[path]) == len(wanted) and all(map(fnmatch.fnmatchcase, parts[path], wanted))]
    if not found:
        raise InputError(f"{where}: no number '{pattern}' in machine {machine.name}; {nearest(pattern, known)}")
    return found


def inertia_at_motor(machine: Machine, axis: Axis) -> float:
    """Inertia of load and rotor at the motor of an axis in the home pose [kg m2]."""
    return total_inertia(machine, axis) * axis.ratio**2


def carrying_axes(path: str, machine: Machine, where: str) -> list[str]:
    """Linear axes that move a mass added to an axis or a body."""
    name = path.removeprefix(ADDED_MASS)
    movers = [axis.name for axis in machine.axes if axis.kind == "linear"]
    known = [*movers, *(body.name for body in machine.bodies)]
    if name not in known:
        raise InputError(f"{where}: '{path}': no linear axis and no body {name}; {nearest(name, known)}")
    spec = load_spec(machine.model_path)  # keep a reference: its elements are freed with it
    bodies = {joint.name: joint.parent for joint in spec.joints}
    carriers, body = set(), bodies[name] if name in movers else spec.body(name)
    while body is not None:
        carriers.add(body.id)
        body = body.parent
    return [axis for axis in movers if bodies[axis].id in carriers]


def _effect_path(path: str, machine: Machine, where: str) -> str:
    parts = path.split(".")
    if len(parts) != 4:
        raise InputError(f"{where}: '{path}': write effect.NAME.AXIS.PARAMETER, e.g. effect.backlash.X.clearance")
    _, name, axis, parameter = parts
    effect = find_effect(name, where)
    effect.parameter(parameter)
    if axis not in machine.axis_names:
        raise InputError(f"{where}: '{path}': no axis {axis}; {nearest(axis, machine.axis_names)}")
    if not effect.can_have(machine, machine.axis(axis)):
        raise InputError(f"{where}: '{path}': axis {axis} cannot have this effect; it is for {effect.which_axes}")
    if effect.from_axis and _effect_table(machine, name, axis) is None:
        raise InputError(f"{where}: '{path}': this effect needs a source axis; put it into the machine file with its from_axis first")
    return path


def _effect_table(machine: Machine, name: str, axis: str) -> Mapping[str, Any] | None:
    return next((table for table in machine.effects if table.get("name") == name and table.get("axis") == axis), None)


def numbers_of(document: Mapping[str, Any]) -> list[str]:
    """Paths of all numbers in the tables of a machine file, without its effects."""
    return [path for path, value in flat({k: v for k, v in document.items() if k != "effect"}).items() if is_number(value)]


def unit_at(path: str) -> str:
    """Unit of the number at a path, from the end of its key: 'm/rev', 'Nm s/rad'; 'SI' for an effect's parameter, '' if there is none."""
    if path.startswith("effect."):
        return "SI"
    if path.startswith(ADDED_MASS):
        return "kg"
    if path.startswith(INERTIA):
        return "kg m2"
    return unit_of_key(next(part for part in reversed(path.split(".")) if not part.isdigit()))


def number_at(machine: Machine, path: str) -> float | None:
    """The number at a path; None for a parameter of an effect that the machine lacks."""
    if path.startswith("effect."):
        _, name, axis, parameter = path.split(".")
        value = (_effect_table(machine, name, axis) or {}).get(parameter)
        return None if value is None else float(value)
    if path.startswith(ADDED_MASS):
        return 0.0
    if path.startswith(INERTIA):
        return inertia_at_motor(machine, machine.axis(path.removeprefix(INERTIA)))
    return float(value_at(machine.document, path))


def with_numbers(machine: Machine, values: Mapping[str, Any]) -> Machine:
    """The machine with other numbers, by path; raises InputError for impossible ones."""
    changed: dict[str, Any] = {}
    added: dict[str, float] = {}
    effects = [dict(table) for table in machine.effects]  # an axis may have several laws, or couplings to several axes
    inertias: dict[str, float] = {}
    for path, value in values.items():
        *tables, last = path.split(".")
        if path.startswith(INERTIA):
            inertias[last] = value
        elif path.startswith("effect."):
            _, name, axis = tables
            mine = next((table for table in effects if (table["name"], table["axis"]) == (name, axis)), None)
            if mine is None:
                effects.append(mine := {"name": name, "axis": axis})
            mine[last] = value
        elif path.startswith(ADDED_MASS):
            for axis in carrying_axes(path, machine, "study"):
                mass = f"axis.{axis}.moving_mass_kg"
                added[mass] = added.get(mass, 0.0) + value
            if last not in machine.axis_names:
                added[f"body.{last}.mass_kg"] = value
        elif last.isdigit():
            whole = ".".join(tables)
            changed.setdefault(whole, list(value_at(machine.document, whole)))[int(last)] = value
        else:
            changed[path] = value
    for mass, more in added.items():
        before = changed.get(mass, number_at(machine, mass) or 0.0)
        changed[mass] = before + more
        if mass.startswith("body."):
            inertia = f"{mass.removesuffix('mass_kg')}inertia_kg_m2"
            table = machine.document["body"][mass.split(".")[1]]
            changed[inertia] = [(1.0 + more / before) * value for value in changed.get(inertia, table["inertia_kg_m2"])]
    if effects:
        changed["effect"] = copy.deepcopy(effects)
    machine = machine.with_values(changed)
    return machine.with_values(_rotors(machine, inertias)) if inertias else machine


def _rotors(machine: Machine, inertias: Mapping[str, float]) -> dict[str, float]:
    """Rotor inertias (with screw or gear), by path, that give axes these total inertias at the motor."""
    out = {}
    for name, wanted in inertias.items():
        axis = machine.axis(name)
        load = inertia_at_motor(machine, axis) - axis.rotor_inertia_kg_m2
        if wanted <= load:
            raise InputError(
                f"study: inertia.{name} = {wanted:.4g} kg m2: its load alone has {load:.4g} at the motor; reduce masses too, or give a larger value"
            )
        out[f"axis.{name}.{key_of('rotor_inertia_kg_m2', axis.kind)}"] = wanted - load
    return out
