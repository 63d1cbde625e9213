"""Campbell map: natural frequencies and damping against speed, each mode followed by shape;
critical speeds.

| check | what | unit |
|---|---|---|
| stability.speeds | largest real part of the poles over the speed range; below zero | rad/s |
| stability.threshold | speed from which rotating damping makes the loop unstable | rad/s |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import pairwise
from typing import Any

import numpy as np

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import InvalidInput, check_shape, invalid, named_failure
from ambrose.core.frequency import eigenvectors
from ambrose.core.presentation import Presented
from ambrose.core.statespace import (
    StateSpace,
    balance_matrix as balance,
    index_of,
    spectral_abscissa,
)
from ambrose.judge.checks import Check, Curve, information, judge
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR, TWO_PI, Demand, demand
from ambrose.machine.description import OperatingPoint, Requirements
from ambrose.model.plant import Plant
from ambrose.model.static_load import LEAST_AMPLIFICATION, allowed_amplification

# Closed-loop poles with damping and whirl direction.
#
# | check | what | unit |
# |---|---|---|
# | stability.abscissa | largest real part of the closed-loop poles; must be negative | rad/s |
# | poles.log_decrement.lowest | smallest log dec to the first forward mode or top speed | - |
# | poles.log_decrement.least | smallest log dec of all poles, bending and controller included | - |
# | poles.damping.above | smallest damping ratio above top speed, for a damping_above | - |
# | poles.damping.least | smallest damping ratio of all poles | - |
#
# The curve "poles" holds every closed-loop pole.


# below this modulus of the whirl measure a mode has no direction; assumed: at 0.1 the backward
# circle has 0.9 of the forward one's amplitude, sqrt((1 - 0.1)/(1 + 0.1))
PLANAR = 0.1
# a damping ratio below this counts as a mode that can ring: at 1/sqrt(2) and above the response of
# a second-order system has no resonance peak
OSCILLATORY = 0.7071067811865476
ONCE = "once per revolution"  # the line of the speed itself in a map
_LISTED = 5  # least damped modes of the standard's range that a detail lists
_NAMED = 4  # unstable poles that a detail names
_ROUNDING = 1e-9  # relative, so that the mode that sets a limit lies within it
# |Im|/|pole| up to which a pole is real: rounding splits a double real pole by about the root of
# 1e-16
_REAL = 1e-7
_KILO = 9999.5  # Hz: from here four digits do not reach the unit


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Poles (n,) [rad/s] with Im >= 0, by ascending modulus, and how the rotor moves in each.

    whirl (n,): +1 forward circle, -1 backward circle, 0 a line; shapes (ports, n): complex
    displacements at ``ports``. A pole with Im = 0 stands for itself, every other for a conjugate
    pair.
    """

    poles: np.ndarray
    whirl: np.ndarray
    shapes: np.ndarray
    ports: tuple[str, ...]

    def __getitem__(self, kept: np.ndarray) -> Modes:
        return Modes(self.poles[kept], self.whirl[kept], self.shapes[:, kept], self.ports)

    @property
    def frequency(self) -> np.ndarray:
        """Damped natural frequency |Im| (n,) [rad/s]."""
        return self.poles.imag

    @property
    def damping(self) -> np.ndarray:
        """Damping ratio -Re/|pole| (n,)."""
        return damping_ratio(self.poles)

    @property
    def log_decrement(self) -> np.ndarray:
        """2 pi (-Re)/|Im| (n,), infinite for real stable poles."""
        return log_decrement(self.poles)


def damping_ratio(poles: np.ndarray) -> np.ndarray:
    """-Re/|pole|, 0 for a pole at the origin."""
    modulus = np.abs(poles)
    return np.divide(-poles.real, modulus, out=np.zeros(poles.shape), where=modulus > 0)


