"""The coefficients of a bearing from its magnetic network."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ambrose.core.checks import invalid
from ambrose.machine.magnet import Magnet
from ambrose.model.magnetics.kinds import magnet_of

_OFF = 0.05  # of the stated bias current from the one that a permanent magnet is worth


@lru_cache(maxsize=64)
def coefficients_of(
    magnet: Magnet, bias: float, name: str
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """k_i (zeta, eta) [N/A], k_s (zeta, eta) [N/m], and the bias current [A] of an opposing pair of
    the same: that of a heteropolar magnet, k_s s_0/k_i of a homopolar one.

    name: of the bearing. Raises InvalidInput where a permanent magnet is stated with a bias current
    that differs from the pair's by more than 5 %: the control current at which one gap has no flux.
    """
    k_i, k_s = (np.diag(matrix) for matrix in magnet_of(magnet).coefficients(bias))
    pair = bias if magnet.kind != "homopolar" else float(k_s[0] * magnet.gap / k_i[0])
    if magnet.bias == "permanent-magnet" and abs(bias - pair) > _OFF * pair:
        raise invalid(
            f"bias_current of bearing {name}",
            f"{bias:.4g} A",
            f"{pair:.4g} A, the control current that takes the permanent magnet's flux out of one "
            "gap",
            f"write bias_current = {pair:.4g}",
        )
    return _pair(k_i), _pair(k_s), pair


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
