"""The worst point found of the tolerances around a plant: the parameters' feedback is closed
frequency by frequency, at the corners, and from the worst of them along one parameter at a time.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.statespace import StateSpace, select
from ambrose.law.timing import Timing
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import tolerances_around, uncertain
from ambrose.synthesis.fixed_order.aims import Aims
from ambrose.synthesis.fixed_order.loops import lateness, warped

_CORNERS = 512  # at most, of a box
_ALONG = np.linspace(-1.0, 1.0, 9)  # of one parameter


def worst_member(
    plant: Plant, controller: StateSpace, timing: Timing | None, aims: Aims
) -> dict[str, float]:
    """The point of the tolerances around a plant with the largest sigma_max(S_o) over its limit;
    {} without tolerances.

    By closing the parameters' feedback at frequencies where the nominal loop's ratio is above half
    its largest: at all corners, at most 512, drawn at random; then, from the worst of them, at
    points along one parameter after the other, for a wide tolerance among narrow ones may be worst
    in between.
    """
    held = tolerances_around(plant)
    if not held:
        return {}
    model = uncertain(plant, held)
    n, names = model.n_w_blocks, [block.name for block in model.blocks]
    top = aims.highest if timing is None else min(aims.highest, 0.97 * np.pi / timing.sample_time)
    omega = np.geomspace(20.0, top, 120)
    part = select(
        model.system, [*model.w[:n], *plant.named("u")], [*model.z[:n], *plant.named("y")]
    )
    P = frequency_response(part, omega).values.copy()
    if timing is not None:
        P[:, :, n:] *= lateness(omega, timing)[:, None, None]
    K = frequency_response(controller, warped(omega, timing)).values

    # Loop closed with u = -K (y + d), P = [P_zw P_zu; P_yw G], S = (I + G K)^-1:
    # z = (P_zw - P_zu K S P_yw) w - P_zu K S d,   y + d = S P_yw w + S d
    S = np.linalg.inv(np.eye(K.shape[-1]) + P[:, n:, n:] @ K)
    KS = K @ S
    M = P[:, :n, :n] - P[:, :n, n:] @ KS @ P[:, n:, :n]
    into, out = -P[:, :n, n:] @ KS, S @ P[:, n:, :n]
    owner = np.repeat(np.arange(len(names)), [block.n_w for block in model.blocks])
    limit = aims.sensitivity_limit(omega)
    ratio = largest_gain(S) / limit

    # Only frequencies where the loop without deviations is high.
    near = ratio >= 0.5 * ratio.max()
    M = M[near]
    into = into[near]
    out = out[near]
    S = S[near]
    limit = limit[near]

    def climbed(tried: np.ndarray, best: float, worst: np.ndarray) -> tuple[float, np.ndarray]:
        """The largest ratio of these points and of the best before, and where."""
        for delta in tried:
            # w = delta z:   y + d = (S + out delta (I - M delta)^-1 into) d
            spread = delta[owner]
            closed = S + out @ (spread[:, None] * np.linalg.solve(np.eye(n) - M * spread, into))
            # the norm is no smaller than the gain
            larger = np.linalg.norm(closed, axis=(1, 2)) > best * limit
            if larger.any():
                gain = float((largest_gain(closed[larger]) / limit[larger]).max())
                if gain > best:
                    best, worst = gain, delta
        return best, worst

    tried = _corners(len(names))
    best, worst = climbed(tried, -np.inf, tried[0])
    for k in range(len(names)):
        along = np.repeat(worst[None], len(_ALONG), axis=0)
        along[:, k] = _ALONG
        best, worst = climbed(along, best, worst)
    return dict(zip(names, map(float, worst), strict=True))


def _corners(count: int) -> np.ndarray:
    """All corners of a box, at most 512 of them at random; of one parameter some points in between
    as well.
    """
    if count == 1:
        return _ALONG[:, None]
    if 2**count <= _CORNERS:
        return np.array(list(product((-1.0, 1.0), repeat=count)))
    return np.random.default_rng(0).choice([-1.0, 1.0], (_CORNERS, count))
