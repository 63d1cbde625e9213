"""What lines resolve of a closed loop: its predicted resonances, how wide each is, and what rises
between two lines.

A pole s of the loop makes a resonance at Im s that is -2 Re s wide at half its power. A polynomial
of second order over a band B about it errs by 3/35 (B/width)^4 of its height: of x^4, the first
power that it lacks at the centre, x from -1 to 1 over the band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.law.loop import closed_loop
from ambrose.model.plant import Plant

_SHARP = 0.3  # damping ratio below which a pole makes a peak
_HIGH = 0.5  # of the largest predicted sensitivity, below which a resonance decides nothing
_OUT = 0.05  # by which a resonance stands out of what is beside it
_OFF = 0.02  # of its frequency, by which the true resonance may lie elsewhere; assumed
_PER_WIDTH, _MOST = 4, 40  # lines over the width of a resonance, and in all for one
_POINTS = 6  # of the prediction between two lines


@dataclass(frozen=True, slots=True)
class Resonance:
    """frequency and width at half power [rad/s]."""

    frequency: float
    width: float

    @property
    def reach(self) -> float:
        """How far from its frequency [rad/s] it shows, also where it lies a little elsewhere."""
        return max(2 * self.width, _OFF * self.frequency)

    @property
    def band(self) -> tuple[float, float, float]:
        """Between which frequencies it shows, and the widest band that follows it [rad/s]: over its
        own width a polynomial errs by 3/35 of its height, over more of it by the fourth power.
        """
        return self.frequency - self.reach, self.frequency + self.reach, self.width

    def lines(self) -> list[float]:
        """Frequencies [rad/s] that show it."""
        reach = self.reach
        count = min(int(2 * reach * _PER_WIDTH / self.width) + 1, _MOST)
        return [float(w) for w in self.frequency + np.linspace(-reach, reach, count) if w > 0]


def predicted_resonances(plant: Plant, law: StateSpace, highest: float) -> list[Resonance]:
    """Those up to ``highest`` [rad/s] that may make the largest sensitivity of the sampled loop."""
    z = poles(closed_loop(plant, law))
    s = np.log(z[np.abs(z) > 0]) / (law.dt or 1.0)
    s = s[(s.imag > 0) & (s.imag < highest) & (s.real < 0)]
    s = s[-s.real < _SHARP * np.abs(s)]
    if not len(s):
        return []

    # sigma_max at each resonance and three half-widths beside it, and over the whole range
    at = s.imag[:, None] - 3 * s.real[:, None] * np.array([-1.0, 0.0, 1.0])
    height = _sigma(plant, law, np.clip(at, 1e-3, None).ravel()).reshape(-1, 3)
    largest = max(
        float(height[:, 1].max()), float(_sigma(plant, law, np.geomspace(10, highest, 200)).max())
    )
    told = (height[:, 1] > _HIGH * largest) & (
        height[:, 1] > height[:, [0, 2]].min(axis=1) + _OUT * largest
    )
    return [Resonance(float(p.imag), float(-2 * p.real)) for p in s[told]]


def between(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    """By what factor (w - 1, a + 1) the predicted |S_ii| and sigma_max rise between two lines above
    both ends.
    """
    share = np.arange(1, _POINTS + 1) / (_POINTS + 1)
    inner = omega[:-1, None] + np.diff(omega)[:, None] * share
    ends, inside = (_sizes(plant, law, w) for w in (omega, inner.ravel()))
    top = inside.reshape(len(inner), _POINTS, -1).max(axis=1)
    return np.asarray(np.maximum(top / np.maximum(ends[:-1], ends[1:]), 1.0))


def risen(high: np.ndarray, factor: np.ndarray) -> float:
    """The largest of values (w,) at the lines and, by ``factor`` (w - 1,), between them."""
    inner = np.maximum(high[:-1], high[1:]) * factor
    return float(max(high.max(), inner.max(initial=0.0)))


def _sizes(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    S = _sensitivity(plant, law, omega)
    own = np.abs(np.einsum("wii->wi", S))
    return np.column_stack([own, np.linalg.norm(S, 2, axis=(1, 2))])


def _sigma(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(_sensitivity(plant, law, omega), 2, axis=(1, 2)))


def _sensitivity(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    # S_o = (I + G K)^-1 with G sampled through its hold
    held = c2d(select(plant.system, plant.named("u"), plant.named("y")), law.dt or 1.0)
    G, K = (frequency_response(system, omega).values for system in (held, law))
    return np.asarray(np.linalg.inv(np.eye(len(plant.axes)) + G @ K))
