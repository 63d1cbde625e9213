"""The rows of the summary, in the order of a data sheet: unbalance response, clearances, stability,
capacity, then the standards for magnetic bearings clause by clause.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.capacity import (
    FLAG,
    UNBALANCE,
    AxisCapacity,
    CircuitChange,
    binding,
)
from ambrose.annexes.rotordynamics.critical_map import CriticalMap
from ambrose.annexes.rotordynamics.levels import OVERDAMPED, LevelOne
from ambrose.annexes.rotordynamics.loop import CONTROLLER, PhaseBudget, ShaftLoop
from ambrose.annexes.rotordynamics.placement import UnbalanceCase
from ambrose.annexes.rotordynamics.response import (
    Reach,
    Separation,
    UnbalanceResponse,
    criticals,
    separation,
)
from ambrose.annexes.rotordynamics.result import OWN, RECALLED, Item, ModeRow, Rub
from ambrose.judge.plants import judge_assumed
from ambrose.judge.unbalance import orbit
from ambrose.law.law import LawLike
from ambrose.law.loop import DEFAULT, STATE_RATE, Timing
from ambrose.machine.criteria import demand
from ambrose.machine.machine import Machine
from ambrose.model.effects.stations import IMPULSE, SURGE
from ambrose.model.static_load import residual_unbalance, sag_line

# Motion at everything that must not touch, and at the vibration probes.


@dataclass(frozen=True, slots=True)
class Reading:
    """The largest reading of the vibration probes: p-p [m], probe, case and speed [rad/s]."""

    peak_to_peak: float
    probe: str
    case: str
    speed: float


def largest_reading(response: UnbalanceResponse, lowest: float, highest: float) -> Reading:
    """A_max: over all probes and placements, between two speeds [rad/s].

    Without probes in the machine file the journals' major axes stand for them.
    """
    fine = response.fine
    speeds = np.union1d(fine[(fine > lowest) & (fine < highest)], [lowest, highest])
    best = Reading(0.0, "", "", highest)
    for k, case in enumerate(response.cases):
        curves = [(item.name, response.read(item, k, speeds)) for item in response.layout.readings]
        if not curves:
            curves = [
                (j.name, response.major_axis(response.layout.nearest(j.position), k, speeds))
                for j in response.layout.journals
            ]
        for name, amplitude in curves:
            top = int(np.argmax(amplitude))
            if 2 * amplitude[top] > best.peak_to_peak:
                best = Reading(float(2 * amplitude[top]), name, case.name, float(speeds[top]))
    return best


def rubs(response: UnbalanceResponse, scale: float) -> tuple[Rub, ...]:
    """Scaled major axis, peak to peak, at every clearance: worst placement and speed of each."""
    layout = response.layout
    offsets = np.abs(sag_line(layout.machine, tuple(gap.position for gap in layout.gaps)))
    found = []
    for gap, offset in zip(layout.gaps, offsets, strict=True):
        station = layout.nearest(gap.position)
        curves = [response.major_axis(station, k) for k in range(len(response.cases))]
        k = int(np.argmax([curve.max() for curve in curves]))
        top = int(np.argmax(curves[k]))
        found.append(
            Rub(
                gap.name,
                gap.kind,
                gap.position,
                gap.diametral,
                float(2 * scale * curves[k][top]),
                float(offset),
                gap.share * gap.diametral,
                float(response.fine[top]),
                response.cases[k].name,
            )
        )
    return tuple(found)


UM = 1e6  # um per m
# numbers as another program prints them (6.8.2) or recalled: to be checked in a bought copy
_RESPONSE = "6.8.2, unbalance response"
_CLEAR = "6.8.2, clearances"
_STABILITY = "6.8.5 and 6.8.6, stability"
_LEVEL_ONE, _LEVEL_TWO = "6.8.5, stability, Level I", "6.8.6, stability, Level II"
ONE_SIDED = " (half-power point on one side only: bandwidth taken as twice that side)"
_FOR = "unbalance for the "
_STILL = 1e-6  # of the least amplitude of a critical speed: a reading below is rounding
_SAME_SPEED = 0.03  # two probes' peaks nearer to each other than this are one critical speed


def unstable(where: str) -> Item:
    """The one row of a loop that does not hold."""
    return Item(
        "stability",
        "Loop stable at the running speeds and at trip",
        standard.EDITION,
        _STABILITY,
        OWN,
        None,
        "-",
        passed=False,
        note=f"{where}; the rest of the analysis has no meaning on an unstable loop: design a "
        "stabilising controller first",
    )


def undamped(found: CriticalMap) -> Iterator[Item]:
    """Where the bearings' stiffness meets the undamped critical speeds, for information."""
    words = []
    for support in found.supports:
        speeds = [
            f"{standard.rpm(crossing.speed)}"
            for crossing in found.crossings
            if crossing.support == support.name
        ]
        words.append(f"{support.name} at {', '.join(speeds)} rpm" if speeds else "")
    met = "; ".join(word for word in words if word) or "none up to trip"
    first = found.rigid[0] / standard.RPM
    yield Item(
        "undamped",
        "Undamped critical speeds at the stiffness of the bearings",
        standard.EDITION,
        "6.8.2, undamped critical speeds",
        RECALLED,
        None,
        "-",
        note=f"{met}; the first on rigid supports is {first:.5g} rpm",
    )


