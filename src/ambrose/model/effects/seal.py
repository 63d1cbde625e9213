"""Annular seal: f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x' + M x'') acts on the rotor.

k > 0 drives forward whirl.
"""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, check_positive, invalid
from ambrose.machine.part import GasSealGeometry, Seal, SealTable
from ambrose.machine.units import as_written
from ambrose.model.effects.bulkflow import (
    BulkFlow,
    Friction,
    Gas,
    SealCondition,
    SealGeometry,
    air,
    bulk_flow,
)

# A machine's gas seal at an operating point: its geometry and gas through the bulk-flow model, each
# flow computed once.
#
# The pressure drop across the seal is the operating point's; the absolute pressure on one side is
# the seal's own. At drops below ``LEAST_DROP`` of it the model has no turbulent flow to work with:
# there the coefficients fall to zero in proportion to the drop.


COMPUTED = ("K", "k", "C", "c")
LEAST_DROP = 0.05  # of the side whose pressure is given
_CELLS = (100, 400)  # the second where the first is too coarse
_SLOWEST = 1.0  # rad/s; the coefficients are even functions of the frequency, and flat there
_SLACK = 1e-9  # of the highest frequency, rounding
_COLD = 150.0  # [K], assumed: just above air's critical point, and 150 degC hardly leave a seal


def gas_coefficients(
    seal: Seal, pressure: float, speed: float, frequency: float
) -> dict[str, float]:
    """K, k [N/m], C, c [N s/m] at a pressure drop [Pa], spin speed [rad/s] and whirl frequency
    [rad/s].

    Raises InvalidInput, naming the seal: a frequency above its ``max_frequency``, a choked or
    reverse flow, a drop larger than the inlet pressure. Raises NumericalFailure where no grid is
    fine enough.
    """
    flow, share = gas_flow(seal, pressure, speed, (float(frequency),))
    return (
        {name: share * float(getattr(flow, name)[0]) for name in COMPUTED}
        if flow
        else dict.fromkeys(COMPUTED, 0.0)
    )


def gas_flow(
    seal: Seal, pressure: float, speed: float, frequencies: tuple[float, ...]
) -> tuple[BulkFlow | None, float]:
    """The flow at whirl frequencies [rad/s], and the factor on its coefficients, below 1 at very
    small drops; None at no drop.

    Raises as ``gas_coefficients``.
    """
    geometry = seal.geometry
    if geometry is None:
        raise InvalidInput(f"seal {seal.name} has no geometry; add [seal.geometry]")
    where = f"[[seal]] {seal.name}, [seal.geometry]"
    low, high = min(frequencies), max(frequencies)
    if not low >= 0 or high > geometry.max_frequency * (1 + _SLACK):
        worst = low if not low >= 0 else high
        within = f"from 0 to its max_frequency, {geometry.max_frequency:g} rad/s"
        raise invalid(
            f"the whirl frequency [rad/s] of seal {seal.name}",
            f"{worst:g}",
            within,
            "raise max_frequency there",
        )
    if pressure == 0:
        return None, 0.0

    # below the least drop the coefficients fall in proportion to it
    least = LEAST_DROP * (geometry.exit_pressure or geometry.inlet_pressure or 0.0)
    spin = speed if geometry.speed is None else geometry.speed
    used_frequencies = tuple(max(w, _SLOWEST) for w in frequencies)
    try:
        return _flow(geometry, max(pressure, least), spin, used_frequencies), min(
            pressure / least, 1.0
        )
    except (InvalidInput, NumericalFailure) as error:
        cold = celsius_for_kelvin(geometry)
        text = f"{cold} (unchanged, {error})" if cold else str(error)
        raise type(error)(f"{where}: {text}") from error


def celsius_for_kelvin(geometry: GasSealGeometry) -> str:
    """What to say of a temperature that is probably one in degrees Celsius; "" else.

    A gas with air's viscosity is none below air's critical temperature, 132 K.
    """
    if geometry.viscosity is not None or geometry.temperature >= _COLD:
        return ""
    return (
        f"temperature is {geometry.temperature:g} K, which looks like degrees Celsius; write "
        f'"{geometry.temperature:g} degC", or for a cold gas its viscosity'
    )


@lru_cache(maxsize=2048)
def _flow(
    geometry: GasSealGeometry, pressure: float, speed: float, frequencies: tuple[float, ...]
) -> BulkFlow:
    # a finer grid where the first is too coarse
    seal, condition = described(geometry, pressure, speed)
    try:
        return bulk_flow(seal, condition, np.array(frequencies), _CELLS[0])
    except NumericalFailure:
        return bulk_flow(seal, condition, np.array(frequencies), _CELLS[1])


def described(
    geometry: GasSealGeometry, pressure: float, speed: float
) -> tuple[SealGeometry, SealCondition]:
    """What ``bulk_flow`` takes, at a pressure drop [Pa] and a spin speed [rad/s]. Raises
    InvalidInput.
    """
    g = geometry
    if g.inlet_pressure is not None and pressure >= g.inlet_pressure:
        raise invalid(
            "the seal_pressure",
            as_written(pressure, "pressure"),
            f"below the inlet_pressure, {as_written(g.inlet_pressure, 'pressure')}",
            "lower it",
        )
    inlet, outlet = (
        (g.inlet_pressure, g.inlet_pressure - pressure)
        if g.inlet_pressure is not None
        else ((g.exit_pressure or 0.0) + pressure, g.exit_pressure or 0.0)
    )
    usual = air(g.temperature)
    gas = Gas(
        g.gas_constant, usual.viscosity if g.viscosity is None else g.viscosity, g.compressibility
    )
    seal = SealGeometry(
        g.length,
        g.diameter,
        g.inlet_clearance,
        g.exit_clearance,
        g.hole_depth,
        g.hole_area_ratio,
        Friction(*g.rotor_friction),
        Friction(*g.stator_friction),
        g.inlet_loss,
        g.exit_recovery,
    )
    return seal, SealCondition(
        inlet, outlet, g.temperature, speed, gas, g.preswirl if speed else 0.0
    )


