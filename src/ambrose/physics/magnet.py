"""Magnetic bearing force, linear view: f = k_i i + k_s x per axis, k_s > 0 destabilising."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.machine.description import BiasPoint, MagnetGeometry, MagneticBearing, Pair

VACUUM_PERMEABILITY = 4e-7 * np.pi  # mu_0 [V s/(A m)]; the measured value differs by 1e-10


@dataclass(frozen=True, slots=True)
class MagnetCoefficients:
    """force_per_current k_i (zeta, eta) [N/A] and negative_stiffness k_s (zeta, eta) [N/m]."""

    force_per_current: Pair
    negative_stiffness: Pair


def linearised(bearing: MagneticBearing, bias_current: float | None = None) -> MagnetCoefficients:
    """The coefficients of a bearing at a bias current [A] (None: the bearing's own).

    At the bearing's own bias the given values win. Elsewhere measured rows are interpolated linearly (the given values count
    as one more row) and never extrapolated; without rows the geometry decides. Raises InvalidInput where nothing applies.
    """
    bias = bearing.bias_current if bias_current is None else bias_current
    bias = check_positive(bias, f"the bias current [A] of bearing {bearing.name}", "give the premagnetisation current")
    given = _given(bearing)
    if given is not None and _same(bias, given.bias_current):
        return MagnetCoefficients(given.force_per_current, given.negative_stiffness)
    if bearing.measured:
        rows = [row for row in bearing.measured if given is None or not _same(row.bias_current, given.bias_current)]
        return _interpolated(bearing.name, [*rows, *([given] if given else [])], bias)
    if bearing.geometry is not None:
        return _from_geometry(bearing.geometry, bias)
    if given is not None:
        raise invalid(
            f"the bias current of bearing {bearing.name}",
            f"{bias:g} A",
            f"the {given.bias_current:g} A at which its coefficients are given",
            "add its geometry, or measured rows at other bias currents",
        )
    raise InvalidInput(
        f"bearing {bearing.name} has no coefficients; give force_per_current and negative_stiffness, measured rows or geometry"
    )


def force_constant(geometry: MagnetGeometry) -> float:
    """k = mu_0 N^2 A/4 [N m2/A2] of an opposing pair: f = k ((i_1/s_1)^2 - (i_2/s_2)^2) cos(a) (Schweitzer & Maslen 2009)."""
    return VACUUM_PERMEABILITY * geometry.turns**2 * geometry.pole_area / 4


def _from_geometry(geometry: MagnetGeometry, bias: float) -> MagnetCoefficients:
    """k_i = 4 k i_0 cos(a)/s_0^2, k_s = 4 k i_0^2 cos(a)/s_0^3, no iron, no leakage (Schweitzer & Maslen 2009, chapter 4)."""
    k = force_constant(geometry) * np.cos(geometry.pole_half_angle)
    k_i, k_s = float(4 * k * bias / geometry.gap**2), float(4 * k * bias**2 / geometry.gap**3)
    return MagnetCoefficients((k_i, k_i), (k_s, k_s))


def _given(bearing: MagneticBearing) -> BiasPoint | None:
    """The given coefficients as a row at the bearing's own bias current."""
    k_i, k_s = bearing.force_per_current, bearing.negative_stiffness
    return None if k_i is None or k_s is None else BiasPoint(bearing.bias_current, k_i, k_s)


def _interpolated(name: str, rows: list[BiasPoint], bias: float) -> MagnetCoefficients:
    rows = sorted(rows, key=lambda row: row.bias_current)
    currents = [row.bias_current for row in rows]
    if not (currents[0] <= bias <= currents[-1] or _same(bias, currents[0]) or _same(bias, currents[-1])):
        raise invalid(
            f"the bias current of bearing {name}",
            f"{bias:g} A",
            f"within the measured {currents[0]:g} to {currents[-1]:g} A",
            "measure there, or choose a bias current inside",
        )
    k_i = [float(np.interp(bias, currents, [row.force_per_current[axis] for row in rows])) for axis in (0, 1)]
    k_s = [float(np.interp(bias, currents, [row.negative_stiffness[axis] for row in rows])) for axis in (0, 1)]
    return MagnetCoefficients((k_i[0], k_i[1]), (k_s[0], k_s[1]))


def _same(a: float, b: float) -> bool:
    return bool(np.isclose(a, b, rtol=1e-9, atol=0.0))
