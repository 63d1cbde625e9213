"""The curve of iron, H over B, with its derivative and the energy below it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid
from ambrose.model.magnetics.vacuum import VACUUM_PERMEABILITY


@dataclass(frozen=True, slots=True)
class Froehlich:
    """H = B/(mu_0 mu_r (1 - |B|/B_s)): permeability mu_r without field, and a flux density B_s [T]
    that is never reached (Froehlich's hyperbola). Raises InvalidInput where one is not positive.
    """

    permeability: float
    flux_density: float

    def __post_init__(self) -> None:
        check_positive(self.permeability, "the relative permeability of iron", "3000 is usual")
        check_positive(self.flux_density, "the saturation [T] of iron", "1.8 T is usual")

    @property
    def limit(self) -> float:
        """The flux density [T] that the iron never reaches."""
        return self.flux_density

    def field(self, flux_density: ArrayLike) -> np.ndarray:
        """H [A/m] at B [T] of any shape."""
        b = np.asarray(flux_density, dtype=float)
        return b / (self._initial * (1 - np.abs(b) / self.flux_density))

    def slope(self, flux_density: ArrayLike) -> np.ndarray:
        """dH/dB [A/(T m)] at B [T]."""
        b = np.abs(np.asarray(flux_density, dtype=float)) / self.flux_density
        return 1 / (self._initial * (1 - b) ** 2)

    def energy(self, flux_density: ArrayLike) -> np.ndarray:
        """Integral of H over B from 0 [J/m3]: B_s^2/(mu_0 mu_r) (-ln(1 - b) - b), b = |B|/B_s."""
        b = np.abs(np.asarray(flux_density, dtype=float)) / self.flux_density
        return self.flux_density**2 / self._initial * (-np.log1p(-b) - b)

    @property
    def _initial(self) -> float:
        return VACUUM_PERMEABILITY * self.permeability


@dataclass(frozen=True, slots=True)
class MeasuredCurve:
    """A measured curve: field H [A/m] at rising flux densities B [T], both without their origin.

    Between the points a monotone cubic; beyond the last one the slope of vacuum, 1/mu_0. Raises
    InvalidInput where either does not rise.
    """

    flux_densities: tuple[float, ...]
    fields: tuple[float, ...]

    def __post_init__(self) -> None:
        b = np.concatenate([[0.0], check_shape(self.flux_densities, "B of a curve [T]", "(n)")])
        h = np.concatenate([[0.0], check_shape(self.fields, "H of a curve [A/m]", "(n)")])
        if len(b) != len(h) or len(b) < 3 or np.diff(b).min() <= 0 or np.diff(h).min() <= 0:
            raise invalid(
                "the B-H curve of iron",
                f"{len(b) - 1} flux densities and {len(h) - 1} fields",
                "two or more pairs of B and H, both rising from zero",
                "sort the points and leave out the origin",
            )

    @property
    def limit(self) -> float:
        """There is none: beyond the curve iron is vacuum."""
        return np.inf

    def field(self, flux_density: ArrayLike) -> np.ndarray:
        """H [A/m] at B [T] of any shape."""
        b, beyond = self._split(flux_density)
        return np.sign(flux_density) * (self._curve()(b) + beyond / VACUUM_PERMEABILITY)

    def slope(self, flux_density: ArrayLike) -> np.ndarray:
        """dH/dB [A/(T m)] at B [T]."""
        b, beyond = self._split(flux_density)
        return np.where(beyond > 0, 1 / VACUUM_PERMEABILITY, self._curve().derivative()(b))

    def energy(self, flux_density: ArrayLike) -> np.ndarray:
        """Integral of H over B from 0 [J/m3]."""
        b, beyond = self._split(flux_density)
        last = float(self.fields[-1])
        return np.asarray(
            self._curve().antiderivative()(b)
            + last * beyond
            + beyond**2 / (2 * VACUUM_PERMEABILITY)
        )

    def _split(self, flux_density: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """|B| on the curve, and what is beyond its end."""
        b = np.abs(np.asarray(flux_density, dtype=float))
        last = self.flux_densities[-1]
        return np.minimum(b, last), np.maximum(b - last, 0.0)

    def _curve(self) -> Any:
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator((0.0, *self.flux_densities), (0.0, *self.fields))


IronCurve = Froehlich | MeasuredCurve
