"""Everything that the generated code contains, as numbers: the sampled controller in scaled states, limits, anti-windup.

    u  = C x + D e                         the current asked for
    us = min(max(u, -limit), limit)        the current given
    x += increment x + B e + unwind (us - u)

Every state lies within +-1 for every input that passes the plausibility check, which is proved: whatever the saturation
does, x[k+1] = (A - L C) x + (B - L D) e + L us holds with L = unwind, so the peak gains of that system bound the states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import NumericalFailure, UnstableSystem, check_finite, check_positive, invalid
from ambrose.core.peak_gain import peak_gains
from ambrose.core.statespace import StateSpace
from ambrose.deployment.block.names import check_identifiers
from ambrose.deployment.discretisation.fixed import Deployment

HOLD_SAMPLES = 10
WINDUP_TIME = 0.02  # s; an integral time of 0.2 s and a derivative time of 2 ms have it as their geometric mean
_SLOW = 5.0  # times the windup time: modes slower than this wind up
_HEADROOM = 1.02


@dataclass(frozen=True, slots=True, eq=False)
class ControlBlock:
    """What runs: see the module's formulas; states within +-1, errors e (m,) [m], currents u (p,) [A].

    increment (n, n), B (n, m) [1/m], C (p, n) [A], D (p, m) [A/m], unwind (n, p) [1/A]; from_error (n, m) [1/m] and from_output
    (n, p) [1/A]: the states with which the controller goes on from given currents; error_limit (m,) [m] and current_limit
    (p,) [A]: what is plausible and what is given out; raw_limit (p,) [A]: the largest current asked for; hold_samples: how long
    a missing input is replaced; winding: how many states, the first ones, wind up, followed within windup_time [s]; delay
    [samples].
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_time: float
    delay: int
    sizes: tuple[int, ...]
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    unwind: np.ndarray
    from_error: np.ndarray
    from_output: np.ndarray
    error_limit: np.ndarray
    current_limit: np.ndarray
    raw_limit: np.ndarray
    winding: int
    hold_samples: int
    windup_time: float

    @property
    def n_states(self) -> int:
        return len(self.increment)

    @property
    def system(self) -> StateSpace:
        """The block between its limits, as a sampled system."""
        A = np.eye(self.n_states) + self.increment
        return StateSpace(A, self.B, self.C, self.D, self.inputs, self.outputs, self.sample_time)


def control_block(
    deployment: Deployment,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
) -> ControlBlock:
    """The block of a deployment.

    name: prefix of everything in the code, a C identifier. error_limit [m] and current_limit [A]: one number or one per axis;
    larger errors are implausible, larger currents are cut. windup_time [s]: how fast states slower than five times it follow
    the limited output. hold_samples: a missing input is replaced by its last good value for so many samples before the block
    reports a fault. Raises InvalidInput, UnstableSystem for a controller whose states have no bound.
    """
    K = deployment.controller
    check_identifiers(name, K.inputs, K.outputs)
    errors = check_limits(error_limit, len(K.inputs), "error_limit", "the bearing's gap is the largest")
    currents = check_limits(current_limit, len(K.outputs), "current_limit", "give the amplifier's largest control current in A")
    check_positive(windup_time, "windup_time", f"give it in seconds, e.g. {WINDUP_TIME:g}")
    if isinstance(hold_samples, bool) or not isinstance(hold_samples, int) or not 0 <= hold_samples <= 32767:
        raise invalid("hold_samples", hold_samples, "a whole number from 0 to 32767", f"{HOLD_SAMPLES} is usual")
    dt = float(K.dt or 0.0)
    slow = _slow_states(deployment, dt, windup_time)
    unwind = _unwinding(deployment, slow, currents, dt / windup_time)
    bound = _state_bounds(deployment, unwind, slow, errors, currents)
    scale = _powers(deployment.sizes, bound)
    C, D = K.C * scale, K.D
    raw = np.abs(C) @ (bound / scale) + np.abs(D) @ errors
    from_error, from_output = _transfer(deployment, scale, slow, currents)
    order, sizes = _winding_first(deployment.sizes, slow)
    increment = (deployment.increment * scale / scale[:, None])[np.ix_(order, order)]
    return ControlBlock(
        name, K.inputs, K.outputs, dt, deployment.delay, sizes,
        increment, (K.B / scale[:, None])[order], C[:, order], D, (unwind / scale[:, None])[order],
        from_error[order], from_output[order], errors, currents, np.maximum(raw, currents), int(slow.sum()),
        hold_samples, windup_time,
    )  # fmt: skip


def check_limits(value: ArrayLike, count: int, name: str, remedy: str) -> np.ndarray:
    """One positive number or one per axis as an array (count,). Raises InvalidInput."""
    values = np.atleast_1d(check_finite(value, name)).astype(float).ravel()
    if values.size not in {1, count}:
        raise invalid(f"the number of {name} values", values.size, f"1 or {count}", "give one, or one per axis")
    if (values <= 0).any():
        raise invalid(name, values.min(), "positive", remedy)
    return np.broadcast_to(values, count).copy()


def _slow_states(deployment: Deployment, dt: float, windup_time: float) -> np.ndarray:
    """Which states (n,) belong to blocks that decay slower than five times the windup time, or not at all."""
    slow = np.zeros(deployment.controller.n_states, bool)
    for block in _blocks(deployment.sizes):
        radius = np.abs(np.linalg.eigvals(deployment.increment[block, block]) + 1).max()
        slow[block] = 1 - radius < dt / (_SLOW * windup_time)
    return slow


