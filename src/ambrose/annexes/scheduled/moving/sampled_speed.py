"""Plant and sampled law while the speed changes: the loop as it runs, from sample to sample.

With the currents u held over a sample of dt, (x, u)' = N (x, u), N = [A(Omega), B; 0, 0], the
plant goes from sample to sample by P = exp(N dt); the law, sampled and late, by its own matrices.
Omega is the mean of the speed over a sample, which changes by at most rate dt from one to the next.
From it the speed within the sample is off by r(t) of mean zero, int |r| <= rate dt^2/4, and P by

    int K(t) r(t) dt = int (K(t) - K(dt/2)) r(t) dt,    K(t) = e^(N (dt - t)) dN/dOmega e^(N t),

to first order in rate dt, a few thousandths of a rad/s. A schedule is told the speed at the sample,
which is within rate dt/2 of the mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy.linalg as sla

from ambrose.annexes.scheduled.moving.law import MovingLaw
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace, select
from ambrose.core.varying.sampled import SampledLoop
from ambrose.law.timing import Timing
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.reduce import free_mode_reduction

_WITHIN = (0.0, 0.25, 0.75, 1.0)  # of a sample, where K is compared with that in the middle
_FURTHER = 1.1  # of the largest found, for what lies between


class SampledFamily:
    """Plant and law along speeds; point_at: speed [rad/s] -> operating point; modes: bending modes
    per plane, None: the full plant.
    """

    def __init__(
        self,
        plant: Plant,
        point_at: Callable[[float], OperatingPoint],
        law: MovingLaw,
        timing: Timing,
        modes: int | None,
    ) -> None:
        self.plant = plant
        self.point_at = point_at
        self.law = law
        self.timing = timing
        self.modes = modes
        system = self._open(plant.point.speed)
        if system.D.any():
            raise InvalidInput(
                "the currents reach the sensors at once; give the amplifier a bandwidth in the "
                "machine file"
            )
        self.C = system.C
        self.n = system.n_states
        self.at = lru_cache(maxsize=4096)(self._at)

    def _open(self, speed: float) -> StateSpace:
        """u -> y."""
        own = replace(self.plant, point=self.point_at(speed))
        small = (
            assemble(own.machine, own.point)
            if self.modes is None
            else free_mode_reduction(own, self.modes)
        )
        return select(small.system, list(small.named("u")), list(small.named("y")))

    def _generator(self, speed: float) -> np.ndarray:
        """N of (x, u)."""
        system = self._open(speed)
        q = system.B.shape[1]
        return np.pad(np.hstack([system.A, system.B]), ((0, q), (0, 0)))

    def controller(self, speed: float) -> StateSpace:
        """The law as it runs: sampled and late at the values of a schedule, linear between them."""
        law, timing = self.law, self.timing
        if law.grid is None:
            return timing.in_loop(law.at(speed))
        k = int(np.clip(np.searchsorted(law.grid, speed) - 1, 0, len(law.grid) - 2))
        low, high = float(law.grid[k]), float(law.grid[k + 1])
        share = (speed - low) / (high - low)
        a, b = timing.in_loop(law.at(low)), timing.in_loop(law.at(high))
        A, B, C, D = (
            (1 - share) * getattr(a, name) + share * getattr(b, name)
            for name in ("A", "B", "C", "D")
        )
        return StateSpace(A, B, C, D, a.inputs, a.outputs, a.dt)

    def _reads(self, K: StateSpace) -> np.ndarray:
        """(x, u) over (x, x_K, d), u = C_K x_K - D_K (C x + d)."""
        u = np.hstack([-K.D @ self.C, K.C, -K.D])
        return np.vstack([np.eye(self.n, u.shape[1]), u])

    def _around(self, P: np.ndarray, K: StateSpace) -> np.ndarray:
        """[A, B] of the loop with P of the plant and the law K."""
        # x_K+ = A_K x_K - B_K (C x + d)
        return np.vstack([P[: self.n] @ self._reads(K), np.hstack([-K.B @ self.C, K.A, -K.B])])

    def _at(self, speed: float) -> np.ndarray:
        P = sla.expm(self._generator(speed) * self.timing.sample_time)
        return self._around(P, self.controller(speed))

    def frozen(self, speed: float) -> StateSpace:
        """d -> y + d at one speed."""
        return self.loop(0.0).system(speed)

    def loop(self, rate: float) -> SampledLoop:
        """The loop for a speed that changes at up to ``rate`` [rad/s^2]."""
        k = self.controller(self.plant.point.speed).n_states
        C = np.pad(self.C, ((0, 0), (0, k)))
        beside = lambda low, high: self._within(low, high, rate)  # noqa: E731
        return SampledLoop(self.at, beside, C, self.timing.sample_time)

    def _within(self, low: float, high: float, rate: float) -> list[np.ndarray]:
        """What the change of the speed within a sample makes of [A, B]: in the plant, in the
        law.
        """
        middle, dt = (low + high) / 2, self.timing.sample_time
        N, K = self._generator(middle), self.controller(middle)
        slope = (self._generator(high) - self._generator(low)) / (high - low)
        kernels = [
            sla.expm(N * (1 - t) * dt) @ slope @ sla.expm(N * t * dt) for t in (0.5, *_WITHIN)
        ]
        moved = np.array(kernels[1:]) - kernels[0]
        plant = moved[:, : self.n] @ self._reads(K) * (_FURTHER * rate * dt**2 / 4)
        plant = np.pad(plant, ((0, 0), (0, K.n_states), (0, 0)))
        if self.law.grid is None:
            return [plant]
        P = sla.expm(N * dt)
        told = self._around(P, self.controller(high)) - self._around(P, self.controller(low))
        return [plant, told[None] * (_FURTHER * rate * dt / 2 / (high - low))]
