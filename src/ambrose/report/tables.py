"""What several pages share: checks, findings and machine data as tables, verdicts and sentences."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from ambrose.identification.findings import ERROR, Finding
from ambrose.judge.checks import (
    CONTINUOUS,
    OVER_TOLERANCES,
    THRUST,
    Check,
    Checks,
    Verification,
    box_label,
)
from ambrose.law.loop import timing_in_words
from ambrose.machine.attachment import attached
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine, tolerance_in_words
from ambrose.machine.parameters import chosen
from ambrose.machine.part import Part
from ambrose.machine.validation.parts import unit_and_names
from ambrose.report import theme
from ambrose.report.page import Cell, Row, Section, Table, Verdict, numbers

_WIDEST = 6  # operating points side by side in one table
RELATION = {"<=": "≤", ">=": "≥", "<": "<", ">": ">"}
# title and detail of a check on pages and screens, where the data keep others
_PLAIN = {
    "timing.assumed": (
        "Growth of the loop sampled at 10 kHz, one sample of delay",
        "No file states the sample rate; this one is assumed. Set sample_time, or use --rate-hz.",
    )
}
# limits that are checked only where the machine file states them
_GUARDS = (
    "compliance_peak",
    "unbalance_orbit",
    "settling_time",
    "gain_margin",
    "phase_margin",
    "log_decrement",
    "damping_above",
    "max_current",
    "control_gain",
    "running_speeds",
)
_VIOLATED = {"<=": ">", ">=": "<", "<": "≥", ">": "≤"}


def verdict(checks: Checks) -> Verdict:
    """The verdict in plain words: "stable, 14 of 16 checks passed; fails: output sensitivity 4.1 >
    3 (at 41 Hz)".

    Of an unstable loop it names the rightmost pole; one that is lost within the tolerances, or at
    another speed, is not called stable.
    """
    judged = [check for check in checks.checks if check.passed is not None]
    failed = [check for check in judged if not check.passed]
    if not checks.stable:
        why = ", ".join(place(check) or reason(check) for check in failed)
        return Verdict(
            checks.label, False, f"UNSTABLE{': ' if why else ''}{why}; nothing else was evaluated"
        )
    if not judged:
        return Verdict(checks.label, True, "stable; no limits were given to check against")
    counted = (
        f"all {len(judged)}" if not failed else f"{len(judged) - len(failed)} of {len(judged)}"
    )
    why = "; fails: " + ", ".join(reason(check) for check in failed) if failed else ""
    words = "stable" if checks.holds else "stable in the middle, UNSTABLE elsewhere"
    return Verdict(checks.label, checks.passed, f"{words}, {counted} checks passed{why}")


def reason(check: Check) -> str:
    """Why a check fails, as a clause: "output sensitivity 4.1 > 3 at 41 Hz"."""
    detail = place(check)
    where = (
        ""
        if not detail or len(detail) > 60
        else f" {detail}"
        if detail.startswith("at ")
        else f" ({detail})"
    )
    title = theme.prose(
        check.title if check.title[:2].isupper() else check.title[:1].lower() + check.title[1:]
    )
    if check.limit is None:
        return f"{title} {theme.quantity(check.value, _unit(check))}{where}"
    value, limit = theme.pair(check.value, check.limit, _unit(check))
    return f"{title} {value} {_VIOLATED.get(check.relation, '≠')} {limit}{where}"


def place(check: Check) -> str:
    """Where a check has its value: the first clause of its detail."""
    return theme.prose(check.detail.split(";")[0].strip().rstrip("."))


def around(box: Checks) -> str:
    """Which box it is: "around nominal pressure"."""
    return box.label.removeprefix(OVER_TOLERANCES).strip()


def listed(words: Sequence[str]) -> str:
    """ "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _unit(check: Check) -> str:
    """The unit a check is shown from; the real part of a pole is a decay in 1/s, not a frequency in
    Hz.
    """
    # nothing but a growth is held below zero
    growth = "abscissa" in check.name or check.limit == 0
    return "1/s" if check.unit == "rad/s" and growth else check.unit


