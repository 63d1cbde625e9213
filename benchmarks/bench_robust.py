"""Robust verification with many uncertain parameters: the turboexpander with its tolerances and its
PID.

The peer is brute force: the eigenvalues of the perturbed loop at every point (16 are timed and
scaled), and for the gain its frequency response at the corners, each evaluated from its own Schur
form on the same grid (4 are timed and scaled). Errors: points whose number of unstable poles
differs, and the largest relative difference of the gain. All times are processor time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.core.frequency import evaluate, schur_form
from ambrose.core.worst_case import gain_bound, worst_gain
from ambrose.core.worst_case_loop import (
    BoxLoop,
    box_margin,
    corners,
    default_grid,
    gains,
    perturbed_matrix,
    sweep,
    unstable_poles,
)
from ambrose.judge import robust
from ambrose.judge.result import pid_synthesis
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce

_EIGENVALUES, _RESPONSES = 16, 4  # points at which the peer is timed
_GROWN = 3.0  # of the box, for the count: some of its points are unstable


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer_name, error, target."""
    machine = load_machine("turboexpander")
    if smoke:  # one parameter instead of eight
        machine = replace(machine, tolerances=machine.tolerances[:1])
    full = assemble(machine, operating_point(machine, "140 Hz"))
    law = pid_synthesis(full).controller
    for model, plant in (
        (("reduced", reduce(full)),) if smoke else (("full", full), ("reduced", reduce(full)))
    ):
        loop = robust.box_loops(plant, law)[0]
        name = f"{model}, {loop.system.n_states} states, {loop.parameters} parameters"
        yield _count(name, loop)
        yield _gains(name, loop)
        yield _margin(name, loop)
        seconds, checks = _timed(lambda plant=plant: robust.check(plant, law), 1)
        yield _row(f"whole verdict, {name}", seconds, "< 25 s" if model == "full" else "")
        if np.isfinite(checks["robust.sensitivity.worst"].value):
            yield _bound(name, loop)


def _timed(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        best = min(best, time.process_time() - start)
    return best, result


def _row(name: str, ours: float, target: str = "", error: Any = None) -> dict[str, Any]:
    return {
        "name": f"robust: {name}",
        "ours": ours,
        "peer": None,
        "peer_name": "",
        "error": error,
        "target": target,
    }


def _count(name: str, loop: BoxLoop) -> dict[str, Any]:
    points = _GROWN * corners(loop.parameters)
    some = points[:: max(1, len(points) // _EIGENVALUES)]
    start = sweep(loop)
    seconds, found = _timed(lambda: unstable_poles(loop, points, start))
    peer, expected = _timed(
        lambda: [(np.linalg.eigvals(perturbed_matrix(loop, d)).real >= 0).sum() for d in some], 1
    )
    wrong = int((found[:: max(1, len(points) // _EIGENVALUES)] != np.array(expected)).sum())
    row = _row(
        f"unstable poles at {len(points)} corners, {name}",
        seconds,
        error=f"{wrong} of {len(some)} differ, {(found > 0).sum()} unstable",
    )
    return row | {
        "peer": peer * len(points) / len(some),
        "peer_name": f"eigenvalues ({len(some)} points, scaled)",
    }


def _gains(name: str, loop: BoxLoop) -> dict[str, Any]:
    points, grid = corners(loop.parameters), default_grid(loop, 20)
    some = points[:: max(1, len(points) // _RESPONSES)]
    M = loop.at(grid)
    seconds, found = _timed(lambda: gains(M, loop, points))
    peer, expected = _timed(lambda: np.array([_response(loop, d, grid) for d in some]), 1)
    error = float(np.abs(found[:: max(1, len(points) // _RESPONSES)] / expected - 1).max())
    row = _row(
        f"gain at {len(points)} corners, {len(grid)} frequencies, {name}", seconds, error=error
    )
    return row | {
        "peer": peer * len(points) / len(some),
        "peer_name": f"response of each ({len(some)} points, scaled)",
    }


def _response(loop: BoxLoop, delta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Gain (w,) of the perturbed loop, from its own matrices."""
    n, s = len(loop.owner), loop.system
    D = np.diag(delta[loop.owner])
    inner = D @ np.linalg.inv(np.eye(n) - s.D[:n, :n] @ D)
    B, direct = (
        s.B[:, n:] + s.B[:, :n] @ inner @ s.D[:n, n:],
        s.D[n:, n:] + s.D[n:, :n] @ inner @ s.D[:n, n:],
    )
    form = schur_form(
        perturbed_matrix(loop, delta), B, s.C[n:] + s.D[n:, :n] @ inner @ s.C[:n], direct
    )
    return np.linalg.norm(evaluate(form, 1j * omega), 2, axis=(1, 2))


def _margin(name: str, loop: BoxLoop) -> dict[str, Any]:
    """Error: the real part of the pole on the axis, over its frequency."""
    seconds, margin = _timed(lambda: box_margin(loop), 1)
    if not np.isfinite(margin.factor):
        return _row(f"margin, {name}", seconds, error="none up to 20 times the box")
    poles = np.linalg.eigvals(perturbed_matrix(loop, margin.delta))
    return _row(
        f"margin, {name}",
        seconds,
        error=float(np.abs(poles.real).min() / max(margin.frequency, 1.0)),
    )


def _bound(name: str, loop: BoxLoop) -> dict[str, Any]:
    """Error: the gap between the bound and the gain found by search."""
    worst = worst_gain(loop)
    net = np.unique(
        np.append(default_grid(loop)[::20], worst.frequency * np.linspace(0.9, 1.1, 21))
    )
    seconds, bound = _timed(lambda: gain_bound(loop, net, worst.value), 1)
    return _row(
        f"gain bound, {len(net)} frequencies, {name}", seconds, error=bound / worst.value - 1
    )
