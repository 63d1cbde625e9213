"""``ambrose.lateral``: the lateral analysis of a rotor with its bearings, seals and controller."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.rotordynamics import items as rows, standard
from ambrose.annexes.rotordynamics.capacity import (
    binding,
    capacities,
    circuit_change,
    unbalance_demands,
    unbalance_limits,
)
from ambrose.annexes.rotordynamics.critical_map import critical_map
from ambrose.annexes.rotordynamics.items import largest_reading, rubs
from ambrose.annexes.rotordynamics.levels import LevelOne, shares, sweep
from ambrose.annexes.rotordynamics.loop import ShaftLoop, free_bending, phase_budgets, shaft_loop
from ambrose.annexes.rotordynamics.placement import (
    ShaftMode,
    UnbalanceCase,
    place,
    place_rigid,
    shaft_modes,
    span_middle,
)
from ambrose.annexes.rotordynamics.response import (
    Solve,
    UnbalanceResponse,
    reach,
    respond,
    without_block,
)
from ambrose.annexes.rotordynamics.result import OWN, Control, Item, Lateral, ModeRow
from ambrose.annexes.rotordynamics.stations import Layout, lay_out, rigid_support_critical
from ambrose.chain.check import clearance_doubts
from ambrose.core.checks import InvalidInput, NumericalFailure, invalid, names_wrong_types
from ambrose.judge.checks import Check, Checks
from ambrose.judge.nominal import check_sensitivity
from ambrose.judge.plants import Progress, judge_stability
from ambrose.judge.result import Synthesis
from ambrose.judge.unbalance import orbit, together
from ambrose.law.law import Law, LawLike, extension, law_of
from ambrose.law.loop import Timing, running_law, timing_of
from ambrose.machine.criteria import SENSITIVITY, SENSITIVITY_RANGE
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import write_json
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.effect import speed_knots
from ambrose.model.effects.stations import JournalBearing, Stage, rated_cross_coupling
from ambrose.model.plant import at_bearings, holds_only
from ambrose.model.static_load import magnet_coefficients, running_range
from ambrose.model.uncertainty import perturbed
from ambrose.report.page import page_of, write

# Stability and sensitivity at every operating point of the machine file: what is cheap enough to
# judge everywhere, as ``ambrose.verify`` judges it. Of each the worst point is a row.


REST = (
    "Checked at every operating point of the machine file: stability and sensitivity, without "
    "tolerances. ambrose verify checks the rest there: orbits, currents, forces, voltages and "
    "margins, and all of it over the tolerances."
)


@dataclass(frozen=True, slots=True)
class Points:
    """The checks of each operating point, and the labels of those that the law does not cover."""

    judged: tuple[Checks, ...]
    uncovered: tuple[str, ...] = ()


def judge_sensitivity(
    machine: Machine, loop: ShaftLoop, controller: LawLike, timing: Timing | None
) -> Points:
    """All operating points that the law covers; loop: at the one of the analysis, which counts even
    where it is none of the machine file's.
    """
    law = law_of(controller)
    points, analysed = list(machine.operation.envelope), loop.plant.point
    if analysed not in [replace(point, label=analysed.label) for point in points]:
        points.append(analysed)
    judged: list[Checks] = []
    uncovered: list[str] = []
    for point in points:
        plant = assemble(machine, point)
        if law.covers(plant):
            judged.append(check_sensitivity(plant, running_law(law, plant, timing)))
        else:
            uncovered.append(point.label or f"{standard.rpm(point.speed)} rpm")
    return Points(tuple(judged), tuple(uncovered))


def point_rows(points: Points, machine: Machine) -> Iterator[Item]:
    """Stability and sensitivity, the worst operating point of each."""
    judged = points.judged
    if points.uncovered:
        labels = ", ".join(points.uncovered)
        yield Item(
            "points.covered",
            "Operating points that the controller does not cover",
            "Ambrose",
            "stability of the loop as it runs",
            OWN,
            float(len(points.uncovered)),
            "-",
            "<=",
            0.0,
            False,
            f"not checked at {labels}: outside the range of the controller's schedule",
        )
    if not judged:
        return
    several = f"worst of {len(judged)} operating points: " if len(judged) > 1 else "at "

    def row(
        name: str,
        title: str,
        of: tuple[str, ...],
        edition: str,
        clause: str,
        basis: str = OWN,
        largest_limit: float = math.inf,
        remark: str = "",
    ) -> Iterator[Item]:
        # the worst of the checks named ``of`` over all points; its limit, or that of the standard
        # where that is less
        candidates = [
            (item, checks.label) for checks in judged for item in checks.checks if item.name in of
        ]
        if not candidates:
            return
        worst, where = max(candidates, key=lambda pair: _severity(pair[0]))
        limit = worst.limit if worst.limit is None else min(worst.limit, largest_limit)
        if limit is None and math.isfinite(largest_limit):
            limit = largest_limit
        axis = worst.name.rpartition(".")[2]
        place = f"axis {axis}, " if axis in machine.axes else ""
        yield Item(
            name,
            f"{title}, {several}{where}",
            edition,
            clause,
            basis,
            worst.value,
            "1/s" if worst.unit == "rad/s" else worst.unit,
            worst.relation,
            limit,
            None if limit is None else _meets(worst.value, worst.relation, limit),
            f"{place}{worst.detail}{_others(candidates, where)}{remark}",
        )

    axes = tuple(f"sensitivity.output.{axis}" for axis in machine.axes)
    zone = SENSITIVITY.limits[0].value
    upto = SENSITIVITY_RANGE.limits[0].value / (2 * np.pi)
    lost = [checks.label for checks in judged if not checks.stable]
    unstable = f"; none at {', '.join(lost)}, where the loop is unstable" if lost else ""
    yield from row(
        "points.stability",
        "Largest real part of the poles",
        ("stability.abscissa",),
        "Ambrose",
        "stability of the loop as it runs",
    )
    yield from row(
        "iso.sensitivity",
        "Peak sensitivity of a control axis",
        axes,
        standard.ISO_3,
        "zone A, or the machine file's sensitivity_peak where that is less",
        "checked",
        zone,
        f"; up to {upto:.4g} Hz or three times the speed{unstable}",
    )
    yield from row(
        "points.sensitivity_max",
        "Peak sensitivity, maximum singular value",
        ("sensitivity.output.max",),
        "Machine file",
        "sensitivity_peak, for all axes together",
        remark=unstable,
    )


def _severity(check: Check) -> float:
    """The larger the worse; what is not known is the worst."""
    if math.isnan(check.value):
        return math.inf
    return -check.value if check.relation.startswith(">") else check.value


def _meets(value: float, relation: str, limit: float) -> bool:
    if relation == "<":
        return value < limit
    return value >= limit if relation == ">=" else value <= limit


def _others(checks: list[tuple[Check, str]], worst: str) -> str:
    """The worst value at every operating point but ``worst``, in words; checks with their points'
    labels.
    """
    at_point: dict[str, Check] = {}
    for check, label in checks:
        if label not in at_point or _severity(check) > _severity(at_point[label]):
            at_point[label] = check
    words = [f"{label} {check.value:.4g}" for label, check in at_point.items() if label != worst]
    return f"; at the others {', '.join(words)}" if words else ""


# The least log decrement of each mode over the tolerances, found by a search: every tolerance at
# both its ends, then the corner to which all of them pull together.
#
# A search finds a member, it proves nothing about the others.


def least_decrements(loop: ShaftLoop, table: tuple[ModeRow, ...]) -> tuple[ModeRow, ...]:
    """The rows with the least log decrement found and the member that has it."""
    names = [tolerance.parameter for tolerance in loop.plant.machine.tolerances]
    members = [{name: side} for name in names for side in (-1.0, 1.0)]
    best = [(row.mode.log_decrement, "nominal") for row in table]
    slopes = np.zeros((len(table), len(names)))  # log decrement at the upper less at the lower end
    for k, member in enumerate(members):
        moved = _moved(loop, member)
        if moved is None:
            continue
        for j, row in enumerate(table):
            value = _decrement(moved, row)
            if value is None:
                continue
            (name,) = member
            slopes[j, k // 2] += value * member[name]
            if value < best[j][0]:
                best[j] = (value, f"{name} {member[name]:+g}")
    for j, row in enumerate(table):
        corner = {
            name: float(-np.sign(slope))
            for name, slope in zip(names, slopes[j], strict=True)
            if slope
        }
        moved = _moved(loop, corner) if corner else None
        value = None if moved is None else _decrement(moved, row)
        if value is not None and value < best[j][0]:
            words = ", ".join(f"{name} {side:+g}" for name, side in corner.items())
            best[j] = (value, words)
    return tuple(
        replace(row, least=float(value), member=words)
        for row, (value, words) in zip(table, best, strict=True)
    )


_OVER_RANGE = 25  # speeds at which the corner's response is computed


def largest_over_tolerances(
    loop_at: Callable[[float], ShaftLoop],
    response: UnbalanceResponse,
    nominal: rows.Reading,
    speeds: tuple[float, float],
) -> tuple[rows.Reading, str]:
    """The largest reading found over the tolerances, of the probe and placement of the nominal one,
    and the member that has it: both ends of each tolerance at its speed, then the corner to which
    all of them pull at speeds over the running range [rad/s].
    """
    layout, stations = response.layout, len(response.layout.positions)
    case = next(item for item in response.cases if item.name == nominal.case)
    forces = case.forces(stations)
    # a rotor without probes is read at its journals, along the major axis
    places: dict[str, tuple[float, float | None]] = {}
    if not layout.readings:
        places = {j.name: (j.position, None) for j in layout.journals}
    places |= {item.name: (item.position, item.direction) for item in layout.readings}
    position, direction = places[nominal.probe]
    station = layout.nearest(position)
    best = nominal, "nominal"

    def read(speed: float, member: dict[str, float]) -> float | None:
        moved = _moved(loop_at(speed), member)
        if moved is None:
            return None
        states, _ = without_block(moved, forces * speed**2)
        x, y = moved.read[2 * station : 2 * station + 2] @ states
        if direction is None:
            return float(2 * orbit(x, y))
        return float(2 * abs(x * np.cos(direction) + y * np.sin(direction)))

    def note(speed: float, member: dict[str, float]) -> float | None:
        nonlocal best
        value = read(speed, member)
        if value is not None and value > best[0].peak_to_peak:
            words = ", ".join(f"{name} {side:+g}" for name, side in member.items())
            best = replace(nominal, peak_to_peak=value, speed=speed), words
        return value

    corner: dict[str, float] = {}
    for tolerance in response.layout.machine.tolerances:
        name = tolerance.parameter
        low, high = (note(nominal.speed, {name: side}) for side in (-1.0, 1.0))
        if low is not None and high is not None and low != high:
            corner[name] = float(np.sign(high - low))
    for speed in np.union1d(np.linspace(*speeds, _OVER_RANGE), nominal.speed) if corner else ():
        note(float(speed), corner)
    return best


def _moved(loop: ShaftLoop, member: dict[str, float]) -> ShaftLoop | None:
    """The loop with parameters moved within their tolerances; None where one does not hold around
    this point.
    """
    try:
        plant = perturbed(loop.plant, member)
    except InvalidInput:
        return None
    system = plant.system
    if system.n_states != len(loop.A):
        return None
    u = [system.inputs.index(name) for name in plant.named("u")]
    y = [system.outputs.index(name) for name in plant.named("y")]
    return replace(loop, plant=plant, A=system.A, B=system.B[:, u], C=system.C[y])


def _decrement(loop: ShaftLoop, row: ModeRow) -> float | None:
    """The log decrement -2 pi Re s/|Im s| of the pole s that a mode has moved to; None where it is
    lost, or no longer rings.
    """
    try:
        pole, _ = loop.mode_near(row.mode.pole, row.mode.states)
    except NumericalFailure:
        return None
    if not pole.imag:
        return None
    return float(-2 * np.pi * pole.real / abs(pole.imag))


# The machine with its synchronous blocks on: the unbalance response with each block converged, and
# what ``ambrose verify`` says of the block.
#
# The block adds c to the error, u = -K (y - c), and once it has converged c = D z, or z = 0 where
# it does not leak. With the states under the forces and c, both linear,
#
#     x = T(s)^-1 (f + B (I + K D_p)^-1 K c),    z = z_f + Z c,
#     c = -Z^-1 z_f,    of a block that leaks    c = (I - D Z)^-1 D z_f.
#
# A block at another multiple of the speed leaves the response to unbalance as it is.


def with_blocks(
    machine: Machine,
    law: Law,
    sampled: tuple[float | None, int | None],
    off: UnbalanceResponse,
    loop_at: Callable[[float], ShaftLoop],
    speeds: tuple[float, float, float],
    scale: float,
    through: Sequence[float],
    progress: Callable[[str], None],
) -> Iterator[Item]:
    """Rows of every block of the controller's file, else of the machine's, on; none without one.

    sampled: rate [Hz] and delay [samples] as stated; off: the response without blocks; speeds
    [rad/s]: running range and trip; scale: of the clearances; through: see ``respond``.
    """
    if not (blocks := law.blocks_on(machine)):
        return
    try:
        items = extension("loops")(machine, law, blocks, *sampled)
    except InvalidInput as error:
        yield _undone("synchronous", f"synchronous blocks: {error}")
        return
    for k, item in enumerate(items, 1):
        name = f"synchronous.{k}"
        words = f", {item.label} on"
        progress(f"unbalance response with the {item.label}")
        block_rows = [*_unbalance(item, off, loop_at, speeds, scale, through, words)]
        try:
            block_rows += _judged(item, words, progress)
        except InvalidInput as error:
            block_rows.append(_undone("stability", f"{item.label}: {error}"))
        yield from (replace(row, name=f"{name}.{row.name}") for row in block_rows)


def _undone(name: str, why: str) -> Item:
    return Item(
        name,
        "Machine with its synchronous blocks on",
        "Ambrose",
        "synchronous block",
        OWN,
        None,
        "-",
        passed=False,
        note=f"not judged, {why}",
    )


def _judged(item: Any, words: str, progress: Callable[[str], None]) -> Iterator[Item]:
    """What verify says of the block: convergence, gain, sensitivity with it on."""
    checks = extension("check")(item, progress)
    if not checks.stable:
        yield _undone("stability", f"{item.label}: {' '.join(checks.notes)}")
    for check in checks.checks:
        yield Item(
            check.name.removeprefix("synchronous."),
            f"{check.title}{words}",
            "Ambrose",
            "synchronous block, as ambrose verify judges it",
            OWN,
            check.value,
            check.unit,
            check.relation or "<=",
            check.limit,
            check.passed,
            check.detail,
        )


def _unbalance(
    item: Any,
    off: UnbalanceResponse,
    loop_at: Callable[[float], ShaftLoop],
    speeds: tuple[float, float, float],
    scale: float,
    through: Sequence[float],
    words: str,
) -> Iterator[Item]:
    """Critical speeds, vibration, clearances and capacity within the block's band; words: behind
    every title. The rest as of ``with_blocks``.
    """
    lowest, highest, trip = speeds
    low = max(item.block.band[0], float(off.speeds[0]))
    high = min(item.block.band[1], float(off.speeds[-1]))
    if item.loop.harmonic != 1 or low >= high:
        return
    response = respond(
        off.layout, loop_at, off.cases, low, high, through=(*through, trip), solve=_solve(item)
    )
    yield from rows.criticals_of(response, lowest, highest, words)
    if low <= highest and high >= lowest:
        ends = max(low, lowest), min(high, highest)
        reading = largest_reading(response, *ends)
        yield rows.vibration(reading, *ends, words, highest)
    if low < trip:
        below = response.upto(trip)
        yield from rows.clearances(rubs(below, scale), words)
        yield _capacity(loop_at(highest), below, words)


def _capacity(loop: ShaftLoop, response: UnbalanceResponse, words: str) -> Item:
    """The least margin of unbalance of all axes."""
    axes = loop.plant.machine.axes
    worst, axis = min(
        (
            (together(limits, demand, ())[0], axes[a])
            for a, limits in enumerate(unbalance_limits(loop))
            for demand in unbalance_demands(loop, response, a, "at the end of the band")
        ),
        key=lambda row: row[0].value,
    )
    asked = worst.value < np.inf
    return Item(
        "capacity.unbalance",
        f"Load capacity divided by the demand of unbalance{words}",
        standard.EDITION,
        "annex E, load capacity",
        OWN,
        worst.value if asked else None,
        "-",
        ">=",
        1.0 if asked else None,
        worst.value >= 1.0,
        f"axis {axis}: {binding(worst)}" if asked else "the block leaves no current to carry",
    )


def _solve(item: Any) -> Solve:
    """States and currents with the block converged."""

    def solve(loop: ShaftLoop, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = 1j * loop.point.speed
        K = loop.gain(s)
        inner = np.linalg.solve(np.eye(len(K)) + K @ loop.D, K)
        x_f = loop.states(s, forces)
        x_c = np.linalg.solve(loop.matrix(s), loop.B @ inner)
        # u = -(I + K D)^-1 K (C x - c),   y = C x + D u,   i
        u_f, u_c = -inner @ loop.C @ x_f, -inner @ (loop.C @ x_c - np.eye(len(K)))
        i_f, i_c = loop.coil(x_f, u_f), loop.coil(x_c, u_c)
        z_f, Z = loop.C @ x_f + loop.D @ u_f, loop.C @ x_c + loop.D @ u_c
        if item.mode == "current-free":
            Z = Z - np.eye(len(K))
        elif item.mode == "force-free":
            machine = loop.plant.machine
            k_i, k_s = magnet_coefficients(machine, loop.point)
            z_f, Z = (
                at_bearings(machine) @ y + (k_i / k_s)[:, None] * i
                for y, i in ((z_f, i_f), (Z, i_c))
            )
        if item.gain is None:
            c = np.linalg.solve(Z, -z_f)
        else:
            D = item.gain(loop.point.speed)
            c = np.linalg.solve(np.eye(len(D)) - D @ Z, D @ z_f)
        i = i_f + i_c @ c
        return x_f + x_c @ c, np.where(np.abs(i) <= item.vanished * np.abs(i_f), 0.0, i)

    return solve


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
    machine.across_the_shaft("a lateral analysis is of the motion across it")
    if only := holds_only(machine):
        raise InvalidInput(
            f"a lateral analysis needs the rotor at every speed, but {only}; describe shaft and "
            "discs, or use ambrose verify"
        )
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

    at_top = loop_at(chosen.speed)
    # notes on what was assumed, before those of the results
    early = tuple(text[0].upper() + text[1:] + "." for text in clearance_doubts(machine))
    if stated is None and not _covers(loop_at, trip):
        early = (
            *early,
            f"The machine file does not cover {standard.rpm(trip)} rpm, 1.05 times the "
            "running speed; without a stated trip speed the analysis ends at the running speed.",
        )
        trip = highest
    _reaches(loop_at, trip)
    name = "none" if law is None else law.named
    slowest = _slowest(machine, trip)
    progress("undamped critical speeds")
    undamped = critical_map(layout, at_top, loop_at, law, (slowest, trip))
    bare = Lateral(
        machine=machine,
        controller=name,
        timing=_timing_in_words(law, timing),
        point=chosen.label or f"{chosen.speed:.4g} rad/s",
        speeds=(lowest, highest, trip),
        layout=layout,
        critical_map=undamped,
        density=density,
        control=None if law is None else _control(at_top),
    )
    progress("how far the response goes")
    knots = speed_knots(machine, slowest, math.inf)
    # far: the last speed of the response, the speeds that it must pass, where it is unstable
    far = reach(loop_at, slowest, (lowest, highest), trip, knots)
    unstable = _unstable_at(at_top, loop_at, law, timing, (lowest, highest, trip))
    bare = replace(bare, along=far.along)
    if unstable is None and far.unstable is not None:
        unstable = _pole_in_words(*far.unstable)
    progress("modes")
    # near [rad/s]: up to here modes are judged and excite placements of unbalance
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
    widest: tuple[Item, ...] = ()
    if tolerances and machine.tolerances:
        progress("unbalance response over the tolerances")
        found_reading, member = largest_over_tolerances(loop_at, whole, reading, (lowest, highest))
        widest = (rows.vibration_over_tolerances(found_reading, member, lowest, highest),)
    limit = standard.vibration_limit(highest / standard.RPM)
    # scale: S_cc = A_vl/A_max of the clearance check within its bounds, and as it is
    largest = 1e6 * reading.peak_to_peak  # [um]
    uncapped = limit / largest if largest else math.inf
    scale = (max(1.0, min(standard.LARGEST_SCALE, uncapped)), uncapped)
    at_clearances = rubs(response, scale[0])
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
        everywhere = tuple(point_rows(judge_sensitivity(machine, at_top, law, timing), machine))
        notes = (*notes, REST)
    items = (
        *rows.undamped(undamped),
        rows.reached(far, whole, highest),
        *rows.unbalance(whole, reading, (lowest, highest), scale),
        *widest,
        *rows.clearances(at_clearances),
        *rows.level_one(one, density, why),
        *rows.level_two(table, highest, law is not None),
        *rows.as_it_runs([loop_at(w) for w in sorted({lowest, highest, trip})], law, timing),
        *rows.capacity(capacity),
        *rows.phase(budgets),
        *rows.circuit(circuit_change(machine, chosen, law, timing, modes)),
        *everywhere,
        *rows.iso_vibration(machine, at_clearances, scale[0], (slowest, trip)),
        *blocks_on,
        *rows.not_covered(machine),
    )
    if words := rows.unbalance_of_both(machine, cases, highest):
        notes = (*notes, words)
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
        rubs=at_clearances,
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


def _control(loop: ShaftLoop) -> Control:
    """The controller as it runs at an operating point, up to 0.45 of its sample rate."""
    law = loop.law
    states, dt = (0, None) if law is None else (law.n_states, law.dt)
    hertz = np.outer([1.0, 10.0, 100.0, 1000.0], [1.0, 2.0, 5.0]).ravel()
    omega = 2 * np.pi * (hertz if dt is None else hertz[hertz * dt <= 0.45])
    gain = np.array([np.diag(loop.gain(1j * w)) for w in omega])
    return Control(loop.plant.axes, states, dt, omega, gain)


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
            f"the operating point {chosen.label or 'given'} is at standstill, but a lateral "
            "analysis needs a turning rotor; add an [[operation.point]] at maximum continuous "
            "speed, name one, or give a rotor model its --speed"
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
    tables = [part.speed for part in machine.parts(JournalBearing)]
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
            abscissa = float(loop.all_modes().poles.real.max())
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
    stages = machine.parts(Stage)
    bare = replace(
        machine,
        seals=(),
        tolerances=(),
        effects=tuple(part for part in machine.effects if part not in stages),
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


def _stations_of_coupling(layout: Layout, stages: Sequence[Stage]) -> list[int]:
    """Mid-span; or each overhung impeller where all impellers are overhung."""
    places = [journal.position for journal in layout.journals]
    overhung = [s for s in stages if not min(places) <= s.position <= max(places)]
    if stages and len(overhung) == len(stages):
        return sorted({layout.nearest(stage.position) for stage in overhung})
    return [span_middle(layout)]


# What a study leaves of the lateral analysis: ``lateral.html`` and ``lateral.json``.


def write_lateral(
    machine: Machine, synthesis: Synthesis, directory: Path, progress: Progress
) -> None:
    """The analysis of a machine under the study's best controller; nothing where it never turns.

    Raises InvalidInput where it cannot be done or written, NumericalFailure as ``lateral`` does.
    """
    if not any(point.speed > 0 for point in machine.operation.envelope):
        return
    progress("lateral analysis")
    result = lateral(machine, synthesis)
    write_json(directory / "lateral.json", dict(result.to_dict()), "lateral analysis")
    write(page_of(result), directory / "lateral.html")
