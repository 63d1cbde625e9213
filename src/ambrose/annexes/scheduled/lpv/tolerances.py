"""LPV control with the tolerances inside: turns of a scheduled synthesis and a constant scaling D
for every grid point.

Uncertain parameters delta within -1 .. 1 stand in the plants as blocks, w = delta z. Whatever they
do in time, and whichever D belongs to the value that the scheduling parameter has at that instant,
z^T D^2 z - w^T D^2 w >= 0. An LPV controller for the plants with D on z and D^-1 on w, of the gain
gamma, therefore keeps its performance to gamma for all tolerances divided by gamma, however
parameter and tolerances move (scaled bounded real lemma; Apkarian & Gahinet 1995, IEEE Trans.
Automatic Control 40). K-step: that controller. D-step: at every grid point the constant D with the
smallest peak of sigma_max(D M D^-1). The turns are judged by what is asked for: stability and
output sensitivity at the corners of the tolerances themselves, of which D, blind to what is real
and what stands still, knows nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ambrose.annexes.scheduled.lpv.synthesis import PlantAt
from ambrose.core.checks import NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant, design_grid, lft
from ambrose.core.scheduled import ScheduledSystem, grid_points
from ambrose.core.scheduled import corners as around
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.core.worst_case.loop import box_loop, corners, default_grid, gains
from ambrose.judge.result import Synthesis
from ambrose.law.design_problem import with_performance_block

_TURNS = 3  # K-steps with one control weight; more were never better
_BACKOFF = 1.2  # nearer to the optimum the second pass of a scaled problem fails
_POWERS = (10.0, 30.0, 100.0)  # of the norm that stands for the peak over frequency
_PER_DECADE = 30  # frequencies at which corners are judged


@dataclass(frozen=True, slots=True, eq=False)
class Worst:
    """The largest output sensitivity found (inf: a member is unstable), and how many of how many
    members are unstable.

    No members: the loop is unstable without any deviation.
    """

    sensitivity: float
    unstable: int
    members: int


def tolerant_lpv(
    plants: Sequence[PlantAt],
    axes: tuple[np.ndarray, ...],
    synthesis: Callable[[PlantAt, float], Synthesis],
    judge: Callable[[ScheduledSystem], Worst],
    limit: float,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Synthesis, Worst, int, bool]:
    """The scheduled controller that ``judge`` finds best, the place of its plants, and whether D
    was in its problem.

    plants: the uncertain problem of a parameter's value with blocks, one function for each control
    weight to try, the most careful first; one follows the other until the judged sensitivity is at
    most ``limit``. synthesis: of plants without blocks, at a back-off. A turn that is unstable
    without any deviation is the last. Ctrl-C ends the turns: the best so far is returned,
    ``stopped_early`` says so. Raises NumericalFailure where no turn is stable without deviations.
    """
    best: tuple[Synthesis, Worst, int, bool] | None = None
    reason = ""
    try:
        for place, plant_at in enumerate(plants):
            problem = _Scaled(plant_at, axes)
            for turn in range(_TURNS):
                try:
                    result = synthesis(problem.plant, _BACKOFF)
                except NumericalFailure as failure:
                    reason = f"{failure}; narrow the tolerances"
                    say(f"turn {turn + 1} failed: {reason}")
                    break
                worst = judge(result.law)  # type: ignore[arg-type]
                if not worst.members:
                    reason = (
                        "it is unstable without any deviation on a model with more bending modes; "
                        "take more into the design"
                    )
                    raise _Lost
                say(
                    f"turn {turn + 1}: gamma {result.gamma:.3f}, {worst.unstable} of "
                    f"{worst.members} members of the tolerances "
                    f"unstable, sigma_max(S_o) {worst.sensitivity:.3f}"
                )
                if best is None or _order(worst) < _order(best[1]):
                    best = result, worst, place, turn > 0
                elif turn:
                    break
                problem.rescale(result.law)  # type: ignore[arg-type]
            if best is not None and best[1].sensitivity <= limit:
                break
    except _Lost:
        say(f"turn {turn + 1}: {reason}")
    except KeyboardInterrupt:
        if best is None:
            raise
        best = (replace(best[0], stopped_early="interrupted"), *best[1:])
    if best is None:
        raise NumericalFailure(f"no scheduled controller for these tolerances was found: {reason}")
    return best


class _Lost(Exception):
    """Further turns would only be faster, and worse."""


def _order(worst: Worst) -> tuple[int, float]:
    return worst.unstable, worst.sensitivity


class _Scaled:
    """The problems with D around them: log D at the grid's values, linear in between; at first that
    of the loop without any.
    """

    def __init__(self, plant_at: PlantAt, axes: tuple[np.ndarray, ...]) -> None:
        self._plant_at = plant_at
        self._axes, self._values = axes, grid_points(axes)
        self._kept: dict[Any, GeneralizedPlant] = {}
        first = self.uncertain(self._values[0])
        self._log_d = np.zeros((len(self._values), len(first.blocks)))
        self._nominal = True

    def uncertain(self, value: Any) -> GeneralizedPlant:
        if value not in self._kept:
            self._kept[value] = with_performance_block(self._plant_at(value))
        return self._kept[value]

    def plant(self, value: Any) -> GeneralizedPlant:
        """The scaled problem at a value of the parameter, without blocks; before the first D the
        performance alone.
        """
        plant = self.uncertain(value)
        if self._nominal:
            last = plant.blocks[-1]
            w, z = plant.w[-last.n_w :], plant.z[-last.n_z :]
            return GeneralizedPlant(
                select(plant.system, [*w, *plant.u], [*z, *plant.y]), w, plant.u, z, plant.y
            )

        # log D is linear between the grid's values; D_z on the rows of z, D_w^-1 on the columns
        # of w.
        index, share = around(self._axes, np.atleast_1d(value)[None])
        d = np.exp(share[0] @ self._log_d[index[0]])
        d_w, d_z = _spread(plant, d)
        s = plant.system
        q = len(plant.w)
        r = len(plant.z)
        B = s.B.copy()
        C = s.C.copy()
        D = s.D.copy()
        B[:, :q], D[:, :q] = B[:, :q] / d_w, D[:, :q] / d_w
        C[:r], D[:r] = C[:r] * d_z[:, None], D[:r] * d_z[:, None]
        return GeneralizedPlant(replace(s, B=B, C=C, D=D), plant.w, plant.u, plant.z, plant.y)

    def rescale(self, law: ScheduledSystem) -> None:
        """The D-step."""
        self._nominal = False
        for i, value in enumerate(self._values):
            plant = self.uncertain(value)
            M = frequency_response(lft(plant, law.at(value)), design_grid(plant)).values
            self._log_d[i] = constant_scaling(plant, M, self._log_d[i])


def _spread(plant: GeneralizedPlant, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d of the blocks on their signals w and z."""
    return tuple(np.repeat(d, [getattr(b, side) for b in plant.blocks]) for side in ("n_w", "n_z"))  # type: ignore[return-value]


