"""The hole-pattern seal of P3: bulk flow, a table, the rational model, and coefficients at an
operating point.

No peer: ROSS 2.3 sets no condition at the seal's exit, so that its coefficients are another
problem's (docs/theory/gas-seals.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.machine.part import GasSealGeometry
from ambrose.model.effects import bulkflow
from ambrose.model.effects.bulkflow import static_flow
from ambrose.model.effects.seal import coefficients, described
from ambrose.model.effects.seal_rational import linearised, rational

HZ = 2 * np.pi
DROP = 38.5e5


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per task: name, ours [s] (least of three), peer, peer_name, error, target."""
    piston = load_machine("turboexpander").seals[0]
    geometry = piston.geometry
    assert isinstance(geometry, GasSealGeometry) and geometry.speed is not None
    seal, condition = described(geometry, DROP, geometry.speed)
    omega = HZ * (np.array([20.0, 140.0]) if smoke else np.arange(20.0, 301.0, 20.0))

    def fresh() -> bulkflow.BulkFlow:
        static_flow.cache_clear()
        return bulkflow.bulk_flow(seal, condition, omega)

    repeats = 1 if smoke else 3
    seconds, flow = _timed(fresh, repeats)
    fine = bulkflow.bulk_flow(seal, condition, omega, 400)
    error = max(
        np.abs(a / b - 1).max()
        for a, b in ((flow.K, fine.K), (flow.k, fine.k), (flow.C, fine.C), (flow.c, fine.c))
    )
    yield _row(
        f"bulk flow, {len(omega)} frequencies, hole-pattern seal of P3",
        seconds,
        f"{error:.1e} from 400 cells",
        "< 1 s",
    )
    states = replace(piston, frequency_dependence="states")
    rational(states, DROP)
    seconds, model = _timed(lambda: rational(states, DROP), repeats)
    w = 140.0 * HZ
    found, exact = linearised(model, w), coefficients(piston, DROP, frequency=w)
    error = abs(complex(found.K - exact.K, w * (found.C - exact.C))) / abs(
        complex(exact.K, w * exact.C)
    )
    yield _row(
        "rational model of it, 3 poles, 2 Hz to 1.5 kHz, flow known",
        seconds,
        f"{error:.1e} at 140 Hz",
        "< 10 ms",
    )


def _timed(task: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.process_time()
        result = task()
        best = min(best, time.process_time() - start)
    return best, result


def _row(name: str, seconds: float, error: str, target: str) -> dict[str, Any]:
    return {
        "name": name,
        "ours": seconds,
        "peer": None,
        "peer_name": "none",
        "error": error,
        "target": target,
    }


if __name__ == "__main__":
    for row in run():
        print(row)
