"""The proof for a sampled loop whose matrices follow a slow parameter: bounded-real functions of
the loop at rest, joined.

The loop goes from sample to sample, x+ = A(p) x + B(p) d, y = C x + d, and p moves by at most rate
dt in a sample of dt. At knots of p the loop that decays by e^(-decay dt) less has its own X with

    e^(decay dt) x+^T X x+ - x^T X x + |y|^2 - gamma^2 |d|^2 <= 0

(bounded real lemma), and between them X(p) is linear. V = x^T X(p) x then falls by what gamma asks
for along every motion if X(p+) <= (1 + growth) X(p) for all that p does in a sample, and

    (1 + growth) x+^T X x+ - x^T X x + |y|^2 - gamma^2 |d|^2 < 0

holds between knots. The first is an inequality in X alone. In the second (A, B) is a parabola, so
that its left side is a polynomial of the fifth degree: it is negative on the whole interval if
every entry of its Bernstein net is, with room for what is measured of (A, B) besides: what the
parabola leaves, and any other deviation. Nothing that was found is taken on trust: both are checked
by eigenvalues, and an interval on which they fail is halved. Slow motions: Desoer 1969, IEEE Trans.
Autom. Control 14; the function: Wu, Yang, Packard & Becker 1996, Int. J. Robust Nonlinear Control
6.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import comb

import numpy as np
import scipy.linalg as sla

from ambrose.annexes.scheduled.varying_cells import accurate_product
from ambrose.annexes.scheduled.varying_proof import Proof
from ambrose.core.checks import NumericalFailure
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, balance_matrix as balance, is_stable

# of gamma, above the largest of the loops at rest that decay less
_ROOMS = (3e-3, 1e-2, 3e-2, 0.1, 0.3)
_FIRST = 96  # intervals to begin with
_HALVINGS = 2
_REST = 25  # values at which the loop at rest is looked at first
_LEAST = 0.1  # of the slowest decay at rest: what the functions are given at least
_ROUNDS = 6
_SHOWN = 0.1  # of the decay, as cost of the states themselves
_EASE = 2.0  # of the decay, beyond what the motion was found to need
_REMEDY = "a smaller range or a slower motion help"


@dataclass(frozen=True, slots=True, eq=False)
class SampledLoop:
    """The loop at one p: A (n, n) and B (n, q) from sample to sample; C (q, n); dt [s].

    at: p -> [A, B] (n, n + q); beside: (low, high) -> what else [A, B] may be off between two p,
    arrays (k, n, n + q) of which the largest counts, and the arrays add up.
    """

    at: Callable[[float], np.ndarray]
    beside: Callable[[float, float], Sequence[np.ndarray]]
    C: np.ndarray
    dt: float

    def system(self, p: float, decay: float = 0.0) -> StateSpace:
        """d -> y at rest; with a ``decay`` [1/s] it decays by that less."""
        n = self.C.shape[1]
        M = self.at(p) * np.exp(decay * self.dt / 2)
        return StateSpace(M[:, :n], M[:, n:], self.C, np.eye(len(self.C)), dt=self.dt)


@dataclass(frozen=True, slots=True, eq=False)
class _Knot:
    """At a p: [A, B] and X in the proof's states."""

    M: np.ndarray
    X: np.ndarray


