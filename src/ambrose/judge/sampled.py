"""Verification of the sampled loop: a sampled controller with its computing delay around the plant
behind a zero-order hold.

At operating points the checks are those of ``nominal``; over the tolerances stability and
sensitivity are examined by eigenvalues and norms at corners and samples of the box (loop diagram in
core/lft.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    StateSpace,
    feedback,
    select,
    series,
    spectral_abscissa,
    static_gain,
)
from ambrose.core.worst_case.loop import box_points
from ambrose.judge import nominal
from ambrose.judge.certificate import certify
from ambrose.judge.checks import Check, Checks
from ambrose.judge.criteria import information, judge
from ambrose.judge.verification import box_label
from ambrose.law.loop import match_controller
from ambrose.machine.criteria import Demand, demand
from ambrose.machine.description import Tolerance
from ambrose.model.plant import Plant
from ambrose.model.reduce import reduce
from ambrose.model.uncertainty import in_tolerances, perturbed, tolerances_around

# points of the box at which the eigenvalues of the full plant's loop are computed
_FULL_POINTS = 40
_MODES = 3  # bending modes per plane of the plant on which all points are examined
_INSIDE = 32
Progress = Callable[[str], None]


def verify_sampled(
    plants: Sequence[Plant], controller: StateSpace, progress: Progress = lambda stage: None
) -> tuple[tuple[Checks, ...], tuple[Checks, ...]]:
    """The checks at every plant, and over the tolerances around each with a stable loop and any
    tolerance.

    plants: full. controller: sampled, with its delay. Raises InvalidInput.
    """
    checks = []
    for plant in plants:
        progress(f"verifying the sampled loop at {plant.point.label}")
        checks.append(check_sampled(plant, controller))
    boxes = []
    for plant, point in zip(plants, checks, strict=True):
        if point.stable and (held := tolerances_around(plant)):
            progress(f"verifying the sampled loop over the tolerances around {plant.point.label}")
            boxes.append(
                replace(
                    check_over_box(plant, controller, held),
                    label=f"{box_label(plant.point.label)}, sampled",
                )
            )
    return tuple(checks), tuple(boxes)


def check_sampled(plant: Plant, controller: StateSpace) -> Checks:
    """``nominal.check`` of a sampled controller with its delay, its signals matched to the plant's.
    Raises InvalidInput.
    """
    return nominal.check(plant, match_controller(controller, plant))


def check_over_box(
    plant: Plant,
    controller: StateSpace,
    tolerances: Sequence[Tolerance] | None = None,
    also: Sequence[Mapping[str, float]] = (),
) -> Checks:
    """Stability and the sampled output sensitivity of a loop over its tolerances, at corners,
    samples and points given.

    By eigenvalues. plant: the full one. controller: sampled, with its delay. tolerances: None: the
    machine's. also: further points, by parameter. Unlike ``robust.check`` it proves nothing between
    the points: a sampled plant depends on its parameters through a matrix exponential. Raises
    InvalidInput.
    """
    controller = match_controller(controller, plant)
    held = plant.machine.tolerances if tolerances is None else tuple(tolerances)
    names = [tolerance.parameter for tolerance in held]
    extra = np.array([[point[name] for name in names] for point in also]).reshape(-1, len(names))
    points = box_points(len(names), _INSIDE)
    points = np.vstack([points[:1], extra, points[1:]])
    small = reduce(plant, _MODES) if plant.bending_modes is None else plant
    abscissa = np.empty(len(points))
    peak = np.empty(len(points))
    for i, point in enumerate(points):
        delta = dict(zip(names, point.tolist(), strict=True))
        certificate = certify(perturbed(small, delta, held), controller, margins=False)
        abscissa[i], peak[i] = certificate.spectral_abscissa, certificate.closed_loop_norm
        if i < _FULL_POINTS:
            abscissa[i] = max(abscissa[i], _abscissa(perturbed(plant, delta, held), controller))
    unstable = abscissa >= 0
    worst = int(np.argmax(np.where(unstable, np.inf, peak)))
    outermost = int(abscissa.argmax())

    def where(i: int) -> str:
        return in_tolerances(dict(zip(names, points[i].tolist(), strict=True)))

    example = (
        f"; for one, {where(outermost)} ({abscissa[outermost]:+.4g} rad/s)"
        if unstable.any()
        else ""
    )
    full = min(_FULL_POINTS, len(points))
    extent = (
        f"{len(points)} corners, samples and worst cases found, {full} of them on the full "
        f"plant{example}"
    )
    value = np.inf if unstable.any() else float(peak[worst])
    checks: list[Check] = [
        judge(
            "sampled.stability.box",
            "Unstable points of the tolerance box, sampled loop",
            int(unstable.sum()),
            "-",
            Demand(0.0, "<=", "every tolerance"),
            extent,
        ),
        information(
            "sampled.abscissa.box",
            "Outermost pole over the box",
            float(abscissa.max()),
            "rad/s",
            where(outermost),
        ),
        judge(
            "sampled.sensitivity.box",
            "Largest sampled output sensitivity found in the box",
            value,
            "-",
            demand("maximum singular value of a sensitivity", plant.machine.requirements),
            where(worst),
        ),
    ]
    return Checks("over the tolerances, sampled", not unstable[0], tuple(checks))


def _abscissa(plant: Plant, controller: StateSpace) -> float:
    """Spectral abscissa [rad/s] of the sampled loop on the full plant."""
    dt = controller.dt
    if dt is None:
        raise InvalidInput(
            "the controller is continuous; give the sampled one with its delay "
            "(core.sampling.c2d, delayed)"
        )
    open_plant = c2d(select(plant.system, plant.named("u"), plant.named("y")), dt)
    return spectral_abscissa(
        feedback(series(controller, open_plant), static_gain(np.eye(len(plant.axes)), dt=dt))
    )
