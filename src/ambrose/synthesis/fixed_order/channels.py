"""The responses that tuning holds below limits: closed-loop channels T = A - B Q C, and the
settling of a pulse in time.

A channel's rows are divided by their limits, so that sigma_max(T) is a ratio; with Q = K (I + G
K)^-1 both are affine in Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded
from scipy.sparse import csr_array

from ambrose.machine.criteria import CURRENT_PULSE as PULSE
from ambrose.synthesis.fixed_order.aims import Aims
from ambrose.synthesis.fixed_order.loops import LoopModel

_TIMED_TO = 2e4  # rad/s; what is faster than that does not matter for settling
# rad/s; below it a step of the quadrature turns the latest time by this phase, above it 4 pulse
# durations:
_SLOW_TO = 2000.0
_PHASE = 0.15  # rad
SETTLING_POWER = 0.4  # of the settling ratio: an exponential decay enters about as a rate


S_O, DRIVE = "S_o", "Q"


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """T = A - B Q C: A (m, w, r, c), B (m, w, r, a), C (m, w, a, c), rows divided by their limits;
    at: which frequencies of the grid.
    """

    name: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    at: np.ndarray

    def response(self, S: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """T (m, w, r, c) at the channel's frequencies; S = S_o and Q (m, w, a, a) at all."""
        return np.asarray(self.A - self.B @ Q[:, self.at] @ self.C)


