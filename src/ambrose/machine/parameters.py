"""Names in a machine: operating points by label, and single parameters as tolerances name them.

seal.<name>.K | k | C | c                        one parameter for both axes (k also as -k), a
                                                 repeated real block
seal.<name>.M                                    of both axes; it takes no tolerance
seal.<name>.K_xx | K_yy | k_xy | k_yx | C_xx | C_yy | c_xy | c_yx     one entry of the matrix alone
seal.<name>.pressure                             every coefficient that follows the pressure,
                                                 together
bearing.<name>.force_per_current | negative_stiffness [.zeta | .eta]
thrust_bearing.<name>.force_per_current | negative_stiffness | core_scale
                                                 in [[thrust_bearing.tolerance]]
coupling.<name>.stiffness | damping [.zeta | .eta]
amplifier.bandwidth | eddy_bandwidth | natural_frequency | damping    of all axes together
rotor.bending_1.frequency | damping              of a free bending mode, bending_2 and so on, in
                                                 both planes

controller.delay and excitation.delay name the timing of a measured loop: not the machine's, but
identified with its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.machine.attachment import attached, attachments
from ambrose.machine.description import AMPLIFIER_PARAMETERS, MachineDescription, OperatingPoint
from ambrose.machine.ordinary_file import LEAST_MODES
from ambrose.machine.part import not_straight
from ambrose.machine.units import shown, suggestion

_TILTED = ("zeta", "eta")
_DIRECT, _CROSS = ("xx", "yy"), ("xy", "yx")

# table -> quantity -> (its dimension, the components that can be named alone); those of registered
# effects are theirs (``quantities``)
QUANTITIES: Mapping[str, Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "seal": {
        "K": ("stiffness", _DIRECT),
        "k": ("stiffness", _CROSS),
        "C": ("damping", _DIRECT),
        "c": ("damping", _CROSS),
        "M": ("mass", ()),
        "pressure": ("pressure", ()),
    },
    "bearing": {
        "force_per_current": ("force per current", _TILTED),
        "negative_stiffness": ("stiffness", _TILTED),
    },
    "amplifier": {
        name: ("angular rate", ())
        for name in ("bandwidth", "eddy_bandwidth", "natural_frequency", "damping")
    },
    "rotor": {"frequency": ("angular rate", ()), "damping": ("ratio", ())},
}


def quantities() -> dict[str, Mapping[str, tuple[str, tuple[str, ...]]]]:
    """``QUANTITIES`` with those of the registered effects: table -> quantity -> (dimension,
    components).
    """
    of_tables = {table: item.quantities for table, item in attachments().items() if item.quantities}
    return {**QUANTITIES, **of_tables}


BENDING = "bending_"  # rotor.bending_<k>: the k-th free bending mode
CONTROLLER_DELAY, EXCITATION_DELAY = "controller.delay", "excitation.delay"
# [s]; what an identification may find beside the machine's parameters
TIMING = (CONTROLLER_DELAY, EXCITATION_DELAY)

_POINT_UNITS = {
    "speed": "rad/s",
    "seal_pressure": "Pa",
    "bias_current": "A",
    "whirl_frequency": "rad/s",
}
_MAY_BE_NONE = ("bias_current", "whirl_frequency")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parsed path: ``quantity`` of the entry ``name`` (amplifier: "") in ``table``; component ""
    means both axes.

    dimension: the key of units.DIMENSIONS in which an absolute tolerance is given.
    """

    path: str
    table: str
    name: str
    quantity: str
    component: str
    dimension: str

    def overlaps(self, other: Parameter) -> bool:
        """Whether both name the same number, one of them perhaps together with its fellow axis."""
        same = (self.table, self.name, self.quantity) == (other.table, other.name, other.quantity)
        return same and (
            self.component == other.component or not (self.component and other.component)
        )