def unbalance(
    response: UnbalanceResponse,
    reading: Reading,
    speeds: tuple[float, float],
    scale: tuple[float, float],
) -> Iterator[Item]:
    """Critical speeds with their margins, vibration and scale factor; speeds: the running range."""
    lowest, highest = speeds
    limit = standard.vibration_limit(highest / standard.RPM)
    yield from criticals_of(response, lowest, highest)
    yield from _small(response, limit / UM, (lowest, highest))
    yield vibration(reading, lowest, highest)
    yield Item(
        "scale_factor",
        "Scale factor for the clearance check",
        standard.EDITION,
        _CLEAR,
        RECALLED,
        scale[0],
        "-",
        note=f"uncapped {scale[1]:.4g}; kept between 1 and {standard.LARGEST_SCALE:g}",
    )


def vibration(
    reading: Reading,
    lowest: float,
    highest: float,
    words: str = "",
    maximum: float | None = None,
) -> Item:
    """The largest reading between two speeds [rad/s]; words: added to the title; maximum: the
    maximum continuous speed [rad/s], where it is another than the second.
    """
    limit = standard.vibration_limit((maximum or highest) / standard.RPM)
    return Item(
        "vibration",
        f"Largest probe reading {speeds_in_words(lowest, highest)}{words}",
        standard.EDITION,
        _RESPONSE,
        RECALLED,
        UM * reading.peak_to_peak,
        "um p-p",
        "<=",
        limit,
        UM * reading.peak_to_peak <= limit,
        f'probe "{reading.probe}", {reading.case}, at {standard.rpm(reading.speed)} rpm; with '
        "twice the residual unbalance",
    )


def vibration_over_tolerances(reading: Reading, member: str, lowest: float, highest: float) -> Item:
    """The largest reading that a search over the tolerances found."""
    limit = standard.vibration_limit(highest / standard.RPM)
    return Item(
        "vibration.tolerances",
        "Largest probe reading found within the tolerances",
        "Ambrose",
        "search: both ends of each tolerance, then the steepest corner over the running range",
        OWN,
        UM * reading.peak_to_peak,
        "um p-p",
        "<=",
        limit,
        UM * reading.peak_to_peak <= limit,
        f'probe "{reading.probe}", {reading.case}, at {standard.rpm(reading.speed)} rpm: {member}; '
        "found, not proved",
    )


