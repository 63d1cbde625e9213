"""Backward whip before any simulation: where friction can keep a rotor whirling, how fast and with
which force.

Steady backward whip at w, in phasors that turn with it. At every touchdown bearing the rotor lies
at its clearance c along the unit e, is pushed back by N along e, and friction, which opposes the
spin, pushes it on, mu N along j e:

    f = -N (1 - j mu) e                      on the rotor, and -f on what it touches            (1)
    (A_rotor + A_stator) f = (c + N/k_c) e   relative displacement; k_c stiffness of the contact (2)

One bearing alone, A = A_rotor + A_stator:  Re A < 0,  mu = Im A / Re A,
N = c / (|Re A| (1 + mu^2) - 1/k_c).                                                            (3)

The friction mu(w) of (3) is what whip at w needs. Where the bearing has more, whip speeds up; where
it has less, it slows down: it settles where mu(w) rises through the bearing's friction, the edge.
A free mass m on a mount k, d has A = -1/(m w^2) + 1/(k + j d w), and (3) is the polynomial

    mu (k^2 - (k m - d^2) w^2) = m d w^3.                                                       (4)

Several bearings whip together, in one phase or in opposite ones: (1) and (2) for all of them, with
the unknowns N and the angles of e, followed from low w upwards. Whip of this kind slips; a rotor
that rolls without slip whirls at speed times radius over clearance, and no whip is faster.
Source of the criterion: the joint receptance of rotor and stator, Black, J. Mech. Eng. Sci. 10 (1)
(1968) 1-12 (recalled); derived anew here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.drop import FallenRotor, stator_receptance
from ambrose.core.frequency import bracketed_root
from ambrose.model.effects.touchdown import Bearing

MOST_FRICTION = 2.0  # beyond any pair of dry metals
_NEWTON, _CLOSE = 12, 1e-10  # steps, and the change that ends them
# rounds at most in which rolling elements take the stiffness of their load, from rigid ones on (a
# soft start would look like a rotor that nothing holds), and the change that ends them
_LOADS, _SAME = 40, 1e-6
_RIGID = 1e9  # N
_DOUBLINGS = 20  # of a load, up to which one is looked for that the elements carry


@dataclass(frozen=True, slots=True, eq=False)
class WhipCurve:
    """What whip needs, over its frequency.

    kind: "A alone" for one bearing, "together, in phase" or "together, in opposition". bearings: of
    which. frequency (w,) [rad/s]; friction (w,): what whip there needs, NaN where there is none
    (Re A >= 0); force (w, b) [N].
    """

    kind: str
    bearings: tuple[int, ...]
    frequency: np.ndarray
    friction: np.ndarray
    force: np.ndarray

    def band(self, mu: float) -> int | None:
        """The point below the first edge: the last one of the first stretch of frequencies in which
        whip needs less than mu; None where it needs more everywhere.
        """
        less = self.friction < mu  # NaN is no whip
        if not less.any():
            return None
        first = int(np.argmax(less))
        ends = np.flatnonzero(~less[first:])
        return len(less) - 1 if not len(ends) else first + int(ends[0]) - 1

    def edge(self, mu: float) -> tuple[float, float]:
        """(frequency [rad/s], largest force [N]) at which whip settles, between two points of the
        curve; (0, 0) where there is no whip, (inf, inf) where the curve ends below mu.
        """
        w, forces = self.edge_of_each(mu)
        return w, max(forces)

    def edge_of_each(self, mu: float) -> tuple[float, tuple[float, ...]]:
        """As ``edge``, with the force of every bearing."""
        at, count = self.band(mu), self.force.shape[1]
        if at is None:
            return 0.0, (0.0,) * count
        if at == len(self.friction) - 1:
            return np.inf, (np.inf,) * count
        w, after = self.frequency, at + 1
        if not np.isfinite(self.friction[after]):
            # the joint resonance lies before the next point: on with the line of the last two
            before = self.friction[at - 1] if at else np.nan
            if not 0 < before < self.friction[at]:  # no resonance: the contact's own end
                return float(w[after]), (np.inf,) * count
            at, after = at - 1, at
        # both 1/mu and 1/N fall to zero at the joint resonance, nearly straight:
        # share = (1/mu - 1/mu_1)/(1/mu_2 - 1/mu_1)
        low, high = self.friction[at], self.friction[after]
        share = high * (low - mu) / (mu * (low - high))
        settled = w[at] + share * (w[after] - w[at])
        flexible = 1 / self.force[at] + share * (1 / self.force[after] - 1 / self.force[at])
        beyond = min(settled, w[min(after + 1, len(w) - 1)])
        return float(beyond), tuple(float(1 / f) if f > 0 else np.inf for f in flexible)


@dataclass(frozen=True, slots=True)
class Whip:
    """Where whip of one kind settles at the machine's own friction.

    frequency [rad/s] and force (b,) [N] at the edge, 0 where there is no whip. A force of inf:
    nothing bounds it where the linear model ends; a frequency of inf: nothing but rolling ends it.
    rolling [rad/s]: without slip; no whip is faster. stop: whether a
    ring would go beyond its mount's stop under the mounts alone; with_stop: whether frequency and
    force hold with the stops that are met (``whip_at_stop``), False where those of several bearings
    did not settle and the figures are the mounts' alone.
    """

    kind: str
    bearings: tuple[str, ...]
    friction: float
    frequency: float
    force: tuple[float, ...]
    rolling: float
    stop: bool
    with_stop: bool = True

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; what is not finite is null."""
        finite = np.isfinite(self.frequency)
        bounded = all(np.isfinite(value) for value in self.force)
        return {
            "kind": self.kind,
            "bearings": list(self.bearings),
            "friction": self.friction,
            "frequency": float(self.frequency) if finite else None,
            "force_0p": [float(value) for value in self.force] if bounded else None,
            "rolling": self.rolling,
            "beyond_stop": self.stop,
            "with_stop": self.with_stop,
        }


