"""The half-order lag of a solid core, and its passive rational model.

Eddy currents hold the flux of a solid core in a skin, whose reluctance grows with the square root
of the frequency (Zhu, Knospe and Maslen, IEEE Trans. Magn. 41(4) 2005):

    R(s) = R_0 + c sqrt(s),    h(s) = R_0/R(s) = 1/(1 + tau sqrt(s)),    tau = c/R_0,
    c = sqrt(sigma/mu) (L_i/(2 pi r_i) + 2 ln(r_o/r_i)/(2 pi) + L_o/(2 pi r_o)),

inner cylinder, back wall and collar as two discs, outer cylinder. Force per current and negative
stiffness both pass h. With u = tau sqrt(w), h = 1/(1 + u (1 + j)/sqrt(2)): the gain is -3 dB and
the phase -15 deg where u^2 + sqrt(2) u = 1, u = (sqrt(6) - sqrt(2))/2; the phase never passes
-45 deg.

h is a Stieltjes function, h(s) = integral over p of rho(p)/(s + p) with rho = tau sqrt(p)/(pi (1 +
tau^2 p)) >= 0, so that a sum of real lags with positive weights, g_k/(1 + s/p_k), can come as close
as it likes: such a model is passive whatever its weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive
from ambrose.core.statespace import StateSpace

CORNER = (math.sqrt(6) - math.sqrt(2)) / 2  # tau sqrt(w) at -3 dB and -15 deg
BAND = (0.1, 5000.0)  # [Hz]
WITHIN = (0.1, 1.0)  # [dB], [deg] over the band
_MOST = 8  # states
_POINTS = 160  # of the band, evenly by logarithm, at which the model is fitted and its error taken
_WIDE = 2.0  # decades beyond the band that the poles cover


def half_order(omega: ArrayLike, tau: float) -> np.ndarray:
    """h(j omega) (w,) at omega [rad/s], tau [sqrt(s)]."""
    return np.asarray(1 / (1 + tau * np.sqrt(1j * np.asarray(omega, dtype=float))))


@dataclass(frozen=True, slots=True, eq=False)
class Lags:
    """sum g_k/(1 + s/p_k): weights g (n,) > 0 of sum 1, poles p (n,) [rad/s].

    gain_error [dB] and phase_error [deg]: the largest over the band. rest: the largest |h - model|
    at all frequencies, what an unmodelled weight has to cover.
    """

    weights: np.ndarray
    poles: np.ndarray
    gain_error: float
    phase_error: float
    rest: float

    def response(self, omega: ArrayLike) -> np.ndarray:
        """(w,) at omega [rad/s]."""
        return _response(np.asarray(omega, dtype=float), self.weights, self.poles)

    def system(self, source: str, output: str, scale: float = 1.0) -> StateSpace:
        """x_k' = p_k (source/scale - x_k), output = scale g^T x; without lags output = source."""
        n = len(self.poles)
        return StateSpace(
            -np.diag(self.poles),
            self.poles[:, None] / scale,
            self.weights[None] * scale,
            np.full((1, 1), 0.0 if n else 1.0),
            [source],
            [output],
        )


def _response(omega: np.ndarray, weights: np.ndarray, poles: np.ndarray) -> np.ndarray:
    return np.asarray((weights / (1 + 1j * omega[:, None] / poles)).sum(axis=1))


@lru_cache(maxsize=32)
def lags(tau: float, states: int | None = None) -> Lags:
    """The rational model of tau [sqrt(s)] with the fewest states within 0.1 dB and 1 deg from 0.1
    Hz to 5 kHz; at most 8. states: so many, however close they come.

    Raises InvalidInput where 8 states do not come so close.
    """
    check_positive(tau, "tau [sqrt(s)] of the solid core", "leave the core laminated")
    numbers = range(2, _MOST + 1) if states is None else (states,)
    for n in numbers:
        found = _fitted(tau, n)
        if found.gain_error <= WITHIN[0] and found.phase_error <= WITHIN[1]:
            return found
    if states is not None:
        return found
    raise InvalidInput(
        f"the rational model of a solid core of tau = {tau:.3g} sqrt(s) is "
        f"{found.gain_error:.2g} dB and {found.phase_error:.2g} deg off with {_MOST} states, more "
        f"than {WITHIN[0]:g} dB and {WITHIN[1]:g} deg; correct the core's conductivity, "
        "permeability and radii"
    )


def _fitted(tau: float, n: int) -> Lags:
    """Least squares of gain and phase errors over their bounds, then of their higher powers, which
    levels them.
    """
    omega = 2 * np.pi * np.geomspace(*BAND, _POINTS)
    wanted = half_order(omega, tau)

    def unpacked(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g = np.exp(x[:n] - x[:n].max())
        return g / g.sum(), np.exp(x[n:])

    def errors(x: np.ndarray) -> np.ndarray:
        ratio = np.log(_response(omega, *unpacked(x)) / wanted)
        # 20 log10 of the gain in dB, the angle in degrees
        gain = ratio.real * 20 / math.log(10) / WITHIN[0]
        return np.concatenate([gain, np.degrees(ratio.imag) / WITHIN[1]])

    low, high = 2 * np.pi * BAND[0] / 10**0.5, 2 * np.pi * BAND[1] * 10**_WIDE
    poles = np.geomspace(low, high, n)
    # rho dp at the nodes, over p for the gain of each lag
    rho = tau * np.sqrt(poles) / (np.pi * (1 + tau**2 * poles))
    start = np.concatenate([np.log(rho), np.log(poles)])
    from scipy.optimize import least_squares

    found = least_squares(errors, start, max_nfev=200).x
    for power in (2, 4):
        found = least_squares(
            lambda x, p=power: np.sign(errors(x)) * np.abs(errors(x)) ** p, found, max_nfev=60
        ).x
    weights, poles = unpacked(found)
    order = np.argsort(poles)
    weights, poles = weights[order], poles[order]
    fine = 2 * np.pi * np.geomspace(*BAND, 2000)
    ratio = np.log(_response(fine, weights, poles) / half_order(fine, tau))
    everywhere = np.geomspace(1e-6, 1e12, 4000)
    rest = np.abs(_response(everywhere, weights, poles) - half_order(everywhere, tau)).max()
    return Lags(
        weights,
        poles,
        float(np.abs(ratio.real).max() * 20 / math.log(10)),
        float(np.degrees(np.abs(ratio.imag)).max()),
        float(rest),
    )


def core_constant(
    conductivity: float,
    permeability: float,
    inner: tuple[float, float],
    outer: tuple[float, float],
    slot: float,
) -> float:
    """c [A sqrt(s)/Wb] of one side: conductivity [S/m], relative permeability, radii [m] of the
    inner and of the outer pole's face (inner, outer edge), depth of the coil's slot [m].

    The inner cylinder's flux runs in the skin at its outer edge, the outer cylinder's at its inner
    edge, back wall and collar as discs between the two.
    """
    mu = 4e-7 * math.pi * permeability
    r_i, r_o = inner[1], outer[0]
    surfaces = slot / r_i + 2 * math.log(r_o / r_i) + slot / r_o
    return math.sqrt(conductivity / mu) * surfaces / (2 * math.pi)
