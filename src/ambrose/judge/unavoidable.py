"""What the unstable poles and the delay of a plant make unavoidable, whatever controller closes its
loop.
"""

from __future__ import annotations

import math

import numpy as np

from ambrose.core.delay_limit import least_sensitivity
from ambrose.core.statespace import index_of
from ambrose.law.timing import Timing, machine_timing
from ambrose.model.plant import Plant
from ambrose.model.reduce import reduce_from

_HERTZ = 2 * math.pi  # rad/s per Hz


def unavoidable_sensitivity(
    plant: Plant, timing: Timing | None = None
) -> tuple[float, float, float]:
    """The least sigma_max(S_o) that any linear controller reaches, the fastest unstable pole
    [rad/s] and the delay [s].

    timing: when the controller acts (None: as the machine file says; where that says nothing,
    without delay). (1, 0, delay) for a plant without unstable poles. The amplifiers' lags, which a
    controller could invert at the price of current, do not count: what is reached in practice lies
    above.
    """
    runs = timing or machine_timing(plant.machine)
    delay = 0.0 if runs is None else runs.lag
    small = plant if plant.bending_modes is not None else reduce_from(plant, 1)
    A = small.system.A
    C = small.system.C[index_of(small.named("y"), small.system.outputs, "output")]
    fastest = float(np.linalg.eigvals(A).real.max(initial=0.0))
    return least_sensitivity(A, C, delay), fastest, delay


def unavoidable_words(least: float, pole: float, delay: float) -> str:
    """What the delay does, as half a sentence."""
    return (
        f"the unstable pole at {pole / _HERTZ:.3g} Hz and the delay of {1e3 * delay:.3g} ms keep S "
        f"above {least:.3g}"
    )


def beyond_reach(least: float, pole: float, delay: float, limit: float) -> str:
    """Why no controller meets a limit of the sensitivity; "" where one may."""
    if least < limit:
        return ""
    remedy = "sample faster, shorten the delay, or lower k_s"
    if not math.isfinite(least):
        invisible = (
            f"the unstable motion at {pole / _HERTZ:.3g} Hz shows in no sensor, or the delay "
            "outlasts it"
        )
        return f"no controller can: {invisible}; {remedy}"
    return (
        f"no controller can: {unavoidable_words(least, pole, delay)}, and {limit:.3g} is asked; "
        f"{remedy}"
    )
