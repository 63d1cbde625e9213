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

from __future__ import annotations

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
from ambrose.core.matrix_equations import discrete_lyapunov, lyapunov
from ambrose.core.presentation import Presented
from ambrose.core.realisation.balancing import balance
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    append,
    as_statespace,
    close,
    index_of,
    is_stable,
    poles,
    rename,
    select,
    spectral_abscissa,
)

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
                "take those it was factored with",
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
            f"a pole decays at {decay:g} 1/s, just the rate that is asked for, and cannot be "
            "mirrored; "
            "ask for a slightly larger decay"
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
