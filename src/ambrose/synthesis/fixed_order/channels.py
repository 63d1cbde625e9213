"""The responses that tuning holds below limits: closed-loop channels T = A - B Q C, and the settling of a pulse in time.

A channel's rows are divided by their limits, so that sigma_max(T) is a ratio; with Q = K (I + G K)^-1 both are affine in Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ambrose.machine.criteria import CURRENT_PULSE as PULSE
from ambrose.synthesis.fixed_order.aims import Aims
from ambrose.synthesis.fixed_order.loops import LoopModel

_TIMED_TO = 2e4  # rad/s; what is faster than that does not matter for settling
_SLOW_TO = 2000.0  # rad/s; below it a step of the quadrature turns the latest time by this phase, above it 4 pulse durations:
_PHASE = 0.15  # rad
SETTLING_POWER = 0.4  # of the settling ratio: an exponential decay enters about as a rate


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A (m, w, r, c), B (m, w, r, a), C (m, w, a, c), rows divided by their limits; at: which frequencies of the grid."""

    name: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    at: np.ndarray


def channels_of(P: np.ndarray, a: int, omega: np.ndarray, aims: Aims, models: Sequence[LoopModel]) -> list[Channel]:
    """Sensitivity, gain, compliance, and under unbalance orbit, currents and forces, each over its limit."""
    u, f = slice(0, a), slice(a, 2 * a)
    G, G_yf = P[:, :, u, u], P[:, :, u, f]
    q, i = slice(a, 2 * a), slice(2 * a, None)
    G_qu, G_qf, G_iu, G_if = P[:, :, q, u], P[:, :, q, f], P[:, :, i, u], P[:, :, i, f]
    every, eye = np.arange(len(omega)), np.eye(a)[None, None]
    limit = 1 / aims.sensitivity_limit(omega)[None, :, None, None]
    found = [
        Channel("sensitivity", np.broadcast_to(eye * limit, G.shape), G * limit, eye, every),
        Channel("gain", np.zeros((1, 1, a, a)), -eye / aims.gain_limit(omega)[None, :, None, None], eye, every),
    ]
    if aims.compliance is not None:
        found.append(Channel("compliance", G_qf / aims.compliance, G_qu / aims.compliance, G_yf, every))
    at = np.flatnonzero(omega <= aims.unbalance_to * (1 + 1e-9))
    if not aims.unbalance or not len(at):
        return found
    force = aims.unbalance * omega[at, None, None] ** 2

    def under_unbalance(name: str, A: np.ndarray, B: np.ndarray, limits: np.ndarray) -> None:
        rows = np.isfinite(limits)
        if rows.any():
            by = force / limits[rows][:, None]
            found.append(Channel(name, A[:, at][:, :, rows] * by, B[:, at][:, :, rows] * by, G_yf[:, at], at))

    if aims.orbit is not None:
        under_unbalance("orbit", G_qf, G_qu, np.full(a, aims.orbit))
    under_unbalance("current", G_if, G_iu, np.array(aims.currents))
    if aims.voltage is not None:
        most, inductance = aims.voltage
        swing = (inductance * omega)[:, None, None]
        under_unbalance("voltage", swing * G_if, swing * G_iu, np.full(a, most))
    k_i, k_s = (np.stack(values)[:, None, :, None] for values in zip(*(model.magnet for model in models), strict=True))
    under_unbalance("force", k_i * G_if + k_s * G_qf, k_i * G_iu + k_s * G_qu, np.array(aims.forces))
    return found


class Settling:
    """|y(t)| after the pulse over the band around zero, from frequency responses by quadrature of a cubic spline."""

    __slots__ = ("at", "early", "late", "peak")

    def __init__(self, omega: np.ndarray, settling: float) -> None:
        self.peak: np.ndarray | None = None
        self.at = np.flatnonzero(omega < min(_TIMED_TO, omega[-1] * (1 + 1e-9)))
        w = omega[self.at]
        last = PULSE.duration + 8 * settling
        slow = np.linspace(0, _SLOW_TO, int(np.ceil(_SLOW_TO * last / _PHASE)) + 1)
        fast = np.linspace(_SLOW_TO, max(w[-1], _SLOW_TO + 1), int(np.ceil(w[-1] * 4 * PULSE.duration / _PHASE)) + 2)
        fine = np.unique(np.concatenate([slow, fast]))
        fine = fine[fine <= w[-1]]
        spline = CubicSpline(w, np.eye(len(w)), bc_type="natural")(np.maximum(fine, w[0]))
        step = np.gradient(fine)
        step[[0, -1]] /= 2
        edge = 0.8 * w[-1]
        taper = np.where(fine > edge, 0.5 + 0.5 * np.cos(np.pi * (fine - edge) / (w[-1] - edge)), 1.0)
        jw = 1j * np.maximum(fine, 1e-6)

        def weights(time: np.ndarray) -> np.ndarray:
            rise = np.exp(jw * time[:, None]) - np.exp(jw * (time - np.minimum(PULSE.duration, time))[:, None])
            return np.asarray((rise / jw * step * taper / np.pi) @ spline)

        after = settling * np.concatenate([np.linspace(1, 2.2, 16), np.geomspace(2.4, 8, 8)])
        self.late = weights(PULSE.duration + after)
        self.early = weights(PULSE.duration * np.linspace(0.1, 2.5, 24))

    def ratios(self, G: np.ndarray, Q: np.ndarray, anew: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """|y| over its band (m, t, axis, pulsed axis), y itself, and the band (m, pulsed axis).

        The peaks that the band is taken of are those of the first call, or computed ``anew``.
        """
        G = G[:, self.at]
        H = G - G @ Q[:, self.at] @ G
        peak = self.peak
        if peak is None or anew:
            peak = np.abs(np.einsum("tw,mwab->mtab", self.early, H, optimize=True).real).max(axis=(1, 2))
        if self.peak is None:
            self.peak = peak
        y = np.einsum("tw,mwab->mtab", self.late, H, optimize=True).real
        band = PULSE.band * peak
        return np.abs(y) / band[:, None, None, :], y, band

    def add(
        self, Z: np.ndarray, G: np.ndarray, timed: tuple[np.ndarray, np.ndarray, np.ndarray], top: float, power: float
    ) -> float:
        """Adds the slope to Z; returns the part of the p-norm's sum."""
        ratio, y, band = timed
        share = (ratio**SETTLING_POWER / top) ** power
        weight = share * SETTLING_POWER / np.maximum(ratio, 1e-300) * np.sign(y) / band[:, None, None, :]
        slope = np.einsum("tw,mtab->mwab", self.late.conj(), weight, optimize=True)
        back = G[:, self.at].conj().swapaxes(2, 3)
        Z[:, self.at] -= back @ slope @ back
        return float(share.sum())
