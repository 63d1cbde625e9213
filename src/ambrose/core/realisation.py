"""Coprime factors of a plant and its controller, and the residual system S that tells another plant
from the plant modelled.

Positive feedback v = K y + e, as in the literature (the controller of the loop diagram enters as
-K)::

    G = N M^-1 = M~^-1 N~    K = U V^-1 = V~^-1 U~
    [V~ -U~; -N~ M~] [M U; N V] = I  (double Bezout identity)

Both left factors are observers that compare what they expect with what is: that of the controller
makes alpha = V~ v - U~ y, that of the plant eps = M~ y - N~ v. In a loop alpha = V~ e holds
whatever the plant and its noise d are, and eps = S alpha + (M~ + S U~) d: an open-loop experiment
on S, which is zero for the plant modelled, stable for every plant that K stabilises, and carries
all there is to know, G(S) = (N + V S)(M + U S)^-1 = (M~ + S U~)^-1 (N~ + S V~). Vidyasagar (1985);
Tay, Mareels & Moore, High Performance Control (1998), ch. 2 and 3; Hansen (1989).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    check_positive,
    check_shape,
    invalid,
    named_failure,
)
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.matrix_equations import balanced_realization, discrete_lyapunov, lyapunov
from ambrose.core.presentation import Presented
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    append,
    as_statespace,
    balance_matrix as balance,
    balance_system,
    close,
    index_of,
    is_stable,
    poles,
    rename,
    select,
    spectral_abscissa,
)

# A system in real block-diagonal form: every state couples only with those whose poles it cannot be
# told from.
#
# A dense state matrix costs n^2 products a step and spreads the rounding of one coefficient over
# all poles. In modal form a single pole is a block of one state, a complex pair a rotation of two,
# and poles so near each other that separating them would need large, cancelling transforms stay
# together (Bavely & Stewart 1979, SIAM J. Numer. Anal. 16, 359-367).


_GROWTH = 1e4  # largest entry of a transform that separates two blocks
_RESIDUAL = 1e-9  # relative, of A X = X T and of Y X = I


@dataclass(frozen=True, slots=True, eq=False)
class ModalForm:
    """``system`` has a block-diagonal A with blocks of ``sizes`` (they add up to n); complex pairs
    are [[a, b], [-b, a]].
    """

    system: StateSpace
    sizes: tuple[int, ...]

    @property
    def starts(self) -> tuple[int, ...]:
        """The first state of every block."""
        return tuple(int(i) for i in np.cumsum([0, *self.sizes])[:-1])


@named_failure("the modal form")
def modal_form(system: Any, growth: float = _GROWTH) -> ModalForm:
    """``system`` in real block-diagonal coordinates, slow blocks first; inputs, outputs and sample
    time are kept.

    A transform that separates two blocks has entries up to ``growth``, so that at most 4 digits are
    lost; beyond, the blocks stay one. Raises NumericalFailure when the transform does not give the
    system back to 1e-9.
    """
    system = as_statespace(system)
    n = system.n_states
    if n == 0:
        return ModalForm(system, ())
    A, B, C, _ = balance_system(system.A, system.B, system.C)
    T, X = sla.schur(A, output="real")

    # A X = X T and Y X = I are checked: X and Y were built up side by side, without an inverse.
    T, X, Y, sizes = _separated(T, X, growth)
    size = np.abs(A).max()
    if (
        not np.abs(A @ X - X @ T).max() <= _RESIDUAL * size * np.abs(X).max()
        or not np.abs(Y @ X - np.eye(n)).max() <= _RESIDUAL
    ):
        raise NumericalFailure(
            f"the modal form of a system with {n} states misses its matrix by more than "
            f"{_RESIDUAL:g}; "
            "reduce the controller's order"
        )

    # Scaled block by block, which leaves T block-diagonal.
    t = np.ones(n)
    start = 0
    for k in sizes:
        _scale_block(T, Y @ B, C @ X, t, slice(start, start + k))
        start += k
    T = T * t / t[:, None]
    B = (Y @ B) / t[:, None]
    C = (C @ X) * t
    order, sizes = _slow_first(T, sizes, system.dt)
    T = T[np.ix_(order, order)]
    B = B[order]
    C = C[:, order]
    return ModalForm(StateSpace(T, B, C, system.D, system.inputs, system.outputs, system.dt), sizes)


def _separated(
    T: np.ndarray, X: np.ndarray, growth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]:
    """The real Schur form T (n, n) with vectors X made block-diagonal: T, X, X^-1 and the sizes."""
    T, X, Y = T.copy(), X.copy(), X.T.copy()
    n, start = len(T), 0
    sizes: list[int] = []
    while start < n:
        end = start + _first_block(T, start)
        while end < n:
            # The block start..end and all that follows: T11 R - R T22 = -T12 makes T12 zero.
            R = _separator(T, start, end)
            if R is not None and np.abs(R).max() <= growth:
                # X [I R; 0 I] and [I -R; 0 I] Y
                X[:, end:] += X[:, start:end] @ R
                Y[start:end] -= R @ Y[end:]
                T[start:end, end:] = 0.0
                break

            # R too large: the block grows by the nearest pole of the rest.
            end = _take_nearest(T, X, Y, start, end)
        sizes.append(end - start)
        start = end
    return T, X, Y, tuple(sizes)


def _first_block(T: np.ndarray, i: int) -> int:
    return 2 if i + 1 < len(T) and T[i + 1, i] != 0 else 1


def _separator(T: np.ndarray, start: int, end: int) -> np.ndarray | None:
    """R with T11 R - R T22 = -T12; None where the two share a pole."""
    T11 = T[start:end, start:end]
    T12 = T[start:end, end:]
    T22 = T[end:, end:]
    if not T12.any():
        return np.zeros_like(T12)
    X, scale, info = sla.lapack.dtrsyl(T11, T22, -T12, isgn=-1)
    if info != 0 or not scale > 0 or not np.isfinite(X).all():
        return None
    return X / scale


def _take_nearest(T: np.ndarray, X: np.ndarray, Y: np.ndarray, start: int, end: int) -> int:
    """Move the block whose pole is nearest to those of start..end next to them, in place; the new
    end.
    """
    # Blocks of T22, of one or two states each.
    eigenvalues = np.linalg.eigvals(T[start:end, start:end])
    rest = T[end:, end:]
    best = np.inf
    at = 0
    i = 0
    while i < len(rest):
        k = _first_block(rest, i)
        distance = np.abs(
            np.linalg.eigvals(rest[i : i + k, i : i + k])[:, None] - eigenvalues
        ).min()
        if distance < best:
            best, at = distance, i
        i += k

    # T22 = Q moved Q^T, the block now first; T12, X and Y turn with it.
    moved, Q, info = sla.lapack.dtrexc(rest, np.eye(len(rest)), at + 1, 1)
    if info != 0:
        raise NumericalFailure(
            "two poles of the controller are too near each other to be reordered; reduce its order"
        )
    T[end:, end:] = moved
    T[:end, end:] = T[:end, end:] @ Q
    X[:, end:] = X[:, end:] @ Q
    Y[end:] = Q.T @ Y[end:]
    return end + _first_block(T, end)


def _scale_block(T: np.ndarray, B: np.ndarray, C: np.ndarray, t: np.ndarray, block: slice) -> None:
    """Factors t of the block's states: a pair becomes a rotation, and the block is as large from
    the input as to the output.
    """
    i = block.start
    if block.stop - i == 2 and T[i, i + 1] * T[i + 1, i] < 0:
        # a pair [[a, b], [c, a]], b c < 0: t_2/t_1 = sqrt(-c/b) makes the two couplings equal
        t[i + 1] = np.sqrt(-T[i + 1, i] / T[i, i + 1])

    # One power of two for the whole block: exact, and a rotation stays one.
    gain_in, gain_out = (
        np.linalg.norm(B[block] / t[block, None]),
        np.linalg.norm(C[:, block] * t[block]),
    )
    if gain_in > 0 and gain_out > 0:
        t[block] *= np.exp2(np.round(0.5 * np.log2(gain_in / gain_out)))


def _slow_first(
    T: np.ndarray, sizes: tuple[int, ...], dt: float | None
) -> tuple[np.ndarray, tuple[int, ...]]:
    starts = np.cumsum([0, *sizes])[:-1]
    rates = []
    for start, k in zip(starts, sizes, strict=True):
        poles = np.linalg.eigvals(T[start : start + k, start : start + k])

        # sampled: |z - 1|, small for slow poles
        rates.append(np.abs(poles if dt is None else poles - 1).max())
    order = np.argsort(rates, kind="stable")
    states = np.concatenate([np.arange(starts[k], starts[k] + sizes[k]) for k in order])
    return states, tuple(sizes[k] for k in order)


# Zeros: the frequencies at which a system of any size and rank loses rank; and systems without
# hidden poles.


@named_failure("the zeros")
def invariant_zeros(system: Any, tolerance: float = 1e-9) -> np.ndarray:
    """Finite invariant zeros (z,) complex [rad/s, or z-plane]; transmission zeros when the system
    is minimal.

    tolerance: relative to the balanced system matrix, below which a row counts as dependent. Sorted
    by modulus. Works for rank-deficient and non-square systems: zeros at infinity and the singular
    part of [A - s, B; C, D] are deflated first. Emami-Naeini & Van Dooren (1982), Automatica 18.
    """
    system = as_statespace(system)
    A, B, C, D = _scaled(system)
    size = max(float(np.linalg.norm(np.block([[A, B], [C, D]]))), 1e-300)

    # First D of full row rank,
    A, B, C, D = _row_reduced(A, B, C, D, tolerance * size)
    # the dual: now D is square and invertible
    A, C, B, D = (x.T for x in _row_reduced(A.T, C.T, B.T, D.T, tolerance * size))
    n = len(A)
    if n == 0:
        return np.zeros(0, complex)
    # the pencil [A - s, B; C, D]: columns turned so that [C, D] = [0, R] leaves a regular pencil of
    # the size n
    _, _, Vt = sla.svd(np.hstack([C, D]))
    V = Vt[len(C) :].T  # null space of [C, D], n columns

    # [A - s, B] V w = 0 with [C, D] V = 0, V[:n] the part of x: ([A, B] V - s V[:n]) w = 0
    values = sla.eig(np.hstack([A, B]) @ V, V[:n], right=False, homogeneous_eigvals=True)
    alpha, beta = values

    # beta = 0: infinite, a zero that the deflation left to rounding. Back in rad/s.
    finite = np.abs(beta) > 1e-14 * np.abs(alpha)
    zeros = alpha[finite] / beta[finite] * _unit(system)
    return zeros[np.lexsort((zeros.imag, zeros.real, np.abs(zeros)))]


def minimal(system: Any, tolerance: float = 1e-9) -> StateSpace:
    """A stable system without the states whose Hankel singular values are below ``tolerance`` of
    the largest.

    What is left differs by at most twice the sum of those left out, so its poles and zeros are
    those that can be seen. Raises UnstableSystem. Moore (1981); Glover (1984).
    """
    check_positive(tolerance, "tolerance", "1e-9 keeps all that double precision can tell")
    balanced, hankel, _, _ = balanced_realization(system)
    k = int((hankel > tolerance * hankel.max(initial=0.0)).sum())
    k = min(k, balanced.n_states)
    return StateSpace(
        balanced.A[:k, :k],
        balanced.B[:k],
        balanced.C[:, :k],
        balanced.D,
        balanced.inputs,
        balanced.outputs,
        balanced.dt,
    )


def _unit(system: StateSpace) -> float:
    """The rate [rad/s] in which a continuous system's poles are of order one; a sampled system
    stays as it is.
    """
    if system.dt is not None or system.n_states == 0:
        return 1.0
    moduli = np.abs(np.linalg.eigvals(system.A))
    moving = moduli[moduli > 0]
    return float(np.exp(np.mean(np.log(moving)))) if moving.size else 1.0


def _scaled(system: StateSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The matrices in units of time, input and output in which they are of order one; zeros only
    change by the unit of time.
    """
    unit = _unit(system)
    A = system.A / unit
    B = system.B / unit
    C = system.C
    D = system.D

    # States, inputs and outputs in turn: each scaling disturbs the others a little.
    for _ in range(3):
        A, B, C, _ = balance_system(A, B, C)
        columns = np.linalg.norm(np.vstack([B, D]), axis=0)
        columns = np.where(columns > 0, columns, 1.0)
        B, D = B / columns, D / columns
        rows = np.linalg.norm(np.hstack([C, D]), axis=1)
        rows = np.where(rows > 0, rows, 1.0)
        C, D = C / rows[:, None], D / rows[:, None]
    return A, B, C, D


