"""Proofs while the seal pressure changes, attacked in time: motions of 0.4 s that go round, on a
sampled loop.

python -m benchmarks.varying_attack [--runs 1000] [--machine seal-rig] [--rates 2 20 inf]
[--scheduled 0.408] [--proofs]

Tried are the worst at rest, triangles at the rate between all pressures (squares where it may move
at any speed), and --runs random motions (squares, telegraphs, random walks) there and back, on the
rigid rotor, each with the disturbance that it amplifies most. The best are bent uphill
(motion_gain.py), and the best of all is run again for four seconds from rest, with the exact
matrices of every sample and three bending modes per plane; pressure and told value are held within
a sample. What a motion is worth is how far it gets above the worst at rest of the same loop.
--proofs: and what ``verify`` proves; --keep FOLDER: the motions as CSV.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ambrose import design, load_machine
from ambrose.annexes.scheduled.moving_model import (
    PressureSpan,
    check_on_model,
    pressure_spans,
    scheduled_spans,
)
from ambrose.annexes.scheduled.moving_proofs import check_pressure, pressure_loop
from ambrose.core.norms import HinfNorm, hinf_norm
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.law.loop import Timing, match_controller
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce
from benchmarks.motion_gain import Gain, Motion, Tables, ascend, closed, gain, growth, tables

_TIMING = Timing(1e-4, 1)
_LEVELS = 81  # values of delta at which the loop is sampled
# s: a motion, before it, and the best one again
_LASTS = 0.4
_RUN_IN = 0.3
_LONG = 4.0
# Lanczos steps for a motion, and for the best one; how many of either kind are bent
_STEPS = 6
_MANY = 30
_BEST = 4
_MODES = 3  # bending modes per plane of the plant on which the best motion is run again
_BOTTOMS, _TRIANGLES = 13, 16  # pressures at which triangles begin, and periods
_BLOWN = 50.0  # a gain above which a motion is looked at for growth


@dataclass(frozen=True, eq=False)
class Held:
    """The loop at a delta that stands still and is told as another, and its peak."""

    delta: float
    told: float
    loop: StateSpace
    peak: HinfNorm


@dataclass(frozen=True, eq=False)
class Target:
    """What is attacked: a law, fixed or scheduled over pressure and told within ``error`` [Pa],
    over a span.
    """

    machine: Machine
    span: PressureSpan
    law: StateSpace | ScheduledSystem
    error: float = 0.0

    def told(self, deltas: np.ndarray, small: Plant) -> list[StateSpace]:
        """The law as it runs where these values of delta are told; one of a fixed law."""
        if not isinstance(self.law, ScheduledSystem):
            return [_TIMING.in_loop(match_controller(self.law, small))]
        pressures = (self.span.low + self.span.high) / 2 + deltas * self.span.half
        return [_TIMING.in_loop(match_controller(self.law.at(p), small)) for p in pressures]

    def tables(
        self,
        modes: int,
        deltas: np.ndarray,
        told: np.ndarray,
        before: float,
        kind: type = np.float32,
    ) -> Tables:
        small = reduce(assemble(self.machine, self.span.middle), modes, static_correction=False)
        laws = self.told(told, small)
        return tables(
            pressure_loop(small, self.span, laws[0], _TIMING),
            deltas,
            laws,
            round(before / _TIMING.sample_time),
            kind,
        )

    def at_rest(self, modes: int) -> tuple[Tables, list[Held]]:
        """The loop in tables, and at rest with what is told right, and off by the error either way;
        the worst comes first.
        """
        values, off = np.linspace(-1, 1, _LEVELS), self.error / self.span.half
        on = self.tables(modes, values, values, _RUN_IN)
        every = values[:: 2 if off else 1]
        pairs = sorted(
            {(delta, min(max(delta + e, -1.0), 1.0)) for delta in every for e in (-off, 0.0, off)}
        )
        found = []
        for delta, told in pairs:
            loop = closed(
                on, Motion(np.array([delta]), np.array([told - delta])), _TIMING.sample_time
            )
            found.append(Held(delta, told, loop, hinf_norm(loop)))
        return on, sorted(found, key=lambda held: -held.peak.value)


def started(rest: list[Held], samples: int, rng: np.random.Generator) -> np.ndarray:
    """A disturbance (samples, p) with something of every peak at rest."""
    found = 0.01 * rng.normal(size=(samples, rest[0].loop.B.shape[1]))
    for held in rest:
        loop, z = held.loop, np.exp(1j * held.peak.frequency * _TIMING.sample_time)
        right = np.linalg.svd(
            loop.C @ np.linalg.solve(z * np.eye(loop.n_states) - loop.A, loop.B) + loop.D
        )[2][0].conj()
        found += (
            z ** np.arange(samples)[:, None] * right * np.exp(2j * np.pi * rng.uniform())
        ).real
    return found


def triangles(rate: float, samples: int) -> list[Motion]:
    """At the rate [1/sample] up and down, or squares, from every bottom and as high as the period
    allows.
    """
    found, phase = [], np.arange(samples) / samples
    for count in np.unique(np.geomspace(1, 250 * _LASTS, _TRIANGLES).astype(int)):
        wave = 2 * np.abs((phase * count) % 1 - 0.5)
        tops = [rate * samples / count / 2] if np.isfinite(rate) else [0.1, 0.5, 1.0, 2.0]
        for height in sorted({min(top, 2.0) for top in tops}):
            for bottom in np.linspace(-1, 1 - height, _BOTTOMS if height < 2 else 1):
                shape = (
                    np.rint(wave)
                    if not np.isfinite(rate)
                    else np.clip(wave * rate * samples / count / 2 / height, 0, 1)
                )
                found.append(Motion(bottom + height * shape))
    return found


def random_motions(rate: float, samples: int, runs: int, rng: np.random.Generator) -> np.ndarray:
    """delta (runs, samples) within -1 .. 1 and the rate [1/sample], there and back: squares,
    telegraphs and random walks.
    """
    half, duration = -(-samples // 2), samples * _TIMING.sample_time
    t, found = np.linspace(0, duration / 2, half), np.empty((runs, half))
    for k in range(runs):
        if k % 3 == 0:
            found[k] = np.sign(
                np.sin(2 * np.pi * 10 ** rng.uniform(0, 2.5) * t + rng.uniform(0, 6.3))
            )
        elif k % 3 == 1:
            length = int(10 ** rng.uniform(1, 3.2))
            found[k] = np.sign(np.repeat(rng.normal(size=half // length + 1), length)[:half])
        else:
            found[k] = np.sin(
                np.cumsum(rng.normal(size=half)) * 10 ** rng.uniform(-2.5, -0.5)
                + rng.uniform(0, 6.3)
            )
    if np.isfinite(rate):
        found[:, 0] = rng.uniform(-1, 1, runs)
        for k in range(1, half):
            found[:, k] = found[:, k - 1] + np.clip(found[:, k] - found[:, k - 1], -rate, rate)
    return np.hstack([found, found[:, ::-1][:, : samples - half]])


def told_off(error: float, samples: int, runs: int, rng: np.random.Generator) -> list[np.ndarray]:
    """By how much the told value is off (samples,): at either end of its band or right, for random
    lengths of time.
    """
    lengths = [int(10 ** rng.uniform(1, 3.2)) for _ in range(runs)]
    return [error * np.repeat(rng.integers(-1, 2, samples // n + 1), n)[:samples] for n in lengths]


def attack(target: Target, rate: float, runs: int, keep: Path | None = None) -> str:
    """The best motion found at up to a rate [Pa/s], in words."""
    begun, rng = time.process_time(), np.random.default_rng(1)
    on, rest = target.at_rest(0)
    worst = rest[0]
    round_trip = 2 * np.pi / worst.peak.frequency / _TIMING.sample_time
    samples = round(max(1, round(_LASTS / _TIMING.sample_time / round_trip)) * round_trip)
    step, off = rate / target.span.half * _TIMING.sample_time, target.error / target.span.half
    known = triangles(step, samples)
    drawn = [Motion(delta) for delta in random_motions(step, samples, runs, rng)]
    if target.error:
        known = [Motion(m.delta, sign * np.full(samples, off)) for m in known for sign in (-1, 1)]
        drawn = [
            Motion(m.delta, e)
            for m, e in zip(drawn, told_off(off, samples, runs, rng), strict=True)
        ]
    start, words = started(rest, samples, rng), [f"at rest {worst.peak.value:.4f}"]
    held = Motion(
        np.full(samples, worst.delta),
        np.full(samples, worst.told - worst.delta) if target.error else None,
    )
    best = [(gain(on, on.places(held), start, _MANY), held)]
    shapes = "triangles" if np.isfinite(rate) else "squares"
    for called, motions in ((f"{len(known)} {shapes}", known), (f"{runs} at random", drawn)):
        found = [(gain(on, on.places(m), start, _STEPS), m) for m in motions]
        found.sort(key=lambda pair: -pair[0].value)
        best += found[:_BEST]
        words.append(f"{called} {found[0][0].value:.4f}" if found else "")
    bent = [ascend(on, motion, at.disturbance, step, off, rng) for at, motion in best]
    top, motion = max(bent + best, key=lambda pair: pair[0].value)
    top = gain(on, on.places(motion), top.disturbance, _MANY)
    words.append(f"uphill from the best {len(best)} {top.value:.4f}")
    again = run_again(target, motion, top)
    if keep:
        keep.mkdir(exist_ok=True)
        write(target, motion, keep / f"{target.machine.name}-{rate / 1e5:g}-bar-per-s.csv")
    cost = time.process_time() - begun
    return (
        f"  {'; '.join(word for word in words if word)}\n  {again}\n  "
        f"{described(target, motion, top, step)}; {cost:.0f} s"
    )


def run_again(target: Target, motion: Motion, found: Gain) -> str:
    """The motion over and over for _LONG from rest, with exact matrices and bending modes."""
    samples = len(motion.delta)
    told = motion.delta if motion.error is None else np.clip(motion.delta + motion.error, -1, 1)
    on = target.tables(_MODES, motion.delta, told, 0.0, float)
    if found.value > _BLOWN and (factor := growth(on, np.arange(samples, dtype=float))) > 1:
        return (
            f"with {_MODES} bending modes per plane the motion loses the rotor: its states grow by "
            f"{factor:.3g} every round"
        )
    laps = round(np.ceil(_LONG / _TIMING.sample_time / samples))
    places = np.tile(np.arange(samples, dtype=float), laps)
    rest, rng = target.at_rest(_MODES)[1], np.random.default_rng(1)
    once = found.disturbance / np.abs(found.disturbance).max() + 0.1 * started(
        rest[:1], samples, rng
    )
    start = (
        np.tile(once, (laps, 1))
        * np.sin(np.pi * (np.arange(samples * laps) + 0.5) / samples / laps)[:, None]
    )
    value = gain(on, (places, places if len(on.law) > 1 else 0 * places), start, _MANY).value
    above = (
        f"{value / rest[0].peak.value - 1:+.2%} from the worst at rest there, "
        f"{rest[0].peak.value:.4f}"
    )
    return f"again with {_MODES} bending modes per plane: {value:.4f}, {above}"


def pressures(target: Target, delta: np.ndarray) -> np.ndarray:
    """In bar."""
    return ((target.span.low + target.span.high) / 2 + delta * target.span.half) / 1e5


def described(target: Target, motion: Motion, found: Gain, step: float) -> str:
    """Where it moves, how often it turns, and at which frequency the rotor is disturbed."""
    p, round_time = pressures(target, motion.delta), len(motion.delta) * _TIMING.sample_time
    energy = (np.abs(np.fft.rfft(found.disturbance, axis=0)) ** 2).sum(axis=1)
    moved = np.diff(motion.delta)
    turns = int((np.diff(np.sign(moved[np.abs(moved) > 1e-9])) != 0).sum())
    share = (
        f", {np.mean(np.abs(moved) > 0.95 * step):.0%} of the time at the rate"
        if np.isfinite(step)
        else ""
    )
    where = (
        f"{p.min():.3g} to {p.max():.3g} bar, {turns / 2 / round_time:.3g} times up and down a "
        f"second{share}"
    )
    return f"the motion: {where}; disturbed at {np.argmax(energy) / round_time:.3g} Hz"


def write(target: Target, motion: Motion, path: Path) -> None:
    """One round: time [s], pressure [Pa], and what is told [Pa]."""
    told = motion.delta if motion.error is None else np.clip(motion.delta + motion.error, -1, 1)
    columns = [
        np.arange(len(told)) * _TIMING.sample_time,
        1e5 * pressures(target, motion.delta),
        1e5 * pressures(target, told),
    ]
    np.savetxt(
        path, np.array(columns).T, delimiter=",", header="t,p_seal,p_told", comments="", fmt="%.10g"
    )


def proof(target: Target, rate: float) -> str:
    """What ``verify`` proves, in words."""
    begun = time.process_time()
    if isinstance(target.law, ScheduledSystem):
        rows = check_on_model(
            target.machine, target.span, target.law, _TIMING, rate, target.error
        ).checks
    else:
        rows = check_pressure(
            target.machine, target.span, target.law, _TIMING, rate if np.isfinite(rate) else 2e6
        ).checks
    values = {row.name: row.value for row in rows}
    proved = values[
        "moving.sensitivity.any" if not np.isfinite(rate) else "moving.sensitivity.rate"
    ]
    above = (
        f"{proved / values['moving.frozen'] - 1:+.2%} from rest on the full plant, "
        f"{values['moving.frozen']:.4f}"
    )
    return f"  proved {proved:.4f}, {above}; {time.process_time() - begun:.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument(
        "--rates", type=float, nargs="+", metavar="BAR/S", default=(2.0, 20.0, np.inf)
    )
    parser.add_argument(
        "--scheduled",
        type=float,
        metavar="BAR",
        help="attack a controller scheduled over pressure, told within BAR",
    )
    parser.add_argument("--machine", nargs="+", default=("seal-rig-k-only", "seal-rig"))
    parser.add_argument("--proofs", action="store_true")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    for name in given.machine:
        machine, rate = load_machine(name), 1 / _TIMING.sample_time
        if given.scheduled is None:
            target = Target(
                machine, pressure_spans(machine)[0], design(machine, "tuned", rate=rate).controller
            )
        else:
            span = pressure_spans(machine)[0]
            law = design(machine, "lpv", pressures=(span.low, span.high), rate=rate).scheduled
            target = Target(machine, scheduled_spans(machine, law)[0], law, 1e5 * given.scheduled)
        for bar_per_s in given.rates:
            told = (
                ""
                if given.scheduled is None
                else f", scheduled, told within {given.scheduled:g} bar"
            )
            print(f"{name}, {bar_per_s:g} bar/s{told}:", flush=True)
            if given.proofs:
                print(proof(target, 1e5 * bar_per_s), flush=True)
            print(attack(target, 1e5 * bar_per_s, given.runs, given.keep), flush=True)


if __name__ == "__main__":
    main()
