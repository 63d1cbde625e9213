"""The structure of a controller that is tuned: which entries of its matrices are free, and of what
size they are.

All four matrices stand in one, Theta = [[D, C], [B, A]], so that u, x' = Theta (err, x). A is
block-diagonal: a complex pair or two real poles share a block of 2 x 2, poles that cannot be
separated without cancelling digits a larger one (core/realisation.py). A_ij = sqrt(w_i
w_j) a_ij, B_i = sqrt(w_i) b_i, C_j = sqrt(w_j) c_j with the poles' moduli w, and inputs and outputs
scaled to comparable gains, so that all unknowns are numbers of similar size. Axes may be parted
into groups that share nothing: two planes, or every axis alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from scipy.sparse.csgraph import connected_components

from ambrose.core.checks import NumericalFailure, invalid, named_failure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.matrix_equations import controllability_gramian, observability_gramian
from ambrose.core.realisation import modal_form
from ambrose.core.statespace import StateSpace, is_stable
from ambrose.machine.machine import Machine
from ambrose.model.plant import measured_ports

_SLOWEST = 1.0  # rad/s; an integrator is a state of this rate, else descent could never move it
_ZERO = 1e-9  # of the largest entry: couples nothing
Groups = tuple[tuple[int, ...], ...]
Part = tuple[tuple[int, ...], tuple[int, ...]]  # outputs and inputs


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """free (m+n, p+n) bool: the entries of Theta that are unknowns; scale (m+n, p+n): their sizes;
    the signals' names.
    """

    free: np.ndarray
    scale: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def theta(self, x: np.ndarray) -> np.ndarray:
        """Theta (m+n, p+n) of the unknowns x (k,)."""
        values = np.zeros(self.free.shape)
        values[self.free] = x * self.scale[self.free]
        return values

    def matrices(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C and D of the unknowns."""
        T = self.theta(x)
        m = len(self.outputs)
        p = len(self.inputs)
        return T[m:, p:], T[m:, :p], T[:m, p:], T[:m, :p]

    def controller(self, x: np.ndarray) -> StateSpace:
        """The controller of the unknowns."""
        return StateSpace(*self.matrices(x), self.inputs, self.outputs)

    law = controller  # what is tuned

    def gradient(self, x: np.ndarray, slope: np.ndarray) -> np.ndarray:  # Theta is linear in x
        """df/dx (k,) from df/dTheta (m+n, p+n)."""
        return np.asarray((slope * self.scale)[self.free])


def slowed(K: StateSpace, fastest: float) -> StateSpace:
    """The controller with its poles beyond ``fastest`` [rad/s] brought there, in modal coordinates.

    What a pole adds to the gain at zero frequency stays: with A = S A S, B = S B, C = C S and a
    diagonal S > 0, C A^-1 B does not change.
    """
    blocks = decoupled_blocks(K, np.arange(K.n_states))
    A = sla.block_diag(*[block[0] for block in blocks])

    # S^2 = fastest / |lambda|: two real poles side by side have one each, other blocks one in all
    share = np.ones(len(A))
    start = 0
    for block, _, _ in blocks:
        alone = not block[~np.eye(len(block), dtype=bool)].any()
        size = np.abs(np.diag(block)) if alone else np.abs(np.linalg.eigvals(block)).max()
        share[start : start + len(block)] = fastest / np.maximum(size, fastest)
        start += len(block)
    S = np.sqrt(share)
    B, C = np.vstack([block[1] for block in blocks]), np.hstack([block[2] for block in blocks])
    return StateSpace(A * S * S[:, None], B * S[:, None], C * S, K.D, K.inputs, K.outputs)


def axis_groups(machine: Machine, kind: str) -> Groups:
    """Which axes share a part of the controller: the planes where all stands at one angle, each
    axis alone, or all of them.
    """
    n = len(machine.axes)
    if kind == "axis" or n == 1:
        return tuple((i,) for i in range(n))
    angles = np.array(
        [
            *(b.angle for b in machine.bearings),
            *(port.direction for port in measured_ports(machine)[0::2]),
        ]
    )
    if kind == "plane" and np.abs(np.sin(angles - angles[0])).max() < 1e-6:
        return tuple(range(0, n, 2)), tuple(range(1, n, 2))
    return (tuple(range(n)),)


def structured(
    controller: StateSpace, groups: Sequence[Sequence[int]] | None = None
) -> tuple[Structure, np.ndarray]:
    """The structure of a continuous controller and its unknowns.

    groups: axes that share a part of the controller, which then has as many inputs as outputs
    (None: one part of everything). Groups that the controller couples are joined.
    """
    whole: Part = tuple(range(len(controller.outputs))), tuple(range(len(controller.inputs)))
    parts = (
        [(np.arange(controller.n_states), whole)] if groups is None else _parts(controller, groups)
    )
    blocks = [block for own, _ in parts for block in decoupled_blocks(controller, own)]
    return _scaled(controller, blocks, [part for _, part in parts])


