"""The machine with its identified parameters written in, each with a tolerance as wide as it is uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.identify.closed_loop import Identification
from ambrose.machine.description import BiasPoint, Machine, MagneticBearing, OperatingPoint, Pair, Seal, Tolerance
from ambrose.machine.parameters import Parameter, find_uncertain, parse_parameter
from ambrose.physics import magnet


def identified_machine(machine: Machine, result: Identification, coverage: float = 1.96) -> Machine:
    """The machine with the values found, and tolerances of ``coverage`` standard deviations (1.96: 95 %) relative to them.

    A bearing identified at another bias current than its own gets a row in ``measured``. Tolerances of the same parameters are
    replaced. Raises InvalidInput for what a machine cannot hold (one entry of a seal's matrix, a tabulated coefficient).
    """
    if result.machine != machine.name:
        raise invalid("the machine of the result", repr(result.machine), repr(machine.name), "take the machine it belongs to")
    check_positive(coverage, "coverage", "1.96 standard deviations cover 95 %")
    tolerances, values = [], []
    for path, value, deviation in zip(result.paths, result.values, result.standard_deviations, strict=True):
        parameter = find_uncertain(machine, path)
        values.append((parameter, float(value)))
        width = max(coverage * float(deviation), 1e-15 * abs(value), 1e-300)
        relative = value != 0
        tolerances.append(Tolerance(path, width / abs(value) if relative else None, None if relative else width))
    found = [parameter for parameter, _ in values]
    kept = [item for item in machine.tolerances if not any(parse_parameter(item.parameter).overlaps(one) for one in found)]
    own = {parameter.quantity: value for parameter, value in values if parameter.table == "amplifier"}
    couplings = []
    for item in machine.couplings:
        mine = _of("coupling", item.name, values)
        stiffness, damping = _pair(item.stiffness, "stiffness", mine), _pair(item.damping, "damping", mine)
        couplings.append(replace(item, stiffness=stiffness, damping=damping))
    return replace(
        machine,
        bearings=tuple(_bearing(item, result.point, _of("bearing", item.name, values)) for item in machine.bearings),
        couplings=tuple(couplings),
        amplifier=replace(machine.amplifier, **own),  # type: ignore[arg-type]
        seals=tuple(_seal(machine, item, result.point, _of("seal", item.name, values)) for item in machine.seals),
        tolerances=(*kept, *tolerances),
    )


_Values = Sequence[tuple[Parameter, float]]


def _of(table: str, name: str, values: _Values) -> _Values:
    return [(parameter, value) for parameter, value in values if (parameter.table, parameter.name) == (table, name)]


def _pair(pair: Pair, quantity: str, values: _Values) -> Pair:
    zeta, eta = pair
    for parameter, value in values:
        if parameter.quantity == quantity:
            zeta = value if parameter.component in {"", "zeta"} else zeta
            eta = value if parameter.component in {"", "eta"} else eta
    return zeta, eta


def _bearing(item: MagneticBearing, point: OperatingPoint, values: _Values) -> MagneticBearing:
    if not values:
        return item
    bias = item.bias_current if point.bias_current is None else point.bias_current
    before = magnet.linearised(item, bias)
    k_i = _pair(before.force_per_current, "force_per_current", values)
    k_s = _pair(before.negative_stiffness, "negative_stiffness", values)
    if abs(bias - item.bias_current) <= 1e-9 * bias:
        return replace(item, force_per_current=k_i, negative_stiffness=k_s)
    others = [row for row in item.measured if abs(row.bias_current - bias) > 1e-9 * bias]
    rows = sorted([*others, BiasPoint(bias, k_i, k_s)], key=lambda row: row.bias_current)
    return replace(item, measured=tuple(rows))


def _seal(machine: Machine, item: Seal, point: OperatingPoint, values: _Values) -> Seal:
    changed = {p.quantity: _in_the_file(machine, p, point, value) for p, value in values}
    return replace(item, **changed)  # type: ignore[arg-type]


def _in_the_file(machine: Machine, parameter: Parameter, point: OperatingPoint, value: float) -> float:
    """A value at the operating point as the machine file holds it: a seal's at its reference pressure."""
    if parameter.table != "seal":
        return value
    item = next(seal for seal in machine.seals if seal.name == parameter.name)
    if parameter.component:
        remedy = f"identify seal.{item.name}.{parameter.quantity}, one number for both axes"
        raise invalid(f'parameter "{parameter.path}"', "one entry of a matrix", "a coefficient that a seal holds", remedy)
    if item.table is not None and parameter.quantity in {name for name, _ in item.table.values}:
        remedy = "remove it from the table, or enter the value there by hand"
        raise InvalidInput(f'parameter "{parameter.path}" is tabulated over {item.table.axes[0][0]}; {remedy}')
    if parameter.quantity not in item.scales_with_pressure or item.reference_pressure is None:
        return value
    if point.seal_pressure == 0:
        raise InvalidInput(f'parameter "{parameter.path}" scales with pressure, which was zero; identify it under pressure')
    return value * item.reference_pressure / point.seal_pressure
