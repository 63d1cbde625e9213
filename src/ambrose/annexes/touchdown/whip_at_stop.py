"""Backward whip whose ring lies against its mount's stop.

In steady whip the ring goes around at a constant distance s from the middle. The stop at t pushes
it straight back by k_s (s - t), so that mount and stop are together a spring of

    kappa(s) = k + k_s (1 - t/s),    s > t,                                                    (1)

and no more: nothing changes within a turn, and (1) is exact. With a mount of stiffness kappa the
edge (``whip``) is at w(kappa) with the force f(kappa) on what the rotor touches, and the ring at

    s = |H f|,    H = 1/(kappa - m w^2 + j w d),                                               (2)

where f reaches it through race and elements. A stiffer spring makes whip faster, and whip comes
from below: it settles at the least kappa that meets (1) and (2).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ambrose.annexes.touchdown.fallen import stator_receptance
from ambrose.core.bracketed_root import bracketed_root
from ambrose.model.effects.touchdown import Bearing

Edge = tuple[float, tuple[float, ...]]  # frequency [rad/s], force of every bearing [N]
_TRIED = 8  # places at which the least solution is looked for
_EXACT = 1e-9  # of the stop's stiffness
_ROUNDS, _CLOSE = 40, 1e-4  # for several bearings, whose stops are met one by the other


def ring_distance(bearing: Bearing, w: float, force: float, mu: float) -> float:
    """How far [m] a ring goes from the middle under a whip's normal force [N] at w [rad/s]; its
    mount is linear here.
    """
    if w == 0.0 or not bearing.ring_mass:
        return 0.0
    if not (math.isfinite(w) and math.isfinite(force)):
        return math.inf
    stiffness = bearing.mount_stiffness - bearing.ring_mass * w**2
    behind = 1 / (stiffness + 1j * w * bearing.mount_damping)
    pushed = force * math.hypot(1, mu)
    if not bearing.race_mass:
        return abs(behind) * pushed
    # from the race on: its displacement is A f, less what its elements give, and its own inertia
    # m w^2 A f adds to f on the way
    A = stator_receptance(bearing, w, force)
    return abs(behind * (1 + bearing.race_mass * w**2 * A)) * pushed


def beyond_stop(bearing: Bearing, w: float, force: float, mu: float) -> bool:
    """Whether a ring goes further than its mount's travel under a whip's force [N] at w [rad/s]."""
    return math.isfinite(bearing.travel) and bool(
        ring_distance(bearing, w, force, mu) > bearing.travel
    )


def edge_at_stop(
    edge: Callable[[tuple[Bearing, ...]], Edge], bearings: tuple[Bearing, ...], mu: float
) -> Edge | None:
    """The edge where stops are met; None where those of several bearings do not settle.

    edge: where whip settles with linear mounts; bearings: those that take part. What nothing bounds
    with its ring fast to the stop stays without bounds.
    """

    def stiffened(shares: np.ndarray) -> tuple[Bearing, ...]:
        # kappa = k + share k_s
        return tuple(
            item._replace(mount_stiffness=item.mount_stiffness + share * item.stop_stiffness)
            if math.isfinite(item.travel)
            else item
            for item, share in zip(bearings, shares, strict=True)
        )

    def left(shares: np.ndarray) -> np.ndarray:
        # (1): 1 - t/s, zero before the stop, less the share that was assumed
        stiff = stiffened(shares)
        w, forces = edge(stiff)
        met = np.zeros(len(stiff))
        for i, item in enumerate(stiff):
            distance = ring_distance(item, w, forces[i], mu)
            if distance > item.travel:
                met[i] = 1 - item.travel / distance
        return met - shares

    if len(bearings) == 1:
        least = _least(lambda share: float(left(np.array([share]))[0]))
        return edge(stiffened(np.array([least])))
    shares = np.zeros(len(bearings))
    for _ in range(_ROUNDS):
        change = left(shares)
        shares = shares + change / 2
        if np.abs(change).max() < _CLOSE:
            return edge(stiffened(shares))
    return None


def _least(left: Callable[[float], float]) -> float:
    """The least share at which ``left``, above zero at 0, falls through zero; 1 where it does
    not.
    """
    low = 0.0
    for high in np.linspace(0, 1, _TRIED + 1)[1:]:
        if left(float(high)) <= 0:
            return bracketed_root(left, low, float(high), absolute=_EXACT)
        low = float(high)
    return 1.0