def unbalance_of_both(machine: Machine, cases: Sequence[UnbalanceCase], highest: float) -> str:
    """How the unbalance here compares with that of ``ambrose verify``, in words."""
    residual = residual_unbalance(machine)
    if residual is None:
        return ""
    # G = U W/m, here of all that a placement carries, with its doubling
    here = max(sum(w.amount for w in case.weights) for case in cases)
    grade = 1e3 * here * highest / residual.mass
    return (
        f"Unbalance here, all planes: up to {here / 1e-6:.4g} g mm, G{grade:.3g} at "
        f"{standard.rpm(highest)} rpm. Of ambrose verify: {residual.moment / 1e-6:.4g} g mm, "
        f"G{1e3 * residual.grade:.3g} at {standard.rpm(residual.speed)} rpm."
    )


def criticals_of(
    response: UnbalanceResponse, lowest: float, highest: float, words: str = ""
) -> Iterator[Item]:
    """Every critical speed with its margin from the running speeds [rad/s]; words: added to the
    title.
    """
    for k, (worst, probe, case) in enumerate(critical_speeds(response, lowest, highest), 1):
        peak = worst.critical
        rpm = peak.speed / standard.RPM
        most = "" if peak.known else "at most "
        factor = f"AF {most}{peak.factor:.3g}"
        if not peak.known:
            factor += " (the response falls to 0.707 of this peak on neither side)"
        elif not peak.both_flanks:
            factor += ONE_SIDED
        where = f'{factor}, probe "{probe}", {2 * UM * peak.amplitude:.3g} um p-p, {_FOR}{case}'
        critical = f"critical speed at {rpm:.5g} rpm{words}"
        if peak.damped:
            yield Item(
                f"critical_speed.{k}",
                f"C{critical[1:]}: critically damped",
                standard.EDITION,
                _RESPONSE,
                RECALLED,
                peak.factor,
                "AF",
                "<",
                standard.CRITICALLY_DAMPED,
                True,
                f"{where}; no separation margin is required",
            )
            continue
        yield Item(
            f"critical_speed.{k}",
            f"Separation margin of the {critical}",
            standard.EDITION,
            _RESPONSE,
            RECALLED,
            worst.margin,
            "%",
            ">=",
            worst.required,
            worst.passed,
            where,
        )


def reached(found: Reach, response: UnbalanceResponse, highest: float) -> Item:
    """Whether the response goes as far as a separation margin may be required."""
    last = min(found.end, found.asked)
    return Item(
        "response.range",
        f"Highest speed of the unbalance response ({len(response.speeds)} speeds, refined at the "
        "critical speeds)",
        standard.EDITION,
        _RESPONSE,
        OWN,
        last / standard.RPM,
        "rpm",
        ">=",
        standard.MARGIN_TO * highest / standard.RPM,
        not found.why,
        (f"not covered above {standard.rpm(last)} rpm: {found.why}; " if found.why else "")
        + f"{standard.MARGIN_TO:g} times the maximum continuous speed, above which no critical "
        "speed needs a margin",
    )


def _small(
    response: UnbalanceResponse, limit: float, running: tuple[float, float]
) -> Iterator[Item]:
    """All peaks too small to be judged in one row; limit: of vibration [m] peak to peak."""
    _, small = _peaks(response, *running)
    if not small:
        return
    speeds = ", ".join(f"{group[0][0].critical.speed / standard.RPM:.5g}" for group in small)
    largest = max(row[0].critical.amplitude for group in small for row in group)
    yield Item(
        "small_peaks",
        f"Response peaks below {100 * standard.SMALL_PEAK:g} % of the vibration limit",
        standard.EDITION,
        _RESPONSE,
        OWN,
        2 * UM * largest,
        "um p-p",
        note=f"at {speeds} rpm; the value is the largest of them. Amplification factor below "
        f"{standard.CRITICALLY_DAMPED:g} or not known; too small to count as critical speeds "
        f"(vibration limit {UM * limit:.3g} um p-p): not checked",
        left_out=True,
    )


