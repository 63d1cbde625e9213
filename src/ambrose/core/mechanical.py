"""Second-order mechanical systems M q'' + (D + Omega G) q' + K q = B f, with displacement and
velocity outputs.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_finite, check_shape, invalid, named_failure
from ambrose.core.statespace import StateSpace

# coordinates up to which a dense eigensolution is the fastest way to a few modes
_DENSE_LIMIT = 250
_ITERATIONS = 60  # of the subspace; 10 to 20 are usual


@dataclass(frozen=True, slots=True, eq=False)
class SecondOrder:
    """M q'' + (D + Omega G) q' + K q = B f, displacement outputs C q, velocity outputs Cv q'.

    mass (n, n) [kg, kg m2]: symmetric, positive definite. damping (n, n) [N s/m]. gyroscopic (n, n)
    [kg m2]: skew. stiffness (n, n) [N/m]: any (cross-coupled springs make it unsymmetric). B (n,
    m), C (p, n), Cv (r, n). Raises InvalidInput.
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
        sizes = {"n": len(np.atleast_1d(self.mass)), "m": len(self.inputs)}
        sizes |= {"p": len(self.outputs), "r": len(self.velocity_outputs)}
        shapes = dict.fromkeys(("mass", "damping", "gyroscopic", "stiffness"), "(n, n)")
        for name, shape in {**shapes, "B": "(n, m)", "C": "(p, n)", "Cv": "(r, n)"}.items():
            object.__setattr__(self, name, check_shape(getattr(self, name), name, shape, **sizes))
        _check_symmetric(self.mass, "mass")
        scale = np.abs(self.gyroscopic).max(initial=0.0)
        if np.abs(self.gyroscopic + self.gyroscopic.T).max(initial=0.0) > 1e-9 * scale:
            raise invalid(
                "gyroscopic",
                "not skew-symmetric",
                "skew (G = -G^T)",
                "put its symmetric part into damping",
            )

    @property
    def n(self) -> int:
        """The number of coordinates; the state space has twice as many states."""
        return self.mass.shape[0]


def to_statespace(system: SecondOrder, speed: float = 0.0) -> StateSpace:
    """First-order form at a spin speed [rad/s], in mass-normalised coordinates z = L^T q (M = L
    L^T).

    The states are z_i and z_i'/s_i with s_i^2 = |K_ii| of the mass-normalised stiffness (at least 1
    rad/s): every coordinate in its own time scale. Without the two scalings rigid-body poles lose
    four digits. Raises InvalidInput when the mass matrix is not positive definite.
    """
    check_finite(speed, "speed")
    n = system.n
    K, D = system.stiffness, system.damping + speed * system.gyroscopic
    B = system.B
    C = system.C
    Cv = system.Cv
    if not np.array_equal(system.mass, np.eye(n)):
        # q = L^-T z: L^-1 K L^-T, L^-1 D L^-T, L^-1 B, C L^-T, Cv L^-T, and the mass is I
        L = _cholesky(system.mass)
        K, D = (_congruent(L, X) for X in (K, D))
        B, C, Cv = (sla.solve_triangular(L, X, lower=True) for X in (B, C.T, Cv.T))
        C, Cv = C.T, Cv.T
    return _first_order(system, -K, -D, B, C, Cv, velocity_scales(K))


def to_common_statespace(system: SecondOrder, speed: float, scales: np.ndarray) -> StateSpace:
    """First-order form in the states q_i and q_i'/s_i for given scales s (n,) [rad/s], at a spin
    speed [rad/s].

    The states mean the same for every stiffness, damping, mass and speed, as scheduling and run-ups
    need; ``to_statespace`` scales and normalises by the matrices themselves. Raises InvalidInput
    when the mass matrix is singular.
    """
    check_finite(speed, "speed")
    s = check_shape(scales, "scales", "(n,)", n=system.n)
    K, B = system.stiffness, system.B
    D = system.damping + speed * system.gyroscopic
    if not np.array_equal(system.mass, np.eye(system.n)):
        try:
            inverse = np.linalg.inv(system.mass)
        except np.linalg.LinAlgError as error:
            raise invalid(
                "the mass matrix", "singular", "positive definite", "check masses and added mass"
            ) from error
        K, B = inverse @ K, inverse @ B
        D = inverse @ D
    return _first_order(system, -K, -D, B, system.C, system.Cv, s)


def _first_order(
    system: SecondOrder,
    position: np.ndarray,
    velocity: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    Cv: np.ndarray,
    s: np.ndarray,
) -> StateSpace:
    """z'' = position z + velocity z' + B f in the states z and z'/s, with the signals of
    ``system``.
    """
    n = len(s)
    A = np.zeros((2 * n, 2 * n))

    # z' = s (z'/s);   (z'/s)' = s^-1 (position z + velocity s (z'/s) + B f)
    A[:n, n:] = np.diag(s)
    A[n:, :n] = position / s[:, None]
    A[n:, n:] = velocity / s[:, None] * s

    # Outputs: C z, then Cv z' = Cv s (z'/s).
    return StateSpace(
        A,
        np.vstack([np.zeros_like(B), B / s[:, None]]),
        np.vstack([np.hstack([C, np.zeros_like(C)]), np.hstack([np.zeros_like(Cv), Cv * s])]),
        np.zeros((len(C) + len(Cv), B.shape[1])),
        system.inputs,
        system.outputs + system.velocity_outputs,
    )


def _congruent(L: np.ndarray, X: np.ndarray) -> np.ndarray:
    """L^-1 X L^-T for lower triangular L."""
    # L^-1 (L^-1 X)^T = (L^-1 X L^-T)^T
    half = sla.solve_triangular(L, X, lower=True)
    return sla.solve_triangular(L, half.T, lower=True).T


