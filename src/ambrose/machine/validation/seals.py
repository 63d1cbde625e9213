"""What the seals of a machine must fulfil: constants, tables and geometries, each on its own."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ambrose.machine.description import MachineDescription
from ambrose.machine.messages import complaint, number, shown, suggestion
from ambrose.machine.seals import (
    FREQUENCY_DEPENDENCE,
    SEAL_AXES,
    SEAL_COEFFICIENTS,
    GasSealGeometry,
    Seal,
    SealTable,
    constant_under_pressure,
)
from ambrose.machine.validation.signs import not_positive

COMPUTED = ("K", "k", "C", "c")  # what a geometry yields
_MOST_POLES = 12  # of a rational seal
_WIDEST = 0.05  # clearance over diameter
_PRESWIRL = 2.0  # surface speeds; inlet swirl measured on test rigs stays below one


def seals(machine: MachineDescription) -> Iterator[str]:
    for seal in machine.seals:
        where = f"[[seal]] {seal.name}"
        yield from not_positive(where, seal, "give a pressure difference", "reference_pressure")
        scaled = seal.scales_with_pressure
        for coefficient in scaled:
            if coefficient not in SEAL_COEFFICIENTS:
                unknown = suggestion(coefficient, SEAL_COEFFICIENTS)
                yield (
                    f'{where}: scales_with_pressure names the unknown coefficient "{coefficient}"; '
                    f"{unknown}"
                )
        if len(set(scaled)) < len(scaled):
            yield (
                f"{where}: scales_with_pressure names a coefficient twice, {', '.join(scaled)}; "
                "name each once"
            )
        if scaled and seal.reference_pressure is None:
            yield (
                f"{where}: reference_pressure is missing; scales_with_pressure needs it, such as "
                '"2.04 bar"'
            )
        if seal.table is not None:
            yield from _seal_table(f"{where}, [seal.table]", seal, seal.table)
        if seal.geometry is not None:
            yield from _beside(where, seal)
            yield from _geometry(f"{where}, [seal.geometry]", seal.geometry)
        yield from _frequency(where, seal)
        reason = f"seal.{seal.name}.scales_with_pressure"
        if (constant := constant_under_pressure(seal)) and reason not in dict(machine.assumed):
            yield (
                f"{where}: {', '.join(constant)} would stay at zero pressure while other "
                "coefficients vanish; name all in "
                f'scales_with_pressure, or say in [machine.assumed] under "{reason}" why not'
            )


def _seal_table(where: str, seal: Seal, table: SealTable) -> Iterator[str]:
    axes, values = dict(table.axes), dict(table.values)
    if not axes or len(axes) < len(table.axes):
        yield (
            f"{where}: axes are missing or repeated; give one list for each of pressure, speed or "
            "frequency that matters"
        )
    if not values:
        yield (
            f"{where}: it lists no coefficient; give any of {', '.join(SEAL_COEFFICIENTS)} as "
            "lists over the axes"
        )
    for axis, grid in axes.items():
        if axis not in SEAL_AXES:
            yield f'{where}: axis "{axis}" is unknown; {suggestion(axis, SEAL_AXES)}'
        if len(grid) == 0 or any(b <= a for a, b in pairwise(grid)):
            yield complaint(
                where,
                axis,
                shown(list(grid)),
                "ascending, with at least one value",
                "sort the table along it",
            )
    size = tuple(len(grid) for grid in axes.values())
    for name, array in values.items():
        if name not in SEAL_COEFFICIENTS:
            yield f'{where}: coefficient "{name}" is unknown; {suggestion(name, SEAL_COEFFICIENTS)}'
            continue
        yield from _table_size(where, name, array, tuple(axes), size)
        if getattr(seal, name) != 0:
            yield (
                f"{where}: {name} is {getattr(seal, name):g} in [[seal]] {seal.name} as well; keep "
                "the constant or the table"
            )
        if "pressure" in axes and name in seal.scales_with_pressure:
            yield (
                f"{where}: {name} is given over pressure and named in scales_with_pressure; keep "
                "one of the two"
            )


def _table_size(
    where: str, name: str, array: object, axes: tuple[str, ...], size: tuple[int, ...]
) -> Iterator[str]:
    try:
        actual = np.asarray(array, dtype=float).shape
    except (TypeError, ValueError):
        yield (
            f"{where}: {name} is ragged; make all its inner lists equally long, nested in the "
            f"order {', '.join(axes)}"
        )
        return
    if actual != size:
        wanted = f"{' x '.join(map(str, size))} ({' x '.join(axes)})"
        remedy = "nest the lists in the order of the axes, one number per point"
        yield complaint(where, f"the size of {name}", " x ".join(map(str, actual)), wanted, remedy)


def _frequency(where: str, seal: Seal) -> Iterator[str]:
    if seal.frequency_dependence not in FREQUENCY_DEPENDENCE:
        known = f"one of {', '.join(FREQUENCY_DEPENDENCE)}"
        yield complaint(
            where,
            "frequency_dependence",
            shown(seal.frequency_dependence),
            known,
            "choose one of them",
        )
    elif seal.frequency_dependence == "states":
        grid = () if seal.table is None else dict(seal.table.axes).get("frequency", ())
        if seal.geometry is None and len(grid) < 2:
            remedy = "give [seal.geometry] or a [seal.table] over frequency, or leave the key out"
            yield (
                f'{where}: frequency_dependence is "states", but no coefficient depends on the '
                f"frequency; {remedy}"
            )
        elif seal.geometry is not None and seal.reference_pressure is None:
            yield (
                f'{where}: reference_pressure is missing; frequency_dependence "states" fits its '
                "poles there"
            )
        elif seal.geometry is None and 2 * sum(w > 0 for w in grid) < 2 * seal.poles + 2:
            yield complaint(
                where,
                "poles",
                seal.poles,
                f"at most {sum(w > 0 for w in grid) - 1} for this table",
                "lower it",
            )
    if not 1 <= seal.poles <= _MOST_POLES:
        yield complaint(
            where,
            "poles",
            seal.poles,
            f"from 1 to {_MOST_POLES}",
            "3 suit most gas seals up to 1.5 kHz",
        )


def _beside(where: str, seal: Seal) -> Iterator[str]:
    """What may not stand beside a geometry."""
    for name in COMPUTED:
        if getattr(seal, name) != 0:
            yield (
                f"{where}: {name} is {getattr(seal, name):g}, but [seal.geometry] yields it; keep "
                "one of the two"
            )
        if name in seal.scales_with_pressure:
            yield (
                f"{where}: scales_with_pressure names {name}, which [seal.geometry] yields at "
                "every pressure; remove it there"
            )
    if seal.table is not None:
        yield f"{where}: both [seal.geometry] and [seal.table] are given; keep one of the two"


def _geometry(where: str, geometry: GasSealGeometry) -> Iterator[str]:
    g = geometry
    remedy = "give it in metres or with a unit; clearances are radial"
    yield from not_positive(
        where, g, remedy, "length", "diameter", "inlet_clearance", "exit_clearance"
    )
    yield from not_positive(where, g, "give an absolute temperature", "temperature")
    yield from not_positive(
        where, g, "leave it out for air", "gas_constant", "viscosity", "compressibility"
    )
    yield from not_positive(where, g, "leave it out for the default", "max_frequency")
    yield from not_positive(where, g, "leave it out for the point's", "speed", zero=True)
    sizes = ("hole_depth", "inlet_loss", "exit_recovery", "hole_area_ratio")
    yield from not_positive(where, g, "0 stands for none", *sizes, zero=True)
    for key in ("hole_area_ratio", "exit_recovery"):
        if getattr(g, key) > 1:
            yield complaint(where, key, f"{getattr(g, key):g}", "at most 1", "it is a share")
    for key in ("inlet_clearance", "exit_clearance"):
        if 0 < g.diameter * _WIDEST < getattr(g, key):
            below = f"below 5 % of the diameter, {_WIDEST * g.diameter:g} m"
            yield complaint(
                where, key, number(getattr(g, key), "m"), below, "check its unit; it is radial"
            )
    for key in ("stator_friction", "rotor_friction"):
        coefficient, exponent = getattr(g, key)
        if coefficient <= 0:
            yield complaint(
                where,
                f"{key} (coefficient)",
                f"{coefficient:g}",
                "positive",
                "Blasius' smooth wall has 0.079",
            )
        if not -1 <= exponent <= 1:
            yield complaint(
                where, f"{key} (exponent)", f"{exponent:g}", "from -1 to 1", "-0.25 is Blasius'"
            )
    if abs(g.preswirl) > _PRESWIRL:
        within = f"from {-_PRESWIRL:g} to {_PRESWIRL:g}"
        yield complaint(
            where,
            "preswirl",
            f"{g.preswirl:g}",
            within,
            "divide the inlet swirl by the surface speed",
        )
    yield from not_positive(
        where, g, "give an absolute pressure", "exit_pressure", "inlet_pressure"
    )
    if (g.exit_pressure is None) == (g.inlet_pressure is None):
        stated = (
            "both exit_pressure and inlet_pressure are"
            if g.exit_pressure
            else "neither exit_pressure nor inlet_pressure is"
        )
        yield (
            f"{where}: {stated} given; give one, the operating point's seal_pressure yields the "
            "other"
        )