def _value_and_limit(check: Check, *, level: bool = True) -> tuple[str, str]:
    if check.limit is None:
        value, limit = theme.quantity(check.value, _unit(check)), ""
    else:
        value, limit = theme.pair(check.value, check.limit, _unit(check))
        limit = f"{RELATION.get(check.relation, check.relation)} {limit}"
    ratio = check.unit in {"", "-", "1"} and any(
        word in check.name for word in ("sensitivity", "gain_margin")
    )
    decibel = theme.decibel(check.value) if ratio and level else ""
    return value + (f" ({decibel})" if decibel else ""), limit


def checks_table(checks: Checks) -> Table:
    """Every check at one operating point: value, limit, verdict, zone, standard and clause,
    detail.
    """
    rows: list[Row] = []
    for check in checks.checks:
        value, limit = _value_and_limit(check)
        title, detail = theme.prose(check.title), theme.prose(check.detail)
        marks = {
            None: Cell("information", "muted"),
            True: Cell("pass", "pass"),
            False: Cell("fail", "fail"),
        }
        words = marks[check.passed]
        rows.append((title, *numbers(value, limit), words, check.zone or "", check.source, detail))
    columns = ("Quantity", "Value", "Limit", "Verdict", "Zone", "Standard, clause", "Where or why")
    return Table(
        checks.label, columns, tuple(rows), " ".join(checks.notes), (23, 11, 10, 9, 4, 16, 27)
    )


def findings_table(findings: Sequence[Finding]) -> Table:
    """Everything that makes the result doubtful."""
    rows = [
        (
            Cell(theme.prose(finding.what), "fail" if finding.severity == ERROR else "none"),
            theme.prose(finding.evidence),
            theme.prose(finding.remedy),
        )
        for finding in findings
    ]
    return Table("Findings", ("What", "Evidence", "What to do"), tuple(rows))


def doubtful(findings: Sequence[Finding]) -> tuple[Section, ...]:
    """The section that begins the page of a measured result: its findings; none without any."""
    if not findings:
        return ()
    return (Section("What makes this doubtful", "", (), (findings_table(findings),)),)


def without_findings(label: str, findings: Sequence[Any], good: str, *, see: str = "; ") -> Verdict:
    """Passed without findings, in the words ``good``; else their number."""
    count = len(findings)
    words = f"{count} finding{'s' * (count > 1)}{see}see below"
    return Verdict(label, not count, words if count else good)


def believed(found: str, findings: Sequence[Finding]) -> Verdict:
    """The verdict on a measured result: what was found, or the first finding with its remedy."""
    if not findings:
        return Verdict("Result", True, f"{found}. No fault found in the records.")
    more = f" ({len(findings) - 1} more below)" if len(findings) > 1 else ""
    return Verdict("Result", False, f"Doubtful: {theme.prose(str(findings[0]))}{more}")


def loop_in_words(timing: str) -> str:
    """Rate and delay of the loop that was checked; of a continuous one how to check another."""
    words = timing_in_words(timing)
    return f"{words}. Use --rate-hz for the sampled loop" if timing == CONTINUOUS else words


_FEW = 3  # tolerances that the head of a page names


def unchecked(result: Verification) -> list[str]:
    """What a verification does not cover, a sentence for each kind."""
    sentences = [
        f"Not checked: the {axis}. Give its controller (--axial), or narrow with --axes radial."
        for axis in result.not_judged
    ]
    if result.left_out:
        names = "; ".join(result.left_out)
        sentences.append(f"Not covered by the controller's schedule, which does not pass: {names}.")
    sentences += still(result.not_varied)
    if result.rotor:
        sentences.append(f"{capitalised((result.rotor,))} No other speed is judged.")
    if result.over_speed:
        sentences.append(f"Above the machine's top speed: {'; '.join(result.over_speed)}.")
    return sentences


