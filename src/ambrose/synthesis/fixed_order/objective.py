"""What tuning minimises: the p-norm of all ratios of a requirement to its limit, over channels,
frequencies, models and poles.

A channel is a closed-loop response T = A - B Q C with Q = K (I + G K)^-1, its rows divided by their
limits, or S_o or Q itself over a limit. From dQ = S_i dK S_o follows dT = -B S_i dK S_o C, so that
all channels' slopes are added up in one matrix per frequency before the controller's own derivative
is taken (the p-norm is smooth; Apkarian & Noll 2006 work with the subgradients of its limit). The
settling of a pulse is a channel in time, y(t) = sum over frequencies of weights (t, w) times
H = S_o G. Poles enter by their damping ratios, with derivatives from left and right eigenvectors;
between two calls of ``narrow`` only those of models whose damping counts are computed. The poles
of a plant's modes above half the sample rate (core/aliasing.py), which stand in w at frequencies
that are not theirs, must be stable and have no damping ratio there.
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


_IGNORED = 1e-7  # share of the p-norm's sum that all together have that is left out
# where it grew to this share, the descent goes back and leaves out so much less
_GROWN, _FINER = 1e-2, 1e-3
_FAR = float(np.log(1.25))  # unless the p-norm of everything fell by that
_TOGETHER = 200  # matrices of one step
_NOTHING = 1e-5  # share below which a pole's slope is left out
_APART = 1e6  # condition number of eigenvectors that divide no more than a few digits away
_COINCIDE = 1e14  # of eigenvectors that do not divide at all
_RINGING = 0.7  # imaginary part over modulus above which a pole is held to a damping ratio
_WATCHED = 20.0  # times the damping asked for: better damped poles are left out
_MATCHED = np.geomspace(max(BAND[0], 2 * np.pi), BAND[1], 30)  # rad/s
_BARRIER = 0.02  # of the controller's own poles
_CLEAR = 0.25  # of the fence's square: below it a search for a start feels no barrier
_STABLE = -1e-6  # rad/s; a pole to the right of it is none of a stable model
# models with as many states together: their places, and A, B, C, D (m, ...)
Stacks = list[tuple[list[int], list[np.ndarray]]]


@dataclass(frozen=True, slots=True)
class Ratio:
    """The largest ratio of a requirement to its limit, where: the model's label, and the frequency
    [rad/s] (nan: a time).
    """

    value: float
    label: str
    frequency: float


@dataclass(slots=True, eq=False)
class Objective:
    """f(x) = ln of the p-norm and its gradient, for models with as many states or not, on one grid
    omega (w,) [rad/s].

    reference: a controller to stay near: the rms of ln|k/k_ref| over the direct gains below 200 Hz
    is held below ``match``. fence: a modulus [rad/s] that the controller's own poles stay below; a
    search that ran into a limit of which its cost knows nothing would end there, so that f has a
    logarithmic barrier, f - 0.02 sum ln(1 - |pole|^2/fence^2).
    """

    structure: Structure | FilterBank
    models: Sequence[LoopModel]
    omega: np.ndarray
    aims: Aims
    reference: StateSpace | None = None
    match: float = 0.08
    fence: float | None = None
    _P: np.ndarray = field(init=False)
    _G: np.ndarray = field(init=False)
    _stacks: Stacks = field(init=False)
    _followed: Stacks = field(init=False)  # those of models whose poles count
    _follow_all: bool = field(init=False)
    _ignored: float = field(init=False)
    _masks: list[np.ndarray] | None = field(init=False)  # of what counts (None: not known)
    _whole: float = field(init=False)  # ln of the p-norm of everything, at the last of ``narrow``
    # on first use: stability needs neither
    _made: tuple[list[Channel | Scaled], Settling | None] | None = field(init=False)
    _active: Active | None = field(init=False)  # None: everything
    # of the pulse responses, which the settling band is taken of
    _peak: np.ndarray | None = field(init=False)
    _wanted: np.ndarray = field(init=False)  # direct gains of the reference (w, a)

    def __post_init__(self) -> None:
        self._P = np.stack([model.response(self.omega) for model in self.models])
        a = self._P.shape[-1] // 2
        self._G = self._P[..., :a, :a]
        self._stacks = self._followed = _stacks(self.models)
        self._follow_all, self._ignored = False, _IGNORED
        self._masks, self._whole = None, np.inf
        self._made = self._active = self._peak = None
        if self.reference is not None:
            values = frequency_response(self.reference, _MATCHED).values
            self._wanted = np.abs(np.diagonal(values, axis1=1, axis2=2))

    def _parts(self) -> tuple[list[Channel | Scaled], Settling | None]:
        if self._made is None:
            # grids of a few points serve the poles alone
            timed = self.aims.settling is not None and len(self.omega) > 20
            settling = Settling(self.omega, self.aims.settling or 0.0) if timed else None
            self._made = (
                channels_of(self._P, self._G.shape[-1], self.omega, self.aims, self.models),
                settling,
            )
        return self._made

    def narrow(self, x: np.ndarray, power: float) -> bool:
        """From now on only what counts near x: channels and poles of models and frequencies; all
        that is left out has together less than a ten-millionth of the p-norm's sum.

        A descent calls this every few steps, so that what has grown joins. False where a model is
        unstable at x, or what had been left out has grown to a hundredth of the sum and the whole
        has not fallen by a fifth since this last said True: from now on the poles of
        all are computed, and less is left out.
        """
        theta = self.structure.theta(x)
        poles = self._read(theta)
        if max(values.real.max() for values, _ in poles) >= _STABLE:
            self._follow_all, self._followed = True, self._stacks
            self._masks = None
            return False
        channels, settling = self._parts()
        S, Q, H = self._closed(x)

        # |T|_F / sqrt(c) <= sigma_max(T), and sum sigma_i^p <= |T|_F^p: what is below ``least`` has
        # together less than the ignored share of top^p. Shares are told over top^p.
        loops = [channel.response(S, Q) for channel in channels]
        norms = [frobenius(T) for T in loops]
        damping = [
            self._damping(*read, places)[0]
            for read, (places, _) in zip(poles, self._stacks, strict=True)
        ]
        top = max(
            float(norm.max(initial=0.0)) / np.sqrt(T.shape[-1])
            for norm, T in zip(norms, loops, strict=True)
        )
        top = max(top, *(float(ratio.max()) for ratio in damping))
        late = np.zeros((0, 0, 0, 0))
        if settling is not None:
            late, _, _, self._peak = settling.ratios(H[:, settling.at].swapaxes(0, 1), self._peak)
            late = late**SETTLING_POWER
            top = max(top, float(late.max()))
        least = top * (self._ignored / sum(norm.size for norm in norms)) ** (1 / power)
        shares = []
        for norm, T in zip(norms, loops, strict=True):
            near = norm >= least
            shares.append(np.zeros(norm.shape))
            shares[-1][near] = schatten(T[near] / top, int(power))[0]
        if settling is not None:
            shares.append(((late / top) ** power).sum(axis=(0, 2, 3)))
        shares += [((ratio / top) ** power).sum(axis=1) for ratio in damping]
        whole = float(np.log(top) + np.log(sum(float(share.sum()) for share in shares)) / power)
        if self._left_out(shares) > _GROWN:
            self._follow_all, self._followed = True, self._stacks
            self._ignored *= _FINER
            # where the highest ratio fell far, what had been left out beside it may well be all
            if whole >= self._whole - _FAR:
                self._masks = None
                return False
        self._whole = whole
        masks = self._masks = together_below(shares, self._ignored)
        count = len(channels)
        slow = np.zeros(0, int) if settling is None else np.flatnonzero(masks[count])
        self._active = active(self._G, channels, masks[:count], settling, slow)
        if not self._follow_all:
            self._followed = []
            for mask, (places, stack) in zip(masks[-len(poles) :], self._stacks, strict=True):
                rows = np.flatnonzero(mask)
                if len(rows):
                    self._followed.append(([places[i] for i in rows], [M[rows] for M in stack]))
        return True

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
        closed = [_loops(theta, stack) for _, stack in self._followed]
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

        # K = C (sI - A)^-1 B + D, S = S_o = (I + G K)^-1, Q = K S_o and H = S_o G, at the pairs
        # that count; Q where a channel is made of it.
        kept = self._active
        K, X, Y = self._controller(x)
        K = K[kept.omega]
        S = np.linalg.inv(np.eye(K.shape[-1]) + kept.G @ K)
        H = S @ kept.G
        Q = np.zeros_like(S)
        Q[kept.driven] = K[kept.driven] @ S[kept.driven]
        loops = [part.response(S, Q) for part in kept.parts]

        # The poles' ratios (0 where none is asked for).
        damping = [
            self._damping(*read, places)[0]
            for read, (places, _) in zip(poles, self._followed, strict=True)
        ]

        # All ratios are taken over ``top``, for the powers to stay in range; |T|_F / sqrt(c) <=
        # sigma_max(T). f = ln top + ln(sum (ratio / top)^p) / p does not depend on it. Where only
        # settling counts there are no others.
        top = max(
            [float(frobenius(T).max(initial=0.0)) / np.sqrt(T.shape[-1]) for T in loops]
            + [float(ratio.max()) for ratio in damping],
            default=0.0,
        )

        # Settling: |y| over its band, to the power 0.4 as a ratio.
        timed = None
        if settling is not None and len(kept.slow):
            if self._peak is None:  # everything counts
                self._peak = settling.ratios(H[kept.timed])[3]
            timed = settling.ratios(H[kept.timed], self._peak[kept.slow])
            top = max(top, float(timed[0].max()) ** SETTLING_POWER)

        # total = sum (ratio / top)^p, and d total / p = Re tr(psi^H dK) at every pair, with
        # psi^H = S_o (by_Q S_i - by_H H):   dQ = S_i dK S_o,   dS_o = -H dK S_o,   dH = -H dK H
        total = 0.0
        by_H, by_Q = np.zeros(S.shape, complex), np.zeros(S.shape, complex)
        for part, T in zip(kept.parts, (T / top for T in loops), strict=True):
            sums, slope = schatten(T, int(power))
            total += float(sums.sum())
            slope /= top
            if not isinstance(part, ActiveScaled):
                by_Q[part.pairs] -= part.C @ slope @ part.B  # dT = -B dQ C
            elif part.of == S_O:
                by_H[part.pairs] += slope * part.factor
            else:
                by_Q[part.pairs] += slope * part.factor

        # the same of y(t), at the pairs of the models that settle late
        if timed is not None and settling is not None:
            late, slope = settling.slope(timed, top, power)
            total += late
            by_H[kept.timed] += kept.G[kept.timed] @ slope

        # the poles' sum, and its slope by Theta over p
        slope_theta = self._poles_slope(theta, closed, damping, top, power)
        total += sum(float(((ratio / top) ** power).sum()) for ratio in damping)

        # the distance from the reference: d (ratio / top)^p / p = (ratio / top)^p / ratio d ratio
        extra = np.zeros_like(theta)
        if self.reference is not None:
            ratio, more = self._mismatch(x)
            share = (ratio / top) ** power
            total += share
            extra = more * (share / max(ratio, 1e-9))

        # The barrier is added to f itself: its slope times total, for the gradient is divided by
        # total at the end. A is the last block of Theta.
        barrier = 0.0
        if self.fence is not None:
            barrier, slope = _barrier(self.structure.matrices(x)[0], self.fence)
            extra[len(extra) - len(slope) :, extra.shape[1] - len(slope) :] += total * slope

        # the models share K, so that psi^H is summed over the pairs of each frequency
        inside = -by_H @ H
        at = kept.driven
        inside[at] += by_Q[at] - by_Q[at] @ Q[at] @ kept.G[at]  # S_i = I - Q G
        psi_h = np.add.reduceat(S @ inside, kept.starts, axis=0)
        slope = _theta_slope(psi_h, X[kept.distinct], Y[kept.distinct])
        gradient = self.structure.gradient(x, slope + slope_theta + extra)
        return float(np.log(top) + np.log(total) / power) + barrier, gradient / total

    def unstable(
        self, x: np.ndarray, power: float = 20.0, scale: float = 100.0
    ) -> tuple[float, np.ndarray]:
        """A soft maximum of the poles' real parts [100 rad/s], with its gradient: for a start that
        does not hold all models. With a fence, its barrier for poles beyond half of that.
        """
        theta = self.structure.theta(x)
        parts = [_loops(theta, stack).eigen() for _, stack in self._stacks]
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
        if self.fence is not None:
            barrier, by_A = _barrier(self.structure.matrices(x)[0], self.fence, _CLEAR)
            of_theta = np.zeros_like(theta)
            of_theta[len(theta) - len(by_A) :, theta.shape[1] - len(by_A) :] = by_A
            value, gradient = value + barrier, gradient + self.structure.gradient(x, of_theta)
        return value, gradient

    def abscissa(self, x: np.ndarray) -> float:
        """The largest real part of any model's closed-loop pole (in w) [rad/s]."""
        theta = self.structure.theta(x)
        return max(float(_loops(theta, stack).poles().real.max()) for _, stack in self._stacks)

    def poles(self, x: np.ndarray) -> np.ndarray:
        """All models' closed-loop poles, in w [rad/s]."""
        theta = self.structure.theta(x)
        return np.concatenate([_loops(theta, stack).poles().ravel() for _, stack in self._stacks])

    def ratios(self, x: np.ndarray) -> dict[str, Ratio]:
        """By channel: the largest ratio over models and grid, and where it is."""
        S, Q, H = self._closed(x)
        found: dict[str, Ratio] = {}
        channels, settling = self._parts()
        for channel in channels:
            size = largest_gains(channel.response(S, Q))
            parts = {channel.name: size}
            if channel.name == "sensitivity":
                # what is required, and what the guard asks for at low frequencies
                share = self.aims.sensitivity_limit(self.omega) / self.aims.sensitivity
                guarded = np.where(share < FALLS, size, 0.0)
                parts = {channel.name: size * share, SENSITIVITY_GUARD: guarded}
            for name, part in parts.items():
                if part.size:
                    i, j = np.unravel_index(int(part.argmax()), part.shape)
                    place = float(self.omega[channel.at[j]])
                    found[name] = Ratio(float(part[i, j]), self.models[int(i)].label, place)
        if settling is not None:
            late, _, _, _ = settling.ratios(H[:, settling.at].swapaxes(0, 1))
            worst = late.max(axis=(0, 2, 3))
            found["settling"] = Ratio(
                float(worst.max()) ** SETTLING_POWER,
                self.models[int(worst.argmax())].label,
                float("nan"),
            )
        read = self._read(self.structure.theta(x))
        for (values, aliased), (members, _) in zip(read, self._stacks, strict=True):
            both, _ = self._damping(values, aliased, members)
            # what is asked for by the guard alone, and by requirements
            size = np.maximum(np.abs(values), 1e-9)
            asked = both * np.maximum(-values.real / size, 1e-9)
            guarded = (size >= self.aims.damped_to) & (asked <= self.aims.guard * (1 + 1e-9))
            for name, mine in (("damping", ~guarded), (DAMPING_GUARD, guarded)):
                ratio = np.where(mine, both, 0.0)
                i, j = np.unravel_index(int(ratio.argmax()), ratio.shape)
                here = Ratio(
                    float(ratio[i, j]), self.models[members[i]].label, float(np.abs(values[i, j]))
                )
                found[name] = max(here, found.get(name, here), key=lambda item: item.value)
        if self.reference is not None:
            found["match"] = Ratio(self._mismatch(x)[0], "", float("nan"))
        return found

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
        closed: list[_Loops],
        damping: list[np.ndarray],
        top: float,
        power: float,
    ) -> np.ndarray:
        """Of those models only of which a pole counts."""
        slope = np.zeros_like(theta)
        for loops, ratio, (places, _) in zip(closed, damping, self._followed, strict=True):
            # eigenvectors cost more than the poles alone: only of models that count
            rows = np.flatnonzero((ratio / top).max(axis=1) ** power > _NOTHING)
            if not len(rows):
                continue
            counted = [places[i] for i in rows]
            part = loops.eigen(rows, self._fast(counted))
            held, derivative = self._damping(part.values, part.aliased, counted)

            # d (ratio / top)^p / p = (ratio / top)^p / ratio d ratio
            share = np.where(held > 0, (held / top) ** power, 0.0)
            weight = np.where(share > _NOTHING, share / np.maximum(held, 1e-300), 0.0)
            slope += part.slope(weight * derivative)
        return slope

    def _read(self, theta: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """``_Loops.read`` of every stack."""
        return [_loops(theta, stack).read(self._fast(places)) for places, stack in self._stacks]

    def _fast(self, places: Sequence[int]) -> list[FastModes | None]:
        return [self.models[i].fast for i in places]

    def _damping(
        self, values: np.ndarray, aliased: np.ndarray, places: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """damping asked for over damping (m, n), 0 where none is asked for, and its derivative by
        real + j imaginary part.

        values (m, n): the poles of the models at ``places``; aliased (m, n): those that are read at
        another frequency than theirs, which are asked for none. Of models at a running speed the
        separation margin asks as well.
        """
        aims = self.aims

        # The damping asked for is constant on either side of damped_to; that of the separation
        # margin varies with the modulus, with the slope ``steeper``.
        size = np.maximum(np.abs(values), 1e-9)
        wanted = np.where(size < aims.damped_to, aims.damping, aims.guard)
        steeper = np.zeros(values.shape)
        if aims.running is not None:
            timing = self.models[0].timing

            # in true frequency: d unwarped / d size = 1 / (1 + (size T / 2)^2)
            asked = needed_damping(unwarped(size, timing), aims.running)
            more, slope = (MARGIN * part for part in asked)
            slope = slope if timing is None else slope / (1 + (size * timing.sample_time / 2) ** 2)
            here = np.array([runs_within(self.models[i].speed, aims.running) for i in places])[
                :, None
            ] & (more > wanted)
            wanted, steeper = np.where(here, more, wanted), np.where(here, slope, 0.0)

        # ratio = wanted / zeta, zeta = -Re lambda / |lambda|
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
        """rms of ln|k/k_ref| of the direct gains over its limit, and its slope in Theta."""
        A, B, C, D = self.structure.matrices(x)
        X, Y = _resolvent(A, B, C, 1j * _MATCHED)
        k = np.diagonal(C @ X + D, axis1=1, axis2=2)
        error = np.log(np.abs(k) / self._wanted)
        ratio = float(np.sqrt((error**2).mean())) / self.match

        # d ratio = sum error d ln|k| / (N ratio match^2),   d ln|k| = Re(dk / k)
        psi_h = np.zeros((len(_MATCHED), len(D), len(D)), complex)
        i = np.arange(len(D))
        psi_h[:, i, i] = error / (max(ratio, 1e-9) * self.match**2) / error.size / k
        return ratio, _theta_slope(psi_h, X, Y)


@dataclass(frozen=True, slots=True, eq=False)
class _LoopPoles:
    """values (m, n) of closed loops; aliased (m, n): which are of the plant's modes above half the
    sample rate; left (m, n, a+k), right (m, a+k, n): d value = left_i dTheta right_i.
    """

    values: np.ndarray
    aliased: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def slope(self, weight: np.ndarray) -> np.ndarray:
        """sum of Re(weight_i conj(d value_i)) in Theta; weight (m, n): derivative by the real, plus
        j by the imaginary part.
        """
        i, j = np.nonzero(weight)
        if not len(i):
            return np.zeros((self.left.shape[2], self.right.shape[1]))

        # Re(weight conj(d lambda)) = Re(conj(weight) left_i dTheta right_i)
        w = np.conj(weight[i, j])
        return np.asarray(((self.left[i, j] * w[:, None]).T @ self.right[i, :, j]).real)


@dataclass(frozen=True, slots=True, eq=False)
class _Loops:
    """Closed loops A (m, N, N) of models with one controller; dA = into dTheta out, into (m, N,
    a+k), out (m, a+k, N).
    """

    A: np.ndarray
    into: np.ndarray
    out: np.ndarray

    def poles(self) -> np.ndarray:
        """(m, N)."""
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
        """The poles with their slopes, of some of the models, and their ``fast`` modes."""
        # d lambda_i = w_i dA v_i with the rows w_i of V^-1; a pseudo-inverse where poles coincide
        values, V = np.linalg.eig(self.A[rows])
        W = _inverse(V)
        aliased = _aliased(values, V, W, fast)
        return _LoopPoles(values, aliased, W @ self.into[rows], self.out[rows] @ V)


def _aliased(
    values: np.ndarray, V: np.ndarray, W: np.ndarray, fast: Sequence[FastModes | None]
) -> np.ndarray:
    """Which poles in w (m, N) are read at the fast modes of their models, with eigenvectors V (m,
    N, N) and W = V^-1; none without ``fast``.
    """
    found = np.zeros(values.shape, bool)
    for i, modes in enumerate(fast):
        if modes is not None:
            # z = (1 + w T/2)/(1 - w T/2)
            half = values[i].astype(complex) * modes.dt / 2
            poles = logarithm((1 + half) / (1 - half), modes.dt)
            found[i] = modes.read(poles, V[i], W[i])[0]
    return found


def _loops(theta: np.ndarray, stack: list[np.ndarray]) -> _Loops:
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
    return _Loops(loop, into @ inner, back @ out)


def _resolvent(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """X = (sI - A)^-1 B (w, n, p) and Y = C (sI - A)^-1 (w, m, n) at s (w,), by the eigenvectors of
    A where they are apart.
    """
    values, V = np.linalg.eig(A)
    W = memberwise(np.linalg.inv, V[None])[0]
    if len(A) and _condition(V, W) < _APART:
        # (sI - A)^-1 = V diag(1 / (s - lambda)) V^-1
        share = (1 / (s[:, None] - values))[:, None, :]
        return (V * share) @ (W @ B), (C @ V * share) @ W
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
    """sum of sigma_i^p of every matrix T (k, r, c), for an even power, and its slope over p, (k, c,
    r): d sum sigma_i^p / p = Re tr(slope dT).
    """
    # sum sigma_i^p = tr (T* T)^(p/2), slope = (T* T)^(p/2 - 1) T*; some hundred matrices at a time
    # stay in the processor's cache
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
    """The models of every size together: their places, and A, B, C, D (m, ...)."""
    groups: dict[int, list[int]] = {}
    for i, model in enumerate(models):
        groups.setdefault(len(model.A), []).append(i)
    return [
        (places, [np.stack([getattr(models[i], k) for i in places]) for k in "ABCD"])
        for places in groups.values()
    ]


def _barrier(A: np.ndarray, fence: float, clear: float = 0.0) -> tuple[float, np.ndarray]:
    """The barrier of the controller's own poles, and its slope by A (n, n); clear: the share of
    fence^2 below which |pole|^2 adds nothing (0: every pole adds).
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
    """df/dTheta from df = sum Re tr(psi^H dK), psi_h (w, a, a), Theta = [[D, C], [B, A]]."""
    # dK = dD + dC X + Y dB + Y dA X: df/dD = Re(psi^H)^T, df/dC = Re(X psi^H)^T,
    # df/dB = Re(psi^H Y)^T, df/dA = Re(X psi^H Y)^T, summed over frequencies
    by_X = X @ psi_h
    left = by_X.transpose(1, 0, 2).reshape(X.shape[1], -1)
    right = Y.reshape(-1, Y.shape[2])
    return np.block(
        [
            [psi_h.sum(axis=0).real.T, by_X.sum(axis=0).real.T],
            [(psi_h @ Y).sum(axis=0).real.T, (left @ right).real.T],
        ]
    )
