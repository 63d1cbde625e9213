"""Beam elements of a spinning circular shaft, in one plane, for three beam theories.

Coordinates of an element: [w_1, theta_1, w_2, theta_2], the deflection and the rotation of the
cross-section at its ends, with theta = dw/dx where there is no shear. With z = w_x + j w_y the
plane matrices give M z'' - j Omega G z' + K z = f for both planes at once. What each theory holds:

==================  ==================  ================  ===================  =================
theory              translational mass  rotary inertia    gyroscopic moments   shear flexibility
==================  ==================  ================  ===================  =================
"bernoulli-euler"   yes                 no                yes                  no
"rayleigh"          yes                 yes               yes                  no
"timoshenko"        yes                 yes               yes                  yes (Cowper 1966)
==================  ==================  ================  ===================  =================

"rayleigh" is the element of Nelson & McVaugh (1976), "timoshenko" that of Nelson (1980); both use
the static deflection under end loads as shape functions. So does the conical element: its static
deflection, stiffness and inertia are integrated over the diameters that vary along it, instead of
being those of a staircase. Frequencies converge with order 4 in the element length; with shear,
whose strain is constant in an element, with order 2. ``beam_element`` takes arrays: a leading axis
runs over elements.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_finite, invalid
from ambrose.machine.description import BEAM_THEORIES

# Four Gauss points integrate the products of the shape functions (degree 6) exactly.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_POINTS, _WEIGHTS = (_POINTS + 1) / 2, _WEIGHTS / 2
# Of a cone the integrands are rational; 64 points integrate them to rounding up to a diameter ratio
# of 100 in an element.
_FINE, _FINE_WEIGHTS = np.polynomial.legendre.leggauss(64)
_FINE, _FINE_WEIGHTS = (_FINE + 1) / 2, _FINE_WEIGHTS / 2


@dataclass(frozen=True, slots=True, eq=False)
class BeamElement:
    """Matrices of one element, or of e elements at once, in [w_1, theta_1, w_2, theta_2].

    translational (..., 4, 4) [kg, kg m, kg m2]: mass of the deflection. rotary (..., 4, 4) [same]:
    mass of the tilting cross-sections, zero for "bernoulli-euler". gyroscopic (..., 4, 4) [same]:
    symmetric, the tilting weighted with the polar inertia. stiffness (..., 4, 4) [N/m, N, N m].
    shear (...,) [-]: phi = 12 E I/(kappa G A L^2), zero without shear.
    """

    translational: np.ndarray
    rotary: np.ndarray
    gyroscopic: np.ndarray
    stiffness: np.ndarray
    shear: np.ndarray

    @property
    def mass(self) -> np.ndarray:
        """Mass matrix of the theory (..., 4, 4): translational plus rotary."""
        return self.translational + self.rotary


def beam_element(
    length: ArrayLike,
    outer_diameter: ArrayLike,
    inner_diameter: ArrayLike = 0.0,
    *,
    density: ArrayLike,
    youngs_modulus: ArrayLike,
    poisson_ratio: ArrayLike = 0.3,
    mass_diameter: ArrayLike | None = None,
    theory: str = "bernoulli-euler",
) -> BeamElement:
    """The matrices of cylindrical elements, exact integrals of the static shape functions.

    length, outer_diameter, inner_diameter [m], density [kg/m3], youngs_modulus [Pa], poisson_ratio
    [-]: numbers, or arrays (e,) for e elements. Stiffness comes from outer_diameter, inertia from
    mass_diameter [m] (None: the outer diameter), both less the bore. theory: one of BEAM_THEORIES.
    Raises InvalidInput for lengths or walls that are not positive and other theories. Source:
    Nelson & McVaugh (1976), Nelson (1980); shear coefficient of Cowper (1966).
    """
    if theory not in BEAM_THEORIES:
        raise invalid(
            "the beam theory",
            repr(theory),
            f"one of {', '.join(BEAM_THEORIES)}",
            "correct beam_theory",
        )
    quantities = [length, outer_diameter, inner_diameter, density, youngs_modulus, poisson_ratio]
    quantities.append(outer_diameter if mass_diameter is None else mass_diameter)
    L, outer, inner, rho, E, nu, heavy = (
        np.asarray(a, dtype=float) for a in np.broadcast_arrays(*quantities)
    )
    _check_section(L, outer, inner, heavy, rho, E, nu)

    # phi = 12 E I/(kappa G A L^2), zero without shear
    EI = E * second_moment(outer, inner)
    phi = np.zeros_like(EI)
    if theory == "timoshenko":
        shear_modulus = E / (2 * (1 + nu))
        phi = (
            12
            * EI
            / (shear_coefficient(nu, inner / outer) * shear_modulus * area(outer, inner) * L**2)
        )

    # rho A int w^T w dz and rho I int theta^T theta dz, the latter twice in the gyroscopic moments:
    # a ring's polar moment is 2 I.
    w, theta = shape(_POINTS, L[..., None], phi[..., None])
    per_length = L[..., None, None]
    translational = (rho * area(heavy, inner))[..., None, None] * per_length * _integral(w)
    tilting = (rho * second_moment(heavy, inner))[..., None, None] * per_length * _integral(theta)
    rotary = np.zeros_like(tilting) if theory == "bernoulli-euler" else tilting
    return BeamElement(translational, rotary, 2 * tilting, _stiffness(EI, L, phi), phi)


def conical_element(
    length: float,
    outer: tuple[float, float],
    inner: tuple[float, float],
    heavy: tuple[float, float],
    *,
    density: float,
    youngs_modulus: float,
    poisson_ratio: float = 0.3,
    theory: str = "bernoulli-euler",
) -> BeamElement:
    """The matrices of one element whose diameters (left, right) [m] vary linearly: outer for the
    stiffness, heavy for the mass.

    ``shear`` is phi of the mean diameters, with which what sits inside the element is interpolated.
    With equal diameters it is ``beam_element``. Arguments and errors as there.
    """
    ends = [np.asarray(pair, dtype=float) for pair in (outer, inner, heavy)]
    args: dict[str, Any] = {
        "density": density,
        "youngs_modulus": youngs_modulus,
        "poisson_ratio": poisson_ratio,
        "theory": theory,
    }
    beam_element(length, ends[0], ends[1], mass_diameter=ends[2], **args)  # checks both ends
    middle = beam_element(
        length, ends[0].mean(), ends[1].mean(), mass_diameter=ends[2].mean(), **args
    )

    def section(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """1/(E I), 1/(kappa G A), rho A and rho I at places x in 0...1."""
        do, di, dm = (pair[0] + x * (pair[1] - pair[0]) for pair in ends)
        # E I; kappa G A with G = E/(2 (1 + nu))
        bending = youngs_modulus * second_moment(do, di)
        shear = (
            shear_coefficient(poisson_ratio, di / do)
            * youngs_modulus
            / (2 * (1 + poisson_ratio))
            * area(do, di)
        )
        slack = 1 / shear if theory == "timoshenko" else np.zeros_like(shear)
        return 1 / bending, slack, density * area(dm, di), density * second_moment(dm, di)

    def deflection(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Deflection and rotation (p, 2) at places s [m] under unit force and moment at the right
        end; the left is held.
        """
        # Gauss points t of 0...s. Force F and moment M at the right end give the curvature
        # (F (L - t) + M)/(E I): theta(s) is its integral, w(s) that of (s - t) times it and of
        # F/(kappa G A).
        t = s[:, None] * _FINE
        bend, slack, _, _ = section(t / length)
        weights = s[:, None] * _FINE_WEIGHTS
        arm, lever = length - t, s[:, None] - t
        w = [
            (weights * (arm * lever * bend + slack)).sum(axis=1),
            (weights * lever * bend).sum(axis=1),
        ]
        return np.stack(w, axis=1), np.stack(
            [(weights * arm * bend).sum(axis=1), (weights * bend).sum(axis=1)], axis=1
        )

    # flexibility: [w, theta] of the right end under [force, moment]
    # [w, theta] of the right end, beyond the rigid motion with the left one: deformation @ (w_1,
    # theta_1, w_2, theta_2). Loads (force, moment) are the inverse of the flexibility times that;
    # the flexibility is symmetric but for rounding.
    end = np.concatenate(deflection(np.array([length])))
    deformation = np.array([[-1.0, -length, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
    loads = np.linalg.solve((end + end.T) / 2, deformation)

    # Shape functions: rigid motion w_1 + s theta_1, theta_1, and the deflection under these loads.
    w, theta = deflection(length * _FINE)
    one = np.ones_like(_FINE)
    zero = np.zeros_like(_FINE)
    place = length * _FINE
    w = np.stack([one, place, zero, zero], axis=1) + w @ loads
    theta = np.stack([zero, one, zero, zero], axis=1) + theta @ loads

    # int rho A w^T w dz and int rho I theta^T theta dz;
    # K = deformation^T flexibility^-1 deformation
    _, _, mass, tilting = section(_FINE)
    stiffness = deformation.T @ loads

    def integral(rows: np.ndarray, density: np.ndarray) -> np.ndarray:
        weighted = np.sqrt(length * _FINE_WEIGHTS * density)[:, None] * rows
        return weighted.T @ weighted

    rotary = integral(theta, tilting)
    lateral = np.zeros_like(rotary) if theory == "bernoulli-euler" else rotary
    return BeamElement(
        integral(w, mass), lateral, 2 * rotary, (stiffness + stiffness.T) / 2, middle.shear
    )


def shape(
    xi: ArrayLike, length: ArrayLike, shear: ArrayLike = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Deflection and cross-section rotation inside an element as rows on its coordinates: the
    static shape under end loads.

    xi (...,) [-]: position from 0 to 1; length (...,) [m]; shear (...,) [-]: phi of the element (0:
    cubic Hermite functions). Returns w (..., 4) [-, m] and theta (..., 4) [1/m, -]. Source: Nelson
    (1980), equations (7), (8); with phi = 0 the Hermite functions and their slopes.
    """
    x, L, phi = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in (xi, length, shear)))
    x2, x3 = x**2, x**3
    scale = (1 / (1 + phi))[..., None]

    # columns: w, theta of the left end, w, theta of the right end
    w = np.stack(
        [
            1 - 3 * x2 + 2 * x3 + phi * (1 - x),
            L * (x - 2 * x2 + x3 + phi * (x - x2) / 2),
            3 * x2 - 2 * x3 + phi * x,
            L * (x3 - x2 + phi * (x2 - x) / 2),
        ],
        axis=-1,
    )
    theta = np.stack(
        [
            6 * (x2 - x) / L,
            1 - 4 * x + 3 * x2 + phi * (1 - x),
            6 * (x - x2) / L,
            3 * x2 - 2 * x + phi * x,
        ],
        axis=-1,
    )
    return scale * w, scale * theta


def area(outer: Any, inner: Any) -> Any:
    """Cross-section [m2] of a ring of diameters outer, inner [m]."""
    return np.pi / 4 * (outer**2 - inner**2)


def second_moment(outer: Any, inner: Any) -> Any:
    """Second moment of area about a diameter [m4] of a ring of diameters outer, inner [m]."""
    return np.pi / 64 * (outer**4 - inner**4)


def shear_coefficient(poisson_ratio: Any, diameter_ratio: Any = 0.0) -> Any:
    """Shear coefficient kappa [-] of a circular or hollow circular section.

    poisson_ratio [-]; diameter_ratio [-]: inner over outer diameter. Source: Cowper (1966), J.
    Appl. Mech. 33, table 1.
    """
    nu, m2 = poisson_ratio, diameter_ratio**2
    return 6 * (1 + nu) * (1 + m2) ** 2 / ((7 + 6 * nu) * (1 + m2) ** 2 + (20 + 12 * nu) * m2)


def _integral(rows: np.ndarray) -> np.ndarray:
    """Integral over xi of rows' rows, (..., 4, 4), from rows (..., points, 4); symmetric to the
    last bit.
    """
    weighted = np.sqrt(_WEIGHTS)[:, None] * rows
    return np.einsum("...pi,...pj->...ij", weighted, weighted)


def _stiffness(EI: np.ndarray, L: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """The element of Nelson (1980) from its two deformations, which no rigid motion excites:

    bend = theta_2 - theta_1 with stiffness E I/L, and shear = (theta_1 + theta_2)/2 - (w_2 - w_1)/L
    with 12 E I/((1 + phi) L).
    """
    zero = np.zeros_like(L)
    half = np.full_like(L, 0.5)
    inverse = 1 / L

    # the deformations as rows on (w_1, theta_1, w_2, theta_2)
    bend = np.stack([zero, zero - 1, zero, zero + 1], axis=-1)
    shear = np.stack([inverse, half, -inverse, half], axis=-1)
    first = (EI / L)[..., None, None] * (bend[..., :, None] * bend[..., None, :])
    return first + (12 * EI / ((1 + phi) * L))[..., None, None] * (
        shear[..., :, None] * shear[..., None, :]
    )


def _check_section(
    L: np.ndarray,
    outer: np.ndarray,
    inner: np.ndarray,
    heavy: np.ndarray,
    rho: np.ndarray,
    E: np.ndarray,
    nu: np.ndarray,
) -> None:
    for value, name in (
        (L, "element length [m]"),
        (rho, "density [kg/m3]"),
        (E, "Young's modulus [Pa]"),
    ):
        if check_finite(value, name).min() <= 0:
            raise invalid(f"the {name}", value.min(), "positive", "correct the shaft section")
    for value, name in ((outer, "outer diameter"), (heavy, "mass diameter")):
        wall = check_finite(value, name) - check_finite(inner, "inner diameter")
        if wall.min() <= 0 or inner.min() < 0:
            at = np.unravel_index(np.argmin(wall), wall.shape)
            have = f"{value[at]:g} m around a bore of {inner[at]:g} m"
            raise invalid(
                f"the {name}",
                have,
                "greater than the bore, which is zero or more",
                "correct the shaft section",
            )
    if check_finite(nu, "Poisson's ratio").min() <= -1 or nu.max() > 0.5:
        raise invalid(
            "Poisson's ratio",
            f"{nu.min():g} to {nu.max():g}",
            "above -1 and at most 0.5",
            "correct the material",
        )
