"""The virtual rig: simulated time per time of the computer, beside scipy's solve_ivp between the
same control samples.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ambrose as amb
from ambrose import load_machine
from ambrose.law.law import law_of
from ambrose.law.pid import pid_controller
from ambrose.model.effects import amplifier, magnet, seal
from ambrose.model.plant import top_speed
from ambrose.record.record import Record
from ambrose.rig import all_axes, virtual_rig
from ambrose.rig.engine.controller import sampled_law
from ambrose.rig.engine.equilibrium import levitated_state, measurement
from ambrose.rig.engine.inputs import Drive, plan, stretch
from ambrose.rig.engine.state import Rig, build, compiled
from ambrose.rig.scenario import Prbs, Scenario, Sine, Unbalance

DT = 1e-4
LENGTH = 10.0  # simulated seconds
PEER_LENGTH = 0.2
EXAMPLE = Path(__file__).parents[1] / "examples" / "expander-five-axes.toml"
MACHINE = load_machine("seal-rig")
PID = pid_controller(MACHINE.controller, MACHINE)
MEMORY = """
import resource, tempfile, pathlib
from benchmarks.bench_rig import MACHINE, PID, excited
from ambrose.rig import virtual_rig
with tempfile.TemporaryDirectory() as folder:
    trace = virtual_rig.run(MACHINE, PID, excited(SECONDS), path=pathlib.Path(folder) / "run.h5")
