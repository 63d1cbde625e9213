"""Verification of a synchronous block: convergence proved over its band, and what it changes of
orbit, current and force.

| check | what | unit |
|---|---|---|
| synchronous.margin | angle by which all phases may be off, proved where it says so | deg |
| synchronous.margin.box | the same over the tolerances, proved or found at members | deg |
| synchronous.gain | eps over the largest one with stable exact poles, at a few speeds | - |
| synchronous.time | slowest convergence over the band, 2/(eps Re lambda) | s |
| synchronous.orbit_0p | worst-case orbit with the block converged, against the limit | m |
| synchronous.current | largest 1x control current with it, over that without | dB |
| synchronous.force | largest 1x magnetic force on the housing, the same | dB |
| synchronous.sensitivity | peak of an axis' sensitivity with the block on (ISO 14839-3) | - |

The margin concerns small gains: Herm(T S) > 0 (core/interval_proof.py) for a loop that is stable
without the block, which the other tables judge. A finite eps is judged by exact poles at single
speeds (a block that moves once a turn: by its multipliers over one). Unbalance is the residual one
of the balance grade in the bearing planes, the worst case over how forward forces share it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.interval_proof import IntervalProof
from ambrose.core.per_turn import largest_block_gain
from ambrose.core.statespace import select, spectral_abscissa
from ambrose.core.synchronous import (
    borders,
    convergence,
    convergence_angle,
    sector_angle,
)
from ambrose.judge.checks import Check, Checks, Curve
from ambrose.judge.criteria import information, judge
from ambrose.judge.synchronous_bands import (
    converged_at,
    forbidden_bands,
    orbit_limit,
    worst_orbits,
    worst_signal,
)
from ambrose.judge.synchronous_sensitivity import sensitivity_peak
from ambrose.law.law import LawLike
from ambrose.law.synchronous import (
    Condition,
    Converged,
    SynchronousLoop,
    conditions,
    synchronous_loop,
)
from ambrose.law.synchronous_pencils import loop_pencils, prove_interval
from ambrose.law.synchronous_table import BlockTable, block_table, running_table
from ambrose.machine.criteria import TWO_PI, Demand, demand
from ambrose.machine.machine import Machine
from ambrose.machine.synchronous import Synchronous
from ambrose.model.unbalance import residual_unbalance
from ambrose.model.uncertainty import tolerances_around

Progress = Callable[[str], None]
_SPEEDS = 61  # at which curves are drawn
_SENSITIVITIES = 7  # speeds of the sensitivity, ends and middle among them
_LINES = "without the block", "block converged"
_POLES = 4  # speeds at which exact poles are computed
_GRID = 49  # speeds between which borders of stability are looked for
_NOTHING = 1e-15  # A, N, m: below it a signal is called zero
_VANISHED = 1e-6  # of the signal without the block, -120 dB: below it nothing is left but rounding


@dataclass(frozen=True, slots=True)
class BlockLoop:
    """A block of a machine in its loop: what the checks below are made of."""

    loop: SynchronousLoop
    block: Synchronous
    table: BlockTable
    conditions: tuple[Condition, ...]
    running: BlockTable

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
    return tuple(items)


def check_block(
    item: BlockLoop, progress: Progress = lambda text: None, *, members: int = 12, seed: int = 0
) -> Checks:
    """The checks and curves of this file's table for one block. members: random ones, where the box
    is not proved.

    Raises InvalidInput.
    """
    progress(f"judging the {item.label}")
    low, high = item.block.band
    stable = all(
        spectral_abscissa(item.loop.sampled(float(w), condition)) < 0
        for condition in item.conditions
        for w in np.linspace(low, high, 3)
    )
    if not stable:
        note = (
            "The loop is unstable without the block somewhere in its band: nothing is judged of "
            "the block."
        )
        return Checks(item.label, False, (), (), (note,))
    checks = [*_margin_checks(item, progress, members, seed), *_gain_checks(item)]
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
    sensitivity, over_speed = _sensitivity_check(item)
    return Checks(item.label, True, (*checks, sensitivity), (*curves, over_speed), notes)


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
    angle, speed, where, unstable = member_margins(item, members, seed)
    detail = (
        f"at {speed:.4g} rad/s, {where.label}; not proved over the box ({reason}), found at "
        f"{members} random members per pressure, one speed each, {unstable} of them unstable"
    )
    return [_angle("synchronous.margin.box", title, angle, wanted, detail)]


def member_margins(
    item: BlockLoop, members: int, seed: int = 0
) -> tuple[float, float, Condition, int]:
    """The smallest convergence angle [rad] (of eigenvalues, exact for small gains) over random
    members and speeds, its speed and member, and how many do not converge.
    """
    rng = np.random.default_rng(seed)
    low, high = item.block.band
    worst = np.inf
    at = low
    where = item.conditions[0]
    unstable = 0
    for condition in item.conditions:
        names = [
            t.parameter for t in tolerances_around(item.loop.plant((low + high) / 2, condition))
        ]
        for _ in range(members):
            corner = rng.random() < 0.5
            values = (
                rng.choice([-1.0, 1.0], len(names)) if corner else rng.uniform(-1, 1, len(names))
            )
            member = Condition(condition.pressure, tuple(zip(names, values.tolist(), strict=True)))
            speed = float(rng.uniform(low, high))
            signals = item.loop.signals(item.mode, speed, member)
            angle = float(convergence_angle(item.running.at(speed), signals))
            unstable += angle <= 0
            if angle < worst:
                worst = angle
                at = speed
                where = member
    return float(worst), at, where, unstable


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


def _gain_checks(item: BlockLoop) -> list[Check]:
    """eps against the exact poles, and the time in which the slowest direction settles."""
    eps, leak = item.block.gain, item.block.leak
    limit = np.inf
    at = 0.0
    slow = np.inf
    slow_at = 0.0
    for w in item.speeds(_POLES):
        speed = float(w)
        drive = item.running.at(speed)
        for condition in item.conditions:
            closed = select(item.loop.sampled(speed, condition), None, item.loop.reads(item.mode))
            frequency = item.loop.harmonic * speed
            highest = min(limit, max(8 * eps, 0.1 * frequency))
            update = item.block.update
            largest = largest_block_gain(
                closed, drive, speed, item.loop.harmonic, update, highest, leak
            )
            if largest < limit:
                limit, at = largest, speed
            # for small gains a' = -(leak + eps/2 T R) a: the slowest direction
            signals = item.loop.signals(item.mode, speed, condition)
            rate = leak + eps / 2 * float(convergence(drive, signals))
            if rate < slow:
                slow, slow_at = rate, speed
    time = 1 / slow if slow > 0 else np.inf
    ratio = eps / limit if limit > 0 else np.inf
    where = (
        f"at {at:.4g} rad/s: eps {eps:.4g} 1/s (time constant {item.block.time_constant:.4g} s), "
        "stable up to at least "
    )
    return [
        judge(
            "synchronous.gain",
            "Gain over the largest with stable exact poles",
            ratio,
            "-",
            Demand(1.0, "<", "stability"),
            f"{where}{limit:.4g} 1/s; at {_POLES} speeds and {_pressures(len(item.conditions))}",
        ),
        information(
            "synchronous.time", "Slowest convergence", time, "s", f"at {slow_at:.4g} rad/s"
        ),
    ]


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
            "Worst-case orbit, block converged, 0-p",
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
    change = 20 * np.log10(np.maximum(ratio, _VANISHED))
    k = int(np.argmax(change))
    m = int(np.argmax(before))
    detail = (
        f"least at {speeds[k]:.4g} rad/s: {before[k]:.3g} to {after[k]:.3g} {unit}; where it is "
        "largest, at "
        f"{speeds[m]:.4g} rad/s, {before[m]:.3g} to {after[m]:.3g} {unit}"
    )
    if ratio[k] <= _VANISHED:
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


def _sensitivity_check(item: BlockLoop) -> tuple[Check, Curve]:
    """The largest sensitivity of an axis with the block on, and what it is over the band without
    and with it.
    """
    eps, leak = item.block.gain, item.block.leak
    speeds = item.speeds(_SENSITIVITIES)
    peaks = np.zeros((2, len(speeds)))
    worst, text = 0.0, ""
    for k, w in enumerate(speeds):
        speed = float(w)
        T = item.table.at(speed)
        for condition in item.conditions:
            alone, _ = sensitivity_peak(item.loop, item.mode, speed, condition, None, 0.0)
            peak, at = sensitivity_peak(item.loop, item.mode, speed, condition, T, eps, leak)
            peaks[:, k] = np.maximum(peaks[:, k], (alone, peak))
            if peak > worst:
                worst = peak
                text = (
                    f"at {at / TWO_PI:.4g} Hz, {speed:.4g} rad/s, {condition.label}; {alone:.4g} "
                    "without the block"
                )
    wanted = demand("sensitivity of an axis", item.loop.machine.requirements)
    title = "Sensitivity of an axis with the block on"
    check = judge("synchronous.sensitivity", title, worst, "-", wanted, text)
    limits = () if check.limit is None else (("limit", check.limit),)
    curve = Curve(
        "synchronous.sensitivity", title, "speed", speeds, peaks, _LINES, "rad/s", "-", limits
    )
    return check, curve
