"""The structured singular value over frequency: a grid, refined until its peak is no artefact of
it.

What is returned is still "on the grid"; ``all_frequencies.proved_level`` proves a level between the
points, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid, named_failure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import Block
from ambrose.core.mu.lower import lower_bound
from ambrose.core.mu.structure import Structure, check_matrix, structure_of
from ambrose.core.mu.upper import upper_bound
from ambrose.core.presentation import Presented
from ambrose.core.statespace import as_statespace, poles

_ROUNDS = 12  # of the refinement of a peak

Response = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MuPeak(Presented):
    """The largest bounds found on a refined grid.

    upper at frequency [rad/s]; lower at lower_frequency [rad/s], with delta (n_w, n_z) that proves
    it (NaN when lower is 0); omega (w,) [rad/s] the refined grid and values (w,) the upper bound
    there; resolved: whether a finer grid would change ``upper`` by less than the tolerance, judged
    by its neighbours (a judgement, no proof).
    """

    _FACTS: ClassVar = ("upper", "frequency", "lower", "lower_frequency", "resolved")

    upper: float
    frequency: float
    lower: float
    lower_frequency: float
    delta: np.ndarray
    omega: np.ndarray
    values: np.ndarray
    resolved: bool


def _response(system: Any, structure: Structure) -> Response:
    """M(omega) from a system or a callable, checked against the blocks."""
    if callable(system) and not hasattr(system, "A"):
        return lambda omega: check_matrix(system(omega), structure)
    state_space = as_statespace(system)
    return lambda omega: check_matrix(frequency_response(state_space, omega).values, structure)


def _grid(omega: ArrayLike, system: Any) -> np.ndarray:
    """The sorted grid; a system's resonances inside it are added."""
    grid = np.unique(check_shape(omega, "omega", "(w)").astype(float))
    if len(grid) < 3 or grid[0] < 0:
        raise invalid(
            "omega",
            f"{len(grid)} frequencies from {grid.min(initial=0):g}",
            "3 or more, none negative",
            "widen it",
        )
    if hasattr(system, "A"):
        p = poles(system)
        dt = getattr(system, "dt", None)
        if dt:
            # s = log(z) / dt; a pole at z = 0 has none
            p = np.log(p[np.abs(p) > 0].astype(complex)) / dt
        extra = np.abs(p[p.imag > 0].imag)
        grid = np.unique(np.concatenate([grid, extra[(extra > grid[0]) & (extra < grid[-1])]]))
    return grid


def _between(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Geometric middle, arithmetic from zero."""
    return np.where(low > 0, np.sqrt(low * high), 0.5 * (low + high))


@named_failure("the peak of the structured singular value")
def mu_peak(
    system: Any,
    blocks: Sequence[Block],
    omega: ArrayLike,
    *,
    lower: bool = True,
    tolerance: float = 1e-4,
    max_points: int = 3000,
) -> MuPeak:
    """The peak of mu over frequency, refined around the high local maxima of its upper bound until
    they stand still.

    system: a system from w to z (or a callable, omega (w,) [rad/s] -> M (w, n_z, n_w)). omega (w,)
    [rad/s]: the starting grid. Points are added halfway to the neighbours of every local maximum
    within 10 % of the largest, and once between all neighbours of which one is above half the
    largest. The result is a statement on the final grid, its upper bound to ``tolerance`` where
    ``resolved``.

    Raises InvalidInput when blocks and system do not fit, or a frequency coincides with a pole.
    """
    structure = structure_of(blocks)
    check_positive(tolerance, "tolerance", "use something like 1e-4")
    respond = _response(system, structure)

    # at points (w,): the upper bound, and the direction in which it is tight (w, n_w)
    def bound(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = upper_bound(respond(points), structure, tolerance=tolerance / 4)
        return found.value, found.worst

    grid = _grid(omega, system)
    values, tight = bound(grid)
    resolved = False
    for count in range(_ROUNDS):
        # Which gaps are halved: the first time all those beside a value above half the largest,
        # then those beside the high local maxima.
        top = values.max()
        if count == 0:
            chosen = np.maximum(values[:-1], values[1:]) > 0.5 * top
        else:
            padded = np.concatenate([[-np.inf], values, [-np.inf]])
            high = (values >= padded[:-2]) & (values >= padded[2:]) & (values > 0.9 * top)
            chosen = high[:-1] | high[1:]
        new = _between(grid[:-1], grid[1:])[chosen]
        new = new[~np.isin(new, grid)]
        if len(new) == 0 or len(grid) + len(new) > max_points:
            break
        more = bound(new)
        order = np.argsort(np.concatenate([grid, new]))
        grid, values, tight = (
            np.concatenate(pair)[order]
            for pair in ((grid, new), (values, more[0]), (tight, more[1]))
        )

        # At rest: the last refinement raised the peak by little, and its neighbours are as high.
        k = int(values.argmax())
        near = values[max(0, k - 1) : k + 2]
        if (
            count
            and values[k] - top <= 0.25 * tolerance * values[k]
            and values[k] - near.min() <= tolerance * values[k]
        ):
            resolved = True
            break
    k = int(values.argmax())
    best = 0.0
    at = float(grid[k])
    delta = np.full((structure.n_w, structure.n_z), np.nan, complex)
    if lower:
        # The lower bound where the upper one is largest; its peak may lie at another of these
        # points.
        chosen = np.argsort(values)[::-1][:40]
        M = respond(grid[chosen])
        low = lower_bound(M, structure, values[chosen], tight[chosen], tolerance=tolerance)
        j = int(low.value.argmax())
        best = float(low.value[j])
        at = float(grid[chosen[j]])
        delta = low.delta[j]
    return MuPeak(
        float(values[k]),
        float(grid[k]),
        min(best, float(values[k])),
        at,
        delta,
        grid,
        values,
        resolved,
    )
