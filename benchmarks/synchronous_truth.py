"""What the design of a synchronous block promises, tried from outside: members, attack, run-up.

    python -m benchmarks.synchronous_truth --part members|attack|runup|through|rate [--machine NAME ...]
                                           [--count N] [--bands N] [--slow X] [--quiet]
                                           [--span LOW HIGH] [--rate X]

members: the designed T at random members of the tolerances, at every pressure: convergence for
small gains at twelve speeds of each band (eigenvalues of T S, from the plant's ports), and exact
poles with the designed eps at one of those speeds each, of the loop that ``synchronous.growth`` puts
together from the matrices of plant and controller.
attack: random tables T of three knots with random phases, gains and coupling, in random bands. For
each the proof over the band and the tolerances, then exact poles with a random small eps at random
speeds and members. ``refuted``: proved, and a pole outside although the loop is stable without the block.
runup: the virtual rig through the designed bands, with and without the block: largest 1x control
current, orbit and magnetic force while the block is on, and the largest sensitivity of an axis with
and without it. --quiet: without noise and quantisation of the sensors, so that what is left is lag.
through: a run-up with all blocks of a design over a span, through the bands that it leaves out.
rate: from the law of the lag, the run-up's rate at which the largest 1x current falls by 30 dB.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ambrose import design
from ambrose.annexes.synchronous.block_checks import orbit_limit
from ambrose.annexes.synchronous.block_design import check_base_loop, design_synchronous
from ambrose.annexes.synchronous.block_loop import (
    BlockTable,
    Condition,
    Converged,
    SynchronousLoop,
    block_table,
    conditions,
    forward_patterns,
    loop_pencils,
    prove_interval,
    running_law,
    synchronous_loop,
)
from ambrose.annexes.synchronous.running import synchronous_program
from ambrose.annexes.synchronous.speeds import sensitivity_peak
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.core.synchronous import best_inverse, convergence
from ambrose.law.synchronous_block import BlockState
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients, residual_unbalance
from ambrose.model.uncertainty import perturbed, tolerances_around
from ambrose.rig.scenario import Scenario, Unbalance
from ambrose.rig.virtual_rig import run
from benchmarks.box_attack import ports
from benchmarks.compiled_synchronous import CompiledSynchronous
from benchmarks.synchronous import (
    MACHINES,
    controlled,
    growth_with,
    held_plant,
    without_noise,
)

_SPEEDS = 12  # of each band, at which all members are tried for small gains
_PROBES = 4  # speeds and members against one proof
_SUSPECTS = 6, 10  # speeds of a band and members at each, of which those are drawn
_LAGS = 40  # speeds of a band at which the lag is worked out
_SWITCHED = 0.5  # s in which a block that is switched on comes up
_ROUNDING = 1e-9  # 1/s: beyond which a pole that a block moved counts as outside


@cache
def held(name: str) -> tuple[Machine, StateSpace]:
    """A bundled machine with the reference controller of its file, or with a tuned one where that
    does not hold it as it runs.
    """
    machine, law = controlled(name)
    loop = synchronous_loop(machine, law)
    top = machine.operation.design.speed
    try:
        check_base_loop(loop, conditions(machine), 0.1 * top, top)
    except InvalidInput:
        rate, late = loop.timing.rate, loop.timing.delay_samples
        return machine, design(machine, "tuned", rate=rate, delay_samples=late).controller
    return machine, law


@dataclass(frozen=True, slots=True)
class Members:
    """tried (small gains, exact poles), lost: members that do not converge; unstable: members that
    the controller does not hold without a block; angle [deg]: the smallest convergence angle.
    """

    tried: tuple[int, int]
    lost: tuple[int, int]
    unstable: int
    angle: float


def plant_at(machine: Machine, speed: float, condition: Condition) -> Plant:
    """The full plant at a speed [rad/s] and a pressure, its tolerances at zero."""
    design = machine.operation.design
    return assemble(
        machine, replace(design, speed=speed, seal_pressure=condition.pressure, label="")
    )


def sensitivity_of(
    loop: SynchronousLoop, plant: Plant, speed: float, delta: np.ndarray
) -> np.ndarray:
    """S (m, a, a) at the speed of members delta (m, parameters) in [-1, 1]: (I + G K)^-1, with hold
    and delay, without aliases.
    """
    found, T = ports(plant), loop.timing.sample_time
    M = found.at(np.array([1j * speed]))[0]
    n = len(found.owner)
    moved = delta[:, found.owner]

    # y = M22 u + M21 D (I - M11 D)^-1 M12 u
    inner = np.eye(n) - M[None, :n, :n] * moved[:, None, :]
    through = np.linalg.solve(inner, np.broadcast_to(M[:n, n:], (len(delta), n, M.shape[1] - n)))
    G = M[None, n:, n:] + (M[None, n:, :n] * moved[:, None, :]) @ through

    # hold and delay at the speed, and the sampled controller there
    s = 1j * speed
    late = (1 - np.exp(-s * T)) / (s * T) * np.exp(-s * T * loop.timing.delay_samples)
    K = transfer_at(loop.controller(plant), np.exp(s * T))
    return np.asarray(np.linalg.inv(np.eye(len(K)) + late * G @ K))


def angles(T: np.ndarray, S: np.ndarray) -> np.ndarray:
    """90 degrees less the largest phase of an eigenvalue of T S (m, a, a): (m,) [deg]."""
    phase = np.abs(np.angle(np.linalg.eigvals(T @ S)))
    return np.asarray(90.0 - np.degrees(phase.max(axis=-1)))


def draws(rng: np.random.Generator, count: int, width: int) -> np.ndarray:
    """Members (m, width): half of them corners of the box."""
    inside = rng.uniform(-1, 1, (count, width))
    corner = rng.random(count) < 0.5
    return np.where(corner[:, None], np.sign(inside), inside)


def members_of(name: str, count: int) -> Members:
    """``members`` of the module's text, on one machine."""
    machine, law = held(name)
    loop = synchronous_loop(machine, law)
    found = design_synchronous(machine, law)
    rng = np.random.default_rng(7)
    tried, lost, unstable, least = [0, 0], [0, 0], 0, 90.0
    for block in found.blocks:
        table = block_table(block, machine)
        low, high = block.band
        for condition in conditions(machine):
            width = len(tolerances_around(plant_at(machine, low, condition)))
            delta = draws(rng, count, width)
            place = rng.integers(_SPEEDS, size=count)
            for k, speed in enumerate(np.linspace(low, high, _SPEEDS).tolist()):
                plant, T = plant_at(machine, speed, condition), table.at(speed)
                S = sensitivity_of(loop, plant, speed, delta)
                spare = angles(T, S)
                least = min(least, float(spare.min()))
                tried[0] += len(spare)
                lost[0] += int((spare <= 0).sum())
                for row in delta[place == k]:
                    outcome = poles_of(plant, law, loop, speed, row, T, block.gain)
                    tried[1] += 1
                    unstable += outcome is None
                    lost[1] += outcome is not None and outcome > 0
    return Members((tried[0], tried[1]), (lost[0], lost[1]), unstable, least)


