"""Which models and frequencies count in the p-norm of the channels: the others are left out of an
evaluation.

Near a controller most pairs of model and frequency stay far below the largest ratio, and to the
power p they add nothing. What counts is gathered once and holds for a few steps of a descent
(Apkarian & Noll 2006 work with the active frequencies likewise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.synthesis.fixed_order.channels import S_O, Channel, Scaled, Settling


@dataclass(frozen=True, slots=True, eq=False)
class ActivePart:
    """A channel A - B Q C at its active pairs: pairs (k,) of all, A (k, r, c), B (k, r, a), C (k,
    a, c).
    """

    pairs: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray

    def response(self, S: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """T (k, r, c)."""
        return np.asarray(self.A - self.B @ Q[self.pairs] @ self.C)


@dataclass(frozen=True, slots=True, eq=False)
class ActiveScaled:
    """A channel factor S_o or factor Q at its active pairs (k,), factor (k, 1, 1)."""

    pairs: np.ndarray
    of: str
    factor: np.ndarray

    def response(self, S: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """T (k, a, a)."""
        return np.asarray((S if self.of == S_O else Q)[self.pairs] * self.factor)


@dataclass(frozen=True, slots=True, eq=False)
class Active:
    """Pairs of model and frequency, ordered by frequency.

    G (p, a, a): u -> y there. omega (p,): frequency index. distinct: the frequencies that occur,
    and starts: their first pairs. slow (k,): models whose settling counts; timed (w, k): their
    pairs. driven (k,): the pairs of channels that are made of Q.
    """

    G: np.ndarray
    omega: np.ndarray
    distinct: np.ndarray
    starts: np.ndarray
    parts: tuple[ActivePart | ActiveScaled, ...]
    slow: np.ndarray
    timed: np.ndarray
    driven: np.ndarray


def active(
    G: np.ndarray,
    channels: Sequence[Channel | Scaled],
    masks: Sequence[np.ndarray],
    settling: Settling | None,
    slow: np.ndarray,
) -> Active:
    """What counts: G (m, w, a, a); masks (m, w of the channel) of every channel; slow (k,): models
    whose settling counts.
    """
    used = np.zeros(G.shape[1::-1], bool)  # (w, m)
    for channel, mask in zip(channels, masks, strict=True):
        used[channel.at] |= mask.T
    if settling is not None:
        used[np.ix_(settling.at, slow)] = True

    # Pairs in the order of frequency, so that those of one frequency stand together; place (w, m)
    # is where each stands.
    omega, models = np.nonzero(used)
    place = np.zeros(used.shape, int)
    place[omega, models] = np.arange(len(omega))
    distinct, starts = np.unique(omega, return_index=True)
    parts: list[ActivePart | ActiveScaled] = []
    driven = np.zeros(len(omega), bool)
    for channel, mask in zip(channels, masks, strict=True):
        i, j = np.nonzero(mask)
        if not len(i):
            continue
        pairs = place[channel.at[j], i]
        if isinstance(channel, Scaled):
            parts.append(ActiveScaled(pairs, channel.of, channel.factor[j, None, None]))
            driven[pairs] |= channel.of != S_O
            continue
        A, B, C = (
            np.broadcast_to(M, (*mask.shape, *M.shape[2:]))[i, j]
            for M in (channel.A, channel.B, channel.C)
        )
        parts.append(ActivePart(pairs, A, B, C))
        driven[pairs] = True
    timed = (
        np.zeros((0, 0), int) if settling is None else place[settling.at[:, None], slow[None, :]]
    )
    return Active(
        G[models, omega], omega, distinct, starts, tuple(parts), slow, timed, np.flatnonzero(driven)
    )
