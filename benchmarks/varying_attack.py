"""Proofs while the seal pressure changes, attacked in time: bang-bang, telegraph and random motions on a rigid sampled loop.

python -m benchmarks.varying_attack [--runs 1000]

The attack looks for the largest energy gain along each motion of two seconds (power iteration with the adjoint); the
proof is of the full plant.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from ambrose import design, load_machine
from ambrose.core.checks import NumericalFailure
from ambrose.core.statespace import StateSpace
from ambrose.core.varying.loop import VaryingLoop
from ambrose.core.varying.proof import proved_gain
from ambrose.plant.assemble import assemble
from ambrose.plant.reduce import reduce
from ambrose.plant.timing import Timing
from ambrose.verification.moving.pressure import PressureSpan, filter_poles, frozen_peaks, pressure_loop, pressure_spans

RATES = (2e5, 2e6, np.inf)  # Pa/s
_TIMING = Timing(1e-4, 1)
_LEVELS = 81  # values of delta at which the loop is sampled
_SAMPLES = 20_000
_ITERATIONS = 6
_TOGETHER = 250


def motions(rate: float, runs: int, rng: np.random.Generator, dt: float) -> np.ndarray:
    """delta (runs, samples) within -1 .. 1 and the rate [1/s]: a third each of square waves, telegraphs and random walks."""
    t = np.arange(_SAMPLES) * dt
    found = np.empty((runs, _SAMPLES), np.float32)
    for k in range(runs):
        if k % 3 == 0:
            wanted = np.sign(np.sin(2 * np.pi * 10 ** rng.uniform(-0.5, 2.5) * t + rng.uniform(0, 6.3)))
        elif k % 3 == 1:
            length = int(10 ** rng.uniform(1, 3.5))
            wanted = np.sign(np.repeat(rng.normal(size=_SAMPLES // length + 1), length)[:_SAMPLES])
        else:
            wanted = np.sin(np.cumsum(rng.normal(size=_SAMPLES)) * 10 ** rng.uniform(-2.5, -0.5))
        found[k] = wanted
    if np.isfinite(rate):
        for k in range(1, _SAMPLES):
            found[:, k] = found[:, k - 1] + np.clip(found[:, k] - found[:, k - 1], -rate * dt, rate * dt)
    return found


def worst(loop: VaryingLoop, deltas: np.ndarray, rng: np.random.Generator) -> float:
    """The largest gain found along the motions, the pressure held over each sample."""
    members = [loop.closed(np.full(loop.parameters, delta)) for delta in np.linspace(-1, 1, _LEVELS)]
    A, B = np.array([m.A for m in members]), np.array([m.B for m in members])
    C, (runs, samples), n, p = members[0].C, deltas.shape, members[0].n_states, members[0].B.shape[1]
    index = np.rint((deltas + 1) / 2 * (_LEVELS - 1)).astype(int)
    d, size = rng.normal(size=(samples, runs, p)).astype(np.float32), 1.0
    for _ in range(_ITERATIONS):
        d /= np.sqrt((d**2).sum(axis=(0, 2)))[:, None]
        x, y = np.zeros((runs, n)), np.empty_like(d)
        for k in range(samples):
            y[k] = x @ C.T + d[k]
            x = np.einsum("rij,rj->ri", A[index[:, k]], x) + np.einsum("rij,rj->ri", B[index[:, k]], d[k])
        size = float(np.sqrt((y.astype(float) ** 2).sum(axis=(0, 2))).max())
        costate = np.zeros((runs, n))
        for k in range(samples - 1, -1, -1):
            d[k] = y[k] + np.einsum("rij,ri->rj", B[index[:, k]], costate)
            costate = y[k] @ C + np.einsum("rij,ri->rj", A[index[:, k]], costate)
    return size


def attack(name: str, span: PressureSpan, law: StateSpace, runs: int) -> None:
    machine = load_machine(name)
    plant = assemble(machine, span.middle)
    loop, rest = pressure_loop(plant, span, law, _TIMING), frozen_peaks(plant, span, law, _TIMING)
    small = pressure_loop(reduce(plant, 0, static_correction=False), span, law, _TIMING)
    print(f"{name}: at rest {rest.gain:.4f} at {rest.pressure / 1e5:.3g} bar", flush=True)
    for rate in RATES:
        begun, rng = time.process_time(), np.random.default_rng(1)
        poles = filter_poles(rest, loop.channels) if np.isfinite(rate) else ()
        try:
            gamma = proved_gain(loop, poles, [rate / span.half] * loop.parameters).gamma
            words = f"proved {gamma:.4f}, {gamma / rest.gain - 1:.2%} above rest"
        except NumericalFailure as error:
            words = f"not proved ({error})"
        cost = time.process_time() - begun
        deltas = motions(rate / span.half, runs, rng, _TIMING.sample_time) if runs else np.empty((0, _SAMPLES))
        parts = np.array_split(deltas, max(1, runs // _TOGETHER)) if runs else []
        found = f"; found {max(worst(small, part, rng) for part in parts):.4f} in {runs} motions" if runs else ""
        print(f"  {rate / 1e5:g} bar/s: {words}, {cost:.1f} s of processor time{found}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    runs = parser.parse_args().runs
    for name in ("seal-rig-k-only", "seal-rig"):
        machine = load_machine(name)
        attack(name, pressure_spans(machine)[0], design(machine, "tuned").controller, runs)


if __name__ == "__main__":
    main()