def _row_reduced(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A system with the same finite zeros whose D has full row rank: outputs that D does not reach
    hold states at zero.
    """
    while True:
        # Outputs turned so that the last ones have no D.
        U, s, _ = sla.svd(D) if D.size else (np.eye(len(D)), np.zeros(0), None)
        rank = int((s > tolerance).sum())
        C, D = U.T @ C, U.T @ D
        dependent = C[rank:]  # these outputs are zero only if the states they see are
        C, D = C[:rank], D[:rank]
        if not dependent.size:
            return A, B, C, D

        # held x = 0: the states in the null space of ``held`` are free, the k others held at zero.
        _, s, Vt = sla.svd(dependent)
        k = int((s > tolerance).sum())
        if k == 0:
            return A, B, C, D
        T = np.vstack([Vt[k:], Vt[:k]]).T  # free states first, then the k held at zero

        # x = T (free, held), T orthogonal
        A = T.T @ A @ T
        B = T.T @ B
        C = C @ T
        n = len(A) - k

        # held = 0 and so held' = A_hf free + B_h u = 0: k new outputs in place of those used up,
        # and k states fewer. Then again, since the new D may lack rank.
        C, D = np.vstack([A[n:, :n], C[:, :n]]), np.vstack([B[n:], D])
        A, B = A[:n, :n], B[:n]


_UNSEEN = 1e-13  # of the largest eigenvalue: a mode that the outputs do not show


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CoprimeFactors(Presented):
    """The eight factors, as two systems that are each other's inverse; the single ones by name (M~
    is ``M_left``).

    plant_gain (n, p), controller_gain (nk, m): L and L_K of the observers. left: [V~ -U~; -N~ M~]
    from (v, y) to (alpha, eps); right: [M U; N V] from (alpha, eps) to (v, y). Signals: v and y
    have the names of the plant's inputs (m) and outputs (p), alpha_<input> and eps_<output> those
    of the residuals.
    """

    plant: StateSpace
    controller: StateSpace
    plant_gain: np.ndarray
    controller_gain: np.ndarray
    left: StateSpace
    right: StateSpace

    @property
    def alpha(self) -> tuple[str, ...]:
        return self.left.outputs[: len(self.plant.inputs)]

    @property
    def eps(self) -> tuple[str, ...]:
        return self.left.outputs[len(self.plant.inputs) :]

    @property
    def M(self) -> StateSpace:
        return select(self.right, self.alpha, self.plant.inputs)

    @property
    def N(self) -> StateSpace:
        return select(self.right, self.alpha, self.plant.outputs)

    @property
    def U(self) -> StateSpace:
        return select(self.right, self.eps, self.plant.inputs)

    @property
    def V(self) -> StateSpace:
        return select(self.right, self.eps, self.plant.outputs)

    @property
    def M_left(self) -> StateSpace:
        return select(self.left, self.plant.outputs, self.eps)

    @property
    def N_left(self) -> StateSpace:
        return _negative(select(self.left, self.plant.inputs, self.eps))

    @property
    def U_left(self) -> StateSpace:
        return _negative(select(self.left, self.plant.outputs, self.alpha))

    @property
    def V_left(self) -> StateSpace:
        return select(self.left, self.plant.inputs, self.alpha)


def coprime_factors(
    plant: ControllerLike,
    controller: ControllerLike,
    plant_gain: ArrayLike | None = None,
    controller_gain: ArrayLike | None = None,
) -> CoprimeFactors:
    """The factors of a plant (m inputs, p outputs) and a controller K from its outputs to its
    inputs, v = K y (positive).

    plant_gain L (n, p): A + L C stable; controller_gain L_K (nk, m): A_K + L_K C_K stable; None:
    ``injection_gain``. An observer-based controller with L_K = -B has the factors of the textbooks,
    U~ = -F (sI - A - L C)^-1 L. Both continuous or of one sample time. Raises InvalidInput, and
    UnstableSystem where K does not stabilise the plant: then S does not exist.
    """
    plant, controller = as_statespace(plant), as_statespace(controller)
    m, p = len(plant.inputs), len(plant.outputs)
    if controller.D.shape != (m, p):
        raise invalid(
            "the controller's size (outputs, inputs)",
            controller.D.shape,
            str((m, p)),
            "select() its signals",
        )
    clash = sorted(set(plant.inputs) & set(plant.outputs))
    if clash:
        raise invalid(
            "the plant's signals",
            f"{clash[0]} on both sides",
            "of different names",
            "rename() its inputs or outputs",
        )
    L = injection_gain(plant.A, plant.C, plant.dt)[0] if plant_gain is None else plant_gain
    L_K = (
        injection_gain(controller.A, controller.C, controller.dt)[0]
        if controller_gain is None
        else controller_gain
    )
    alpha, eps = (
        [f"alpha_{name}" for name in plant.inputs],
        [f"eps_{name}" for name in plant.outputs],
    )

    # alpha = V~ v - U~ y, the innovation of the controller's observer; K has the input y and the
    # output v: inputs (y, v)
    observer = StateSpace(
        *_observer(
            controller, check_shape(L_K, "controller_gain", "(nk, m)", nk=controller.n_states, m=m)
        ),
        [*[f"K {name}" for name in plant.outputs], *[f"K {name}" for name in plant.inputs]],
        alpha,
        controller.dt,
    )

    # eps = M~ y - N~ v, that of the plant's: inputs (v, y)
    plant_observer = StateSpace(
        *_observer(plant, check_shape(L, "plant_gain", "(n, p)", n=plant.n_states, p=p)),
        [*plant.inputs, *plant.outputs],
        eps,
        plant.dt,
    )
    for name, system in (
        ("A + L C of the plant", plant_observer),
        ("A + L C of the controller", observer),
    ):
        if system.n_states and not is_stable(system):
            raise invalid(
                name,
                f"unstable ({spectral_abscissa(system):.4g} 1/s)",
                "stable",
                "take the gain of injection_gain()",
            )

    # One v and one y for both: [V~ -U~; -N~ M~] from (v, y) to (alpha, eps).
    left = select(
        _joined(
            append(plant_observer, observer),
            {name: [f"K {name}"] for name in plant_observer.inputs},
        ),
        outputs=[*alpha, *eps],
    )

    # Its inverse [M U; N V] from (alpha, eps) to (v, y): its poles are those of the loop.
    right = exchange(left, left.inputs, left.outputs)
    if not is_stable(right):
        worst = max(poles(right), key=lambda pole: pole.real if right.dt is None else abs(pole))
        raise UnstableSystem(
            "the controller does not stabilise the plant it is factored with (closed-loop pole "
            f"{worst:.4g}"
            f"{' rad/s' if right.dt is None else ' in the z-plane'}); the residual system exists "
            "only for a plant and a "
            "controller that are stable together: check the feedback's sign, delay, sample time "
            "and the nominal parameters"
        )
    return CoprimeFactors(plant, controller, np.asarray(L), np.asarray(L_K), left, right)


def _observer(
    system: StateSpace, L: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What an output is beyond what its observer expects: (A, B, C, D) from (inputs, outputs) to
    the innovation.
    """
    # x^' = A x^ + B v - L (y - C x^ - D v) = (A + L C) x^ + (B + L D) v - L y
    # innovation y - C x^ - D v, over the inputs (v, y)
    A = system.A + L @ system.C
    return (
        A,
        np.hstack([system.B + L @ system.D, -L]),
        -system.C,
        np.hstack([-system.D, np.eye(len(system.outputs))]),
    )