def log_decrement(poles: np.ndarray) -> np.ndarray:
    """2 pi zeta/sqrt(1 - zeta^2) = 2 pi (-Re)/|Im|: the log of the ratio of two successive maxima;
    +-inf on the real axis.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        value = TWO_PI * -poles.real / np.abs(poles.imag)
    return np.where(np.isnan(value), 0.0, value)


def direction(whirl: float) -> str:
    """The whirl measure in a word."""
    return "planar" if abs(whirl) < PLANAR else "forward" if whirl > 0 else "backward"


@named_failure("the modes of the loop")
def modes(system: StateSpace, ports: tuple[str, ...], plant: StateSpace | None = None) -> Modes:
    """Eigenvalues of the system and the displacement shapes at its outputs q_<port>.

    plant: the continuous system that a sampled loop was closed around (``law.loop.closed_loop``):
    sampled poles are mapped by ln(z)/dt, those of the plant's modes above half the sample rate on
    the branch of their true frequency (core/aliasing.py); None: all within half the sample rate.

    Whirl: with X, Y a port pair's complex amplitudes, (|X + jY|^2 - |X - jY|^2) / (sum of both),
    summed over the pairs; spin is positive from the first direction to the second.
    """
    values, vectors = continuous_poles(system.A, system.dt, None if plant is None else plant.A)
    real = np.abs(values.imag) <= _REAL * np.abs(values)
    values = np.where(real, values.real, values)
    keep = values.imag >= 0
    values, vectors = values[keep], vectors[:, keep]
    order = np.lexsort((values.imag, np.abs(values)))
    values, vectors = values[order], vectors[:, order]
    shapes = system.C[index_of([f"q_{port}" for port in ports], system.outputs, "output")] @ vectors
    return Modes(values, whirl_measure(shapes, ports), shapes, ports)


def whirl_measure(shapes: np.ndarray, ports: tuple[str, ...]) -> np.ndarray:
    """The measure of ``modes`` for shapes (ports, n) complex, in [-1, 1]."""
    first, second = pairs(ports)
    X, Y = shapes[first], shapes[second]
    forward, backward = (np.abs(X + 1j * Y) ** 2).sum(axis=0), (np.abs(X - 1j * Y) ** 2).sum(axis=0)
    total = forward + backward
    return np.divide(forward - backward, total, out=np.zeros(len(total)), where=total > 0)


def pairs(ports: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Positions of the two directions of every place: <place>_zeta with _eta, <place>_x with _y."""
    first, second = [], []
    for one, other in (("_zeta", "_eta"), ("_x", "_y")):
        for i, port in enumerate(ports):
            if port.endswith(one) and port.removesuffix(one) + other in ports:
                first.append(i)
                second.append(ports.index(port.removesuffix(one) + other))
    return first, second


def _that_ring(eigenmodes: Modes) -> np.ndarray:
    return np.flatnonzero((eigenmodes.poles.imag > 0) & (eigenmodes.damping < OSCILLATORY))


def held_to(eigenmodes: Modes, top_speed: float) -> tuple[float, float]:
    """Up to where modes are held against the log decrement, and the first that can ring and does
    not whirl backward (inf: none), both [rad/s].
    """
    reach = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * top_speed)
    ringing = _that_ring(eigenmodes)
    forward = ringing[eigenmodes.whirl[ringing] > -PLANAR]
    first = float(eigenmodes.frequency[forward[0]]) if forward.size else math.inf
    return max(top_speed, first) if first <= reach else reach, first