@dataclass(frozen=True, slots=True)
class SealCoefficients:
    """K, k [N/m] direct and cross-coupled stiffness, C, c [N s/m] damping, M [kg] added mass."""

    K: float = 0.0
    k: float = 0.0
    C: float = 0.0
    c: float = 0.0
    M: float = 0.0


def coefficients(
    seal: Seal, pressure: float = 0.0, speed: float = 0.0, frequency: float | None = None
) -> SealCoefficients:
    """The coefficients at a differential pressure [Pa], spin speed [rad/s] and whirl frequency
    [rad/s] (None: the speed).

    Constants first; a table replaces those it lists, by linear interpolation over its axes; a
    geometry replaces K, k, C and c by those of its bulk flow; then those that
    ``scales_with_pressure`` names are multiplied by pressure/reference_pressure. Raises
    InvalidInput outside the table (nothing is extrapolated), above a geometry's highest frequency,
    for a flow that chokes, and for a negative pressure.
    """
    remedy = "give the pressure drop across the seal, not an absolute or negative pressure"
    pressure = check_positive(
        pressure, f"the pressure [Pa] of seal {seal.name}", remedy, zero_allowed=True
    )
    point = {
        "pressure": pressure,
        "speed": speed,
        "frequency": speed if frequency is None else frequency,
    }
    result = SealCoefficients(seal.K, seal.k, seal.C, seal.c, seal.M)
    if seal.table is not None:
        result = replace(result, **_interpolated(seal.name, seal.table, point))
    if seal.geometry is not None:
        result = replace(result, **gas_coefficients(seal, pressure, speed, point["frequency"]))
    if not seal.scales_with_pressure:
        return result
    remedy = "give the pressure [Pa] of its coefficients"
    if seal.reference_pressure is None:
        raise invalid(
            f"the reference_pressure of seal {seal.name}",
            "missing",
            "given for scales_with_pressure",
            remedy,
        )
    ratio = pressure / check_positive(
        seal.reference_pressure, f"the reference_pressure [Pa] of seal {seal.name}", remedy
    )
    return replace(
        result, **{name: ratio * getattr(result, name) for name in seal.scales_with_pressure}
    )


def matrices(coefficients: SealCoefficients) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stiffness (2, 2) [N/m], damping (2, 2) [N s/m] and added mass (2, 2) [kg] in x, y, as in the
    force law above.
    """
    s = coefficients
    return (
        np.array([[s.K, s.k], [-s.k, s.K]]),
        np.array([[s.C, s.c], [-s.c, s.C]]),
        np.diag([s.M, s.M]),
    )


def parameters(coefficients: SealCoefficients) -> tuple[float, float, float, float, float]:
    """What ``force`` needs: (K, k [N/m], C, c [N s/m], M [kg])."""
    s = coefficients
    return (float(s.K), float(s.k), float(s.C), float(s.c), float(s.M))


def force(
    x: float,
    y: float,
    vx: float,
    vy: float,
    ax: float,
    ay: float,
    p: tuple[float, float, float, float, float],
) -> tuple[float, float]:
    """Force (x, y) [N] on the rotor at displacements [m], velocities [m/s] and accelerations
    [m/s2]; p from ``parameters``.

    With the added mass in the rotor's mass matrix instead, call it with zero accelerations.
    Compiles with numba as it stands.
    """
    K = p[0]
    k = p[1]
    C = p[2]
    c = p[3]
    M = p[4]
    return -(K * x + k * y + C * vx + c * vy + M * ax), -(-k * x + K * y - c * vx + C * vy + M * ay)


def _interpolated(name: str, table: SealTable, point: Mapping[str, float]) -> dict[str, float]:
    """Values of the table's coefficients at a point, linear between the grid's points."""
    places = []
    for axis, grid in table.axes:
        at = _inside(name, axis, np.asarray(grid, dtype=float), point[axis])
        # grid[i] <= at <= grid[i + 1], and how far between them
        i = min(max(bisect_right(grid, at) - 1, 0), max(len(grid) - 2, 0))
        share = (at - grid[i]) / (grid[i + 1] - grid[i]) if len(grid) > 1 else 0.0
        places.append((i, share))
    return {coefficient: _between(values, places) for coefficient, values in table.values}


def _between(values: Any, places: Sequence[tuple[int, float]]) -> float:
    """The value at a place of a nested grid, linear along each axis."""
    if not places:
        return float(values)
    (i, share), *rest = places
    low = _between(values[i], rest)
    return low if share == 0 else (1 - share) * low + share * _between(values[i + 1], rest)


def _inside(name: str, axis: str, grid: np.ndarray, value: float) -> float:
    """``value``, moved onto the end of the grid where only rounding separates them."""
    slack = 1e-9 * np.abs(grid).max()
    if not grid[0] - slack <= value <= grid[-1] + slack:
        raise invalid(
            f"the {axis} of seal {name}",
            as_written(value, axis),
            f"within its table, {as_written(grid[0], axis, False)} to {as_written(grid[-1], axis)}",
            "extend the table or choose an operating point inside",
        )
    return float(np.clip(value, grid[0], grid[-1]))
