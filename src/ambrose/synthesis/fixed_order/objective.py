"""What tuning minimises: the p-norm of all ratios of a value to its limit, over channels,
frequencies, models and poles. It is smooth; Apkarian & Noll 2006 work with the subgradients of its
limit, the largest ratio.

x (k,): the free numbers of the controller Theta = [[D, C], [B, A]], (a + n, a + n), of n states,
K (a, a) [A/m]; G (a, a) [m/A]: u -> y of a model; lambda: closed-loop poles [rad/s] (of a sampled
loop in w, see ``channels``). With the ratios rho,

    f = (1/p) ln sum rho^p                                                                  (1)
    S_o = (I + G K)^-1,  Q = K S_o,  H = S_o G,  S_i = I - Q G:
    dQ = S_i dK S_o,  dS_o = -H dK S_o,  dH = -H dK H                                       (2)
    of a channel T = A - B Q C, or S_o or Q, rows over their limits: rho its singular values,
    sum sigma^p = tr (T* T)^(p/2),  d(sum sigma^p)/p = Re tr((T* T)^(p/2 - 1) T* dT)        (3)
    K = D + C X,  X = (sI - A)^-1 B,  Y = C (sI - A)^-1:  dK = dD + dC X + Y dB + Y dA X    (4)
    of settling: rho = (|y(t)| / band)^0.4,  y(t) = Re sum_w weight(t, w) H(w)              (5)
    of a pole: rho = required zeta / zeta,  zeta = -Re lambda / |lambda|                    (6)
    A_loop = diag(A_plant, 0) + into (I - Theta outer)^-1 Theta out                         (7)
    dlambda = w dA_loop v,  w and v left and right eigenvectors with w v = 1                (8)
    of a reference: rho = rms of ln|k/k_ref| of the direct gains / match                    (9)
    with a fence R: f - 0.02 sum ln(1 - |lambda_K|^2 / R^2) over the controller's poles     (10)
    for a start that is not stable: f = (1/p) ln sum exp(p Re lambda / scale)               (11)

The slopes of all channels are added up in one matrix per frequency, df = Re tr(psi* dK), before
(4) is used. Between two calls of ``narrow`` only what counts is computed: with c columns
|T|_F / sqrt(c) <= sigma_max <= |T|_F and sum sigma^p <= |T|_F^p                            (12).
Poles of a plant's modes above half the sample rate (core/aliasing.py) stand in w at frequencies
that are not theirs: they must be stable and have no damping ratio there.

Tests by these numbers: tests/synthesis/fixed_order/test_objective.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ambrose.core.aliasing import FastModes, logarithm
from ambrose.core.checks import memberwise
from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.statespace import StateSpace
from ambrose.model.static_load import needed_damping, runs_within
from ambrose.synthesis.fixed_order.bank import FilterBank
from ambrose.synthesis.fixed_order.channels import (
    DAMPING_GUARD,
    FALLS,
    MARGIN,
    S_O,
    SENSITIVITY_GUARD,
    SETTLING_POWER,
    Aims,
    Channel,
    LoopModel,
    Scaled,
    Settling,
    channels_of,
    unwarped,
    warped,
)
from ambrose.synthesis.fixed_order.structure import Structure
from ambrose.synthesis.hinf import BAND

# Which models and frequencies count in the p-norm of the channels: the others are left out of an
# evaluation.
#
# Near a controller most pairs of model and frequency stay far below the largest ratio, and to the
# power p they add nothing. What counts is gathered once and holds for a few steps of a descent
# (Apkarian & Noll 2006 work with the active frequencies likewise).


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
    """The pairs of model and frequency that count, ordered by frequency.

    G (p, a, a): u -> y there. omega (p,): index of the pair's frequency. distinct (d,): indices of
    the frequencies that occur, starts (d,): their first pairs. parts: the channels at their pairs.
    slow (s,): models whose settling counts; timed (w, s): their pairs. driven (q,): the pairs of
    channels that are made of Q.
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
    """The pairs that count. G (m, w, a, a); masks: of every channel (m, its frequencies), True
    where the pair counts; slow (s,): models whose settling counts.
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


_IGNORED = 1e-7  # share of the sum in (1) that may be left out, all terms together
# where it grew to the first share, the descent goes back and leaves out the second times as much,
# unless f of everything fell by _FAR
_GROWN, _FINER = 1e-2, 1e-3
_FAR = float(np.log(1.25))
_TOGETHER = 200  # matrices (T* T) multiplied at a time
_NOTHING = 1e-5  # share of the sum below which a pole's slope is left out
_APART = 1e6  # condition number of eigenvectors above which a resolvent loses too many digits
_COINCIDE = 1e14  # condition number above which eigenvectors have no inverse
_RINGING = 0.7  # imaginary part over modulus above which a pole is held to a damping ratio
_WATCHED = 20.0  # times the damping asked for: better damped poles are left out
_MATCHED = np.geomspace(max(BAND[0], 2 * np.pi), BAND[1], 30)  # rad/s
_BARRIER = 0.02  # of the controller's own poles
_CLEAR = 0.25  # of the fence's square: below it a search for a start feels no barrier
_STABLE = -1e-6  # rad/s; a pole to the right of it is none of a stable model
# models with as many states each: their indices, and A, B, C, D stacked (m, ...)
Stacks = list[tuple[list[int], list[np.ndarray]]]


@dataclass(frozen=True, slots=True)
class Ratio:
    """The largest ratio of a value to its limit, and where: the model's label, and the frequency
    [rad/s] (nan: at a time).
    """

    value: float
    label: str
    frequency: float


@dataclass(slots=True, eq=False)
class Objective:
    """f(x) of (1) and its gradient, for models of any number of states on one grid omega (w,)
    [rad/s].

    reference: a controller to stay near: the rms of ln|k/k_ref| over the direct gains below 200 Hz
    is held below ``match`` [-]. fence [rad/s]: a modulus that the controller's own poles stay
    below, by the barrier (10); a search that ran into a limit unknown to its cost would end there.
    """

    structure: Structure | FilterBank
    models: Sequence[LoopModel]
    omega: np.ndarray
    aims: Aims
    reference: StateSpace | None = None
    match: float = 0.08
    fence: float | None = None
    _P: np.ndarray = field(init=False)  # u, f -> y, q, i of every model (m, w, 3a, 2a)
    _G: np.ndarray = field(init=False)  # u -> y (m, w, a, a) [m/A]
    _stacks: Stacks = field(init=False)  # all models
    _followed: Stacks = field(init=False)  # those whose poles count
    _follow_all: bool = field(init=False)  # whether all of them do from now on
    _ignored: float = field(init=False)  # share of the sum that the next ``narrow`` may leave out
    # True where a term counts, one array per channel, settling and stack (None: all count)
    _masks: list[np.ndarray] | None = field(init=False)
    _whole: float = field(init=False)  # f of everything at the last ``narrow`` that was True
    # channels and settling, made on first use: stability needs neither
    _requirements: tuple[list[Channel | Scaled], Settling | None] | None = field(init=False)
    _active: Active | None = field(init=False)  # the pairs that count; None: all
    # (m, pulsed axis) peaks of the pulse responses [m], of which the settling band is a share
    _peak: np.ndarray | None = field(init=False)
    _reference_gains: np.ndarray = field(init=False)  # |k_ref| (w, a) at _MATCHED [A/m]

    def __post_init__(self) -> None:
        self._P = np.stack([model.response(self.omega) for model in self.models])
        a = self._P.shape[-1] // 2
        self._G = self._P[..., :a, :a]
        self._stacks = self._followed = _stacks(self.models)
        self._follow_all, self._ignored = False, _IGNORED
        self._masks, self._whole = None, np.inf
        self._requirements = self._active = self._peak = None
        if self.reference is not None:
            values = frequency_response(self.reference, _MATCHED).values
            self._reference_gains = np.abs(np.diagonal(values, axis1=1, axis2=2))

    def _parts(self) -> tuple[list[Channel | Scaled], Settling | None]:
        """The channels, and the settling in time where a limit of it is among the aims."""
        if self._requirements is None:
            # grids of a few points serve the poles alone
            timed = self.aims.settling is not None and len(self.omega) > 20
            settling = Settling(self.omega, self.aims.settling or 0.0) if timed else None
            self._requirements = (
                channels_of(self._P, self._G.shape[-1], self.omega, self.aims, self.models),
                settling,
            )
        return self._requirements

    def narrow(self, x: np.ndarray, power: float) -> bool:
        """Let only those terms of the sum in (1) count that are large at x: all that are left out
        have together less than a ten-millionth of it.

        A descent calls this every few steps, so that what has grown joins. False where a model is
        unstable at x, or what had been left out has grown to a hundredth of the sum while the
        p-norm has not fallen by a fifth since the last True: from now on the poles of all models
        are computed, and less is left out.
        """
        theta = self.structure.theta(x)
        poles = self._read(theta)
        if max(values.real.max() for values, _ in poles) >= _STABLE:
            self._follow_all, self._followed = True, self._stacks
            self._masks = None
            return False
        shares, whole = self._shares(x, power, poles)

        # What the last narrowing left out counts by now: less of it next time.
        if self._left_out(shares) > _GROWN:
            self._follow_all, self._followed = True, self._stacks
            self._ignored *= _FINER
            # where the largest ratio fell far, what was small beside it is not small any more
            if whole >= self._whole - _FAR:
                self._masks = None
                return False
        self._whole = whole

        # The pairs of channels and settling that count, and the stacks' models whose poles do.
        channels, settling = self._parts()
        masks = self._masks = together_below(shares, self._ignored)
        slow = np.zeros(0, int) if settling is None else np.flatnonzero(masks[len(channels)])
        self._active = active(self._G, channels, masks[: len(channels)], settling, slow)
        if not self._follow_all:
            self._followed = []
            for mask, (places, stack) in zip(masks[-len(poles) :], self._stacks, strict=True):
                rows = np.flatnonzero(mask)
                if len(rows):
                    self._followed.append(([places[i] for i in rows], [M[rows] for M in stack]))
        return True

    def _shares(
        self, x: np.ndarray, power: float, poles: Sequence[tuple[np.ndarray, np.ndarray]]
    ) -> tuple[list[np.ndarray], float]:
        """The terms of the sum in (1) in a common unit, and f of all of them: an array per channel
        (m, its frequencies), for settling (m,) and per stack (its models); poles as ``_read`` gives
        them.
        """
        channels, settling = self._parts()
        S, Q, H = self._closed(x)

        # top: a lower bound of the largest ratio, by (12); the unit is top^p
        loops = [channel.response(S, Q) for channel in channels]
        norms = [frobenius(T) for T in loops]
        damping = self._damping_ratios(poles, self._stacks)
        top = max(
            *(float(norms[k].max(initial=0.0)) / np.sqrt(T.shape[-1]) for k, T in enumerate(loops)),
            *(float(ratio.max()) for ratio in damping),
        )
        late = np.zeros((0, 0, 0, 0))
        if settling is not None:
            late, _, _, self._peak = settling.ratios(H[:, settling.at].swapaxes(0, 1), self._peak)
            late = late**SETTLING_POWER
            top = max(top, float(late.max()))

        # matrices with |T|_F < least have together less than the ignored share, by (12): 0 will do
        least = top * (self._ignored / sum(norm.size for norm in norms)) ** (1 / power)
        shares = []
        for norm, T in zip(norms, loops, strict=True):
            large = norm >= least
            shares.append(np.zeros(norm.shape))
            shares[-1][large] = schatten(T[large] / top, int(power))[0]
        if settling is not None:
            shares.append(((late / top) ** power).sum(axis=(0, 2, 3)))
        shares += [((ratio / top) ** power).sum(axis=1) for ratio in damping]
        return shares, float(np.log(top) + np.log(sum(item.sum() for item in shares)) / power)

    def _left_out(self, shares: Sequence[np.ndarray]) -> float:
        """The share of the sum that is not counted since the last ``narrow``."""
        if self._masks is None:
            return 0.0
        out = sum(float(s[~mask].sum()) for s, mask in zip(shares, self._masks, strict=True))
        return out / sum(float(share.sum()) for share in shares)

    def __call__(self, x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        """ln of the p-norm, for an even power, and its gradient (k,); inf where a model is
        unstable (after ``narrow``: one whose poles are followed).
        """
        if power % 2:
            raise ValueError(
                f"power is {power}, but must be even: powers of T* T stand for those of singular "
                "values"
            )

        # Poles on the axis or to the right of it: the frequency responses would mean nothing.
        theta = self.structure.theta(x)
        closed = [_closed_loops(theta, stack) for _, stack in self._followed]
        poles = [
            loops.read(self._fast(places))
            for loops, (places, _) in zip(closed, self._followed, strict=True)
        ]
        if max((values.real.max() for values, _ in poles), default=-np.inf) >= _STABLE:
            return np.inf, np.zeros(len(x))
        channels, settling = self._parts()
        if self._active is None:
            masks = [np.ones((len(self.models), len(channel.at)), bool) for channel in channels]
            self._active = active(
                self._G,
                channels,
                masks,
                settling,
                np.arange(0 if settling is None else len(self.models)),
            )

        # K, S = S_o, H and Q of (2) at the pairs that count; Q where a channel is made of it.
        kept = self._active
        K, X, Y = self._controller(x)
        K = K[kept.omega]
        S = np.linalg.inv(np.eye(K.shape[-1]) + kept.G @ K)
        H = S @ kept.G
        Q = np.zeros_like(S)
        Q[kept.driven] = K[kept.driven] @ S[kept.driven]
        loops = [part.response(S, Q) for part in kept.parts]

        damping = self._damping_ratios(poles, self._followed)

        # Powers are of ratio / top, to stay in range, with top near the largest ratio by (12); f =
        # ln top + ln(sum (ratio / top)^p) / p does not depend on it. Where only settling counts
        # there are no other ratios.
        top = max(
            [float(frobenius(T).max(initial=0.0)) / np.sqrt(T.shape[-1]) for T in loops]
            + [float(ratio.max()) for ratio in damping],
            default=0.0,
        )

        # Settling: |y| over its band, to the power 0.4 as the ratio of (5).
        timed = None
        if settling is not None and len(kept.slow):
            if self._peak is None:  # everything counts
                self._peak = settling.ratios(H[kept.timed])[3]
            timed = settling.ratios(H[kept.timed], self._peak[kept.slow])
            top = max(top, float(timed[0].max()) ** SETTLING_POWER)

        # total = sum (ratio / top)^p, and d total / p = Re tr(psi* dK) at every pair. By (2), where
        # d total / p = Re tr(by_Q dQ + by_S dS_o + by_y dH) and by_H = by_S + G by_y,
        # psi* = S_o (by_Q S_i - by_H H).
        total = 0.0
        by_H, by_Q = np.zeros(S.shape, complex), np.zeros(S.shape, complex)
        for part, T in zip(kept.parts, (T / top for T in loops), strict=True):
            sums, slope = schatten(T, int(power))
            total += float(sums.sum())
            slope /= top
            if not isinstance(part, ActiveScaled):
                by_Q[part.pairs] -= part.C @ slope @ part.B  # (3) with dT = -B dQ C
            elif part.of == S_O:
                by_H[part.pairs] += slope * part.factor
            else:
                by_Q[part.pairs] += slope * part.factor

        # the same of y(t), at the pairs of the models whose settling counts
        if timed is not None and settling is not None:
            late, slope = settling.slope(timed, top, power)
            total += late
            by_H[kept.timed] += kept.G[kept.timed] @ slope

        # the poles' terms, and their slope by Theta over p
        slope_theta = self._poles_slope(theta, closed, damping, top, power)
        total += sum(float(((ratio / top) ** power).sum()) for ratio in damping)

        # the distance from the reference: d (ratio / top)^p / p = (ratio / top)^p / ratio d ratio
        if self.reference is not None:
            ratio, by_theta = self._mismatch(x)
            share = (ratio / top) ** power
            total += share
            slope_theta += by_theta * (share / max(ratio, 1e-9))

        # The barrier is added to f itself: its slope times total, for the gradient is divided by
        # total at the end.
        barrier, by_theta = self._fenced(theta)
        slope_theta += total * by_theta

        # the models share K, so that psi* is summed over the pairs of each frequency
        inside = -by_H @ H
        at = kept.driven
        inside[at] += by_Q[at] - by_Q[at] @ Q[at] @ kept.G[at]  # S_i = I - Q G
        psi_h = np.add.reduceat(S @ inside, kept.starts, axis=0)
        slope = _theta_slope(psi_h, X[kept.distinct], Y[kept.distinct])
        gradient = self.structure.gradient(x, slope + slope_theta)
        return float(np.log(top) + np.log(total) / power) + barrier, gradient / total

    def unstable(
        self, x: np.ndarray, power: float = 20.0, scale: float = 100.0
    ) -> tuple[float, np.ndarray]:
        """The soft maximum (11) of the poles' real parts over ``scale`` [rad/s], with its gradient
        (k,): for a start that does not hold all models. A fence adds its barrier for controller
        poles beyond half of it.
        """
        theta = self.structure.theta(x)
        parts = [_closed_loops(theta, stack).eigen() for _, stack in self._stacks]
        top = max(part.values.real.max() for part in parts)

        # f = top / scale + ln(sum exp((Re lambda - top) p / scale)) / p,
        # df = sum share Re(d lambda) / total / scale
        total, slope = 0.0, np.zeros_like(theta)
        for part in parts:
            share = np.exp((part.values.real - top) * power / scale)
            total += share.sum()
            slope += part.slope(share)
        value = float(top / scale + np.log(total) / power)
        gradient = self.structure.gradient(x, slope) / total / scale
        barrier, by_theta = self._fenced(theta, _CLEAR)
        return value + barrier, gradient + self.structure.gradient(x, by_theta)

    def abscissa(self, x: np.ndarray) -> float:
        """The largest real part of any model's closed-loop pole (in w) [rad/s]."""
        theta = self.structure.theta(x)
        return max(
            float(_closed_loops(theta, stack).poles().real.max()) for _, stack in self._stacks
        )

    def poles(self, x: np.ndarray) -> np.ndarray:
        """All models' closed-loop poles, in w [rad/s]."""
        theta = self.structure.theta(x)
        return np.concatenate(
            [_closed_loops(theta, stack).poles().ravel() for _, stack in self._stacks]
        )

    def ratios(self, x: np.ndarray, *, poles: bool = True) -> dict[str, Ratio]:
        """By requirement or guard: the largest ratio over models and grid, and where it is; those
        of poles, which no grid changes, where they are asked for.
        """
        S, Q, H = self._closed(x)
        largest: dict[str, Ratio] = {}
        channels, settling = self._parts()
        for channel in channels:
            size = largest_gains(channel.response(S, Q))
            parts = {channel.name: size}
            if channel.name == "sensitivity":
                # size: over the limit that the guard lowers towards zero frequency; size times
                # share: over the required one
                share = self.aims.sensitivity_limit(self.omega) / self.aims.sensitivity
                guarded = np.where(share < FALLS, size, 0.0)
                parts = {channel.name: size * share, SENSITIVITY_GUARD: guarded}
            for name, part in parts.items():
                if part.size:
                    i, j = np.unravel_index(int(part.argmax()), part.shape)
                    place = float(self.omega[channel.at[j]])
                    largest[name] = Ratio(float(part[i, j]), self.models[int(i)].label, place)
        if settling is not None:
            late, _, _, _ = settling.ratios(H[:, settling.at].swapaxes(0, 1))
            worst = late.max(axis=(0, 2, 3))
            largest["settling"] = Ratio(
                float(worst.max()) ** SETTLING_POWER,
                self.models[int(worst.argmax())].label,
                float("nan"),
            )
        read = self._read(self.structure.theta(x)) if poles else []
        for (values, aliased), (members, _) in zip(read, self._stacks, strict=poles):
            ratios, _ = self._damping(values, aliased, members)
            # poles of which the guard alone asks for damping, and those of requirements
            size = np.maximum(np.abs(values), 1e-9)
            required = ratios * np.maximum(-values.real / size, 1e-9)
            guarded = (size >= self.aims.damped_to) & (required <= self.aims.guard * (1 + 1e-9))
            for name, held in (("damping", ~guarded), (DAMPING_GUARD, guarded)):
                ratio = np.where(held, ratios, 0.0)
                i, j = np.unravel_index(int(ratio.argmax()), ratio.shape)
                here = Ratio(
                    float(ratio[i, j]), self.models[members[i]].label, float(np.abs(values[i, j]))
                )
                largest[name] = max(here, largest.get(name, here), key=lambda item: item.value)
        if self.reference is not None:
            largest["match"] = Ratio(self._mismatch(x)[0], "", float("nan"))
        return largest

    def sensitivity(self, x: np.ndarray) -> np.ndarray:
        """sigma_max(S_o) over its limit, (models, w)."""
        S, _, _ = self._closed(x)
        return np.asarray(largest_gain(S) / self.aims.sensitivity_limit(self.omega))

    def _closed(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """S = S_o, Q = K S_o and H = S_o G of all models at all frequencies, (m, w, a, a)."""
        K, _, _ = self._controller(x)
        S = np.linalg.inv(np.eye(K.shape[-1]) + self._G @ K)
        return S, K @ S, S @ self._G

    def _controller(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K (w, a, a), X = (sI - A)^-1 B (w, n, a), Y = C (sI - A)^-1 (w, a, n)."""
        A, B, C, D = self.structure.matrices(x)
        s = 1j * warped(self.omega, self.models[0].timing)
        X, Y = _resolvent(A, B, C, s)
        return C @ X + D, X, Y

    def _poles_slope(
        self,
        theta: np.ndarray,
        closed: list[_ClosedLoops],
        damping: list[np.ndarray],
        top: float,
        power: float,
    ) -> np.ndarray:
        """df/dTheta over p (a + n, a + n) of the terms (6), top^p the unit of the sum; closed,
        damping: loops and ratios (m, n) of every followed stack.
        """
        slope = np.zeros_like(theta)
        for loops, ratio, (places, _) in zip(closed, damping, self._followed, strict=True):
            # eigenvectors cost more than the poles alone: only of models that count
            rows = np.flatnonzero((ratio / top).max(axis=1) ** power > _NOTHING)
            if not len(rows):
                continue
            counted = [places[i] for i in rows]
            poles = loops.eigen(rows, self._fast(counted))
            rho, derivative = self._damping(poles.values, poles.aliased, counted)

            # d (rho / top)^p / p = (rho / top)^p / rho d rho
            share = np.where(rho > 0, (rho / top) ** power, 0.0)
            weight = np.where(share > _NOTHING, share / np.maximum(rho, 1e-300), 0.0)
            slope += poles.slope(weight * derivative)
        return slope

    def _read(self, theta: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Poles (m, N) of every stack, and which of them are aliased (m, N)."""
        return [
            _closed_loops(theta, stack).read(self._fast(places)) for places, stack in self._stacks
        ]

    def _fast(self, places: Sequence[int]) -> list[FastModes | None]:
        """The modes above half the sample rate of the models at ``places``."""
        return [self.models[i].fast for i in places]

    def _fenced(self, theta: np.ndarray, clear: float = 0.0) -> tuple[float, np.ndarray]:
        """The barrier (10) and its slope by Theta, whose last block is A; 0 without a fence."""
        value, by_theta = 0.0, np.zeros_like(theta)
        if self.fence is not None:
            a = self._G.shape[-1]
            value, by_theta[a:, a:] = _barrier(theta[a:, a:], self.fence, clear)
        return value, by_theta

    def _damping_ratios(
        self, poles: Sequence[tuple[np.ndarray, np.ndarray]], stacks: Stacks
    ) -> list[np.ndarray]:
        """The ratios (6) (m, n) of every stack's poles, as ``_read`` gives them."""
        return [
            self._damping(*read, places)[0] for read, (places, _) in zip(poles, stacks, strict=True)
        ]

    def _damping(
        self, values: np.ndarray, aliased: np.ndarray, places: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The ratios (6), required damping over damping (m, n), 0 where none is required, and their
        derivative by the real plus j times that by the imaginary part.

        values (m, n): the poles of the models at ``places``; aliased (m, n): those that stand at
        another frequency than theirs, of which none is required. At a running speed API 617's
        separation margin requires damping as well.
        """
        aims = self.aims

        # wanted: the damping ratio required, constant on either side of damped_to; that of the
        # separation margin varies with the modulus, with the slope ``steeper`` [s/rad].
        size = np.maximum(np.abs(values), 1e-9)
        wanted = np.where(size < aims.damped_to, aims.damping, aims.guard)
        steeper = np.zeros(values.shape)
        if aims.running is not None:
            timing = self.models[0].timing

            # in true frequency: d unwarped / d size = 1 / (1 + (size T / 2)^2)
            needed = needed_damping(unwarped(size, timing), aims.running)
            margin, slope = (MARGIN * part for part in needed)
            slope = slope if timing is None else slope / (1 + (size * timing.sample_time / 2) ** 2)
            runs = np.array([runs_within(self.models[i].speed, aims.running) for i in places])
            here = runs[:, None] & (margin > wanted)
            wanted, steeper = np.where(here, margin, wanted), np.where(here, slope, 0.0)

        # (6), of poles that ring and are not damped far better than required
        zeta = np.maximum(-values.real / size, 1e-9)
        held = (np.abs(values.imag) > _RINGING * size) & (zeta < _WATCHED * wanted) & ~aliased
        ratio = np.where(held, wanted / zeta, 0.0)

        # d zeta / d Re = -1/|lambda| + Re^2/|lambda|^3,   d zeta / d Im = Re Im / |lambda|^3
        by_real, by_imaginary = (
            -1 / size + values.real**2 / size**3,
            values.real * values.imag / size**3,
        )

        # d ratio = -ratio / zeta d zeta + d wanted / zeta,
        # d|lambda| = Re(conj(lambda) d lambda) / |lambda|
        outward = np.where(held, steeper / zeta / size, 0.0)
        return ratio, -ratio / zeta * (by_real + 1j * by_imaginary) + outward * values

    def _mismatch(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """The ratio (9) and its slope by Theta."""
        A, B, C, D = self.structure.matrices(x)
        X, Y = _resolvent(A, B, C, 1j * _MATCHED)
        k = np.diagonal(C @ X + D, axis1=1, axis2=2)
        error = np.log(np.abs(k) / self._reference_gains)
        ratio = float(np.sqrt((error**2).mean())) / self.match

        # d ratio = sum error d ln|k| / (N ratio match^2),   d ln|k| = Re(dk / k)
        psi_h = np.zeros((len(_MATCHED), len(D), len(D)), complex)
        i = np.arange(len(D))
        psi_h[:, i, i] = error / (max(ratio, 1e-9) * self.match**2) / error.size / k
        return ratio, _theta_slope(psi_h, X, Y)


@dataclass(frozen=True, slots=True, eq=False)
class _LoopPoles:
    """Poles of closed loops with their derivatives: values (m, n) [rad/s]; aliased (m, n): which
    are of the plant's modes above half the sample rate; left (m, n, a + k), right (m, a + k, n):
    (8) by Theta, dlambda_i = left_i dTheta right_i, with the k states of the controller.
    """

    values: np.ndarray
    aliased: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def slope(self, weight: np.ndarray) -> np.ndarray:
        """df/dTheta (a + k, a + k) of df = sum of Re(conj(weight_i) dlambda_i); weight (m, n): the
        derivative of f by the real plus j times that by the imaginary part of every pole.
        """
        i, j = np.nonzero(weight)
        if not len(i):
            return np.zeros((self.left.shape[2], self.right.shape[1]))

        # Re(conj(weight) left_i dTheta right_i)
        w = np.conj(weight[i, j])
        return np.asarray(((self.left[i, j] * w[:, None]).T @ self.right[i, :, j]).real)


@dataclass(frozen=True, slots=True, eq=False)
class _ClosedLoops:
    """(7), the closed loops A (m, N, N) of models with one controller, and their derivative dA =
    into dTheta out, into (m, N, a + k), out (m, a + k, N).
    """

    A: np.ndarray
    into: np.ndarray
    out: np.ndarray

    def poles(self) -> np.ndarray:
        """The poles (m, N) [rad/s]."""
        return np.asarray(np.linalg.eigvals(self.A))

    def read(self, fast: Sequence[FastModes | None]) -> tuple[np.ndarray, np.ndarray]:
        """The poles (m, N), and which of them are of the models' ``fast`` modes (m, N)."""
        if all(modes is None for modes in fast):  # eigenvectors cost more than the poles alone
            values = self.poles()
            return values, np.zeros(values.shape, bool)
        values, V = np.linalg.eig(self.A)
        return values, _aliased(values, V, _inverse(V), fast)

    def eigen(
        self, rows: np.ndarray | slice = slice(None), fast: Sequence[FastModes | None] = ()
    ) -> _LoopPoles:
        """The poles of the models ``rows``, whose ``fast`` modes are given, with derivatives."""
        # (8) with the rows w_i of V^-1; a pseudo-inverse where poles coincide
        values, V = np.linalg.eig(self.A[rows])
        W = _inverse(V)
        aliased = _aliased(values, V, W, fast)
        return _LoopPoles(values, aliased, W @ self.into[rows], self.out[rows] @ V)


def _aliased(
    values: np.ndarray, V: np.ndarray, W: np.ndarray, fast: Sequence[FastModes | None]
) -> np.ndarray:
    """Which poles (m, N) in w are of the modes above half the sample rate, ``fast``, of their
    models; V (m, N, N): eigenvectors, W = V^-1. None is without ``fast``.
    """
    aliased = np.zeros(values.shape, bool)
    for i, modes in enumerate(fast):
        if modes is not None:
            # z = (1 + w T/2)/(1 - w T/2)
            half = values[i].astype(complex) * modes.dt / 2
            poles = logarithm((1 + half) / (1 - half), modes.dt)
            aliased[i] = modes.read(poles, V[i], W[i])[0]
    return aliased


def _closed_loops(theta: np.ndarray, stack: list[np.ndarray]) -> _ClosedLoops:
    """The loops (7) of plants A, B, C, D (m, ...) with the controller Theta, u = K (-y)."""
    # With err = -y the controller is (u, x_k') = Theta (err, x_k), and
    # (err, x_k) = out (x, x_k) + outer (u, x_k'),   out = diag(-C, I), outer = diag(-D, 0).
    A, B, C, D = stack
    count, N, a = B.shape
    n = len(theta) - a
    outer = np.zeros((count, a + n, a + n))
    outer[:, :a, :a] = -D
    inner = np.linalg.inv(np.eye(a + n) - theta @ outer)

    # (x, x_k)' = diag(A, 0) (x, x_k) + into (u, x_k'),   into = diag(B, I)
    into, out = np.zeros((count, N + n, a + n)), np.zeros((count, a + n, N + n))
    into[:, :N, :a], into[:, N:, a:] = B, np.eye(n)
    out[:, :a, :N], out[:, a:, N:] = -C, np.eye(n)

    # (u, x_k') = (I - Theta outer)^-1 Theta out (x, x_k)
    loop = into @ (inner @ theta) @ out
    loop[:, :N, :N] += A

    # its derivative: (I - Theta outer)^-1 dTheta (I - outer Theta)^-1 out
    back = np.eye(a + n) + outer @ inner @ theta  # (I - outer Theta)^-1
    return _ClosedLoops(loop, into @ inner, back @ out)


def _resolvent(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """X = (sI - A)^-1 B (w, n, p) and Y = C (sI - A)^-1 (w, m, n) of (4) at s (w,) [rad/s], by the
    eigenvectors of A where these are well conditioned.
    """
    values, V = np.linalg.eig(A)
    W = memberwise(np.linalg.inv, V[None])[0]
    if len(A) and _condition(V, W) < _APART:
        # (sI - A)^-1 = V diag(1 / (s - lambda)) V^-1
        fractions = (1 / (s[:, None] - values))[:, None, :]
        return (V * fractions) @ (W @ B), (C @ V * fractions) @ W
    inverse = np.linalg.inv(s[:, None, None] * np.eye(len(A)) - A)
    return inverse @ B, C @ inverse


def _inverse(V: np.ndarray) -> np.ndarray:
    """The inverse of matrices of eigenvectors (..., n, n), a pseudo-inverse where they coincide."""
    n = V.shape[-1]
    W = memberwise(np.linalg.inv, V.reshape(-1, n, n)).reshape(V.shape)
    return W if _condition(V, W) < _COINCIDE else np.linalg.pinv(V)


def _condition(V: np.ndarray, W: np.ndarray) -> float:
    """The largest condition number |V| |W| in Frobenius norms, W the inverse of V, which is not
    below that of singular values; inf where there is no inverse.
    """
    worst = float((frobenius(V) * frobenius(W)).max(initial=0.0))
    return worst if np.isfinite(worst) else np.inf


def frobenius(T: np.ndarray) -> np.ndarray:
    """The Frobenius norm of every matrix (..., r, c), between its largest singular value and
    sqrt(c) times that.
    """
    return np.sqrt(
        np.einsum("...ij,...ij->...", T.real, T.real)
        + np.einsum("...ij,...ij->...", T.imag, T.imag)
    )


def together_below(shares: Sequence[np.ndarray], ignored: float) -> list[np.ndarray]:
    """Which entries of all arrays count: the smallest are left out (False) as long as together
    they stay below the share ``ignored`` of the sum.
    """
    every = np.sort(np.concatenate([share.ravel() for share in shares]))
    few = int(np.searchsorted(every.cumsum(), ignored * every.sum(), side="right"))
    return [share > (every[few - 1] if few else -np.inf) for share in shares]


def schatten(T: np.ndarray, power: int) -> tuple[np.ndarray, np.ndarray]:
    """(3): sum of sigma_i^p of every matrix T (k, r, c), for an even power p, and its slope over
    p, (k, c, r): d(sum sigma_i^p) / p = Re tr(slope dT).
    """
    # slope = (T* T)^(p/2 - 1) T*; some hundred matrices at a time stay in the processor's cache
    sums, slopes = np.empty(len(T)), np.empty((len(T), T.shape[2], T.shape[1]), complex)
    for first in range(0, len(T), _TOGETHER):
        at = slice(first, first + _TOGETHER)
        T_h = T[at].conj().swapaxes(1, 2)
        gram = T_h @ T[at]
        inner = np.linalg.matrix_power(gram, power // 2 - 1)
        sums[at] = np.einsum("kij,kij->k", gram.conj(), inner).real
        np.matmul(inner, T_h, out=slopes[at])
    return sums, slopes


def largest_gains(T: np.ndarray) -> np.ndarray:
    """The largest singular value of every matrix (..., r, c) that can be the largest of all; of the
    others, a lower bound.
    """
    size = frobenius(T)

    # |T|_F / sqrt(min(r, c)) <= sigma_max <= |T|_F: only a matrix whose upper bound reaches the
    # largest lower one can be the largest.
    bound = size / np.sqrt(min(T.shape[-2:]))
    held = size >= bound.max(initial=0.0)
    bound[held] = largest_gain(T[held])
    return np.asarray(bound)


def _stacks(models: Sequence[LoopModel]) -> Stacks:
    """The models by their number of states, stacked."""
    groups: dict[int, list[int]] = {}
    for i, model in enumerate(models):
        groups.setdefault(len(model.A), []).append(i)
    return [
        (places, [np.stack([getattr(models[i], k) for i in places]) for k in "ABCD"])
        for places in groups.values()
    ]


def _barrier(A: np.ndarray, fence: float, clear: float = 0.0) -> tuple[float, np.ndarray]:
    """The barrier (10) of the controller's own A (n, n), and its slope by A; fence [rad/s]; clear:
    the share of fence^2 below which |pole|^2 adds nothing (0: every pole adds).
    """
    values, V = np.linalg.eig(A)
    W = _inverse(V)

    # part = (|lambda|^2 / fence^2 - clear) / (1 - clear), from 0 to 1 at the fence
    part = np.maximum(np.abs(values) ** 2 / fence**2 - clear, 0.0) / (1 - clear)
    room = 1 - part
    if (room <= 0).any():
        return np.inf, np.zeros_like(A)

    # -d ln(1 - part) = 2 Re(conj(lambda) d lambda) / fence^2 / (1 - clear) / room,
    # d lambda_i = w_i dA v_i
    value = -float(np.log(room).sum())
    weight = 2 * _BARRIER * values.conj() / fence**2 / room
    if clear:  # -ln(1 - part) - part begins without a kink; its slope is part / room
        value -= float(part.sum())
        weight *= part / (1 - clear)
    return _BARRIER * value, np.asarray(((W * weight[:, None]).T @ V.T).real)


def _theta_slope(psi_h: np.ndarray, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """df/dTheta (a + n, a + n) from df = sum over frequencies of Re tr(psi* dK), psi_h = psi* (w,
    a, a), with X and Y of (4).
    """
    # df/dD = Re(psi*)^T, df/dC = Re(X psi*)^T, df/dB = Re(psi* Y)^T, df/dA = Re(X psi* Y)^T, each
    # summed over frequencies
    by_X = X @ psi_h
    left = by_X.transpose(1, 0, 2).reshape(X.shape[1], -1)
    right = Y.reshape(-1, Y.shape[2])
    return np.block(
        [
            [psi_h.sum(axis=0).real.T, by_X.sum(axis=0).real.T],
            [(psi_h @ Y).sum(axis=0).real.T, (left @ right).real.T],
        ]
    )
