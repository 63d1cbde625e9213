"""LPV synthesis with its verification; the same inequalities through cvxpy; growth with states and
grid points.

Plants: the turboexpander's design problem from 20 to 300 Hz (20 states); for growth a chain of
oscillators whose springs follow the parameter. The peer solves the first pass only (the smallest
gamma), with cvxpy's default solver or Clarabel; its error is the relative difference of gamma. All
times are processor time.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.annexes.scheduled.lpv.family import Shape, program, scaled_family
from ambrose.annexes.scheduled.lpv.machine import plants_along
from ambrose.annexes.scheduled.lpv.synthesis import lpv_synthesis
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.matrix_inequalities import Inequality, minimise
from ambrose.core.statespace import StateSpace
from ambrose.law.law import BOTH, SPEED, Scheduling
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble

POINTS = 8


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer_name, error, target."""
    machine = load_machine("turboexpander")
    plant_at = plants_along(assemble(machine, operating_point(machine, "140 Hz")))
    speeds = 2 * np.pi * np.linspace(20, 300, POINTS)
    if smoke:
        yield _whole("chain, 8 states, 3 points", _chain(2), np.linspace(0, 1, 3))
        yield _against_cvxpy("first pass, chain", _chain(2), np.linspace(0, 1, 3), "CLARABEL")
        return
    yield _whole("turboexpander, 20 states, 8 points, any rate", plant_at, speeds, None, "< 30 s")
    yield _whole("turboexpander, 20 states, 8 points, 1760 rad/s^2", plant_at, speeds, 1760.0)
    both = plants_along(assemble(machine, operating_point(machine, "140 Hz")), BOTH)
    rectangle = (2 * np.pi * np.array([0.0, 262.5, 525.0]), np.array([0.0, 19.25e5, 38.5e5]))
    yield _whole(
        "turboexpander, 20 states, 3 x 3 points, any rate", both, rectangle, None, "< 30 s", BOTH
    )
    yield _against_cvxpy(
        "first pass, turboexpander, 20 states, 8 points", plant_at, speeds, "CLARABEL"
    )
    yield _against_cvxpy(
        "first pass, chain, 8 states, 4 points", _chain(2), np.linspace(0, 1, 4), None
    )
    yield _against_cvxpy(
        "first pass, chain, 8 states, 4 points", _chain(2), np.linspace(0, 1, 4), "CLARABEL"
    )
    for series, sizes in {
        "states": ((2, POINTS), (4, POINTS), (7, POINTS)),
        "points": ((4, 3), (4, 6), (4, 15)),
    }.items():
        for masses, count in sizes:
            row = _whole(
                f"chain, {4 * masses} states, {count} points",
                _chain(masses),
                np.linspace(0, 1, count),
            )
            size = count if series == "points" else 4 * masses
            yield {**row, "series": f"LPV synthesis over {series}", "size": size}


def _chain(masses: int) -> Callable[[float], GeneralizedPlant]:
    """Masses in a row between springs that stiffen with p, with a lagging actuator and an error
    weight each: 4 states.
    """
    n = masses
    laplace = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    eye, zero = np.eye(n), np.zeros((n, n))

    def at(p: float) -> GeneralizedPlant:
        A = np.block(
            [
                [zero, eye, zero, zero],
                [-(1 + 2 * p) * laplace + 0.5 * eye, -0.05 * laplace, eye, zero],
                [zero, zero, -10 * eye, zero],
                [-eye, zero, zero, -0.02 * eye],
            ]
        )
        B = np.block(
            [
                [zero, zero, zero],
                [zero, zero, zero],
                [10 * eye, zero, 10 * eye],
                [zero, -0.1 * eye, zero],
            ]
        )
        C = np.block(
            [[zero, zero, zero, 0.2 * eye], [zero, zero, zero, zero], [-eye, zero, zero, zero]]
        )
        D = np.block([[zero, zero, zero], [zero, zero, 0.2 * eye], [zero, -0.1 * eye, zero]])
        s = StateSpace(A, B, C, D)
        return GeneralizedPlant(
            s, s.inputs[: 2 * n], s.inputs[2 * n :], s.outputs[: 2 * n], s.outputs[2 * n :]
        )

    return at


def _row(
    name: str, ours: float, peer: float | None, peer_name: str, error: float | str, target: str = ""
) -> dict[str, Any]:
    return {
        "name": f"lpv: {name}",
        "ours": ours,
        "peer": peer,
        "peer_name": peer_name,
        "error": error,
        "target": target,
    }


def _whole(
    name: str,
    plant_at: Callable[[Any], GeneralizedPlant],
    grid: Any,
    rate: float | None = None,
    target: str = "",
    along: Scheduling = SPEED,
) -> dict[str, Any]:
    start = time.process_time()
    result = lpv_synthesis(
        plant_at, grid, rate=rate, backoff=1.1, parameter=along.name, unit=along.unit
    )
    spent = time.process_time() - start
    m = result.certificate.margins
    ratio = m["gamma_optimal"] / m["pointwise_largest"]
    said = (
        f"gamma {ratio:.3f} of pointwise, fastest pole {result.certificate.fastest_pole:.2g} rad/s"
    )
    return _row(name, spent, None, "", said, target)


def _against_cvxpy(
    name: str, plant_at: Callable[[float], GeneralizedPlant], grid: np.ndarray, solver: str | None
) -> dict[str, Any]:
    """solver: None is cvxpy's own choice, SCS, which takes hours for the turboexpander."""
    family = scaled_family([plant_at(float(value)) for value in grid], (grid,))
    cost, items = program(family, Shape("none", 0, (None,)))
    start = time.process_time()
    ours = minimise(cost, items, tolerance=1e-5)
    spent = time.process_time() - start
    try:
        import cvxpy
    except ImportError:
        return _row(name, spent, None, "cvxpy (not installed)", ours.gap)
    start = time.process_time()
    try:
        value, solver = _cvxpy(cvxpy, cost, items, solver)
    except Exception as error:
        return _row(
            name, spent, None, f"cvxpy ({str(error).strip().splitlines()[0][:50]})", ours.gap
        )
    return _row(
        name, spent, time.process_time() - start, f"cvxpy, {solver}", abs(value / ours.value - 1)
    )


def _cvxpy(
    cvxpy: Any, cost: np.ndarray, items: list[Inequality], solver: str | None
) -> tuple[float, str]:
    """The value and the solver that cvxpy chose; matrices as affine functions of x."""
    x = cvxpy.Variable(len(cost))
    constraints = []
    for item in items:
        d = item.side
        j, i = np.tril_indices(d)
        spread = np.zeros((d * d, len(item.constant)))
        weight = np.where(i == j, 1.0, 1 / np.sqrt(2.0))
        spread[i * d + j, np.arange(len(i))] = spread[j * d + i, np.arange(len(i))] = weight
        vector = (spread @ item.rows) @ x[item.columns] + spread @ item.constant
        constraints.append(cvxpy.reshape(vector, (d, d), order="C") >> 0)
    problem = cvxpy.Problem(cvxpy.Minimize(cost @ x), constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SCS ends inexact: its error is in the table
        problem.solve(solver=solver)
    return float(problem.value), str(problem.solver_stats.solver_name)