def parse_parameter(path: str) -> Parameter:
    """The parameter that ``path`` names, by the grammar above. Raises InvalidInput saying which
    part is wrong.
    """
    table, *parts = path.split(".")
    tables = quantities()
    if table not in tables:
        raise _wrong(path, f'has the unknown first part "{table}"; {suggestion(table, tables)}')
    known = tables[table]
    name = parts.pop(0) if table != "amplifier" and parts else ""
    if not parts or (table != "amplifier" and not name):
        form = (
            f"{table}.<{'|'.join(known)}>"
            if table == "amplifier"
            else f"{table}.<name>.<{'|'.join(known)}>"
        )
        raise _wrong(path, f"is incomplete; write {form}")
    quantity = parts[0]
    component = ""
    rest = parts[1:]
    if table == "seal":
        quantity, _, component = quantity.partition("_")
    elif rest:
        component, *rest = rest
    if quantity not in known:
        raise _wrong(path, f'has the unknown quantity "{parts[0]}"; {_list(known)}')
    dimension, components = known[quantity]
    if rest or (component and component not in components) or path.endswith(("_", ".")):
        raise _wrong(
            path, f'cannot go beyond "{quantity}" like that; {_forms(table, quantity, components)}'
        )
    return Parameter(path, table, name, quantity, component, dimension)


def find_parameter(machine: MachineDescription, path: str) -> Parameter:
    """The parameter that ``path`` names, after checking that this machine has it. Raises
    InvalidInput.
    """
    parameter = parse_parameter(path)
    if parameter.table == "amplifier":
        used = AMPLIFIER_PARAMETERS.get(machine.amplifier.order, ())
        if parameter.quantity not in used:
            has = f"has only {' and '.join(used)}" if used else "has no parameter"
            raise _wrong(
                path, f'names nothing here; an amplifier of order "{machine.amplifier.order}" {has}'
            )
        return parameter
    names = {
        "seal": [seal.name for seal in machine.seals],
        "bearing": [bearing.name for bearing in machine.bearings],
        "rotor": [f"{BENDING}{k + 1}" for k in range(bending_modes_of_mesh(machine))],
    }.get(parameter.table)
    if names is None:
        names = [part.name for effect, part in attached(machine) if effect.table == parameter.table]
    if parameter.table == "rotor" and parameter.name not in names:
        raise _wrong(
            path, f"names no bending mode of this mesh; write {BENDING}1 to {BENDING}{len(names)}"
        )
    if parameter.name not in names:
        nothing = f"the machine has no [[{parameter.table}]]"
        raise _wrong(
            path,
            f'names the unknown {parameter.table} "{parameter.name}"; '
            f"{suggestion(parameter.name, names, nothing)}",
        )
    return parameter


def find_uncertain(machine: MachineDescription, path: str) -> Parameter:
    """``find_parameter`` for a tolerance. Raises InvalidInput for a parameter of the machine that
    cannot be uncertain, too.
    """
    parameter = find_parameter(machine, path)
    if parameter.table == "thrust_bearing" and machine.bearings:
        raise _wrong(
            path, "is of the axis along the shaft; move it into a [[thrust_bearing.tolerance]]"
        )
    if parameter.quantity == "core_scale" and any(
        getattr(part, "core", "") == "laminated" for part in machine.effects
    ):
        raise _wrong(path, "names nothing here: a laminated core has none; leave it out")
    examples = f'"seal.{parameter.name}.K" or "seal.{parameter.name}.C"'
    if (parameter.table, parameter.quantity) == ("seal", "M"):
        remedy = f"remove it and give {examples} a tolerance"
        raise _wrong(
            path,
            "cannot be uncertain: it acts on the acceleration, which no port of the plant "
            f"carries; {remedy}",
        )
    if (parameter.table, parameter.quantity) == ("seal", "pressure"):
        fault = not_straight(next(item for item in machine.seals if item.name == parameter.name))
        if fault:
            raise _wrong(path, f"cannot be uncertain: {fault}; or give {examples} a tolerance")
    return parameter


