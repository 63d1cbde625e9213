"""The unknowns of the scalings: their traces and second derivatives against dense matrices, one
unknown at a time.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.lft import Block, ComplexBlock, FullBlock, RealBlock
from ambrose.core.mu.structure import Basis, scaling_basis, structure_of

STRUCTURES: tuple[list[Block], ...] = (
    [RealBlock("r"), FullBlock("f", 1, 1)],  # dense coefficients
    [RealBlock("r", 2), FullBlock("f", 3, 2)],
    [FullBlock("f", 2, 3), FullBlock("g", 1, 2)],  # no sparse entries at all
    # sparse coefficients
    [
        RealBlock("r", 3),
        ComplexBlock("c", 2),
        RealBlock("s"),
        FullBlock("f", 2, 1),
        ComplexBlock("d"),
    ],
    [*(RealBlock(f"r{i}") for i in range(8)), RealBlock("a", 4), FullBlock("f", 2, 2)],
)


def hermitian(basis: Basis, members: int) -> np.ndarray:
    rng, N = np.random.default_rng(basis.count), basis.n_w + basis.n_z + basis.n_x
    K = rng.standard_normal((members, N, N)) + 1j * rng.standard_normal((members, N, N))
    return K + K.conj().swapaxes(1, 2)


@pytest.mark.parametrize("g_scaling", [True, False])
@pytest.mark.parametrize("blocks", STRUCTURES)
def test_traces_and_curvature(blocks, g_scaling, monkeypatch):
    basis = scaling_basis(structure_of(blocks), g_scaling=g_scaling)
    S = basis.assemble(np.eye(basis.count))
    np.testing.assert_array_equal(S, S.conj().swapaxes(1, 2))
    K = hermitian(basis, 3)
    products = K[:, None] @ S  # (b, variables, N, N)
    traces = np.trace(products, axis1=2, axis2=3)
    flat = products.reshape(*products.shape[:2], -1)
    curvature = flat @ products.swapaxes(2, 3).reshape(flat.shape).swapaxes(1, 2)
    np.testing.assert_allclose(basis.traces(K), traces.real, atol=1e-11)
    np.testing.assert_allclose(basis.curvature(K), curvature.real, rtol=1e-12, atol=1e-10)
    monkeypatch.setattr("ambrose.core.mu.structure._CHUNK", 1)  # one member at a time
    np.testing.assert_allclose(basis.curvature(K), curvature.real, rtol=1e-12, atol=1e-10)


def test_assemble_is_linear_and_holds_the_blocks():
    """X on w, minus X on z, X once more for the barrier; -j G between w and z; a full block is one
    number.
    """
    basis = scaling_basis(structure_of([RealBlock("r", 2), FullBlock("f", 1, 2)]), g_scaling=True)
    assert (basis.n_w, basis.n_z, basis.n_x, basis.count) == (3, 4, 3, 9)
    x = np.random.default_rng(0).standard_normal(9)
    S = basis.assemble(x[None])[0]
    X, G = S[:2, :2], 1j * S[:2, 3:5]
    np.testing.assert_allclose(X, [[x[0], x[2] + 1j * x[3]], [x[2] - 1j * x[3], x[1]]])
    np.testing.assert_allclose(S[3:5, 3:5], -X)
    np.testing.assert_allclose(S[7:9, 7:9], X)
    np.testing.assert_allclose(G, G.conj().T, atol=1e-15)
    np.testing.assert_allclose(np.diag(S)[[2, 5, 6, 9]], x[8] * np.array([1, -1, -1, 1]))
    np.testing.assert_allclose(
        basis.assemble(2 * x[None] - 1)[0], 2 * S - basis.assemble(np.ones((1, 9)))[0], atol=1e-14
    )