def receptances(fallen: FallenRotor, frequency: np.ndarray) -> np.ndarray:
    """Backward receptances (w, b, b) [m/N] of the rotor over frequencies (w,) [rad/s]."""
    return np.array([fallen.receptance(float(w)) for w in frequency])


def alone(
    name: str, index: int, frequency: np.ndarray, rotor: np.ndarray, bearing: Bearing
) -> WhipCurve:
    """The curve (3) of one bearing. rotor (w,) [m/N]: its receptance there."""
    points = [_needed(rotor[i], float(w), bearing) for i, w in enumerate(frequency)]
    friction, force = np.array(points).T
    return WhipCurve(f"{name} alone", (index,), frequency, friction, force[:, None])


def _needed(rotor: complex, w: float, bearing: Bearing) -> tuple[float, float]:
    """(mu, N) of (3); NaN where there is no whip."""

    def room(A: complex) -> float:
        mu = max(A.imag / A.real, 0.0)
        return abs(A.real) * (1 + mu**2) - 1 / bearing.stiffness

    contact = _at_load(rotor, w, bearing, room)
    if contact is None:
        return np.nan, np.nan
    A, force = contact
    return max(A.imag / A.real, 0.0), force


def _at_load(
    rotor: complex, w: float, bearing: Bearing, room: Callable[[complex], float]
) -> tuple[complex, float] | None:
    """A and N of (3), N = c / room(A), where rolling elements have the stiffness of their load;
    None where there is no whip, or the contact itself is softer: it opens no gap any more.
    """

    def joint(load: float) -> complex:
        return rotor + stator_receptance(bearing, w, load)

    load, A = _RIGID, joint(_RIGID)
    for _ in range(_LOADS):
        if A.real >= 0 or room(A) <= 0:
            break
        last, load = load, bearing.clearance / room(A)
        if not bearing.race_mass or abs(load - last) < _SAME * load:
            return A, load
        A = joint(load)
    if load == _RIGID or not bearing.race_mass:
        return None

    # slow, or elements too soft at the load of rigid ones: up from there to one that they carry,
    # N room(A(N)) = c
    def missing(log_load: float) -> float:
        A = joint(np.exp(log_load))
        return float(np.exp(log_load) * room(A) - bearing.clearance) if A.real < 0 else -1.0

    low = np.log(bearing.clearance / room(joint(_RIGID)))
    way = -np.log(2) if missing(low) > 0 else np.log(2)
    for _ in range(_DOUBLINGS):
        high = low + way
        if missing(high) * way > 0:
            load = float(np.exp(bracketed_root(missing, low, high, absolute=_SAME)))
            return joint(load), load
        low = high
    return None


def edge_alone(fallen: FallenRotor, index: int, mu: float, curve: WhipCurve) -> tuple[float, float]:
    """(frequency [rad/s], force [N]) of the edge of one bearing, solved between the points of its
    curve; the force is inf where the contact itself is softer than what mu asks for.
    """
    at = curve.band(mu)
    if at is None or at == len(curve.friction) - 1:
        return curve.edge(mu)
    bearing = fallen.bearings[index]

    def room(A: complex) -> float:
        return abs(A.real) * (1 + mu**2) - 1 / bearing.stiffness

    def joint(w: float) -> complex:
        rotor = fallen.receptance(w)[index, index]
        contact = _at_load(rotor, w, bearing, room)
        return complex(
            rotor + stator_receptance(bearing, w, _RIGID) if contact is None else contact[0]
        )

    def excess(w: float) -> float:
        # mu Re A = Im A; above zero where friction is more than whip needs (Re A < 0), below
        # where it is less, and beyond the joint resonance
        A = joint(w)
        return A.imag - mu * A.real

    low, high = curve.frequency[at], curve.frequency[at + 1]
    if excess(low) * excess(high) > 0:
        return float(high), np.inf  # the contact's own end
    w = bracketed_root(excess, low, high, absolute=1e-12, relative=1e-12)
    left = room(joint(w))
    return w, bearing.clearance / left if left > 0 else np.inf