def pole_checks(eigenmodes: Modes, requirements: Requirements, top_speed: float) -> list[Check]:
    """The checks of this file's table.

    top_speed [rad/s]: modes up to it are held against the log decrement, whatever their direction;
    so is the first mode that can ring and does not whirl backward, within the sensitivity's range:
    with rigid modes that cannot ring it would else be a bending mode far above what the standards
    speak of, and all modes of the range are held instead. A detail lists the five least damped
    modes of 2 kHz.
    """
    listed_to = SENSITIVITY_RANGE.limits[0].value
    reach = max(listed_to, SPEED_RANGE_FACTOR * top_speed)
    worst = int(np.argmax(eigenmodes.poles.real))
    abscissa = float(eigenmodes.poles[worst].real)
    stability = judge(
        "stability.abscissa",
        "Stability: largest real part of the closed-loop poles",
        abscissa,
        "rad/s",
        Demand(0.0, "<", "asymptotic stability"),
        _stability_detail(eigenmodes, worst),
    )
    ringing = _that_ring(eigenmodes)
    if not ringing.size:
        return [stability]
    checks = [stability]
    ceiling, first = held_to(eigenmodes, top_speed)
    oscillating = eigenmodes.poles.imag > 0  # one that cannot ring counts where no other is near
    low = np.flatnonzero(oscillating & (eigenmodes.frequency <= ceiling * (1 + _ROUNDING)))
    if low.size:
        k = low[np.argmin(eigenmodes.log_decrement[low])]
        title = "Log decrement of the modes up to the top speed"
        included = "the first forward one included" if first <= reach else "no forward one rings"
        where = f"{describe(eigenmodes, k)}; modes up to {ceiling / TWO_PI:.4g} Hz, {included}"
        wanted = demand("log decrement", requirements)
        checks.append(
            judge(
                "poles.log_decrement.lowest", title, eigenmodes.log_decrement[k], "-", wanted, where
            )
        )
    order = ringing[np.argsort(eigenmodes.damping[ringing])]
    above = order[eigenmodes.frequency[order] > top_speed * (1 + _ROUNDING)]
    if requirements.damping_above is not None and above.size:
        checks.append(
            judge(
                "poles.damping.above",
                "Damping ratio of the modes above the top speed",
                eigenmodes.damping[above[0]],
                "-",
                demand("damping above the top speed", requirements),
                f"at {_place(eigenmodes, above[0])}",
            )
        )
    near = [k for k in order if eigenmodes.frequency[k] <= listed_to][:_LISTED]
    least = order[0]
    where = f"at {_place(eigenmodes, least)}"
    listed = (
        ", ".join(f"{_place(eigenmodes, k)} {eigenmodes.damping[k]:.3g}" for k in near) or "none"
    )
    detail = f"{where}; least up to {listed_to / TWO_PI:.4g} Hz: {listed}"
    return [
        *checks,
        information(
            "poles.log_decrement.least",
            "Least log decrement of all poles",
            eigenmodes.log_decrement[least],
            "-",
            where,
            ">=",
        ),
        information(
            "poles.damping.least",
            "Least damping ratio of all poles",
            eigenmodes.damping[least],
            "-",
            detail,
            ">=",
        ),
    ]


def describe(eigenmodes: Modes, k: int) -> str:
    """One pole in words: "pole at 49.2 Hz forward, damping ratio -0.171"."""
    pole = eigenmodes.poles[k]
    if pole.imag == 0:
        return f"real pole at {pole.real:.4g} rad/s"
    return f"pole at {_place(eigenmodes, k)}, damping ratio {eigenmodes.damping[k]:.3g}"


def _place(eigenmodes: Modes, k: int) -> str:
    hertz = eigenmodes.frequency[k] / TWO_PI
    place = f"{hertz:.4g} Hz" if hertz < _KILO else f"{hertz / 1e3:.4g} kHz"
    return f"{place} {direction(eigenmodes.whirl[k])}"


def _stability_detail(eigenmodes: Modes, worst: int) -> str:
    unstable = np.flatnonzero(eigenmodes.poles.real >= 0)
    if not unstable.size:
        return f"rightmost: {describe(eigenmodes, worst)}"
    unstable = unstable[np.argsort(-eigenmodes.poles[unstable].real)]
    named = "; ".join(describe(eigenmodes, k) for k in unstable[:_NAMED])
    return named + (f"; and {unstable.size - _NAMED} more" if unstable.size > _NAMED else "")


def pole_curve(eigenmodes: Modes) -> Curve:
    """All closed-loop poles, both halves of the plane."""
    both = np.concatenate([eigenmodes.poles, eigenmodes.poles[eigenmodes.poles.imag > 0].conj()])
    return Curve(
        "poles",
        "Closed-loop poles",
        "poles",
        both.real,
        both.imag[None, :],
        ("poles",),
        "rad/s",
        "rad/s",
    )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CampbellMap(Presented):
    """speeds (s,) [rad/s]; frequency (m, s) [rad/s] damped, damping (m, s) ratio, whirl (m, s) in
    [-1, 1], a row per mode.

    Rows ascend by frequency at the first speed. whirl: +1 forward, -1 backward, 0 planar (see
    rotor_modes.modes).
    """

    speeds: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    whirl: np.ndarray

    def facts(self) -> Mapping[str, Any]:
        """The range of speeds, the modes with their direction, and the least damping."""
        span = f"{self.speeds[0]:.4g} to {self.speeds[-1]:.4g} rad/s"
        return {"speeds": span, "least_damping": float(self.damping.min()), "modes": self.names}

    @property
    def names(self) -> tuple[str, ...]:
        """One name per mode, with its direction at the highest speed."""
        return tuple(f"mode {k + 1}, {direction(row[-1])}" for k, row in enumerate(self.whirl))


