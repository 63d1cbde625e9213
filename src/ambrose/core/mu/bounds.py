"""Structured singular value mu(M) = 1 / min{ sigma_max(Delta) : det(I - M Delta) = 0 }, mixed real
and complex blocks.

The public face: ``mu_bounds`` at given matrices, ``mu_peak`` over frequency. The algorithms are in
upper.py, lower.py and bounds.py; all_frequencies.py proves a level.

With real blocks only, mu is a discontinuous function of M and may be 0 (det(I - M Delta) never
vanishes for real Delta, as for M = 6.78j): the smallest error in M, or a step in frequency, may
change it by a jump. The upper bound is safe at the M it is given and nowhere else; a claim over
frequency needs ``proved_level``. Some complex uncertainty (a performance block, or a few per cent
of neglected dynamics) makes mu continuous.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid, named_failure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import Block
from ambrose.core.mu.lower import lower_bound
from ambrose.core.mu.structure import Structure, check_matrix, structure_of
from ambrose.core.mu.upper import upper_bound
from ambrose.core.presentation import Presented, to_plain
from ambrose.core.statespace import as_statespace, poles

# mu of a real matrix with one repeated real block, which is an eigenvalue.
#
# With Delta = delta I and delta real, det(I - delta M) = 0 says that 1/delta is an eigenvalue of M:
# mu(M) is the largest modulus of its real eigenvalues, 0 where it has none (Zhou, Doyle & Glover
# 1996, sec. 11.2, there for the complex block and the spectral radius). The scalings of upper.py
# reach that bound only where they may grow without limit.


_ROUNDING = 10 * np.finfo(float).eps  # times n: of the norm of M, what eig solves exactly


def real_eigenvalue_bound(M: np.ndarray) -> float:
    """An upper bound of the largest |real eigenvalue| of real M (n, n), above it by rounding alone.

    A simple eigenvalue moves by at most its condition times the rounding error. Two real ones
    that nearly coincide may come out as a complex pair: a pair counts as real where rounding
    makes M - Re(lambda) I singular.
    """
    size = float(np.linalg.norm(M, 2))
    if size == 0:
        return 0.0
    error = _ROUNDING * len(M) * size
    values, left, right = sla.eig(M, left=True, right=True)

    # condition 1/|y^H x| of unit vectors; with a defective eigenvalue it is infinite, and the
    # modulus of all that may be real is at most the norm
    overlap = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    with np.errstate(divide="ignore"):
        moved = error / overlap
    real = values.imag == 0
    for k in np.flatnonzero(~real):
        shifted = M - values[k].real * np.eye(len(M))
        real[k] = np.linalg.svd(shifted, compute_uv=False)[-1] <= error + moved[k]
    return float(min(size, (np.abs(values) + moved)[real].max(initial=0.0)))


__all__ = ["MuBounds", "MuPeak", "mu_bounds", "mu_peak"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MuBounds(Presented):
    """Bounds of mu at each matrix M (..., n_z, n_w), on the grid and nowhere between.

    upper, lower (...): lower <= mu <= upper. D_w (..., n_w, n_w), D_z (..., n_z, n_z): Hermitian
    positive scalings, Delta D_z = D_w Delta; sigma_max(D_z M D_w^-1) is the complex bound. G (...,
    n_w, n_z): Hermitian on the real blocks, else zero, in M^H D_z^2 M + j (G M - M^H G^H) <=
    upper^2 D_w^2. delta (..., n_w, n_z): a perturbation with det(I - M delta) = 0 and largest
    singular value 1/lower; NaN where lower is 0 (none was found).
    """

    upper: np.ndarray
    lower: np.ndarray
    D_w: np.ndarray
    D_z: np.ndarray
    G: np.ndarray
    delta: np.ndarray
    blocks: tuple[Block, ...]

    def facts(self) -> Mapping[str, Any]:
        """The largest bounds over all matrices, and the blocks."""
        largest = {name: float(getattr(self, name).max(initial=0.0)) for name in ("upper", "lower")}
        return {
            **largest,
            "matrices": self.upper.size,
            "blocks": [block.name for block in self.blocks],
        }

    def to_dict(self) -> dict[str, Any]:
        """The bounds and the names of the blocks, ready for JSON; scalings and perturbations stay
        behind.
        """
        return {
            "upper": to_plain(self.upper),
            "lower": to_plain(self.lower),
            "blocks": [block.name for block in self.blocks],
        }

    @property
    def gap(self) -> np.ndarray:
        """(upper - lower) / upper (...), 0 where both vanish."""
        return (self.upper - self.lower) / np.where(self.upper > 0, self.upper, 1.0)

    def worst(self, index: int | tuple[int, ...] = ()) -> dict[str, complex | np.ndarray]:
        """The perturbation at one matrix by block name: a number for a repeated block (real or
        complex), an array (n_w, n_z) for a full block.
        """
        delta = self.delta[index]
        result = {}
        i = 0
        j = 0
        for block in self.blocks:
            part = delta[..., i : i + block.n_w, j : j + block.n_z]
            result[block.name] = part if block.full else part[..., 0, 0]
            i, j = i + block.n_w, j + block.n_z
        return result


@named_failure("the structured singular value")
def mu_bounds(
    M: ArrayLike,
    blocks: Sequence[Block],
    *,
    g_scaling: bool = True,
    lower: bool = True,
    tolerance: float = 1e-4,
    max_iterations: int = 120,
    restarts: int = 4,
    seed: int = 0,
) -> MuBounds:
    """Upper and lower bound of the structured singular value of every matrix in M, with the
    scalings and a worst perturbation.

    M (..., n_z, n_w): maps w to z, w = Delta z; leading axes are a batch, typically frequencies.
    blocks: RealBlock, ComplexBlock, FullBlock in the order of the channels. g_scaling: False treats
    real blocks as complex (D-K wants G = 0). lower: False skips the lower bound (it is then 0).
    tolerance [-]: relative distance at which either search stops. max_iterations: Newton steps of
    the upper bound. restarts, seed: random starts of the lower bound where a gap remains.

    The upper bound is re-verified with the final scalings by one eigenvalue computation, rounding
    error included; the lower bound by the singular values of I - M delta. The upper bound is within
    ``tolerance`` of the best with these scalings; with real blocks alone, where mu jumps and the
    scalings may grow without bound, it holds but may be looser; of one real block on a real matrix
    it is the largest real eigenvalue, below what the scalings returned prove. A matrix that
    rounding makes singular on the way costs itself some tightness and the others of the batch
    nothing. Raises InvalidInput when the blocks do not fit M, or M is not finite. Fan, Tits & Doyle
    1991 (upper bound); Packard, Fan & Doyle 1988 and Young & Doyle 1990 (lower bound).
    """
    structure = structure_of(blocks)
    array = check_matrix(M, structure)
    check_positive(tolerance, "tolerance", "use something like 1e-4")
    if max_iterations < 1 or restarts < 0 or seed < 0:
        settings = (max_iterations, restarts, seed)
        raise invalid(
            "max_iterations, restarts, seed", settings, "at least 1, 0 and 0", "leave the defaults"
        )
    batch = array.shape[:-2]
    flat = array.reshape(int(np.prod(batch)), structure.n_z, structure.n_w)
    # sizes near 1 whatever the units, so that nothing over- or underflows
    scale = np.abs(flat).max(axis=(1, 2), initial=0.0)
    scale = np.where(scale > 0, scale, 1.0)
    unit = flat / scale[:, None, None]
    up = upper_bound(
        unit, structure, g_scaling=g_scaling, tolerance=tolerance, max_iterations=max_iterations
    )
    if g_scaling and len(blocks) == 1 and blocks[0].real:
        up = replace(up, value=_with_real_eigenvalues(unit, up.value))
    value, delta = (
        np.zeros(len(flat)),
        np.full((len(flat), structure.n_w, structure.n_z), np.nan, complex),
    )
    if lower:
        low = lower_bound(
            unit, structure, up.value, up.worst, tolerance=tolerance, restarts=restarts, seed=seed
        )
        value, delta = np.minimum(low.value, up.value), low.delta
    D_w, D_z, G = _square_roots(up.X_w, up.X_z, up.G * scale[:, None, None], structure)
    return MuBounds(
        (up.value * scale).reshape(batch),
        (value * scale).reshape(batch),
        D_w.reshape(*batch, *D_w.shape[1:]),
        D_z.reshape(*batch, *D_z.shape[1:]),
        G.reshape(*batch, *G.shape[1:]),
        (delta / scale[:, None, None]).reshape(*batch, *delta.shape[1:]),
        tuple(blocks),
    )


def _with_real_eigenvalues(M: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """The bounds (b,), lower where a matrix is real and its real eigenvalues say more."""
    real = np.flatnonzero((M.imag == 0).all(axis=(1, 2)))
    tight = bound.copy()
    tight[real] = [min(bound[k], real_eigenvalue_bound(M[k].real)) for k in real]
    return tight


def _square_roots(
    X_w: np.ndarray, X_z: np.ndarray, G: np.ndarray, structure: Structure
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hermitian roots D of X, block by block; the last block's first entry is scaled to 1, and G
    with it.
    """
    last = structure.places[-1]
    unit = X_w[:, last.w.start, last.w.start].real[:, None, None]
    X_w = X_w / unit
    X_z = X_z / unit
    G = G / unit
    D_w, D_z = np.zeros_like(X_w), np.zeros_like(X_z)
    for place in structure.places:
        for X, D, part in ((X_w, D_w, place.w), (X_z, D_z, place.z)):
            values, vectors = np.linalg.eigh(X[:, part, part])
            root = (
                vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
            ) @ vectors.conj().swapaxes(1, 2)
            D[:, part, part] = root
    return D_w, D_z, G


