"""Levenberg-Marquardt with a guard: a step that leaves the set where the model may be used (a
stable loop) is shortened.

Marquardt's scaling by the diagonal of J'J (1963); the gain ratio steers the damping as in Nielsen
(1999), who lets it fall to a third in a step; here a ninth, for most starts are close.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """The normal equations at a point: cost = r'r, H = J'J (q, q), g = J'r (q,); model(theta +
    step) = model + J step.

    parts: whatever else was found there, handed on to the Minimum.
    """

    cost: float
    H: np.ndarray
    g: np.ndarray
    parts: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the iteration ended: x (q,), the cost there, whether it converged, its number of steps,
    and the refused ones.

    parts: of the last point that was computed, which is x or a negligible step before it.
    """

    x: np.ndarray
    cost: float
    converged: bool
    iterations: int
    refused: int
    parts: tuple[Any, ...] = ()


def minimise(
    linearise: Callable[[np.ndarray], Linearised],
    x: np.ndarray,
    scale: np.ndarray,
    allowed: Callable[[np.ndarray], bool],
    max_iterations: int = 50,
    tolerance: float = 1e-9,
    floor: float = 0.0,
    negligible: float = 0.0,
) -> Minimum:
    """The least of r(x)'r(x) near x (q,).

    scale (q,): the size of a parameter, for the stopping rule |step| <= tolerance * max(|x|,
    scale); a step whose predicted gain is below 1e-12 of the cost, or a cost below ``floor``, also
    ends it. One below ``negligible`` of the cost is taken and ends it, without a look at where it
    leads. allowed(x): steps are shortened until true, and until ``linearise`` does not raise
    InvalidInput (a point at which nothing can be told); at the start that is raised. Raises
    NumericalFailure where J has a zero column.
    """
    damping = 1e-6
    growth = 2.0
    refused = 0
    state = linearise(x)
    for iteration in range(max_iterations):
        size = np.sqrt(np.diag(state.H))
        if not (size > 0).all():
            raise NumericalFailure(
                f"the outputs do not depend on parameter number {int(np.argmin(size)) + 1}; leave "
                "it out"
            )

        # unit diagonal: Marquardt's scaling
        H, g = state.H / size / size[:, None], state.g / size
        while True:
            scaled = np.linalg.solve(H + damping * np.eye(len(x)), g)
            step = scaled / size

            # 2 s'g - s'H s with (H + damping) s = g:   s'(damping s + g)
            predicted = float(scaled @ (damping * scaled + g))
            small = bool((np.abs(step) <= tolerance * np.maximum(np.abs(x), scale)).all())

            # a step that is small only because the damping is large is no minimum
            if small or predicted <= 1e-12 * state.cost or state.cost <= floor:
                return Minimum(x, state.cost, damping < 1e3, iteration, refused, state.parts)
            trial = x + step
            if predicted <= negligible * state.cost and damping < 1e-3 and allowed(trial):
                return Minimum(
                    trial, state.cost - predicted, True, iteration + 1, refused, state.parts
                )
            following = None
            if allowed(trial):
                # where a trial says nothing, as at the edge of stability
                with suppress(InvalidInput):
                    following = linearise(trial)

            # a trial that is not allowed, or tells nothing, counts as one that lost
            gain = (state.cost - following.cost) / predicted if following is not None else -1.0
            if following is not None and gain > 0:
                damping, growth = max(damping * max(1 / 9, 1 - (2 * gain - 1) ** 3), 1e-12), 2.0
                break
            refused += 1

            # refused in a row: the damping grows by 2, 4, 8, ...
            damping, growth = max(damping, 1e-6) * growth, growth * 2
            if damping > 1e12:
                return Minimum(x, state.cost, False, iteration, refused, state.parts)
        x, state = trial, following
    return Minimum(x, state.cost, False, max_iterations, refused, state.parts)