def campbell(
    plant_at: Callable[[float], Plant],
    speeds: np.ndarray,
    count: int,
    controller: LawLike | None = None,
) -> CampbellMap:
    """The ``count`` lowest modes that can ring, over ascending speeds (s,) [rad/s], at least two.

    plant_at: speed [rad/s] -> Plant; controller: closes the loop at every speed, None for the plant
    alone (with the magnets' negative stiffness, so that its rigid modes need not oscillate). Modes
    are matched from speed to speed by the modal assurance criterion of their shapes at the ports
    and the distance of their poles (assignment with least total cost). Raises InvalidInput when
    there are fewer modes than ``count``.
    """
    speeds = check_shape(speeds, "speeds", "(s)").astype(float)
    if speeds.size < 2 or (np.diff(speeds) <= 0).any():
        raise invalid(
            "speeds", f"{speeds.size} values", "at least two, ascending", "give them in rad/s"
        )
    rows = [_lowest(_ringing(plant_at(float(speeds[0])), controller), count)]
    for speed in speeds[1:]:
        candidates = _ringing(plant_at(float(speed)), controller)
        rows.append(candidates[_follow(rows[-1], candidates)])
    p = np.array([row.poles for row in rows]).T
    return CampbellMap(speeds, p.imag, damping_ratio(p), np.array([row.whirl for row in rows]).T)


def _ringing(plant: Plant, controller: LawLike | None) -> Modes:
    """Every oscillating mode of the plant or of its closed loop."""
    loop = plant.system if controller is None else closed_loop(plant, controller)
    eigenmodes = modes(loop, plant.ports, plant.system)
    return eigenmodes[eigenmodes.poles.imag > 0]


def _lowest(eigenmodes: Modes, count: int) -> Modes:
    chosen = np.flatnonzero(np.abs(eigenmodes.damping) < OSCILLATORY)
    chosen = chosen[np.argsort(eigenmodes.frequency[chosen], kind="stable")][:count]
    if len(chosen) < count:
        raise invalid(
            "the number of modes",
            count,
            f"at most {len(chosen)}",
            "ask for fewer, or keep more bending modes in the plant",
        )
    return eigenmodes[chosen]


def _follow(eigenmodes: Modes, candidates: Modes) -> np.ndarray:
    """Which candidate continues which mode, (m,)."""
    poles, shapes = eigenmodes.poles, eigenmodes.shapes
    if len(candidates.poles) < len(poles):
        raise invalid(
            "the number of oscillating modes",
            len(candidates.poles),
            f"{len(poles)} at every speed",
            "ask for fewer modes or take smaller steps in speed",
        )
    from scipy.optimize import linear_sum_assignment

    size = (
        np.linalg.norm(shapes, axis=0)[:, None] * np.linalg.norm(candidates.shapes, axis=0)[None, :]
    )
    overlap = np.abs(shapes.conj().T @ candidates.shapes)
    assurance = np.divide(overlap, size, out=np.zeros_like(overlap), where=size > 0) ** 2
    distance = np.abs(candidates.poles[None, :] - poles[:, None]) / np.abs(poles)[:, None]
    _, order = linear_sum_assignment(10 * distance + (1 - assurance))
    return order


def campbell_curves(diagram: CampbellMap) -> list[Curve]:
    """The map as two curves: "campbell" (frequencies and the line of the speed itself) and
    "campbell.damping".
    """
    names = diagram.names
    lines = np.vstack([diagram.frequency, diagram.speeds])
    return [
        Curve(
            "campbell",
            "Natural frequencies against speed",
            "speed",
            diagram.speeds,
            lines,
            (*names, ONCE),
            "rad/s",
            "rad/s",
        ),
        Curve(
            "campbell.damping",
            "Damping ratios against speed",
            "speed",
            diagram.speeds,
            diagram.damping,
            names,
            "rad/s",
            "-",
        ),
    ]


