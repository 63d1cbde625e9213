"""What was found about a seal, written into the machine: coefficients over pressure (or frequency)
with their tolerances.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.identification.parameters import half_width
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, averaged, line
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import parse_parameter, settled
from ambrose.machine.seals import Seal, SealTable
from ambrose.model.assemble import seal_coefficients

_LEVEL = 0.95  # of every tolerance
FORMS = ("line", "table", "frequency")


def update_seal(machine: Machine, fit: SealFit, form: str = "line") -> Machine:
    """The machine with the seal's coefficients as found, and an absolute tolerance for each.

    form "line": regression lines over pressure, as a table from zero to the highest pressure
    measured or operated at; half width of a tolerance: the widest prediction band there. "table":
    the measured pressures themselves, means over frequency, linear between; half width: the largest
    standard deviation times the two-sided normal quantile of 95 %. "frequency": every pressure and
    frequency measured, the lowest frequency down to zero (the seal's frequency_dependence decides
    how it is used). A tolerance that the machine states already and that is wider stays: it may be
    the range of operation. One of the pressure stays with lines, which it moves as one; the other
    forms widen every coefficient by its change over that range. Raises InvalidInput where the fit
    belongs to another machine, or operating points lie outside the table.
    """
    if fit.machine != machine.name:
        raise invalid(
            "the machine of the fit",
            repr(fit.machine),
            repr(machine.name),
            "take the machine it belongs to",
        )
    if form not in FORMS:
        raise invalid("form", repr(form), f"one of {', '.join(FORMS)}", "correct it")
    item = next((one for one in machine.seals if one.name == fit.seal), None)
    if item is None:
        raise invalid(
            "the seal of the fit",
            repr(fit.seal),
            "one of the machine",
            "take the machine it belongs to",
        )
    table, widths = {"line": _line, "table": _table, "frequency": _grid}[form](machine, fit)
    check_reach(machine, item.name, table.axes[0][1][0], table.axes[0][1][-1])
    still = tuple(x for x in item.scales_with_pressure if x == "M")
    dependence = item.frequency_dependence if form == "frequency" else "synchronous"
    zero: dict[str, Any] = dict.fromkeys(COEFFICIENTS, 0.0)
    changed = replace(
        item,
        **zero,
        table=table,
        geometry=None,
        frequency_dependence=dependence,
        scales_with_pressure=still,
    )
    tolerances = list(machine.tolerances)
    ranges = [
        one for one in tolerances if form != "line" and one.parameter == f"seal.{fit.seal}.pressure"
    ]
    for one in ranges:
        tolerances.remove(one)
        widths = widths + _change(machine, changed, one)
    for letter, width in zip(COEFFICIENTS, widths.tolist(), strict=True):
        # of both axes, or of single entries
        stated = [i for i, one in enumerate(tolerances) if _names(one, fit.seal, letter)]
        for i in stated:
            if (
                half_width(
                    tolerances[i],
                    getattr(seal_coefficients(changed, machine.operation.nominal), letter),
                )
                < width
            ):
                tolerances[i] = replace(tolerances[i], relative=None, absolute=width)
        if not stated:
            tolerances.append(Tolerance(f"seal.{fit.seal}.{letter}", absolute=width))
    seals = tuple(changed if one is item else one for one in machine.seals)
    updated = replace(machine, seals=seals, tolerances=tuple(tolerances))
    return replace(updated, assumed=settled(machine, updated))


_Made = tuple[SealTable, np.ndarray]


def _line(machine: Machine, fit: SealFit) -> _Made:
    rows = fit if np.isnan(fit.frequency).all() else averaged(fit)
    top = max(
        float(rows.pressure.max()), *(point.seal_pressure for point in machine.operation.envelope)
    )
    ends = np.array([0.0, check_positive(top, "the highest pressure", "measure under pressure")])
    lines = [line(rows, letter) for letter in COEFFICIENTS]
    values = tuple(
        (letter, tuple(one.at(ends).tolist()))
        for letter, one in zip(COEFFICIENTS, lines, strict=True)
    )
    span = np.linspace(0.0, ends[1], 21)
    return SealTable((("pressure", tuple(ends.tolist())),), values), np.array(
        [o.prediction(span, _LEVEL).max() for o in lines]
    )


def _table(machine: Machine, fit: SealFit) -> _Made:
    rows = averaged(fit)
    values = tuple(
        (letter, tuple(rows.values[:, i].tolist())) for i, letter in enumerate(COEFFICIENTS)
    )
    widths = _quantile() * rows.deviations.max(axis=0)
    return SealTable((("pressure", tuple(rows.pressure.tolist())),), values), widths


def _grid(machine: Machine, fit: SealFit) -> _Made:
    kept = fit.rows(np.isfinite(fit.frequency))
    pressures, frequencies = kept.pressures, np.unique(kept.frequency)
    if len(kept) != len(pressures) * len(frequencies) or not len(kept):
        raise InvalidInput(
            "the fit has no full grid of pressures and frequencies; use stepped sines with one "
            "schedule"
        )
    order = np.lexsort((kept.frequency, kept.pressure))
    shape = len(pressures), len(frequencies)
    grids = [kept.values[order, i].reshape(shape) for i in range(len(COEFFICIENTS))]
    if frequencies[0] > 0:  # the lowest one holds down to standstill, where operating points may be
        frequencies, grids = (
            np.append(0.0, frequencies),
            [np.column_stack([grid[:, 0], grid]) for grid in grids],
        )
    axes = (("pressure", tuple(pressures.tolist())), ("frequency", tuple(frequencies.tolist())))
    values = tuple(
        (x, tuple(map(tuple, grid.tolist()))) for x, grid in zip(COEFFICIENTS, grids, strict=True)
    )
    return SealTable(axes, values), _quantile() * kept.deviations.max(axis=0)


def _change(machine: Machine, item: Seal, pressure: Tolerance) -> np.ndarray:
    """The largest change (4,) of a tabulated seal's coefficients over a tolerance of the pressure,
    SI.
    """
    point, table = (
        machine.operation.nominal,
        dict(item.table.axes)["pressure"] if item.table else (),
    )
    half = half_width(pressure, point.seal_pressure)
    ends = np.clip([point.seal_pressure - half, point.seal_pressure + half], table[0], table[-1])
    at = [point.seal_pressure, *ends, *(x for x in table if ends[0] < x < ends[1])]
    coefficients = [seal_coefficients(item, replace(point, seal_pressure=float(x))) for x in at]
    rows = np.array([[getattr(one, letter) for letter in COEFFICIENTS] for one in coefficients])
    return np.asarray(np.abs(rows - rows[0]).max(axis=0))


def check_reach(machine: Machine, seal: str, low: float, high: float) -> None:
    """Refuse pressures [Pa] of a table that some operating point lies outside of: nothing is
    extrapolated later.
    """
    for point in machine.operation.envelope:
        if not low * (1 - 1e-9) <= point.seal_pressure <= high * (1 + 1e-9):
            raise invalid(
                f"operating point {point.label!r}",
                f"{point.seal_pressure:g} Pa",
                f"within {low:g} to {high:g} Pa, the pressures at which seal {seal} was recorded, "
                "for a table",
                'record there, or take the form "line"',
            )


def _names(tolerance: Tolerance, seal: str, letter: str) -> bool:
    parameter = parse_parameter(tolerance.parameter)
    return (parameter.table, parameter.name, parameter.quantity) == ("seal", seal, letter)


def _quantile() -> float:
    from scipy.special import ndtri

    return float(ndtri((1 + _LEVEL) / 2))
