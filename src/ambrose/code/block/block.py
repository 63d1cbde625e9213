"""What the blocks of fixed and scheduled controllers share: signals, timing, limits, and how their
realisation is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.code.block.names import check_identifiers, names_in_code
from ambrose.core.checks import NumericalFailure, check_finite, check_positive, invalid
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace

HOLD_SAMPLES = 10
# s; an integral time of 0.2 s and a derivative time of 2 ms have it as their geometric mean
WINDUP_TIME = 0.02
HEADROOM = 1.02  # of the bounds on the states
_UNSEEN = 1e-150  # effect of a state that no output sees; its square is a number
_SLOW = 5.0  # times the windup time: modes slower than this wind up


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Block:
    """What runs, states within +-1, errors e (m,) [m], currents u (p,) [A]; every matrix of a
    scheduled block has its k grid points as the first axis.

    increment (n, n): A - I; B (n, m) [1/m], C (p, n) [A], D (p, m) [A/m], unwind (n, p) [1/A];
    error_limit (m,) [m] and current_limit (p,) [A]: what is plausible and what is given out;
    raw_limit (p,) [A]: the largest current asked for; hold_samples: how long a missing input is
    replaced; windup_time [s]: how fast states that wind up follow the limited current; delay
    [samples].
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_time: float
    delay: int
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    unwind: np.ndarray
    error_limit: np.ndarray
    current_limit: np.ndarray
    raw_limit: np.ndarray
    hold_samples: int
    windup_time: float

    @property
    def n_states(self) -> int:
        return self.increment.shape[-1]

    @property
    def state_range(self) -> np.ndarray:
        """The largest magnitude (n,) of every state."""
        return np.ones(self.n_states)

    @property
    def transfers(self) -> bool:
        """Whether the block can go on from given currents: its states reach every output."""
        raise NotImplementedError

    def single(self) -> Self:
        """The block with limits that single precision holds: what code in "float" compares with."""
        errors, currents = (
            np.float32(x).astype(float) for x in (self.error_limit, self.current_limit)
        )
        return replace(self, error_limit=errors, current_limit=currents)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Checked settings of a block: error_limit (m,) [m], current_limit (p,) [A], windup_time [s],
    hold_samples.
    """

    error_limit: np.ndarray
    current_limit: np.ndarray
    windup_time: float
    hold_samples: int


def check_settings(
    K: StateSpace | ScheduledSystem,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    windup_time: float,
    hold_samples: int,
) -> Settings:
    """The settings as arrays of the controller's size, after checking them and the names. Raises
    InvalidInput.
    """
    check_identifiers(name, names_in_code(K.inputs), names_in_code(K.outputs))
    errors = check_limits(
        error_limit, len(K.inputs), "error_limit", "the bearing's gap is the largest"
    )
    currents = check_limits(
        current_limit,
        len(K.outputs),
        "current_limit",
        "give the amplifier's largest control current in A",
    )
    check_positive(windup_time, "windup_time", f"give it in seconds, e.g. {WINDUP_TIME:g}")
    if (
        isinstance(hold_samples, bool)
        or not isinstance(hold_samples, int)
        or not 0 <= hold_samples <= 32767
    ):
        raise invalid(
            "hold_samples",
            hold_samples,
            "a whole number from 0 to 32767",
            f"{HOLD_SAMPLES} is usual",
        )
    return Settings(errors, currents, windup_time, hold_samples)


def check_limits(value: ArrayLike, count: int, name: str, remedy: str) -> np.ndarray:
    """One positive number or one per axis as an array (count,). Raises InvalidInput."""
    values = np.atleast_1d(check_finite(value, name)).astype(float).ravel()
    if values.size not in {1, count}:
        raise invalid(
            f"the number of {name} values",
            values.size,
            f"1 or {count}",
            "give one, or one per axis",
        )
    if (values <= 0).any():
        raise invalid(name, values.min(), "positive", remedy)
    return np.broadcast_to(values, count).copy()


def block_slices(sizes: Sequence[int]) -> list[slice]:
    """The places of diagonal blocks of these sizes."""
    return [slice(start, end) for start, end in pairwise(np.cumsum([0, *sizes]).tolist())]


def slow_states(
    increment: np.ndarray, sizes: Sequence[int], dt: float, windup_time: float
) -> np.ndarray:
    """Which states (n,) belong to blocks that decay slower than five times the windup time, or not
    at all.

    increment (n, n): A - I.
    """
    slow = np.zeros(len(increment), bool)
    for block in block_slices(sizes):
        # slow: 1 - |z| < dt/(_SLOW windup_time), for the slowest mode of the block
        radius = np.abs(np.linalg.eigvals(increment[block, block]) + 1).max()
        slow[block] = 1 - radius < dt / (_SLOW * windup_time)
    return slow


def anti_windup_gain(
    increment: np.ndarray,
    C: np.ndarray,
    size: np.ndarray,
    currents: np.ndarray,
    rate: float,
    where: str,
) -> np.ndarray:
    """L (n, p) [1/A]: a filter's gain, from the Riccati equation, that stabilises A - L C.

    increment (n, n): A - I. States are weighted by their effect ``size`` (n,) on the outputs C (p,
    n) in parts of the currents (p,) [A]; with one integrator per output the unwinding takes rate =
    dt / windup_time per sample. Raises NumericalFailure.
    """
    # states size x: A = size A/size, C = C/size, so that each moves the outputs by about 1
    A, C = np.eye(len(increment)) + increment * size[:, None] / size, C / size
    p = len(currents)
    try:
        # P = A P A' - A P C'(I + C P C')^-1 C P A' + rate^2 I,   L = A P C'(I + C P C')^-1;
        # one integrator, A = C = 1: P^2 = rate^2 (1 + P), hence L = rate for small rates
        P = sla.solve_discrete_are(A.T, C.T, rate**2 * np.eye(len(A)), np.eye(p))
        L = A @ np.linalg.solve(np.eye(p) + C @ P @ C.T, C @ P).T
    except np.linalg.LinAlgError as error:
        raise NumericalFailure(
            f"no anti-windup gain was found {where} ({error}): an integrator that no output sees, "
            "or an unsuitable "
            "windup_time; remove that state, or give another windup_time"
        ) from error
    if np.abs(np.linalg.eigvals(A - L @ C)).max() >= 1:
        raise NumericalFailure(
            f"the anti-windup gain {where} does not stabilise the states; give another windup_time"
        )

    # back from size x, and from parts of the currents to [1/A]
    return L / size[:, None] / currents


def transfer_gains(
    increment: np.ndarray, B: np.ndarray, C: np.ndarray, slow: np.ndarray, currents: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """steady (k, n, m) and pick (k, n, p), so that x = steady e; x += pick (u - C x - D e) goes on
    with the currents u.

    increment (k, n, n): A - I; B (k, n, m), C (k, p, n); slow (n,); currents (p,) [A]. steady:
    where fast states stand for constant errors. pick = W C' (C W C')^-1: of all states that
    continue with u, the nearest to the fast modes' steady state, in weights W that leave the fast
    modes alone where the slow ones span the outputs. None where the states do not reach every
    output.
    """
    k, p, n = C.shape
    steady = np.zeros((k, n, B.shape[2]))
    pick = np.zeros((k, n, p))
    fast = ~slow

    # spans: whether the slow states alone reach every output, at every point
    C = C / currents[:, None]
    size = np.maximum(np.linalg.norm(C, axis=1).max(axis=0, initial=0.0), _UNSEEN)
    spans = slow.any() and all(
        np.linalg.matrix_rank(c[:, slow] / size[slow], tol=1e-3) == p for c in C
    )

    # W: states by their effect on the outputs, the fast ones left alone where the slow ones span
    weight = np.where(slow | (not spans), 1 / size**2, 0.0)
    for i in range(k):
        # C W C'; singular where no state reaches some combination of the outputs
        gram = (C[i] * weight) @ C[i].T
        if n == 0 or np.linalg.matrix_rank(gram, tol=1e-9 * max(np.trace(gram), 1e-300)) < p:
            return None

        # (I - A) x = B e of the fast states;  pick = W C'(C W C')^-1
        steady[i, fast] = np.linalg.solve(-increment[i][np.ix_(fast, fast)], B[i, fast])
        pick[i] = weight[:, None] * np.linalg.solve(gram, C[i]).T / currents
    return steady, pick