def speed_stability_check(along: AlongSpeed, point: OperatingPoint | None = None) -> Check:
    """Stability of a loop that was followed over a range of speeds, at the worst of them, all else
    as at a point.
    """
    speeds, values = along.speeds, along.abscissa
    k = int(np.argmax(values))
    span = f"from {speeds[0] / TWO_PI:.4g} to {speeds[-1] / TWO_PI:.4g} Hz"
    if point is not None and point.seal_pressure:
        span += f" at {point.seal_pressure / 1e5:.4g} bar"
    lost = [
        f"from {part[0] / TWO_PI:.4g} to {part[-1] / TWO_PI:.4g} Hz"
        for part in np.split(speeds, np.flatnonzero(np.diff(values >= 0)) + 1)
        if values[np.searchsorted(speeds, part[0])] >= 0
    ]
    unstable = "" if not lost else f"; unstable {', '.join(lost)}"
    return judge(
        "stability.speeds",
        f"Stability over the speed range, {len(speeds)} speeds, refined at the worst",
        values[k],
        "rad/s",
        Demand(0.0, "<", "asymptotic stability"),
        f"largest at {speeds[k] / TWO_PI:.4g} Hz, {span}{unstable}",
    )


_THRESHOLD_SPEEDS, _HALVINGS = 24, 20
BEYOND_TOP = 2.0  # times the top speed up to which a threshold speed is looked for; assumed


def threshold_speed(
    loop_at: Callable[[float], StateSpace], low: float, high: float
) -> tuple[float | None, float]:
    """The first speed [rad/s] between two from which a closed loop is unstable, None for none, and
    the speed to which it was looked for: ``high``, or where coefficients or controller end.
    """

    def unstable(speed: float) -> bool:
        loop = loop_at(speed)
        values = np.linalg.eigvals(balance(loop.A)[0])
        return bool((np.abs(values) >= 1 if loop.dt else values.real >= 0).any())

    stable = low
    for lost in np.linspace(low, high, _THRESHOLD_SPEEDS).tolist():
        try:
            if not unstable(lost):
                stable = lost
                continue
        except InvalidInput:
            return None, stable
        end = lost
        for _ in range(_HALVINGS if end > stable else 0):
            middle = (stable + end) / 2
            stable, end = (stable, middle) if unstable(middle) else (middle, end)
        return end, end
    return None, high


def threshold_check(loop_at: Callable[[float], StateSpace], low: float, high: float) -> Check:
    """``threshold_speed`` from the lowest speed to ``BEYOND_TOP`` times the highest [rad/s]."""
    found, end = threshold_speed(loop_at, low, BEYOND_TOP * high)
    detail = f"the loop is stable up to {end / TWO_PI:.4g} Hz, where the search ended"
    return information(
        "stability.threshold",
        "Threshold speed with rotating damping",
        end,
        "rad/s",
        detail if found is None else f"unstable from here on; top speed {high / TWO_PI:.4g} Hz",
        ">=",
    )


# Critical speeds in an unbalance response: where it peaks sharply enough (API 617, lateral
# analysis; recalled).
#
# A peak at N with half-power band N1 to N2, where the response is 1/sqrt(2) of the peak, has the
# amplification factor N / (N2 - N1). From 2.5 on it is a critical speed, below it is called
# critically damped and needs no separation margin.


_TAKEN = (
    "; no running_speeds in the machine file: taken to run from its slowest to its fastest turning "
    "operating point"
)
_SAME = 0.03  # peaks of two lines this near to each other are one critical speed


def critical_speeds(curve: Curve) -> tuple[tuple[float, float], ...]:
    """(speed [rad/s], amplification factor) of an "unbalance" curve, by speed; of all its lines but
    the envelope "worst case".

    Where only one flank falls to half power inside the curve, twice that flank is the band; a peak
    without any is left out.
    """
    rows = [
        row
        for label, row in zip(curve.labels, curve.y, strict=True)
        if label != "worst case" or len(curve.labels) == 1
    ]
    return tuple(peak for peak in _different(curve.x, rows) if peak[1] >= LEAST_AMPLIFICATION)


