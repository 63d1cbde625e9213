"""The bands of speed in which a mode must not be used: its orbit, with the block converged, against
the limit.

Stability does not show them: near a resonance of the rotor without current (or without force) every
pole is stable and the orbit grows without bound.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.law.synchronous import Condition, Converged, SynchronousLoop, forward_patterns
from ambrose.machine.criteria import CLEARANCE, TWO_PI
from ambrose.machine.machine import Machine
from ambrose.model.unbalance import Unbalance, residual_unbalance

# speeds from rest to a band's end at which orbits are looked at, before borders are found exactly
_POINTS = 120
_NO_BOUND = 0.1  # m: an orbit of the linear model that is larger says that nothing bounds it
_LOW = float(np.log(1e-3))  # of the limit: below it a local maximum is not refined


@dataclass(frozen=True, slots=True)
class Forbidden:
    """A band of speed [rad/s] in which a mode breaks its limit. orbit [m]: the largest one in it
    (inf: none is bounded), at ``worst``; without [m]: the loop's own orbit there without the block;
    replacement: "off", "damping" or "" (neither keeps the limit); reason: in words.
    """

    low: float
    high: float
    worst: float
    orbit: float
    without: float
    limit: float
    condition: str
    replacement: str = "off"
    reason: str = ""

    def __str__(self) -> str:
        size = f"{self.orbit * 1e6:.3g} um" if self.orbit < _NO_BOUND else "without bound"
        text = (
            f"{self.low:.4g} to {self.high:.4g} rad/s ({self.low / TWO_PI:.4g} to "
            f"{self.high / TWO_PI:.4g} Hz)"
        )
        why = (
            self.reason
            or f"the orbit would be {size}, limit {self.limit * 1e6:.3g} um, at {self.worst:.4g} "
            "rad/s"
        )
        return f"{text}: {why}, {self.condition}"


def orbit_limit(machine: Machine, speed: float) -> float:
    """The largest orbit [m] that is allowed at a speed [rad/s]: the required one up to its speed,
    and 0.3 of the smallest touchdown (or air) gap, zone A of ISO 14839-2.
    """
    gaps = [bearing.touchdown_gap or bearing.gap for bearing in machine.bearings]
    known = [CLEARANCE.limits[0].value * gap for gap in gaps if gap]
    wanted = machine.requirements.unbalance_orbit
    if wanted is not None and speed <= (machine.requirements.unbalance_to or np.inf) * (1 + 1e-9):
        known.append(wanted)
    return min(known, default=np.inf)


def worst_orbits(values: np.ndarray, force: float) -> float:
    """The largest orbit [m] at a bearing over forward forces in the bearing planes with root sum
    square ``force`` [N]. values (a, bearings): phasors per newton of each plane's force.
    """
    x, y = values[0::2], values[1::2]
    # every orbit of a force vector f is |row . f| for the forward and the backward part of each
    # bearing
    forward, backward = (x + 1j * y) / 2, (x - 1j * y) / 2
    return float((np.linalg.norm(forward, axis=1) + np.linalg.norm(backward, axis=1)).max() * force)


def worst_signal(values: np.ndarray, force: float) -> float:
    """The largest amplitude of a channel over forward forces with root sum square ``force`` [N];
    values (a, bearings) per newton.
    """
    return float(np.linalg.norm(values, axis=1).max() * force)


def unbalance_of(machine: Machine) -> Unbalance:
    """The machine's residual unbalance. Raises InvalidInput where no balancing speed is known."""
    residual = residual_unbalance(machine)
    if residual is None:
        raise InvalidInput(
            "no balancing speed is known, so that no orbit can be judged; set "
            "requirements.balance_speed or a speed_range"
        )
    return residual


def converged_at(
    loop: SynchronousLoop,
    mode: str | None,
    speed: float,
    condition: Condition,
    drive: Callable[[float], np.ndarray] | None = None,
) -> Converged:
    """Phasors per newton of a forward force at each bearing, with the block converged (None:
    without).
    """
    gain = None if drive is None else drive(speed)
    return loop.converged(mode, speed, condition, forward_patterns(loop.machine), gain)


