"""From measured signals to the regression's: notch and high-pass on what is measured, then the
filters of model.py.

All filters are linear, so that the notch on y, v and e is the same notch on the prediction error,
the regressors and the instruments. The instruments are the regressors of a simulated loop, driven
by the recorded excitation alone: no noise, gas force or unbalance is in them, and none biases the
estimate (Soderstrom & Stoica 1983, Instrumental Variable Methods, sec. 5.3).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ambrose.annexes.scheduled.seal_monitor.model import Direction, SealModel
from ambrose.core.response import simulate
from ambrose.core.statespace import StateSpace

HIGH_PASS, NOTCH = 2 * np.pi * 5.0, 2 * np.pi * 4.0  # [rad/s]: corner; width of a notch


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """Biquads in series on every signal: rows b0, b1, b2, a1, a2; settled after ``settling``
    [s].
    """

    sections: np.ndarray
    settling: float


def measuring_filter(speed: float, dt: float, harmonics: int = 3) -> Filter:
    """High-pass of second order and notches at 1x to ``harmonics`` x of speed [rad/s], as far as
    the samples carry them.
    """
    # Bilinear, s = (1 - z^-1)/(1 + z^-1) with tan(w dt/2) for w:   s^2/(s^2 + sqrt(2) c s + c^2)
    c = np.tan(HIGH_PASS * dt / 2)
    a0 = 1 + np.sqrt(2) * c + c * c
    rows = [[1 / a0, -2 / a0, 1 / a0, 2 * (c * c - 1) / a0, (1 - np.sqrt(2) * c + c * c) / a0]]

    # (s^2 + w^2)/(s^2 + beta s + w^2) at every harmonic
    tones = [k * speed for k in range(1, harmonics + 1) if HIGH_PASS < k * speed < 0.8 * np.pi / dt]
    for tone in tones:
        w, beta = np.tan(tone * dt / 2), np.tan(NOTCH * dt / 2)
        a0 = 1 + beta + w * w
        b1 = 2 * (w * w - 1) / a0
        rows.append([(1 + w * w) / a0, b1, (1 + w * w) / a0, b1, (1 - beta + w * w) / a0])

    # decay rates [1/s] of the high-pass and of a notch
    slowest = min([HIGH_PASS / np.sqrt(2), *[NOTCH / 2 for _ in tones]])
    return Filter(np.array(rows), 9.0 / slowest)


@dataclass(slots=True)
class Signals:
    """The regression's signals of successive stretches of a record; holds the filters' states
    between them.
    """

    model: SealModel
    filter: Filter
    _states: dict[str, np.ndarray] = field(default_factory=dict)

    def follow(self, y: np.ndarray, v: np.ndarray, e: np.ndarray) -> dict[str, np.ndarray]:
        """y (p, k) [m], command v = u + e (m, k) [A] and excitation e (m, k) [A] of the next
        stretch.

        Returns, whitened: error (p, k), r1 (q, p, k) and r2 (q q, p, k), doubts (c, p, k),
        instruments (q, p, k).
        """
        from scipy.signal import sosfilt

        s = self.filter.sections
        sos = np.hstack([s[:, :3], np.ones((len(s), 1)), s[:, 3:]])
        signals = np.vstack([y, v, e])
        if "filter" not in self._states:  # as if it had always been as it is now
            self._states["filter"] = np.zeros((len(sos), len(signals), 2))
            self._states["offset"] = np.r_[signals[: len(y) + len(v), 0], np.zeros(len(e))]
        filtered, self._states["filter"] = sosfilt(
            sos, signals - self._states["offset"][:, None], zi=self._states["filter"]
        )
        y, v, e = np.split(filtered, [len(y), len(y) + len(v)])

        model = self.model
        W = self.model.W
        C = self.model.C

        # x^+ = (A - L C) x^ + B v + L y,   e = y - C x^
        x = self._step("observer", model.observer, np.hstack([model.B, model.L]), np.vstack([v, y]))
        out = {"error": W @ (y - C @ x)}

        # phi_g driven by D_g x^ + N_g v
        parts = [self._driven(f"1 {g}", d, x, v) for g, d in enumerate(model.unknown)]
        out["r1"] = np.stack([W @ C @ part for part in parts])

        # phi_gh driven by D_g phi_h + D_gh x^ + N_gh v; g outside, h inside, as in ``squares``
        pairs = [(d, part) for d in model.unknown for part in parts]
        bent = [square.D @ x + square.N @ v for square in model.squares]
        twice = [self._driven(f"2 {i}", *pair, into=bent[i]) for i, pair in enumerate(pairs)]
        out["r2"] = np.stack([W @ C @ part for part in twice])

        doubts = [W @ C @ self._driven(f"doubt {c}", d, x, v) for c, d in enumerate(model.doubts)]
        out["doubts"] = np.stack(doubts) if doubts else np.zeros((0, *y.shape))

        # instruments: as r1, from the simulated loop that the excitation alone drives
        x, v = self._loop(e)
        out["instruments"] = np.stack(
            [W @ C @ self._driven(f"z {g}", d, x, v) for g, d in enumerate(model.unknown)]
        )

        return out

    def _driven(
        self,
        name: str,
        direction: Direction,
        x: np.ndarray,
        v: np.ndarray | None = None,
        into: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        driven = into + direction.D @ x + (0 if v is None else direction.N @ v)
        return self._step(name, self.model.observer, np.eye(len(driven)), driven)

    def _step(self, name: str, A: np.ndarray, B: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The states x (n, k) of x+ = A x + B u."""
        n = len(A)
        into = B @ u
        x = simulate(
            StateSpace(A, np.eye(n), np.eye(n), np.zeros((n, n)), dt=1.0),
            into,
            x0=self._states.get(name, np.zeros(n)),
        )
        # the state that the next stretch begins with
        self._states[name] = A @ x[:, -1] + into[:, -1]
        return x

    def _loop(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States and command of the simulated loop."""
        model, law = self.model, self.model.law
        n, x = len(model.A), self._step("loop", *model.loop, e)
        # v = u + e = C_k x_k - D_k C x + e
        return x[:n], law.C @ x[n:] - law.D @ model.C @ x[:n] + e
