"""The plant of one levitated axis in samples, and the predictor of its displacement.

Between samples, with the input held (zero-order hold),

    y'' = a y + b w(t) + f,    T w' + w = u(t - tau),

a > 0: it falls, with the pole p = sqrt(a); f is a constant force over mass (the weight, an
offset). T = 0: no actuator. In samples, exactly,

    A(q) y = B(q) u + c + C(q)/D(q) e,    A = 1 - 2 cosh(p h) q^-1 + q^-2,

h the sample time, e white. Process noise (forces) and sensor noise, each white, give C of order 2
and D = 1: the innovations form of the Kalman filter, whose noise shares the plant's unstable pole,
so that the predictor

    e = D/C (A y - B u - c)

is stable although the plant is not (Ljung, System Identification, 2nd ed., 1999, sections 4.2 and
13.4: the direct method in closed loop, consistent where the noise model holds the truth). Coloured
forces ask for more of C and D.

Everything here is in the record's own scale: time in samples, y and u over their deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

STIFFNESS, GAIN, DELAY, LAG = range(4)  # places of a, b, tau and T among the unknowns
_AHEAD = -0.8  # samples, the smallest delay
_SLOWEST = 0.998  # root of the noise model: a predictor forgets its start in 500 samples


@dataclass(frozen=True, slots=True)
class Structure:
    """What is unknown: ``lag``: a first-order actuator; ``colour``: orders of C beyond 2, and
    of D.

    The unknowns, in this order: a [1/sample^2], b, tau [samples], T [samples] with lag, c, then the
    coefficients of C (2 + colour) and of D (colour) after their leading 1.
    """

    lag: bool = False
    colour: int = 0

    @property
    def plant(self) -> int:
        """How many unknowns are the plant's."""
        return 3 + self.lag

    @property
    def size(self) -> int:
        return self.plant + 3 + 2 * self.colour

    def split(self, unknowns: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
        """The plant's unknowns, c, and the polynomials C and D."""
        noise = unknowns[self.plant + 1 :]
        ahead = 2 + self.colour
        numerator = np.concatenate([[1.0], noise[:ahead]])
        denominator = np.concatenate([[1.0], noise[ahead:]])
        return unknowns[: self.plant], float(unknowns[self.plant]), numerator, denominator


def own_polynomial(stiffness: float) -> np.ndarray:
    """A (3,): 1 - 2 cosh(sqrt(a)) q^-1 + q^-2, with the cosine where a < 0."""
    root = np.sqrt(complex(stiffness))
    return np.array([1.0, -2.0 * np.cosh(root).real, 1.0])


def input_polynomials(plant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """B over its own denominator (1 with T = 0), from the exact step from sample to sample.

    With tau = d + r samples, 0 <= r < 1, the input of the last sample but one acts for r, the last
    one for the rest:

        x+ = Phi x + Gamma_1 u[k-d-1] + Gamma_0 u[k-d],
        Gamma_0 = integral_0^(1-r) e^(F s) G ds,   Gamma_1 = e^(F (1-r)) integral_0^r e^(F s) G ds.
    """
    stiffness, gain, delay = plant[:3]
    lag = plant[LAG] if len(plant) > LAG else 0.0
    whole = int(np.floor(delay))
    part = delay - whole
    if lag > 0:
        F = np.array([[0, 1, 0], [stiffness, 0, gain], [0, 0, -1 / lag]])
        G = np.array([0, 0, 1 / lag])
    else:
        F = np.array([[0.0, 1.0], [stiffness, 0.0]])
        G = np.array([0.0, gain])
    early, early_step = _step(F, G, 1 - part)
    _, late_step = _step(F, G, part)
    Phi, _ = _step(F, G, 1.0)
    gammas = (early_step, early @ late_step)
    # B from the first Markov parameters: B = (denominator * impulse response), cut at the order
    order = len(F)
    denominator = own_polynomial(stiffness)
    actuator = np.array([1.0, -np.exp(-1 / lag)]) if lag > 0 else np.ones(1)
    whole_denominator = np.convolve(denominator, actuator)
    numerator = np.zeros(whole + order + 2)
    for shift, gamma in enumerate(gammas):
        state = gamma
        markov = np.zeros(order + 1)
        for k in range(order):
            markov[k + 1] = state[0]
            state = Phi @ state
        polynomial = np.convolve(whole_denominator, markov)[: order + 1]
        numerator[whole + shift : whole + shift + order + 1] += polynomial
    return numerator, actuator


def _step(F: np.ndarray, G: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """e^(F t) and integral_0^t e^(F s) G ds."""
    n = len(F)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n] = F
    block[:n, n] = G
    exponential = expm(block * time)
    return exponential[:n, :n], exponential[:n, n]


def equation_error(
    structure: Structure, unknowns: np.ndarray, y: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """A y - B u - c (n,); the first samples, which know no past, are left at 0."""
    plant, constant, _, _ = structure.split(unknowns)
    # u is taken a sample ahead, so that a delay near zero may be searched from both sides
    shifted = plant.copy()
    shifted[DELAY] += 1
    numerator, actuator = input_polynomials(shifted)
    driven = lfilter(numerator, actuator, np.append(u[1:], u[-1]))
    own = lfilter(own_polynomial(plant[STIFFNESS]), [1.0], y)
    left = own - driven - constant
    left[: len(numerator)] = 0.0
    return np.asarray(left)


def innovations(
    structure: Structure, unknowns: np.ndarray, y: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """e = D/C (A y - B u - c), (n,)."""
    _, _, C, D = structure.split(unknowns)
    return np.asarray(lfilter(D, C, equation_error(structure, unknowns, y, u)))


def largest_root(polynomial: np.ndarray) -> float:
    """Largest magnitude of its roots in z; below 1: the filter 1/polynomial is stable."""
    if len(polynomial) < 2:
        return 0.0
    return float(np.abs(np.roots(polynomial)).max())


def admissible(structure: Structure, unknowns: np.ndarray) -> bool:
    """Whether the predictor is stable, the lag positive, and y not before u but for a skew."""
    plant, _, C, D = structure.split(unknowns)
    if not _AHEAD <= plant[DELAY] < 60 or not abs(plant[STIFFNESS]) < 4:
        return False
    if structure.lag and not 1e-3 < plant[LAG] < 200:
        return False
    return largest_root(C) < _SLOWEST and largest_root(D) < _SLOWEST