def still(not_varied: Sequence[str]) -> list[str]:
    """The tolerances that have no effect, counted by operating point and reason, as
    ``model.uncertainty.not_varied`` words them; another reason in full.
    """
    sentences, left = [], list(not_varied)
    for ending, why in (
        ("(zero here)", "coefficient is zero"),
        (" only)", "stated for other points"),
    ):
        ended = [words for words in left if words.endswith(ending)]
        left = [words for words in left if not words.endswith(ending)]
        counts = Counter(words.partition(": ")[0] for words in ended)
        if counts:
            where = ", ".join(f"{count} at {label}" for label, count in counts.items())
            sentences.append(f"Tolerances without effect ({why}): {where}.")
    return [*sentences, *(f"Not varied around {words}." for words in left)]


def tolerances_in_head(machine: Machine) -> tuple[str, str]:
    """For the head of a page: the first tolerances, and how many more there are."""
    widths = [tolerance_in_words(item) for item in machine.tolerances]
    more = f" and {len(widths) - _FEW} more" if len(widths) > _FEW else ""
    return "Tolerances", ", ".join(widths[:_FEW]) + more


def unstated(machine: Machine) -> tuple[str, str]:
    """For the head of a page: the limits and guards that the machine file does not state."""
    names = [name for name in _GUARDS if getattr(machine.requirements, name) is None]
    names += ["gravity_direction"] if machine.gravity_direction is None else []
    return "Not in the machine file", ", ".join(names).replace("_", " ")


def assumed_table(machine: Machine) -> tuple[Table, ...]:
    """What the machine file marks as chosen; nothing where it marks nothing. A reason for a value
    that the file no longer states is named beneath.
    """
    stand, gone = chosen(machine), []
    gone = [name for name, reason in machine.assumed if (name, reason) not in stand]
    if not machine.assumed:
        return ()
    note = f"Reasons for what the file no longer states: {', '.join(gone)}." if gone else ""
    return (Table("Chosen, not measured", ("Parameter", "Reason"), stand, note),)


def capitalised(notes: Sequence[str], joint: str = " ", end: str = ".") -> str:
    """Notes as sentences: each begins with a capital."""
    return joint.join(f"{note[:1].upper()}{note[1:]}{end}" for note in notes)


def overview_tables(verifications: Sequence[Checks]) -> tuple[Table, ...]:
    """One row per check that has a limit somewhere, one column per operating point: the
    verification at a glance.

    Many operating points are cut into several tables, so that each fits on paper.
    """
    every = [check for checks in verifications for check in checks.checks]
    judged = [check for check in every if check.passed is not None]
    # of all checks where none has a limit
    names = list(dict.fromkeys(check.name for check in judged or every))
    starts = range(0, len(verifications), _WIDEST)
    parts = [verifications[i : i + _WIDEST] for i in starts]
    return tuple(
        _overview_table(part, names, i + 1 if len(parts) > 1 else 0) for i, part in enumerate(parts)
    )


def _overview_table(verifications: Sequence[Checks], names: Sequence[str], part: int) -> Table:
    stable = (
        Cell("stable", "pass") if checks.holds else Cell("unstable", "fail")
        for checks in verifications
    )
    rows: list[tuple[str | Cell, ...]] = [("Stability", Cell("", "number"), *stable)]
    for name in names:
        matches = [
            next((check for check in checks.checks if check.name == name), None)
            for checks in verifications
        ]
        first = next((check for check in matches if check is not None), None)
        limits = {_value_and_limit(check)[1] for check in matches if check is not None}
        if first is None:
            continue
        cells = (_overview_cell(check, with_limit=len(limits) > 1) for check in matches)
        rows.append(
            (
                theme.prose(first.title),
                Cell(limits.pop() if len(limits) == 1 else "", "number"),
                *cells,
            )
        )
    columns = ("Quantity", "Limit", *(checks.label for checks in verifications))
    note = "✓ pass, ✗ fail, – no limit. Quantities without any limit are in the detailed tables."
    rest = 60 // max(len(verifications), 3)
    widths = (100 - 12 - rest * len(verifications), 12, *(rest for _ in verifications))
    return Table(
        "All operating points" + (f", part {part}" if part else ""),
        columns,
        tuple(rows),
        note,
        widths,
    )