@dataclass(frozen=True, slots=True, eq=False)
class Scaled:
    """T = factor S_o, or factor Q: of says which; factor (w,), one over the limit; at: as there."""

    name: str
    of: str
    factor: np.ndarray
    at: np.ndarray

    def response(self, S: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """As of a channel."""
        whole = S if self.of == S_O else Q
        return np.asarray(whole * self.factor[None, :, None, None])


def channels_of(
    P: np.ndarray, a: int, omega: np.ndarray, aims: Aims, models: Sequence[LoopModel]
) -> list[Channel | Scaled]:
    """Sensitivity, gain, compliance, and under unbalance orbit, currents and forces, each over its
    limit.
    """
    # Columns of P: u, f; rows: y, q, i. With u = -K y: y = G u + G_yf f gives u = -Q G_yf f,
    # G the rows y and columns u.
    u, f = slice(0, a), slice(a, 2 * a)
    G_yf = P[:, :, u, f]
    q, i = slice(a, 2 * a), slice(2 * a, None)
    G_qu = P[:, :, q, u]
    G_qf = P[:, :, q, f]
    G_iu = P[:, :, i, u]
    G_if = P[:, :, i, f]
    every = np.arange(len(omega))

    # S_o = I - G Q,   K S_o = Q
    found: list[Channel | Scaled] = [
        Scaled("sensitivity", S_O, 1 / aims.sensitivity_limit(omega), every),
        Scaled("gain", DRIVE, 1 / aims.gain_limit(omega), every),
    ]

    # f -> q: G_qf - G_qu Q G_yf
    if aims.compliance is not None:
        found.append(
            Channel("compliance", G_qf / aims.compliance, G_qu / aims.compliance, G_yf, every)
        )
    at = np.flatnonzero(omega <= aims.unbalance_to * (1 + 1e-9))
    if not aims.unbalance or not len(at):
        return found

    # Under unbalance f = U omega^2, up to the speed at which it is asked for.
    force = aims.unbalance * omega[at, None, None] ** 2

    def under_unbalance(name: str, A: np.ndarray, B: np.ndarray, limits: np.ndarray) -> None:
        rows = np.isfinite(limits)
        if rows.any():
            by = force / limits[rows][:, None]
            found.append(
                Channel(name, A[:, at][:, :, rows] * by, B[:, at][:, :, rows] * by, G_yf[:, at], at)
            )

    if aims.orbit is not None:
        under_unbalance("orbit", G_qf, G_qu, np.full(a, aims.orbit))
    under_unbalance("current", G_if, G_iu, np.array(aims.currents))
    if aims.voltage is not None:
        most, inductance = aims.voltage

        # |v| = omega L |i|
        swing = (inductance * omega)[:, None, None]
        under_unbalance("voltage", swing * G_if, swing * G_iu, np.full(a, most))

    # bearing force k_i i + k_s q
    k_i, k_s = (
        np.stack(values)[:, None, :, None]
        for values in zip(*(model.magnet for model in models), strict=True)
    )
    under_unbalance(
        "force", k_i * G_if + k_s * G_qf, k_i * G_iu + k_s * G_qu, np.array(aims.forces)
    )
    return found


class Settling:
    """|y(t)| after the pulse over the band around zero, from frequency responses by quadrature
    of a cubic spline.
    """

    __slots__ = ("at", "early", "late")

    def __init__(self, omega: np.ndarray, settling: float) -> None:
        self.at = np.flatnonzero(omega < min(_TIMED_TO, omega[-1] * (1 + 1e-9)))
        w = omega[self.at]

        # A step turns exp(j w t) by _PHASE: up to _SLOW_TO at the latest time, above it at 4 pulse
        # durations.
        last = PULSE.duration + 8 * settling
        slow = np.linspace(0, _SLOW_TO, int(np.ceil(_SLOW_TO * last / _PHASE)) + 1)
        fast = np.linspace(
            _SLOW_TO,
            max(w[-1], _SLOW_TO + 1),
            int(np.ceil(w[-1] * 4 * PULSE.duration / _PHASE)) + 2,
        )
        fine = np.unique(np.concatenate([slow, fast]))
        fine = fine[fine <= w[-1]]

        # Trapezoidal rule on steps that differ; the end of the range fades out as half a cosine,
        # for a sharp end would ring in time.
        step = np.gradient(fine)
        step[[0, -1]] /= 2
        edge = 0.8 * w[-1]
        taper = np.where(
            fine > edge, 0.5 + 0.5 * np.cos(np.pi * (fine - edge) / (w[-1] - edge)), 1.0
        )
        jw = 1j * np.maximum(fine, 1e-6)

        def weights(time: np.ndarray) -> np.ndarray:
            # y(t) = 1/pi Re int H(jw) (exp(jw t) - exp(jw (t - d))) / jw dw after a pulse of
            # duration d; while it lasts (t < d), the second exponent is 0.
            rise = np.exp(jw * time[:, None]) - np.exp(
                jw * (time - np.minimum(PULSE.duration, time))[:, None]
            )
            return _by_samples(rise / jw * step * taper / np.pi, fine, w)

        # late: from the settling time on; early: where the peak lies, of which the band is taken.
        after = settling * np.concatenate([np.linspace(1, 2.2, 16), np.geomspace(2.4, 8, 8)])
        self.late = weights(PULSE.duration + after)
        self.early = weights(PULSE.duration * np.linspace(0.1, 2.5, 24))

    def ratios(
        self, H: np.ndarray, peak: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """|y| over its band (t, m, axis, pulsed axis), y itself, the band (m, pulsed axis), and the
        peaks it is taken of.

        H (w, m, a, a): S_o G = G - G Q G, a pulse of u -> y in the closed loop, at the frequencies
        ``at``. peak (m, pulsed axis): None takes those of the response itself.
        """
        flat = H.reshape(len(H), -1)
        if peak is None:
            early = (self.early @ flat).real.reshape(-1, *H.shape[1:])
            peak = np.abs(early).max(axis=(0, 2))
        y = (self.late @ flat).real.reshape(-1, *H.shape[1:])
        band = PULSE.band * peak
        return np.abs(y) / band[None, :, None, :], y, band, peak

    def slope(
        self, timed: tuple[np.ndarray, ...], top: float, power: float
    ) -> tuple[float, np.ndarray]:
        """The part of the p-norm's sum, and the conjugate transpose (w, m, a, a) of its slope by
        H; timed: what ``ratios`` returned.
        """
        ratio, y, band, _ = timed

        # d share / p = share 0.4 / ratio d ratio,   d ratio = sign(y) dy / band (the band is held)
        share = (ratio**SETTLING_POWER / top) ** power
        weight = (
            share * SETTLING_POWER / np.maximum(ratio, 1e-300) * np.sign(y) / band[None, :, None, :]
        )

        # y = Re sum_w late H: the slope is late* weight, its conjugate transpose late weight^T
        turned = np.ascontiguousarray(weight.swapaxes(2, 3))
        slope = self.late.T @ turned.reshape(len(turned), -1)
        return float(share.sum()), slope.reshape(-1, *turned.shape[1:])


def _by_samples(weights: np.ndarray, fine: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The weights (t, n) at the knots w (n,) of a quadrature (t, f) at fine (f,) of their natural
    cubic spline.
    """
    # Within interval i, with left + right = 1 and bends M = y'':
    # y = left y_i + right y_i+1 + h^2/6 ((left^3 - left) M_i + (right^3 - right) M_i+1).
    i = np.clip(np.searchsorted(w, fine, side="right") - 1, 0, len(w) - 2)
    # below the first frequency: its value
    h, at = np.diff(w), np.maximum(fine, w[0])
    left, right = (w[i + 1] - at) / h[i], (at - w[i]) / h[i]
    rows, size = np.arange(len(fine)), (len(fine), len(w))

    def spread(on_left: np.ndarray, on_right: np.ndarray) -> np.ndarray:
        places = np.concatenate([rows, rows]), np.concatenate([i, i + 1])
        return np.asarray(
            (csr_array((np.concatenate([on_left, on_right]), places), size).T @ weights.T).T
        )

    # natural: no bend at the two ends
    by_values = spread(left, right)
    bend = h[i] ** 2 / 6
    by_bends = spread(bend * (left**3 - left), bend * (right**3 - right))[:, 1:-1]
    # bends (n-2,) from values
    # h_i-1 M_i-1 + 2 (h_i-1 + h_i) M_i + h_i M_i+1 = 6 ((y_i+1 - y_i)/h_i - (y_i - y_i-1)/h_i-1);
    # the matrix is symmetric: it acts on the weights as on the bends
    banded = np.array([np.append(0, h[1:-1]), 2 * (h[1:] + h[:-1]), np.append(h[1:-1], 0)])
    inner = solve_banded((1, 1), banded, by_bends.T).T * 6
    by_values[:, :-2] += inner / h[:-1]
    by_values[:, 1:-1] -= inner * (1 / h[:-1] + 1 / h[1:])
    by_values[:, 2:] += inner / h[1:]
    return by_values
