"""Verification of a synchronous block: convergence proved over its band, and what it changes of
orbit, current and force.

| check | what | unit |
|---|---|---|
| synchronous.margin | angle by which all phases may be off, proved where it says so | deg |
| synchronous.margin.box | the same over the tolerances, proved or found at members | deg |
| synchronous.gain | eps over the largest one with stable exact poles, where that is smallest | - |
| synchronous.gain.box | the same at corners of the tolerances | - |
| synchronous.time | slowest convergence over the band, against a run-up through it | s |
| synchronous.orbit_0p | worst-case orbit with the block converged, against the limit | m |
| synchronous.current | largest 1x control current with it, over that without | dB |
| synchronous.force | largest 1x magnetic force on the housing, the same | dB |
| synchronous.sensitivity | peak of an axis' sensitivity with the block on (ISO 14839-3) | - |
| synchronous.sensitivity.box | the same at corners of the tolerances | - |

The margin concerns small gains: Herm(T S) > 0 (core/interval_proof.py) for a loop that is stable
without the block, which the other tables judge. A finite eps, and the sensitivity, are searched
over the speeds of the band and refined (speeds.py), with exact poles at the worst (a block that
moves once a turn: by its multipliers over one). Unbalance is the residual one
of the balance grade in the bearing planes, the worst case over how forward forces share it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ambrose.annexes.synchronous.block_loop import (
    BlockTable,
    Condition,
    Converged,
    SynchronousLoop,
    block_table,
    conditions,
    extreme_conditions,
    forward_patterns,
    loop_pencils,
    prove_interval,
    running_table,
    synchronous_loop,
)
from ambrose.annexes.synchronous.speeds import (
    MINUTE,
    SETTLED,
    Least,
    Resonator,
    Survey,
    bases,
    growth_by_gain,
    least,
    resonator,
    survey,
)
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.interval_proof import IntervalProof
from ambrose.core.statespace import spectral_abscissa
from ambrose.core.synchronous import (
    borders,
    convergence,
    convergence_angle,
    largest_stable,
    sector_angle,
)
from ambrose.judge.checks import Check, Checks, Curve, information, judge
from ambrose.law.law import LawLike
from ambrose.law.pid import pid_controller
from ambrose.machine.criteria import CLEARANCE, TWO_PI, Demand, demand
from ambrose.machine.machine import Machine
from ambrose.machine.part import PidSettings, Synchronous
from ambrose.model.static_load import Unbalance, residual_unbalance
from ambrose.model.uncertainty import tolerances_around

# The bands of speed in which a mode must not be used: its orbit, with the block converged, against
# the limit.
#
# Stability does not show them: near a resonance of the rotor without current (or without force)
# every pole is stable and the orbit grows without bound.


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
            "no balancing speed is known, so that no orbit can be checked; set "
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


Progress = Callable[[str], None]
_SPEEDS = 61  # at which curves are drawn
_LINES = "without the block", "block converged"
_GRID = 49  # speeds between which borders of stability are looked for
_NOTHING = 1e-15  # A, N, m: below it a signal is called zero
VANISHED = 1e-6  # of the signal without the block, -120 dB: below it nothing is left but rounding


@dataclass(frozen=True, slots=True)
class BlockLoop:
    """A block of a machine in its loop: what the checks below are made of. others: the blocks
    beside it.
    """

    loop: SynchronousLoop
    block: Synchronous
    table: BlockTable
    conditions: tuple[Condition, ...]
    running: BlockTable
    others: tuple[BlockLoop, ...] = ()
    vanished: ClassVar[float] = VANISHED

    def resonator(self, speed: float) -> Resonator:
        """The block at a speed [rad/s]."""
        block = self.block
        drive = self.running.at(speed)
        return resonator(self.loop, block.mode, drive, speed, block.gain, block.leak, block.update)

    def on(self, speed: float) -> tuple[Resonator, ...]:
        """The block at a speed [rad/s], then those of other harmonics that are on there, too."""
        also = (o for o in self.others if o.block.band[0] <= speed <= o.block.band[1])
        return self.resonator(speed), *(other.resonator(speed) for other in also)

    def survey(self, conditions: Sequence[Condition], members: bool = False) -> Survey:
        """The worst speeds of the band with all blocks on that are on there."""
        knots = self.table.speeds.tolist()
        return survey(self.loop, self.block.band, knots, self.on, conditions, members)

    def corners(self) -> tuple[Condition, ...]:
        """Corners of the tolerances at every pressure."""
        middle = sum(self.block.band) / 2
        return tuple(
            corner
            for condition in self.conditions
            for corner in extreme_conditions(self.loop, condition, middle)
        )

    def closed(self, speed: float, condition: Condition) -> np.ndarray:
        """D R (a, a): how the amplitudes converge, with D as it runs."""
        return self.running.at(speed) @ self.loop.signals(self.mode, speed, condition)

    @property
    def mode(self) -> str:
        return self.block.mode

    @property
    def label(self) -> str:
        low, high = self.block.band
        return (
            f"synchronous block {self.block.harmonic}x, {self.mode}, {low:.4g} to {high:.4g} rad/s"
        )

    def speeds(self, count: int) -> np.ndarray:
        return np.linspace(*self.block.band, count)

    def drive(self, speed: float) -> np.ndarray:
        """D (a, a) of a block that leaks: c = D z once settled, (eps/(2 leak)) T."""
        return self.block.gain / (2 * self.block.leak) * self.table.at(speed)

    def converged(self, speed: float, condition: Condition) -> Converged:
        return converged_at(self.loop, self.mode, speed, condition, self.gain)

    @property
    def gain(self) -> Callable[[float], np.ndarray] | None:
        """``drive`` of a block that leaks; None: it drives its signal to zero."""
        return self.drive if self.block.leak > 0 else None


def block_loops(
    machine: Machine,
    controller: LawLike,
    blocks: Sequence[Synchronous],
    rate: float | None = None,
    delay: int | None = None,
) -> tuple[BlockLoop, ...]:
    """The blocks in the loop of a machine and a controller. Raises InvalidInput for blocks that do
    not fit the machine.
    """
    loop, at = synchronous_loop(machine, controller, rate, delay), conditions(machine)
    items = []
    for block in blocks:
        here, table = replace(loop, harmonic=block.harmonic), block_table(block, machine)
        running = running_table(table, here, block.mode)
        items.append(BlockLoop(here, block, table, at, running))
    return tuple(
        replace(item, others=tuple(other for other in items if other is not item)) for item in items
    )


def check_block(
    item: BlockLoop,
    progress: Progress = lambda text: None,
    *,
    members: int = 12,
    seed: int = 0,
    speed_rate: float | None = None,
) -> Checks:
    """The checks and curves of this file's table for one block. members: random ones, where the box
    is not proved; speed_rate [rad/s^2]: the fastest run-up (None: the band in a minute).

    Raises InvalidInput.
    """
    progress(f"judging the {item.label}")
    known = (
        (float(w), condition)
        for condition in (*item.conditions, *item.corners())
        for w in bases(item.block.band, 3)
    )
    if (lost := _loop_alone(item, known)) is not None:
        return lost
    progress(f"searching the speeds of the {item.label}")
    nominal, corners = item.survey(item.conditions), item.corners()
    box = item.survey(corners, members=True) if corners else None
    # what is unstable with the block may be so between those speeds without it
    places = (place for one in (nominal, box) if one is not None for place in one.places)
    unstable = ((place.look.speed, place.condition) for place in places if not place.stable)
    if (lost := _loop_alone(item, unstable)) is not None:
        return lost
    checks = [*_margin_checks(item, progress, members, seed), _gain_check(item, nominal)]
    if box is not None:
        checks.append(_gain_check(item, box, len(corners)))
    checks.append(_time_check(item, nominal, speed_rate))
    curves = [_margin_curve(item)]
    notes: tuple[str, ...] = ()
    if item.block.harmonic == 1 and residual_unbalance(item.loop.machine) is not None:
        progress(f"unbalance with the {item.label}")
        unbalance, drawn = _unbalance_checks(item)
        checks += unbalance
        curves += drawn
    else:
        notes = (
            "No orbit, current or force: they are known for the unbalance (1x) with a balancing "
            "speed alone.",
        )
    checks.append(_sensitivity_check(item, nominal))
    if box is not None:
        checks.append(_sensitivity_check(item, box, len(corners)))
    over_speed = _sensitivity_curve(nominal, checks[-1].limit)
    return Checks(item.label, True, tuple(checks), (*curves, over_speed), notes)


def _loop_alone(item: BlockLoop, places: Iterable[tuple[float, Condition]]) -> Checks | None:
    """The failed check of the loop without the block where that is unstable at one of (speed
    [rad/s], condition): no T holds it. None: at none.
    """
    for speed, condition in places:
        growth = spectral_abscissa(item.loop.sampled(speed, condition))
        if growth >= 0:
            title = "Outermost pole of the loop without the block"
            detail = (
                f"at {speed:.5g} rad/s, {condition.label}: stabilise the loop, or take that speed "
                "out of the band"
            )
            wanted = Demand(0.0, "<", "stability")
            check = judge("stability.abscissa", title, growth, "rad/s", wanted, detail)
            note = "The loop is unstable without the block: the block is not checked."
            label = f"the loop alone, in the band of the {item.label}"
            return Checks(label, False, (check,), (), (note,))
    return None


def _margin_checks(item: BlockLoop, progress: Progress, members: int, seed: int) -> list[Check]:
    """Convergence for small gains over the band: proved where the mode allows it, and over the
    tolerances.
    """
    low, high = item.block.band
    wanted = Demand(0.0, ">=", "convergence for every small gain")
    title = "Angle by which all phases may be off"
    checks = []
    proofs: list[tuple[IntervalProof, Condition]] = []
    for condition in item.conditions:
        progress(f"proving convergence at {condition.label}")
        pencils = loop_pencils(item.loop, condition, low, high, mode=item.mode)
        proofs.append(
            (
                prove_interval(pencils, item.running.at, item.table.speeds.tolist(), low, high),
                condition,
            )
        )
    failed = [(proof, condition) for proof, condition in proofs if not proof.proved]
    if failed and item.mode == "damping":  # the leak holds what T would not
        return []
    if failed:
        detail = _refusal(item, failed[0][0], failed[0][1])
        return [_angle("synchronous.margin", title, min(failed[0][0].angle, -1e-6), wanted, detail)]
    proof, condition = min(proofs, key=lambda entry: entry[0].angle)
    cells = sum(one.cells for one, _ in proofs)
    detail = (
        f"at {proof.worst:.4g} rad/s, {condition.label}; proved at every speed of the band and "
        f"{_pressures(len(proofs))}, {cells} cells, on the full plant without aliasing, which is "
        "allowed for"
    )
    checks.append(_angle("synchronous.margin", title, proof.angle, wanted, detail))
    checks += _box_checks(item, progress, members, seed, wanted)
    return checks


def _box_checks(
    item: BlockLoop, progress: Progress, members: int, seed: int, wanted: Demand
) -> list[Check]:
    """The margin over the tolerances: proved over the whole box, else the smallest found at random
    members.
    """
    low, high = item.block.band
    title = "The same over the tolerances"
    proved: list[tuple[IntervalProof, Condition]] = []
    varied, reason = 0, ""
    for condition in item.conditions:
        tolerances = tolerances_around(item.loop.plant((low + high) / 2, condition))
        if not tolerances:
            continue
        varied += 1
        progress(f"proving convergence over the tolerances at {condition.label}")
        pencils = loop_pencils(item.loop, condition, low, high, tolerances, mode=item.mode)
        proof = prove_interval(pencils, item.running.at, item.table.speeds.tolist(), low, high)
        proved.append((proof, condition))
        if not proof.proved:
            reason = f"from {proof.failed:.4g} rad/s"
            break
    if not varied or (reason and item.mode == "damping"):  # the leak holds what T would not
        return []
    if not reason:
        proof, condition = min(proved, key=lambda entry: entry[0].angle)
        detail = (
            f"at {proof.worst:.4g} rad/s, {condition.label}; proved over the band and the whole box"
        )
        return [_angle("synchronous.margin.box", title, proof.angle, wanted, detail)]
    found = member_margins(item, members, seed)
    detail = (
        f"at {found.speed:.4g} rad/s, {found.condition.label}; not proved over the box ({reason})"
    )
    title += f", {members} random members per pressure, {found.count} speeds, refined at the worst"
    return [_angle("synchronous.margin.box", title, found.value, wanted, detail)]


def member_margins(item: BlockLoop, members: int, seed: int = 0) -> Least:
    """The smallest convergence angle [rad] (of eigenvalues, exact for small gains) of random
    members, half of them corners, over all speeds of the band.
    """
    rng = np.random.default_rng(seed)
    chosen: list[Condition] = []
    for condition in item.conditions:
        at = item.loop.plant(sum(item.block.band) / 2, condition)
        names = [tolerance.parameter for tolerance in tolerances_around(at)]
        for _ in range(members):
            corner = rng.random() < 0.5
            values = (
                rng.choice([-1.0, 1.0], len(names)) if corner else rng.uniform(-1, 1, len(names))
            )
            moved = tuple(zip(names, values.tolist(), strict=True))
            chosen.append(Condition(condition.pressure, moved))
    knots = item.table.speeds.tolist()
    return least(item.loop, item.block.band, knots, item.on, chosen, convergence_angle)


def _pressures(count: int) -> str:
    return "1 pressure" if count == 1 else f"{count} pressures"


def _angle(name: str, title: str, angle: float, wanted: Demand, detail: str) -> Check:
    return judge(name, title, float(np.degrees(angle)), "deg", wanted, detail)


def _refusal(item: BlockLoop, proof: IntervalProof, condition: Condition) -> str:
    """Where T is unstable, or not proved, and what would be stable."""
    low, high = item.block.band

    def value(speed: float) -> float:
        signals = item.loop.signals(item.mode, speed, condition)
        return float(convergence(item.running.at(speed), signals))

    grid = np.linspace(low, high, _GRID)
    levels = np.array([value(float(w)) for w in grid])
    if (levels > 0).all():
        assert proof.failed is not None
        text = (
            f"not proved at {proof.failed:.4g} rad/s, {condition.label}, though every eigenvalue "
            "seen converges there"
        )
        return f"{text}; give a T nearer to S^-1 (ambrose synthesize --synchronous {item.mode})"
    worst = float(grid[int(np.argmin(levels))])

    # stable ranges: between borders, by the sign in their middle
    turns = borders(value, grid)
    edges = [low, *(border.value for border in turns), high]
    stable = [(a, b) for a, b in itertools.pairwise(edges) if value((a + b) / 2) > 0]
    ranges = ", ".join(f"{a:.5g} to {b:.5g} rad/s" for a, b in stable) or "at no speed of the band"
    text = (
        f"T is unstable for every gain at {worst:.4g} rad/s, {condition.label}; it is stable "
        f"{ranges}"
    )
    return f"{text}, and T = S^-1 everywhere (ambrose synthesize --synchronous {item.mode})"


def _searched(item: BlockLoop, found: Survey, corners: int) -> str:
    """How far a search went, for a title."""
    where = f" at {corners} corners of the tolerances" if corners else ""
    return f"{found.count} speeds{where}, refined at the worst"


def _gain_check(item: BlockLoop, found: Survey, corners: int = 0) -> Check:
    """eps against the exact poles where they are nearest to instability."""
    eps = item.block.gain
    place = found.least_stable
    speed = place.look.speed
    system = item.loop.sampled(speed, place.condition)
    own, *_ = item.on(speed)

    grows = growth_by_gain(system, item.on(speed))

    def stable(gain: float) -> bool:
        return grows(gain) < 0

    if place.stable:
        limit = largest_stable(stable, max(2 * eps, 0.1 * own.frequency), 0.05)
    else:
        limit = largest_stable(stable, eps, 0.05)
    ratio = eps / limit if limit > 0 else np.inf
    detail = (
        f"at {speed:.5g} rad/s, {place.condition.label}: eps {eps:.4g} 1/s (time constant "
        f"{item.block.time_constant:.4g} s), outermost pole {place.growth:+.4g} 1/s, "
    )
    # one border is assumed by the bisection: an unstable pole decides by itself
    if not place.stable:
        ratio = max(ratio, 1.0)
        detail += "unstable; make the time constant longer, or take that speed out of the band"
    else:
        detail += f"stable up to at least {limit:.4g} 1/s"
    name = "synchronous.gain.box" if corners else "synchronous.gain"
    title = f"Gain over the largest with stable exact poles, {_searched(item, found, corners)}"
    return judge(name, title, ratio, "-", Demand(1.0, "<", "stability"), detail)


def _time_check(item: BlockLoop, found: Survey, speed_rate: float | None) -> Check:
    """The time in which the slowest direction settles, against a run-up through the band: for small
    gains a' = -(leak + (eps/2) T R) a.
    """
    low, high = item.block.band
    slowest = found.slowest
    rate = item.block.leak + item.block.gain / 2 * slowest.value
    time = 1 / rate if rate > 0 else np.inf
    run_up = MINUTE if speed_rate is None else (high - low) / speed_rate
    through = "a minute" if speed_rate is None else f"{run_up:.3g} s"
    wanted = Demand(run_up / SETTLED, "<=", f"settled to 95 % in a run-up of {through}")
    title = (
        f"Converges within (time constant of the slowest direction), {slowest.count} speeds, "
        "refined at the worst"
    )
    samples = time / item.loop.timing.sample_time
    detail = f"at {slowest.speed:.5g} rad/s, {samples:.3g} samples"
    return judge("synchronous.time", title, time, "s", wanted, detail)


def _unbalance_checks(item: BlockLoop) -> tuple[list[Check], list[Curve]]:
    """Orbit, current and force over the band, before and after, for the worst forward unbalance."""
    machine = item.loop.machine
    residual = residual_unbalance(machine)
    assert residual is not None
    speeds = item.speeds(_SPEEDS)

    # rows: orbit [m], current [A], force [N]; the worst condition at every speed
    before, after = np.zeros((3, len(speeds))), np.zeros((3, len(speeds)))
    for k, w in enumerate(speeds):
        force = float(residual.force(w))
        for condition in item.conditions:
            for rows, values in (
                (before, converged_at(item.loop, None, float(w), condition)),
                (after, item.converged(float(w), condition)),
            ):
                sizes = (
                    worst_orbits(values.q, force),
                    worst_signal(values.u, force),
                    worst_signal(values.force, force),
                )
                rows[:, k] = np.maximum(rows[:, k], sizes)

    limits = np.array([orbit_limit(machine, float(w)) for w in speeds])
    forbidden = forbidden_bands(item.loop, item.mode, item.block.band, item.conditions, item.gain)

    # a forbidden band is found between the drawn speeds as well
    k = int(np.argmax(after[0] / limits))
    orbit = after[0, k]
    limit = limits[k]
    detail = f"at {speeds[k]:.4g} rad/s; {before[0, k] * 1e6:.3g} um without the block"
    if forbidden:
        orbit, limit = forbidden[0].orbit, forbidden[0].limit
        detail = f"the band contains a forbidden speed, {forbidden[0]}; take it out of the band"
    checks = [
        judge(
            "synchronous.orbit_0p",
            f"Worst-case orbit, block converged, {len(speeds)} speeds, peaks above the limit "
            "refined, 0-p",
            orbit,
            "m",
            Demand(float(limit), "<=", "required orbit, or ISO 14839-2 zone A"),
            detail,
        )
    ]
    for row, name, title, unit in (
        (1, "current", "1x control current, 0-p", "A"),
        (2, "force", "1x force on the housing, 0-p", "N"),
    ):
        checks.append(_change_check(name, title, unit, speeds, before[row], after[row]))
    curves = [
        Curve(
            "synchronous.orbit_0p",
            "Worst-case 1x orbit, 0-p",
            "speed",
            speeds,
            np.array([before[0], after[0]]),
            _LINES,
            "rad/s",
            "m",
            (("limit", float(limits.min())),),
        ),
        Curve(
            "synchronous.current_0p",
            "Largest 1x control current, 0-p",
            "speed",
            speeds,
            np.array([before[1], after[1]]),
            _LINES,
            "rad/s",
            "A",
        ),
        Curve(
            "synchronous.force_0p",
            "Largest 1x force on the housing, 0-p",
            "speed",
            speeds,
            np.array([before[2], after[2]]),
            _LINES,
            "rad/s",
            "N",
        ),
    ]
    return checks, curves


def _change_check(
    name: str, title: str, unit: str, speeds: np.ndarray, before: np.ndarray, after: np.ndarray
) -> Check:
    """The change of a signal in dB where it is least favourable; one that vanishes in the model is
    told as -120 dB.
    """
    ratio = after / np.maximum(before, _NOTHING)
    change = 20 * np.log10(np.maximum(ratio, VANISHED))
    k = int(np.argmax(change))
    m = int(np.argmax(before))
    detail = (
        f"least at {speeds[k]:.4g} rad/s: {before[k]:.3g} to {after[k]:.3g} {unit}; where it is "
        "largest, at "
        f"{speeds[m]:.4g} rad/s, {before[m]:.3g} to {after[m]:.3g} {unit}"
    )
    if ratio[k] <= VANISHED:
        detail = (
            f"it vanishes in the model; without the block up to {before[m]:.3g} {unit}, at "
            f"{speeds[m]:.4g} rad/s"
        )
    return information(
        f"synchronous.{name}",
        f"{title}, block converged over without",
        float(change[k]),
        "dB",
        detail,
    )


def _margin_curve(item: BlockLoop) -> Curve:
    """The sector angle over the band, a line per pressure."""
    speeds = item.speeds(_SPEEDS)
    angles = [
        [np.degrees(sector_angle(item.closed(float(w), condition))) for w in speeds]
        for condition in item.conditions
    ]
    labels = tuple(condition.label for condition in item.conditions)
    title = "Angle by which all phases may be off"
    return Curve(
        "synchronous.margin",
        title,
        "speed",
        speeds,
        np.array(angles),
        labels,
        "rad/s",
        "deg",
        (("limit", 0.0),),
    )


def _sensitivity_check(item: BlockLoop, found: Survey, corners: int = 0) -> Check:
    """The largest sensitivity of an axis with the block on, over speed and frequency."""
    place = found.most_sensitive
    worst = place.look
    # of an unstable loop no sensitivity is measured
    unstable = next((other for other in found.places if not other.stable), None)
    value = worst.sensitivity if unstable is None else np.inf
    text = (
        f"at {worst.frequency / TWO_PI:.4g} Hz, {worst.speed:.5g} rad/s, {place.condition.label}; "
        f"{worst.alone:.4g} without the block"
    )
    wanted = demand("sensitivity of an axis", item.loop.machine.requirements)
    if wanted.limit is not None and worst.alone > wanted.limit:
        text += ", so the loop alone fails: tune its controller"
    if unstable is not None:
        text = f"unstable at {unstable.look.speed:.5g} rad/s, {unstable.condition.label}"
    title = f"Sensitivity of an axis with the block on, {_searched(item, found, corners)}"
    name = "synchronous.sensitivity.box" if corners else "synchronous.sensitivity"
    return judge(name, title, value, "-", wanted, text)


def _sensitivity_curve(found: Survey, limit: float | None) -> Curve:
    """What it is over the band without and with the block, at every speed that was looked at."""
    speeds = np.array([one.speed for one in found.looks])
    peaks = np.array([[one.alone for one in found.looks], [one.sensitivity for one in found.looks]])
    return Curve(
        "synchronous.sensitivity",
        "Sensitivity of an axis with the block on",
        "speed",
        speeds,
        peaks,
        _LINES,
        "rad/s",
        "-",
        () if limit is None else (("limit", limit),),
    )


_RPM = 30 / np.pi  # rpm per rad/s


def block_doubts(machine: Machine, settings: PidSettings) -> Iterator[str]:
    """Blocks that drive away what they are to bring to zero, under the reference controller at both
    ends and the middle of their bands: a T with the wrong sign or angle.
    """
    law = pid_controller(settings, machine)
    for i, item in enumerate(block_loops(machine, law, settings.synchronous), 1):
        speeds = item.speeds(3).tolist()
        try:
            first = item.conditions[0]
            lost = [w for w in speeds if spectral_abscissa(item.loop.sampled(w, first)) >= 0]
            if lost:  # no fault of T
                yield (
                    f"[[controller.synchronous]] {i}: without the block the [controller] does not "
                    f"hold the rotor at {lost[0] * _RPM:,.5g} rpm, in the block's band; tune it "
                    "first"
                )
                continue
            seen = [item.loop.signals(item.mode, w, first) for w in speeds]
            # da/dt = -eps T R a converges where every eigenvalue of T R has a positive real part
            real = [
                float(convergence(item.running.at(w), response))
                for w, response in zip(speeds, seen, strict=True)
            ]
        except AmbroseError:  # no model at one of them, which verify says
            continue
        if max(real) < 0:
            yield (
                f"[[controller.synchronous]] {i}: {item.mode} with this T drives away what it is "
                f"to bring to zero at all of {', '.join(f'{w * _RPM:,.5g}' for w in speeds)} rpm; "
                "check the sign and the angle of T, 180 degrees are a wrong sign"
            )