def _winding_first(sizes: Sequence[int], slow: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    blocks = sorted(_blocks(sizes), key=lambda block: not slow[block.start])
    order = np.concatenate([np.arange(b.start, b.stop) for b in blocks]) if blocks else np.zeros(0, int)
    return order, tuple(b.stop - b.start for b in blocks)


def _blocks(sizes: Sequence[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(start, end) for start, end in pairwise(ends)]


def _unwinding(deployment: Deployment, slow: np.ndarray, currents: np.ndarray, rate: float) -> np.ndarray:
    """L (n, p) [1/A] on the slow states: a filter's gain, from the Riccati equation, that stabilises A - L C.

    States are weighted by their effect on the outputs, outputs by their limits; with one integrator per output the unwinding
    takes rate = dt / windup_time per sample.
    """
    n, p = deployment.controller.n_states, len(currents)
    gain = np.zeros((n, p))
    if not slow.any():
        return gain
    E = deployment.increment[np.ix_(slow, slow)]
    C = deployment.controller.C[:, slow] / currents[:, None]
    size = np.linalg.norm(C, axis=0)
    if not (size > 0).all():
        raise UnstableSystem("the controller has an integrator that no output sees: it would grow for ever; remove that state")
    A, C = np.eye(len(E)) + E * size[:, None] / size, C / size
    try:
        P = sla.solve_discrete_are(A.T, C.T, rate**2 * np.eye(len(A)), np.eye(p))
        L = A @ np.linalg.solve(np.eye(p) + C @ P @ C.T, C @ P).T
    except np.linalg.LinAlgError as error:
        message = (
            f"no anti-windup gain was found for the controller's {len(A)} slow states ({error}); give a longer windup_time"
        )
        raise NumericalFailure(message) from error
    if np.abs(np.linalg.eigvals(A - L @ C)).max() >= 1:
        raise NumericalFailure("the anti-windup gain does not stabilise the slow states; give another windup_time")
    gain[slow] = L / size[:, None] / currents
    return gain


def _state_bounds(
    deployment: Deployment, unwind: np.ndarray, slow: np.ndarray, errors: np.ndarray, currents: np.ndarray
) -> np.ndarray:
    """Bounds (n,) on the states for every plausible input and any saturation (the module's formula)."""
    K, E = deployment.controller, deployment.increment
    bound = np.zeros(K.n_states)
    for block in _blocks(deployment.sizes):
        if not slow[block].any():
            bound[block] = peak_gains(E[block, block], K.B[block] * errors) @ np.ones(len(errors))
    if slow.any():
        L, fast = unwind[slow], ~slow
        B = np.hstack([(K.B[slow] - L @ K.D) * errors, -L @ K.C[:, fast] * bound[fast], L * currents])
        bound[slow] = peak_gains(E[np.ix_(slow, slow)] - L @ K.C[:, slow], B).sum(axis=1)
    if not np.isfinite(bound).all():
        raise UnstableSystem("a state of the controller has no bound: it is unstable; design a stable controller for code")
    return np.maximum(_HEADROOM * bound, np.finfo(float).tiny)


def _powers(sizes: Sequence[int], bound: np.ndarray) -> np.ndarray:
    """Powers of two (n,), not below the bounds, one for the two states of a rotation."""
    scale = np.exp2(np.ceil(np.log2(bound)))
    for block in _blocks(sizes):
        if block.stop - block.start == 2:
            scale[block] = scale[block].max()
    return scale


def _transfer(
    deployment: Deployment, scale: np.ndarray, slow: np.ndarray, currents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled states from errors (n, m) and currents (n, p): fast ones in their steady state, slow ones make up the current.

    x = xe + W C' (C W C')^-1 (u - D e - C xe): of all states that continue with u, the nearest to the fast modes' steady state
    xe, in the weights W, which leave the fast modes alone where the slow ones span the outputs.
    """
    K, E = deployment.controller, deployment.increment
    n, m, p = K.n_states, len(K.inputs), len(currents)
    steady = np.zeros((n, m))
    fast = ~slow
    steady[fast] = np.linalg.solve(-E[np.ix_(fast, fast)], K.B[fast])
    C = K.C / currents[:, None]
    size = np.maximum(np.linalg.norm(C, axis=0), np.finfo(float).tiny)
    normed = C[:, slow] / size[slow]
    spans = slow.any() and np.linalg.matrix_rank(normed, tol=1e-3) == p
    weight = np.where(slow | (not spans), 1 / size**2, 0.0)
    gram = (C * weight) @ C.T
    if n == 0 or np.linalg.matrix_rank(gram, tol=1e-9 * max(np.trace(gram), 1e-300)) < p:
        return np.zeros((n, m)), np.zeros((n, p))  # outputs that the states cannot set: transfer starts from rest
    pick = weight[:, None] * np.linalg.solve(gram, C).T / currents
    from_error = steady - pick @ (K.D + K.C @ steady)
    return from_error / scale[:, None], pick / scale[:, None]


def transfers(block: ControlBlock) -> bool:
    """Whether the block can go on from given currents (its states span the outputs)."""
    return bool(block.from_output.any())
