"""What tuning minimises: the p-norm of all ratios of a requirement to its limit, over channels, frequencies, models and poles.

A channel is a closed-loop response T = A - B Q C with Q = K (I + G K)^-1, its rows divided by their limits. From
dQ = S_i dK S_o follows dT = -B S_i dK S_o C, so that all channels' slopes are added up in one matrix per frequency before the
controller's own derivative is taken (the p-norm is smooth; Apkarian & Noll 2006 work with the subgradients of its limit). The
settling of a pulse is a channel in time, y(t) = sum over frequencies of weights (t, w) times G - G Q G. Poles enter by their
damping ratios, with derivatives from left and right eigenvectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace
from ambrose.plant.separation import needed_damping, runs_within
from ambrose.synthesis.fixed_order.aims import Aims
from ambrose.synthesis.fixed_order.bank import FilterBank
from ambrose.synthesis.fixed_order.channels import SETTLING_POWER, Channel, Settling, channels_of
from ambrose.synthesis.fixed_order.loops import LoopModel, unwarped, warped
from ambrose.synthesis.fixed_order.structure import Structure
from ambrose.synthesis.weight_tuning import BAND

_IGNORED = 1e-3  # share of the p-norm below which a frequency is left out
_RINGING = 0.7  # imaginary part over modulus above which a pole is held to a damping ratio
_WATCHED = 20.0  # times the damping asked for: better damped poles are left out
_MATCHED = np.geomspace(max(BAND[0], 2 * np.pi), BAND[1], 30)  # rad/s
_BARRIER = 0.02  # of the controller's own poles


@dataclass(frozen=True, slots=True)
class Ratio:
    """The largest ratio of a requirement to its limit, where: the model's label, and the frequency [rad/s] (nan: a time)."""

    value: float
    label: str
    frequency: float


