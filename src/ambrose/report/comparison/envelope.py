"""The decision about several controllers, and the map behind it: per controller and operating point
the requirement that comes nearest to its limit, or exceeds it most.

A share is the ratio of a value to its limit (``Check.ratio``): up to 1 the requirement is met. A
second row of every operating point holds the worst over the tolerances around it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ambrose.judge.checks import Check, Checks
from ambrose.judge.verification import box_label
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.report import units
from ambrose.report.page import Cell, Row, Section, Table, Verdict
from ambrose.report.tables import around, listed
from ambrose.rig.candidate import Candidate, find

NOT_EVALUATED = "not evaluated"
_MEETS, _FAILS = (0.6, 0.8, 1.0), (1.1, 1.5, 2.0)  # upper ends of the shades
# panels of speed over pressure are drawn where this share of all pairs are operating points
_GRID = 0.75
# The first entry that the check's name begins with says what binds; "robust." and "sampled." are
# cut off first.
_SHORT = {
    "sensitivity.output": "output sensitivity",
    "sensitivity.input": "input sensitivity",
    "sensitivity": "output sensitivity",
    "compliance": "compliance",
    "poles.log_decrement": "log decrement",
    "margin.gain": "gain margin",
    "margin.phase": "phase margin",
    "unbalance.clearance": "orbit in the gap",
    "unbalance.current_0p": "unbalance current",
    "unbalance.force_0p": "unbalance force",
    "unbalance": "unbalance orbit",
    "impulse.settling": "settling",
    "impulse.current_0p": "pulse current",
    "impulse.force_0p": "pulse force",
    "stability.margin": "stability margin",
    "stability.speeds": "at other speeds",
    "stability": "stability",
}


@dataclass(frozen=True, slots=True)
class Share:
    """check: what binds, the one that exceeds its limit most or comes nearest to it; None without
    any that has a limit.

    stable: whether the loop is, over the whole box where it is one.
    """

    check: Check | None
    stable: bool = True

    @property
    def ratio(self) -> float:
        """Of the value to its limit; infinite for an unstable loop, 0 without a limit."""
        ratio = None if self.check is None else self.check.ratio
        return math.inf if not self.stable else ratio or 0.0

    @property
    def passed(self) -> bool:
        """Whether the loop is stable and meets every limit."""
        return self.stable and (self.check is None or self.check.passed is not False)


def share(checks: Checks) -> Share:
    """What binds in these checks, at an operating point or over the tolerances around it."""
    judged = [check for check in checks.checks if check.passed is not None]
    worst = max(judged, key=lambda check: (not check.passed, check.ratio or 0.0), default=None)
    if not checks.stable or checks.lost:
        margin = find(checks, "robust.stability.margin")
        named = margin if margin in checks.lost else next(iter(checks.lost), None)
        return Share(named, False)
    return Share(worst if worst is not None and (worst.ratio or not worst.passed) else None)


def binding(check: Check) -> str:
    """What binds, in two words: "output sensitivity"."""
    name = check.name.removeprefix("robust.").removeprefix("sampled.")
    return next(
        (words for start, words in _SHORT.items() if name.startswith(start)),
        units.prose(check.title),
    )


def ratio_text(ratio: float) -> str:
    """Two decimals, and as many as it takes to tell it from 1."""
    if not math.isfinite(ratio):
        return units.number(ratio)
    text = f"{ratio:.2f}" if ratio < 10 else units.number(ratio)
    return units.pair(ratio, 1.0, "")[0] if text == "1.00" and ratio != 1.0 else text


def nearest(candidates: Sequence[Candidate]) -> Candidate:
    """The controller that meets everything with most to spare, or comes nearest to it."""
    labels = _labels(candidates)
    return min(candidates, key=lambda candidate: _distance(candidate, labels))


def _labels(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    return tuple(
        dict.fromkeys(checks.label for candidate in candidates for checks in candidate.checks)
    )


def decision(candidates: Sequence[Candidate]) -> Verdict:
    """One sentence: which controller meets everything, or which comes nearest, and what binds
    it.
    """
    labels, best = _labels(candidates), nearest(candidates)
    good = [
        candidate for candidate in candidates if candidate.passed and not _absent(candidate, labels)
    ]
    where, worst = _worst(best)
    if best in good:
        box = ", and over the tolerances around them," if best.boxes else ""
        box += (
            f" between them (found on grids of {listed([c.label for c in best.ranges])}),"
            if best.ranges
            else ""
        )
        count = (
            f"all {len(best.checks)} operating points"
            if len(best.checks) > 1
            else "the operating point"
        )
        margin = (
            f"; nearest to its limit: {_amount(worst)} {where}"
            if worst.check is not None
            else "; no limits were given"
        )
        others = [_quoted(candidate.name) for candidate in good if candidate is not best]
        also = f"; also by {listed(others)}" if others else ""
        return Verdict(
            "",
            True,
            f"Every requirement is met at {count}{box} by {_quoted(best.name)}{margin}{also}.",
        )
    lost = [checks.label for checks in best.checks if not checks.stable]
    if lost:
        why = f"it is unstable at {listed(lost)}"
    elif absent := _absent(best, labels):
        why = f"it is {NOT_EVALUATED} at {listed(absent)}"
        why += ", which its schedule does not cover" if set(absent) <= set(best.left_out) else ""
    elif not worst.stable:
        why = f"it becomes unstable {where}"
    else:
        why = f"{_amount(worst)} {where}"
    return Verdict(
        "",
        False,
        f"No controller meets every requirement; nearest comes {_quoted(best.name)}: {why}.",
    )


def _quoted(name: str) -> str:
    """A name that would read as two of a list, "mu, polished", in quotes."""
    return f'"{name}"' if "," in name or " and " in name else name


def _absent(candidate: Candidate, labels: Sequence[str]) -> list[str]:
    """The operating points at which it was not evaluated."""
    return [
        label
        for label in dict.fromkeys((*labels, *candidate.left_out))
        if candidate.at(label) is None
    ]


def _distance(candidate: Candidate, labels: Sequence[str]) -> tuple[int, int, float]:
    """How far a controller is from meeting everything: points not held, boxes not held, the worst
    ratio.
    """
    points, boxes = (
        [share(checks) for checks in part]
        for part in (candidate.checks, (*candidate.boxes, *candidate.ranges))
    )
    missing = len(_absent(candidate, labels)) + sum(not own.stable for own in points)
    return missing, sum(not own.stable for own in boxes), _worst(candidate)[1].ratio


def _worst(candidate: Candidate) -> tuple[str, Share]:
    """Where and what binds of everything that was evaluated; an operating point goes before the box
    around it.
    """
    known = [(f"at {checks.label}", share(checks)) for checks in candidate.checks]
    known += [(f"over the tolerances {around(box)}", share(box)) for box in candidate.boxes]
    known += [
        (f"between the points of {checks.label}", share(checks)) for checks in candidate.ranges
    ]
    return max(known, key=lambda item: (not item[1].passed, item[1].ratio))


def _amount(result: Share) -> str:
    """ "output sensitivity 2.82 (limit 3, share 0.94)"."""
    check = result.check
    if check is None or check.limit is None:
        return ""
    value, limit = units.pair(check.value, check.limit, check.unit)
    return f"{binding(check)} {value} (limit {limit}, share {ratio_text(result.ratio)})"


def envelope_section(
    machine: Machine, candidates: Sequence[Candidate], points: Sequence[str]
) -> Section:
    """The map: a panel of speed over pressure per controller where the operating points form a
    grid, else one table.
    """
    known = {point.label: point for point in machine.operation.envelope}
    left_out = [label for candidate in candidates for label in candidate.left_out]
    places = sorted(
        (known[label] for label in {*points, *left_out} if label in known),
        key=lambda p: (p.speed, p.seal_pressure),
    )
    points = [place.label for place in places] + [
        label for label in dict.fromkeys((*points, *left_out)) if label not in known
    ]
    grid = len(places) == len(points) and _is_grid(places)
    panels = (
        [_panel(candidate, places) for candidate in candidates]
        if grid
        else [_table(known, candidates, points)]
    )
    words = (
        "For every operating point the requirement that comes nearest to its limit, and its share "
        "of the limit: up to 1 it "
    )
    words += "is met."
    if any(candidate.boxes for candidate in candidates):
        words += (
            " Each second row (±): the worst that was found over the tolerances around the point."
        )
    return Section("The envelope", words, (), (*panels, _legend()))


def _is_grid(places: Sequence[OperatingPoint]) -> bool:
    pairs = {(place.speed, place.seal_pressure) for place in places}
    speeds, pressures = ({pair[i] for pair in pairs} for i in (0, 1))
    fills = len(pairs) == len(places) >= _GRID * len(speeds) * len(pressures)
    return fills and len(speeds) > 1 and len(pressures) > 1


def _panel(candidate: Candidate, places: Sequence[OperatingPoint]) -> Table:
    """One controller: speeds from left to right, pressures from the bottom up."""
    speeds, pressures = (
        sorted(set(values))
        for values in zip(*((p.speed, p.seal_pressure) for p in places), strict=True)
    )
    at = {(place.speed, place.seal_pressure): place.label for place in places}
    rows: list[Row] = []
    for pressure in reversed(pressures):
        labels = [at.get((speed, pressure)) for speed in speeds]
        rows.append(
            (units.quantity(pressure, "Pa"), *(_cell(candidate, label) for label in labels))
        )
        if candidate.boxes:
            rows.append(
                (Cell("± tolerances", "muted"), *(_box_cell(candidate, label) for label in labels))
            )
    columns = ("", *(_rpm(speed) for speed in speeds))
    widths = (22, *[78 // len(speeds)] * len(speeds))
    return Table(candidate.name, columns, tuple(rows), "", widths, (), True)


def _table(
    known: dict[str, OperatingPoint], candidates: Sequence[Candidate], points: Sequence[str]
) -> Table:
    """Rows are operating points, columns controllers."""
    rows: list[Row] = []
    for label in points:
        place = known.get(label)
        where = (
            ""
            if place is None
            else f"{_rpm(place.speed)}, {units.quantity(place.seal_pressure, 'Pa')}"
        )
        rows.append(
            (Cell(label, detail=where), *(_cell(candidate, label) for candidate in candidates))
        )
        boxes = [_box_cell(candidate, label) for candidate in candidates]
        if any(
            any(box.label == box_label(label) for box in candidate.boxes)
            for candidate in candidates
        ):
            rows.append((Cell("± tolerances", "muted"), *boxes))
    widths = (16, *[84 // len(candidates)] * len(candidates))
    return Table(
        "",
        ("Operating point", *(candidate.name for candidate in candidates)),
        tuple(rows),
        "",
        widths,
        (),
        True,
    )


def _cell(candidate: Candidate, label: str | None) -> Cell:
    if label is None:
        return Cell("")
    checks = candidate.at(label)
    if checks is None:
        why = "not in its schedule" if label in candidate.left_out else ""
        return Cell(NOT_EVALUATED, detail=why, shade="absent")
    result = share(checks)
    return _shaded(result, "" if checks.stable else "nominal loop")


def _box_cell(candidate: Candidate, label: str | None) -> Cell:
    box = next(
        (box for box in candidate.boxes if label is not None and box.label == box_label(label)),
        None,
    )
    if box is None:
        return Cell("" if label is None else NOT_EVALUATED, shade="" if label is None else "absent")
    result = share(box)
    margin = (
        result.check
        if result.check is not None and result.check.name == "robust.stability.margin"
        else None
    )
    return _shaded(
        result, f"from {units.number(margin.value)} of them on" if margin is not None else ""
    )


def _shaded(result: Share, why: str) -> Cell:
    if not result.stable:
        return Cell(
            "unstable",
            "fail",
            detail=why or (binding(result.check) if result.check is not None else ""),
            shade="unstable",
        )
    if result.check is None:
        return Cell("stable", "pass", detail="no limits", shade="free")
    return Cell(
        ratio_text(result.ratio),
        "pass" if result.passed else "fail",
        detail=binding(result.check),
        shade=shade_of(result),
    )


def shade_of(result: Share) -> str:
    """The shade of a stable loop: "meets-1" to "meets-3" up to the limit, "fails-1" to "fails-4"
    beyond it.
    """
    ends, name = (_MEETS[:-1], "meets") if result.passed else (_FAILS, "fails")
    return f"{name}-{1 + sum(result.ratio > end for end in ends)}"


def _legend() -> Table:
    """The shades in a row."""
    meets = [f"up to {end:g}" for end in _MEETS[:-1]] + ["up to 1: met"]
    fails = [f"up to {end:g}" for end in _FAILS] + ["more"]
    cells = [Cell(text, shade=f"meets-{i}") for i, text in enumerate(meets, 1)]
    cells += [Cell(text, shade=f"fails-{i}") for i, text in enumerate(fails, 1)]
    cells += [Cell("unstable", shade="unstable"), Cell(NOT_EVALUATED, shade="absent")]
    widths = (16, *[84 // len(cells)] * len(cells))
    return Table(
        "", ("",) * (1 + len(cells)), (("Share of the limit", *cells),), "", widths, (), True
    )


def _order(place: OperatingPoint | None) -> tuple[float, float]:
    return (math.inf, 0.0) if place is None else (place.speed, place.seal_pressure)


def _rpm(speed: float) -> str:
    return units.join(units.number(speed * units.RPM, 4), "rpm")
