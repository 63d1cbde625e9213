"""The unknowns of the D and G scalings: X commutes with Delta, G is Hermitian on the real blocks, as one real vector x.

S(x) = [[X_w, -j G~], [j G~^H, -X_z]] with the blocks of X appended once more (the rows "x": the barrier that keeps X > 0);
it is linear, S(x) = sum x_a S_a. A repeated block of size r owns r^2 unknowns for X (and r^2 for G when real), a full block
one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.lft import FullBlock, RealBlock
from ambrose.core.mu_structure import Structure

Entry = tuple[int, int, complex, int]  # row, column, coefficient, variable


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """S_a as sparse entries (row, column, mix), except for full blocks, kept apart by their diagonal; and all of them dense."""

    n_w: int
    n_z: int
    n_x: int  # one row per repeated channel and one per full block
    count: int  # variables
    row: np.ndarray
    column: np.ndarray
    mix: np.ndarray  # (entries, variables) complex: coefficient of each sparse entry
    dense: np.ndarray  # (variables, N N) complex: every S_a, flat, N = n_w + n_z + n_x
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
        return (x @ self.dense).reshape(len(x), N, N)


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
    n_x = sum(1 if isinstance(place.block, FullBlock) else place.block.n_w for place in structure.places)
    N = n_w + n_z + n_x
    entries: list[Entry] = []
    full: list[tuple[int, np.ndarray]] = []
    trace: list[float] = []
    is_g: list[bool] = []
    x = n_w + n_z
    for place in structure.places:
        w, z, block = place.w.start, n_w + place.z.start, place.block
        if isinstance(block, FullBlock):
            diagonal = np.zeros(N)
            diagonal[w : w + block.n_w], diagonal[z : z + block.n_z], diagonal[x] = 1.0, -1.0, 1.0
            full.append((len(trace), diagonal))
            trace, is_g, x = [*trace, 1.0], [*is_g, False], x + 1
            continue
        for matrix in _hermitian(block.n_w):
            for p, q, c in matrix:
                entries += [(w + p, w + q, c, len(trace)), (z + p, z + q, -c, len(trace)), (x + p, x + q, c, len(trace))]
            trace, is_g = [*trace, float(len(matrix) == 1)], [*is_g, False]
        for matrix in _hermitian(block.n_w) if g_scaling and isinstance(block, RealBlock) else []:
            for p, q, c in matrix:
                entries += [(w + p, z + q, -1j * c, len(trace)), (z + p, w + q, 1j * c, len(trace))]
            trace, is_g = [*trace, 0.0], [*is_g, True]
        x += block.n_w
    return _frozen((n_w, n_z, n_x), entries, full, trace, is_g)


def _frozen(
    sizes: tuple[int, int, int], entries: list[Entry], full: list[tuple[int, np.ndarray]], trace: list[float], is_g: list[bool]
) -> Basis:
    """The lists as arrays."""
    count, N = len(trace), sum(sizes)
    mix, dense = np.zeros((len(entries), count), complex), np.zeros((count, N, N), complex)
    for k, (p, q, c, variable) in enumerate(entries):
        mix[k, variable] = c
        dense[variable, p, q] += c
    for variable, diagonal in full:
        dense[variable, np.arange(N), np.arange(N)] = diagonal
    index = np.array([entry[:2] for entry in entries], int).reshape(-1, 2)
    return Basis(
        *sizes, count, index[:, 0], index[:, 1], mix, dense.reshape(count, N * N), tuple(full), np.array(trace), np.array(is_g)
    )