@dataclass(slots=True, eq=False)
class Objective:
    """f(x) = ln of the p-norm and its gradient, for models with as many states or not, on one grid omega (w,) [rad/s].

    reference: a controller to stay near: the rms of ln|k/k_ref| over the direct gains below 200 Hz is held below ``match``.
    fence: a modulus [rad/s] that the controller's own poles stay below; a search that ran into a limit of which its cost knows
    nothing would end there, so that f has a logarithmic barrier, f - 0.02 sum ln(1 - |pole|^2/fence^2).
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
    _stacks: list[tuple[list[int], list[np.ndarray]]] = field(init=False)
    _made: tuple[list[Channel], Settling | None] | None = field(init=False)  # on first use: stability needs neither
    _wanted: np.ndarray = field(init=False)  # direct gains of the reference (w, a)

    def __post_init__(self) -> None:
        self._P = np.stack([model.response(self.omega) for model in self.models])
        a = self._P.shape[-1] // 2
        self._G = self._P[..., :a, :a]
        self._stacks = _stacks(self.models)
        self._made = None
        if self.reference is not None:
            values = frequency_response(self.reference, _MATCHED).values
            self._wanted = np.abs(np.diagonal(values, axis1=1, axis2=2))

    def _parts(self) -> tuple[list[Channel], Settling | None]:
        if self._made is None:
            timed = self.aims.settling is not None and len(self.omega) > 20
            settling = Settling(self.omega, self.aims.settling or 0.0) if timed else None
            self._made = channels_of(self._P, self._G.shape[-1], self.omega, self.aims, self.models), settling
        return self._made

    def __call__(self, x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        """ln of the p-norm, and its gradient (k,); inf where a model is unstable."""
        theta = self.structure.theta(x)
        poles = [_loop_poles(theta, stack, slopes=True) for _, stack in self._stacks]
        if max(part.values.real.max() for part in poles) >= -1e-6:
            return np.inf, np.zeros(len(x))
        K, X, Y = self._controller(x)
        S = np.linalg.inv(np.eye(K.shape[-1]) + self._G @ K)
        Q = K @ S
        channels, settling = self._parts()
        loops = [channel.A - channel.B @ Q[:, channel.at] @ channel.C for channel in channels]
        sizes = [np.linalg.norm(T, axis=(2, 3)) for T in loops]
        damping = [self._damping(part.values, places) for part, (places, _) in zip(poles, self._stacks, strict=True)]
        top = max(
            *(size.max(initial=0.0) / np.sqrt(T.shape[-1]) for size, T in zip(sizes, loops, strict=True)),
            *(ratio.max() for ratio, _ in damping),
        )
        timed = None
        if settling is not None:
            timed = settling.ratios(self._G, Q)
            top = max(top, float(timed[0].max()) ** SETTLING_POWER)
        total, Z = 0.0, np.zeros(Q.shape, complex)
        for channel, T, size in zip(channels, loops, sizes, strict=True):
            used = size >= top * _IGNORED ** (1 / power)
            if not used.any():
                continue
            U, s, Vh = np.linalg.svd(T[used], full_matrices=False)
            share = (s / top) ** power
            total += share.sum()
            slope = (U * (share / np.maximum(s, 1e-300))[:, None, :]) @ Vh
            i, j = np.nonzero(used)
            B, C = (np.broadcast_to(M, (*used.shape, *M.shape[2:]))[used] for M in (channel.B, channel.C))
            Z[i, channel.at[j]] -= B.conj().swapaxes(1, 2) @ slope @ C.conj().swapaxes(1, 2)
        if timed is not None and settling is not None:
            total += settling.add(Z, self._G, timed, top, power)
        slope_theta = self._poles_slope(theta, poles, damping, top, power)
        total += sum(float(((ratio / top) ** power).sum()) for ratio, _ in damping)
        extra = np.zeros_like(theta)
        if self.reference is not None:
            ratio, more = self._mismatch(x)
            share = (ratio / top) ** power
            total += share
            extra = more * (share / max(ratio, 1e-9))
        barrier = 0.0
        if self.fence is not None:
            barrier, slope = _barrier(self.structure.matrices(x)[0], self.fence)
            extra[len(extra) - len(slope) :, extra.shape[1] - len(slope) :] += total * slope
        gradient = self.structure.gradient(x, _controller_slope(Z, Q, self._G, S, X, Y) + slope_theta + extra)
        return float(np.log(top) + np.log(total) / power) + barrier, gradient / total

    def unstable(self, x: np.ndarray, power: float = 20.0, scale: float = 100.0) -> tuple[float, np.ndarray]:
        """A soft maximum of the poles' real parts [100 rad/s], with its gradient: for a start that does not hold all models."""
        theta = self.structure.theta(x)
        parts = [_loop_poles(theta, stack, slopes=True) for _, stack in self._stacks]
        top = max(part.values.real.max() for part in parts)
        total, slope = 0.0, np.zeros_like(theta)
        for part in parts:
            share = np.exp((part.values.real - top) * power / scale)
            total += share.sum()
            slope += part.slope(share)
        return float(top / scale + np.log(total) / power), self.structure.gradient(x, slope) / total / scale

    def abscissa(self, x: np.ndarray) -> float:
        """The largest real part of any model's closed-loop pole (in w) [rad/s]."""
        theta = self.structure.theta(x)
        return max(float(_loop_poles(theta, stack).values.real.max()) for _, stack in self._stacks)

    def poles(self, x: np.ndarray) -> np.ndarray:
        """All models' closed-loop poles, in w [rad/s]."""
        theta = self.structure.theta(x)
        return np.concatenate([_loop_poles(theta, stack).values.ravel() for _, stack in self._stacks])

    def ratios(self, x: np.ndarray) -> dict[str, Ratio]:
        """By channel: the largest ratio over models and grid, and where it is."""
        K, _, _ = self._controller(x)
        Q = K @ np.linalg.inv(np.eye(K.shape[-1]) + self._G @ K)
        found: dict[str, Ratio] = {}
        channels, settling = self._parts()
        for channel in channels:
            T = channel.A - channel.B @ Q[:, channel.at] @ channel.C
            size = np.linalg.norm(T, 2, axis=(2, 3))
            if size.size:
                i, j = np.unravel_index(int(size.argmax()), size.shape)
                found[channel.name] = Ratio(float(size[i, j]), self.models[int(i)].label, float(self.omega[channel.at[j]]))
        if settling is not None:
            late, _, _ = settling.ratios(self._G, Q, anew=True)
            worst = late.max(axis=(1, 2, 3))
            found["settling"] = Ratio(
                float(worst.max()) ** SETTLING_POWER, self.models[int(worst.argmax())].label, float("nan")
            )
        theta = self.structure.theta(x)
        for members, stack in self._stacks:
            values = _loop_poles(theta, stack).values
            ratio, _ = self._damping(values, members)
            i, j = np.unravel_index(int(ratio.argmax()), ratio.shape)
            here = Ratio(float(ratio[i, j]), self.models[members[i]].label, float(np.abs(values[i, j])))
            found["damping"] = max(here, found.get("damping", here), key=lambda item: item.value)
        if self.reference is not None:
            found["match"] = Ratio(self._mismatch(x)[0], "", float("nan"))
        return found

    def sensitivity(self, x: np.ndarray) -> np.ndarray:
        """sigma_max(S_o) over its limit, (models, w)."""
        K, _, _ = self._controller(x)
        S = np.linalg.inv(np.eye(K.shape[-1]) + self._G @ K)
        return np.asarray(np.linalg.norm(S, 2, axis=(2, 3)) / self.aims.sensitivity_limit(self.omega))

    def _controller(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K (w, a, a), X = (sI - A)^-1 B (w, n, a), Y = C (sI - A)^-1 (w, a, n)."""
        A, B, C, D = self.structure.matrices(x)
        s = 1j * warped(self.omega, self.models[0].timing)
        inverse = np.linalg.inv(s[:, None, None] * np.eye(len(A)) - A)
        X = inverse @ B
        return C @ X + D, X, C @ inverse

    def _poles_slope(
        self, theta: np.ndarray, poles: list[_LoopPoles], damping: list[tuple[np.ndarray, np.ndarray]], top: float, power: float
    ) -> np.ndarray:
        slope = np.zeros_like(theta)
        for part, (ratio, derivative) in zip(poles, damping, strict=True):
            share = np.where(ratio > 0, (ratio / top) ** power, 0.0)
            weight = np.where(share > 1e-9, share / np.maximum(ratio, 1e-300), 0.0)
            slope += part.slope(weight * derivative)
        return slope

    def _damping(self, values: np.ndarray, places: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """damping asked for over damping (m, n), 0 where none is asked for, and its derivative by real + j imaginary part.

        values (m, n): the poles of the models at ``places``. Of those at a running speed the separation margin asks as well.
        """
        aims = self.aims
        size = np.maximum(np.abs(values), 1e-9)
        wanted = np.where(size < aims.damped_to, aims.damping, aims.guard)
        steeper = np.zeros(values.shape)
        if aims.running is not None:
            timing = self.models[0].timing
            more, slope = needed_damping(unwarped(size, timing), aims.running)
            slope = slope if timing is None else slope / (1 + (size * timing.sample_time / 2) ** 2)
            here = np.array([runs_within(self.models[i].speed, aims.running) for i in places])[:, None] & (more > wanted)
            wanted, steeper = np.where(here, more, wanted), np.where(here, slope, 0.0)
        zeta = np.maximum(-values.real / size, 1e-9)
        held = (np.abs(values.imag) > _RINGING * size) & (zeta < _WATCHED * wanted)
        ratio = np.where(held, wanted / zeta, 0.0)
        by_real, by_imaginary = -1 / size + values.real**2 / size**3, values.real * values.imag / size**3
        outward = np.where(held, steeper / zeta / size, 0.0)
        return ratio, -ratio / zeta * (by_real + 1j * by_imaginary) + outward * values

    def _mismatch(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """rms of ln|k/k_ref| of the direct gains over its limit, and its slope in Theta."""
        A, B, C, D = self.structure.matrices(x)
        inverse = np.linalg.inv(1j * _MATCHED[:, None, None] * np.eye(len(A)) - A)
        X, Y = inverse @ B, C @ inverse
        k = np.diagonal(C @ X + D, axis1=1, axis2=2)
        error = np.log(np.abs(k) / self._wanted)
        ratio = float(np.sqrt((error**2).mean())) / self.match
        psi = np.zeros((len(_MATCHED), len(D), len(D)), complex)
        i = np.arange(len(D))
        psi[:, i, i] = error / (max(ratio, 1e-9) * self.match**2) / error.size / np.conj(k)
        return ratio, _theta_slope(psi, X, Y)


@dataclass(frozen=True, slots=True, eq=False)
class _LoopPoles:
    """values (m, n) of closed loops; left (m, n, a+k), right (m, a+k, n): d value = left_i dTheta right_i."""

    values: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def slope(self, weight: np.ndarray) -> np.ndarray:
        """sum of Re(weight_i conj(d value_i)) in Theta; weight (m, n): derivative by the real, plus j by the imaginary part."""
        i, j = np.nonzero(weight)
        if not len(i):
            return np.zeros((self.left.shape[2], self.right.shape[1]))
        w = np.conj(weight[i, j])
        return np.asarray(((self.left[i, j] * w[:, None]).T @ self.right[i, :, j]).real)


def _loop_poles(theta: np.ndarray, stack: list[np.ndarray], slopes: bool = False) -> _LoopPoles:
    A, B, C, D = stack
    count, N, a = B.shape
    n = len(theta) - a
    outer = np.zeros((count, a + n, a + n))
    outer[:, :a, :a] = -D
    inner = np.linalg.inv(np.eye(a + n) - theta @ outer)
    into, out = np.zeros((count, N + n, a + n)), np.zeros((count, a + n, N + n))
    into[:, :N, :a], into[:, N:, a:] = B, np.eye(n)
    out[:, :a, :N], out[:, a:, N:] = -C, np.eye(n)
    loop = into @ (inner @ theta) @ out
    loop[:, :N, :N] += A
    if not slopes:
        return _LoopPoles(np.linalg.eigvals(loop), np.zeros((0, 0, 0)), np.zeros((0, 0, 0)))
    values, V = np.linalg.eig(loop)
    W = np.linalg.pinv(V) if np.linalg.cond(V).max() > 1e14 else np.linalg.inv(V)
    back = np.linalg.inv(np.eye(a + n) - outer @ theta)
    return _LoopPoles(values, W @ (into @ inner), (back @ out) @ V)


def _stacks(models: Sequence[LoopModel]) -> list[tuple[list[int], list[np.ndarray]]]:
    """The models of every size together: their places, and A, B, C, D (m, ...)."""
    groups: dict[int, list[int]] = {}
    for i, model in enumerate(models):
        groups.setdefault(len(model.A), []).append(i)
    return [(places, [np.stack([getattr(models[i], k) for i in places]) for k in "ABCD"]) for places in groups.values()]


def _barrier(A: np.ndarray, fence: float) -> tuple[float, np.ndarray]:
    """The barrier of the controller's own poles, and its slope by A (n, n)."""
    values, V = np.linalg.eig(A)
    W = np.linalg.pinv(V) if len(A) and np.linalg.cond(V) > 1e14 else np.linalg.inv(V)
    room = 1 - np.abs(values) ** 2 / fence**2
    if (room <= 0).any():
        return np.inf, np.zeros_like(A)
    weight = 2 * _BARRIER * values.conj() / fence**2 / room
    return -_BARRIER * float(np.log(room).sum()), np.asarray(((W * weight[:, None]).T @ V.T).real)


def _controller_slope(Z: np.ndarray, Q: np.ndarray, G: np.ndarray, S: np.ndarray, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """df/dTheta from df/dQ (m, w, a, a): dQ = S_i dK S_o, S_i = I - Q G."""
    used = np.abs(Z).sum(axis=(2, 3)) > 0
    psi = np.zeros(X.shape[:1] + Q.shape[-2:], complex)
    if used.any():
        S_i = np.eye(Q.shape[-1]) - Q[used] @ G[used]
        np.add.at(psi, np.nonzero(used)[1], S_i.conj().swapaxes(1, 2) @ Z[used] @ S[used].conj().swapaxes(1, 2))
    return _theta_slope(psi, X, Y)


def _theta_slope(psi: np.ndarray, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """df/dTheta from df/dK (w, a, a), Theta = [[D, C], [B, A]]."""
    XH, YH = X.conj().swapaxes(1, 2), Y.conj().swapaxes(1, 2)
    return np.block([
        [psi.sum(axis=0).real, (psi @ XH).sum(axis=0).real],
        [(YH @ psi).sum(axis=0).real, (YH @ psi @ XH).sum(axis=0).real],
    ])  # fmt: skip