def operating_point(
    machine: MachineDescription, point: OperatingPoint | str | None = None, **values: float | None
) -> OperatingPoint:
    """An operating point of a machine: by its label, or the beginning of it that only one has;
    None: its design point.

    ``values`` change it: speed [rad/s], seal_pressure [Pa], bias_current [A], whirl_frequency
    [rad/s]. What was changed has no label. Raises InvalidInput for an unknown label or keyword, and
    for a value that no point can have.
    """
    if isinstance(point, str):
        point = _labelled(machine, point)
    elif point is None:
        point = machine.operation.design
    elif not isinstance(point, OperatingPoint):
        raise invalid(
            "the operating point",
            shown(point),
            "a label or an OperatingPoint",
            f"choose {_labels(machine)}",
        )
    for name, value in values.items():
        if name not in _POINT_UNITS:
            raise InvalidInput(
                f'operating point: unknown keyword "{name}"; {suggestion(name, _POINT_UNITS)}'
            )
        if value is not None or name not in _MAY_BE_NONE:
            remedy = f"give it in {_POINT_UNITS[name]}"
            check_positive(value, name, remedy, zero_allowed=name != "bias_current")
    changed = {name: None if value is None else float(value) for name, value in values.items()}
    if all(getattr(point, name) == value for name, value in changed.items()):
        return point
    return replace(point, label="", **changed)  # type: ignore[arg-type]


def bending_modes_of_mesh(machine: MachineDescription) -> int:
    """How many bending modes per plane every full model of so many elements has, see
    ``model.assemble.bending_modes_of``.
    """
    if machine.measured_rotor is not None:
        return len(machine.bending_modes)
    return min(2 * sum(section.elements for section in machine.shaft), LEAST_MODES)


def uncertain_modes(machine: MachineDescription) -> tuple[int, ...]:
    """The numbers, from 1, of the free bending modes that the machine's tolerances name;
    ascending.
    """
    paths = [
        parse_parameter(item.parameter)
        for item in machine.tolerances
        if item.parameter.startswith("rotor.")
    ]
    return tuple(sorted({int(path.name.removeprefix(BENDING)) for path in paths}))


def chosen(machine: MachineDescription) -> tuple[tuple[str, str], ...]:
    """The entries of [machine.assumed] that still speak of something: all but those of a key that
    the machine does not state any more ("bearing.geometry" where no bearing has one).
    """
    return tuple(row for row in machine.assumed if _stands(machine, row[0]))


def settled(before: MachineDescription, after: MachineDescription) -> tuple[tuple[str, str], ...]:
    """The reasons of a machine without those whose key was stated ``before`` and is no more."""
    stood = chosen(before)
    return tuple(r for r in after.assumed if r not in stood or _stands(after, r[0]))


def _stands(machine: MachineDescription, path: str) -> bool:
    """False where the key of a reason is one of a machine file's and none is stated; words of the
    user's own, and tables ("gravity_direction", which may say why there is none), stand.
    """
    if path.endswith(".scales_with_pressure"):  # may say why one does not
        return True
    nodes: list[Any] = [machine]
    for part in path.split("."):
        found = [
            getattr(node, item.name)
            for node in nodes
            if is_dataclass(node)
            for item in fields(node)
            if part in {item.name, item.metadata.get("key"), item.name.removesuffix("s")}
        ]
        found += [node for node in nodes if getattr(node, "name", None) == part]
        if not found:
            return True
        nodes = [one for item in found for one in (item if isinstance(item, tuple) else (item,))]
        nodes = [node for node in nodes if node is not None]
        if not nodes:
            return "." not in path
    return True


def _labelled(machine: MachineDescription, label: str) -> OperatingPoint:
    points = machine.operation.envelope
    matches = [p for p in points if p.label == label] or [
        p for p in points if p.label.startswith(label)
    ]
    if len(matches) != 1:
        raise InvalidInput(
            f"operating point {label!r} is not one point of machine {machine.name!r}; it has "
            f"{_labels(machine)}"
        )
    return matches[0]


def _labels(machine: MachineDescription) -> str:
    return ", ".join(repr(point.label) for point in machine.operation.envelope)


def _wrong(path: str, problem: str) -> InvalidInput:
    return InvalidInput(f'parameter "{path}" {problem}')


def _list(names: Mapping[str, object] | tuple[str, ...]) -> str:
    return f"known: {', '.join(names)}"


def _forms(table: str, quantity: str, components: tuple[str, ...]) -> str:
    mark = "_" if table == "seal" else "."
    return f"possible: {', '.join([quantity, *(f'{quantity}{mark}{c}' for c in components)])}"
