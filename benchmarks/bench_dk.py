"""mu synthesis of the published P5 plant with a D of first order (24 states), the same polished at
order 12, and the turboexpander with eight real parameters.

The peer, dkpy, has no real blocks and no repeated ones: it gets full complex blocks of the same
size, two D-K iterations, D of order 1, and 30 frequencies. It is skipped where it is not installed.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.core.lft import GeneralizedPlant, close_uncertainty, lft
from ambrose.core.statespace import StateSpace, is_stable
from ambrose.law.design_problem import design_plant, with_performance_block
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.fixed_order.polish import polish_synthesis
from ambrose.synthesis.mu import mu_synthesis
from benchmarks.published_p5 import published_p5_problem


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per problem: name, ours [s], peer [s] or None, peer_name, error (what was reached),
    target.
    """
    limits: dict[str, Any] = (
        {"iterations": 1, "omega": np.geomspace(1e-2, 1e3, 12)} if smoke else {}
    )
    yield _published(1 if smoke else 3, **limits)
    yield _polished(0.5 if smoke else 60.0, **limits)
    if not smoke:
        yield _eight_reals()


def _timed(plant: GeneralizedPlant, **settings: Any) -> tuple[float, Any]:
    start = time.perf_counter()
    result = mu_synthesis(plant, **settings)
    return time.perf_counter() - start, result


def _published(repeats: int, **limits: Any) -> dict[str, Any]:
    plant = published_p5_problem()
    seconds, result = min(
        (_timed(plant, order=1, **limits) for _ in range(repeats)), key=lambda item: item[0]
    )
    steps = ", ".join(f"{row['gamma']:.3f}" for row in result.history)
    text = (
        f"order {result.controller.n_states}, complex mu {steps}; mixed "
        f"{result.certificate.margins['mu_mixed']:.3f}"
    )
    peer = _dkpy(plant)
    if peer is not None:
        text += f"; peer's mu {peer[1]:.3f}"
    return {
        "name": "D-K: published P5, delta I_2 + full 8x8, 20 states",
        "ours": seconds,
        "peer": peer[0] if peer else None,
        "peer_name": "dkpy",
        "error": text,
        "target": "< 2 s, >= 50x",
    }


def _polished(time_limit: float, **limits: Any) -> dict[str, Any]:
    plant = published_p5_problem()
    start = mu_synthesis(plant, order=1, **limits).controller
    begin = time.perf_counter()
    result = polish_synthesis(plant, start, order=12, time_limit=time_limit)
    seconds = time.perf_counter() - begin
    margins = result.certificate.margins
    text = (
        f"worst norm over the range {result.gamma:.3f} (proved {margins['proved_norm']:.3f}); "
        f"D-K's {margins['start_norm']:.3f}, reduced {margins['reduced_norm']:.3f}"
    )
    return {
        "name": "polish: published P5, order 24 to 12",
        "ours": seconds,
        "peer": None,
        "peer_name": "",
        "error": text,
        "target": "< 30 s, no worse than D-K at 24",
    }


def _eight_reals() -> dict[str, Any]:
    machine = load_machine("turboexpander")
    plant = design_plant(
        reduce(assemble(machine, operating_point(machine, "140 Hz (P3)"))), uncertain=True
    )
    seconds, result = _timed(plant, order=1, iterations=2)
    corners = _unstable(plant, result.controller)
    text = (
        f"order {result.controller.n_states}, complex mu {result.gamma:.3f}, {corners} of 256 "
        "corners unstable"
    )
    return {
        "name": "D-K: turboexpander, 8 reals + full 8x8, 20 states",
        "ours": seconds,
        "peer": None,
        "peer_name": "",
        "error": text,
        "target": "< 10 s, 0 corners",
    }


def _unstable(plant: GeneralizedPlant, controller: StateSpace) -> int:
    names, n = [block.name for block in plant.blocks], plant.n_w_blocks
    count = 0
    for corner in itertools.product((-1.0, 1.0), repeat=len(names)):
        system = close_uncertainty(plant, dict(zip(names, corner, strict=True)))
        inner = GeneralizedPlant(system, plant.w[n:], plant.u, plant.z[n:], plant.y)
        count += not is_stable(lft(inner, controller))
    return count


def _dkpy(plant: GeneralizedPlant) -> tuple[float, float] | None:
    """Seconds and mu of dkpy's D-K iteration; None without dkpy, or when it fails."""
    try:
        import control
        import dkpy
    except ImportError:
        return None
    plant = with_performance_block(plant)
    try:
        iteration = dkpy.DkIterFixedOrder(
            controller_synthesis=dkpy.HinfSynLmi(),
            structured_singular_value=dkpy.SsvLmiBisection(n_jobs=None),
            d_scale_fit=dkpy.DScaleFitSlicot(),
            n_iterations=2,
            fit_order=1,
        )
        blocks = [dkpy.ComplexFullBlock(block.n_w, block.n_z) for block in plant.blocks]
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            system = control.ss(plant.system.A, plant.system.B, plant.system.C, plant.system.D)
            found = iteration.synthesize(
                system, len(plant.y), len(plant.u), np.geomspace(1e-3, 1e4, 30), blocks
            )
        return time.perf_counter() - start, float(np.max(found[2]))
    except Exception as error:  # a peer that fails is a row without a peer, said so
        print(f"dkpy failed: {error}")
        return None