def _overview_cell(check: Check | None, *, with_limit: bool) -> Cell:
    if check is None:
        return Cell("not evaluated", "muted")
    value, limit = _value_and_limit(check, level=False)
    words = [
        value + (f" ({limit})" if with_limit and limit else ""),
        *([f"zone\u00a0{check.zone}"] if check.zone else []),
    ]
    return Cell(
        " · ".join(words), "none" if check.passed is None else "pass" if check.passed else "fail"
    )


# The table that decides: a row for each operating point or range, a column for each requirement.


# title, and the check that it shows; where several begin so, the one nearest to its limit
_DECISIVE = (
    ("S, worst axis, zone", "sensitivity.output."),
    ("σmax(S)", "sensitivity.output.max"),
    ("unbalance", "unbalance.orbit_0p"),
    ("current", "unbalance.current_0p"),
    ("settling", "impulse.settling"),
)
_FURTHEST = "furthest beyond its limit"
_OVER_BOX = ("sampled.sensitivity.box", "robust.sensitivity.worst")
_LIMIT_OF = {"range.sensitivity": "sensitivity.output.max"}


def tightest(verification: Verification) -> tuple[str, Check] | None:
    """The label and the check that decides: of those that fail the furthest beyond its limit, else
    the nearest to it. None without any limit; loops that are unstable have no number.
    """
    judged = [
        (label, check)
        for label, checks in verification.labelled
        for check in checks.checks
        if check.passed is not None and check not in checks.lost
    ]
    failed = [item for item in judged if not item[1].passed]
    finite = [item for item in failed or judged if math.isfinite(item[1].value)]
    return max(finite, key=lambda item: item[1].ratio or 0.0, default=None)


def deciding_table(verification: Verification) -> Table:
    """Stability, sensitivity with its zone, unbalance response, current, settling and the worst
    over the tolerances; the first row is the limits. The cell that is nearest to its limit has a
    star; columns that would be empty are left out.
    """
    boxes = {box.label: box for box in verification.boxes}
    nearest = tightest(verification)
    others = (*verification.ranges, *verification.moving, *verification.synchronous)
    lines: list[tuple[str, Checks, list[Check | None]]] = []
    for checks in (*verification.points, *others):
        found = [_decisive(checks, name) for _, name in _DECISIVE]
        box = boxes.get(box_label(checks.label))
        found.append(None if box is None else _over_box(box))
        lines.append((checks.label, checks, found))
    titles = [*(title for title, _ in _DECISIVE), "S over tolerances"]
    used = [k for k in range(len(titles)) if any(found[k] is not None for _, _, found in lines)]
    heads = ("operating point", "stable", *(titles[k] for k in used))
    limits = {
        k: {_limit(check) for _, _, found in lines if (check := found[k]) is not None} for k in used
    }
    common = {k: len(limits[k]) == 1 for k in used}
    shared = (Cell(next(iter(limits[k])) if common[k] else "", "number") for k in used)
    limit_row: Row = (Cell("limit", "number"), Cell("", "number"), *shared)
    rows = [limit_row] if used else []
    for label, checks, found in lines:
        box = boxes.get(box_label(label))
        lost = bool(checks.lost) or not checks.stable
        stable = Cell("no", "fail") if lost else Cell("yes", "pass")
        cells = [_decisive_cell(found[k], nearest, with_limit=not common[k]) for k in used]
        if box is not None and box.lost:
            cells[-1] = Cell("unstable", "fail")
        rows.append((Cell(label, "none" if checks.passed else "fail"), stable, *cells))
    starred = nearest is not None and any(nearest[1] in found for _, _, found in lines)
    what = "tightest requirement" if nearest is not None and nearest[1].passed else _FURTHEST
    return Table("", heads, tuple(rows), f"* {what}" if starred else "")


