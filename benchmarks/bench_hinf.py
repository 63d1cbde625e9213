"""H-infinity synthesis, verification included, beside SLICOT's SB10AD (slycot) and the linear
matrix inequalities (Clarabel).

SB10AD searches its own optimum from 20 times ours with the same tolerance and verifies nothing; its
error column is its gamma against ours. Peers that are not installed are left out. The matrix
inequalities are timed for gamma alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ambrose.core.hinf_riccati import scale_plant
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import Synthesis
from ambrose.synthesis.hinf import hinf_synthesis
from benchmarks.published_p5 import published_p5_problem


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer_name, error (largest relative
    difference of gamma), target.
    """
    p5 = published_p5_problem(uncertain=False)
    repeats = 1 if smoke else 5
    yield _against_slicot("published P5 plant, 20 states, tolerance 1e-3", p5, 1e-3, repeats)
    if not smoke:
        yield _against_slicot("published P5 plant, 20 states, tolerance 1e-8", p5, 1e-8, repeats)
    if smoke:
        yield _against_inequalities("random plant, 8 states", _random(8), repeats)
    else:
        yield _against_inequalities("published P5 plant, 20 states", p5, repeats)
    for n in (8,) if smoke else (8, 20, 40, 60):
        yield _against_slicot(
            f"random plant, {n} states, tolerance 1e-3", _random(n), 1e-3, repeats
        )
    yield _singular(repeats)


def _random(n: int, singular: bool = False) -> GeneralizedPlant:
    """Four disturbances and outputs, two controls and measurements, everything direct; seeded."""
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 0.6 * np.eye(n)
    D = rng.standard_normal((6, 6))
    if singular:
        D[:4, 5] = D[5, :4] = 0.0
    system = StateSpace(A, rng.standard_normal((n, 6)), rng.standard_normal((6, n)), D)
    return GeneralizedPlant(
        system, system.inputs[:4], system.inputs[4:], system.outputs[:4], system.outputs[4:]
    )


def _timed(work: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    return best, result


def _row(
    name: str, ours: float, peer: float | None, peer_name: str, error: float | str, target: str = ""
) -> dict[str, Any]:
    return {
        "name": f"hinf: {name}",
        "ours": ours,
        "peer": peer,
        "peer_name": peer_name,
        "error": error,
        "target": target,
    }


def _optimal(result: Synthesis) -> float:
    return result.certificate.margins["gamma_optimal"]


def _against_slicot(
    name: str, plant: GeneralizedPlant, tolerance: float, repeats: int
) -> dict[str, Any]:
    ours, result = _timed(lambda: hinf_synthesis(plant, tolerance=tolerance), repeats)
    target = "< 0.1 s" if "20 states" in name else ""
    try:
        from slycot import sb10ad
    except ImportError:
        return _row(name, ours, None, "SB10AD (not installed)", tolerance, target)
    s = plant.system
    m = len(plant.u)
    p = len(plant.y)
    start = 20 * _optimal(result)
    arguments = (
        s.n_states,
        len(s.inputs),
        len(s.outputs),
        m,
        p,
        start,
        s.A,
        s.B,
        s.C,
        s.D,
        1,
        tolerance,
        0.0,
    )
    try:
        peer, answer = _timed(lambda: sb10ad(*arguments), repeats=1)
    except Exception as error:
        return _row(
            name,
            ours,
            None,
            f"SB10AD ({str(error).strip().splitlines()[0][:50]})",
            tolerance,
            target,
        )
    return _row(name, ours, peer, "SB10AD", abs(_optimal(result) / float(answer[0]) - 1), target)


def _against_inequalities(name: str, plant: GeneralizedPlant, repeats: int) -> dict[str, Any]:
    from ambrose.core.hinf_lmi import smallest_gamma

    ours, result = _timed(lambda: hinf_synthesis(plant, tolerance=1e-5), repeats)
    scaled = scale_plant(plant)
    peer, prepared = _timed(lambda: smallest_gamma(scaled, lambda: 120.0), repeats=1)
    return _row(
        name,
        ours,
        peer,
        "matrix inequalities, Clarabel",
        abs(_optimal(result) / prepared.gamma - 1),
        "gamma within 1e-3",
    )


def _singular(repeats: int) -> dict[str, Any]:
    ours, result = _timed(lambda: hinf_synthesis(_random(20, singular=True)), repeats)
    epsilon = result.certificate.margins["epsilon"]
    return _row(
        "random plant, 20 states, D12 and D21 singular",
        ours,
        None,
        "none",
        f"verified with epsilon {epsilon:g}",
    )
