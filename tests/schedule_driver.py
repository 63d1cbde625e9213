"""Scheduled blocks for the tests, and what drives them: speeds of every kind."""

from pathlib import Path
from typing import Any

import numpy as np

import code_driver as driver
from ambrose import StateSpace
from ambrose.code.block.scheduled import ScheduledBlock, build_scheduled_block
from ambrose.code.sampled import deploy_scheduled
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.law.loop import response

ERROR = 1e-3
CURRENT = 2.0
DT = 1e-4
GRID = (100.0, 250.0, 300.0, 600.0)  # rad/s
PRESSURES = (0.0, 0.5e5, 2e5)  # Pa


def small_schedule(dt: float | None = None) -> ScheduledSystem:
    """A slow pole and a resonance that moves with speed, two errors, two currents, four grid points
    unevenly apart.
    """
    systems = []
    for v in GRID:
        w = 300.0 + 2.0 * v
        A = [[-2.0, 0.0, 0.0], [0.3 * v, -60.0 - 0.2 * v, w], [0.0, -w, -80.0]]
        B = [[20.0, 5.0], [1e3, 0.0], [0.5 * v, 2e3]]
        C = [[300.0, 900.0 - v, 40.0], [-100.0 + v, 0.0, 700.0]]
        D = [[1e3 + v, 0.0], [0.0, 2e3]]
        systems.append(StateSpace(A, B, C, D, ["err_x", "err_y"], ["u_x", "u_y"]))
    return ScheduledSystem(GRID, systems)


def pressure_schedule() -> ScheduledSystem:
    """The same over 0.1 to 0.6 bar: [Pa] is 100 times [rad/s]."""
    made = small_schedule()
    return ScheduledSystem(100.0 * made.grid, made.systems, "pressure", "Pa")


def both_schedule() -> ScheduledSystem:
    """The same over speed and 0 to 2 bar at three values: its gain and its damping change with the
    pressure, too.
    """
    systems = []
    for s in small_schedule().systems:
        for p in PRESSURES:
            A = s.A - np.diag([0.0, 4e-4 * p, 1e-4 * p])
            systems.append(
                StateSpace(A, s.B, (1 + 2e-6 * p) * s.C, s.D + 1e-3 * p, s.inputs, s.outputs)
            )
    return ScheduledSystem((GRID, PRESSURES), systems, "speed and pressure", "rad/s and Pa")


def two_states() -> ScheduledSystem:
    """Two states, an integrator among them, one error, one current."""
    systems = [
        StateSpace(
            [[0.0, 0.0], [0.0, -400.0 - v]],
            [[5.0], [3e3]],
            [[2e3, 10.0 + 0.1 * v]],
            [[1e3 + v]],
            ["err_x"],
            ["u_x"],
        )
        for v in GRID
    ]
    return ScheduledSystem(GRID, systems)


def gain_schedule() -> ScheduledSystem:
    """A gain that grows with speed, no states."""
    systems = [
        StateSpace([], [], [], [[2e3 + v, 0.0], [0.0, 3e3]], ["err_x", "err_y"], ["u_x", "u_y"])
        for v in GRID
    ]
    return ScheduledSystem(GRID, systems)


def block_of(schedule: ScheduledSystem, name: str = "lpv", **settings: Any) -> ScheduledBlock:
    return build_scheduled_block(
        deploy_scheduled(schedule, DT, DT, force=True), name, ERROR, CURRENT, **settings
    )


def replay(
    program: Path,
    arithmetic: str,
    errors: np.ndarray,
    speeds: np.ndarray,
    valid: np.ndarray | None = None,
    outputs: int = 2,
    **signals: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Currents (k, p) and status (k,) of the compiled block over errors (k, m) and speeds (k,)."""
    return driver.replay(
        program, arithmetic, errors, valid, outputs=outputs, speeds=speeds, **signals
    )


def adversarial_speeds(
    block: ScheduledBlock, count: int, seed: int = 0, axis: int = 0
) -> np.ndarray:
    """Speeds (count,): sweeps, jumps, grid points and their neighbours, out of range, NaN,
    infinity, denormals, any bits.
    """
    rng = np.random.default_rng(seed)
    grid = block.axes[axis]
    low, high = grid[0], grid[-1]
    v = np.empty(count)
    start = 0
    while start < count:
        k = int(min(rng.integers(20, 600), count - start))
        kind = int(rng.integers(0, 9))
        if kind <= 1:
            part = np.linspace(*rng.uniform(low, high, 2), k)
        elif kind == 2:
            part = np.linspace(low - 0.2 * high, 1.2 * high, k)[:: rng.choice([-1, 1])]
        elif kind == 3:
            part = rng.uniform(low, high, k)
        elif kind == 4:
            part = np.nextafter(rng.choice(grid, k), rng.choice([-np.inf, 0.0, np.inf], k))
        elif kind == 5:
            part = rng.choice(grid, k)
        elif kind == 6:
            part = np.where(
                rng.random(k) < 0.3,
                rng.choice([np.nan, np.inf, -np.inf, 1e300], k),
                rng.uniform(low, high),
            )
        elif kind == 7:
            part = np.full(k, np.nan)
        else:
            part = np.concatenate(
                [
                    np.frombuffer(rng.bytes(8 * (k - k // 2))),
                    rng.choice([5e-324, -0.0, -1e3, 1e-310], k // 2),
                ]
            )
        v[start : start + k] = part
        start += k
    return v


def apart_in_gain(sampled: ScheduledSystem, meant: ScheduledSystem, dt: float) -> float:
    """The largest relative distance of frequency responses at the grid points from Tustin's map of
    a continuous schedule.
    """
    omega = np.geomspace(1e-4, 0.99, 100) * np.pi / dt
    worst = 0.0
    for v in meant.grid:
        expected = response(c2d(meant.at(float(v)), dt, "tustin"), omega)
        found = response(sampled.at(float(v)), omega)
        worst = max(
            worst,
            float(
                (
                    np.linalg.norm(found - expected, 2, (1, 2))
                    / np.linalg.norm(expected, 2, (1, 2))
                ).max()
            ),
        )
    return worst