def _decisive(checks: Checks, name: str) -> Check | None:
    """The check of that name, or of those that begin so the worst; None where there is none."""
    if not name.endswith("."):
        here = [c for c in checks.checks if _LIMIT_OF.get(c.name, c.name) == name]
    else:
        here = [c for c in checks.checks if c.name.startswith(name) and not c.name.endswith(".max")]
    return max(here, key=lambda check: check.value, default=None)


def _over_box(box: Checks) -> Check | None:
    """The worst sensitivity over the tolerances: the check of it that has a limit."""
    here = [check for check in box.checks if check.name in _OVER_BOX]
    return next((check for check in here if check.passed is not None), here[0] if here else None)


def _limit(check: Check) -> str:
    return _value_and_limit(check)[1]


def _decisive_cell(
    check: Check | None, nearest: tuple[str, Check] | None, *, with_limit: bool
) -> Cell:
    if check is None:
        return Cell("–", "muted")
    value, limit = _value_and_limit(check, level=False)
    kind = "none" if check.passed is None else "pass" if check.passed else "fail"
    words = [value, *([check.zone] if check.zone else [])]
    words += [f"({limit})"] if with_limit and limit else []
    star = " *" if nearest is not None and check is nearest[1] else ""
    return Cell(" ".join(words) + star, kind)


def failing_table(verification: Verification) -> Table:
    """Every requirement that is not met: where, which, value, limit and what was found; one row for
    what is found alike at several points, with the worst value.
    """
    alike: dict[tuple[str, ...], list[tuple[str, Check]]] = {}
    for label, checks in verification.labelled:
        for check in checks.failed:
            key = (check.name, check.title, check.detail)
            alike.setdefault(key, []).append((_short(label), check))
    rows: list[Row] = []
    for found in alike.values():
        check = max((check for _, check in found), key=lambda check: check.ratio or check.value)
        at = found[0][0] if len(found) == 1 else f"{len(found)} operating points"
        title, detail = _PLAIN.get(check.name, (check.title, check.detail))
        where = (theme.prose(title), *_value_and_limit(check, level=False), theme.prose(detail))
        rows.append((at, *where))
    columns = ("at", "requirement", "value", "limit", "found")
    return Table("Not met", columns, tuple(rows), "", (15, 29, 9, 9, 38))


def _short(label: str) -> str:
    return (
        f"tolerances, {label.removeprefix(OVER_TOLERANCES).removeprefix(' around ')}"
        if (label.startswith(OVER_TOLERANCES))
        else label
    )