print(trace.run_time, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
COMPILE = """
from benchmarks.bench_rig import MACHINE, PID, excited
from ambrose.rig import virtual_rig
print(virtual_rig.run(MACHINE, PID, excited(0.01)).compile_time)
"""


def excited(length: float) -> Scenario:
    """Binary sequences of 0.5 A on two axes: displacements up to 50 um."""
    sequences = (Prbs("e_A_zeta", 0.5, 1e-3, 7), Prbs("e_B_eta", 0.5, 1e-3, 7, 1))
    return Scenario("excited", length, sequences=sequences)


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """Rows as benchmarks/__main__.py wants them; ours is the time for ten simulated seconds unless
    the name says otherwise.
    """
    yield from _against_scipy(
        *((0.5, 0.01, ("RK23",)) if smoke else (LENGTH, PEER_LENGTH, ("RK23", "RK45", "LSODA")))
    )
    yield from _cost(
        *((0.05, (1,), (5e3,)) if smoke else (2.0, (0, 1, 3, 8), (5e3, 10e3, 20e3, 40e3)))
    )
    # as long in a smoke run: a difference of shorter runs is less than what the start scatters by
    yield from _all_axes(4.0, *(((10e3,), 1) if smoke else ((10e3, 20e3), 3)))
    yield _memory(0.5 if smoke else 60.0)
    if not smoke:  # half a minute by its nature
        yield from _compilation()


def _seconds(scenario: Scenario, **options: Any) -> float:
    """The shortest of three runs; without the start, which is compiled and prepared code."""
    return min(virtual_rig.run(MACHINE, PID, scenario, **options).run_time for _ in range(3))


def _difference(record: Record, reference: Record) -> float:
    names = [name for name in reference.signals if name.startswith(("y_", "q_"))]
    a, b = record.select(names).values, reference.select(names).values
    k = min(a.shape[1], b.shape[1])
    return float(np.abs(a[:, :k] - b[:, :k]).max() / np.abs(b).max())


def _row(
    name: str,
    ours: float,
    error: Any,
    target: str = "",
    peer: float | None = None,
    peer_name: str = "",
) -> dict[str, Any]:
    return {
        "name": name,
        "ours": ours,
        "peer": peer,
        "peer_name": peer_name,
        "error": error,
        "target": target,
    }


def _against_scipy(
    length: float, peer_length: float, methods: tuple[str, ...]
) -> Iterator[dict[str, Any]]:
    """Both at an error of 1e-5 at most. solve_ivp gets the same forces in Python, and then our
    compiled derivative as well.
    """
    ours = _seconds(excited(length))
    short = excited(peer_length)
    fine = virtual_rig.run(MACHINE, PID, short, dt=2.5e-6).record
    error = _difference(virtual_rig.run(MACHINE, PID, short).record, fine)
    y = fine.select([f"y_{axis}" for axis in MACHINE.axes]).values
    title = f"virtual rig, rigid + 1 bending mode, {length:g} s at 10 kHz: {length / ours:.0f} s/s"
    for kind, target in (("Python", ">= 30 s/s at 1e-5, >= 150x"), ("our compiled", "")):
        found = []
        for method in methods:
            seconds, other = _scipy(short, method, 1e-4, kind != "Python")
            difference = float(np.abs(other - y[:, : other.shape[1]]).max() / np.abs(y).max())
            if difference <= 1e-5:
                found.append(
                    (
                        seconds * length / peer_length,
                        f"solve_ivp {method}, {kind} derivative, error {difference:.1e}",
                    )
                )
        peer, name = min(found)
        yield _row(title, ours, error, target, peer, name)


def _in_python(rig: Rig, drive: Drive) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """dz/dt of state and command by numpy and the force functions of physics: the seal rig at rest,
    free of contact.
    """
    k, p, a = rig.constants, rig.modes, len(rig.axes)
    rows = drive.seal[0]
    couplings = rig.machine.couplings

    def derivative(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        q = z[: 2 * p].reshape(p, 2)
        v = z[2 * p : 4 * p].reshape(p, 2)
        amp = z[4 * p : 4 * p + 2 * a].reshape(a, 2)
        place, velocity = k.shape @ q, k.shape @ v
        force, dz = np.zeros_like(place), np.zeros_like(z)
        for b in range(len(k.magnet)):
            c, s = k.direction[b]
            x, y = place[b]
            f, g = magnet.force(
                amp[2 * b, 0], amp[2 * b + 1, 0], c * x + s * y, c * y - s * x, k.magnet[b]
            )
            force[b] += c * f - s * g, s * f + c * g
        b = len(k.magnet)
        for i, spring in enumerate(couplings):
            c, s = k.direction[b + i]
            (x, y), (vx, vy) = place[b + i], velocity[b + i]
            f = -spring.stiffness[0] * (c * x + s * y) - spring.damping[0] * (c * vx + s * vy)
            g = -spring.stiffness[1] * (c * y - s * x) - spring.damping[1] * (c * vy - s * vx)
            force[b + i] += c * f - s * g, s * f + c * g
        b += len(couplings)
        for i in range(len(rows)):
            force[b + i] += seal.force(*place[b + i], *velocity[b + i], 0.0, 0.0, rows[i, :5])
        dz[: 2 * p] = z[2 * p : 4 * p]
        acceleration = k.shape.T @ force - k.stiffness[:, None] * q - k.damping[:, None] * v
        dz[2 * p : 4 * p] = acceleration.ravel() + k.weight
        for i in range(a):
            dz[4 * p + 2 * i : 4 * p + 2 * i + 2] = amplifier.derivative(
                u[i], *amp[i], k.amplifier[i]
            )
        return dz

    return derivative


def _scipy(
    scenario: Scenario, method: str, rtol: float, with_ours: bool
) -> tuple[float, np.ndarray]:
    """Time [s] and measurements (a, k) of the same run, the machine integrated by solve_ivp from
    sample to sample.
    """
    from scipy.integrate import solve_ivp

    rig = build(MACHINE)
    task = plan(rig, scenario, DT, 0)
    drive = stretch(task, 0, task.samples)
    law = sampled_law(PID, MACHINE, DT, 0.0, 1)
    z, x, held = levitated_state(rig, drive, law)
    C, slopes, work, dz = measurement(rig), compiled()[1], rig.work(), np.zeros((1, rig.states))
    now, plain = np.zeros(len(rig.axes)), _in_python(rig, drive)

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        if not with_ours:
            return plain(state, now)
        slopes(rig.constants, drive, 0, now[None], state[None], work, dz)
        return dz[0].copy()  # RK23 keeps what it got: the same array would change under it

    atol = np.full(rig.states, 1e-12)
    atol[2 * rig.modes :] = 1e-9
    measured = np.empty((len(rig.axes), task.samples))
    begun = time.perf_counter()
    for k in range(task.samples):
        measured[:, k] = C @ z
        now = held + drive.excitation[:, k]
        held = np.clip(law.C @ x - law.D @ measured[:, k], -law.limit, law.limit)
        x = law.A @ x - law.B @ measured[:, k]
        z = solve_ivp(
            derivative, (0.0, DT), z, method=method, rtol=rtol, atol=atol, first_step=DT / 2
        ).y[:, -1]
    return time.perf_counter() - begun, measured


def _cost(
    length: float, bending: tuple[int, ...], rates: tuple[float, ...]
) -> Iterator[dict[str, Any]]:
    for modes in bending:
        ours = _seconds(excited(length), bending_modes=modes) * LENGTH / length
        short = [
            virtual_rig.run(MACHINE, PID, excited(0.05), bending_modes=modes, dt=dt).record
            for dt in (None, 2e-6)
        ]
        target = ">= 60 s/s, error <= 1e-7" if modes == 8 else ">= 120 s/s, error <= 1e-7"
        found = _row(
            f"  with {modes} bending modes: {LENGTH / ours:.0f} s/s",
            ours,
            _difference(*short),
            target,
        )
        yield {**found, "series": "virtual rig over displacements", "size": 4 + 2 * modes}
    for rate in rates:
        ours = _seconds(replace(excited(length), sample_time=1 / rate)) * LENGTH / length
        yield _row(f"  controller at {rate / 1e3:g} kHz: {LENGTH / ours:.0f} s/s", ours, "")


def _all_axes(length: float, rates: tuple[float, ...], runs: int) -> Iterator[dict[str, Any]]:
    """The example with its axis along the shaft, at full speed under an unbalance, the thrust
    swinging; three bending modes.
    """
    machine = load_machine(EXAMPLE)
    point = machine.operation.nominal
    laws = [amb.design(part, "pid").at(point) for part in (machine, machine.axial)]
    parts = all_axes.parts_of(law_of(laws[0]), laws[1])
    assert parts is not None
    speed = top_speed(machine)
    swing = Scenario(
        "swing",
        length,
        sines=(Sine("f_thrust_z", 60.0, 50.0),),
        unbalances=(Unbalance("every", grade=2.5e-3, grade_speed=speed),),
        speed=speed,
    )
    all_axes.run(machine, parts, replace(swing, duration=0.01))  # compiled
    for rate in rates:
        # processor time of three lengths less that of one: what a second more takes, whatever
        # else the computer does
        short = replace(swing, sample_time=1 / rate)
        long = replace(short, duration=3 * length)
        once, thrice = (
            min(_processor(all_axes.run, machine, parts, events) for _ in range(runs))
            for events in (short, long)
        )
        ours = (thrice - once) / 2
        title = f"  all five axes at {rate / 1e3:g} kHz: {length / ours:.0f} s/s"
        yield _row(title, ours * LENGTH / length, "", ">= 60 s/s")


def _processor(call: Callable[..., Any], *arguments: Any) -> float:
    begin = time.process_time()
    call(*arguments)
    return time.process_time() - begin


def _memory(length: float) -> dict[str, Any]:
    program = MEMORY.replace("SECONDS", str(length))
    seconds, megabytes = (float(word) for word in _elsewhere(program).split())
    return _row(
        f"  {length:g} s at 10 kHz, all signals, record on disk",
        seconds,
        f"{megabytes:.0f} MB",
        "< 500 MB",
    )


def _compilation() -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        cold = float(_elsewhere(COMPILE, NUMBA_CACHE_DIR=folder))
        warm = float(_elsewhere(COMPILE, NUMBA_CACHE_DIR=folder))
    return [
        _row("  compiling, once per computer", cold, ""),
        _row("  the same from the cache, and preparing a run", warm, ""),
    ]


def _elsewhere(program: str, **environment: str) -> str:
    """What a program prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout
