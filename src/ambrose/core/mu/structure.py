"""What the structured singular value needs to know about a list of blocks: where each one sits, and
how to balance M.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.lft import Block, ComplexBlock, FullBlock, RealBlock

_SWEEPS = 30  # Osborne iterations; each is one pass over all groups


@dataclass(frozen=True, slots=True)
class Place:
    """One block, the rows of w and the rows of z it owns."""

    block: Block
    w: slice
    z: slice


@dataclass(frozen=True, slots=True)
class Structure:
    """The blocks in order, w = Delta z. ``places`` has one entry per block; n_w, n_z are the
    totals.
    """

    places: tuple[Place, ...]
    n_w: int
    n_z: int

    @property
    def real(self) -> tuple[Place, ...]:
        return tuple(place for place in self.places if place.block.real)

    @property
    def complex(self) -> tuple[Place, ...]:
        return tuple(place for place in self.places if not place.block.real)


def structure_of(blocks: Sequence[Block]) -> Structure:
    """The places of ``blocks``. Raises InvalidInput when the list is empty or holds something else
    than blocks.
    """
    blocks = list(blocks)
    if not blocks:
        raise InvalidInput(
            "the list of blocks is empty; give at least one RealBlock, ComplexBlock or FullBlock"
        )
    places = []
    i = 0
    j = 0
    for block in blocks:
        if not isinstance(block, RealBlock | ComplexBlock | FullBlock):
            raise invalid(
                "a block",
                repr(block),
                "a RealBlock, ComplexBlock or FullBlock",
                "see ambrose.core.lft",
            )
        places.append(Place(block, slice(i, i + block.n_w), slice(j, j + block.n_z)))
        i, j = i + block.n_w, j + block.n_z
    return Structure(tuple(places), i, j)


def check_matrix(M: ArrayLike, structure: Structure) -> np.ndarray:
    """``M`` as a complex array (..., n_z, n_w). Raises InvalidInput naming both sizes when the
    blocks do not fit, or on NaN.
    """
    M = check_finite(M, "M")
    if M.ndim < 2 or M.shape[-2:] != (structure.n_z, structure.n_w):
        listed = ", ".join(
            f"{place.block.name} {place.block.n_z} x {place.block.n_w}"
            for place in structure.places
        )
        raise invalid(
            "the shape of M",
            M.shape,
            f"(..., {structure.n_z}, {structure.n_w}), from the blocks' z and w sizes ({listed})",
            "M maps w to z: one column per input w = Delta z, one row per output z; list the "
            "blocks in that order",
        )
    return M.astype(complex)


def channel_groups(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Which channel is in which of Osborne's groups, (groups, n_w), (groups, n_z): full blocks
    whole, other channels alone.
    """
    w_group = []
    z_group = []
    count = 0
    for place in structure.places:
        block = place.block
        if block.full:
            w_group += [count] * block.n_w
            z_group += [count] * block.n_z
            count += 1
        else:
            w_group += range(count, count + block.repeat)
            z_group += range(count, count + block.repeat)
            count += block.repeat
    numbers = np.arange(count)[:, None]
    return (numbers == np.array(w_group)).astype(float), (numbers == np.array(z_group)).astype(
        float
    )


def osborne(M: np.ndarray, structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diagonal scalings that even out the off-diagonal blocks: M' = diag(d_z) M diag(1/d_w), d_z
    (b, n_z), d_w (b, n_w).

    Osborne's iteration on Frobenius norms (Osborne 1960). Norms are floored at 1e-9 of the largest,
    so that a reducible M gives finite scalings. M (b, n_z, n_w).
    """
    # N_gj = |M_gj|^2, Frobenius, between the groups; M over its largest entry
    P_w, P_z = channel_groups(structure)
    groups = len(P_w)
    top = np.abs(M).max(axis=(1, 2), keepdims=True)
    N = P_z @ (np.abs(M / np.where(top > 0, top, 1.0)) ** 2) @ P_w.T
    log_d = np.zeros((len(M), groups))  # log of d squared
    off = ~np.eye(groups, dtype=bool)
    for _ in range(_SWEEPS if groups > 1 else 0):
        before = log_d.copy()
        for g in range(groups):
            # weight_j = d_j^2 / d_g^2
            weight = np.exp(np.clip(log_d - log_d[:, g : g + 1], -600, 600))
            row = (N[:, g, :] / weight)[:, off[g]].sum(axis=1)  # |d_g M_gj / d_j|^2
            column = (N[:, :, g] * weight)[:, off[g]].sum(axis=1)

            # d_g^2 times f gives row f and column / f: equal for f = sqrt(column / row)
            floor = 1e-18 * (N[:, g, g] + row + column) + 1e-200
            log_d[:, g] -= 0.5 * np.log((row + floor) / (column + floor))
        if np.abs(log_d - before).max(initial=0.0) < 1e-2:
            break

    # A common factor of all d changes nothing: their geometric mean is 1.
    log_d -= log_d.mean(axis=1, keepdims=True)
    d = np.exp(0.5 * np.clip(log_d, -100, 100))  # a ratio of 1e43: its square, in X, stays in range
    d_z, d_w = d @ P_z, d @ P_w
    return d_z[:, :, None] * M / d_w[:, None, :], d_z, d_w


# The unknowns of the D and G scalings: X commutes with Delta, G is Hermitian on the real blocks, as
# one real vector x.
#
# S(x) = [[X_w, -j G~], [j G~^H, -X_z]] with the blocks of X appended once more (the rows "x": the
# barrier that keeps X > 0); it is linear, S(x) = sum x_a S_a. A repeated block of size r owns r^2
# unknowns for X (and r^2 for G when real), a full block one.


Entry = tuple[int, int, complex, int]  # row, column, coefficient, variable
_CHUNK = 1_000_000  # products of two entries held at once
_DENSE = 500  # coefficients up to which dense arrays are faster than sparse ones


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """S_a as sparse entries at the positions (row, column); those of full blocks are kept apart by
    their diagonal.

    mix (positions, variables): S_a at the positions; half (variables, positions above or on the
    diagonal, numbered in ``upper``): the same with those off the diagonal twice, so that tr(H S_a)
    = Re sum half H[column, row] for Hermitian H.
    """

    n_w: int
    n_z: int
    n_x: int  # one row per repeated channel and one per full block
    count: int  # variables
    row: np.ndarray
    column: np.ndarray
    upper: np.ndarray
    mix: Any  # dense or sparse
    half: Any
    full: tuple[tuple[int, np.ndarray], ...]  # (variable, diagonal of S_a)
    trace: np.ndarray  # (variables,) tr X
    is_g: np.ndarray  # (variables,) bool

    @property
    def start(self) -> np.ndarray:
        """X = I, G = 0."""
        return self.trace

    def assemble(self, x: np.ndarray) -> np.ndarray:
        """S (b, N, N) for variables x (b, variables)."""
        N = self.n_w + self.n_z + self.n_x
        S = np.zeros((len(x), N, N), complex)
        if len(self.row):
            S[:, self.row, self.column] = (self.mix @ x.T).T
        diagonal = np.arange(N)
        for variable, weight in self.full:
            S[:, diagonal, diagonal] += x[:, variable, None] * weight
        return S

    def traces(self, K: np.ndarray) -> np.ndarray:
        """tr(K S_a) for every variable and Hermitian K (b, N, N), (b, variables)."""
        values = np.zeros((len(K), self.count))
        if len(self.row):
            values += (self.half @ K[:, self.column[self.upper], self.row[self.upper]].T).real.T
        diagonal = np.einsum("bii->bi", K).real
        for variable, weight in self.full:
            values[:, variable] += diagonal @ weight
        return values

    def curvature(self, K: np.ndarray) -> np.ndarray:
        """tr(K S_a K S_b) for Hermitian K (b, N, N), (b, variables, variables)."""
        H = np.zeros((len(K), self.count, self.count))
        if len(self.row):
            step = max(1, _CHUNK // (len(self.row) * len(self.upper)))
            for start in range(0, len(K), step):
                H[start : start + step] = self._curvature(K[start : start + step])
        for variable, weight in self.full:
            # S_a = diag(weight): tr(K diag(weight) K S_b)
            column = self.traces((K * weight) @ K)
            H[:, :, variable] = column
            H[:, variable, :] = column
        return H

    def _curvature(self, K: np.ndarray) -> np.ndarray:
        """The same without the full blocks: K[q, r] K[s, p] over the positions (p, q) and (r, s),
        and the coefficients.
        """
        b, N = len(K), K.shape[1]
        # neighbours in memory: the members of the batch
        flat = np.ascontiguousarray(K.reshape(b, N * N).T)

        # (p, q): positions of S_b above or on the diagonal; (row, column) = (r, s): those of S_a
        # tr(K S_a K S_b) = sum K[q, r] S_a[r, s] K[s, p] S_b[p, q]
        p, q = self.row[self.upper], self.column[self.upper]
        pairs = flat[q * N + self.row[:, None]]
        pairs *= flat[self.column[:, None] * N + p]

        # the sum over (r, s) first, then over (p, q): K S_a K is Hermitian, as ``half`` needs it
        once = (self.mix.T @ pairs.reshape(len(self.row), -1)).reshape(self.count, len(p), b)
        twice = self.half @ once.swapaxes(0, 1).reshape(len(p), -1)
        return np.asarray(twice.real.reshape(self.count, self.count, b).transpose(2, 0, 1))


def _hermitian(r: int) -> list[list[tuple[int, int, complex]]]:
    """A basis of the Hermitian r x r matrices: the diagonal first, then pairs (real, imaginary)."""
    basis: list[list[tuple[int, int, complex]]] = [[(p, p, 1.0 + 0j)] for p in range(r)]
    for p in range(r):
        for q in range(p + 1, r):
            basis += [[(p, q, 1.0 + 0j), (q, p, 1.0 + 0j)], [(p, q, 1j), (q, p, -1j)]]
    return basis


def scaling_basis(structure: Structure, *, g_scaling: bool) -> Basis:
    """The unknowns for a structure; ``g_scaling=False`` leaves G out."""
    n_w, n_z = structure.n_w, structure.n_z
    n_x = sum(1 if place.block.full else place.block.n_w for place in structure.places)

    # rows and columns of S: w, z, and the rows "x"
    N = n_w + n_z + n_x
    entries: list[Entry] = []
    full: list[tuple[int, np.ndarray]] = []
    trace: list[float] = []
    is_g: list[bool] = []
    x = n_w + n_z
    for place in structure.places:
        w = place.w.start
        z = n_w + place.z.start
        block = place.block
        if block.full:
            # X = x I on both sides: S_a = diag(I, -I), and x itself once in the barrier
            diagonal = np.zeros(N)
            diagonal[w : w + block.n_w] = 1.0
            diagonal[z : z + block.n_z] = -1.0
            diagonal[x] = 1.0
            full.append((len(trace), diagonal))
            trace = [*trace, 1.0]
            is_g = [*is_g, False]
            x = x + 1
            continue

        # X_w = X_z = X in the rows w, -X in the rows z, X in the barrier
        for matrix in _hermitian(block.n_w):
            for p, q, c in matrix:
                entries += [
                    (w + p, w + q, c, len(trace)),
                    (z + p, z + q, -c, len(trace)),
                    (x + p, x + q, c, len(trace)),
                ]
            trace, is_g = [*trace, float(len(matrix) == 1)], [*is_g, False]

        # -j G~ in (w, z), j G~^H = j G~ in (z, w)
        for matrix in _hermitian(block.n_w) if g_scaling and block.real else []:
            for p, q, c in matrix:
                entries += [(w + p, z + q, -1j * c, len(trace)), (z + p, w + q, 1j * c, len(trace))]
            trace, is_g = [*trace, 0.0], [*is_g, True]
        x += block.n_w
    return _frozen((n_w, n_z, n_x), entries, full, trace, is_g)


def _frozen(
    sizes: tuple[int, int, int],
    entries: list[Entry],
    full: list[tuple[int, np.ndarray]],
    trace: list[float],
    is_g: list[bool],
) -> Basis:
    """The lists as arrays."""
    from scipy.sparse import csr_array

    # every position that occurs, sorted, and its number
    number = {position: i for i, position in enumerate(sorted({entry[:2] for entry in entries}))}
    place = np.array(list(number), int).reshape(-1, 2)
    coefficient, variable = [entry[2] for entry in entries], [entry[3] for entry in entries]
    position = [number[entry[:2]] for entry in entries]
    mix: Any = np.zeros((len(place), len(trace)), complex)
    np.add.at(mix, (position, variable), coefficient)

    # tr(H S_a) needs the upper triangle alone, what is off the diagonal twice.
    upper = np.flatnonzero(place[:, 0] <= place[:, 1])
    half: Any = mix[upper].T * np.where(place[upper, 0] < place[upper, 1], 2.0, 1.0)
    if mix.size > _DENSE:
        mix, half = csr_array(mix), csr_array(half)
    return Basis(
        *sizes,
        len(trace),
        place[:, 0],
        place[:, 1],
        upper,
        mix,
        half,
        tuple(full),
        np.array(trace),
        np.array(is_g),
    )
