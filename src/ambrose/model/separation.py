"""How far a critical speed stays from the running speeds, after API 617 (as public code cites its
7th to 9th edition).

A critical speed with the amplification factor AF >= 2.5 needs the separation margin

    SM = min(16 %, 17 % (1 - 1/(AF - 1.5)))            of the lowest running speed, below it,
    SM = min(26 %, 10 % + 17 % (1 - 1/(AF - 1.5)))     of the highest, above it,

and none of them may lie between the two. Read the other way round, each place allows an
amplification factor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

LEAST_AMPLIFICATION = 2.5  # below it a peak is critically damped: no critical speed
_OFFSET, _SPAN = 1.5, 0.17  # of SM = 17 % (1 - 1/(AF - 1.5))
# margin from which more than 2.5 is allowed, and from which anything is
_BELOW, _ABOVE = (0.0, 0.16), (0.10, 0.26)


def running_range(
    stated: tuple[float, float] | None, speeds: Iterable[float]
) -> tuple[float, float] | None:
    """Between which speeds [rad/s] a machine runs: as stated, else from the slowest to the fastest
    of its turning operating points' ``speeds``; None: none turns.
    """
    turning = [speed for speed in speeds if speed > 0]
    return stated or ((min(turning), max(turning)) if turning else None)


def runs_within(speed: float, running: tuple[float, float]) -> bool:
    """Whether an operating point's speed lies within the running speeds, all [rad/s]."""
    return running[0] * (1 - 1e-9) <= speed <= running[1] * (1 + 1e-9)


def allowed_amplification(
    omega: np.ndarray, running: tuple[float, float], capped: bool = True
) -> np.ndarray:
    """The largest amplification factor allowed of a critical speed at omega (n,) [rad/s]; inf far
    from ``running`` [rad/s].

    capped: with the standard's jump to "anything" at 16 and 26 %; without, where the formula's own
    pole lies, at 17 and 27 %.
    """
    omega = np.asarray(omega, float)
    low, high = running
    below = omega < low
    margin = np.where(below, (low - omega) / low, np.maximum(omega - high, 0.0) / high)
    free, cap = (np.where(below, _BELOW[k], _ABOVE[k]) for k in (0, 1))
    share = np.clip((margin - free) / _SPAN, 0.0, 1.0)
    with np.errstate(divide="ignore"):
        allowed = _OFFSET + 1 / (1 - share)
    return np.where(capped & (margin >= cap), np.inf, allowed)


def needed_damping(
    omega: np.ndarray, running: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """The damping ratio 1/(2 AF) that the place omega [rad/s] of every mode asks for, and its
    derivative [s/rad].

    Continuous over omega: 0.2 between the running speeds, 0 beyond 17 and 27 % of them.
    """
    low, high = running
    below = omega < low
    margin = np.where(below, (low - omega) / low, np.maximum(omega - high, 0.0) / high)
    slope = np.where(below, -1 / low, np.where(omega > high, 1 / high, 0.0))
    free = np.where(below, _BELOW[0], _ABOVE[0])
    # 1 where 2.5 is allowed, 0 where anything is
    left = np.clip(1 - (margin - free) / _SPAN, 0.0, 1.0)
    within = (left > 0) & (left < 1)
    size = _OFFSET * left + 1
    return left / (2 * size), np.where(within, -slope / _SPAN / (2 * size**2), 0.0)