def _function(loop: StateSpace, gamma: float, more: float = 0.0) -> np.ndarray:
    """X of the sampled loop at rest, with more |x|^2 in the cost. Raises NumericalFailure where
    gamma is too small.
    """
    # The continuous loop with the same X: x' = x+ - x, and x the mean of both (bilinear map).
    # The cost of the states as further outputs: else what the next sample no longer shows has no
    # room.
    A, B = loop.A, loop.B
    n, q = loop.n_states, len(loop.D)
    C = np.vstack([loop.C, np.sqrt(more) * np.eye(n)])
    D = np.vstack([loop.D, np.zeros((n, q))])
    mean = np.linalg.inv(np.eye(len(A)) + A)
    A, B = 2 * mean @ (A - np.eye(len(A))), 2 * mean @ B
    C, D = C - C @ A / 2, D - C @ B / 2

    # A^T X + X A + C^T C + (X B + C^T D) R^-1 (..)^T = 0, R = gamma^2 I - D^T D
    A, t = balance(A)
    B, C = B / t[:, None], C * t
    R = gamma**2 * np.eye(q) - D.T @ D
    inner = np.linalg.solve(R, D.T @ C)
    try:
        if np.linalg.eigvalsh(R)[0] <= 0:
            raise NumericalFailure("gamma is below the gain at half the rate")
        X = sla.solve_continuous_are(A + B @ inner, B, C.T @ C + C.T @ D @ inner, -R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise NumericalFailure("a loop at rest has no bounded-real function") from error
    return (X + X.T) / 2 / t / t[:, None]


def _net(M: Sequence[np.ndarray], X: Sequence[np.ndarray], share: float) -> list[np.ndarray]:
    """The Bernstein net, of degree 5, of share M^T X M - [X, 0; 0, 0] over an interval on which M
    has a net of three and X one of two.
    """
    width, n = M[0].shape[1], len(X[0])
    found = [np.zeros((width, width)) for _ in range(6)]
    for (i, left), (j, right), (k, middle) in product(*map(enumerate, (M, M, X))):
        # B_i^2 B_j^2 B_k^1 = C(2, i) C(2, j) C(1, k)/C(5, i + j + k) B_(i + j + k)^5
        weight = share * comb(2, i) * comb(2, j) / comb(5, i + j + k)
        found[i + j + k] += weight * left.T @ middle @ right
    # what is linear has the values at i/5 as its net of this degree
    for i, form in enumerate(found):
        form[:n, :n] -= (1 - i / 5) * X[0] + i / 5 * X[1]
    return [(form + form.T) / 2 for form in found]


class _Search:
    """Knots in states in which the middle loop's own X is I, and the checks between them."""

    def __init__(self, loop: SampledLoop, low: float, high: float, rate: float) -> None:
        self.loop = loop
        self.step = rate * loop.dt
        self.ends = (low, high)
        self.n = loop.C.shape[1]
        self.rounding, self.needed = 0.0, 0.0

    def settle(self, gamma: float, decay: float) -> None:
        """The states, for a gamma: X = I of the loop in the middle."""
        self.gamma, self.decay = gamma, decay
        X = _function(self.loop.system(sum(self.ends) / 2, decay), gamma)
        size = np.sqrt(np.maximum(np.diag(X), 1e-300))
        values, V = np.linalg.eigh(X / size / size[:, None])
        root = np.sqrt(np.maximum(values, 1e-13 * values.max()))
        self.T, self.inverse = V / root / size[:, None], (V * root).T * size
        exact, rest = accurate_product(self.loop.C, self.T)
        self.C = exact + rest

        # the inverse is that of T but for F: T^-1 = (I - F) inverse, F^2 left out
        high, low = accurate_product(self.inverse, self.T)
        self.F = high - np.eye(self.n) + low
        self.skew = float(np.linalg.norm(self.F, 2)) ** 2 + self.n * np.finfo(float).eps

    def turned(self, M: np.ndarray) -> np.ndarray:
        """[A, B] (.., n, n + q) in these states."""
        n = self.n
        high, low = accurate_product(M[..., :n], self.T)
        A, rest = accurate_product(self.inverse, high)
        B = sum(accurate_product(self.inverse, M[..., n:]))
        found = np.concatenate([A + (rest + self.inverse @ low), B], axis=-1)
        return found - self.F @ found

    def knot(self, p: float) -> _Knot:
        M = self.turned(self.loop.at(p))
        q, scale = len(self.C), np.exp(self.decay * self.loop.dt / 2)
        loop = StateSpace(
            M[:, : self.n] * scale, M[:, self.n :] * scale, self.C, np.eye(q), dt=self.loop.dt
        )
        return _Knot(M, _function(loop, self.gamma, _SHOWN * self.decay * self.loop.dt))

    def growth(self, X: np.ndarray, slopes: list[np.ndarray]) -> float:
        """By how much X grows in a sample at most, as a share of itself."""
        # |eig(S, X)| = |R^-T S R^-1| with X = R^T R
        unit = sla.solve_triangular(np.linalg.cholesky(X).T, np.eye(self.n))
        return self.step * max(float(np.linalg.norm(unit.T @ S @ unit, 2)) for S in slopes)

    def room(self, low: float, high: float, ends: tuple[_Knot, _Knot], growth: float) -> float:
        """By how much the inequality holds between two knots, less the bound of its rounding, in
        states in which X of the end is I.
        """
        a, b = ends
        q, n = len(self.C), self.n
        eps = float(np.finfo(float).eps)
        quarters = [self.turned(self.loop.at(low + s * (high - low))) for s in (0.25, 0.5, 0.75)]

        # the parabola through ends and middle, M_0 + M_1 - 2 M_m = its bend; what it leaves at the
        # quarters is of a cubic the most but for 3 %, and counts twice
        net = (a.M, 2 * quarters[1] - (a.M + b.M) / 2, b.M)
        left = [
            M - ((1 - s) ** 2 * net[0] + 2 * s * (1 - s) * net[1] + s**2 * net[2])
            for s, M in ((0.25, quarters[0]), (0.75, quarters[2]))
        ]
        causes = [2 * np.array(left), *map(self.turned, self.loop.beside(low, high))]

        # X in the middle is R^T R, x = R^-1 x'
        R = np.linalg.cholesky((a.X + b.X) / 2).T
        unit = np.eye(n + q)
        unit[:n, :n] = sla.solve_triangular(R, np.eye(n))
        turn = unit[:n, :n]
        X = [turn.T @ item.X @ turn for item in ends]
        after = [R @ M @ unit for M in net]
        seen = np.hstack([self.C @ turn, np.eye(q)])
        forms = _net(after, X, 1 + growth)
        still = seen.T @ seen - np.diag(np.repeat([0.0, self.gamma**2], [n, q]))
        worst = -max(float(np.linalg.eigvalsh(form + still)[-1]) for form in forms)

        # |x+ + e v|^2 <= |x+|^2 + (2 |x+| + e) e |v|^2, in states in which X(p) <= most I
        off = sum(float(np.linalg.norm(R @ c @ unit, 2, axis=(1, 2)).max()) for c in causes)
        off += 4 * self.skew * float(np.linalg.norm(R, 2) * np.linalg.norm(turn, 2))
        most = max(float(np.linalg.norm(item, 2)) for item in X)
        size = max(float(np.linalg.norm(item, 2)) for item in after)
        beside = (1 + growth) * most * (2 * size + off) * off
        rounding = (
            8
            * (n + q)
            * eps
            * (most * (2 + size) ** 2 + float(np.linalg.norm(seen, 2)) ** 2 + self.gamma**2)
        )
        self.rounding = max(self.rounding, rounding)
        return worst - beside - rounding

    def held(self) -> float | None:
        """The room with which the inequality holds everywhere; None where it does not. ``needed``
        is the decay that the motion asks for.
        """
        self.rounding, self.needed = 0.0, 0.0
        knots = {float(p): self.knot(float(p)) for p in np.linspace(*self.ends, _FIRST + 1)}
        room: dict[tuple[float, float], tuple[float, float]] = {}
        for left in range(_HALVINGS, -1, -1):
            p = sorted(knots)
            pairs = list(pairwise(p))
            slopes = [(knots[b].X - knots[a].X) / (b - a) for a, b in pairs]
            if self.step > min(np.diff(p)):
                raise NumericalFailure(
                    f"the parameter moves through its range in a few samples; {_REMEDY}"
                )
            # within a sample p may be on the interval before or after
            growths = [
                max(self.growth(knots[end].X, slopes[max(0, k - 1) : k + 2]) for end in pair)
                for k, pair in enumerate(pairs)
            ]
            self.needed = float(np.log1p(max(growths)) / self.loop.dt)
            if self.needed > self.decay:
                return None

            # what held with as much growth holds still
            for pair, growth in zip(pairs, growths, strict=True):
                if growth > room.get(pair, (0.0, -1.0))[1]:
                    both = (knots[pair[0]], knots[pair[1]])
                    room[pair] = (self.room(*pair, both, growth), growth)
            failed = [pair for pair in pairs if not room[pair][0] > 0]
            if not failed:
                return min(room[pair][0] for pair in pairs)
            # where most fail a larger gamma is the remedy, not more knots
            if 2 * len(failed) > len(pairs):
                return None
            if left:
                knots |= {middle: self.knot(middle) for middle in (sum(f) / 2 for f in failed)}
        return None


def proved_sampled(
    loop: SampledLoop,
    low: float,
    high: float,
    rate: float,
    *,
    tell: Callable[[str], None] = lambda text: None,
) -> Proof:
    """A gamma above the gain from d to y along every motion of p between low and high with |p'| <=
    rate [1/s], close to the smallest one of this kind.

    X of the proof: in the states given, in the middle. Raises NumericalFailure where none is found.
    """
    search = _Search(loop, low, high, rate)
    values = np.linspace(low, high, _REST)
    systems = [loop.system(p) for p in values]
    unstable = [p for p, item in zip(values, systems, strict=True) if not is_stable(item)]
    if unstable:
        raise NumericalFailure(f"the loop is unstable at rest at {unstable[0]:.6g}")

    # the decay that a motion asks for, found with ample room
    radius = max(np.abs(np.linalg.eigvals(item.A)).max() for item in systems)
    decay = max(rate / (high - low), -_LEAST * float(np.log(radius)) / loop.dt)
    for _ in range(_ROUNDS):
        slower = [loop.system(p, decay) for p in values]
        if not all(is_stable(item) for item in slower):
            raise NumericalFailure(
                f"the motion requires a decay of {decay:.3g} 1/s, more than the loop has; {_REMEDY}"
            )
        least = max(hinf_norm(item).value for item in slower)
        for room in _ROOMS:
            try:
                search.settle(least * (1 + room), decay)
                found = search.held()
            except NumericalFailure as error:
                tell(f"not proved at {least * (1 + room):.4f}: {error}")
                continue
            tell(
                f"gain {'' if found else 'not '}below {search.gamma:.4f}: the motion requires a "
                f"decay of {search.needed:.3g} of {decay:.3g} 1/s"
            )
            if found:
                X = search.inverse.T @ search.knot((low + high) / 2).X @ search.inverse
                return Proof(search.gamma, X, found, search.rounding)
            if search.needed > decay:
                break
        else:
            break
        decay = max(_EASE * search.needed, 2 * decay)
    raise NumericalFailure(f"no function of the loops at rest proves the loop; {_REMEDY}")