def _negative(system: StateSpace) -> StateSpace:
    return StateSpace(
        system.A, system.B, -system.C, -system.D, system.inputs, system.outputs, system.dt
    )


@named_failure("the system with exchanged signals")
def exchange(system: Any, inputs: Sequence[str], outputs: Sequence[str]) -> StateSpace:
    """The same system read the other way: ``inputs`` (c names) become outputs and as many
    ``outputs`` become inputs, by place.

    The exchanged signals come first on both sides. Raises NumericalFailure where the feedthrough
    between them is singular.
    """
    system = as_statespace(system)
    j, i = index_of(inputs, system.inputs, "input"), index_of(outputs, system.outputs, "output")
    if len(i) != len(j):
        raise invalid(
            "the number of outputs exchanged",
            len(i),
            f"{len(j)}, that of the inputs",
            "name as many",
        )
    free_in = [k for k in range(len(system.inputs)) if k not in j]
    free_out = [k for k in range(len(system.outputs)) if k not in i]
    D = system.D[np.ix_(i, j)]
    # balanced: v goes with alpha and y with eps, in their units
    if len(D) and np.linalg.cond(balance(D)[0]) > 1e12:
        raise NumericalFailure(
            "the feedthrough between the exchanged signals is singular (an algebraic loop); add a "
            "roll-off"
        )
    inverse = np.linalg.inv(D)
    # v = D^-1 (alpha - C_i x - D_i w), put into the states and the other outputs
    C_v, D_v = -inverse @ system.C[i], np.hstack([inverse, -inverse @ system.D[np.ix_(i, free_in)]])
    B_j, D_j = system.B[:, j], system.D[np.ix_(free_out, j)]

    # x' = (A + B_j C_v) x + (B_j D_v + [0, B_free]) (alpha, w), outputs (v, z) with z likewise
    empty = np.zeros((len(free_out), len(j)))
    return StateSpace(
        system.A + B_j @ C_v,
        B_j @ D_v + np.hstack([np.zeros((system.n_states, len(j))), system.B[:, free_in]]),
        np.vstack([C_v, system.C[free_out] + D_j @ C_v]),
        np.vstack([D_v, D_j @ D_v + np.hstack([empty, system.D[np.ix_(free_out, free_in)]])]),
        [system.outputs[k] for k in i] + [system.inputs[k] for k in free_in],
        [system.inputs[k] for k in j] + [system.outputs[k] for k in free_out],
        system.dt,
    )


