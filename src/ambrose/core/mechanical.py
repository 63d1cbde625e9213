"""Second-order mechanical systems M q'' + (D + Omega G) q' + K q = B f, with displacement and velocity outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.core.statespace import StateSpace

_DENSE_LIMIT = 500  # coordinates up to which a dense eigensolution is the fastest way to a few modes


@dataclass(frozen=True, slots=True, eq=False)
class SecondOrder:
    """M q'' + (D + Omega G) q' + K q = B f, displacement outputs C q, velocity outputs Cv q'.

    mass (n, n) [kg, kg m2]: symmetric, positive definite. damping (n, n) [N s/m]. gyroscopic (n, n) [kg m2]: skew.
    stiffness (n, n) [N/m]: any (cross-coupled springs make it unsymmetric). B (n, m), C (p, n), Cv (r, n).
    Raises InvalidInput.
    """

    mass: np.ndarray
    damping: np.ndarray
    gyroscopic: np.ndarray
    stiffness: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Cv: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    velocity_outputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = check_shape(self.mass, "mass", "(n, n)").shape[0]
        for name in ("damping", "gyroscopic", "stiffness"):
            check_shape(getattr(self, name), name, "(n, n)", n=n)
        check_shape(self.B, "B", "(n, m)", n=n, m=len(self.inputs))
        check_shape(self.C, "C", "(p, n)", p=len(self.outputs), n=n)
        check_shape(self.Cv, "Cv", "(r, n)", r=len(self.velocity_outputs), n=n)
        scale = np.abs(self.gyroscopic).max(initial=0.0)
        if np.abs(self.gyroscopic + self.gyroscopic.T).max(initial=0.0) > 1e-9 * scale:
            raise invalid("gyroscopic", "not skew-symmetric", "skew (G = -G^T)", "put its symmetric part into damping")

    @property
    def n(self) -> int:
        """The number of coordinates; the state space has twice as many states."""
        return self.mass.shape[0]


def to_statespace(system: SecondOrder, speed: float = 0.0) -> StateSpace:
    """First-order form at a spin speed [rad/s], in mass-normalised coordinates z = L^T q (M = L L^T).

    The states are z and z'/s with one scalar s; without these two scalings rigid-body poles lose four digits.
    """
    L = _cholesky(system.mass)

    def congruent(X: np.ndarray) -> np.ndarray:
        half = sla.solve_triangular(L, X, lower=True)
        return sla.solve_triangular(L, half.T, lower=True).T

    K = congruent(system.stiffness)
    D = congruent(system.damping + speed * system.gyroscopic)
    s = float(np.sqrt(max(float(np.linalg.norm(K, 2)), 1.0)))
    n = system.n
    B = sla.solve_triangular(L, system.B, lower=True)
    C = sla.solve_triangular(L, system.C.T, lower=True).T
    Cv = sla.solve_triangular(L, system.Cv.T, lower=True).T
    A = np.block([[np.zeros((n, n)), s * np.eye(n)], [-K / s, -D]])
    return StateSpace(
        A,
        np.vstack([np.zeros_like(B), B / s]),
        np.vstack([np.hstack([C, np.zeros_like(C)]), np.hstack([np.zeros_like(Cv), Cv * s])]),
        np.zeros((len(C) + len(Cv), B.shape[1])),
        system.inputs,
        system.outputs + system.velocity_outputs,
    )


def _cholesky(mass: np.ndarray) -> np.ndarray:
    try:
        return sla.cholesky(mass, lower=True)
    except sla.LinAlgError as error:
        raise invalid(
            "the mass matrix",
            "not positive definite",
            "symmetric positive definite",
            "look for an element without mass",
        ) from error


def undamped_modes(mass: np.ndarray, stiffness: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The lowest modes of M q'' + K q = 0 for symmetric M (n, n), K (n, n).

    Returns frequencies (count,) [rad/s] (zero for rigid-body modes) and mass-orthonormal shapes (n, count). Large problems
    go through a sparse shift-invert Lanczos iteration. Raises InvalidInput when ``count`` exceeds n.
    """
    n = mass.shape[0]
    if not 0 < count <= n:
        raise invalid("the number of modes", count, f"between 1 and {n}", "refine the mesh or ask for fewer")
    if n <= _DENSE_LIMIT or count > n // 4:
        values, shapes = sla.eigh(stiffness, mass, subset_by_index=[0, count - 1])
    else:
        values, shapes = _sparse_modes(mass, stiffness, count)
    values[np.abs(values) < 1e-9 * max(np.abs(values).max(), 1.0)] = 0.0
    if (values < 0).any():
        raise InvalidInput(f"the stiffness has a negative mode ({values.min():g} rad2/s2); give the free rotor's stiffness")
    return np.sqrt(values), shapes


def _sparse_modes(mass: np.ndarray, stiffness: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import eigsh

    # A negative shift keeps K - sigma M definite although the free rotor's K is singular.
    sigma = -1e-8 * np.abs(np.diag(stiffness)).max() / np.abs(np.diag(mass)).max()
    start = np.ones(mass.shape[0])
    values, shapes = eigsh(csc_array(stiffness), count, csc_array(mass), sigma=sigma, v0=start)
    order = np.argsort(values)
    return values[order], shapes[:, order]


def project(system: SecondOrder, basis: np.ndarray) -> SecondOrder:
    """Galerkin projection q = basis eta onto the columns of basis (n, k); all signals are kept."""
    basis = check_shape(basis, "basis", "(n, k)", n=system.n)
    V = basis
    return SecondOrder(
        V.T @ system.mass @ V, V.T @ system.damping @ V, V.T @ system.gyroscopic @ V, V.T @ system.stiffness @ V,
        V.T @ system.B, system.C @ V, system.Cv @ V, system.inputs, system.outputs, system.velocity_outputs,
    )  # fmt: skip
