"""H-infinity norm, frequency response and matrix equations, beside slycot, python-control and
scipy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.frequency import frequency_response
from ambrose.core.matrix_equations import solve_riccati
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace


def run() -> list[dict[str, Any]]:
    """One row per task: name, ours and peer [s] (medians; peer None where it is not installed),
    peer_name, error (relative).
    """
    return [
        *(hinf(n) for n in (8, 20)),
        {**hinf(40), "target": "< 0.05 s"},
        hinf(60),
        hinf(328, repeats=1),
        {**response(320, 2000), "target": "< 0.5 s, >= 10x"},
        riccati_equation(24),
    ]


def median_time(function: Callable[[], Any], repeats: int = 7) -> tuple[float, Any]:
    """The median wall time of several calls after a first one, and the result."""
    result, times = function(), []
    for _ in range(repeats):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return float(np.median(times)), result


def row(
    name: str, ours: float, peer: float | None, peer_name: str, error: float | None
) -> dict[str, Any]:
    return {"name": name, "ours": ours, "peer": peer, "peer_name": peer_name, "error": error}


def lightly_damped(n: int, m: int = 4) -> StateSpace:
    """n / 2 modes of 1 .. 1000 rad/s with damping ratios 1e-5 .. 1e-1 behind an orthogonal
    transformation.
    """
    rng = np.random.default_rng(n)
    A = np.zeros((n, n))
    for i in range(0, n, 2):
        omega, zeta = 10 ** rng.uniform(0, 3), 10 ** rng.uniform(-5, -1)
        A[i : i + 2, i : i + 2] = [[-zeta * omega, omega], [-omega, -zeta * omega]]
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return StateSpace(
        Q @ A @ Q.T, rng.standard_normal((n, m)), rng.standard_normal((m, n)), np.zeros((m, m))
    )


def hinf(n: int, repeats: int = 7) -> dict[str, Any]:
    """slycot's AB13DD through its own interface, if it is installed (it is a test tool only:
    GPL).
    """
    system = lightly_damped(n)
    ours, norm = median_time(lambda: hinf_norm(system), repeats)
    name = f"H-infinity norm, n = {n}, 4 x 4, lightly damped"
    try:
        import slycot
    except ImportError:
        return row(name, ours, None, "slycot ab13dd", None)
    m = len(system.inputs)

    def theirs() -> float:
        A, B, C, D = (np.array(x, order="F") for x in (system.A, system.B, system.C, system.D))
        return float(slycot.ab13dd("C", "I", "S", "D", n, m, m, A, np.eye(n), B, C, D, tol=1e-6)[0])

    peer, value = median_time(theirs, repeats)
    return row(name, ours, peer, "slycot ab13dd", abs(norm.value / value - 1))


def response(n: int, points: int) -> dict[str, Any]:
    """python-control solves a dense system at every frequency (or calls slycot's TB05AD)."""
    system = lightly_damped(n)
    omega = np.geomspace(0.5, 2e3, points)
    ours, values = median_time(lambda: frequency_response(system, omega).values, 3)
    name = f"frequency response, {n} states, 4 x 4, {points} frequencies"
    try:
        import control
    except ImportError:
        return row(name, ours, None, "python-control", None)
    their_system = system.to_control()
    start = time.perf_counter()
    theirs = control.frequency_response(their_system, omega, squeeze=False).complex.transpose(
        2, 0, 1
    )
    peer = time.perf_counter() - start
    return row(
        name,
        ours,
        peer,
        "python-control",
        float(np.abs(values - theirs).max() / np.abs(theirs).max()),
    )


def riccati_equation(n: int) -> dict[str, Any]:
    """scipy's solver for the definite case (LQR); ours takes an indefinite G as well."""
    rng = np.random.default_rng(n)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, 4)), rng.standard_normal((4, n))
    G, Q = B @ B.T, C.T @ C
    ours, solution = median_time(lambda: solve_riccati(A, G, Q))
    peer, X = median_time(lambda: sla.solve_continuous_are(A, B, Q, np.eye(4)))
    return row(
        f"Riccati equation, n = {n}",
        ours,
        peer,
        "scipy",
        float(np.abs(solution.X - X).max() / np.abs(X).max()),
    )


if __name__ == "__main__":
    for line in run():
        peer = "-" if line["peer"] is None else f"{line['peer']:.4f} s"
        print(
            f"{line['name']:62s} {line['ours']:.4f} s   {line['peer_name']}: {peer}   error "
            f"{line['error']}"
        )