def deciding_verdict(verification: Verification) -> str:
    """The verdict on a controller, then the number that decides."""
    judged = [
        check
        for _, checks in verification.labelled
        for check in checks.checks
        if check.passed is not None
    ]
    failed = [check for check in judged if not check.passed]
    thrust = sum(checks.label.startswith(THRUST) for checks in verification.points)
    points = len(verification.points) - thrust
    along = sum(around(box).startswith(f"around {THRUST}") for box in verification.boxes)
    boxes = len(verification.boxes) - along
    alone = {"radial": "radial axes, ", "thrust": "thrust axis, "}
    scope = alone[verification.axes[0]] if len(verification.axes) == 1 else ""
    if thrust:
        own = f", tolerances at {along} of them" if along else ""
        scope += f"radial axes and thrust axis ({thrust} states{own}), "
    scope += f"{points} operating point{'s' * (points != 1)}"
    scope += f", {verification.between}" if verification.between else ""
    scope += f", tolerances at {boxes} of them" if boxes else ""
    ranges = len(verification.ranges)
    scope += f", {ranges} range{'s' * (ranges > 1)}" if ranges else ""
    loop = "continuous loop"
    if verification.timing != CONTINUOUS:
        loop = timing_in_words(verification.timing).partition(",")[0] + " loop"
        loop = loop.replace("sampled at ", "sampled ")
    if verification.passed:
        words = f"PASSED: {scope}, {loop}."
    elif failed:
        unstable = [_short(label) for label, checks in verification.labelled if not checks.holds]
        if len(unstable) == points > 1 and not boxes and not thrust:
            unstable = [f"all {points} operating points"]
        words = (
            f"FAILED: {len(failed)} of {len(judged)} requirements are not met ({scope}, {loop})."
        )
        words += f" Unstable: {'; '.join(unstable)}." if unstable else ""
    elif verification.not_judged:
        words = f"FAILED: the {verification.not_judged[0]} has no controller ({scope}, {loop})."
    else:
        words = f"FAILED: the controller does not cover all operating points ({scope}, {loop})."
    if (nearest := tightest(verification)) is None:
        return words
    label, check = nearest
    value, limit = _value_and_limit(check, level=False)
    title = _PLAIN.get(check.name, (check.title,))[0]
    title = theme.prose(title[:1].lower() + title[1:])
    which = "Tightest requirement" if check.passed else _FURTHEST.capitalize()
    return f"{words} {which}: {title} {value} (limit {limit.split(' ', 1)[-1]}), {_short(label)}."


def operating_points_table(points: Sequence[OperatingPoint]) -> Table:
    """Speed, seal pressure and bias current of the operating points."""
    rows: list[Row] = []
    for point in points:
        speed = (
            f"{theme.number(point.speed * theme.RPM, 5)} rpm "
            f"({theme.quantity(point.speed, 'rad/s')})"
        )
        bias = (
            "machine's" if point.bias_current is None else theme.quantity(point.bias_current, "A")
        )
        rows.append((point.label, *numbers(speed, theme.quantity(point.seal_pressure, "Pa"), bias)))
    columns = ("Operating point", "Speed", "Seal pressure difference", "Bias current")
    return Table("Operating points", columns, tuple(rows))


