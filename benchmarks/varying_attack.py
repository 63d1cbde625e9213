"""Proofs while the seal pressure changes, attacked in time: bang-bang, telegraph and random motions on a rigid sampled loop.

python -m benchmarks.varying_attack [--runs 1000] [--machine seal-rig] [--scheduled 0.408]

The attack looks for the largest energy gain along each motion of two seconds (power iteration with the adjoint); the
proof is that of ``verify``.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from ambrose import design, load_machine
from ambrose.core.statespace import StateSpace
from ambrose.machine.machine import Machine
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import match_controller
from ambrose.plant.reduce import reduce
from ambrose.plant.timing import Timing
from ambrose.verification.moving.on_model import check_on_model, scheduled_spans
from ambrose.verification.moving.pressure import check_pressure, pressure_loop
from ambrose.verification.moving.spans import PressureSpan, pressure_spans

RATES = (2e5, 2e6, np.inf)  # Pa/s
_TIMING = Timing(1e-4, 1)
_LEVELS = 81  # values of delta at which the loop is sampled
_SAMPLES = 20_000
_SHORT = 5_000
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


def levels(deltas: np.ndarray) -> np.ndarray:
    """The nearest of the _LEVELS values of delta."""
    return np.rint((deltas + 1) / 2 * (_LEVELS - 1)).astype(int)


def worst(members: list[StateSpace], index: np.ndarray, rng: np.random.Generator) -> float:
    """The largest gain found along the motions, index (runs, samples) of the member that each sample has."""
    A, B = np.array([m.A for m in members]), np.array([m.B for m in members])
    C, (runs, samples), n, p = members[0].C, index.shape, members[0].n_states, members[0].B.shape[1]
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
    small = pressure_loop(reduce(plant, 0, static_correction=False), span, law, _TIMING)
    members = [small.closed(np.full(small.parameters, delta)) for delta in np.linspace(-1, 1, _LEVELS)]
    for rate in RATES:
        begun, rng = time.process_time(), np.random.default_rng(1)
        if np.isfinite(rate):
            rows = {row.name: row for row in check_pressure(machine, span, law, _TIMING, rate).checks}
        row = rows["moving.sensitivity.rate" if np.isfinite(rate) else "moving.sensitivity.any"]
        above = row.value / rows["moving.frozen"].value - 1
        cost = time.process_time() - begun
        deltas = motions(rate / span.half, runs, rng, _TIMING.sample_time) if runs else np.empty((0, _SAMPLES))
        parts = np.array_split(levels(deltas), max(1, runs // _TOGETHER)) if runs else []
        found = f"; found {max(worst(members, part, rng) for part in parts):.4f} in {runs} motions" if runs else ""
        print(
            f"{name}, {rate / 1e5:g} bar/s: {row.value:.4f}, {above:.2%} above rest ({row.detail}), {cost:.1f} s{found}",
            flush=True,
        )


def attack_schedule(name: str, error: float, runs: int) -> None:
    """A controller scheduled over pressure, told within ``error`` [Pa]: proof at RATES[1], and motions of half a second."""
    machine = load_machine(name)
    law = design(machine, "lpv", pressures=pressure_range(machine), rate=1 / _TIMING.sample_time).scheduled
    (span,), rng, begun = scheduled_spans(machine, law), np.random.default_rng(1), time.process_time()
    rows = check_on_model(machine, span, law, _TIMING, RATES[1], error).checks
    print(f"{name}, scheduled over pressure, told within {error / 1e5:g} bar of it, {RATES[1] / 1e5:g} bar/s:")
    print(*(f"  {row.name} {row.value:.4f} ({row.detail})" for row in rows), sep="\n")
    print(f"  {time.process_time() - begun:.0f} s of processor time", flush=True)
    small = reduce(assemble(machine, span.middle), 0, static_correction=False)
    members = []
    for delta in np.linspace(-1, 1, _LEVELS):
        pressure = (span.low + span.high) / 2 + delta * span.half
        held = pressure_loop(small, span, law.at(span.low), _TIMING)
        for off in (-error, 0.0, error):
            told = min(max(pressure + off, span.low), span.high)
            running = _TIMING.in_loop(match_controller(law.at(told), small))
            members.append(replace(held, controller=running).closed(np.full(held.parameters, delta)))
    deltas = motions(RATES[1] / span.half, runs, rng, _TIMING.sample_time)[:, :_SHORT]
    length = 10 ** rng.uniform(1, 3.5, runs)
    told = np.array([np.repeat(rng.integers(0, 3, _SHORT), int(n))[:_SHORT] for n in length])
    parts = np.array_split(3 * levels(deltas) + told, max(1, runs // _TOGETHER))
    print(f"  found {max(worst(members, part, rng) for part in parts):.4f} in {runs} motions", flush=True)


def pressure_range(machine: Machine) -> tuple[float, float]:
    pressures = [point.seal_pressure for point in machine.operation.envelope]
    return min(pressures), max(pressures)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument(
        "--scheduled", type=float, metavar="BAR", help="attack a controller scheduled over pressure, told within BAR"
    )
    parser.add_argument("--machine", nargs="+", default=("seal-rig-k-only", "seal-rig"))
    given = parser.parse_args()
    runs = given.runs
    if given.scheduled is not None:
        attack_schedule("seal-rig", 1e5 * given.scheduled, runs)
        return
    for name in given.machine:
        machine = load_machine(name)
        attack(name, pressure_spans(machine)[0], design(machine, "tuned", rate=1 / _TIMING.sample_time).controller, runs)


if __name__ == "__main__":
    main()
