"""The sensitivity with a synchronous block on, as it is measured in operation (ISO 14839-3).

With the block's H(z) = (eps Ts/2) (D e^{j W Ts}/(z - e^{j W Ts}) + its conjugate) from what it
reads to c, and the loop's M from c and M_d from the disturbance d at the sensors to that, e = S d +
M_e c with M_e = -S, so that

    e = (S + M_e H (1 - M H)^-1 M_d) d

which has a zero at the speed for the mode current-free, and peaks beside it that grow with eps.
"""

from __future__ import annotations

import numpy as np

from ambrose.core.frequency import transfer_matrix
from ambrose.law.synchronous import Condition, SynchronousLoop

_FREQUENCIES = 400  # of the grid, from 3 rad/s
_BESIDE = 1e-13  # from a pole of the block, in z


def sensitivity(
    loop: SynchronousLoop,
    mode: str,
    speed: float,
    condition: Condition,
    T: np.ndarray | None,
    gain: float,
    omega: np.ndarray,
    leak: float = 0.0,
) -> np.ndarray:
    """S (w, a, a) at omega (w,) [rad/s], from a disturbance of the measured displacements to what
    the controller sees.

    T (a, a): of the block at the speed [rad/s] (None: without it); gain eps [1/s]; leak [1/s].
    """
    # M: from c to (e, y, u), axes in a row; M_e = -S
    sampled = loop.sampled(speed, condition)
    dt, n = loop.timing.sample_time, len(loop.axes)
    z = np.exp(1j * omega * dt)
    # d enters y, hence e: as -c does, but for what is added to c's own path: y = g + d, e = g - c +
    # d
    M = transfer_matrix(sampled.A, sampled.B, sampled.C, sampled.D, z)
    S = -M[:, :n]

    if T is None or gain == 0:
        return np.asarray(S)

    # M_read: from c to what the block reads
    names = loop.reads(mode)
    rows = [sampled.outputs.index(name) for name in names]
    M_read = M[:, rows]

    # d = -c for all that follows e; y itself is e + c, so that d reaches y by one more than -c does
    M_d = -M_read.copy()
    for i, name in enumerate(names):
        if name.startswith("y_"):
            M_d[:, i, loop.axes.index(name[2:])] += 1.0

    # H = drive turn/(z - keep turn) + its conjugate: of c = Re(e^{j n theta} a) with
    # a+ = keep a + eps Ts D e^{-j n theta} s, keep = 1 - leak Ts
    drive = gain * dt / 2 * (T @ loop.weights(mode, speed, condition))
    turn = np.exp(1j * loop.harmonic * speed * dt)
    keep = 1 - leak * dt

    # exactly at the speed the block's gain is infinite: a rounding error beside it stands for it
    ahead, behind = (_apart(z - keep * pole) for pole in (turn, turn.conjugate()))
    H = (
        drive[None] * (turn / ahead)[:, None, None]
        + drive.conj()[None] * (turn.conjugate() / behind)[:, None, None]
    )

    # s = M_read c + M_d d, c = H s:   s = (I - M_read H)^-1 M_d d,   e = S d + M_e H s
    inner = np.linalg.solve(np.eye(len(rows)) - M_read @ H, M_d)
    return np.asarray(S + M[:, :n] @ H @ inner)


def _apart(distance: np.ndarray) -> np.ndarray:
    """Complex distances (w,), none of them zero."""
    return np.where(np.abs(distance) < _BESIDE, _BESIDE, distance)


def frequencies(loop: SynchronousLoop, speed: float, gain: float) -> np.ndarray:
    """Frequencies (w,) [rad/s] up to 2 kHz or three times the speed, packed beside the speed where
    the block acts.
    """
    highest = min(max(12566.0, 3 * speed), 0.98 * np.pi / loop.timing.sample_time)
    grid = np.geomspace(3.0, highest, _FREQUENCIES)
    if gain:
        beside, centre = gain * np.geomspace(0.05, 50, 40), loop.harmonic * speed
        grid = np.concatenate([grid, centre + beside, centre - beside])
    return np.unique(grid[(grid > 1.0) & (grid < highest)])


def sensitivity_peak(
    loop: SynchronousLoop,
    mode: str,
    speed: float,
    condition: Condition,
    T: np.ndarray | None,
    gain: float,
    leak: float = 0.0,
) -> tuple[float, float]:
    """The largest modulus of an axis' own sensitivity, other loops closed (ISO 14839-3), and its
    frequency [rad/s].
    """
    omega = frequencies(loop, speed, gain)
    S = np.abs(
        np.einsum("waa->wa", sensitivity(loop, mode, speed, condition, T, gain, omega, leak))
    )
    k = int(np.argmax(S.max(axis=1)))
    return float(S[k].max()), float(omega[k])