def poles_of(
    plant: Plant,
    law: StateSpace,
    loop: SynchronousLoop,
    speed: float,
    row: np.ndarray,
    T: np.ndarray,
    eps: float,
) -> float | None:
    """The outermost pole's growth [1/s] of one member of a plant with the block, less rounding;
    None where the member is unstable without one.
    """
    dt = loop.timing.sample_time
    member = held_plant(moved(plant, row), dt)
    if growth_with(member, law, speed, dt, T, 0.0) > _ROUNDING:
        return None
    return growth_with(member, law, speed, dt, T, eps) - _ROUNDING


def moved(plant: Plant, row: np.ndarray) -> Plant:
    """A member of a plant's tolerances, in [-1, 1] each."""
    around = tolerances_around(plant)
    values = {item.parameter: float(v) for item, v in zip(around, row, strict=True)}
    return perturbed(plant, values, around) if around else plant


def attack_on(name: str, count: int, spans: int) -> tuple[int, int, int]:
    """Tables tried, proved over band and box, and refuted by exact poles."""
    machine, law = held(name)
    loop = synchronous_loop(machine, law)
    rng = np.random.default_rng(11)
    top, at, dt = machine.operation.design.speed, conditions(machine), loop.timing.sample_time
    proved = refuted = 0
    for band in bands(rng, top, spans):
        condition = at[int(rng.integers(len(at)))]
        around = tolerances_around(plant_at(machine, band[0], condition))
        pencils = loop_pencils(loop, condition, *band, around)
        suspects = suspects_of(machine, law, dt, band, condition, rng)
        for table in tables(rng, loop, condition, band, -(-count // spans)):
            if not prove_interval(pencils, table.at, table.speeds.tolist(), *band).proved:
                continue
            proved += 1
            for k in rng.integers(len(suspects), size=_PROBES).tolist():
                speed, row, plant = suspects[k]
                eps = 10 ** rng.uniform(-3, -1)
                if growth_with(plant, law, speed, dt, table.at(speed), eps) > _ROUNDING:
                    refuted += 1
                    print(f"{name}: refuted at {speed:.4g} rad/s, {condition.label}, {row}")
    return spans * (-(-count // spans)), proved, refuted


def suspects_of(
    machine: Machine,
    law: StateSpace,
    dt: float,
    band: tuple[float, float],
    condition: Condition,
    rng: np.random.Generator,
) -> list[tuple[float, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]]:
    """Random speeds of a band and members, sampled, that are stable without a block."""
    found = []
    for speed in rng.uniform(*band, _SUSPECTS[0]).tolist():
        plant = plant_at(machine, speed, condition)
        for row in draws(rng, _SUSPECTS[1], len(tolerances_around(plant))):
            member = held_plant(moved(plant, row), dt)
            one = np.eye(len(machine.axes))
            if growth_with(member, law, speed, dt, one, 0.0) <= _ROUNDING:
                found.append((speed, row, member))
    return found


def bands(rng: np.random.Generator, top: float, count: int) -> list[tuple[float, float]]:
    """Random bands of 2 to 20 % of the top speed."""
    middle, width = rng.uniform(0.25, 0.9, count) * top, rng.uniform(0.02, 0.2, count) * top
    return [(float(m - w / 2), float(m + w / 2)) for m, w in zip(middle, width, strict=True)]


def tables(
    rng: np.random.Generator,
    loop: SynchronousLoop,
    condition: Condition,
    band: tuple[float, float],
    count: int,
) -> Iterator[BlockTable]:
    """Tables around S^-1, turned by up to 100 degrees and coupled by up to its own size, a knot
    each at the ends and in the middle.
    """
    knots = np.linspace(*band, 3)
    best = np.array(
        [best_inverse(loop.response("current-free", float(w), condition)[None]) for w in knots]
    )
    n = best.shape[-1]
    for _ in range(count):
        turn = np.exp(1j * np.radians(rng.uniform(-100, 100)))
        far = 10 ** rng.uniform(-3, 0)
        mixed = rng.standard_normal((3, n, n)) + 1j * rng.standard_normal((3, n, n))
        yield BlockTable(knots, turn * best @ (np.eye(n) + far / np.sqrt(2 * n) * mixed))


@dataclass(frozen=True, slots=True)
class RunUp:
    """Largest 1x while the block is on, after over before [dB], and S of an axis."""

    current: float
    force: float
    orbit: float
    share_on: float
    sensitivity: tuple[float, float]


def run_up(name: str, slow: float, *, quiet: bool = False) -> tuple[str, RunUp]:
    """``runup`` of the module's text, through the widest band of the design; slow: times as long as
    80 time constants.
    """
    machine, law = held(name)
    if quiet:
        machine = without_noise(machine)
    loop = synchronous_loop(machine, law)
    found = design_synchronous(machine, law)
    block = max(found.blocks, key=lambda item: item.band[1] - item.band[0])
    low, high = block.band
    residual = residual_unbalance(machine)
    assert residual is not None
    first, last = machine.bearings[0].name, machine.bearings[-1].name
    size = float(residual.moment)
    weights = (Unbalance(first, size), Unbalance(last, 0.7 * size, phase=1.0))
    # slow against the block: what it lags behind is the change in a time constant
    ramp = max(1.0, 80 * slow * block.time_constant)
    # up from the lower edge; what is measured begins when the block's slowest direction has
    # converged to 60 dB there: exp(-7)
    start, at = low + block.hysteresis, conditions(machine)[0]
    slowest = convergence(
        block_table(block, machine).at(start), loop.response(block.mode, start, at)
    )
    hold = _SWITCHED + 7 * block.time_constant / float(slowest)
    scenario = Scenario(
        "run-up", hold + ramp, unbalances=weights, speed=start, to_speed=high, ramp=hold + ramp
    )
    sampled = loop.controller(loop.plant(low, conditions(machine)[0]))
    wanted = []
    for switched_off in (((0.0, scenario.duration),), ()):
        blocks = running_law((block,), loop)
        compiled = CompiledSynchronous(blocks)
        program = synchronous_program(
            machine, sampled, blocks, scenario, block=compiled, switched_off=switched_off
        )
        trace = run(machine, program, scenario, every=5)
        wanted.append((trace, program))
    figures = [one_x(machine, trace.record, start, high, hold) for trace, _ in wanted]
    on = np.mean([states[0] == BlockState.ON for _, states, _, _ in wanted[1][1].history])
    change = [20 * np.log10(b / a) for a, b in zip(*figures, strict=True)]
    peaks = []
    for T, eps in ((None, 0.0), (True, block.gain)):
        worst = 0.0
        for w in np.linspace(low, high, 3):
            chosen = block_table(block, machine).at(float(w)) if T else None
            for condition in conditions(machine):
                peak = sensitivity_peak(loop, block.mode, float(w), condition, chosen, eps)[0]
                worst = max(worst, peak)
        peaks.append(worst)
    rate = (high - start) / scenario.duration
    begin = start + rate * hold
    words = f"{begin:.4g} to {high:.4g} rad/s in {ramp:.3g} s, {rate:.3g} rad/s^2"
    return words, RunUp(change[0], change[1], change[2], float(on), (peaks[0], peaks[1]))


def one_x(
    machine: Machine, record: object, start: float, end: float, after: float
) -> tuple[float, float, float]:
    """Largest 1x of current [A], magnetic force [N] and orbit [m], in windows of sixty turns."""
    time = record.time  # type: ignore[attr-defined]
    speed = start + (end - start) * time / time[-1]
    wave = np.exp(-1j * np.concatenate([[0.0], np.cumsum(speed[:-1] * np.diff(time))]))
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    worst = [0.0, 0.0, 0.0]
    begin = int(np.searchsorted(time, after))
    while True:
        width = int(60 * 2 * np.pi / speed[begin] / (time[1] - time[0]))
        if begin + width >= len(time):
            return worst[0], worst[1], worst[2]
        part = slice(begin, begin + width)

        def tone(kind: str, part: slice = part) -> np.ndarray:
            return np.array(
                [2 * np.mean(record[f"{kind}_{a}"][part] * wave[part]) for a in machine.axes]  # type: ignore[index]
            )

        u, i, q = tone("u"), tone("i"), tone("q")
        worst[0] = max(worst[0], float(np.abs(u).max()))
        worst[1] = max(worst[1], float(np.abs(k_i * i + k_s * q).max()))
        worst[2] = max(worst[2], float(np.abs(q).max()))
        begin += width


def through(name: str, low: float, high: float, duration: float) -> list[str]:
    """``through`` of the module's text: a line per block, then the largest orbit of the whole run
    [m], without and with the blocks, and its limit.
    """
    machine, law = held(name)
    loop = synchronous_loop(machine, law)
    found = design_synchronous(machine, law, band=(low, high))
    residual = residual_unbalance(machine)
    assert residual is not None
    first, last = machine.bearings[0].name, machine.bearings[-1].name
    size = float(residual.moment)
    weights = (Unbalance(first, size), Unbalance(last, 0.7 * size, phase=1.0))
    scenario = Scenario(
        "through", duration, unbalances=weights, speed=low, to_speed=high, ramp=duration
    )
    sampled = loop.controller(loop.plant(low, conditions(machine)[0]))
    records = []
    for switched_off in (((0.0, duration),), ()):
        blocks = running_law(found.blocks, loop)
        compiled = CompiledSynchronous(blocks)
        program = synchronous_program(
            machine, sampled, blocks, scenario, block=compiled, switched_off=switched_off
        )
        records.append(run(machine, program, scenario, every=5).record)
    rate, lines = (high - low) / duration, []
    for block in found.blocks:
        # on from the hysteresis, ramped in half a second, settled after five time constants
        settled = block.band[0] + block.hysteresis + rate * (5 * block.time_constant + _SWITCHED)
        span = (settled - low) / rate, (block.band[1] - low) / rate
        inside = [one.between(0.0, span[1]) for one in records]
        ends = low + rate * float(inside[0].time[-1])
        before, after = (one_x(machine, one, low, ends, span[0]) for one in inside)
        change = [20 * np.log10(b / a) for a, b in zip(before, after, strict=True)]
        words = ", ".join(f"{x:.1f} dB" for x in change)
        lines.append(f"{block.mode} {settled:.4g} to {block.band[1]:.4g} rad/s: {words}")
    largest = [one_x(machine, one, low, high, 0.0)[2] for one in records]
    limit = orbit_limit(machine, high)
    return [*lines, f"orbit {largest[0]:.3g}, {largest[1]:.3g} m, limit {limit:.3g} m"]


@dataclass(frozen=True, slots=True)
class Lag:
    """What a run-up leaves of the 1x current, by the law of the lag: band [rad/s]; speed [rad/s] at
    which most is left; per_rate [s^2/rad]: the largest of the band over the largest without the
    block, of a run-up of 1 rad/s^2; own: the same over that without the block at the same speed.
    """

    band: tuple[float, float]
    speed: float
    per_rate: float
    own: float

    def rate(self, decibels: float) -> float:
        """The rate [rad/s^2] at which the largest current falls by so much."""
        return float(10 ** (-decibels / 20) / self.per_rate)


def lags_of(name: str) -> list[Lag]:
    """``rate`` of the module's text, for every block of the design."""
    machine, law = held(name)
    loop, condition = synchronous_loop(machine, law), conditions(machine)[0]
    pattern, size = forward_patterns(machine), np.zeros(len(machine.bearings), complex)
    # as in the run-ups: phases count from the bearing's own first axis
    size[0] = np.exp(1j * machine.bearings[0].angle)
    size[-1] += 0.7 * np.exp(1j * (1.0 + machine.bearings[-1].angle))
    found = []
    for block in design_synchronous(machine, law).blocks:
        table, before, left = block_table(block, machine), [], []
        speeds = np.linspace(block.band[0] + block.hysteresis, block.band[1], _LAGS)
        for w in speeds.tolist():

            def settled(speed: float, mode: str | None = block.mode) -> Converged:
                force = (pattern @ size)[:, None] * speed**2
                return loop.converged(mode, speed, condition, force)

            # a' = (eps/2) T (e_0 - S a) with a* = S^-1 e_0: a' = a*' leaves e = (2/eps) T^-1 a*'
            below, above = max(0.999 * w, block.band[0]), min(1.001 * w, block.band[1])
            slope = (settled(above).c - settled(below).c) / (above - below)
            e = 2 / block.gain * np.linalg.solve(table.at(w), slope)
            z = np.exp(1j * w * loop.timing.sample_time)
            K = transfer_at(loop.controller(loop.plant(w, condition)), z)
            left.append(float(np.abs(K @ e).max()))
            before.append(float(np.abs(settled(w, None).u).max()))
        k = int(np.argmax(left))
        share = float(np.max(np.array(left) / np.array(before)))
        found.append(Lag(block.band, float(speeds[k]), left[k] / max(before), share))
    return found


def transfer_at(law: StateSpace, z: complex) -> np.ndarray:
    """(outputs, inputs) of a sampled law at z."""
    inner = np.linalg.solve(z * np.eye(len(law.A)) - law.A, law.B.astype(complex))
    return np.asarray(law.C @ inner + law.D)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--part", choices=("members", "attack", "runup", "through", "rate"), default="members"
    )
    parser.add_argument("--machine", nargs="*", default=MACHINES)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--bands", type=int, default=8, help="of the attack")
    parser.add_argument("--span", type=float, nargs=2, default=(700.0, 1250.0), help="rad/s")
    parser.add_argument("--rate", type=float, default=25.0, help="rad/s^2, of through")
    parser.add_argument("--slow", type=float, default=1.0, help="of the run-up")
    parser.add_argument("--quiet", action="store_true", help="run-up without noise")
    options = parser.parse_args()
    for name in options.machine:
        if options.part == "members":
            m = members_of(name, options.count)
            print(
                f"{name}: small gains {m.lost[0]} of {m.tried[0]} lost, smallest angle "
                f"{m.angle:.1f} deg; exact poles {m.lost[1]} of {m.tried[1]} lost, "
                f"{m.unstable} unstable without a block",
                flush=True,
            )
        elif options.part == "attack":
            tried, proved, refuted = attack_on(name, options.count, options.bands)
            print(f"{name}: {tried} tables, {proved} proved, {refuted} refuted", flush=True)
        elif options.part == "rate":
            for lag in lags_of(name):
                print(
                    f"{name}, {lag.band[0]:.4g} to {lag.band[1]:.4g} rad/s: 30 dB of the largest "
                    f"current at {lag.rate(30):.3g} rad/s^2 ({lag.speed:.4g} rad/s), at every "
                    f"speed at {10**-1.5 / lag.own:.3g} rad/s^2",
                    flush=True,
                )
        elif options.part == "through":
            low, high = options.span
            for line in through(name, low, high, (high - low) / options.rate):
                print(f"{name}: {line}", flush=True)
        else:
            words, r = run_up(name, options.slow, quiet=options.quiet)
            print(
                f"{name}, {words}: 1x current {r.current:.1f} dB, force {r.force:.1f} dB, orbit "
                f"{r.orbit:.1f} dB, on {r.share_on:.0%}; S {r.sensitivity[0]:.3g} without, "
                f"{r.sensitivity[1]:.3g} with",
                flush=True,
            )


if __name__ == "__main__":
    main()
