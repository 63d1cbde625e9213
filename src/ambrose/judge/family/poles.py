"""Poles of a closed loop while one thing changes: speed, pressure, or a parameter over its
tolerance; where stability ends.

Poles of a sampled loop are shown as those of the continuous one that it samples, log(z)/dt, and
modes of the plant above half the sample rate at their true frequency (core/aliasing.py). At each
value the plant is assembled anew. The ends of stability between two values are found by bisection;
what comes and goes between them is not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.judge.rotor_modes import damping_ratio

_DEEP = float(np.log(1e-12))  # ln|z| below which a pole is a delay, at no finite s
_BISECTIONS = 12  # a 4096th of the distance between two values

LoopAt = Callable[[float], tuple[StateSpace, StateSpace]]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoleMap(Presented):
    """over: what changes; unit: its SI unit; values (n,) ascending; poles: of each, with an
    imaginary part of zero or more, up to the highest frequency asked for [rad/s]; abscissa (n,)
    [rad/s]: the largest real part of all poles; damping (n,): the least damping ratio of the
    oscillating ones in the range; ends: (value, whether it is stable above).
    """

    over: str
    unit: str
    values: np.ndarray
    poles: tuple[np.ndarray, ...]
    abscissa: np.ndarray
    damping: np.ndarray
    ends: tuple[tuple[float, bool], ...]

    @property
    def stable(self) -> np.ndarray:
        """Whether the loop is stable (n,)."""
        return self.abscissa < 0


def pole_map(
    loop_at: LoopAt,
    over: str,
    unit: str,
    values: Sequence[float],
    highest: float,
) -> PoleMap:
    """The poles of ``loop_at(value)`` over ascending values, at least two. loop_at: the loop and
    the continuous plant that it was closed around, whose states are the loop's first; highest
    [rad/s]: modulus of the poles kept. Raises InvalidInput.
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 1 or len(x) < 2 or (np.diff(x) <= 0).any():
        raise invalid(
            f"the values of {over}", f"{x.size} values", "at least two, ascending", "give a range"
        )
    poles = [_continuous(*loop_at(float(value))) for value in x]
    kept = tuple(p[(p.imag >= 0) & (np.abs(p) <= highest)] for p in poles)
    abscissa = np.array([float(p.real.max()) for p in poles])
    rings = [p[p.imag > 1e-6 * np.abs(p)] for p in kept]
    damping = np.array([float(damping_ratio(p).min()) if len(p) else 1.0 for p in rings])
    ends = tuple(
        (_end(loop_at, a, b, before < 0), bool(after < 0))
        for (a, b), (before, after) in zip(
            pairwise(x.tolist()), pairwise(abscissa.tolist()), strict=True
        )
        if (before < 0) != (after < 0)
    )
    return PoleMap(over, unit, x, kept, abscissa, damping, ends)


def _continuous(loop: StateSpace, plant: StateSpace) -> np.ndarray:
    p = continuous_poles(loop.A, loop.dt, plant.A)[0].astype(complex)
    p = p if loop.dt is None else p[p.real > _DEEP / loop.dt]
    return p[np.lexsort((p.imag, p.real, np.abs(p)))]


def _end(loop_at: LoopAt, low: float, high: float, stable_below: bool) -> float:
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if (spectral_abscissa(loop_at(middle)[0]) < 0) == stable_below:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