def together(
    kind: str,
    angles: np.ndarray,
    frequency: np.ndarray,
    rotor: np.ndarray,
    bearings: tuple[Bearing, ...],
) -> WhipCurve:
    """The curve of all bearings at once, followed upwards from the angles (b,) [rad] of e; rotor
    (w, b, b) [m/N].

    Unknowns: the friction angle g = atan mu, and the angles of e against the first one's.
    """
    count = len(bearings)
    friction = np.full(len(frequency), np.nan)
    force = np.full((len(frequency), count), np.nan)
    clearance = np.array([bearing.clearance for bearing in bearings])
    unknown = np.array([0.0, *angles[1:]])
    load = np.full(count, _RIGID)
    for i, w in enumerate(frequency):
        # the load of the frequency before is close already
        known = i > 0 and bool(np.isfinite(force[i - 1]).all())
        for _ in range(1 if known else _LOADS):
            stator = [
                stator_receptance(b, float(w), n) for b, n in zip(bearings, load, strict=True)
            ]
            solved = _solve(rotor[i] + np.diag(stator), clearance, bearings, unknown)
            if solved is None:
                break
            unknown, load = solved
            if not any(bearing.race_mass for bearing in bearings):
                break
        if solved is None:
            if np.isfinite(friction).any():
                break  # the branch ends: beyond the joint resonance
            unknown = np.array([0.0, *angles[1:]])
            load = np.full(count, _RIGID)
            continue
        friction[i] = max(np.tan(unknown[0]), 0.0)
        force[i] = load
        if friction[i] > MOST_FRICTION:
            break
    return WhipCurve(kind, tuple(range(count)), frequency, friction, force)


def _solve(
    A: np.ndarray, clearance: np.ndarray, bearings: tuple[Bearing, ...], start: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Newton's method for (1) and (2): the unknowns and the forces (b,); None where no bearing is
    pushed, or it does not close.
    """
    soft = np.array([1 / bearing.stiffness for bearing in bearings])

    def forces(unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        e = np.exp(1j * np.array([0.0, *unknown[1:]]))
        # (2) with N e = -f / (1 - j mu): (A + 1/(k_c (1 - j mu))) f = c e
        contact = np.diag(soft / (1 - 1j * np.tan(unknown[0])))
        f = np.linalg.solve(A + contact, clearance * e)
        pushed = -f / e  # N (1 - j mu): all at the angle -g
        return np.angle(pushed * np.exp(1j * unknown[0])), np.abs(pushed)

    unknown = start.copy()
    for _ in range(_NEWTON):
        error, size = forces(unknown)
        slopes = np.empty((len(error), len(error)))
        for k in range(len(error)):
            moved = unknown.copy()
            moved[k] += 1e-6
            slopes[:, k] = (forces(moved)[0] - error) / 1e-6
        try:
            step = np.linalg.solve(slopes, error)
        except np.linalg.LinAlgError:
            return None
        unknown = unknown - step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-300))
        if np.abs(step).max() < _CLOSE:
            break
    else:
        return None
    if not -1e-9 <= unknown[0] < np.arctan(MOST_FRICTION * 5):
        return None
    error, size = forces(unknown)
    return unknown, size * np.cos(unknown[0])


# Backward whip whose ring lies against its mount's stop.
#
# In steady whip the ring goes around at a constant distance s from the middle. The stop at t pushes
# it straight back by k_s (s - t), so that mount and stop are together a spring of
#
#     kappa(s) = k + k_s (1 - t/s),    s > t,                                                    (1)
#
# and no more: nothing changes within a turn, and (1) is exact. With a mount of stiffness kappa the
# edge (``whip``) is at w(kappa) with the force f(kappa) on what the rotor touches, and the ring at
#
#     s = |H f|,    H = 1/(kappa - m w^2 + j w d),                                               (2)
#
# where f reaches it through race and elements. A stiffer spring makes whip faster, and whip comes
# from below: it settles at the least kappa that meets (1) and (2).


Edge = tuple[float, tuple[float, ...]]  # frequency [rad/s], force of every bearing [N]
_TRIED = 8  # places at which the least solution is looked for
_EXACT = 1e-9  # of the stop's stiffness
_ROUNDS, _CLOSED = 40, 1e-4  # for several bearings, whose stops are met one by the other


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
        if np.abs(change).max() < _CLOSED:
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
