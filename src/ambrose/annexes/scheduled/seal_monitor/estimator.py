"""Instrumental-variable estimate of the seal's parameters over a fading window, with an interval,
from block to block.

With instruments z, sum z e = (sum z r1 + sum z r2 theta) theta over the window, each sample
weighted by exp(-age/window). The interval has three parts: noise, by the scatter of the blocks' own
sums around the estimate (whatever the noise's colour, with Student's t for half the blocks that
count); what is taken as known, by its exact effect on this estimate; the rate at which the seal may
change times the estimate's own mean age. A faster change is seen by a second, short window that
disagrees (watch.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

BLOCK = 0.0125  # [s] whose sums count as independent
_FEWEST = 5.0  # blocks beyond one per parameter: fewer show no scatter
_Z = 1.959963984540054  # 97.5 % quantile of the normal distribution


@dataclass(frozen=True, slots=True)
class Estimate:
    """theta (q,) in units of the reference, half widths (q,) of its 95 % interval and of the parts
    of that, mean age [s].

    Parts: noise; known, of what the model takes as known; change, of a seal that changes. NaN and
    infinite where nothing excites the loop, or too little was seen.
    """

    theta: np.ndarray
    half_width: np.ndarray
    noise: np.ndarray
    known: np.ndarray
    change: np.ndarray
    age: float
    restarted: bool = False


def block_sums(signals: Mapping[str, np.ndarray], block: int) -> dict[str, np.ndarray]:
    """Sums over b successive blocks, for q parameters and c doubts (what the model takes as known):
    ze (b, q), zr1 (b, q, q), zr2 (b, q, q, q) and zd (b, q, c).
    """

    def cut(x: np.ndarray) -> np.ndarray:
        whole = x.shape[-1] // block * block
        return x[..., :whole].reshape(*x.shape[:-1], whole // block, block)

    # (..., p, b, k): output p, block b, sample k of the block
    z, e, r1, r2, d = (
        cut(signals[name]) for name in ("instruments", "error", "r1", "r2", "doubts")
    )
    q = len(z)

    # over outputs and the samples of a block: sum z e, sum z r1, sum z r2, sum z d
    products = [np.einsum("ipbk,jpbk->bij", z, x, optimize=True) for x in (e[None], r1, r2, d)]
    return {
        "ze": products[0][..., 0],
        "zr1": products[1],
        "zr2": products[2].reshape(-1, q, q, q),
        "zd": products[3],
    }


@dataclass(slots=True)
class Window:
    """Fading sums over an exponential window [s]; ``lag``: sum of weight, age and z r1."""

    q: int
    c: int
    window: float
    step: float
    sums: np.ndarray = field(init=False)
    squares: np.ndarray = field(init=False)
    known: np.ndarray = field(init=False)
    lag: np.ndarray = field(init=False)
    weight: float = 0.0
    weight2: float = 0.0

    def __post_init__(self) -> None:
        q = self.q
        size = q + q * q + q**3
        self.sums, self.squares = np.zeros(size), np.zeros((size, size))
        self.known, self.lag = np.zeros((q, self.c)), np.zeros((q, q))

    def add(self, block: Mapping[str, np.ndarray]) -> None:
        """The sums of one more block."""
        q, f = self.q, float(np.exp(-self.step / self.window))
        # a block's row: (z e; z r1; z r2), q + q^2 + q^3 entries
        row = np.concatenate([block["ze"], block["zr1"].ravel(), block["zr2"].ravel()])

        # sum w age z r1: what was there fades and ages by a step; the new block is half a step old
        before = self.sums[q : q + q * q].reshape(q, q)
        self.lag = f * (self.lag + self.step * before) + 0.5 * self.step * block["zr1"]

        # sum w row, and sum w^2 row row' for the variance of the former
        self.sums, self.squares = f * self.sums + row, f * f * self.squares + np.outer(row, row)
        self.known = f * self.known + block["zd"]
        self.weight, self.weight2 = f * self.weight + 1, f * f * self.weight2 + 1

    def estimate(self, kinds: np.ndarray, rate: float) -> Estimate:
        """theta and its interval from the sums so far.

        kinds (c,): numbers of the groups whose members err together; rate [reference/s].
        """
        q = self.q
        s, R1, R2 = np.split(self.sums, [q, q + q * q])
        R1, R2 = R1.reshape(q, q), R2.reshape(q, q, q)

        unknown = np.full(q, np.inf)
        # blocks of equal weight with the same scatter of their mean: (sum w)^2 / sum w^2
        counted = self.weight**2 / self.weight2 if self.weight2 else 0.0
        if counted < _FEWEST + q or np.linalg.cond(R1) > 1e8:  # not excited
            return Estimate(np.full(q, np.nan), unknown, unknown, unknown, unknown, np.inf)

        # s = R1 theta + (R2 theta) theta: the linear part first, then by iteration on R2 theta
        theta = np.linalg.solve(R1, s)
        for _ in range(6):
            theta = np.linalg.solve(R1 + R2 @ theta, s)

        # derivative of R1 theta + R2 theta theta: both factors of the squares count
        slope = R1 + R2 @ theta + np.einsum("igh,g->ih", R2, theta)

        # T row = z e - z r1 theta - z r2 theta theta: what the estimate leaves of a block
        T = np.hstack(
            [
                np.eye(q),
                -np.kron(np.eye(q), theta),
                -np.kron(np.eye(q), np.outer(theta, theta).ravel()),
            ]
        )

        # their scatter, q degrees of freedom being spent on theta; theta errs by slope^-1 of it
        scatter = T @ self.squares @ T.T * counted / (counted - q)
        slope_inverse = np.linalg.inv(slope)
        spread = np.sqrt(np.diag(slope_inverse @ scatter @ slope_inverse.T))

        # neighbours are not quite independent: half of them count
        noise = students_t((counted - q) / 2) * spread

        # a doubt moves theta by slope^-1 sum z d; those of a kind add up, the kinds in quadrature
        effect = np.abs(slope_inverse @ self.known)
        groups = [effect[:, kinds == kind].sum(axis=1) for kind in np.unique(kinds)]
        known = np.sqrt(np.sum(np.square(groups), axis=0)) if groups else np.zeros(q)

        # theta(t - age) = theta(t) -+ rate age, at worst, enters by slope^-1 sum w age z r1
        ages = slope_inverse @ self.lag
        change = rate * np.abs(ages).sum(axis=1)
        return Estimate(
            theta,
            np.hypot(noise, known) + change,
            noise,
            known,
            change,
            float(np.abs(np.diag(ages)).max()),
        )


def students_t(freedom: float) -> float:
    """The 97.5 % quantile of Student's t, to 1 % from 3 degrees of freedom on (Abramowitz & Stegun
    26.7.5).
    """
    z, n = _Z, freedom
    return (
        z
        + (z**3 + z) / (4 * n)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3)
    )