def stations_table(machine: Machine) -> Table:
    """What acts on the rotor, where, and how strongly, from left to right."""
    rows: list[tuple[float, str, str]] = []
    for bearing in machine.bearings:
        words = [
            f"bias {theme.quantity(bearing.bias_current, 'A')}",
            f"ζ at {theme.quantity(bearing.angle, 'rad')}",
        ]
        words += _pair_of("kᵢ", bearing.force_per_current, "N/A") + _pair_of(
            "kₛ", bearing.negative_stiffness, "N/m"
        )
        limits = [("gap", bearing.gap, "m"), ("touchdown gap", bearing.touchdown_gap, "m")]
        limits += [
            ("largest control current", bearing.max_current, "A"),
            ("largest force", bearing.max_force, "N"),
        ]
        words += [
            f"{name} {theme.quantity(value, unit)}"
            for name, value, unit in limits
            if value is not None
        ]
        rows.append((bearing.position, f"bearing {bearing.name}", ", ".join(words)))
    for sensor in machine.sensors:
        lag = (
            "no lag"
            if sensor.bandwidth is None
            else f"bandwidth {theme.quantity(sensor.bandwidth, 'rad/s')}"
        )
        words = [*_pair_of("gain", sensor.gain, ""), lag]
        words += [] if sensor.angle is None else [f"at {theme.quantity(sensor.angle, 'rad')}"]
        words += [] if sensor.weight == 1 else [f"weight {theme.number(sensor.weight)}"]
        rows.append((sensor.position, f"sensor {sensor.bearing}", ", ".join(words)))
    for seal in machine.seals:
        values = (
            (c, getattr(seal, c), u)
            for c, u in (("K", "N/m"), ("k", "N/m"), ("C", "N s/m"), ("c", "N s/m"), ("M", "kg"))
        )
        words = [f"{name} {theme.quantity(value, unit)}" for name, value, unit in values if value]
        words += (
            []
            if seal.reference_pressure is None
            else [f"at {theme.quantity(seal.reference_pressure, 'Pa')}"]
        )
        words += [] if seal.table is None else ["coefficients from a table"]
        words += [] if seal.geometry is None else ["coefficients from its geometry"]
        words += (
            []
            if seal.frequency_dependence == "synchronous"
            else [f"frequency dependence with {seal.poles} poles"]
        )
        rows.append(
            (seal.position, _titled("seal", seal.name), ", ".join(words) or "no coefficients")
        )
    for effect, part in attached(machine):
        title = _titled(effect.table.replace("_", " "), part.name)
        words = _figures_of(part)
        rows += [(station.position, title, ", ".join(words)) for station in effect.stations(part)]
    for support in machine.supports:
        place = next(
            bearing.position for bearing in machine.bearings if bearing.name == support.bearing
        )
        pairs = (
            ("mass", support.mass, "kg"),
            ("stiffness", support.stiffness, "N/m"),
            ("damping", support.damping, "N s/m"),
        )
        words = [
            f"{name} {' and '.join(theme.quantity(v, u) for v in dict.fromkeys(pair))}"
            for name, pair, u in pairs
        ]
        words += [f"with seal {name}" for name in support.seals] + ["sensors on the ground"] * (
            support.sensor == "ground"
        )
        rows.append((place, f"support {support.bearing}", ", ".join(words)))
    for disc in machine.discs:
        inertias = (("polar", disc.polar_inertia), ("diametral", disc.diametral_inertia))
        words = [
            f"{name} inertia {theme.quantity(value, 'kg m2')}" for name, value in inertias if value
        ]
        rows.append(
            (
                disc.position,
                theme.axis_name(disc.name),
                ", ".join([f"mass {theme.quantity(disc.mass, 'kg')}", *words]),
            )
        )
    cells = tuple(
        (what, Cell(theme.number(x * 1e3, 4), "number"), text) for x, what, text in sorted(rows)
    )
    return Table("Stations", ("Station", "Position [mm]", "Data"), cells)


def _titled(kind: str, name: str) -> str:
    return name if name.lower() == kind else f"{kind} {theme.axis_name(name)}"


def _figures_of(part: Part) -> list[str]:
    """The numbers of a registered effect's part that are not at their default, in words; of a list
    or a table how many there are.
    """
    words = []
    for key in part.to_dict():
        value: Any = getattr(part, key, None)
        if not isinstance(value, float | tuple):
            continue
        name = key.replace("_", " ")
        unit, names = unit_and_names(type(part), key)  # type: ignore[arg-type]  # a class is hashable
        numbers: Any = value
        pair = isinstance(value, tuple) and len(value) == 2
        if pair and all(isinstance(number, float) for number in numbers):
            words += _pair_of(name, numbers, unit, names)
        elif isinstance(value, float) and key not in {"position", "angle"}:
            words.append(f"{name} {theme.quantity(value, unit)}")
        elif isinstance(value, tuple):
            words.append(f"{name} at {len(value)} points")
    return words


def _pair_of(
    name: str, values: tuple[float, float] | None, unit: str, names: Sequence[str] = ()
) -> list[str]:
    """A pair, ζ and η unless it has other names, in words, as one number where both are equal."""
    if values is None:
        return []
    if math.isclose(*values, rel_tol=1e-12):
        return [f"{name} {theme.quantity(values[0], unit)}"]
    first, second = ("ζ", "η") if len(names) != 2 or names[0] == "zeta" else names
    one, other = (theme.quantity(value, unit) for value in values)
    return [f"{name} {one} ({first}), {other} ({second})"]
