"""Annular seal: f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x' + M x'') acts on the rotor.

k > 0 drives forward whirl.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.machine.messages import as_written
from ambrose.machine.seals import Seal, SealTable
from ambrose.model.effects.gas_seal import gas_coefficients


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
    remedy = "give the pressure [Pa] at which its coefficients hold"
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