def critical_speeds(
    response: UnbalanceResponse, lowest: float, highest: float
) -> list[tuple[Separation, str, str]]:
    """Every critical speed that a probe or a major axis sees, up to ``standard.MARGIN_TO`` times
    the highest speed: its tightest reading with the probe and the placement, by speed.

    Readings far below the largest one there do not count (``standard.MINOR_READING``); peaks below
    ``standard.SMALL_PEAK`` of the vibration limit are none, unless the shaft moves more elsewhere.
    """
    return [min(group, key=_tightness) for group in _peaks(response, lowest, highest)[0]]


_Group = list[tuple[Separation, str, str]]


def _peaks(
    response: UnbalanceResponse, lowest: float, highest: float
) -> tuple[list[_Group], list[_Group]]:
    """Readings of peaks that are one critical speed, by speed; and those of peaks too small, where
    no other reading has a larger one beside.
    """
    kept: _Group = []
    small: _Group = []
    least = standard.SMALL_PEAK * standard.vibration_limit(highest / standard.RPM) / UM / 2
    for k, case in enumerate(response.cases):
        for name, amplitude in _curves(response, k, least):
            for peak in criticals(response.fine, amplitude):
                if peak.speed > standard.MARGIN_TO * highest:
                    continue
                counts = peak.amplitude >= least or (
                    not peak.damped and response.prominence(peak.speed, peak.factor, k) >= least
                )
                row = separation(peak, lowest, highest), name, case.name
                (kept if counts else small).append(row)
    alone = [row for row in small if not any(_beside(row, other) for other in kept)]
    major = [
        row for row in kept if not any(_minor(row, other) for other in kept if _beside(row, other))
    ]
    return _grouped(major), _grouped(alone)


def _curves(response: UnbalanceResponse, case: int, least: float) -> list[tuple[str, np.ndarray]]:
    """Readings (v,) [m] of a placement; in the place of those that a block holds still, where
    rounding alone has peaks, the largest major axis of the whole shaft. least [m]: of a peak.
    """
    curves = response.curves(case)
    moved = [(name, curve) for name, curve in curves if curve.max() >= _STILL * least]
    if len(moved) < len(curves):
        xy = response.at(response.motion[..., case], response.fine)
        moved.append(("largest major axis of the shaft", orbit(xy[..., 0], xy[..., 1]).max(axis=1)))
    return moved


def _beside(one: tuple[Separation, str, str], other: tuple[Separation, str, str]) -> bool:
    """Whether two readings may be of one critical speed."""
    first, second = one[0].critical.speed, other[0].critical.speed
    return abs(first - second) <= _SAME_SPEED * max(first, second)


def _minor(one: tuple[Separation, str, str], other: tuple[Separation, str, str]) -> bool:
    """Whether a reading does not count beside another of the same critical speed."""
    small, large = one[0].critical, other[0].critical
    # beside a damped peak a sharp one may be another critical speed
    share = standard.MINOR_READING[1 if large.damped else 0]
    return small.amplitude < share * large.amplitude


def _grouped(rows: _Group) -> list[_Group]:
    """Readings by speed, those of one critical speed together: none is far from its row's."""
    groups: list[_Group] = []
    for row in sorted(rows, key=lambda row: row[0].critical.speed):
        if groups and _beside(groups[-1][0], row):
            groups[-1].append(row)
        else:
            groups.append([row])
    return groups


def _tightness(row: tuple[Separation, str, str]) -> tuple[bool, float]:
    """What a reading lacks or has to spare; then the critically damped ones, the sharpest first."""
    item, peak = row[0], row[0].critical
    return (True, -peak.factor) if peak.damped else (False, item.margin - item.required)


_CLEARANCES = {
    "touchdown": "the touchdown bearings",
    "seal": "the seals",
    "clearance": "the close clearances",
    "magnet": "the magnets",
}