def velocity_scales(stiffness: np.ndarray) -> np.ndarray:
    """The scale s_i [rad/s] of each velocity state, (n,), from the mass-normalised stiffness (n,
    n).
    """
    return np.sqrt(np.maximum(np.abs(np.diag(stiffness)), 1.0))


def _check_symmetric(matrix: np.ndarray, name: str) -> None:
    if np.abs(matrix - matrix.T).max(initial=0.0) > 1e-9 * np.abs(matrix).max(initial=0.0):
        raise invalid(
            f"the {name} matrix",
            "not symmetric",
            "symmetric",
            "look for an entry without its mirror image",
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


@named_failure("the modes of M q'' + K q = 0")
def undamped_modes(
    mass: np.ndarray, stiffness: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest modes of M q'' + K q = 0 for symmetric matrices, M positive definite, K positive
    semidefinite.

    mass (n, n) [kg]; stiffness (n, n) [N/m]. Returns frequencies (count,) [rad/s], exactly zero for
    rigid-body modes, and mass-orthonormal shapes (n, count). Large problems go through a sparse
    subspace iteration (Bathe 1971), in which repeated modes (two planes of a rotor) cannot get
    lost. Frequencies are good to 1e-9, shapes orthonormal to 1e-9. Raises InvalidInput when
    ``count`` exceeds n, a matrix is not symmetric, M is not positive definite or K has a negative
    mode.
    """
    mass = check_shape(mass, "mass", "(n, n)")
    n = mass.shape[0]
    stiffness = check_shape(stiffness, "stiffness", "(n, n)", n=n)
    for matrix, name in ((mass, "mass"), (stiffness, "stiffness")):
        _check_symmetric(matrix, name)
    if not 0 < count <= n:
        raise invalid(
            "the number of modes", count, f"between 1 and {n}", "refine the mesh or ask for fewer"
        )
    shapes = (
        None if n <= _DENSE_LIMIT or count > n // 8 else _subspace_iteration(mass, stiffness, count)
    )
    if shapes is None:
        try:
            _, shapes = sla.eigh(stiffness, mass, subset_by_index=[0, count - 1])
        except sla.LinAlgError:
            _cholesky(mass)
            raise
    # A dense solver leaves rounding errors of eps times the HIGHEST mode in the lowest ones; within
    # the space they cancel.
    values, shapes = _ritz(mass, stiffness, shapes)
    noise = _noise(np.abs(stiffness), shapes)
    if (values < -noise).any():
        raise InvalidInput(
            f"the stiffness has a negative mode ({values.min():g} rad2/s2); give the free rotor's "
            "stiffness"
        )
    return np.sqrt(np.where(values <= noise, 0.0, values)), shapes


def _noise(absolute_stiffness: Any, shapes: np.ndarray) -> np.ndarray:
    """What rounding in K can make of each Rayleigh quotient, (k,)."""
    size = np.abs(shapes)
    return 100 * np.finfo(float).eps * (size * (absolute_stiffness @ size)).sum(axis=0)


def _ritz(mass: Any, stiffness: Any, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The eigenvalues and mass-orthonormal vectors of the pair within the span of ``basis``,
    ascending.
    """
    # q = basis eta: (basis^T K basis) eta = w^2 (basis^T M basis) eta, columns of length one
    basis = basis / np.linalg.norm(basis, axis=0)
    k, m = basis.T @ (stiffness @ basis), basis.T @ (mass @ basis)
    values, vectors = sla.eigh((k + k.T) / 2, (m + m.T) / 2)
    return values, basis @ vectors


def _subspace_iteration(mass: np.ndarray, stiffness: np.ndarray, count: int) -> np.ndarray | None:
    """A basis (n, count) of the lowest modes, or None where it does not converge."""
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    K, M = csc_array(stiffness), csc_array(mass)
    # A small shift keeps K + shift M definite although the free rotor's K is singular.
    shift = 1e-10 * float((np.abs(np.diag(stiffness)) / np.diag(mass)).max())
    try:
        factor = splu(
            csc_array(K + shift * M), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
        )
    except (
        RuntimeError
    ):  # SuperLU met a zero pivot: the dense solver tells a singular mass from a negative mode
        return None

    # More vectors than modes asked for: the iteration converges with the ratio of w^2 to the first
    # mode outside.
    X = np.random.default_rng(0).standard_normal((len(mass), count + max(8, count // 2)))
    last, absolute = np.zeros(count), abs(K)
    for _ in range(_ITERATIONS):
        # or many vectors become one another
        values, X = _ritz(M, K, np.linalg.qr(factor.solve(M @ X))[0])

        # Settled to 1e-12, or to what rounding in K makes of it.
        change = np.abs(values[:count] - last)
        if (
            change <= 1e-12 * (np.abs(values[:count]) + shift) + _noise(absolute, X[:, :count])
        ).all():
            return X[:, :count]
        last = values[:count]
    return None


def project(system: SecondOrder, basis: np.ndarray) -> SecondOrder:
    """Galerkin projection q = basis eta onto the columns of basis (n, k); all signals are kept."""
    V = check_shape(basis, "basis", "(n, k)", n=system.n)
    return SecondOrder(
        V.T @ system.mass @ V,
        V.T @ system.damping @ V,
        V.T @ system.gyroscopic @ V,
        V.T @ system.stiffness @ V,
        V.T @ system.B,
        system.C @ V,
        system.Cv @ V,
        system.inputs,
        system.outputs,
        system.velocity_outputs,
    )
