"""Verification of the sampled loop: a sampled controller with its computing delay around the plant behind a zero-order hold.

At operating points the checks are those of ``nominal``; over the tolerances stability and sensitivity are examined by
eigenvalues and norms at corners and samples of the box (loop diagram in core/lft.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, feedback, select, series, spectral_abscissa, static_gain
from ambrose.core.worst_case.loop import box_points
from ambrose.plant.loop import match_controller
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.plant.uncertainty import perturbed
from ambrose.synthesis.certificate import certify
from ambrose.verification import nominal
from ambrose.verification.checks import Check, Checks
from ambrose.verification.criteria import Demand, information, judge

_FULL_POINTS = 40  # points of the box at which the eigenvalues of the full plant's loop are computed
_MODES = 3  # bending modes per plane of the plant on which all points are examined
_INSIDE = 32
Progress = Callable[[str], None]


def verify_sampled(
    plants: Sequence[Plant], controller: StateSpace, progress: Progress = lambda stage: None
) -> tuple[tuple[Checks, ...], tuple[Checks, ...]]:
    """The checks at every plant, and over the tolerances of the first one's machine (none: empty).

    plants: full, the nominal one first. controller: sampled, with its delay. Raises InvalidInput.
    """
    checks = []
    for plant in plants:
        progress(f"verifying the sampled loop at {plant.point.label}")
        checks.append(check_sampled(plant, controller))
    if not plants or not plants[0].machine.tolerances:
        return tuple(checks), ()
    progress("verifying the sampled loop over the tolerances")
    return tuple(checks), (check_over_box(plants[0], controller),)


def check_sampled(plant: Plant, controller: StateSpace) -> Checks:
    """``nominal.check`` of a sampled controller with its delay, its signals matched to the plant's. Raises InvalidInput."""
    return nominal.check(plant, match_controller(controller, plant))


def check_over_box(plant: Plant, controller: StateSpace) -> Checks:
    """Stability and the sampled output sensitivity of a loop over its machine's tolerances, at corners and samples.

    By eigenvalues. plant: the full one. controller: sampled, with its delay. Unlike ``robust.check`` it proves nothing
    between the points: a sampled plant depends on its parameters through a matrix exponential. Raises InvalidInput.
    """
    controller = match_controller(controller, plant)
    names = [tolerance.parameter for tolerance in plant.machine.tolerances]
    points = box_points(len(names), _INSIDE)
    small = reduce(plant, _MODES) if plant.bending_modes is None else plant
    abscissa = np.empty(len(points))
    peak = np.empty(len(points))
    for i, point in enumerate(points):
        delta = dict(zip(names, point.tolist(), strict=True))
        certificate = certify(perturbed(small, delta), controller)
        abscissa[i], peak[i] = certificate.spectral_abscissa, certificate.closed_loop_norm
        if i < _FULL_POINTS:
            abscissa[i] = max(abscissa[i], _abscissa(perturbed(plant, delta), controller))
    unstable = abscissa >= 0
    worst = int(np.argmax(np.where(unstable, np.inf, peak)))
    outermost = int(abscissa.argmax())

    def where(i: int) -> str:
        return ", ".join(f"{name} {value:+.3g}" for name, value in zip(names, points[i], strict=True))

    example = f"; for one, {where(outermost)} ({abscissa[outermost]:+.4g} rad/s)" if unstable.any() else ""
    full = min(_FULL_POINTS, len(points))
    extent = f"{len(points)} corners and samples, {full} of them on the full plant{example}"
    value = np.inf if unstable.any() else float(peak[worst])
    checks: list[Check] = [
        judge(
            "sampled.stability.box", "Unstable points of the tolerance box, sampled loop", int(unstable.sum()), "-",
            Demand(0.0, "<=", "every tolerance"), extent,
        ),
        information("sampled.abscissa.box", "Outermost pole over the box", float(abscissa.max()), "rad/s", where(outermost)),
        information("sampled.sensitivity.box", "Sampled output sensitivity over the box", value, "-", where(worst)),
    ]  # fmt: skip
    return Checks("over the tolerances, sampled", not unstable[0], tuple(checks))


def _abscissa(plant: Plant, controller: StateSpace) -> float:
    """Spectral abscissa [rad/s] of the sampled loop on the full plant."""
    dt = controller.dt
    if dt is None:
        raise InvalidInput("the controller is continuous; give the sampled one with its delay (core.sampling.c2d, delayed)")
    open_plant = c2d(select(plant.system, plant.named("u"), plant.named("y")), dt)
    return spectral_abscissa(feedback(series(controller, open_plant), static_gain(np.eye(len(plant.axes)), dt=dt)))
