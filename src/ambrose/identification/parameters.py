"""The unknown parameters of a machine: paths with "*" spelled out, their values and units, the
plant with others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ambrose.core.checks import InvalidInput, as_several, invalid
from ambrose.machine.attachment import attachment_of, by_table
from ambrose.machine.description import BiasPoint, MagneticBearing, OperatingPoint, Pair, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import (
    BENDING,
    CONTROLLER_DELAY,
    QUANTITIES,
    TIMING,
    Parameter,
    find_uncertain,
    parse_parameter,
)
from ambrose.machine.part import BendingMode, Seal, constant_under_pressure
from ambrose.machine.units import DIMENSIONS
from ambrose.model.assemble import assemble, bending_modes_of
from ambrose.model.axial import at_point, with_found
from ambrose.model.effects import magnet
from ambrose.model.effects.seal import coefficients
from ambrose.model.plant import Plant
from ambrose.model.static_load import stated_at_load
from ambrose.model.uncertainty import channels, free_mode_reduction, perturbed

COVERAGE = 1.96  # standard deviations of a normal 95 % interval
# of a mode's frequency or damping: a tolerance is what gives it ports, its width is of no matter
_PORT = 0.01


class Estimate(Protocol):
    """What every method gives: values and standard_deviations (q,) of the parameters at ``paths``,
    SI, at ``point``.
    """

    @property
    def machine(self) -> str: ...
    @property
    def point(self) -> OperatingPoint: ...
    @property
    def paths(self) -> tuple[str, ...]: ...
    @property
    def values(self) -> np.ndarray: ...
    @property
    def standard_deviations(self) -> np.ndarray: ...


def unit_of(path: str) -> str:
    """The SI unit of a parameter."""
    return "s" if path in TIMING else DIMENSIONS[parse_parameter(path).dimension].unit


def half_width(tolerance: Tolerance, value: float) -> float:
    """Of a tolerance about a parameter's value, SI."""
    return (tolerance.absolute or 0.0) + (tolerance.relative or 0.0) * abs(value)


def part_names(machine: Machine) -> dict[str, list[str]]:
    """Table of the machine file -> the names of its parts."""
    return {
        "bearing": [item.name for item in machine.bearings],
        "seal": [item.name for item in machine.seals],
        **{
            table: [item.name for item in items]
            for table, items in by_table(machine.attached).items()
        },
    }


def expand(machine: Machine, paths: Sequence[str]) -> tuple[str, ...]:
    """The paths with every "*" replaced by all names (second part), both axes (fourth part) or a
    seal's entries: "bearing.*.negative_stiffness.*", "seal.*.K_*"; "bending" (the first mode),
    "bending_2" and so on by frequency and damping of the mode.

    Raises InvalidInput for a path that leads nowhere, and for two that name the same number.
    """
    paths = as_several(paths)
    names = part_names(machine)
    expanded: list[str] = []
    for path in paths:
        parts = path.split(".")
        if len(parts) == 1 and path.startswith(BENDING.rstrip("_")):
            mode = f"rotor.{BENDING}1" if path == BENDING.rstrip("_") else f"rotor.{path}"
            expanded += [f"{mode}.frequency", f"{mode}.damping"]
            continue
        spelled = [parts]
        if len(parts) > 1 and parts[1] == "*":
            spelled = [[parts[0], name, *parts[2:]] for name in names.get(parts[0], [])]
        letter = parts[2].removesuffix("_*") if len(parts) > 2 else ""
        if parts[0] == "seal" and letter != parts[-1] and letter in QUANTITIES["seal"]:
            spelled = [
                [*item[:2], f"{letter}_{entry}"]
                for item in spelled
                for entry in QUANTITIES["seal"][letter][1]
            ]
        if len(parts) > 3 and parts[3] == "*":
            spelled = [[*item[:3], axis] for item in spelled for axis in ("zeta", "eta")]
        if not spelled:
            raise InvalidInput(
                f'parameter "{path}" names nothing: the machine has no [[{parts[0]}]]'
            )
        expanded += [".".join(item) for item in spelled]
    if not expanded:
        raise InvalidInput(
            "no unknown parameter was named; give paths such as bearing.*.negative_stiffness.*"
        )
    parameters = [find_uncertain(machine, path) for path in expanded]
    for i, one in enumerate(parameters):
        if one.quantity == "core_scale":
            raise InvalidInput(
                f'parameter "{one.path}" is not identified from records; measure the response of '
                "force per current, and state its corner as core_corner"
            )
        if one.quantity == "pressure":
            remedy = f"name its coefficients, seal.{one.name}.k and so on"
            raise InvalidInput(
                f'parameter "{one.path}" is an operating point\'s, known with the record; {remedy}'
            )
        for other in parameters[:i]:
            if one.overlaps(other):
                raise InvalidInput(
                    f'parameters "{other.path}" and "{one.path}" are the same number; name it once'
                )
    return tuple(expanded)


