"""The verdict on one controller: on the full plants point by point, and over all tolerances around
each.

verification = verify_controller(machine, controller)     # as the front door and the command
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, names_wrong_types
from ambrose.core.statespace import StateSpace
from ambrose.judge import nominal, robust, sampled
from ambrose.judge.campbell import follow
from ambrose.judge.checks import (
    CONTINUOUS,
    WITH_MEAN_DELAY,
    Check,
    Checks,
    Curve,
    Verification,
    box_label,
    judge,
    moving_proofs,
    refuse_motion,
    required_line,
)
from ambrose.judge.loop_response import solid_cores
from ambrose.judge.measured import Responses, check_measured, placed, read_responses
from ambrose.judge.plants import (
    Progress,
    full_plants,
    judge_assumed,
    plant_at,
    plants_along_speed,
    small_along_speed,
    split_covered,
)
from ambrose.judge.result import Certificate, certify
from ambrose.law.design_problem import machine_weights
from ambrose.law.law import SPEED, Law, LawLike, extension, law_of
from ambrose.law.loop import (
    DEFAULT,
    STATE_RATE,
    Timing,
    laws_of,
    loop_alone,
    match_controller,
    running_law,
    timing_of,
)
from ambrose.machine.criteria import Demand, demand
from ambrose.machine.description import OperatingPoint, OperatingRange, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.effect import pressure_knots, speed_knots
from ambrose.model.plant import Plant, beyond_top_speed, holds_only
from ambrose.model.uncertainty import default_bending_modes, not_varied, reduce, tolerances_around
from ambrose.options import Verifying
from ambrose.record.response import Response

# Verification between operating points: a range of speeds and pressures, gridded as finely as the
# loop changes.


_STEPS = 8  # of a refinement along one axis


def check_range(
    machine: Machine, area: OperatingRange, law: LawLike, timing: Timing | None = None
) -> Checks:
    """Stability and sigma_max(S_o) of the nominal loop over a range; the worst point that is found,
    on the full plant.

    law: a controller or a schedule that covers the range; timing: the loop as it runs (None:
    continuous).
    """
    extremes = search(machine, area, law, timing)
    corner, looked = assemble(machine, area.corners[0]), 0
    modes, cored = default_bending_modes(corner), solid_cores(corner)

    def certified(speed: float, pressure: float, bending: int | None = None) -> Certificate:
        nonlocal looked
        looked += 1
        plant = assemble(machine, area.at(speed, pressure))
        plant = plant if bending is None else reduce(plant, bending)
        return certify(plant, running_law(law, plant, timing), margins=False)

    point = extremes.worst(area)
    place = point.speed, point.seal_pressure
    if np.isfinite(extremes.peak).all():
        place = _refined(lambda v, p: certified(v, p, modes).closed_loop_norm, extremes, place)
    worst = certified(*place)

    def loop_at(axis: int, other: float, value: float) -> StateSpace:
        speed, pressure = (value, other) if axis == 0 else (other, value)
        plant = assemble(machine, area.at(speed, pressure))
        return loop_alone(plant, running_law(law, plant, timing))

    # the poles along each of speed and pressure, where the other has an end, a table that bends or
    # the largest peak
    knots = speed_knots(machine, *area.speed), pressure_knots(machine, *area.seal_pressure)
    grids = [
        np.unique([*grid, *more])
        for grid, more in zip((extremes.speeds, extremes.pressures), knots, strict=True)
    ]
    count, peak = 0, place
    abscissa = float(extremes.abscissa.max())
    for axis, ends in enumerate((area.seal_pressure, area.speed)):
        for other in sorted({*ends, *knots[1 - axis], peak[1 - axis]}):
            if len(grids[axis]) < 2:
                continue
            along = follow(partial(loop_at, axis, other), grids[axis])
            count += len(along.speeds)
            k = int(np.argmax(along.abscissa))
            if along.abscissa[k] > max(abscissa, 0.0) or (along.abscissa[k] >= 0 and worst.stable):
                at = float(along.speeds[k])
                place = (at, other) if axis == 0 else (other, at)
                worst = certified(*place)
            abscissa = max(abscissa, float(along.abscissa[k]))
    abscissa = max(abscissa, worst.spectral_abscissa)
    size = (
        f"{len(extremes.speeds)} speeds x {len(extremes.pressures)} pressures, "
        f"{100 * extremes.change:.2g} % between neighbours"
    )
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    checks = (
        judge(
            "range.abscissa",
            f"Outermost pole between the points, {count + looked} speeds and pressures, refined at "
            "the worst",
            abscissa,
            "rad/s",
            Demand(0.0, "<", "stability"),
            f"found on a grid of {size}, on the full plant over the speed",
        ),
        judge(
            "range.sensitivity",
            f"Largest output sensitivity between the points, {extremes.peak.size + looked} speeds "
            "and pressures, refined at the worst",
            worst.closed_loop_norm,
            "-",
            wanted,
            f"{area.at(*place).label}, on the full plant; found on a grid of {size}"
            + (", with the cores' half order" if cored else ""),
        ),
    )
    curves: tuple[Curve, ...] = ()
    if len(extremes.speeds) > 1:
        labels = tuple(f"{pressure / 1e5:.4g} bar" for pressure in extremes.pressures)
        title = f"Largest sensitivity over {area.label}"
        curves = (
            Curve(
                "range.sensitivity",
                title,
                "speed",
                extremes.speeds,
                extremes.peak.T,
                labels,
                "rad/s",
                "-",
                required_line(wanted.limit),
            ),
        )
    return Checks(area.label, abscissa < 0, checks, curves)


def _refined(
    value: Callable[[float, float], float], extremes: Found, place: tuple[float, float]
) -> tuple[float, float]:
    """Where a value is largest near a place of the grid: over the speed, then over the pressure,
    twice, each time nearer.
    """
    from scipy.optimize import minimize_scalar

    best, where = float(extremes.peak.max()), place
    for share in (1.0, 0.25):
        for axis, grid in enumerate((extremes.speeds, extremes.pressures)):
            k = int(np.argmin(np.abs(grid - where[axis])))
            ends = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
            low, high = (float(where[axis] + share * (end - where[axis])) for end in ends)
            if high - low <= 1e-9 * (grid[-1] - grid[0]):
                continue
            other = where[1 - axis]

            def along(x: float, axis: int = axis, other: float = other) -> float:
                return -value(x, other) if axis == 0 else -value(other, x)

            found = minimize_scalar(
                along, bounds=(low, high), method="bounded", options={"maxiter": _STEPS}
            )
            if -found.fun > best:
                best, x = -float(found.fun), float(found.x)
                where = (x, other) if axis == 0 else (other, x)
    return where


# A range of speeds and seal pressures, gridded as finely as the loop changes.
#
# The grid is a product of speeds and pressures. It begins with ends, middles and where tables bend;
# the interval over
# which the figure changes most is halved until no neighbours differ by more than a few per cent, or
# the number of points is used up. What is found is found on that grid: nothing is proved between
# its points.


_CHANGE = 0.05  # relative, of the figure between neighbours
_MOST = 32  # points of the grid


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """speeds (s,) [rad/s], pressures (p,) [Pa], peak (s, p): sigma_max(S_o), inf where the loop is
    unstable; abscissa (s, p) [rad/s]; change: the largest relative change of the peak between
    neighbours.
    """

    speeds: np.ndarray
    pressures: np.ndarray
    peak: np.ndarray
    abscissa: np.ndarray

    @property
    def change(self) -> float:
        return max(
            (float(_changes(self.peak, axis).max(initial=0.0)) for axis in (0, 1)), default=0.0
        )

    def worst(self, area: OperatingRange) -> OperatingPoint:
        """Where the peak is largest; where loops are unstable, the most unstable one."""
        value = self.abscissa if np.isinf(self.peak).any() else self.peak
        i, j = np.unravel_index(int(value.argmax()), value.shape)
        return area.at(float(self.speeds[i]), float(self.pressures[j]))


def search(
    machine: Machine, area: OperatingRange, law: LawLike, timing: Timing | None = None
) -> Found:
    """The peak of sigma_max(S_o) of the nominal loop, and its outermost pole, over a range, on
    plants with all bending modes that matter (``default_bending_modes``).

    law: a continuous controller or a schedule; timing: the loop as it runs (None: continuous).
    """
    known: dict[tuple[float, float], tuple[float, float]] = {}
    modes = default_bending_modes(assemble(machine, area.corners[0]))

    def judged(speed: float, pressure: float) -> tuple[float, float]:
        if (speed, pressure) not in known:
            plant = reduce(assemble(machine, area.at(speed, pressure)), modes)
            certificate = certify(plant, running_law(law, plant, timing), margins=False)
            known[speed, pressure] = certificate.closed_loop_norm, certificate.spectral_abscissa
        return known[speed, pressure]

    grids = [
        np.unique([*np.linspace(*pair, 3), *knots(machine, *pair)])
        if pair[1] > pair[0]
        else np.array(pair[:1])
        for pair, knots in ((area.speed, speed_knots), (area.seal_pressure, pressure_knots))
    ]
    while True:
        values = np.array([[judged(float(v), float(p)) for p in grids[1]] for v in grids[0]])
        result = Found(grids[0], grids[1], values[..., 0], values[..., 1])
        changes = [_changes(result.peak, axis).max(axis=1 - axis, initial=0.0) for axis in (0, 1)]
        axis = int(np.argmax([part.max(initial=0.0) for part in changes]))
        added = len(grids[1 - axis])
        if changes[axis].max(initial=0.0) <= _CHANGE or result.peak.size + added > _MOST:
            return result
        k = int(changes[axis].argmax())
        grids[axis] = np.insert(grids[axis], k + 1, grids[axis][k : k + 2].mean())


def _changes(peak: np.ndarray, axis: int) -> np.ndarray:
    """Relative changes between neighbours along an axis; 0 between two unstable ones, inf between a
    stable and an unstable.
    """
    low, high = (np.take(peak, range(i, peak.shape[axis] - 1 + i), axis) for i in (0, 1))
    both = np.isinf(low) & np.isinf(high)
    with np.errstate(invalid="ignore"):
        change = np.abs(high - low) / np.minimum(low, high)
    return np.where(both, 0.0, change)


# what moves while the machine runs is across the shaft
_ACROSS: dict[str, Any] = {"pressure_rate": None, "pressure_error": 0.0, "speed_rate": None}


@names_wrong_types
def verify_controller(
    machine: Machine | Plant | Sequence[Plant],
    controller: LawLike,
    points: Sequence[str | OperatingPoint] | None = None,
    *,
    measured: Responses = (),
    running: LawLike | None = None,
    progress: Progress = lambda stage: None,
    **options: Any,
) -> Verification:
    """The checks of a controller on the full plant at every operating point, and over the
    tolerances around each.

    machine: or the plants to verify on, one or several; every group of its axes is judged, and one
    without a law is named in ``not_judged``. controller: what controls, as a law or as anything
    that ``law.law.law_of`` makes one of. points: operating points or labels (None: all).
    measured: frequency responses or their files, one for each operating point that they are of,
    where they decide in place of the model and its tolerances (``judge.measured``); running: the
    controller that ran then (None: they are of the plant alone).
    options: of ``ambrose.options.Verifying``. The loop is sampled by Tustin's map and late; where
    nobody knows a rate the continuous loop is judged, and ``timing`` says so. Operating points that
    a schedule does not cover are listed as left out. Raises InvalidInput where the controller is
    not one for this machine, and, before anything is computed, where a motion cannot be examined.
    """
    law, asked = law_of(controller), Verifying(**options)
    if not isinstance(machine, Machine):
        plants = (machine,) if isinstance(machine, Plant) else tuple(machine)
        return _verify_axes(plants, None, law, asked, measured, running, progress)
    groups = laws_of(machine, law, asked.axial, asked.axes)
    (own, first), *others = groups.values()
    if points is None:
        refuse_motion(own, first, asked)
    lines = _allotted([own, *(group for group, _ in others)], points, measured)
    ran = {} if running is None else laws_of(machine, law_of(running), axes=asked.axes)
    if running is not None and not any(lines.values()):
        placed((), (), running)
    # the thrust axis first: it takes little, and its controller may be the wrong one
    found = None
    for name, (group, other) in reversed(groups.items()):
        how = asked if group is own else replace(asked, **_ACROSS)
        by = ran.get(name, (group, None))[1] if lines[group.name] else None
        whole, plants = group if points is None else None, _plants(group, points)
        one = _verify_axes(plants, whole, other, how, lines[group.name], by, progress)
        found = one if found is None else one.with_thrust(found)
    assert found is not None
    wanted = machine.groups if asked.axes is None else {}
    missing = tuple(f"{name} axis" for name in wanted if name not in groups)
    several = len(machine.groups) > 1
    return replace(found, not_judged=missing, axes=tuple(groups) if several else ())


def _allotted(
    groups: Sequence[Machine],
    points: Sequence[str | OperatingPoint] | None,
    measured: Responses,
) -> dict[str, list[Response]]:
    """{group's machine: its responses}, by the machine that each names. Raises InvalidInput for
    those of another machine or point, before anything is computed.
    """
    found: dict[str, list[Response]] = {group.name: [] for group in groups}
    for one in read_responses(measured):
        found.get(one.machine, found[groups[0].name]).append(one)
    for group in groups if len(groups) > 1 else ():
        if items := found[group.name]:
            placed(_plants(group, points), items, None)
    return found


def _plants(machine: Machine, points: Sequence[str | OperatingPoint] | None) -> tuple[Plant, ...]:
    """The plants at these operating points; None: at all."""
    return full_plants(machine) if points is None else tuple(plant_at(machine, p) for p in points)


def _verify_axes(
    plants: tuple[Plant, ...],
    whole: Machine | None,
    law: Law,
    asked: Verifying,
    measured: Responses,
    running: LawLike | None,
    progress: Progress,
) -> Verification:
    """``verify_controller`` of one group of axes and its law; whole: its machine, where all of its
    operating points are judged.
    """
    if not plants:
        raise InvalidInput(
            "no operating point is given; name one at least, or leave points out for all of the "
            "machine"
        )
    within, left_out = split_covered(law, plants)
    places = placed(within, measured, running)
    sampled = next((one.sample_rate_hz for one in places.values()), None)
    rate = sampled if asked.rate is None else asked.rate
    timing = timing_of(within[0].machine, law, rate, asked.delay_samples)
    by_lines = []
    for k, response in sorted(places.items()):
        progress(f"judging on the responses of {within[k].point.label}")
        by_lines.append(check_measured(within[k], response, law, running, timing))
    modelled = [plant for k, plant in enumerate(within) if k not in places]
    # together: along the speed once for every pressure
    every = verify_points([*(within[k] for k in sorted(places)), *modelled], law, progress, timing)
    by_lines = [_with_model(*pair) for pair in zip(by_lines, every, strict=False)]
    checks = every[len(by_lines) :]
    boxes: tuple[Checks, ...] = ()
    if asked.tolerances:
        boxes = verify_tolerances(
            modelled,
            law,
            checks,
            progress,
            timing,
            everywhere=asked.everywhere,
            informed=asked.informed,
        )
    checks = (*by_lines, *checks)
    ranges: tuple[Checks, ...] = ()
    moving: tuple[Checks, ...] = ()
    if whole is not None:
        ranges, beyond = verify_ranges(whole, law, checks, progress, timing)
        left_out = (*left_out, *beyond)
        moving = tuple(
            item
            for proof in moving_proofs()
            for item in proof.prove(whole, law, checks, timing, asked, progress)
        )
    blocks = () if whole is None else verify_synchronous(whole, law, asked, progress)
    still = tuple(words for plant in modelled for words in not_varied(plant)) + tuple(
        f"{within[k].point.label}: its responses were measured"
        for k in sorted(places)
        if tolerances_around(within[k])
    )
    return Verification(
        checks,
        boxes,
        left_out,
        CONTINUOUS if timing is None else str(timing),
        still if asked.tolerances else (),
        ranges,
        moving,
        blocks,
        controller=law.named,
        over_speed=tuple(
            f"{plant.point.label}: {words}"
            for plant in within
            if (words := beyond_top_speed(plant.machine, plant.point.speed))
        ),
        between=_between(law, within, checks),
        rotor=next((holds_only(plant.machine) for plant in within), ""),
    )


_TOLD = ("stability.abscissa", "sensitivity.", "complementary.", "margin.")  # by responses


def _with_model(lines: Checks, model: Checks) -> Checks:
    """Checks on measured responses, and of the model what these do not tell: unbalance, currents,
    settling, damping, the controller's own limits.
    """
    if not lines.stable:
        return lines
    if not model.stable:
        why = "the model of this point is unstable; identify the machine from these responses"
        title = "Requirements that the responses do not tell, by the model"
        none = Demand(0.0, "<", "stability of the model")
        growth = model["stability.abscissa"].value
        return replace(
            lines,
            checks=(*lines.checks, judge("model.abscissa", title, growth, "rad/s", none, why)),
        )
    rest = tuple(check for check in model.checks if not check.name.startswith(_TOLD))
    curves = tuple(curve for curve in model.curves if not curve.name.startswith(_TOLD))
    return replace(lines, checks=(*lines.checks, *rest), curves=(*lines.curves, *curves))


def verify_points(
    plants: Sequence[Plant],
    controller: LawLike,
    progress: Progress = lambda stage: None,
    timing: Timing | None = None,
) -> tuple[Checks, ...]:
    """The checks on every full plant, of the loop as it runs. Where nobody states a rate and the
    loop would be unstable at the one that rig and export assume, "timing.assumed" fails. Raises
    InvalidInput where the controller is not one for it.
    """
    law = law_of(controller)
    results = []
    seen: set[tuple[float, float | None]] = set()
    for plant in plants:
        progress(f"verifying at {plant.point.label}")
        # over all speeds once for every pressure and bias current of the points
        place = plant.point.seal_pressure, plant.point.bias_current
        turning = plant.machine.operation.running[1] > 0 and place not in seen
        seen.add(place)
        along = plants_along_speed(plant) if turning else None
        checks = nominal.check(
            plant,
            running_law(law, plant, timing),
            plant_at=along,
            law_at=lambda other: running_law(law, other, timing),
            covered=_speeds_covered(law, plant),
            small_at=small_along_speed(plant) if turning else None,
        )
        unsampled = _unstable_when_sampled(plant, law, timing) if checks.stable else ()
        results.append(replace(checks, checks=(*checks.checks, *unsampled)))
    return tuple(results)


def _speeds_covered(law: Law, plant: Plant) -> tuple[float, float]:
    """The part of the machine's running range [rad/s] that a schedule over speed is made for."""
    low, high = plant.machine.operation.running
    if law.follows(SPEED) and law.range is not None:
        first, last = (float(np.atleast_1d(end)[0]) for end in law.range)
        low, high = max(low, first), min(high, last)
    return low, high


def _unstable_when_sampled(plant: Plant, law: Law, timing: Timing | None) -> tuple[Check, ...]:
    """A failed check of a loop that holds as continuous alone: what rig and code would run does
    not.
    """
    assumed = judge_assumed(plant, law, timing)
    if assumed is None or assumed.stable:
        return ()
    return (
        Check(
            "timing.assumed",
            f"Growth at {DEFAULT.rate:g} Hz and one sample late, as virtual rig and export assume",
            assumed.abscissa,
            "rad/s",
            0.0,
            "<",
            False,
            detail=f"no sample rate is stated, and the continuous loop was checked; {STATE_RATE}",
        ),
    )


def _between(law: Law, plants: Sequence[Plant], points: Sequence[Checks]) -> str:
    """What was checked between the speeds of the points, in words; "" where all have one speed."""
    if any(check.name == "stability.speeds" for part in points for check in part.checks):
        low, high = (30 / np.pi * end for end in _speeds_covered(law, plants[0]))
        return f"speeds from {low:,.6g} to {high:,.6g} rpm (searched)"
    several = len({plant.point.speed for plant in plants}) > 1
    machine = plants[0].machine
    stated = (machine.whole or machine).operation.speed_range[1] > 0
    remedy = "" if stated else " (state speed_range)"
    return f"nothing between their speeds{remedy}" if several else ""


def verify_ranges(
    machine: Machine,
    law: LawLike,
    points: Sequence[Checks],
    progress: Progress,
    timing: Timing | None = None,
) -> tuple[tuple[Checks, ...], tuple[str, ...]]:
    """The checks over every range all of whose corners (of ``points``) are held; the ranges that a
    schedule does not cover.
    """
    law = law_of(law)
    stable = {checks.label: checks.stable for checks in points}
    ranges = []
    beyond = []
    for area in machine.operation.ranges:
        covered = [law.covers(assemble(machine, corner)) for corner in area.corners]
        if not all(covered):
            beyond.append(area.label)
        elif all(stable.get(corner.label, True) for corner in area.corners):
            progress(f"verifying between the points of {area.label}")
            ranges.append(check_range(machine, area, law, timing))
    return tuple(ranges), tuple(beyond)


def verify_synchronous(
    machine: Machine, law: Law, asked: Verifying, progress: Progress
) -> tuple[Checks, ...]:
    """The checks of every synchronous block: the controller file's, else the machine file's.

    Raises InvalidInput for blocks that do not fit the machine, or a controller scheduled over
    speed.
    """
    if not (blocks := law.blocks_on(machine)):
        return ()
    items = extension("loops")(machine, law, blocks, asked.rate, asked.delay_samples)
    check = extension("check")
    return tuple(check(item, progress, speed_rate=asked.speed_rate) for item in items)


def verify_tolerances(
    plants: Sequence[Plant],
    controller: LawLike,
    points: Sequence[Checks],
    progress: Progress,
    timing: Timing | None = None,
    tolerances: Sequence[Tolerance] | None = None,
    *,
    design: LawLike | None = None,
    everywhere: bool = False,
    informed: bool = True,
) -> tuple[Checks, ...]:
    """The checks over the tolerances around every plant with a stable loop (``points``) and any
    tolerance.

    tolerances: None: all; otherwise those, and of all together only the number of unstable corners
    and samples. Around the first of them (``everywhere``: around all) everything is examined: worst
    cases searched and bounded, stability proved. Around the others stability and the worst
    sensitivity are searched. informed: what no requirement limits, too. With a
    timing this is done on the continuous loop with its mean delay, and the sampled loop is examined
    at the corners, at samples and at what the search found, which judges the sensitivity. design:
    the continuous law that ``controller`` is the sampled one of (None: itself); of a sampled law
    without it only the points are examined.
    """
    boxes: list[Checks] = []
    for plant, point in zip(plants, points, strict=True):
        varied = tolerances_around(plant, tolerances)
        if not varied or not point.stable:
            continue
        progress(f"verifying over the tolerances around {plant.point.label}")
        matched = match_controller(controller, plant)
        source = match_controller(controller if design is None else design, plant)
        checks: list[Checks] = []
        if source.dt is None:
            model = source if timing is None else timing.late(source)
            checks.append(
                _continuous_box(
                    plant,
                    model,
                    varied,
                    detailed=everywhere or not boxes,
                    late=timing is not None,
                    informed=informed,
                )
            )
            if tolerances is not None and (every := tolerances_around(plant)):
                checks[0] = replace(
                    checks[0], checks=(*checks[0].checks, robust.stability(plant, model, every))
                )
        if timing is not None:
            worst_points = checks[0].found if checks else ()
            checks.append(
                sampled.check_over_box(plant, timing.in_loop(matched), varied, worst_points)
            )
        boxes.append(_joined(box_label(plant.point.label), checks))
    return tuple(boxes)


def _continuous_box(
    plant: Plant,
    law: StateSpace,
    varied: tuple[Tolerance, ...],
    *,
    detailed: bool,
    late: bool,
    informed: bool,
) -> Checks:
    """The robust checks of a continuous law, which with ``late`` holds the loop's mean delay;
    ``detailed``: all of them; ``informed``: those that no requirement limits, too.
    """
    if not detailed:
        box = robust.examine(plant, law, varied)
    else:
        stated = informed and plant.machine.weights is not None
        weights = machine_weights(plant.machine) if stated else None
        box = robust.check(plant, law, varied, weights, informed=informed)
    if not late:
        return box
    checks = tuple(replace(c, detail=f"{c.detail}; {WITH_MEAN_DELAY}") for c in box.checks)
    return replace(
        box,
        checks=tuple(_unjudged(c) if c.name == "robust.sensitivity.worst" else c for c in checks),
    )


def _unjudged(check: Check) -> Check:
    """A check without its limit: Tustin's map moves a fast controller's resonances, so that the
    sampled loop is the judge.
    """
    return replace(
        check,
        limit=None,
        passed=None,
        detail=f"{check.detail}, which the sampled one below replaces",
    )


def _joined(label: str, parts: Sequence[Checks]) -> Checks:
    """Several examinations of one box as one."""
    checks, curves, notes = (
        tuple(x for part in parts for x in getattr(part, name))
        for name in ("checks", "curves", "notes")
    )
    points = tuple(point for part in parts for point in part.found)
    return Checks(label, all(part.stable for part in parts), checks, curves, notes, points)
