"""A controller of lower order that behaves the same in its loop: balanced by the closed loop's
Gramians, the rest residualised.

What a state of the controller matters is decided in the loop, not in the controller alone (which
may be unstable, and whose integrators open-loop balancing keeps or drops for the wrong reason). The
Gramians of the whole loop, w to z, are averaged over the models of the plant; their blocks for the
controller's states are balanced against each other (Wortelboer 1994, ch. 4), and the weak states
are set to their steady state, which keeps the gain at zero frequency (singular perturbation).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import NumericalFailure, invalid, named_failure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.matrix_equations import controllability_gramian, observability_gramian
from ambrose.core.statespace import StateSpace, is_stable

_PAIR = 0.9  # two values closer than this ratio are a pair, which is not cut


@named_failure("the reduced controller")
def reduce_controller(
    models: Sequence[GeneralizedPlant], controller: StateSpace, order: int
) -> tuple[StateSpace, np.ndarray]:
    """The controller with ``order`` states, or one less where the cut would part a pair; and the
    closed-loop values (n,).

    models: plants without blocks, at least one of them stabilised by the controller. Raises
    InvalidInput for an impossible order, NumericalFailure when no model is stable.
    """
    n = controller.n_states
    if not isinstance(order, int | np.integer) or not 0 <= order <= n:
        raise invalid(
            "order",
            order,
            f"a whole number from 0 to {n}, the controller's order",
            "polish cannot raise it",
        )
    loops = [lft(model, controller) for model in models]
    loops = [loop for loop in loops if is_stable(loop)]
    if not loops:
        raise NumericalFailure(
            "the controller stabilises no model of the plant; start from one that does"
        )
    part = slice(loops[0].n_states - n, None)  # lft appends the controller's states to the plant's

    # Blocks of the controller's states in the loops' Gramians, their mean over the models.
    P, Q = np.zeros((n, n)), np.zeros((n, n))
    for loop in loops:
        P += controllability_gramian(loop)[part, part] / len(loops)
        Q += observability_gramian(loop)[part, part] / len(loops)

    # P = L L^T, Q = R R^T, R^T L = U diag(values) V^T
    L, R = _root(P), _root(Q)
    U, values, Vt = np.linalg.svd(R.T @ L)
    if order == n:
        return controller, values

    # Two nearly equal values are a pair: the cut goes before it.
    keep = order
    if 0 < keep and values[keep] > _PAIR * values[keep - 1]:
        keep -= 1

    # Values lost in rounding have no balanced state.
    rank = int((values > 1e-13 * values[0]).sum())
    keep = min(keep, rank)

    # T_L = diag(values)^-1/2 U^T R^T, T_R = L V diag(values)^-1/2, T_L T_R = I
    root = np.sqrt(values[:rank])
    T_L, T_R = (R @ (U[:, :rank] / root)).T, L @ (Vt[:rank].T / root)
    balanced = (T_L @ controller.A @ T_R, T_L @ controller.B, controller.C @ T_R, controller.D)
    return _residualised(balanced, keep, controller), values


def _root(X: np.ndarray) -> np.ndarray:
    """L with X = L L^T for a symmetric X >= 0, up to rounding."""
    # unit diagonal first: small states keep their digits
    scale = np.sqrt(np.maximum(np.diag(X), 1e-300))
    values, vectors = np.linalg.eigh(X / scale[:, None] / scale)
    return scale[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0)))


def _residualised(
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], keep: int, names: StateSpace
) -> StateSpace:
    A, B, C, D = matrices
    a, b = slice(None, keep), slice(keep, None)
    if len(A) == keep:
        return StateSpace(A, B, C, D, names.inputs, names.outputs)
    if np.linalg.cond(A[b, b]) > 1e13:  # an integrator among the weak states: truncate
        return StateSpace(A[a, a], B[a], C[:, a], D, names.inputs, names.outputs)

    # 0 = A_ba x_a + A_bb x_b + B_b u:   x_b = -XA x_a - XB u
    X = np.linalg.solve(A[b, b], np.hstack([A[b, a], B[b]]))
    XA, XB = X[:, :keep], X[:, keep:]
    return StateSpace(
        A[a, a] - A[a, b] @ XA,
        B[a] - A[a, b] @ XB,
        C[:, a] - C[:, b] @ XA,
        D - C[:, b] @ XB,
        names.inputs,
        names.outputs,
    )
