"""Many drops: friction, mount, unbalance and speed as nobody knows them, and what comes of it.

The cases are drawn at once from one seed, so that they do not depend on how many processors work on
them. A drop that turns three times against its spin without going back is said to whirl: a count on
the simulated motion, no statement on stability.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from threading import Event
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.drop import (
    FIGURES,
    Drop,
    brake_of,
    build,
    case_of,
    compiled,
    run,
    slip_of,
)
from ambrose.annexes.touchdown.fallen import FallenRotor
from ambrose.core.checks import NumericalFailure
from ambrose.machine.machine import Machine
from ambrose.model.effects.touchdown import Bearing

WHIRLS = 3.0  # whole turns against the spin
# factors on the file's values, lowest and highest: friction evenly, mount by its logarithm
FRICTION, MOUNT = (0.5, 1.5), (0.5, 2.0)
SPEED = (0.5, 1.0)  # of the operating point's, evenly
_CHUNK = 8  # drops between two looks at whether to go on
_QUANTILES = (0.05, 0.5, 0.95, 1.0)  # of the drops, in the table


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Drops d of one machine at b bearings.

    cases (d, 4): factors on friction, mount stiffness and damping, and speed [rad/s]; angles (d, b)
    of the unbalance [rad]. figures (d, b, 14) as in ``drop.Fall``; slip (d, b) [J]; seals (d, s):
    largest displacement over the gap. duration [s] of every drop; wall [s] that all took.
    """

    seed: int
    duration: float
    cases: np.ndarray
    angles: np.ndarray
    figures: np.ndarray
    slip: np.ndarray
    seals: np.ndarray
    wall: float
    workers: int

    @property
    def count(self) -> int:
        return len(self.cases)

    @property
    def force(self) -> np.ndarray:
        """The largest contact force (d, b) [N]."""
        return np.asarray(self.figures[:, :, 2])

    @property
    def load(self) -> np.ndarray:
        """The largest load of the rolling elements (d, b) [N]."""
        return np.asarray(self.figures[:, :, 3])

    @property
    def turns(self) -> np.ndarray:
        """Most turns against the spin without going back (d,), at any bearing."""
        return np.asarray(self.figures[:, :, 6].max(axis=1) / (2 * np.pi))

    @property
    def whirls(self) -> np.ndarray:
        """Which drops (d,) whirl."""
        return np.asarray(self.turns >= WHIRLS)

    @property
    def whirl_frequency(self) -> np.ndarray:
        """Of the drops that whirl, the frequency [rad/s] of their fastest turn."""
        turn = np.where(self.figures[:, :, 8] > 0, self.figures[:, :, 8], np.inf).min(axis=1)
        return np.asarray(2 * np.pi / turn[self.whirls])

    def quantiles(self, values: np.ndarray) -> dict[str, float]:
        """5 %, median, 95 % and the largest, of values (d,)."""
        found = np.quantile(values, _QUANTILES)
        return dict(zip(("5 %", "median", "95 %", "largest"), map(float, found), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        whirls = self.whirls
        return {
            "drops": self.count,
            "seed": self.seed,
            "duration": self.duration,
            "wall_time": self.wall,
            "workers": self.workers,
            "friction_factor": list(FRICTION),
            "mount_factor": list(MOUNT),
            "speed_factor": list(SPEED),
            "whirl": "three whole turns against the spin without going back, at any bearing",
            "share_that_whirls": float(whirls.mean()),
            "whirl_frequency": self.quantiles(self.whirl_frequency) if whirls.any() else None,
            "force_0p": [self.quantiles(column) for column in self.force.T],
            "slip_energy": [self.quantiles(column) for column in self.slip.T],
            "penetration_0p": [self.quantiles(column) for column in self.seals.T],
        }


def _stiffest(bearing: Bearing) -> Bearing:
    return bearing._replace(
        mount_stiffness=MOUNT[1] * bearing.mount_stiffness,
        mount_damping=MOUNT[1] * bearing.mount_damping,
    )


def draw(fallen: FallenRotor, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Cases (d, 4) and angles (d, b) of a campaign."""
    generator = np.random.default_rng(seed)
    b = len(fallen.names)
    even = generator.random((count, 4 + b))
    friction = FRICTION[0] + (FRICTION[1] - FRICTION[0]) * even[:, 0]
    mount = MOUNT[0] * (MOUNT[1] / MOUNT[0]) ** even[:, 1:3]
    speed = fallen.speed * (SPEED[0] + (SPEED[1] - SPEED[0]) * even[:, 3])
    return np.column_stack([friction, mount, speed]), 2 * np.pi * even[:, 4:]


def drops(
    machine: Machine,
    fallen: FallenRotor,
    unbalance: tuple[float, ...],
    count: int,
    *,
    duration: float,
    seed: int,
    workers: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Campaign:
    """``count`` drops of ``duration`` [s] on all processors (or ``workers``). unbalance (b,) [kg m]
    at the bearings. Raises NumericalFailure where one overflows.
    """
    from time import perf_counter

    cases, angles = draw(fallen, count, seed)
    rig, _ = build(machine, fallen)
    brake = brake_of(machine)
    b, seals = len(fallen.names), len(fallen.seal_names)
    figures, slip = np.zeros((count, b, FIGURES)), np.zeros((count, b))
    met = np.zeros((count, seals))
    compiled()
    threads = workers or os.cpu_count() or 1
    stop = Event()
    # mounts up to twice as stiff and damped: steps as short as that asks for
    _, dt = build(machine, replace(fallen, bearings=tuple(map(_stiffest, fallen.bearings))))

    def chunk(first: int) -> int:
        last = min(first + _CHUNK, count)
        for d in range(first, last):
            if stop.is_set():
                return d - first
            one(d)
        return last - first

    def one(d: int) -> None:
        drop = Drop(float(cases[d, 3]), unbalance, tuple(angles[d]), *map(float, cases[d, :3]))
        case, state = case_of(fallen, rig, drop, brake)
        try:
            fall = run(rig, case, state, duration, dt)
        except NumericalFailure as error:
            raise NumericalFailure(f"drop {d + 1} of seed {seed}: {error}") from None
        figures[d], met[d] = fall.figures, fall.seals
        slip[d] = slip_of(fallen, fall)

    began = perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        waiting = {pool.submit(chunk, first) for first in range(0, count, _CHUNK)}
        done, told = 0, 0
        try:
            while waiting:
                finished, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
                done += sum(future.result() for future in finished)
                if 10 * done // count > told:
                    told = 10 * done // count
                    progress(f"{done:,} of {count:,} drops, {perf_counter() - began:.0f} s")
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    wall = perf_counter() - began
    return Campaign(seed, duration, cases, angles, figures, slip, met, wall, threads)