def residual_system(factors: CoprimeFactors, plant: Any) -> StateSpace:
    """S from alpha to eps of another plant G with the same signals: (M~ G - N~)(V~ - U~ G)^-1.

    Its poles are those of the loop of K with that plant, and those of A + L C: stable exactly as
    long as K stabilises G.
    """
    plant = as_statespace(plant)
    _check_signals(factors, plant)
    return _watched(factors, plant, (), ())


def residual_lft(factors: CoprimeFactors, plant: GeneralizedPlant) -> GeneralizedPlant:
    """S of an uncertain plant with the uncertainty pulled out: the same blocks, w and z, with u =
    alpha and y = eps.

    [0, M~ G_yw; G_zu M, G_zw + G_zu U M~ G_yw] closed by Delta where ``plant`` is nominally that of
    the factors; P1 (13), Niemann (2003). plant: u and y hold the factors' signals.
    """
    _check_signals(factors, select(plant.system, plant.u, plant.y))
    w, z = plant.w[: plant.n_w_blocks], plant.z[: plant.n_z_blocks]
    return GeneralizedPlant(
        _watched(factors, plant.system, w, z), w, factors.alpha, z, factors.eps, plant.blocks
    )


def _watched(
    factors: CoprimeFactors, plant: StateSpace, w: Sequence[str], z: Sequence[str]
) -> StateSpace:
    """From (alpha, w) to (eps, z): the plant in the loop that alpha drives, watched by the
    observers of the factors.
    """
    v, y = factors.plant.inputs, factors.plant.outputs
    observers = rename(factors.left, [f"seen {name}" for name in factors.left.inputs])

    # Plant (v, w) -> (y, z) and observers (seen v, seen y) -> (alpha, eps), side by side;
    joined = append(select(plant, [*v, *w], [*y, *z]), observers)

    # seen y is the plant's y, seen v the plant's v.
    fed = _fed(joined, {f"seen {name}": name for name in y})
    merged = _joined(fed, {name: [f"seen {name}"] for name in v}, [*v, *w])

    # v as an output, alpha as the input that makes it: the loop that alpha drives.
    return select(exchange(merged, v, factors.alpha), [*factors.alpha, *w], [*factors.eps, *z])


