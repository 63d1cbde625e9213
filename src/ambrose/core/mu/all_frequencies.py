"""Mixed mu below a level at every frequency, proved: constant scalings on short intervals, and
nothing left between points.

With the scalings (X, G) of one frequency the M that satisfy

    M^H X_z M + j (G M - M^H G^H) < X_w

are a convex set. Two values of M that lie in it with room to spare therefore vouch for the chord
between them, and for all that is as near to the chord as the room allows; the chords below
say how near M(j omega) stays. Intervals are halved until their scalings do; all that are open are
tried together. Where mu itself reaches the level, the level is raised, which leaves valid what was
proved before. Skewed: only some rows of M are divided by the level, as for a worst-case gain (Fan &
Tits 1992).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import (
    NumericalFailure,
    UnstableSystem,
    check_positive,
    invalid,
    named_failure,
)
from ambrose.core.frequency import expansion, largest_gain, solve_shifted
from ambrose.core.lft import Block
from ambrose.core.mu.structure import Structure, osborne, structure_of
from ambrose.core.mu.upper import UpperBound, positive_definite, upper_bound
from ambrose.core.realisation import ModalForm, modal_form
from ambrose.core.statespace import StateSpace, as_statespace, balance_system

# A frequency response between two frequencies: the chord that joins its values, and how far it can
# lie from it.
#
# M(s) = D + sum of R_k / (s - p_k) in modal form, so that between a and b, entry by entry,
#
#     |M(j omega) - chord| <= (b - a)^2 / 8 max |M''|,
#
# with M'' by its Taylor series in the middle, the remainder by the sum of n! |R_k| / d_k^(n+1), d_k
# the distance of p_k from the interval: residues that cancel do so in the terms that count. Poles
# that cannot be told apart stay together as a small matrix, whose resolvent is bounded by a Neumann
# series. Nothing is asked of a grid: what lies between its points is enclosed.


_GROWTH = (1e4, 1e2, 1e1)  # of the transforms that separate poles, the first that keeps the digits
_TERMS = 8  # of the Taylor series
# of the eigenvectors of a cluster, up to which its resolvent is also bounded in their coordinates
_CONDITION = 1e9
_CHUNK = 200_000  # numbers held at once, which a processor keeps near


@dataclass(frozen=True, slots=True, eq=False)
class Chords:
    """D (n_z, n_w); poles (k,) [rad/s], both of a pair; residues (k, n_z, n_w); clusters: (A, B, C)
    of poles kept together, A quasi-triangular. sections: (b, 2 n_z n_w), see ``_sections``.
    """

    D: np.ndarray
    poles: np.ndarray
    residues: np.ndarray
    clusters: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    sections: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # of a pair p = a +- j b: R / (s - p) + R* / (s - p*) = (N0 + s N1) / (s^2 - 2 a s + p p*)
        # where N0 = -2 Re(R p*), N1 = 2 Re R; of a real one R / (s - p) = (N0 + s N1) / (p^2 - s^2)
        # where N0 = -p R, N1 = -R
        flat = self.residues.reshape(len(self.poles), self.D.size)
        alone, pair = self._kinds()
        R, p = flat[pair], self.poles[pair, None]
        S, q = flat[alone].real, self.poles[alone, None].real
        rows = [[-2 * (R * p.conj()).real, 2 * R.real], [-q * S, -S]]
        object.__setattr__(self, "sections", np.block(rows))

    def _kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers of the real poles, and of those above the real axis."""
        return np.flatnonzero(self.poles.imag == 0), np.flatnonzero(self.poles.imag > 0)

    @property
    def every_pole(self) -> np.ndarray:
        """The poles, those of the clusters included (n,) [rad/s]."""
        return np.concatenate([self.poles, *(np.linalg.eigvals(A) for A, _, _ in self.clusters)])

    def between(self, left: np.ndarray, right: np.ndarray) -> ChordsBetween:
        """left M right, for constant left (p, n_z) and right (n_w, m)."""
        return ChordsBetween(self, left, right)

    def part(self, outputs: np.ndarray, inputs: np.ndarray) -> Chords:
        """The chords between some of the inputs and outputs, by number."""
        clusters = tuple((A, B[:, inputs], C[outputs]) for A, B, C in self.clusters)
        return Chords(
            self.D[np.ix_(outputs, inputs)],
            self.poles,
            self.residues[:, outputs][:, :, inputs],
            clusters,
        )

    def at(self, omega: np.ndarray) -> np.ndarray:
        """M (w, n_z, n_w) at omega (w,) [rad/s]; infinity gives D."""
        values = np.broadcast_to(self.D, (len(omega), *self.D.shape)).astype(complex)
        finite = np.flatnonzero(np.isfinite(omega))
        step = max(1, _CHUNK // max(1, len(self.poles)))
        for start in range(0, len(finite), step):
            k = finite[start : start + step]
            values[k] += self._by_sections(omega[k])
        return values

    def _by_sections(self, omega: np.ndarray) -> np.ndarray:
        """M - D (w, n_z, n_w) in real products, half as long as those of every pole."""
        # 1 / (x + j y) of every section, x = |p|^2 - w^2 and y = -2 a w, or x = p^2 + w^2
        alone, pair = self._kinds()
        w, size = omega[:, None], np.abs(self.poles[pair])
        q = self.poles[alone].real
        x = np.hstack([(size - w) * (size + w), q**2 + w**2])
        y = np.hstack([-2 * self.poles[pair].real * w, np.zeros((len(omega), len(alone)))])
        with np.errstate(divide="ignore", invalid="ignore"):
            both = np.vstack([x, -y]) / np.tile(x**2 + y**2, (2, 1))

        # N0 + j w N1 times that
        real, imaginary = np.split((both @ self.sections).reshape(2, -1, 2 * self.D.size), 2)
        (a0, a1), (b0, b1) = (np.hsplit(part[0], 2) for part in (real, imaginary))
        values = np.empty(a0.shape, complex)
        values.real, values.imag = a0 - w * b1, b0 + w * a1
        values = values.reshape(len(omega), *self.D.shape)
        for A, B, C in self.clusters:
            X = np.repeat(B[:, None, :].astype(complex), len(omega), axis=1)
            solve_shifted(A, X, 1j * omega)
            values += np.moveaxis(np.tensordot(C, X, 1), 0, 1)
        return values

    def with_slope(self, omega: float) -> tuple[np.ndarray, np.ndarray]:
        """M and dM/d omega (n_z, n_w) at omega [rad/s]; infinity gives D and zero."""
        if np.isinf(omega):
            return self.D + 0j, np.zeros_like(self.D)
        values, slopes = self._sums(np.array([omega]), 1, 2)
        return self.D + values[0], -1j * slopes[0]

    def _sums(self, omega: np.ndarray, first: int, count: int = 1) -> Iterator[np.ndarray]:
        """The sums of R_k / (j omega - p_k)^power, (w, n_z, n_w) each, for ``count`` powers from
        ``first``.
        """
        # factor: 1 / (s - p_k), (w, k); sides: (s I - A)^-power B of every cluster, from B on
        s = 1j * omega
        factor = 1 / (s[:, None] - self.poles)
        flat = self.residues.reshape(len(self.poles), self.D.size)
        sides = [
            np.repeat(B[:, None, :].astype(complex), len(s), axis=1) for _, B, _ in self.clusters
        ]

        # one division, one solution of a shifted system more for every power
        part = factor
        for power in range(1, first + count):
            part = part * factor if power > 1 else part
            for (A, _, _), X in zip(self.clusters, sides, strict=True):
                solve_shifted(A, X, s)
            if power >= first:
                values = (part @ flat).reshape(len(s), *self.D.shape)
                for (_, _, C), X in zip(self.clusters, sides, strict=True):
                    values += np.moveaxis(np.tensordot(C, X, 1), 0, 1)
                yield values

    def distance(self, low: np.ndarray, high: np.ndarray, cells: int) -> np.ndarray:
        """Bound (c, n_z, n_w) on the entries of |M - chord| over each interval [low, high] (c,)
        [rad/s], cut into ``cells`` of one width with a chord each; of |M - D| where high is
        infinite. Infinite where one is too wide for its clusters.
        """
        bound = np.empty((len(low), *self.D.shape))
        end = np.isinf(high)
        bound[end] = self._tail(low[end])
        low, high = low[~end], high[~end]

        # d_k of the docstring: from p_k to the segment j [low, high]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        beside = np.maximum(np.abs(middle[:, None] - self.poles.imag) - half[:, None], 0.0)
        near = np.hypot(self.poles.real, beside)

        # |M''| <= sum_i (i + 1)(i + 2) |sum_k R_k / (j middle - p_k)^(i + 3)| half^i, i < _TERMS,
        # as M^(i + 2) / i! = (-j)^(i + 2) (i + 1)(i + 2) sum_k R_k / (s - p_k)^(i + 3). The
        # remainder is the term i = _TERMS with |R_k| / d_k^(_TERMS + 3).
        last = _TERMS + 3
        rest = (near**-last @ np.abs(self.residues).reshape(len(self.poles), self.D.size)).reshape(
            len(low), *self.D.shape
        )
        for A, B, C in self.clusters:
            rest = rest + _cluster(A, B, C, middle, half, last)
        bend = (_TERMS + 1) * (_TERMS + 2) * half[:, None, None] ** _TERMS * rest
        for i, term in enumerate(self._sums(middle, 3, _TERMS)):
            bend += (i + 1) * (i + 2) * half[:, None, None] ** i * np.abs(term)

        # (b - a)^2 / 8 max |M''| for a chord of width 2 half / cells
        bound[~end] = (2 * half[:, None, None] / cells) ** 2 / 8 * bend
        return bound

    def _tail(self, low: np.ndarray) -> np.ndarray:
        """Bound (c, n_z, n_w) on |M - D| above each frequency low (c,) [rad/s]."""
        # |M - D| <= sum |R_k| / |s - p_k|, from the nearest s above low
        near = np.hypot(self.poles.real, np.maximum(low[:, None] - np.abs(self.poles.imag), 0.0))
        bound = (1 / near @ np.abs(self.residues).reshape(len(self.poles), self.D.size)).reshape(
            len(low), *self.D.shape
        )
        for A, B, C in self.clusters:
            # |(s I - A)^-1| <= 1 / (|s| - |A|)
            beyond = np.maximum(low - np.linalg.norm(A, 2), 0.0)[:, None, None]
            outside = np.linalg.norm(C, axis=1)[:, None] * np.linalg.norm(B, axis=0)
            bound = bound + np.divide(
                outside, beyond, out=np.full_like(bound, np.inf), where=beyond > 0
            )
        return np.asarray(bound)


@dataclass(frozen=True, slots=True, eq=False)
class ChordsBetween:
    """left M right of constant matrices: what is summed over the poles is M, however often its
    entries occur.
    """

    model: Chords
    left: np.ndarray
    right: np.ndarray

    @property
    def D(self) -> np.ndarray:
        return np.asarray(self.left @ self.model.D @ self.right)

    @property
    def every_pole(self) -> np.ndarray:
        """As of M."""
        return self.model.every_pole

    def at(self, omega: np.ndarray) -> np.ndarray:
        """left M right (w, p, m) at omega (w,) [rad/s]; infinity gives that of D."""
        return np.asarray(self.left @ self.model.at(omega) @ self.right)

    def with_slope(self, omega: float) -> tuple[np.ndarray, np.ndarray]:
        """The same and d/d omega of it (p, m) at omega [rad/s]."""
        values, slopes = self.model.with_slope(omega)
        return self.left @ values @ self.right, self.left @ slopes @ self.right

    def distance(self, low: np.ndarray, high: np.ndarray, cells: int) -> np.ndarray:
        """As of M: |left (M - chord) right| <= |left| |M - chord| |right|, entry by entry."""
        # infinity beside a zero entry would be NaN
        bound = self.model.distance(low, high, cells)
        wide = ~np.isfinite(bound).all(axis=(1, 2))
        bound[wide] = 0.0
        moved = np.abs(self.left) @ bound @ np.abs(self.right)
        moved[wide] = np.inf
        return np.asarray(moved)


def _cluster(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, middle: np.ndarray, half: np.ndarray, power: int
) -> np.ndarray:
    """Bound on |C R^power B| within ``half`` of ``middle``: the smaller one of the coordinates
    given and of eigenvectors.
    """
    bound = _neumann(A, B, C, middle, half, power)
    V = np.linalg.eig(A)[1]
    if np.linalg.cond(V) < _CONDITION:
        inverse = np.linalg.inv(V)
        bound = np.minimum(
            bound, _neumann(inverse @ A @ V, inverse @ B, C @ V, middle, half, power)
        )
    return bound


def _neumann(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, middle: np.ndarray, half: np.ndarray, power: int
) -> np.ndarray:
    """R = R0 (I + j d R0)^-1 with R0 in the middle and |d| <= half."""
    # R here is R0; it commutes with (I + j d R0)^-1, whose norm is at most 1 / (1 - half |R0|):
    # |C R^power B| <= |C R0| |R0|^(power - 2) |R0 B| / (1 - half |R0|)^power.
    R = np.linalg.inv(1j * middle[:, None, None] * np.eye(len(A)) - A)
    size = np.linalg.norm(R, 2, axis=(1, 2))
    part = half * size
    grown = np.full(len(middle), np.inf)
    fits = part < 0.9
    grown[fits] = size[fits] ** (power - 2) / (1 - part[fits]) ** power
    inside = np.linalg.norm(C @ R, axis=2)[:, :, None] * np.linalg.norm(R @ B, axis=1)[:, None, :]

    # not zero: infinity times zero would be NaN
    return np.asarray(grown[:, None, None] * np.maximum(inside, np.finfo(float).tiny))


def chords(system: Any) -> Chords:
    """The chords of a stable continuous system. Raises InvalidInput for a sampled one,
    UnstableSystem.
    """
    system = as_statespace(system)
    if system.dt is not None:
        raise invalid(
            "the system", repr(system), "continuous", "give the one that it was sampled from"
        )
    response = modal_chords(system)
    if not (response.every_pole.real < 0).all():
        worst = response.every_pole.real.max()
        raise UnstableSystem(f"a pole has real part {worst:.4g} rad/s; close the loop stably first")
    return response


def modal_chords(system: StateSpace) -> Chords:
    """The response of a continuous system, stable or not: by its eigenvectors where they cost no
    more than four digits, else by its modal form with the widest separation that keeps them; one
    single cluster where there is none.
    """
    A, B, C, _ = balance_system(system.A, system.B, system.C)
    if system.n_states and (known := expansion(A, B, C)) is not None:
        p, R = known
        return Chords(system.D.astype(float), p + 0j, R.reshape(-1, *system.D.shape) + 0j, ())
    for growth in _GROWTH:
        try:
            modal = modal_form(system, growth)
        except NumericalFailure:
            continue
        return _residues(modal)

    # No transform keeps the digits: the whole system is one cluster, in real Schur form.
    nothing = np.zeros((0, *system.D.shape), complex)
    T, Q = sla.schur(A)
    return Chords(system.D.astype(float), np.zeros(0, complex), nothing, ((T, Q.T @ B, C @ Q),))


def _residues(modal: ModalForm) -> Chords:
    A = modal.system.A
    B = modal.system.B
    C = modal.system.C
    D = modal.system.D
    poles: list[complex] = []
    residues: list[np.ndarray] = []
    clusters = []
    for start, size in zip(modal.starts, modal.sizes, strict=True):
        i = slice(start, start + size)
        a = A[i, i]
        b = B[i]
        c = C[:, i]
        if size == 1:
            poles.append(complex(a[0, 0]))
            residues.append(c @ b + 0j)
        elif size == 2 and a[0, 0] == a[1, 1] and a[0, 1] * a[1, 0] < 0:
            # A = [[a, p], [q, a]] with p q < 0: poles a +- j beta, beta^2 = -p q
            p, q = a[0, 1], a[1, 0]
            beta = np.sqrt(-p) * np.sqrt(q) if q > 0 else np.sqrt(p) * np.sqrt(-q)
            # A v = (a + j beta) v, u A = (a + j beta) u
            v, u = np.array([p, 1j * beta]), np.array([q, 1j * beta])

            # R = C v u B / (u v), its conjugate at the other pole
            residue = np.outer(c @ v, u @ b) / (u @ v)
            poles += [complex(a[0, 0], beta), complex(a[0, 0], -beta)]
            residues += [residue, residue.conj()]
        else:
            clusters.append((a, b, c))
    stacked = np.array(residues, complex).reshape(-1, *D.shape)
    return Chords(D.astype(float), np.array(poles, complex), stacked, tuple(clusters))


_CELLS = 8  # chords per interval
_FINER = (1, 8, 64)  # how much finer the chords are made before an interval is halved
_EASY = 0.7  # size of the balanced matrix below which its scalings will do
_LEVEL = 1.05  # times its size at infinite frequency, where those of the centre are without bound
_FIRST = 12  # intervals per decade to begin with
# from the slowest pole times this to the fastest times that, then on to zero and infinity
_SPAN = 1e-3, 1e3
_ROUND = 400  # intervals tried together
# complex numbers of the vertices worked on together: memory that is not asked for anew every time
_HELD = 100_000
_HIGHEST = 1e25  # rad/s, above which the rest is not pushed any further out
_THINNEST = 1e-11  # relative width of an interval that is not halved any more
_TOLERANCE = 1e-3  # of a level at one frequency
_DIGITS = 1e-13  # relative, by which a product of three matrices is off at most
_FACTOR = 100.0  # by which a level is raised at most before it is given up


@dataclass(frozen=True, slots=True, eq=False)
class ProvedLevel:
    """mu < ``level`` at all frequencies; frequency [rad/s]: where it was raised last (NaN: never);
    intervals: how many.
    """

    level: float
    frequency: float
    intervals: int


@named_failure("the level proved for the structured singular value")
def proved_level(
    system: Any,
    blocks: Sequence[Block],
    start: float,
    *,
    skew: np.ndarray | None = None,
    room: float = 4e-3,
    highest: float = np.inf,
    omega: np.ndarray | None = None,
    max_intervals: int = 6_000,
) -> ProvedLevel:
    """The lowest level >= ``start`` found with mu(M(j omega)) < level proved for all omega,
    infinity included.

    system: M, stable and continuous, or its ``Chords``. skew (n_z,) bool: the rows of M that the
    level divides, so that the proof is of mu < 1 for what remains (None: all rows, which is mu <
    level itself). room: what a raised level is above the upper bound of mu there. highest: a level
    above it is not tried. omega (w,) [rad/s]: where to look first.

    Raises InvalidInput, and NumericalFailure where no level up to ``highest``, or 100 times
    ``start``, is proved.
    """
    structure = structure_of(blocks)
    model = system if isinstance(system, Chords | ChordsBetween) else chords(system)
    if model.D.shape != (structure.n_z, structure.n_w):
        raise invalid(
            "the shape of M",
            model.D.shape,
            f"{(structure.n_z, structure.n_w)}, as the blocks have it",
            "match them",
        )
    rows = np.ones(structure.n_z, bool) if skew is None else np.asarray(skew, bool)
    top = min(highest, _FACTOR * check_positive(start, "start", "give a level"))
    task = _Task(model, structure, rows, room, top, start)
    if omega is not None:
        task.lift(np.sort(omega))
    low, high = _intervals(model)
    tried = 0

    # A queue from low to high frequency; what is left of a round goes to its front.
    while len(low):
        now = (low[:_ROUND], high[:_ROUND])
        low = low[_ROUND:]
        high = high[_ROUND:]
        tried += len(now[0])
        if tried > max_intervals:
            raise NumericalFailure(
                f"{tried} intervals of frequency did not suffice for a proof at the level "
                f"{task.level:.4g}; {len(low)} are "
                f"open near {now[0][0]:.4g} rad/s: allow more, or a higher level"
            )
        remaining = task.attempt(*now)
        low, high = np.concatenate([remaining[0], low]), np.concatenate([remaining[1], high])
    return ProvedLevel(task.level, task.frequency, tried)


def proved_below(
    loop: Any, blocks: Sequence[Block], level: float, max_intervals: int = 6_000
) -> bool:
    """Whether mu(M(j omega)) < level was proved for all frequencies, infinity included; loop: M,
    continuous and stable.

    False where the proof ends in a numerical failure as well: it never takes with it what it was to
    prove something about. Complex uncertainty, or a block for the performance, must be among the
    blocks: with real ones alone the scalings grow without bound.
    """
    try:
        proved_level(loop, blocks, level, highest=level, max_intervals=max_intervals)
    except (
        NumericalFailure,
        UnstableSystem,
        np.linalg.LinAlgError,
    ):  # a proof that fails takes no result with it
        return False
    return True


def least_level(
    M: np.ndarray,
    structure: Structure,
    skew: np.ndarray,
    start: float,
    tolerance: float = _TOLERANCE,
) -> tuple[float, int]:
    """The smallest level found >= ``start`` with mu < 1 for all M (w, n_z, n_w) whose ``skew`` rows
    it divides, and which of them asks for it. Infinite where 100 times ``start`` does not suffice.
    """

    # Which of the M are not shown to have mu < 1: sigma_max of the balanced matrix first, the
    # scalings for the rest.
    def exceeds(part: np.ndarray, level: float) -> np.ndarray:
        scaled = _divided(part, skew, level)
        over = largest_gain(osborne(scaled, structure)[0]) >= 1 - tolerance / 10
        enough = np.full(int(over.sum()), 1 - tolerance / 10)  # whether mu < 1 is all that is asked
        over[over] = (
            upper_bound(scaled[over], structure, level=enough, tolerance=tolerance / 10).value >= 1
        )
        return over

    # Up from the start by growing factors; what holds at one level holds at every higher one and
    # need not be looked at again.
    low = start
    high = start * (1 + tolerance)
    step = 1 + tolerance
    active, which = M, np.arange(len(M))
    while True:
        left = exceeds(active, high)
        if not left.any():
            break
        active = active[left]
        which = which[left]
        low = high
        step = step**2
        high *= step
        if high > _FACTOR * start:
            return np.inf, int(which[0])

    # Bisection of log level.
    while high / low > 1 + tolerance:
        middle = np.sqrt(low * high)
        left = exceeds(active, middle)
        if left.any():
            active = active[left]
            which = which[left]
            low = middle
        else:
            high = middle
    return float(high), int(which[0])


def _divided(M: np.ndarray, skew: np.ndarray, level: float) -> np.ndarray:
    return M / np.where(skew, level, 1.0)[:, None]


def _intervals(model: Chords | ChordsBetween) -> tuple[np.ndarray, np.ndarray]:
    """The intervals to begin with, low and high (c,), from 0 to infinity; finer next to poles of
    little damping.
    """
    every = model.every_pole
    if not every.size:
        return np.array([0.0]), np.array([np.inf])
    slow, fast = np.abs(every).min() * _SPAN[0], np.abs(every).max() * _SPAN[1]
    net = np.geomspace(slow, fast, int(_FIRST * np.log10(fast / slow)) + 2)

    # Poles of a damping ratio below 0.3: points up to three half-widths beside the resonance.
    light = every[(every.imag > 0) & (-every.real < 0.3 * np.abs(every))]
    beside = light.imag[:, None] + light.real[:, None] * np.array([-3.0, -1.0, 1.0, 3.0])
    net = np.unique(np.concatenate([[0.0], net, beside[beside > 0], [np.inf]]))

    # points apart by rounding alone count once
    net = net[np.append(~(np.diff(net) <= 1e-9 * net[:-1]), True)]
    return net[:-1], net[1:]


@dataclass(slots=True, eq=False)
class _Task:
    """What is proved, and how far the level had to be raised."""

    model: Chords | ChordsBetween
    structure: Structure
    skew: np.ndarray
    room: float
    highest: float
    level: float
    frequency: float = float("nan")

    def lift(self, omega: np.ndarray) -> None:
        """Raise the level until the upper bound is below it at omega (w,), with room. Raises
        NumericalFailure.
        """
        lifted, i = least_level(
            self.model.at(omega), self.structure, self.skew, self.level / (1 + self.room)
        )
        self.raised(lifted * (1 + self.room), float(omega[i]))

    def raised(self, level: float, frequency: float) -> None:
        if level > self.highest * (1 + 1e-12):
            raise NumericalFailure(
                f"the structured singular value is not proved below {self.highest:.4g}: its bound "
                f"at {frequency:.4g} rad/s is "
                f"{level:.4g}; shrink the uncertainty, or allow a higher level"
            )
        if level > self.level:
            self.level, self.frequency = level, frequency

    def attempt(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Try the intervals; what remains of them, (low, high)."""
        # Scalings with room in the middle of each interval, at the lower end of the one that ends
        # at infinity: those of D itself may be without bound, where it is zero but for the gain.
        end = np.isinf(high)
        middle = 0.5 * (low + np.where(end, low, high))
        at_infinity = _divided(self.model.D[None], self.skew, self.level)
        last = float(largest_gain(osborne(at_infinity, self.structure)[0])[0])
        scalings, holds = _scalings(
            _divided(self.model.at(middle), self.skew, self.level),
            self.structure,
            max(_EASY, min(_LEVEL * last, (1 + last) / 2)),
        )
        good = np.zeros((len(low), _CELLS), bool)
        left = np.flatnonzero(holds)
        # what is near the edge with so many chords may be well inside with more
        for finer in _FINER:
            part = scalings.part(left)
            fine = self._contained(part, low[left], high[left], _CELLS * finer)
            good[left] |= fine.reshape(len(left), _CELLS, finer).all(axis=2)
            left = left[~good[left].all(axis=1)]
            if not len(left):
                break

        # No scalings at all in the middle: mu may reach the level there.
        if not holds.all():
            self.lift_at(middle[~holds])
        return self._rest(low, high, good)

    def _contained(
        self, bound: UpperBound, low: np.ndarray, high: np.ndarray, cells: int
    ) -> np.ndarray:
        """Which of the equal cells (i, cells) of the intervals the scalings prove, a few intervals
        at a time.
        """
        step = max(1, _HELD // (cells * self.model.D.size))
        if len(low) > step:
            parts = [np.arange(i, min(i + step, len(low))) for i in range(0, len(low), step)]
            return np.concatenate(
                [self._contained(bound.part(part), low[part], high[part], cells) for part in parts]
            )

        # The vertices of the chords; towards infinity all are D, and the distance is that from D.
        end = np.isinf(high)
        points = low[:, None] + (np.where(end, low, high) - low)[:, None] * np.linspace(
            0.0, 1.0, cells + 1
        )
        points[end] = np.inf
        M = self.model.at(points.ravel()).reshape(*points.shape, *self.model.D.shape)
        slack = self.model.distance(low, high, cells)
        return _contained(
            bound, *(_divided(part, self.skew, self.level) for part in (M, slack[:, None]))
        )

    def lift_at(self, omega: np.ndarray) -> None:
        """The bound reaches the level at omega: raise it there, and by the room at least."""
        M = self.model.at(omega)

        # All rows divided by the level: mu < level, which one bound gives; else a search for the
        # level.
        if self.skew.all():
            values = upper_bound(M, self.structure, tolerance=_TOLERANCE / 4).value
            lifted, i = max(float(values.max()), self.level), int(values.argmax())
        else:
            lifted, i = least_level(M, self.structure, self.skew, self.level)
        self.raised(lifted * (1 + self.room), float(omega[i]))

    def _rest(
        self, low: np.ndarray, high: np.ndarray, good: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The parts that are not proved yet: runs of open cells; an interval of which all is open
        is halved.
        """
        new_low, new_high = [], []
        for i in np.flatnonzero(~good.all(axis=1)):
            # The last interval: a finite part of two octaves comes off.
            if np.isinf(high[i]):
                if low[i] > _HIGHEST:
                    raise NumericalFailure(
                        f"the level {self.level:.6g} is not proved towards infinite frequency: "
                        "the direct term reaches it; "
                        "allow a higher level"
                    )
                new_low += [low[i], 4 * max(low[i], 1e-300)]
                new_high += [4 * max(low[i], 1e-300), np.inf]
                continue
            if high[i] - low[i] < _THINNEST * high[i]:
                raise NumericalFailure(
                    f"no scalings prove the level {self.level:.6g} on any interval around "
                    f"{low[i]:.6g} rad/s: the bound is "
                    "reached there within rounding; allow a higher level"
                )

            # Runs of neighbouring open cells, each an interval of its own.
            cells = np.flatnonzero(~good[i])
            runs = np.split(cells, np.flatnonzero(np.diff(cells) > 1) + 1)
            if len(cells) == _CELLS:
                runs = [cells[: _CELLS // 2], cells[_CELLS // 2 :]]
            width = (high[i] - low[i]) / _CELLS
            new_low += [low[i] + width * run[0] for run in runs]
            new_high += [
                low[i] + width * (run[-1] + 1) if run[-1] + 1 < _CELLS else high[i] for run in runs
            ]
        return np.array(new_low), np.array(new_high)


def _scalings(
    M: np.ndarray, structure: Structure, easy: float = _EASY
) -> tuple[UpperBound, np.ndarray]:
    """Scalings with room at M (i, n_z, n_w), those of the balanced matrix where its size is below
    ``easy``, and whether they prove mu < 1.
    """
    # Those of the balanced matrix: X = diag(d^2), G = 0.
    balanced, d_z, d_w = osborne(M, structure)
    value = largest_gain(balanced)
    X_w, X_z = (np.einsum("bi,ij->bij", d**2, np.eye(d.shape[1])) + 0j for d in (d_w, d_z))
    G = np.zeros((len(M), structure.n_w, structure.n_z), complex)

    # Too near the edge: the analytic centre at level 1, which has most room.
    hard = np.flatnonzero(value >= easy)
    if len(hard):
        bound = upper_bound(M[hard], structure, level=np.ones(len(hard)), max_iterations=60)
        value[hard] = bound.value
        X_w[hard] = bound.X_w
        X_z[hard] = bound.X_z
        G[hard] = bound.G
    holds = (value < 1) & positive_definite(X_w) & positive_definite(X_z)  # after scaling back
    return UpperBound(value, X_w, X_z, G, np.zeros((len(M), structure.n_w))), holds


def _contained(bound: UpperBound, M: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Which cells (i, c) the scalings prove, for vertices M (i, c + 1, n_z, n_w) and distances from
    the chords ``slack``.
    """
    # X = L L^H, N = L_z^H M L_w^-H, G := L_w^-1 G L_z^-H: the inequality becomes Phi < I,
    # Phi = N^H N + j (G N - N^H G^H) = (N - j G^H)^H (N - j G^H) - G G^H.
    L_w, L_z = np.linalg.cholesky(bound.X_w), np.linalg.cholesky(bound.X_z)
    right, left = np.linalg.inv(L_w).conj().swapaxes(1, 2), L_z.conj().swapaxes(1, 2)
    G = np.linalg.inv(L_w) @ bound.G @ np.linalg.inv(L_z).conj().swapaxes(1, 2)
    N = _times(right, _times(left, M), behind=True)
    shifted = N - 1j * G.conj().swapaxes(1, 2)[:, None]
    cross = _times(1j * G, N)
    Phi = N.conj().swapaxes(2, 3) @ N + cross + cross.conj().swapaxes(2, 3)

    # How far N can lie from its chord, entry by entry: |L_z^H| slack |L_w^-H|. An infinite slack
    # proves nothing; it is set to 0 here and to infinity at the end.
    wide = ~np.isfinite(slack).all(axis=(2, 3))
    moved = (
        np.abs(left)[:, None] @ np.where(wide[..., None, None], 0.0, slack) @ np.abs(right)[:, None]
    )
    # Phi moves by (N - j G^H)^H F + its conjugate + F^H F for every F that is no larger than
    # ``moved``, entry by entry
    reach = (
        2 * np.linalg.norm(np.abs(shifted).swapaxes(2, 3) @ moved, axis=(2, 3))
        + np.linalg.norm(moved, axis=(2, 3)) ** 2
    )

    edge = np.linalg.norm(Phi, axis=(2, 3))  # no eigenvalue is larger, nor lower than its negative
    rest = reach + _rounding(bound, L_w, L_z, M)[:, None]

    # Eigenvalues only where the norm neither proves Phi + rest < 1 nor rules it out.
    open_still = (rest + edge >= 1) & (rest - edge < 1)
    edge[open_still] = np.linalg.eigvalsh(Phi[open_still])[:, -1]
    edge += rest
    edge[np.broadcast_to(wide, edge.shape)] = np.inf

    # Phi < I is a convex set: if both vertices stay in it with every F added, so does what lies
    # between them, and M with it.
    return np.asarray(np.maximum(edge[:, :-1], edge[:, 1:]) < 1)


def _times(L: np.ndarray, M: np.ndarray, *, behind: bool = False) -> np.ndarray:
    """L M, or M L, for L (i, n, k) and M (i, c, k, m): row by row, or column by column, where L is
    diagonal, as it is for blocks of one channel or a full one.
    """
    n, k = L.shape[1:]
    if n != k or L[:, ~np.eye(n, dtype=bool)].any():
        return M @ L[:, None] if behind else L[:, None] @ M
    d = np.einsum("ijj->ij", L)[:, None]
    return np.asarray(M * d[:, :, None] if behind else d[..., None] * M)


def _rounding(bound: UpperBound, L_w: np.ndarray, L_z: np.ndarray, M: np.ndarray) -> np.ndarray:
    """What rounding can add to the eigenvalues of Phi - I (i,), at all vertices
    M (i, c + 1, n_z, n_w) of an interval alike.

    G may be as large as it likes where N is small along it, as that of a parameter which hardly
    matters is: what rounding makes of G N goes with |G| |N|, not with |G|^2.
    """
    back_w, back_z = (np.abs(np.linalg.inv(L)) for L in (L_w, L_z))
    largest = np.abs(M).max(axis=1)

    # a product is off by _DIGITS of the product of the moduli: n >= |N|, g >= |G| hold those of
    # N = L_z^H M L_w^-H and G = L_w^-1 G L_z^-H, and one >= 1 those of L^-1 L = I
    n, g, *ones = (
        np.linalg.norm(moduli, axis=(1, 2))
        for moduli in (
            np.abs(L_z).swapaxes(1, 2) @ largest @ back_w.swapaxes(1, 2),
            back_w @ np.abs(bound.G) @ back_z.swapaxes(1, 2),
            back_w @ np.abs(L_w),
            back_z @ np.abs(L_z),
        )
    )
    one = np.maximum(*ones)

    # N^H N: both factors, X_z = L_z L_z^H, the product. G N and its conjugate: both factors, the
    # product, L_z^-H L_z^H between them. I for L_w^-1 X_w L_w^-H: L_w^-1 L_w twice, and the L_w
    # that stands for X_w.
    return np.asarray(_DIGITS * (4 * n**2 + 2 * (3 + one) * g * n + 3 * one**2))