def clearances(found: Sequence[Rub], words: str = "") -> Iterator[Item]:
    """The tightest clearance of each kind; words: added to the title."""
    for kind, plural in _CLEARANCES.items():
        of_kind = [rub for rub in found if rub.kind == kind]
        if not of_kind:
            continue
        worst = max(of_kind, key=lambda rub: rub.share / (rub.allowed / rub.diametral))
        yield Item(
            f"clearance.{kind}",
            f"Motion relative to diametral clearance, least margin of {plural}: {worst.name}"
            f"{words}",
            standard.EDITION,
            _CLEAR,
            RECALLED,
            100 * worst.share,
            "% of diametral, p-p",
            "<=",
            100 * worst.allowed / worst.diametral,
            all(rub.passed for rub in of_kind),
            f"{UM * worst.motion:.3g} um p-p scaled at {standard.rpm(worst.speed)} rpm, "
            f"static offset {UM * worst.offset:.3g} um, of {UM * worst.diametral:.4g} um; "
            f"{worst.case}",
        )
    if not found:
        yield Item(
            "clearance",
            "Clearances",
            standard.EDITION,
            _CLEAR,
            RECALLED,
            None,
            "-",
            passed=False,
            note="not done: the machine file has no [[clearance]], no seal with a clearance and "
            "no touchdown_gap; add [[clearance]]",
        )


def level_one_beyond(one: LevelOne) -> str:
    """Of a sweep that met no border: how far it went, and what is left of the damping there."""
    times = "" if one.anticipated is None else f" = {standard.SWEEP:g} Q_A"
    left = one.least_at_end
    decrement = "" if left >= OVERDAMPED else f"; least log decrement there {left:.3g}"
    return (
        f"no mode loses its damping up to {one.end:.4g} N/m{times}, where the sweep ends{decrement}"
    )


def level_one(one: LevelOne | None, density: float | None = None, why: str = "") -> Iterator[Item]:
    """Log decrement at Q_A, border, screening with a mean gas density [kg/m^3]; why: it was not
    done.
    """
    if one is None:
        yield Item(
            "level_one",
            "Level I",
            standard.EDITION,
            _LEVEL_ONE,
            RECALLED,
            None,
            "-",
            passed=False,
            note=f"not done: {why}",
        )
        return
    where = "the overhung impellers" if len(one.stations) > 1 else "one station"
    rings = "" if math.isnan(one.least) else f": mode at {standard.rpm(one.least)} rpm"
    crossing = (
        ""
        if math.isnan(one.crossing)
        else f"; unstable beyond: mode at {standard.rpm(one.crossing)} rpm"
    )
    met = math.isfinite(one.border)
    swept = f"({len(one.cross_coupling)} values{', refined' if met else ''})"
    if one.anticipated is None:
        yield Item(
            "level_one.border",
            f"Level I: cross-coupling at the stability threshold, Q0 {swept}",
            standard.EDITION,
            _LEVEL_ONE,
            RECALLED,
            one.border if met else one.end,
            "N/m",
            ">=",
            note="not checked: no anticipated value, the machine file has no [[stage]]"
            + (crossing if met else f"; {level_one_beyond(one)}"),
            bound="" if met else ">",
            left_out=True,
        )
        yield from _screening(one, density)
        return
    yield Item(
        "level_one.log_decrement",
        "Level I: log decrement at the anticipated cross-coupling Q_A",
        standard.EDITION,
        _LEVEL_ONE,
        RECALLED,
        one.at_anticipated,
        "-",
        ">=",
        standard.LEAST_LOG_DECREMENT,
        one.at_anticipated >= standard.LEAST_LOG_DECREMENT,
        f"Q_A {one.anticipated:.4g} N/m at {where}; least of all oscillatory forward modes{rings}",
    )
    ratio = (one.border if met else one.end) / one.anticipated
    reasons = one.screening.reasons if one.screening is not None else ()
    yield Item(
        "level_one.border",
        f"Level I: threshold cross-coupling relative to the anticipated one, Q0/Q_A {swept}",
        standard.EDITION,
        _LEVEL_ONE,
        RECALLED,
        ratio,
        "-",
        ">=",
        standard.SCREEN_NEAR,
        ratio >= standard.SCREEN_NEAR,
        (f"Q0 {one.border:.4g} N/m{crossing}; " if met else f"{level_one_beyond(one)}; ")
        + (
            "Level I is sufficient"
            if not reasons
            else "Level II is required: " + "; ".join(reasons)
        ),
        bound="" if met else ">",
    )
    yield from _screening(one, density)