def constant_scaling(plant: GeneralizedPlant, M: np.ndarray, log_d: np.ndarray) -> np.ndarray:
    """log d (blocks,), the last 0, with the smallest peak of sigma_max(D M D^-1) over M (w, n_z,
    n_w) that descent finds.
    """
    which = np.arange(len(plant.blocks), dtype=float)
    of_w, of_z = (side.astype(int) for side in _spread(plant, which))
    count = len(which)

    def cost(x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        # ln of the p-norm over frequency of sigma_1(D M D^-1), over its peak, for powers in range
        d = np.exp(np.append(x, 0.0))
        U, s, Vh = np.linalg.svd(M * d[of_z][:, None] / d[of_w])
        top = s[:, 0].max()
        share = (s[:, 0] / top) ** power
        total = share.sum()

        # d ln sigma_1 = sum |u_k|^2 d ln d_z,k - sum |v_k|^2 d ln d_w,k, added up by block
        left = (share / total) @ np.abs(U[:, :, 0]) ** 2
        right = (share / total) @ np.abs(Vh[:, 0]) ** 2
        slope = np.bincount(of_z, left, count) - np.bincount(of_w, right, count)
        return float(np.log(total) / power + np.log(top)), slope[:-1]

    # D matters up to a factor: the last is 1. Low powers first, for the peak alone is not smooth.
    x = log_d[:-1] - log_d[-1]
    for power in _POWERS:
        x = minimize(
            cost, x, args=(power,), jac=True, method="L-BFGS-B", options={"maxiter": 300}
        ).x
    return np.append(x, 0.0)


def worst_corners(units: Mapping[Any, GeneralizedPlant], law: ScheduledSystem) -> Worst:
    """The largest output sensitivity of the frozen loops at the corners of the tolerances (and at
    their middle).

    units: the open problem with all weights and scales 1 at each value that is looked at
    (``problem.unit_problem``).
    """
    worst = 0.0
    unstable = 0
    members = 0
    for value, unit in units.items():
        closed = lft(unit, law.at(value))
        if not is_stable(closed):
            return Worst(np.inf, 0, 0)
        a = len(unit.u)
        w = list(unit.w)
        z = list(unit.z)

        # After the blocks w1 (a) at u and w2 at y, z1 (a) = err and z2 = u: w2 -> z1 is -S_o.
        loop = box_loop(
            select(
                closed, w[: unit.n_w_blocks] + w[unit.n_w_blocks + a :], z[: unit.n_z_blocks + a]
            ),
            unit.blocks,
        )

        # delta at all corners; an unstable member is counted, and left out of the gains
        every = corners(loop.parameters)
        stable = np.array([_holds(loop.system, delta[loop.owner]) for delta in every])
        unstable, members = unstable + int((~stable).sum()), members + len(every)
        omega = default_grid(loop, _PER_DECADE)
        corner_gains = gains(
            loop.at(omega), loop, np.vstack([np.zeros(loop.parameters), every[stable]])
        )
        worst = max(worst, float(corner_gains.max()))
    return Worst(worst if not unstable else np.inf, unstable, members)


def _holds(system: StateSpace, delta: np.ndarray) -> bool:
    n = len(delta)

    # w = delta z, z = C x + D w:   x' = (A + B delta (I - D delta)^-1 C) x
    inner = np.linalg.solve(np.eye(n) - system.D[:n, :n] * delta, system.C[:n])
    return bool(np.linalg.eigvals(system.A + (system.B[:, :n] * delta) @ inner).real.max() < 0)