def _fed(system: StateSpace, fed: Mapping[str, str]) -> StateSpace:
    """``system`` with an output added to each input named: fed maps inputs to outputs."""
    loop = np.zeros((len(system.inputs), len(system.outputs)))
    for name, source in fed.items():
        loop[system.inputs.index(name), system.outputs.index(source)] = 1.0
    return close(system, loop)


def _joined(
    system: StateSpace, same: Mapping[str, Sequence[str]], keep: Sequence[str] | None = None
) -> StateSpace:
    """``system`` with inputs that receive the same signal made one: same maps the one that stays to
    the others.
    """
    keep = list(same) if keep is None else list(keep)
    mix = np.zeros((len(system.inputs), len(keep)))
    for k, name in enumerate(keep):
        for other in (name, *same.get(name, ())):
            mix[system.inputs.index(other), k] = 1.0
    return StateSpace(
        system.A, system.B @ mix, system.C, system.D @ mix, keep, system.outputs, system.dt
    )


def _check_signals(factors: CoprimeFactors, plant: StateSpace) -> None:
    for side, known, actual in (
        ("inputs", factors.plant.inputs, plant.inputs),
        ("outputs", factors.plant.outputs, plant.outputs),
    ):
        if set(known) != set(actual):
            raise invalid(
                f"the plant's {side}",
                ", ".join(actual),
                ", ".join(known),
                "use the signals with which it was factored",
            )
    if plant.dt != factors.plant.dt:
        raise invalid(
            "the plant's dt",
            plant.dt,
            str(factors.plant.dt),
            "sample it like the plant it was factored with",
        )


