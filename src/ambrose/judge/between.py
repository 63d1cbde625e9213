"""Verification between operating points: a range of speeds and pressures, gridded as finely as the
loop changes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ambrose.core.statespace import StateSpace
from ambrose.judge.along_speed import follow
from ambrose.judge.certificate import certify
from ambrose.judge.checks import Checks, Curve
from ambrose.judge.criteria import judge, required_line
from ambrose.judge.range_search import Found, search
from ambrose.judge.result import Certificate
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop, running_law
from ambrose.law.timing import Timing
from ambrose.machine.criteria import Demand, demand
from ambrose.machine.description import OperatingRange
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.effect import speed_knots
from ambrose.model.reduce import default_bending_modes, reduce

_STEPS = 8  # of a refinement along one axis


def check_range(
    machine: Machine, area: OperatingRange, law: LawLike, timing: Timing | None = None
) -> Checks:
    """Stability and sigma_max(S_o) of the nominal loop over a range; the worst point that is found,
    on the full plant.

    law: a controller or a schedule that covers the range; timing: the loop as it runs (None:
    continuous).
    """
    extremes = search(machine, area, law, timing)
    modes, looked = default_bending_modes(assemble(machine, area.corners[0])), 0

    def certified(speed: float, pressure: float, bending: int | None = None) -> Certificate:
        nonlocal looked
        looked += 1
        plant = assemble(machine, area.at(speed, pressure))
        plant = plant if bending is None else reduce(plant, bending)
        return certify(plant, running_law(law, plant, timing), margins=False)

    point = extremes.worst(area)
    place = point.speed, point.seal_pressure
    if np.isfinite(extremes.peak).all():
        place = _refined(lambda v, p: certified(v, p, modes).closed_loop_norm, extremes, place)
    worst = certified(*place)

    def loop_at(speed: float, pressure: float) -> StateSpace:
        plant = assemble(machine, area.at(speed, pressure))
        return closed_loop(plant, running_law(law, plant, timing))

    # the poles over the speed, at both ends of the pressure and where the peak is largest
    speeds = np.unique([*extremes.speeds, *speed_knots(machine, *area.speed)])
    count, abscissa = 0, float(extremes.abscissa.max())
    for pressure in sorted({*area.seal_pressure, place[1]}) if len(speeds) > 1 else ():
        along = follow(partial(loop_at, pressure=pressure), speeds)
        count += len(along.speeds)
        k = int(np.argmax(along.abscissa))
        if along.abscissa[k] >= 0 and worst.stable:
            place = float(along.speeds[k]), pressure
            worst = certified(*place)
        abscissa = max(abscissa, float(along.abscissa[k]))
    abscissa = max(abscissa, worst.spectral_abscissa)
    size = (
        f"{len(extremes.speeds)} speeds x {len(extremes.pressures)} pressures, "
        f"{100 * extremes.change:.2g} % between neighbours"
    )
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    checks = (
        judge(
            "range.abscissa",
            f"Outermost pole between the points, {count + looked} speeds and pressures, refined at "
            "the worst",
            abscissa,
            "rad/s",
            Demand(0.0, "<", "stability"),
            f"found on a grid of {size}, on the full plant over the speed",
        ),
        judge(
            "range.sensitivity",
            f"Largest output sensitivity between the points, {extremes.peak.size + looked} speeds "
            "and pressures, refined at the worst",
            worst.closed_loop_norm,
            "-",
            wanted,
            f"{area.at(*place).label}, on the full plant; found on a grid of {size}",
        ),
    )
    curves: tuple[Curve, ...] = ()
    if len(extremes.speeds) > 1:
        labels = tuple(f"{pressure / 1e5:.4g} bar" for pressure in extremes.pressures)
        title = f"Largest sensitivity over {area.label}"
        curves = (
            Curve(
                "range.sensitivity",
                title,
                "speed",
                extremes.speeds,
                extremes.peak.T,
                labels,
                "rad/s",
                "-",
                required_line(wanted.limit),
            ),
        )
    return Checks(area.label, abscissa < 0, checks, curves)


def _refined(
    value: Callable[[float, float], float], extremes: Found, place: tuple[float, float]
) -> tuple[float, float]:
    """Where a value is largest near a place of the grid: over the speed, then over the pressure,
    twice, each time nearer.
    """
    from scipy.optimize import minimize_scalar

    best, where = float(extremes.peak.max()), place
    for share in (1.0, 0.25):
        for axis, grid in enumerate((extremes.speeds, extremes.pressures)):
            k = int(np.argmin(np.abs(grid - where[axis])))
            ends = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
            low, high = (float(where[axis] + share * (end - where[axis])) for end in ends)
            if high - low <= 1e-9 * (grid[-1] - grid[0]):
                continue
            other = where[1 - axis]

            def along(x: float, axis: int = axis, other: float = other) -> float:
                return -value(x, other) if axis == 0 else -value(other, x)

            found = minimize_scalar(
                along, bounds=(low, high), method="bounded", options={"maxiter": _STEPS}
            )
            if -found.fun > best:
                best, x = -float(found.fun), float(found.x)
                where = (x, other) if axis == 0 else (other, x)
    return where