def separation_check(
    omega: np.ndarray, orbits: np.ndarray, requirements: Requirements, running: tuple[float, float]
) -> Check:
    """The critical speed of orbits (k, w) over omega (w,) [rad/s] that comes nearest to what API
    617 allows, or past it.

    Its value is the amplification factor over the allowed one: 0 where no peak stands near
    ``running`` [rad/s]. The detail lists all critical speeds, the one that binds first.
    """
    resonances = _different(omega, orbits)
    allowed = allowed_amplification(np.array([speed for speed, _ in resonances]), running)
    ratio = np.array([factor for _, factor in resonances]) / allowed
    listed = "; ".join(
        f"{speed / TWO_PI:.4g} Hz has {factor:.3g}, "
        f"{f'allowed {most:.3g}' if math.isfinite(most) else 'far enough'}"
        for (speed, factor), most in (
            (resonances[k], allowed[k]) for k in np.argsort(-ratio, kind="stable")
        )
        if factor >= LEAST_AMPLIFICATION
    )
    low, high = (speed / TWO_PI for speed in running)
    title = (
        f"Amplification factor near the running speeds, {low:.4g} to {high:.4g} Hz, relative to "
        "the allowed one"
    )
    wanted = demand("separation margin", requirements)
    return judge(
        "unbalance.separation",
        title,
        float(ratio.max(initial=0.0)),
        "-",
        wanted,
        (listed or f"no peak has a factor of {LEAST_AMPLIFICATION:g}: no critical speed")
        + ("" if requirements.running_speeds else _TAKEN),
    )


def _different(x: np.ndarray, rows: Iterable[np.ndarray]) -> list[tuple[float, float]]:
    kept: list[tuple[float, float]] = []
    for speed, factor in sorted(
        (peak for row in rows for peak in _peaks(x, row)), key=lambda item: -item[1]
    ):
        if all(abs(speed - other) > _SAME * other for other, _ in kept):
            kept.append((speed, factor))
    return sorted(kept)


def _peaks(x: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
    tops = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] >= y[2:])) + 1
    peaks = []
    for top in tops:
        flanks = [_flank(x[top::step], y[top::step]) for step in (-1, 1)]
        known = [flank for flank in flanks if flank is not None]
        if known:
            peaks.append((float(x[top]), float(x[top] / (sum(known) * 2 / len(known)))))
    return peaks


def _flank(x: np.ndarray, y: np.ndarray) -> float | None:
    """From the peak y[0] to half power along one side; None where the curve ends or rises above the
    peak before.
    """
    half = y[0] / math.sqrt(2)
    k = int(np.argmax(y < half))
    if y[k] >= half or y[:k].max() > y[0]:
        return None
    return abs(float(np.interp(half, [y[k], y[k - 1]], [x[k], x[k - 1]]) - x[0]))


# The poles of a loop followed over a range of speeds, so that the worst speed is looked at and not
# the one that an even grid hits.
#
# From speed to speed poles are paired by their shapes: with right eigenvectors v and left ones w,
# w_i v_i = 1, pole i goes on as j where |(w_i v'_j)(w'_j v_i)| is near one. An interval is parted
#
# 1. where a pole may rise above the rightmost one known: above its highest value, by ``_BEND``
#    times what it bends, as its slopes at the ends and then a third speed between them tell;
# 2. where the frequencies of two light poles cross that may rise so by coupling there, within a
# small
#    part of it;
# 3. where the frequency of a light pole passes the speed itself, a critical speed, if those are
#    asked for.
#
# Nothing is proved between the speeds.


_BEND = 3.0  # times what a pole bends, by which it may rise
_SAME_ALONG_SPEED = 1e-3  # of the largest real part: to what it is found
_NEAR = 0.3  # of a coupling: the distance of two frequencies that is near
_NARROW = 1e-4  # of the range: intervals below are not parted
_MOST = 80  # speeds in all, but for critical ones
_LIGHT = 0.15  # damping ratio below which a pole is a narrow one
_STEPS = 2  # with which a critical speed is approached


@dataclass(frozen=True, slots=True, eq=False)
class AlongSpeed:
    """speeds (s,) [rad/s], ascending; abscissa (s,) [rad/s]: the largest real part there; critical:
    (speed, damping) [rad/s] of every critical speed of a light pole.
    """

    speeds: np.ndarray
    abscissa: np.ndarray
    critical: tuple[tuple[float, float], ...]