# The structured singular value over frequency: a grid, refined until its peak is no artefact of it.
#
# What is returned is still "on the grid"; ``all_frequencies.proved_level`` proves a level between
# the points, too.


_ROUNDS = 12  # of the refinement of a peak

Response = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MuPeak(Presented):
    """The largest bounds found on a refined grid.

    upper at frequency [rad/s]; lower at lower_frequency [rad/s], with delta (n_w, n_z) that proves
    it (NaN when lower is 0); omega (w,) [rad/s] the refined grid and values (w,) the upper bound
    there; resolved: whether a finer grid would change ``upper`` by less than the tolerance, judged
    by its neighbours (a judgement, no proof).
    """

    _FACTS: ClassVar = ("upper", "frequency", "lower", "lower_frequency", "resolved")

    upper: float
    frequency: float
    lower: float
    lower_frequency: float
    delta: np.ndarray
    omega: np.ndarray
    values: np.ndarray
    resolved: bool


def _response(system: Any, structure: Structure) -> Response:
    """M(omega) from a system or a callable, checked against the blocks."""
    if callable(system) and not hasattr(system, "A"):
        return lambda omega: check_matrix(system(omega), structure)
    state_space = as_statespace(system)
    return lambda omega: check_matrix(frequency_response(state_space, omega).values, structure)


