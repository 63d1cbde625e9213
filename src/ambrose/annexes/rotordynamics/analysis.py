"""``ambrose.lateral``: the lateral analysis of a rotor with its bearings, seals and controller."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

from ambrose.annexes.rotordynamics import items as rows
from ambrose.annexes.rotordynamics import points, standard
from ambrose.annexes.rotordynamics.block_on import with_blocks
from ambrose.annexes.rotordynamics.capacity import capacities
from ambrose.annexes.rotordynamics.circuit import circuit_change
from ambrose.annexes.rotordynamics.clearances import largest_reading, rubs
from ambrose.annexes.rotordynamics.critical_map import critical_map
from ambrose.annexes.rotordynamics.level_one import LevelOne, sweep
from ambrose.annexes.rotordynamics.level_two import shares
from ambrose.annexes.rotordynamics.loop import ShaftLoop, shaft_loop
from ambrose.annexes.rotordynamics.phase_budget import free_bending, phase_budgets
from ambrose.annexes.rotordynamics.placement import (
    ShaftMode,
    UnbalanceCase,
    place,
    place_rigid,
    shaft_modes,
    span_middle,
)
from ambrose.annexes.rotordynamics.reach import reach
from ambrose.annexes.rotordynamics.response import respond
from ambrose.annexes.rotordynamics.result import Item, Lateral, ModeRow
from ambrose.annexes.rotordynamics.stations import Layout, lay_out, rigid_support_critical
from ambrose.annexes.rotordynamics.tolerances import least_decrements
from ambrose.chain.check import clearance_doubts
from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.judge.stability import judge_stability
from ambrose.law.law import LawLike, law_of
from ambrose.law.timing import Timing, timing_of
from ambrose.machine.attachment import attached
from ambrose.machine.axial import across_the_shaft
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.model.effects.journal_bearing import JournalBearing
from ambrose.model.effects.stage import Stage, rated_cross_coupling
from ambrose.model.separation import running_range

TRIP = 1.05  # times the maximum continuous speed, where nothing is said
_LOOPS = 64  # kept by speed
_SLOWEST = 0.05  # of the trip speed: where response curves begin
_RIGID = (
    "No oscillatory forward mode lies below 1.25 times the trip speed or 1.3 times the maximum "
    "continuous speed: the unbalance is placed by the shapes of the rigid rotor, parallel and "
    "conical (assumed)."
)
_WEIGHTLESS = (
    "No gravity_direction in the machine file: static offset and load capacity count no weight, "
    "as for a vertical rotor; state it for a horizontal one."
)
_BARE_NOTE = (
    "Level I takes the rotor without seals and stages, as the standard does; a controller that "
    "relies on the stiffness of a seal may not stabilise it."
)


@names_wrong_types
def lateral(
    machine: Machine,
    controller: LawLike | None = None,
    point: OperatingPoint | str | None = None,
    *,
    trip: float | None = None,
    density: float | None = None,
    tolerances: bool = True,
    rate: float | None = None,
    delay_samples: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Lateral:
    """Unbalance response, stability (Level I and II), clearances and capacity, clause by clause.

    controller: what controls, with its synchronous blocks (else the machine file's): the response
    is judged with them off and on; None for a rotor on journal bearings alone. point: the operating
    point at maximum continuous speed, or its label (default: the fastest one). The machine runs
    from its slowest turning operating point to its fastest, unless ``running_speeds`` says
    otherwise. trip [rad/s]: default 1.05 times the highest running speed; the unbalance response
    goes on to 1.3 times the highest running speed at least. density [kg/m^3]: mean of the gas, for
    the screening of Level I. tolerances: whether the least log decrement over them is looked for.
    rate [Hz], delay_samples: the loop as it runs, as in ``ambrose.verify``. progress receives a
    line per stage. Raises InvalidInput for a machine at rest, for a trip speed below the running
    speeds and where a table does not reach it.
    """
    across_the_shaft(machine, "a lateral analysis is of the motion across it")
    chosen = _point(machine, point)
    running = machine.requirements.running_speeds
    turning = (item.speed for item in (*machine.operation.envelope, chosen))
    lowest, highest = running_range(running, turning) or (chosen.speed, chosen.speed)
    stated, trip = trip, _trip(trip, highest)
    if density is not None and not 0 < density < math.inf:
        raise invalid("the mean gas density", density, "more than 0 kg/m3", "it screens Level I")
    if controller is None and machine.bearings:
        raise InvalidInput(
            f"{machine.name} floats on magnetic bearings and needs a controller: give one, or "
            'design it with ambrose.design(machine, "pid")'
        )
    law = None if controller is None else law_of(controller)
    timing = None if law is None else timing_of(machine, law, rate, delay_samples)
    layout = lay_out(machine)

    @lru_cache(maxsize=_LOOPS)
    def loop_at(speed: float) -> ShaftLoop:
        return shaft_loop(layout, replace(chosen, speed=speed, label=""), law, timing)

    early = tuple(text[0].upper() + text[1:] + "." for text in clearance_doubts(machine))
    if stated is None and not _covers(loop_at, trip):
        early = (
            *early,
            f"The machine file does not cover {standard.rpm(trip)} rpm, 1.05 times the "
            "running speed; without a stated trip speed the analysis ends at the running speed.",
        )
        trip = highest
    _reaches(loop_at, trip)
    at_top = loop_at(chosen.speed)
    name = getattr(controller, "label", "") or ("none" if law is None else "as given")
    slowest = _slowest(machine, trip)
    progress("undamped critical speeds")
    undamped = critical_map(layout, at_top, loop_at, law, (slowest, trip))
    bare = Lateral(
        machine=machine,
        controller=str(name),
        timing=_timing_in_words(law, timing),
        point=chosen.label or f"{chosen.speed:.4g} rad/s",
        speeds=(lowest, highest, trip),
        layout=layout,
        critical_map=undamped,
        density=density,
    )
    progress("how far the response goes")
    far = reach(loop_at, slowest, (lowest, highest), trip)
    unstable = _unstable_at(at_top, loop_at, law, timing, (lowest, highest, trip))
    if unstable is None and far.unstable is not None:
        unstable = _pole_in_words(*far.unstable)
    progress("modes")
    near = max(standard.MODES_TO * trip, far.asked)
    listed = _listed_to(at_top, near)
    bare = replace(bare, modes_to=listed)
    modes = shaft_modes(at_top, near)
    table = tuple(ModeRow(mode, shares(at_top, mode)) for mode in modes)
    further = tuple(
        ModeRow(mode, shares(at_top, mode)) for mode in shaft_modes(at_top, listed, near)
    )
    if unstable is not None:
        items: tuple[Item, ...] = (rows.unstable(unstable), *rows.undamped(undamped))
        return replace(bare, items=items, modes=(*table, *further))
    if tolerances and machine.tolerances:
        progress("modes over the tolerances")
        table = least_decrements(at_top, table)
    table = (*table, *further)

    forward = [mode for mode in modes if mode.forward]
    cases = _cases(layout, forward, chosen.speed)
    if not cases:
        cases = place_rigid(layout, chosen.speed)
        early = (*early, _RIGID)
    progress(f"unbalance response, {len(cases)} placements")
    if slowest > _SLOWEST * trip:
        early = (
            *early,
            f"Response curves begin at {standard.rpm(slowest)} rpm, where the tables of the "
            "journal bearings do.",
        )
    whole = respond(layout, loop_at, cases, slowest, far.end, progress, through=far.through)
    response = whole.upto(trip)
    reading = largest_reading(response, lowest, highest)
    limit = standard.vibration_limit(highest / standard.RPM)
    # S_cc = A_vl/A_max
    largest = 1e6 * reading.peak_to_peak  # [um]
    uncapped = limit / largest if largest else math.inf
    scale = (max(1.0, min(standard.LARGEST_SCALE, uncapped)), uncapped)
    found = rubs(response, scale[0])
    budgets = phase_budgets(at_top, timing)
    progress("Level I")
    one, why, notes = _level_one(machine, layout, chosen, law, timing, near, density)
    progress("load capacity")
    capacity = (
        capacities(at_top, loop_at, law, timing, response, trip)
        if machine.bearings and law is not None
        else ()
    )
    everywhere: tuple[Item, ...] = ()
    blocks_on: tuple[Item, ...] = ()
    if machine.bearings and law is not None:
        blocks_on = tuple(
            with_blocks(
                machine,
                law,
                (rate, delay_samples),
                whole,
                loop_at,
                (lowest, highest, trip),
                scale[0],
                far.through,
                progress,
            )
        )
        progress("sensitivity at every operating point")
        everywhere = tuple(
            points.rows(points.judge_sensitivity(machine, at_top, law, timing), machine)
        )
        notes = (*notes, points.REST)
    items = (
        *rows.undamped(undamped),
        rows.reached(far, whole, highest),
        *rows.unbalance(whole, reading, (lowest, highest), scale),
        *rows.clearances(found),
        *rows.level_one(one, density, why),
        *rows.level_two(table, highest, law is not None),
        *rows.as_it_runs([loop_at(w) for w in sorted({lowest, highest, trip})], law, timing),
        *rows.capacity(capacity),
        *rows.phase(budgets),
        *rows.circuit(circuit_change(machine, chosen, law, timing, modes)),
        *everywhere,
        *rows.iso_vibration(machine, found, scale[0], (slowest, trip)),
        *blocks_on,
        *rows.not_covered(machine),
    )
    if machine.bearings and machine.gravity_direction is None:
        notes = (*notes, _WEIGHTLESS)
    if running is None:
        notes = (
            *notes,
            "No running_speeds in the machine file: the machine is taken to run "
            f"{rows.speeds_in_words(lowest, highest)}, between its slowest and fastest turning "
            "operating points; set running_speeds in [requirements] for another range.",
        )
    return replace(
        bare,
        items=tuple(items),
        modes=table,
        rubs=found,
        response=whole,
        level_one=one,
        capacities=capacity,
        scale=scale,
        notes=(*early, *notes),
        phase_budgets=budgets,
        critical_speeds=tuple(rows.critical_speeds(whole, lowest, highest)),
    )


def _listed_to(loop: ShaftLoop, near: float) -> float:
    """Up to where modes are listed [rad/s]: those that are judged or excited, and beyond them the
    first two bending modes, as far as a sampled controller can have modes.
    """
    nyquist = math.inf if loop.law is None or loop.law.dt is None else math.pi / loop.law.dt
    bending = free_bending(loop.plant.machine)[: standard.BENDING_LISTED]
    beyond = [standard.BEYOND_BENDING * float(bending[-1])] if len(bending) else []
    return max(near, min(nyquist, *beyond, math.inf))


def _timing_in_words(law: LawLike | None, timing: Timing | None) -> str:
    if law is None:
        return "no controller"
    return "continuous" if timing is None else str(timing)


def _point(machine: Machine, point: OperatingPoint | str | None) -> OperatingPoint:
    if point is not None:
        chosen = operating_point(machine, point)
    else:
        chosen = max(machine.operation.envelope, key=lambda item: item.speed)
    if chosen.speed <= 0:
        raise InvalidInput(
            f"the operating point {chosen.label or 'given'} stands still, but a lateral analysis "
            "needs a turning rotor; give the point at maximum continuous speed"
        )
    return chosen


def _trip(trip: float | None, highest: float) -> float:
    if trip is None:
        return TRIP * highest
    if not (math.isfinite(trip) and trip >= highest):
        raise invalid(
            "the trip speed",
            f"{standard.rpm(trip)} rpm",
            f"{standard.rpm(highest)} rpm or more",
            "it ends the curves",
        )
    return trip


def _covers(loop_at: Callable[[float], ShaftLoop], speed: float) -> bool:
    try:
        loop_at(speed)
    except InvalidInput:
        return False
    return True


def _reaches(loop_at: Callable[[float], ShaftLoop], trip: float) -> None:
    """Refuses a trip speed that a table does not reach, before anything is computed."""
    try:
        loop_at(trip)
    except InvalidInput as error:
        raise InvalidInput(
            f"the analysis goes to the trip speed, {trip:g} rad/s, which the machine file does not "
            f"cover ({error}); extend the table, or give a trip speed inside"
        ) from error


def _slowest(machine: Machine, trip: float) -> float:
    """Where response curves begin [rad/s]: at a share of the trip speed, or where the last of the
    journal bearings' tables does.
    """
    tables = [part.speed for _, part in attached(machine) if isinstance(part, JournalBearing)]
    return max([_SLOWEST * trip, *(table[0] for table in tables if table)])


def _unstable_at(
    at_top: ShaftLoop,
    loop_at: Callable[[float], ShaftLoop],
    law: LawLike | None,
    timing: Timing | None,
    speeds: tuple[float, float, float],
) -> str | None:
    """Where the loop as it runs is unstable, of running speeds and trip; None: nowhere there."""
    for speed in sorted({at_top.point.speed, *speeds}):
        loop = at_top if speed == at_top.point.speed else loop_at(speed)
        if law is None:
            abscissa = float(loop.all_modes().real.max())
        else:
            abscissa = judge_stability(loop.plant, law, timing).abscissa
        if abscissa >= 0:
            return _pole_in_words(speed, abscissa)
    return None


def _pole_in_words(speed: float, abscissa: float) -> str:
    return f"at {standard.rpm(speed)} rpm a pole has real part {abscissa:.4g} 1/s"


def _cases(layout: Layout, forward: list[ShaftMode], speed: float) -> tuple[UnbalanceCase, ...]:
    """A placement per forward mode; none twice, none without a mode."""
    cases: list[UnbalanceCase] = []
    for mode in forward:
        for case in place(layout, mode, speed):
            if all(case.weights != other.weights for other in cases):
                cases.append(case)
    return tuple(cases)


def _level_one(
    machine: Machine,
    layout: Layout,
    point: OperatingPoint,
    law: LawLike | None,
    timing: Timing | None,
    near: float,
    density: float | None,
) -> tuple[LevelOne | None, str, tuple[str, ...]]:
    """Level I of the machine without seals and stages, its modes up to a frequency [rad/s]; None
    and why where it cannot be done; notes.
    """
    stages = [part for _, part in attached(machine) if isinstance(part, Stage)]
    bare = replace(
        machine,
        seals=(),
        tolerances=(),
        effects=tuple(part for part in machine.effects if not isinstance(part, Stage)),
        supports=tuple(replace(support, seals=()) for support in machine.supports),
    )
    anticipated = sum(rated_cross_coupling(stage) for stage in stages) or None
    stations = _stations_of_coupling(layout, stages)
    loop = shaft_loop(layout_of(bare, layout), replace(point, seal_pressure=0.0), law, timing)
    notes: tuple[str, ...] = (_BARE_NOTE,) if machine.seals else ()
    if anticipated is None:
        notes = (*notes, "No [[stage]] in the machine file: Level I finds the border Q0 alone.")
    # critical speed ratio: maximum continuous speed over the first critical on rigid supports
    ratio = point.speed / rigid_support_critical(layout)
    try:
        return sweep(loop, stations, anticipated, near, ratio, density), "", notes
    except NumericalFailure as error:
        unused = (
            ""
            if density is None
            else f"; the gas density, {density:.4g} kg/m3, that screens it was of no use"
        )
        return None, f"{error}{unused}", notes


def layout_of(machine: Machine, layout: Layout) -> Layout:
    """The same stations on another machine with the same shaft and bearings."""
    return replace(layout, machine=machine)


def _stations_of_coupling(layout: Layout, stages: list[Stage]) -> list[int]:
    """Mid-span; or each overhung impeller where all impellers are overhung."""
    places = [journal.position for journal in layout.journals]
    overhung = [s for s in stages if not min(places) <= s.position <= max(places)]
    if stages and len(overhung) == len(stages):
        return sorted({layout.nearest(stage.position) for stage in overhung})
    return [span_middle(layout)]