def follow(
    loop_at: Callable[[float], StateSpace],
    speeds: np.ndarray,
    *,
    critical: bool = False,
    whole_at: Callable[[float], StateSpace] | None = None,
) -> AlongSpeed:
    """A closed loop, of the same states at any speed [rad/s], at every one of speeds (s,),
    ascending, and at those that are added. critical: whether critical speeds are looked for.
    whole_at: the loop of which ``loop_at`` is a smaller model: that one says which speeds are
    added, and the whole one's poles are those of every speed.
    """
    known: dict[float, _Modes] = {}

    def at(speed: float) -> _Modes:
        if speed not in known:
            known[speed] = _modes(loop_at(speed))
        return known[speed]

    highest = max(float(at(float(w)).poles.real.max()) for w in speeds)
    narrowest = _NARROW * float(speeds[-1] - speeds[0])
    # intervals to be parted, the one in which a pole may rise highest first
    waiting: list[tuple[float, float, float, float]] = []

    def judge_interval(low: float, high: float, *, looked_into: bool = False) -> None:
        nonlocal highest
        first, last = _alike(at(low), at(high))
        last = _paired(first, last)
        cross = _crossing(first, last, highest)
        if cross is None and not looked_into:
            # A on a straight line between the ends: a cubic by the slopes w (A' - A) v of a pole
            # there lies (slope - slope')/8 off the chord in the middle
            change = last.A - first.A
            bend = np.abs((first.slopes(change) - last.slopes(change)).real) / 8
            top = np.maximum(first.poles.real, last.poles.real)
            if not (top + _BEND * bend).max() > highest + _SAME_ALONG_SPEED * abs(highest):
                return
        share = 0.5 if cross is None else cross
        middle = low + share * (high - low)
        modes_there = _alike(at(low), at(middle), at(high))
        halfway = _paired(*modes_there[:2])
        start, centre = modes_there[0].poles, halfway.poles
        end = _paired(halfway, modes_there[2]).poles
        highest = max(highest, float(centre.real.max()))
        # off the chord from start to end, and no farther than a parabola or a corner rises
        bend = np.abs((centre - (1 - share) * start - share * end).real)
        top = np.maximum(np.maximum(start.real, end.real), centre.real)
        rise = np.inf if cross is not None else float((top + _BEND * bend).max())
        if high - low > narrowest:
            heappush(waiting, (-rise, low, middle, high))

    for low, high in pairwise(speeds.tolist()):
        judge_interval(low, high)
    while waiting and len(known) < _MOST:
        rise, low, middle, high = heappop(waiting)
        if -rise <= highest + _SAME_ALONG_SPEED * abs(highest):
            break
        judge_interval(low, middle, looked_into=True)
        judge_interval(middle, high, looked_into=True)

    found: list[tuple[float, float]] = []
    for low, high in pairwise(sorted(known)) if critical else ():
        first, last = _alike(at(low), at(high))
        start, end = first.poles, _paired(first, last).poles
        light = np.minimum(-start.real, -end.real) < _LIGHT * high
        passes = (start.imag - low > 0) != (end.imag - high > 0)
        found += [
            _critical(at, (low, start[k]), (high, end[k])) for k in np.flatnonzero(light & passes)
        ]
    found_at = np.array(sorted(known))
    if whole_at is None:
        abscissa = np.array([known[w].poles.real.max() for w in found_at])
    else:
        abscissa = np.array([spectral_abscissa(whole_at(float(w))) for w in found_at])
    return AlongSpeed(found_at, abscissa, tuple(sorted(found)))