@named_failure("the injection gain")
def injection_gain(
    A: ArrayLike,
    C: ArrayLike,
    dt: float | None = None,
    decay: float = 0.0,
    noise: ArrayLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """L (n, p) with A + L C stable, and the covariance (p, p) of its innovation; only slow and
    unstable poles are moved.

    A (n, n), C (p, n), dt [s] (None: continuous). Poles that decay slower than ``decay`` [1/s] are
    mirrored at that rate, the others stay. noise (p,): standard deviations of the outputs' white
    noise (None: all 1). With decay 0 this is the Kalman filter for measurement noise alone: M~ = I
    + C (sI - A - L C)^-1 L is all-pass, so that white noise stays white in eps, of the covariance
    returned (sampled; continuous: that of the noise). Its dual, injection_gain(A', B')' , is a
    state feedback. Raises InvalidInput for a mode to be moved that the outputs do not show, or that
    decays at just that rate. Bernoulli equation: Anderson & Moore (1989), sec. 3.5; Barabanov &
    Ortega (2004).
    """
    A = check_shape(A, "A", "(n, n)")
    C = check_shape(C, "C", "(p, n)", n=len(A))
    n, p = len(A), len(C)
    check_positive(decay, "decay", "give a rate in 1/s, or 0", zero_allowed=True)
    sigma = np.ones(p) if noise is None else check_shape(noise, "noise", "(p)", p=p)
    if (sigma <= 0).any():
        raise invalid("noise", sigma.tolist(), "positive", "give standard deviations")

    # A + decay I (sampled: exp(decay dt) A): poles slower than ``decay`` become the unstable ones.
    shift = 1.0 if dt is None else float(np.exp(decay * dt))
    balanced, t = balance(A)
    shifted = balanced + decay * np.eye(n) if dt is None else shift * balanced
    # not "rhp" and "ouc": of a complex pair SciPy 1.14 shows those tests the real part alone, and
    # leaves it where it is
    T, Q, k = sla.schur(shifted, sort=_right if dt is None else _outside) if n else (A, A, 0)
    if k == 0:
        return np.zeros((n, p)), np.diag(sigma**2)

    # The leading k Schur vectors Q1 span the unstable part: T1, seen by C1 = sigma^-1 C Q1. With
    # L = Q1 g the rest of the triangle stays; T1 + g C1 is to be stable.
    slow, outputs_of_slow = T[:k, :k], (C * t @ Q[:, :k]) / sigma[:, None]

    # A pole on the boundary is mirrored into itself: no stabilising solution.
    values = np.linalg.eigvals(slow)
    close_by = (
        np.abs(values.real) / max(1e-300, np.abs(T).max())
        if dt is None
        else np.abs(np.abs(values) - 1)
    )
    if close_by.min() < 1e-11:
        raise InvalidInput(
            f"a pole decays at {decay:g} 1/s, exactly the required rate, and cannot be "
            "mirrored; require a slightly larger decay"
        )
    if dt is None:
        # T1^T X + X T1 = C1^T C1; with Y = X^-1 the Bernoulli equation
        # T1 Y + Y T1^T = Y C1^T C1 Y
        X = lyapunov(-slow.T, outputs_of_slow.T @ outputs_of_slow)
    else:
        # T1^T X T1 = X + C1^T C1; with Y = X^-1 the Riccati equation without process noise,
        # Y = T1 Y T1^T - T1 Y C1^T (I + C1 Y C1^T)^-1 C1 Y T1^T
        inverse = np.linalg.inv(slow)
        X = discrete_lyapunov(inverse.T, inverse.T @ outputs_of_slow.T @ outputs_of_slow @ inverse)

    # X on the scale of a unit diagonal: what is unseen does not depend on the units of the states.
    size = np.sqrt(np.maximum(np.diag(X), 1e-300))
    if np.linalg.eigvalsh(X / size / size[:, None])[0] < _UNSEEN:
        raise InvalidInput(
            "a mode that decays too slowly does not show in the outputs; no gain can move it: use "
            "other outputs"
        )

    # Kalman gain g = -Y C1^T (sampled: -T1 Y C1^T (I + C1 Y C1^T)^-1)
    # shift (A + L C) = shift A + Q1 g C1: L = Q1 g/shift, in the states and the units as given
    Y = np.linalg.inv(X / size / size[:, None]) / size / size[:, None]
    innovation = np.eye(p) if dt is None else np.eye(p) + outputs_of_slow @ Y @ outputs_of_slow.T
    gain = -(Y if dt is None else slow @ Y) @ np.linalg.solve(innovation, outputs_of_slow).T / shift
    return t[:, None] * (Q[:, :k] @ gain) / sigma, sigma[:, None] * innovation * sigma


def _right(real: float, imaginary: float) -> bool:
    return real >= 0


def _outside(real: float, imaginary: float) -> bool:
    return bool(np.hypot(real, imaginary) > 1)


def observer_controller(plant: Any, F: ArrayLike, L: ArrayLike) -> StateSpace:
    """The controller v = F x^ with the observer x^' = A x^ + B v - L (y - C x^ - D v), from y to v
    (positive feedback).

    F (m, n): A + B F stable; L (n, p): A + L C stable (of z too, for a sampled plant).
    """
    plant = as_statespace(plant)
    n = plant.n_states
    m = len(plant.inputs)
    p = len(plant.outputs)
    F, L = check_shape(F, "F", "(m, n)", m=m, n=n), check_shape(L, "L", "(n, p)", n=n, p=p)
    A = plant.A + plant.B @ F + L @ (plant.C + plant.D @ F)
    return StateSpace(A, -L, F, np.zeros((m, p)), plant.outputs, plant.inputs, plant.dt)