def _screening(one: LevelOne, density: float | None) -> Iterator[Item]:
    """Critical speed ratio beside the border of region B at the gas density, for information."""
    if one.speed_ratio is None:
        return
    used = f"it counts where {standard.SCREEN_NEAR:g} <= Q0/Q_A < {standard.SCREEN_FAR:g}"
    if density is None:
        title = "Level I: critical speed ratio, mean gas density not given"
        note = f"region B is assumed; {used}; give the density with --density"
    else:
        border = standard.border_speed_ratio(density)
        region = "B" if one.speed_ratio > border else "A"
        title = f"Level I: critical speed ratio, mean gas density {density:.4g} kg/m3"
        note = f"region {region}: region B lies above {border:.4g} at this density; {used}"
    yield Item(
        "level_one.speed_ratio",
        title,
        standard.EDITION,
        _LEVEL_ONE,
        RECALLED,
        one.speed_ratio,
        "-",
        note=f"{note}; maximum continuous speed divided by the first critical speed on rigid "
        "supports",
    )


def level_two(table: Sequence[ModeRow], highest: float, controlled: bool) -> Iterator[Item]:
    """The least log decrement of the modes up to the running speed, and over the tolerances;
    controlled: whether a controller is among what acts.
    """
    counted = [row for row in table if row.mode.frequency <= highest]
    if not counted:
        yield Item(
            "level_two.log_decrement",
            "Level II: log decrement",
            standard.EDITION,
            _LEVEL_TWO,
            RECALLED,
            None,
            "-",
            passed=True,
            note="no oscillatory lateral mode up to the running speed",
        )
        yield from _beyond(table, highest)
        return
    worst = min(counted, key=lambda row: row.mode.log_decrement)
    value = worst.mode.log_decrement
    yield Item(
        "level_two.log_decrement",
        "Level II: least log decrement of the modes up to the running speed",
        standard.EDITION,
        _LEVEL_TWO,
        RECALLED,
        value,
        "-",
        ">=",
        standard.LEAST_LOG_DECREMENT,
        value >= standard.LEAST_LOG_DECREMENT,
        f"mode at {standard.rpm(worst.mode.frequency)} rpm; with seals, stages and "
        + ("the controller" if controlled else "journal bearings"),
    )
    known = [row for row in counted if row.least is not None]
    if known:
        least = min(known, key=lambda row: row.least or 0.0)
        value = float(least.least or 0.0)
        yield Item(
            "level_two.log_decrement.tolerances",
            "Level II: least log decrement found within the tolerances",
            "Ambrose",
            "search: both ends of each tolerance, then the steepest corner",
            OWN,
            value,
            "-",
            ">=",
            standard.LEAST_LOG_DECREMENT,
            value >= standard.LEAST_LOG_DECREMENT,
            f"mode at {standard.rpm(least.mode.frequency)} rpm: {least.member}; found, not proved",
        )
    yield from _beyond(table, highest)


def _beyond(table: Sequence[ModeRow], highest: float) -> Iterator[Item]:
    """The least log decrement of the modes listed above the running speed, for information."""
    above = [row.mode for row in table if row.mode.frequency > highest]
    if not above:
        return
    worst = min(above, key=lambda mode: mode.log_decrement)
    yield Item(
        "level_two.log_decrement.beyond",
        "Level II: least log decrement of the modes listed above the running speed",
        standard.EDITION,
        _LEVEL_TWO,
        OWN,
        worst.log_decrement,
        "-",
        note=f"mode at {standard.rpm(worst.frequency)} rpm ({worst.frequency / (2 * np.pi):.4g} "
        "Hz), for information: the limit is for modes up to the running speed",
    )