def split_timing(machine: Machine, paths: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The machine's parameters among ``paths``, with "*" spelled out, and those of timing:
    "controller.delay" (or "delay") and "excitation.delay". Raises InvalidInput as ``expand`` does.
    """
    paths = as_several(paths)
    named = [CONTROLLER_DELAY if path == "delay" else path for path in paths]
    timing = [path for path in named if path in TIMING]
    for path in set(timing):
        if timing.count(path) > 1:
            raise InvalidInput(f'parameter "{path}" is named twice; name it once')
    rest = [path for path in named if path not in TIMING]
    return expand(machine, rest) if rest or not timing else (), tuple(timing)


def nominal_values(plant: Plant, paths: Sequence[str]) -> np.ndarray:
    """The values (q,) of the parameters at ``paths`` at the plant's operating point, SI.

    Raises InvalidInput for a path that names two different numbers (both axes of a bearing).
    """
    values = []
    for path in paths:
        nominal = {channel.nominal for channel in channels(plant, path)}
        if len(nominal) > 1:
            text = " and ".join(f"{value:g}" for value in sorted(nominal))
            raise invalid(
                f'parameter "{path}"',
                f"{text} on the two axes",
                "one number",
                f'write "{path}.*", each on its own',
            )
        values.append(nominal.pop())
    return np.array(values)


def reduced_plant(
    machine: Machine,
    point: OperatingPoint,
    bending_modes: int,
    paths: Sequence[str] = (),
    residual: bool = False,
) -> Plant:
    """The plant at an operating point with the rotor's free modes, ``bending_modes`` per plane or
    as many as the mesh has, and ports for the modes among ``paths``; residual: with the compliance
    of all others. Raises InvalidInput for a mode that is not kept.
    """
    named = {item.parameter for item in machine.tolerances}
    wanted = [path for path in paths if path.startswith("rotor.")]
    for path in wanted:
        if mode_number(path) > bending_modes:
            remedy = f"take {mode_number(path)} bending modes (--bending-modes), or leave it out"
            raise InvalidInput(
                f'parameter "{path}" is not in a model of {bending_modes} bending modes; {remedy}'
            )
    ports = tuple(Tolerance(path, relative=_PORT) for path in wanted if path not in named)
    plant = assemble(
        replace(machine, tolerances=(*machine.tolerances, *ports)) if ports else machine, point
    )
    kept = min(bending_modes, bending_modes_of(plant.rotor_model))
    return free_mode_reduction(plant, kept, residual)


def mode_number(path: str) -> int:
    """k of "rotor.bending_k.frequency" or damping."""
    return int(parse_parameter(path).name.removeprefix(BENDING))


def with_bending(machine: Machine, values: Mapping[str, float]) -> Machine:
    """The machine with frequencies [rad/s] and damping ratios of bending modes, by their paths, as
    measured ones.
    """
    modes = {mode.number: mode for mode in machine.bending_modes}
    for path, value in values.items():
        k = mode_number(path)
        modes[k] = replace(modes.get(k, BendingMode(k)), **{parse_parameter(path).quantity: value})  # type: ignore[arg-type]
    return (
        replace(machine, bending_modes=tuple(modes[k] for k in sorted(modes)))
        if values
        else machine
    )


def plant_at(
    machine: Machine, point: OperatingPoint, values: Mapping[str, float], bending_modes: int = 3
) -> Plant:
    """The reduced plant at an operating point with these values, SI, at these paths but those of
    delays.

    Raises InvalidInput.
    """
    machine = with_bending(
        machine, {path: value for path, value in values.items() if path.startswith("rotor.")}
    )
    values = {path: value for path, value in values.items() if not path.startswith("rotor.")}
    plant = reduced_plant(machine, point, bending_modes)
    moves = {
        path: value - channels(plant, path)[0].nominal
        for path, value in values.items()
        if path not in TIMING
    }
    moves = {path: move for path, move in moves.items() if move}
    if not moves:
        return plant
    tolerances = [Tolerance(path, absolute=abs(move)) for path, move in moves.items()]
    return perturbed(
        plant, {path: 1.0 if move > 0 else -1.0 for path, move in moves.items()}, tolerances
    )


def ratios(reference: Plant, plant: Plant, paths: Sequence[str]) -> np.ndarray:
    """By what each parameter (q,) of ``reference`` is to be multiplied at another operating point
    of the same machine.

    A coefficient of a seal that follows the pressure keeps its law and shares the value at the
    reference; couplings and amplifiers do not change. Raises InvalidInput for a bearing whose bias
    differs (its gain and stiffness are then other numbers, tied by no law that a record could
    confirm), and for a coefficient that only exists at one of the points.
    """
    factors = np.ones(len(paths))
    for i, path in enumerate(paths):
        parameter = find_uncertain(reference.machine, path)
        if parameter.table == "thrust_bearing":
            # another load, or another place of the collar
            ends = (channels(item, path)[0].nominal for item in (plant, reference))
            factors[i] = next(ends) / next(ends)
        if parameter.table == "bearing":
            bearing = next(
                item for item in reference.machine.bearings if item.name == parameter.name
            )
            bias = [
                bearing.bias_current if p.bias_current is None else p.bias_current
                for p in (reference.point, plant.point)
            ]
            if abs(bias[0] - bias[1]) > 1e-9 * abs(bias[0]):
                raise invalid(
                    f'parameter "{path}" at the bias {bias[1]:g} A',
                    "another number",
                    f"that at {bias[0]:g} A",
                    "identify each bias current on its own, or take the bearings as known in this "
                    "fit",
                )
        nominal_reference, nominal_plant = (
            nominal_values(reference, [path])[0],
            nominal_values(plant, [path])[0],
        )
        if nominal_reference != 0:
            factors[i] = nominal_plant / nominal_reference
        elif nominal_plant != 0:
            raise invalid(
                f'parameter "{path}"',
                f"zero at the first operating point and {nominal_plant:g} at another",
                "non-zero at the first",
                "identify the points one by one",
            )
    return factors


# The machine with its identified parameters written in, each with a tolerance as wide as it is
# uncertain, and its origin.


def update_machine(
    machine: Machine, result: Estimate, *, origin: str = "", keep_wider: bool = False
) -> Machine:
    """The machine with the values found, and tolerances of 1.96 standard deviations (95 %) relative
    to them.

    A bearing identified at another bias current than its own gets a row in ``measured``. Tolerances
    of the same parameters are replaced; keep_wider: not a seal's, or its pressure's, that is wider
    than what was found: it may be the range of operation. A seal holds one coefficient for both
    axes: single entries (K_xx, k_yx) are averaged with their fellow entry, as found or as it was,
    and the tolerance of the coefficient covers both with their uncertainty. origin: where the
    values are from, added to ``source``; a delay that was found goes into the controller's
    settings, a bending mode's frequency and damping into its [[bending_mode]]. Entries of
    ``assumed`` about a quantity whose every value was identified are taken out; a seal's
    coefficient that does not follow the pressure as others do gets one. Raises InvalidInput for
    what a machine cannot hold (a coefficient from a table or a geometry).
    """
    if result.machine != machine.name:
        raise invalid(
            "the machine of the result",
            repr(result.machine),
            repr(machine.name),
            "take the machine it belongs to",
        )
    entries = _entries(machine, result)
    if not machine.lateral:
        return _axial(machine, result, entries, origin)
    values = [(one.parameter, one.value) for one in entries]
    tolerances = [one.tolerance for one in entries]
    if keep_wider:
        stated = {item.parameter: item for item in machine.tolerances}
        tolerances = [
            _wider(stated.get(item.parameter), item, one.value)
            if one.parameter.table == "seal"
            else item
            for item, one in zip(tolerances, entries, strict=True)
            if not _within_pressure(machine, result.point, one)
        ]
    kept = [
        item
        for item in machine.tolerances
        if not any(parse_parameter(item.parameter).overlaps(p) for p, _ in values)
    ]
    amplifier_values = {
        parameter.quantity: value for parameter, value in values if parameter.table == "amplifier"
    }
    attached = [_attached(item, values) for item in machine.attached]
    coupled = len(machine.couplings)
    pid, delays = machine.controller, dict(zip(result.paths, result.values.tolist(), strict=True))
    seals = tuple(
        _seal(item, result.point, _of("seal", item.name, values)) for item in machine.seals
    )
    reasons = dict(
        row for row in machine.assumed if not _settled(machine, row[0], [p for p, _ in values])
    )
    for seal in seals:
        if still := ", ".join(constant_under_pressure(seal)):
            remark = (
                f"{still}: found at {result.point.seal_pressure:g} Pa; how it follows the pressure "
                "is not known"
            )
            reasons.setdefault(f"seal.{seal.name}.scales_with_pressure", remark)
    modes = {parameter.path: value for parameter, value in values if parameter.table == "rotor"}
    return replace(
        machine,
        bending_modes=with_bending(machine, modes).bending_modes,
        controller=replace(pid, delay=delays[CONTROLLER_DELAY])
        if pid is not None and CONTROLLER_DELAY in delays
        else pid,
        bearings=tuple(
            _bearing(machine, item, result.point, _of("bearing", item.name, values))
            for item in machine.bearings
        ),
        couplings=tuple(attached[:coupled]),
        effects=tuple(attached[coupled:]),
        amplifier=replace(machine.amplifier, **amplifier_values),  # type: ignore[arg-type]
        seals=seals,
        tolerances=(*kept, *tolerances),
        source="; ".join(part for part in (machine.source, origin) if part),
        assumed=tuple(reasons.items()),
    )


def _axial(machine: Machine, result: Estimate, entries: Sequence[_Entry], origin: str) -> Machine:
    """The axis along the shaft with the values found: scales of its magnets' faces and gaps, its
    amplifier's bandwidth, its controller's delay, its tolerances.
    """
    found = {one.parameter.quantity: one for one in entries}
    at, part = machine.condition(result.point), machine.thrust
    now = at_point(machine, result.point)
    if {"force_per_current", "negative_stiffness"} & found.keys():
        k_i = found["force_per_current"].value if "force_per_current" in found else None
        k_s = found["negative_stiffness"].value if "negative_stiffness" in found else None
        part = with_found(
            part, at.load, at.place, k_i or now.force_per_current, k_s or now.stiffness
        )
    if "bandwidth" in found:
        part = replace(part, amplifier_bandwidth=found["bandwidth"].value)
    delays = dict(zip(result.paths, result.values.tolist(), strict=True))
    if part.controller is not None and CONTROLLER_DELAY in delays:
        part = replace(part, controller=replace(part.controller, delay=delays[CONTROLLER_DELAY]))
    mine = [one.tolerance for one in entries]
    known = {item.parameter for item in mine}
    kept = tuple(item for item in part.tolerances if item.parameter not in known)
    part = replace(part, tolerances=(*kept, *mine))
    assert machine.whole is not None
    whole = replace(
        machine.whole,
        effects=tuple(part if item == machine.thrust else item for item in machine.whole.effects),
        source="; ".join(text for text in (machine.whole.source, origin) if text),
    )
    return whole.axial


@dataclass(frozen=True, slots=True)
class _Entry:
    """A parameter of the machine file, its value at the operating point and the half-width of its
    tolerance, SI.
    """

    parameter: Parameter
    value: float
    width: float

    @property
    def tolerance(self) -> Tolerance:
        if self.value == 0:
            return Tolerance(self.parameter.path, absolute=self.width)
        return Tolerance(self.parameter.path, relative=self.width / abs(self.value))


def _entries(machine: Machine, result: Estimate) -> list[_Entry]:
    """The parameters as a machine file holds them: single entries of a seal's matrices made one
    coefficient.
    """
    single: dict[tuple[str, str], list[tuple[float, float]]] = {}
    entries = []
    for path, value, deviation in zip(
        result.paths, result.values.tolist(), result.standard_deviations.tolist(), strict=True
    ):
        if path in TIMING:
            continue  # no parameter of the machine; the controller's settings take its delay
        parameter, width = find_uncertain(machine, path), COVERAGE * deviation
        if parameter.table == "seal" and parameter.component:
            single.setdefault((parameter.name, parameter.quantity), []).append((value, width))
        else:
            entries.append(_Entry(parameter, value, max(width, 1e-15 * abs(value), 1e-300)))
    for (name, quantity), parts in single.items():
        seal = next(item for item in machine.seals if item.name == name)
        before = getattr(
            coefficients(seal, result.point.seal_pressure, result.point.speed), quantity
        )
        both = [*parts, *[(before, 0.0)] * (2 - len(parts))]
        mean = float(np.mean([value for value, _ in both]))
        width = max(abs(value - mean) + width for value, width in both)
        entries.append(_Entry(parse_parameter(f"seal.{name}.{quantity}"), mean, max(width, 1e-300)))
    return entries


def _wider(stated: Tolerance | None, identified: Tolerance, value: float) -> Tolerance:
    """The wider of the two, both taken at the identified value."""
    if stated is None:
        return identified
    return stated if half_width(stated, value) > half_width(identified, value) else identified


def _within_pressure(machine: Machine, point: OperatingPoint, entry: _Entry) -> bool:
    """Whether a stated tolerance of the seal's pressure moves this coefficient by more than what
    was found leaves open.
    """
    one, pressure_path = entry.parameter, f"seal.{entry.parameter.name}.pressure"
    if not any(
        one.quantity in item.scales_with_pressure
        for item in machine.seals
        if one.table == "seal" and item.name == one.name
    ):
        return False
    ranges = [
        half_width(item, point.seal_pressure)
        for item in machine.tolerances
        if item.parameter == pressure_path
    ]
    return any(half * abs(entry.value) > entry.width * point.seal_pressure for half in ranges)


def _settled(machine: Machine, key: str, identified: Sequence[Parameter]) -> bool:
    """Whether an entry of ``assumed`` speaks of a quantity ("bearing.force_per_current") all values
    of which are identified.
    """
    table, _, rest = key.partition(".")
    name, _, quantity = rest.rpartition(".")
    if table == "amplifier":
        return any(p.table == table and p.quantity == quantity for p in identified)
    names = [name] if name else part_names(machine).get(table, [])
    if not quantity or not names:
        return False

    def known(item: str) -> bool:
        mine = [
            p.component
            for p in identified
            if (p.table, p.name, p.quantity) == (table, item, quantity)
        ]
        return "" in mine or {"zeta", "eta"} <= set(mine)

    return all(known(item) for item in names)


_Values = Sequence[tuple[Parameter, float]]


def _of(table: str, name: str, values: _Values) -> _Values:
    return [
        (parameter, value)
        for parameter, value in values
        if (parameter.table, parameter.name) == (table, name)
    ]


def _attached(item: Any, values: _Values) -> Any:
    """A part of a registered effect with the values found of its quantities: pairs, or numbers."""
    effect = attachment_of(item)
    mine = _of(effect.table, item.name, values)
    updated: dict[str, Any] = {}
    for quantity, (_, components) in effect.quantities.items():
        values_of = [value for parameter, value in mine if parameter.quantity == quantity]
        if not values_of:
            continue
        old = getattr(item, quantity)
        if components:
            updated[quantity] = _pair(old, quantity, mine)
        elif isinstance(old, float):
            updated[quantity] = values_of[-1]
        else:
            raise invalid(
                f"{quantity} of {effect.table} {item.name}",
                "a table",
                "one number, to take a value that was found",
                "give a constant, or leave it out of the parameters to identify",
            )
    return replace(item, **updated)


def _pair(pair: Pair, quantity: str, values: _Values) -> Pair:
    zeta, eta = pair
    for parameter, value in values:
        if parameter.quantity == quantity:
            zeta = value if parameter.component in {"", "zeta"} else zeta
            eta = value if parameter.component in {"", "eta"} else eta
    return zeta, eta


def _bearing(
    machine: Machine, item: MagneticBearing, point: OperatingPoint, values: _Values
) -> MagneticBearing:
    """A bearing with values found while it carried the rotor; what was not found becomes what it is
    there.
    """
    if not values:
        return item
    item = stated_at_load(machine, item)
    bias = item.bias_current if point.bias_current is None else point.bias_current
    before = magnet.linearised(item, bias)
    k_i = _pair(before.force_per_current, "force_per_current", values)
    k_s = _pair(before.negative_stiffness, "negative_stiffness", values)
    if abs(bias - item.bias_current) <= 1e-9 * bias:
        return replace(item, force_per_current=k_i, negative_stiffness=k_s)
    others = [row for row in item.measured if abs(row.bias_current - bias) > 1e-9 * bias]
    rows = sorted([*others, BiasPoint(bias, k_i, k_s)], key=lambda row: row.bias_current)
    return replace(item, measured=tuple(rows))


def _seal(item: Seal, point: OperatingPoint, values: _Values) -> Seal:
    """A seal with values at the operating point, those that scale with the pressure at its
    reference pressure.
    """
    changed = {}
    for parameter, value in values:
        quantity = parameter.quantity
        if item.geometry is not None and quantity in {"K", "k", "C", "c"}:
            remedy = (
                "remove the geometry, or write a table of what was measured "
                "(identification/seal/by_pressure.py)"
            )
            raise InvalidInput(
                f'parameter "{parameter.path}" comes from the geometry of seal {item.name}; '
                f"{remedy}"
            )
        if item.table is not None and quantity in dict(item.table.values):
            remedy = "remove it from the table, or enter the value there by hand"
            raise InvalidInput(
                f'parameter "{parameter.path}" is tabulated over {item.table.axes[0][0]}; {remedy}'
            )
        changed[quantity] = value
        if quantity in item.scales_with_pressure and item.reference_pressure is not None:
            if point.seal_pressure == 0:
                raise InvalidInput(
                    f'parameter "{parameter.path}" scales with pressure, which was zero; identify '
                    "it under pressure"
                )
            changed[quantity] = value * item.reference_pressure / point.seal_pressure
    return replace(item, **changed)  # type: ignore[arg-type]
