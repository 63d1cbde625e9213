"""Everything that the generated code contains, as numbers: the sampled controller in scaled states,
limits, anti-windup.

    u  = C x + D e                         the current asked for
    us = min(max(u, -limit), limit)        the current given
    x += increment x + B e + unwind (us - u)

Every state lies within +-1 for every input that passes the plausibility check, which is proved:
whatever the saturation does, x[k+1] = (A - L C) x + (B - L D) e + L us holds with L = unwind, so
the peak gains of that system bound the states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import (
    HEADROOM,
    HOLD_SAMPLES,
    WINDUP_TIME,
    Block,
    Settings,
    anti_windup_gain,
    block_slices,
    check_settings,
    slow_states,
    transfer_gains,
)
from ambrose.code.block.names import names_in_code
from ambrose.code.sampled import Deployment
from ambrose.core.checks import UnstableSystem
from ambrose.core.peak_gain import peak_gains
from ambrose.core.statespace import StateSpace


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlBlock(Block):
    """What runs: see the module's formulas.

    sizes: of the diagonal blocks of ``increment``; from_error (n, m) [1/m] and from_output (n, p)
    [1/A]: the states with which the controller goes on from given currents; winding: how many
    states, the first ones, wind up.
    """

    sizes: tuple[int, ...]
    from_error: np.ndarray
    from_output: np.ndarray
    winding: int

    @property
    def transfers(self) -> bool:
        return bool(self.from_output.any())

    @property
    def system(self) -> StateSpace:
        """The block between its limits, as a sampled system."""
        A = np.eye(self.n_states) + self.increment
        return StateSpace(A, self.B, self.C, self.D, self.inputs, self.outputs, self.sample_time)

    def respond(self, e: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The currents asked for (p,) [A] and what is added to the states (n,), for errors e (m,)
        [m].
        """
        return self.D @ e + self.C @ x, self.increment @ x + self.B @ e


def build_block(
    deployment: Deployment,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
) -> ControlBlock:
    """The block of a deployment.

    name: prefix of everything in the code, a C identifier. error_limit [m] and current_limit [A]:
    one number or one per axis; larger errors are implausible, larger currents are cut. windup_time
    [s]: how fast states slower than five times it follow the limited output. hold_samples: a
    missing input is replaced by its last good value for so many samples before the block reports a
    fault. Raises InvalidInput, UnstableSystem for a controller whose states have no bound.
    """
    K = deployment.controller
    settings = check_settings(K, name, error_limit, current_limit, windup_time, hold_samples)
    errors, currents = settings.error_limit, settings.current_limit
    dt = float(K.dt or 0.0)

    # anti-windup L and bounds in the deployment's states, then scale: z = x/scale within +-1
    slow = slow_states(deployment.increment, deployment.sizes, dt, windup_time)
    unwind = unwinding(deployment, slow, currents, dt / windup_time)
    bound = state_bounds(deployment, unwind, slow, settings)
    scale = _powers(deployment.sizes, bound)

    # currents asked for at most: |C| bound + |D| errors
    C, D = K.C * scale, K.D
    raw = np.abs(C) @ (bound / scale) + np.abs(D) @ errors
    from_error, from_output = transfer(deployment, scale, slow, currents)

    # states that wind up first; A - I in scaled states
    order, sizes = _winding_first(deployment.sizes, slow)
    increment = (deployment.increment * scale / scale[:, None])[np.ix_(order, order)]
    return ControlBlock(
        name=name,
        inputs=names_in_code(K.inputs),
        outputs=names_in_code(K.outputs),
        sample_time=dt,
        delay=deployment.delay,
        sizes=sizes,
        increment=increment,
        B=(K.B / scale[:, None])[order],
        C=C[:, order],
        D=D,
        unwind=(unwind / scale[:, None])[order],
        from_error=from_error[order],
        from_output=from_output[order],
        error_limit=errors,
        current_limit=currents,
        raw_limit=np.maximum(raw, currents),
        winding=int(slow.sum()),
        hold_samples=hold_samples,
        windup_time=windup_time,
    )


def _winding_first(sizes: Sequence[int], slow: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    blocks = sorted(block_slices(sizes), key=lambda block: not slow[block.start])
    order = (
        np.concatenate([np.arange(b.start, b.stop) for b in blocks]) if blocks else np.zeros(0, int)
    )
    return order, tuple(b.stop - b.start for b in blocks)


def unwinding(
    deployment: Deployment, slow: np.ndarray, currents: np.ndarray, rate: float
) -> np.ndarray:
    """L (n, p) [1/A], on the slow states only."""
    gain = np.zeros((deployment.controller.n_states, len(currents)))
    if not slow.any():
        return gain

    # currents in parts of their limits, seen from the slow states
    C = deployment.controller.C[:, slow] / currents[:, None]
    size = np.linalg.norm(C, axis=0)
    if not (size > 0).all():
        raise UnstableSystem(
            "the controller has an integrator that no output sees: it would grow for ever; remove "
            "that state"
        )
    where = f"for the controller's {len(size)} slow states"
    gain[slow] = anti_windup_gain(
        deployment.increment[np.ix_(slow, slow)], C, size, currents, rate, where
    )
    return gain


def state_bounds(
    deployment: Deployment, unwind: np.ndarray, slow: np.ndarray, settings: Settings
) -> np.ndarray:
    """Bounds (n,) on the states for every plausible input and any saturation (the module's
    formula).
    """
    K = deployment.controller
    E = deployment.increment
    errors = settings.error_limit
    bound = np.zeros(K.n_states)

    # blocks without slow states have no anti-windup: x[k+1] = A x + B e
    for block in block_slices(deployment.sizes):
        if not slow[block].any():
            bound[block] = peak_gains(E[block, block], K.B[block] * errors) @ np.ones(len(errors))
    if slow.any():
        # slow states: x[k+1] = (A - L C) x + (B - L D) e - L C_fast x_fast + L us,
        # fast ones at their bounds
        L, fast = unwind[slow], ~slow
        B = np.hstack(
            [
                (K.B[slow] - L @ K.D) * errors,
                -L @ K.C[:, fast] * bound[fast],
                L * settings.current_limit,
            ]
        )
        bound[slow] = peak_gains(E[np.ix_(slow, slow)] - L @ K.C[:, slow], B).sum(axis=1)
    if not np.isfinite(bound).all():
        raise UnstableSystem(
            "a state of the controller has no bound: it is unstable; design a stable controller "
            "for code"
        )
    return np.maximum(HEADROOM * bound, np.finfo(float).tiny)


def _powers(sizes: Sequence[int], bound: np.ndarray) -> np.ndarray:
    """Powers of two (n,), not below the bounds, one for the two states of a rotation."""
    scale = np.exp2(np.ceil(np.log2(bound)))

    # one scale keeps a rotation a rotation
    for block in block_slices(sizes):
        if block.stop - block.start == 2:
            scale[block] = scale[block].max()
    return scale


def transfer(
    deployment: Deployment, scale: np.ndarray, slow: np.ndarray, currents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled states from errors (n, m) and currents (n, p), zero where the states cannot set the
    outputs.
    """
    K = deployment.controller
    gains = transfer_gains(deployment.increment[None], K.B[None], K.C[None], slow, currents)
    if gains is None:
        return np.zeros(K.B.shape), np.zeros(K.C.T.shape)

    # x = steady e + pick (u - (D + C steady) e): fast states at constant errors, moved
    # until the outputs are u
    steady, pick = gains[0][0], gains[1][0]
    return (steady - pick @ (K.D + K.C @ steady)) / scale[:, None], pick / scale[:, None]