def as_it_runs(
    loops: Sequence[ShaftLoop], law: LawLike | None, timing: Timing | None
) -> Iterator[Item]:
    """That no rate is known, where none is: then every row is of the continuous law. It fails
    where the loop would be unstable at one of these speeds at the rate that others assume.
    """
    if law is None or not loops:
        return
    found = [(loop, judge_assumed(loop.plant, law, timing)) for loop in loops]
    known = [(stability.abscissa, loop) for loop, stability in found if stability is not None]
    if not known:
        return
    abscissa, loop = max(known, key=lambda row: row[0])
    would = "stable"
    if abscissa >= 0:
        rpm = loop.point.speed / standard.RPM
        would = f"unstable (at {rpm:.5g} rpm a pole with real part {abscissa:+.4g} 1/s)"
    yield Item(
        "controller.rate",
        "Sample rate and computing delay of the controller",
        "Ambrose",
        "controller as it runs",
        OWN,
        None,
        "-",
        passed=False if abscissa >= 0 else None,
        note="not stated: every row takes the controller as continuous, without sampling, hold and "
        f"delay. At {DEFAULT.rate:g} Hz and one sample late, as virtual rig and export assume, the "
        f"loop would be {would}; {STATE_RATE}",
    )


def speeds_in_words(lowest: float, highest: float) -> str:
    """The running speeds [rad/s] in rpm."""
    first, last = (f"{standard.rpm(speed)}" for speed in (lowest, highest))
    return f"at {first} rpm" if first == last else f"from {first} to {last} rpm"


def capacity(found: Sequence[AxisCapacity]) -> Iterator[Item]:
    """Unbalance, every load of the file on top of it, and all that lasts: the axis with the least
    margin of each.
    """
    if not found:
        return
    kinds = (
        ("unbalance", UNBALANCE, "Load capacity divided by the demand of unbalance"),
        ("impulse", IMPULSE, "Load capacity divided by the demand of an impulse and unbalance"),
        ("surge", SURGE, "Load capacity divided by the demand of a surge and unbalance"),
    )
    for name, kind, title in kinds:
        rows = [(margin, axis) for axis in found if (margin := axis.least(kind)) is not None]
        worst = min(rows, key=lambda row: row[0].value, default=None)
        yield Item(
            f"capacity.{name}",
            title,
            standard.EDITION,
            "annex E, load capacity",
            OWN,
            None if worst is None else worst[0].value,
            "-",
            ">=",
            None if worst is None else 1.0,
            None if worst is None else worst[0].value >= 1.0,
            f"not covered: no [[load]] of kind {name} in the machine file"
            if worst is None
            else f"bearing {worst[1].bearing}, axis {worst[1].axis}: {binding(worst[0])}",
            left_out=worst is None,
        )
    held = max(found, key=lambda axis: abs(axis.limits.static) / axis.limits.bias)
    parts = ", ".join(f"{name} {force:.4g} N" for name, force in held.static)
    limits = held.limits
    yield Item(
        "capacity.static",
        "Static control current divided by the smaller of bias and maximum current",
        standard.EDITION,
        "annex E, load capacity",
        OWN,
        abs(limits.static) / min(limits.bias, limits.largest or limits.bias),
        "-",
        "<=",
        1.0,
        abs(limits.static) <= min(limits.bias, limits.largest or limits.bias),
        f"axis {held.axis}: {parts}",
    )


def phase(budgets: Sequence[PhaseBudget]) -> Iterator[Item]:
    """What the signal chain takes at the lowest bending mode, on the axis where it takes most."""
    if not budgets:
        return
    worst = min(budgets, key=lambda budget: float(budget.cost[0]))
    shares = sorted(
        (float(row[0]), name)
        for name, row in zip(worst.elements, worst.phases, strict=True)
        if name != CONTROLLER
    )
    words = ", ".join(f"{name} {np.degrees(value):.3g}" for value, name in shares)
    yield Item(
        "phase.first_bending",
        f"Phase of the signal chain without the controller at the first bending mode, "
        f"{worst.frequencies[0] / (2 * np.pi):.4g} Hz",
        "Ambrose",
        "signal chain",
        OWN,
        float(np.degrees(worst.cost[0])),
        "deg",
        note=f"axis {worst.axes[0]}: {words}",
    )


