"""T of a synchronous block over a band: the inverse of what the block sees, for all pressures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.synchronous import best_inverse, convergence, sector_angle
from ambrose.judge.synchronous_bands import Forbidden, orbit_limit
from ambrose.law.synchronous import Condition, SynchronousLoop
from ambrose.law.synchronous_table import BlockTable

# knots of a table over a band as wide as its middle speed, to begin with; of any table, at most;
# assumed
_KNOTS, _MOST_KNOTS = 17, 97
_ANGLE = np.radians(15.0)  # below which no T is offered
_LOSS = np.radians(5.0)  # by which T between two knots may be worse than at them


def usable_tables(
    loop: SynchronousLoop, mode: str, band: tuple[float, float], at: Sequence[Condition]
) -> list[tuple[tuple[float, float], BlockTable, Forbidden | None]]:
    """The parts of a band [rad/s] in which one T converges at all conditions with ``_ANGLE`` to
    spare, with their tables; and those in which none was found, with an empty table.
    """
    count = max(5, int(np.ceil(_KNOTS * (band[1] - band[0]) / (0.5 * (band[0] + band[1])))))
    known = {
        float(w): _inverse(loop, mode, float(w), at) for w in np.linspace(*band, min(count, 33))
    }
    pending = list(zip(sorted(known)[:-1], sorted(known)[1:], strict=True))
    while pending and len(known) < _MOST_KNOTS:
        a, b = pending.pop()
        if min(known[a][1], known[b][1]) < _ANGLE:
            continue
        middle, mean = (a + b) / 2, (known[a][0] + known[b][0]) / 2
        between = min(
            sector_angle(mean @ loop.response(mode, middle, condition)) for condition in at
        )
        if between < min(known[a][1], known[b][1]) - _LOSS and b - a > 1e-3 * b:
            known[middle] = _inverse(loop, mode, middle, at)
            pending += [(a, middle), (middle, b)]
    speeds = sorted(known)
    good = [known[w][1] >= _ANGLE for w in speeds]
    parts: list[tuple[tuple[float, float], BlockTable, Forbidden | None]] = []
    k = 0
    while k < len(speeds):
        end = k
        while end + 1 < len(speeds) and good[end + 1] == good[k]:
            end += 1
        if good[k]:
            if end > k:
                chosen = speeds[k : end + 1]
                table = BlockTable(np.array(chosen), np.array([known[w][0] for w in chosen]))
                parts.append(((chosen[0], chosen[-1]), table, None))
        else:
            ends = speeds[max(k - 1, 0)], speeds[min(end + 1, len(speeds) - 1)]
            worst = min(speeds[k : end + 1], key=lambda w: known[w][1])
            reason = f"no T converges at all pressures with {np.degrees(_ANGLE):.0f} deg to spare"
            limit = orbit_limit(loop.machine, worst)
            parts.append(
                (
                    ends,
                    BlockTable(np.array([]), np.array([])),
                    Forbidden(
                        *ends, worst, np.nan, np.nan, limit, f"{len(at)} pressures", reason=reason
                    ),
                )
            )
        k = end + 1
    return parts


def _inverse(
    loop: SynchronousLoop, mode: str, speed: float, at: Sequence[Condition]
) -> tuple[np.ndarray, float]:
    """T (a, a) at a speed for all conditions, scaled to the slowest direction, and its sector angle
    [rad].
    """
    responses = np.array([loop.response(mode, speed, condition) for condition in at])
    T = best_inverse(responses)
    slowest = float(convergence(T, responses).min())
    angle = min(sector_angle(T @ R) for R in responses)
    return (T / slowest if slowest > 0 else T), float(angle)