def forbidden_bands(
    loop: SynchronousLoop,
    mode: str | None,
    band: tuple[float, float],
    conditions: Sequence[Condition],
    drive: Callable[[float], np.ndarray] | None = None,
    points: int | None = None,
    share: float = 1.0,
) -> tuple[Forbidden, ...]:
    """The bands within ``band`` [rad/s] where the orbit of the mode (None: of the loop without a
    block) passes its limit, for any condition; ascending.

    share: of the limit, for a design that is to keep clear of it. Borders are roots of orbit/limit
    - 1, peaks between points are refined first. Raises InvalidInput.
    """
    from scipy.optimize import brentq, minimize_scalar

    residual, machine = unbalance_of(loop.machine), loop.machine
    points = (
        max(9, int(np.ceil(_POINTS * (band[1] - band[0]) / band[1]))) if points is None else points
    )
    forbidden: list[Forbidden] = []
    for condition in conditions:

        def ratio(speed: float, condition: Condition = condition) -> float:
            values = converged_at(loop, mode, speed, condition, drive)
            orbit = worst_orbits(values.q, float(residual.force(speed)))
            return float(np.log(max(orbit / (share * orbit_limit(machine, speed)), 1e-12)))

        speeds = np.linspace(*band, points)
        if machine.requirements.unbalance_to is not None:  # where the limit jumps
            step = machine.requirements.unbalance_to
            speeds = np.unique(
                [*speeds, *(w for w in (step, step * (1 + 1e-8)) if band[0] < w < band[1])]
            )

        # log(orbit/limit); local maxima are refined in place, so that no narrow peak is missed
        levels = np.array([ratio(float(w)) for w in speeds])
        for k in range(1, len(speeds) - 1):
            if levels[k] >= max(levels[k - 1], levels[k + 1], _LOW):
                peak = minimize_scalar(
                    lambda w: -ratio(float(w)),
                    bounds=(speeds[k - 1], speeds[k + 1]),
                    method="bounded",
                    options={"xatol": 1e-7 * speeds[k]},
                )
                if -peak.fun > levels[k]:
                    speeds[k], levels[k] = peak.x, -peak.fun

        # runs of points above the limit; borders lie before the first and after the last of a run
        over = levels > 0
        k = 0
        while k < len(speeds):
            if not over[k]:
                k += 1
                continue
            end = k
            while end + 1 < len(speeds) and over[end + 1]:
                end += 1

            low = (
                float(speeds[k])
                if k == 0
                else float(brentq(ratio, speeds[k - 1], speeds[k], rtol=1e-6))
            )
            last = end + 1 == len(speeds)
            high = (
                float(speeds[end])
                if last
                else float(brentq(ratio, speeds[end], speeds[end + 1], rtol=1e-6))
            )

            worst = float(speeds[k + int(np.argmax(levels[k : end + 1]))])
            force = float(residual.force(worst))
            orbit = worst_orbits(converged_at(loop, mode, worst, condition, drive).q, force)
            without = worst_orbits(converged_at(loop, None, worst, condition).q, force)
            limit = orbit_limit(machine, worst)
            forbidden.append(Forbidden(low, high, worst, orbit, without, limit, condition.label))
            k = end + 1
    return _merged(forbidden)


def _merged(bands: Sequence[Forbidden]) -> tuple[Forbidden, ...]:
    """Bands that overlap as one, with the worst orbit of them."""
    merged: list[Forbidden] = []
    for band in sorted(bands, key=lambda item: item.low):
        if merged and band.low <= merged[-1].high:
            last = merged[-1]
            worse = band if band.orbit / band.limit > last.orbit / last.limit else last
            merged[-1] = Forbidden(
                last.low,
                max(last.high, band.high),
                worse.worst,
                worse.orbit,
                worse.without,
                worse.limit,
                worse.condition,
                worse.replacement,
                worse.reason,
            )
        else:
            merged.append(band)
    return tuple(merged)