def _grid(omega: ArrayLike, system: Any) -> np.ndarray:
    """The sorted grid; a system's resonances inside it are added."""
    grid = np.unique(check_shape(omega, "omega", "(w)").astype(float))
    if len(grid) < 3 or grid[0] < 0:
        raise invalid(
            "omega",
            f"{len(grid)} frequencies from {grid.min(initial=0):g}",
            "3 or more, none negative",
            "widen it",
        )
    if hasattr(system, "A"):
        p = poles(system)
        dt = getattr(system, "dt", None)
        if dt:
            # s = log(z) / dt; a pole at z = 0 has none
            p = np.log(p[np.abs(p) > 0].astype(complex)) / dt
        extra = np.abs(p[p.imag > 0].imag)
        grid = np.unique(np.concatenate([grid, extra[(extra > grid[0]) & (extra < grid[-1])]]))
    return grid


def _between(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Geometric middle, arithmetic from zero."""
    return np.where(low > 0, np.sqrt(low * high), 0.5 * (low + high))


@named_failure("the peak of the structured singular value")
def mu_peak(
    system: Any,
    blocks: Sequence[Block],
    omega: ArrayLike,
    *,
    lower: bool = True,
    tolerance: float = 1e-4,
    max_points: int = 3000,
) -> MuPeak:
    """The peak of mu over frequency, refined around the high local maxima of its upper bound until
    they stand still.

    system: a system from w to z (or a callable, omega (w,) [rad/s] -> M (w, n_z, n_w)). omega (w,)
    [rad/s]: the starting grid. Points are added halfway to the neighbours of every local maximum
    within 10 % of the largest, and once between all neighbours of which one is above half the
    largest. The result is a statement on the final grid, its upper bound to ``tolerance`` where
    ``resolved``.

    Raises InvalidInput when blocks and system do not fit, or a frequency coincides with a pole.
    """
    structure = structure_of(blocks)
    check_positive(tolerance, "tolerance", "use something like 1e-4")
    respond = _response(system, structure)

    # at points (w,): the upper bound, and the direction in which it is tight (w, n_w)
    def bound(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = upper_bound(respond(points), structure, tolerance=tolerance / 4)
        return found.value, found.worst

    grid = _grid(omega, system)
    values, tight = bound(grid)
    resolved = False
    for count in range(_ROUNDS):
        # Which gaps are halved: the first time all those beside a value above half the largest,
        # then those beside the high local maxima.
        top = values.max()
        if count == 0:
            chosen = np.maximum(values[:-1], values[1:]) > 0.5 * top
        else:
            padded = np.concatenate([[-np.inf], values, [-np.inf]])
            high = (values >= padded[:-2]) & (values >= padded[2:]) & (values > 0.9 * top)
            chosen = high[:-1] | high[1:]
        new = _between(grid[:-1], grid[1:])[chosen]
        new = new[~np.isin(new, grid)]
        if len(new) == 0 or len(grid) + len(new) > max_points:
            break
        more = bound(new)
        order = np.argsort(np.concatenate([grid, new]))
        grid, values, tight = (
            np.concatenate(pair)[order]
            for pair in ((grid, new), (values, more[0]), (tight, more[1]))
        )

        # At rest: the last refinement raised the peak by little, and its neighbours are as high.
        k = int(values.argmax())
        near = values[max(0, k - 1) : k + 2]
        if (
            count
            and values[k] - top <= 0.25 * tolerance * values[k]
            and values[k] - near.min() <= tolerance * values[k]
        ):
            resolved = True
            break
    k = int(values.argmax())
    best = 0.0
    at = float(grid[k])
    delta = np.full((structure.n_w, structure.n_z), np.nan, complex)
    if lower:
        # The lower bound where the upper one is largest; its peak may lie at another of these
        # points.
        chosen = np.argsort(values)[::-1][:40]
        M = respond(grid[chosen])
        low = lower_bound(M, structure, values[chosen], tight[chosen], tolerance=tolerance)
        j = int(low.value.argmax())
        best = float(low.value[j])
        at = float(grid[chosen[j]])
        delta = low.delta[j]
    return MuPeak(
        float(values[k]),
        float(grid[k]),
        min(best, float(values[k])),
        at,
        delta,
        grid,
        values,
        resolved,
    )
