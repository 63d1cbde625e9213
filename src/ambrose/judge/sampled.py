"""Verification of the sampled loop: a sampled controller with its computing delay around the plant
behind a zero-order hold.

At operating points the checks are those of ``nominal``; over the tolerances stability is examined
by eigenvalues and the sensitivity on the full plant behind its hold, at corners and samples of the
box and where a search climbs from them (loop diagram in core/lft.py).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case.loop import box_points
from ambrose.judge import nominal
from ambrose.judge.checks import Check, Checks
from ambrose.judge.criteria import information, judge
from ambrose.judge.loop_response import half_order_share, solid_cores
from ambrose.judge.sampled_box import Peak, SampledBox, sampled_box
from ambrose.judge.verification import box_label
from ambrose.law.loop import match_controller
from ambrose.machine.criteria import TWO_PI, Demand, demand
from ambrose.machine.description import Tolerance
from ambrose.model.basis import bending_modes_of
from ambrose.model.plant import Plant
from ambrose.model.reduce import default_bending_modes, reduce_from
from ambrose.model.uncertainty import in_tolerances, perturbed, tolerances_around

# points of the box at which the eigenvalues of the full plant's loop are computed
_FULL_POINTS = 40
_STARTS = 3  # of the search inside the box, besides the nominal point
_BENDING = re.compile(r"rotor\.bending_(\d+)\.")
_INSIDE = 32  # points inside the box, beside its corners
# of a half bandwidth, by which resonances of members that share a grid may differ: the peak between
# is missed by 0.5 %, before the search goes on from the highest
_ALIKE = 0.1
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
        if point.stable and (tolerances := tolerances_around(plant)):
            progress(f"verifying the sampled loop over the tolerances around {plant.point.label}")
            boxes.append(
                replace(
                    check_over_box(plant, controller, tolerances),
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
    """Stability and the sampled output sensitivity of a loop over its tolerances, on the full plant
    as it runs.

    plant: the full one. controller: sampled, with its delay. tolerances: None: the machine's. also:
    further points, by parameter, such as the worst ones of the continuous search.

    The sensitivity is that of the full plant behind its hold (``sampled_box``) at the nominal
    point, at corners, samples and the points given; from the worst of them the search climbs
    inside the box. The frequencies are those of a net and of every member's own resonances, which a
    reduced plant tells. Stability is decided by eigenvalues, of the full plant's loop at the first
    points and at the worst one found. Unlike ``robust.check`` nothing is proved between the points.
    Raises InvalidInput.
    """
    controller = match_controller(controller, plant)
    tolerances_varied = plant.machine.tolerances if tolerances is None else tuple(tolerances)
    box = sampled_box(plant, controller, tolerances_varied)
    names = box.names

    # the nominal point, the points given, then corners and samples
    extra = np.array([[point[name] for name in names] for point in also]).reshape(-1, len(names))
    points = box_points(len(names), _INSIDE)
    points = np.vstack([points[:1], extra, points[1:]])

    # resonances of every member: a reduced plant places them closely enough for a first look
    small = reduce_from(plant, _modes(plant, names)) if plant.bending_modes is None else plant

    # abscissa of the reduced loop, of the full one too at the first points; light poles of the last
    abscissa = np.empty(len(points))
    light: list[np.ndarray] = []
    for i, point in enumerate(points):
        poles = box.closed_loop_poles(point, small)
        abscissa[i] = poles.real.max()
        if i < _FULL_POINTS:
            poles = box.closed_loop_poles(point)
            abscissa[i] = max(abscissa[i], poles.real.max())
        light.append(box.light(poles))

    # the peak of every member on the grid, which all share but for what lies beside resonances;
    # members whose resonances are alike share that, too
    base = box.base_grid()
    peaks = [
        Peak(float(row.max()), float(base[row.argmax()]), point)
        for row, point in zip(box.gains(base, points), points, strict=True)
    ]
    for members in _alike(light):
        grid = box.beside(light[members[0]])
        if not len(grid):
            continue
        for i, row in zip(members, box.gains(grid, points[members]), strict=True):
            if row.max() > peaks[i].value:
                peaks[i] = Peak(float(row.max()), float(grid[row.argmax()]), points[i])

    # the search moves on the gain alone: where it ends the poles are looked at again
    unstable = abscissa >= 0
    worst, found = _worst(box, peaks, unstable)
    if found.size and found.max() >= 0:
        points = np.vstack([points, worst.delta])
        abscissa = np.append(abscissa, found.max())
        unstable = np.append(unstable, True)

    outermost = int(abscissa.argmax())

    def where(delta: np.ndarray) -> str:
        return in_tolerances(box.named(delta))

    example = (
        f"; for one, {where(points[outermost])} ({abscissa[outermost]:+.4g} rad/s)"
        if unstable.any()
        else ""
    )
    full = min(_FULL_POINTS, len(points))
    extent = (
        f"{len(points)} corners, samples and worst cases found; poles on the full plant at "
        f"{full} of them{example}"
    )
    share, words = 1.0, ""
    if solid_cores(plant):
        there = perturbed(plant, box.named(worst.delta), tolerances_varied)
        share, words = half_order_share(there, controller)
    value = np.inf if unstable.any() else worst.value * share
    found_at = f"{where(worst.delta)}, at {worst.omega / TWO_PI:.4g} Hz; full plant, search{words}"
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
            where(points[outermost]),
        ),
        judge(
            "sampled.sensitivity.box",
            "Largest sampled output sensitivity found in the box",
            value,
            "-",
            demand("maximum singular value of a sensitivity", plant.machine.requirements),
            where(points[outermost]) if unstable.any() else found_at,
        ),
    ]
    return Checks("over the tolerances, sampled", not unstable[0], tuple(checks))


def _alike(light: Sequence[np.ndarray]) -> list[list[int]]:
    """Members of the box in groups whose light poles lie within a small part of their half
    bandwidths of each other, where their responses peak at the same frequencies.
    """
    groups: list[list[int]] = []
    for i, own in enumerate(light):
        for members in groups:
            first = light[members[0]]
            if len(first) == len(own) and bool(
                (np.abs(own - first) <= _ALIKE * np.abs(first.real)).all()
            ):
                members.append(i)
                break
        else:
            groups.append([i])
    return groups


def _worst(box: SampledBox, peaks: Sequence[Peak], unstable: np.ndarray) -> tuple[Peak, np.ndarray]:
    """The highest peak that the search reaches from the nominal point and the worst stable ones;
    and the poles [rad/s] of the full plant's loop there, real parts, empty where none was searched.

    Every start is looked at anew around the resonances of the full plant, which lie elsewhere than
    those of a reduced one.
    """
    stable = [peak for peak, lost in zip(peaks, unstable, strict=True) if not lost]
    if not stable:
        return peaks[0], np.empty(0)
    starts = sorted(stable[1:], key=lambda peak: -peak.value)[:_STARTS]
    best: Peak | None = None
    for start in (stable[0], *starts):
        resonances = box.beside(box.closed_loop_poles(start.delta))
        grid = np.union1d(np.append(box.base_grid(), start.omega), resonances)
        peak = box.climb(box.peak(start.delta, grid))
        if best is None or peak.value > best.value:
            best = peak
    assert best is not None
    return best, box.closed_loop_poles(best.delta).real


def _modes(plant: Plant, names: Sequence[str]) -> int:
    """Bending modes per plane of the plant that tells where resonances are: those that matter, and
    every one that a tolerance names, with the next one.
    """
    named = [int(match[1]) for name in names if (match := _BENDING.match(name)) is not None]
    available = bending_modes_of(plant.rotor_model)
    return min(max([default_bending_modes(plant), *named]) + 1, available)
