"""Time responses, sensitivities, records and run-ups, beside python-control and plain ways of doing
the same.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose import load_machine
from ambrose.core.response import SystemDerivative, held_derivative, impulse_response, simulate
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.output_error.normal_equations import lift, stream
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.files import read_record, write_record
from ambrose.record.record import Record
from ambrose.rig import linear
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trace import Trace

DT, HZ = 1e-4, 2 * np.pi


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer name, error (largest difference over
    the largest value).
    """
    full, reduced = _loop(1 if smoke else None), _loop(0)
    part = 100 if smoke else 1  # of the samples
    for loop, k in ((full, 5_000 // part), (reduced, 50_000 // part)):
        yield _against_control(
            f"{loop.n_states}-state loop, {k:,} samples, 1 input, 4 outputs", loop, k
        )
    yield _against_stepping(reduced, 1_000_000 // part, 50_000 // part)
    yield _impulse(full, 2_000 // part)
    yield _sensitivity(reduced, 50_000 // part)
    yield _run_up()
    yield from _files(50_000 // part)


def _loop(bending_modes: int | None) -> StateSpace:
    machine = load_machine("seal-rig")
    plant = assemble(machine, OperatingPoint(seal_pressure=1e5))
    if bending_modes is not None:
        plant = free_mode_reduction(plant, bending_modes)
    loop = closed_loop(plant, pid_controller(machine.controller, machine))
    return select(loop, "e_A_zeta", [f"y_{axis}" for axis in machine.axes])


def _seconds(job: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """The shortest time of a few runs, and the result."""
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.perf_counter()
        result = job()
        best = min(best, time.perf_counter() - start)
    return best, result


def _row(
    name: str, ours: float, peer: float | None, peer_name: str, error: float
) -> dict[str, Any]:
    return {"name": name, "ours": ours, "peer": peer, "peer_name": peer_name, "error": error}


def _excitation(k: int) -> np.ndarray:
    return np.sign(np.random.default_rng(0).standard_normal((1, k))) * 0.1


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


def _against_control(name: str, loop: StateSpace, k: int) -> dict[str, Any]:
    """Against forced_response of the held model: the only way to get an exact answer from
    python-control.
    """
    import control

    u, t = _excitation(k), np.arange(k) * DT
    ours, y = _seconds(lambda: simulate(loop, u, DT))
    system = loop.to_control()
    peer, other = _seconds(
        lambda: control.forced_response(control.c2d(system, DT, "zoh"), t, u).outputs, 1
    )
    return _row(name, ours, peer, "python-control c2d + forced_response", _difference(y, other))


def _against_stepping(loop: StateSpace, k: int, part: int) -> dict[str, Any]:
    """k samples; the peer takes the first ``part`` of them."""
    u = _excitation(k)
    ours, y = _seconds(lambda: simulate(loop, u, DT), 1)
    held = c2d(loop, DT)

    def step() -> np.ndarray:
        x, states = np.zeros(held.n_states), np.empty((part, held.n_states))
        for i in range(part):
            states[i] = x
            x = held.A @ x + held.B[:, 0] * u[0, i]
        return held.C @ states.T

    peer, other = _seconds(step, 1)
    name = f"{loop.n_states}-state loop, {k:,} samples"
    return _row(
        name,
        ours,
        peer * k / part,
        "numpy, sample by sample (extrapolated)",
        _difference(y[:, :part], other),
    )


def _impulse(loop: StateSpace, k: int) -> dict[str, Any]:
    ours, y = _seconds(lambda: impulse_response(loop, k, DT))

    def powers() -> np.ndarray:
        E, x = sla.expm(loop.A * DT), loop.B
        values = np.empty((len(loop.C), k))
        for i in range(k):
            values[:, i] = (loop.C @ x)[:, 0]
            x = E @ x
        return values

    peer, other = _seconds(powers, 1)
    name = f"impulse response, {loop.n_states} states, {k:,} samples"
    return _row(name, ours, peer, "scipy expm, sample by sample", _difference(y[:, 0], other))


def _sensitivity(loop: StateSpace, k: int) -> dict[str, Any]:
    """Nine parameters, k samples at 10 kHz, against central differences of our own simulation;
    error: of the differences.
    """
    rng = np.random.default_rng(1)
    u = _excitation(k)
    directions = [
        SystemDerivative(
            1e-3 * rng.standard_normal(loop.A.shape) * np.abs(loop.A),
            0 * loop.B,
            0 * loop.C,
            0 * loop.D,
        )
        for _ in range(9)
    ]

    def exact() -> np.ndarray:
        dA, dB = (np.array([getattr(d, letter) for d in directions]) for letter in "AB")
        A, B, dA, dB = held_derivative(loop.A, loop.B, dA, dB, DT)
        sampled = StateSpace(A, B, loop.C, loop.D, dt=DT)
        lifted = lift(
            sampled,
            [SystemDerivative(a, b, 0 * loop.C, 0 * loop.D) for a, b in zip(dA, dB, strict=True)],
        )
        pieces = [
            F.transpose(0, 2, 1, 3).reshape(len(F), len(loop.C), -1)
            for _, F in stream(lifted, list(u), np.zeros(len(A)))
        ]
        return np.concatenate(pieces, axis=2)[1:, :, :k]

    ours, dy = _seconds(exact, 1)

    def differences() -> np.ndarray:
        h = 1e-4
        result = []
        for d in directions:
            ends = [StateSpace(loop.A + s * h * d.A, loop.B, loop.C, loop.D) for s in (1, -1)]
            plus, minus = (simulate(end, u, DT) for end in ends)
            result.append((plus - minus) / (2 * h))
        return np.array(result)

    peer, other = _seconds(differences, 1)
    name = f"exact sensitivities, 9 parameters, {loop.n_states} states, {k:,} samples"
    return _row(
        name,
        ours,
        peer,
        "central differences of ambrose's own response (error is theirs)",
        _difference(other, dy),
    )


def _run_up() -> dict[str, Any]:
    """Error: the estimate that the simulation makes of itself."""
    machine = load_machine("seal-rig")
    K = pid_controller(machine.controller, machine)

    def loop_at(speed: float) -> StateSpace:
        return closed_loop(
            free_mode_reduction(assemble(machine, OperatingPoint(speed=speed)), 2), K
        )

    scenario = load_scenario("run-up").on(machine)  # its speeds are shares of the balance speed
    ends = [scenario.speed_at(0.0), scenario.speed_at(scenario.duration)]

    def run() -> Trace:
        return linear.run(
            ScheduledSystem(ends, [loop_at(speed) for speed in ends]), scenario, mass=68.9
        )

    ours, trace = _seconds(run, 1)
    return _row(
        f"run-up {ends[0] / HZ:.0f} to {ends[1] / HZ:.0f} Hz, reduced loop",
        ours,
        None,
        "",
        trace.speed_error,
    )


def _files(k: int) -> list[dict[str, Any]]:
    """A record of 12 signals of k samples; error: of what comes back."""
    values = np.random.default_rng(2).standard_normal((12, k))
    record = Record("bench", 1 / DT, tuple(f"y_{i}" for i in range(12)), ("m",) * 12, values)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in ("h5", "csv"):
            path = Path(folder) / f"record.{suffix}"
            written, _ = _seconds(lambda path=path: write_record(record, path))
            read, again = _seconds(lambda path=path: read_record(path))
            rows.append(
                _row(
                    f"write {suffix} record, {12 * k:,} numbers",
                    written,
                    None,
                    "",
                    _difference(again.values, values),
                )
            )
            rows.append(
                _row(
                    f"read {suffix} record, {12 * k:,} numbers",
                    read,
                    None,
                    "",
                    _difference(again.values, values),
                )
            )
    return rows