def _parts(K: StateSpace, groups: Sequence[Sequence[int]]) -> list[tuple[np.ndarray, Part]]:
    """The states and the axes, out and in, of every group; axes that the controller couples across
    groups end up in one.
    """
    m, n = len(K.inputs), K.n_states

    def linked(X: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(X) > _ZERO * np.abs(X).max(initial=1e-300))

    # Nodes: the axes (m), each as input and output in one, then the states (n); the axes of a group
    # are linked from the start.
    graph = np.zeros((m + n, m + n), bool)
    graph[:m, :m] = linked(K.D)
    graph[:m, m:] = linked(K.C)
    graph[m:, :m] = linked(K.B)
    graph[m:, m:] = linked(K.A)
    for group in groups:
        graph[np.ix_(list(group), list(group))] = True
    count, label = connected_components(graph, directed=False)
    parts = []
    for k in range(count):
        members = np.flatnonzero(label == k)
        axes = tuple(int(i) for i in members if i < m)
        if axes:  # states that reach no axis do nothing
            parts.append((members[members >= m] - m, (axes, axes)))
    return parts


def decoupled_blocks(
    K: StateSpace, own: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A, B (k, p), C (m, k) of every block of a group's states; parts that are decoupled already
    are not mixed.
    """
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    single: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    A = K.A[np.ix_(own, own)]
    B = K.B[own]
    C = K.C[:, own]
    count, label = (
        connected_components(np.abs(A) > 0, directed=False) if len(own) else (0, np.zeros(0, int))
    )
    for k in range(count):
        at = np.flatnonzero(label == k)
        form = modal_form(StateSpace(A[np.ix_(at, at)], B[at], C[:, at], K.D))
        S = form.system
        for start, size in zip(form.starts, form.sizes, strict=True):
            i = slice(start, start + size)
            (single if size == 1 else found).append((S.A[i, i], S.B[i], S.C[:, i]))
    single.sort(key=lambda block: abs(float(block[0][0, 0])))
    for pair in (single[j : j + 2] for j in range(0, len(single), 2)):
        found.append(
            (
                sla.block_diag(*[b[0] for b in pair]),
                np.vstack([b[1] for b in pair]),
                np.hstack([b[2] for b in pair]),
            )
        )
    return found


def _scaled(
    K: StateSpace, blocks: list[tuple[np.ndarray, np.ndarray, np.ndarray]], groups: list[Part]
) -> tuple[Structure, np.ndarray]:
    m, p = len(K.outputs), len(K.inputs)

    # All blocks in one: A block-diagonal, B and C of all inputs and outputs.
    A = sla.block_diag(*[b[0] for b in blocks]) if blocks else np.zeros((0, 0))
    B = np.vstack([b[1] for b in blocks] or [np.zeros((0, p))])
    C = np.hstack([b[2] for b in blocks] or [np.zeros((m, 0))])
    n = len(A)

    # Free in Theta = [[D, C], [B, A]]: A within the blocks, D within a group of axes; B and C of a
    # block follow below, within its group.
    free = np.zeros((m + n, p + n), bool)
    free[m:, p:] = sla.block_diag(*[np.ones_like(b[0], bool) for b in blocks]) if blocks else False
    for part in groups:
        free[np.ix_(*part)] = True
    start = 0
    rate = np.ones(n)
    even = np.ones(n)
    # root of the controller's largest gain: half of it to the outputs, half to the inputs
    omega = np.geomspace(1.0, 1e5, 40)
    gain = np.sqrt(np.abs(frequency_response(K, omega).values).max(initial=1e-30))
    for block in blocks:
        j = slice(start, start + len(block[0]))
        # its group: the one whose inputs enter it or whose outputs it reaches
        out_axes, in_axes = next(
            g for g in groups if block[1][:, list(g[1])].any() or block[2][list(g[0])].any()
        )
        free[m + j.start : m + j.stop, list(in_axes)] = free[
            list(out_axes), p + j.start : p + j.stop
        ] = True

        # two real poles side by side keep a rate each; otherwise all moduli of the block
        poles = np.abs(
            np.linalg.eigvals(block[0])
            if block[0][~np.eye(len(block[0]), dtype=bool)].any()
            else np.diag(block[0])
        )
        rate[j] = np.maximum(poles, _SLOWEST)

        # x = even x' makes B and C of the block equally large in scaled units
        into = float(np.linalg.norm(block[1] / np.sqrt(rate[j])[:, None] / gain))
        out = float(np.linalg.norm(block[2] / gain / np.sqrt(rate[j])))
        even[j] = np.sqrt(max(into, 1e-30) / max(out, 1e-30)) if min(into, out) > 0 else 1.0
        start += len(poles)
    A = A * even / even[:, None]
    B = B / even[:, None]
    C = C * even

    # scale of Theta: [[gain^2, gain sqrt(w_j)], [sqrt(w_i) gain, sqrt(w_i w_j)]]
    root = np.sqrt(rate)
    rows, columns = (
        np.concatenate([np.full(m, gain), root]),
        np.concatenate([np.full(p, gain), root]),
    )
    structure = Structure(free, rows[:, None] * columns, K.inputs, K.outputs)
    theta = np.block([[K.D, C], [B, A]])
    return structure, (theta / structure.scale)[free]


# A controller of lower order that behaves the same in its loop: balanced by the closed loop's
# Gramians, the rest residualised.
#
# What a state of the controller matters is decided in the loop, not in the controller alone (which
# may be unstable, and whose integrators open-loop balancing keeps or drops for the wrong reason).
# The Gramians of the whole loop, w to z, are averaged over the models of the plant; their blocks
# for the controller's states are balanced against each other (Wortelboer 1994, ch. 4), and the weak
# states are set to their steady state, which keeps the gain at zero frequency (singular
# perturbation).


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