def circuit(found: CircuitChange | None) -> Iterator[Item]:
    """What the amplifier as a circuit would change of a mode's damping, for information."""
    if found is None:
        return
    source = "stated" if found.stated else "of a coil without leakage"
    more = (
        '; set order = "current-loop" in [amplifier], with the coil\'s resistance'
        if abs(found.change) > FLAG
        else ""
    )
    yield Item(
        "circuit.damping",
        f"Change in damping with the amplifier modelled as a circuit, mode at "
        f"{standard.rpm(found.frequency)} rpm",
        "Ambrose",
        "electronics",
        OWN,
        100 * found.change,
        "%",
        note=f"damping ratio {found.before:.3g} without back-EMF, {found.after:.3g} with it; "
        f"L {1e3 * found.inductance:.3g} mH {source}, L/R 30 ms assumed{more}",
    )


def iso_vibration(
    machine: Machine, found: Sequence[Rub], scale: float, speeds: tuple[float, float]
) -> Iterator[Item]:
    """ISO 14839-2: the orbit at a magnetic bearing and its static offset, divided by the clearance;
    speeds [rad/s]: the first and the last of the response.
    """
    rows = [rub for rub in found if rub.kind == "touchdown"]
    if not rows:
        return
    # (scaled p-p/scale/2 + offset)/(diametral/2)
    shares = [(rub.motion / scale + 2 * rub.offset) / rub.diametral for rub in rows]
    k = int(np.argmax(shares))
    limit = demand("orbit over clearance", machine.requirements).limit
    yield Item(
        "iso.vibration",
        "Orbit 0-p with static offset relative to touchdown clearance, " + speeds_in_words(*speeds),
        standard.ISO_2,
        "zone A",
        RECALLED,
        shares[k],
        "-",
        "<=",
        limit,
        None if limit is None else shares[k] <= limit,
        f"{rows[k].name}, {rows[k].case}, with twice the residual unbalance",
    )


_ELSEWHERE = (
    ("ISO 14839-4:2012", "limit of di/dt of laminated bearings", "see load capacity, voltage"),
    ("ISO 14839-4:2012", "places of bearings and sensors", "see the drawing of the rotor"),
)
_UNCOVERED = (
    ("ISO 14839-1:2018", "terms", "not covered: words only"),
    ("ISO 14839-4:2012", "monitoring and alarms", "not covered: monitoring on site"),
    ("ISO 14839-4:2012", "balancing", "not covered here: see ambrose balance"),
    ("ISO 14839-5:2022", "touchdown bearings", "not covered here: see ambrose landing"),
    (
        standard.EDITION,
        "annex E, auxiliary bearing landing analysis",
        "not covered here: see ambrose landing",
    ),
    (standard.EDITION, "6.8.7, torsional analysis", "not covered: lateral motion only"),
    (standard.EDITION, "6.8.3, verification by test", "not covered: a test"),
)


def not_covered(machine: Machine) -> Iterator[Item]:
    """Clauses that a reviewer looks for and will not find here."""
    for edition, clause, note in (*_ELSEWHERE, *_UNCOVERED):
        title = clause.rpartition(", ")[2]
        if machine.bearings or ("ISO" not in edition and "annex E" not in clause):
            yield Item(
                f"not_covered.{title.replace(' ', '_').replace('/', '_per_')}",
                title[0].upper() + title[1:],
                edition,
                clause,
                RECALLED,
                None,
                "-",
                note=note,
                left_out=(edition, clause, note) in _UNCOVERED,
            )