@dataclass(frozen=True, slots=True, eq=False)
class _Modes:
    """Continuous poles (n,), of a sampled loop ln(z)/T; right vectors (n, n), and left ones, of
    A (n, n); rate (n,): of a pole per change of its eigenvalue.
    """

    poles: np.ndarray
    right: np.ndarray
    left: np.ndarray
    A: np.ndarray
    rate: np.ndarray

    def __getitem__(self, kept: np.ndarray) -> _Modes:
        return _Modes(
            self.poles[kept], self.right[:, kept], self.left[kept], self.A, self.rate[kept]
        )

    def slopes(self, change: np.ndarray) -> np.ndarray:
        """By how much a change of A moves each pole (n,) [rad/s], to first order."""
        return np.asarray(np.einsum("ij,ji->i", self.left, change @ self.right) * self.rate)

    def coupling(self, kept: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Between the poles kept (k,), (k, k) [rad/s], by a change of A."""
        moved = self.left[kept] @ change @ self.right[:, kept] * self.rate[kept]
        return np.asarray(np.sqrt(np.abs(moved * moved.T)))


def _modes(loop: StateSpace) -> _Modes:
    balanced, scale = balance(loop.A)
    try:
        values, right, left = eigenvectors(balanced)
    except np.linalg.LinAlgError:  # of a defective pole, to the last digit
        values, right = np.linalg.eig(balanced)
        left = np.linalg.pinv(right)
    rate = np.ones(len(values), complex)
    if loop.dt is not None:
        # a pole of a delay at z = 0 is as far to the left as any
        size = np.maximum(np.abs(values), 1e-12)
        rate = 1 / (size * np.exp(1j * np.angle(values)) * loop.dt)
        values = (np.log(size) + 1j * np.angle(values)) / loop.dt
    return _Modes(values, scale[:, None] * right, left / scale, loop.A, rate)


def _alike(*several: _Modes) -> Sequence[_Modes]:
    """Of every pair of poles one, where all have as many pairs; else all poles."""
    upper = [np.flatnonzero(one.poles.imag >= 0) for one in several]
    if len({len(kept) for kept in upper}) > 1:
        return several
    return [one[kept] for one, kept in zip(several, upper, strict=True)]


def _paired(first: _Modes, second: _Modes) -> _Modes:
    """The second ones in the order of the first."""
    from scipy.optimize import linear_sum_assignment

    alike = np.abs((first.left @ second.right) * (second.left @ first.right).T)
    distance = np.abs(first.poles[:, None] - second.poles[None, :])
    apart = distance / (np.abs(first.poles)[:, None] + distance + 1.0)
    _, order = linear_sum_assignment(apart - np.minimum(alike, 1.0))
    return second[order]


def _crossing(start: _Modes, end: _Modes, highest: float) -> float | None:
    """The share of an interval, the first, at which the frequencies of two light poles cross that
    may rise above the highest real part known by coupling there.
    """
    light = np.flatnonzero(
        (start.poles.imag > 0)
        & (end.poles.imag > 0)
        & (-start.poles.real < _LIGHT * start.poles.imag)
    )
    a, b = start.poles[light], end.poles[light]
    before = a.imag[:, None] - a.imag[None, :]
    after = b.imag[:, None] - b.imag[None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.nan_to_num(before / (before - after), nan=0.0, posinf=0.0, neginf=0.0)
    inside = (share > 0) & (share < 1)
    if not inside.any():
        return None
    # to first order two poles that meet part by the square root of m_ij m_ji, m = w (A' - A) v, of
    # those that cross any
    some = np.flatnonzero(inside.any(axis=0))
    light, both = light[some], np.ix_(some, some)
    share, inside = share[both], inside[both]
    before, after = before[both], after[both]
    change = end.A - start.A
    coupling = np.maximum(
        share * start.coupling(light, change), (1 - share) * end.coupling(light, change)
    )
    top = np.maximum(a.real, b.real)[some]
    inside &= np.maximum(top[:, None], top[None, :]) + _BEND * coupling > highest
    # at an end that near to it what bends there is seen
    inside &= np.minimum(np.abs(before), np.abs(after)) > _NEAR * coupling
    return float(share[inside].min()) if inside.any() else None


def _critical(
    at: Callable[[float], _Modes], low: tuple[float, complex], high: tuple[float, complex]
) -> tuple[float, float]:
    """Where the frequency of a pole is the speed, by regula falsi, and its damping, both
    [rad/s].
    """
    for _ in range(_STEPS):
        (a, p), (b, q) = low, high
        speed = float(a + (b - a) * (p.imag - a) / ((p.imag - a) - (q.imag - b)))
        guess = p + (q - p) * (speed - a) / (b - a) if b > a else p
        own = at(speed).poles
        pole = complex(own[np.argmin(np.abs(own - guess))])
        if (pole.imag - speed > 0) == (p.imag - a > 0):
            low = speed, pole
        else:
            high = speed, pole
    return float(pole.imag), max(abs(pole.real), 1e-6 * speed)
