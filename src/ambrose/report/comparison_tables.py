"""Several controllers in tables: who passes where and why not, and the quantities that decide, side
by side.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ambrose.judge.checks import WITH_MEAN_DELAY, Check, Checks, box_label
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.report import theme
from ambrose.report.page import Cell, Row, Section, Table, Verdict
from ambrose.report.tables import RELATION, around, listed, place
from ambrose.rig.trial import Candidate, find

# The decision about several controllers, and the map behind it: per controller and operating point
# the requirement that comes nearest to its limit, or exceeds it most.
#
# A share is the ratio of a value to its limit (``Check.ratio``): up to 1 the requirement is met. A
# second row of every operating point holds the worst over the tolerances around it.


NOT_EVALUATED = "not evaluated"
_MEETS, _FAILS = (0.6, 0.8), (1.1, 1.5, 2.0)  # upper ends of the shades
_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven")
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
        theme.prose(check.title),
    )


def ratio_text(ratio: float) -> str:
    """In percent, with as many digits as it takes to tell it from 100."""
    text = theme.number(100 * ratio, 3 if ratio >= 1 else 2)
    if text == "100" and ratio != 1.0:
        text = theme.pair(100 * ratio, 100.0, "")[0]
    return theme.join(text, "%")


def nearest(candidates: Sequence[Candidate]) -> Candidate:
    """The controller that meets everything with most to spare, or comes nearest to it."""
    labels = _labels(candidates)
    return min(candidates, key=lambda candidate: _distance(candidate, labels))


def _labels(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    return tuple(
        dict.fromkeys(checks.label for candidate in candidates for checks in candidate.checks)
    )


def decision(candidates: Sequence[Candidate]) -> Verdict:
    """Which controllers meet everything, or which comes nearest, then the number that decides."""
    labels, best = _labels(candidates), nearest(candidates)
    good = [
        candidate for candidate in candidates if candidate.passed and not _absent(candidate, labels)
    ]
    where, worst = _worst(best)
    name = quoted(best.name)
    if best in good:
        number = len(best.checks)
        points = f"all {number} operating points" if number > 1 else "the operating point"
        ranges = f", on grids between them ({listed([c.label for c in best.ranges])})"
        scope = f"{points}{ranges if best.ranges else ''}"
        scope += " and over the tolerances" if best.boxes else ""
        others = [quoted(candidate.name) for candidate in good if candidate is not best]
        count = _COUNTS[len(good)] if len(good) < len(_COUNTS) else str(len(good))
        who = f"{count} controllers meet" if others else f"{name} meets"
        which = f": {', '.join([name, *others])}" if others else ""
        margin = (
            f"Tightest requirement{f' of {name}' if others else ''}: {_amount(worst)}, {where}"
            if worst.check is not None
            else "No limits were given"
        )
        return Verdict("", True, f"{who} every requirement at {scope}{which}. {margin}.")
    lost = [checks.label for checks in best.checks if not checks.stable]
    if lost:
        why = f"unstable at {listed(lost)}"
    elif absent := _absent(best, labels):
        why = f"{NOT_EVALUATED} at {listed(absent)}"
        why += ", outside its schedule" if set(absent) <= set(best.left_out) else ""
    elif not worst.stable:
        why = f"unstable {where}"
    else:
        why = f"{_amount(worst)}, {where}"
    return Verdict("", False, f"No controller meets every requirement. Nearest: {name}, {why}.")


def quoted(name: str) -> str:
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
    missing = len(_absent(candidate, labels)) + sum(not one.stable for one in points)
    return missing, sum(not one.stable for one in boxes), _worst(candidate)[1].ratio


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
    """ "output sensitivity 2.82 (limit 3)"."""
    check = result.check
    if check is None or check.limit is None:
        return ""
    value, limit = theme.pair(check.value, check.limit, check.unit)
    return f"{binding(check)} {value} (limit {limit})"


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
    every = [cell.detail for panel in panels for row in panel.cells for cell in row if cell.shade]
    usual = max(every, key=every.count, default="")
    words = "Share of the limit that the tightest requirement uses"
    words += f": {usual}, where no other is named." if usual else "."
    if any(candidate.boxes for candidate in candidates):
        words += " ± tolerances: the worst found over the tolerances around the point."
    panels = [named_once(panel, usual) for panel in panels]
    return Section("The envelope", tables=(*panels[:-1], replace(panels[-1], note=words)))


def named_once(table: Table, usual: str) -> Table:
    """The table without the detail that most of its cells share."""
    rows = (
        tuple(replace(cell, detail="") if cell.detail == usual else cell for cell in row)
        for row in table.cells
    )
    return replace(table, rows=tuple(rows))


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
            (theme.quantity(pressure, "Pa"), *(_cell(candidate, label) for label in labels))
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
            else f"{_rpm(place.speed)}, {theme.quantity(place.seal_pressure, 'Pa')}"
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
        result,
        f"from {theme.number(100 * margin.value)}\u00a0% of them" if margin is not None else "",
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
    ends, name = (_MEETS, "meets") if result.passed else (_FAILS, "fails")
    return f"{name}-{1 + sum(result.ratio > end for end in ends)}"


def _rpm(speed: float) -> str:
    return theme.join(theme.number(speed * theme.RPM, 4), "rpm")


Better = Callable[..., Any]  # min or max

_WIDEST = 9  # columns of values side by side in one table
_LONGEST = 80  # characters of where something occurs, in one cell
# The quantities that decide, and whether less or more of each is better.
_AT_A_POINT: dict[str, Better] = {
    "sensitivity.output.max": min,
    "compliance.max": min,
    "unbalance.orbit_0p": min,
    "unbalance.current_0p": min,
    "impulse.settling": min,
    "impulse.current_0p": min,
    "poles.log_decrement.lowest": max,
}
_IN_THE_BOX: dict[str, Better] = {
    "robust.stability.margin": max,
    "robust.stability.proved": max,
    "robust.sensitivity.worst": min,
    "sampled.sensitivity.box": min,
}
_IMPLIED = {
    "stability.abscissa",
    "robust.stability.box",
    "sampled.stability.box",
    "robust.performance",
}  # told by rows of their own


def _brief(words: str) -> str:
    """Words that fit a cell; what is longer stands in the detailed tables only."""
    return words if len(words) <= _LONGEST else ""


def glance_table(machine: Machine, candidates: Sequence[Candidate], points: Sequence[str]) -> Table:
    """The quantities that decide, one column per candidate: worst of all operating points, whole
    box, the controller.
    """
    rows: list[Row] = [
        _heading("Worst of all operating points", candidates),
        _stability_row(candidates, points),
    ]
    for known, better in _names(
        [checks for candidate in candidates for checks in candidate.checks], _AT_A_POINT
    ):
        rows.append(
            _row(
                known,
                [_worst_of(candidate, points, known.name, better) for candidate in candidates],
                better,
            )
        )
    boxes = [candidate.robust for candidate in candidates]
    evaluated = [checks for checks in boxes if checks is not None]
    if evaluated:
        rows.append(_heading(f"Tolerances ({_box(machine)}) {around(evaluated[0])}", candidates))
        # the heading names the parameter of a single tolerance
        alone = machine.tolerances[0].parameter + " " if len(machine.tolerances) == 1 else ""
        for known, better in _names(evaluated, _IN_THE_BOX):
            entries = [_entry(checks, known.name, alone) for checks in boxes]
            rows.append(_row(known, entries, better))
    rows += _mu_row(candidates)
    rows += [_heading("Controller", candidates), *_controller_rows(candidates)]
    note = (
        "Shaded: the best of its row. No sign: no limit. γ of different methods is "
        "not comparable: each minimises a norm of its own design problem."
    )
    width = 60 // max(len(candidates), 2)
    widths = (100 - 10 - width * len(candidates), 10, *[width] * len(candidates))
    columns = ("Quantity", "Limit", *(candidate.name for candidate in candidates))
    return Table("The quantities that decide", columns, tuple(rows), note, widths, by_cell=True)


def point_tables(candidates: Sequence[Candidate], points: Sequence[str]) -> tuple[Table, ...]:
    """The same quantities at every operating point, the candidates side by side; cut into several
    tables to fit on paper.
    """
    every = [checks for candidate in candidates for checks in candidate.checks]
    names = _names(every, _AT_A_POINT)
    size = max(1, _WIDEST // len(candidates))
    return tuple(
        _point_table(candidates, points[i : i + size], names) for i in range(0, len(points), size)
    )


def _point_table(
    candidates: Sequence[Candidate], points: Sequence[str], names: Sequence[tuple[Check, Better]]
) -> Table:
    grouped = [[candidate.at(point) for candidate in candidates] for point in points]
    rows: list[Row] = [
        ("Stability", "", *(_stability_cell(checks) for group in grouped for checks in group))
    ]
    for known, better in names:
        groups = [[_entry(checks, known.name) for checks in group] for group in grouped]
        rows.append(
            _row(
                known, [entry for group in groups for entry in group], better, group=len(candidates)
            )
        )
    title = "At every operating point" if len(points) > 1 else f"At {points[0]}"
    rest = 72 // max(len(points) * len(candidates), 6)
    widths = (
        100 - 6 - rest * len(points) * len(candidates),
        6,
        *[rest] * (len(points) * len(candidates)),
    )
    columns = ("Quantity", "Limit", *[candidate.name for _ in points for candidate in candidates])
    groups_above = (("", 2), *((point, len(candidates)) for point in points))
    return Table(
        title,
        columns,
        tuple(rows),
        "Shaded: the best at that operating point.",
        widths,
        groups_above,
        True,
    )


@dataclass(frozen=True, slots=True)
class _Entry:
    """What stands in one cell: a check with some words, or only words why there is none."""

    check: Check | None
    words: str = ""


def _entry(checks: Checks | None, name: str, known: str | None = None) -> _Entry:
    """The check of that name; known: words of its place that go without saying, None: all."""
    if checks is None:
        return _Entry(None, "not evaluated")
    if not checks.stable:
        return _Entry(None, "unstable")
    check = find(checks, name)
    if check is None:
        return _Entry(None, "not evaluated")
    words = [f"zone\u00a0{check.zone}"] if check.zone and math.isfinite(check.value) else []
    if known is not None:
        words += ["with its mean delay"] if WITH_MEAN_DELAY in check.detail else []
        words += [_brief(place(check).replace(known, ""))] if check.passed is False else []
    return _Entry(check, ", ".join(filter(None, words)))


def _worst_of(candidate: Candidate, points: Sequence[str], name: str, better: Better) -> _Entry:
    """The check where it is worst, and at which operating point; none where one of them is
    unstable.
    """
    if not all(checks.stable for checks in candidate.checks):
        return _Entry(None, "unstable")
    known = [
        (check, point) for point in points if (check := find(candidate.at(point), name)) is not None
    ]
    if not known:
        return _Entry(None, "not evaluated")
    check, point = (max if better is min else min)(known, key=lambda pair: pair[0].value)
    return _Entry(
        check,
        ", ".join(
            ([f"zone\u00a0{check.zone}"] if check.zone else [])
            + ([point] if len(points) > 1 and check.passed is False else [])
        ),
    )


def _row(sample: Check, entries: Sequence[_Entry], better: Better, *, group: int = 0) -> Row:
    """Title, limit and cells; among every ``group`` of them (0: all) the best is marked. sample:
    what the row is about, as it was evaluated anywhere.
    """
    checks = [entry.check for entry in entries if entry.check is not None]
    first = checks[0] if checks else sample
    known = [
        abs(x) for check in checks for x in (check.value, check.limit or 0.0) if math.isfinite(x)
    ]
    factor, unit = theme.scale(first.unit, max(known, default=0.0))
    limits = {_limit(check, factor) for check in checks or [sample]}
    size = group or len(entries)
    cells = []
    for start in range(0, len(entries), size):
        part = entries[start : start + size]
        amounts = [
            _number(entry.check, factor) if entry.check is not None else "" for entry in part
        ]
        best = _best(
            [
                (e.check.value, text)
                for e, text in zip(part, amounts, strict=True)
                if e.check is not None
            ],
            better,
        )
        for entry, text in zip(part, amounts, strict=True):
            limit_words = (
                ""
                if entry.check is None or len(limits) == 1
                else f"limit {_limit(entry.check, factor) or 'none'}"
            )
            if entry.check is None:
                cells.append(Cell(entry.words, "muted"))
                continue
            mark = {None: "", True: "pass", False: "fail"}[entry.check.passed]
            cells.append(
                Cell(
                    text,
                    mark,
                    text == best,
                    ", ".join(part for part in (entry.words, limit_words) if part),
                )
            )
    title = theme.prose(first.title) + (f" [{unit}]" if unit else "")
    return (title, limits.pop() if len(limits) == 1 else "", *cells)


def _limit(check: Check, factor: float) -> str:
    return (
        ""
        if check.limit is None
        else f"{RELATION.get(check.relation, check.relation)} {theme.number(check.limit * factor)}"
    )


def _number(check: Check, factor: float) -> str:
    """The value in the shown unit, with as many digits as it takes to tell it from its limit."""
    if check.limit is None or not math.isfinite(check.value):
        return theme.number(check.value * factor)
    return theme.pair(check.value * factor, check.limit * factor, "")[0]


def _best(known: Sequence[tuple[float, str]], better: Better) -> str | None:
    """The text of the best of some values; none without a rival that reads otherwise."""
    return str(better(known)[1]) if len({text for _, text in known}) > 1 else None


def _names(every: Sequence[Checks], chosen: Mapping[str, Better]) -> list[tuple[Check, Better]]:
    """The chosen quantities that were evaluated, as found somewhere, then every other one that
    fails somewhere.
    """
    evaluated = {check.name: check for checks in every for check in checks.checks}
    failed = {
        check.name: check for checks in every for check in checks.checks if check.passed is False
    }
    result: list[tuple[Check, Better]] = [
        (evaluated[name], better) for name, better in chosen.items() if name in evaluated
    ]
    for name, check in failed.items():
        if name not in chosen and name not in _IMPLIED:
            result.append((check, max if check.relation in {">", ">="} else min))
    return result


def _heading(text: str, candidates: Sequence[Candidate]) -> Row:
    return (Cell(text, "heading"), *[""] * (1 + len(candidates)))


def _stability_row(candidates: Sequence[Candidate], points: Sequence[str]) -> Row:
    cells = []
    for candidate in candidates:
        bad = [
            point
            for point in points
            if (checks := candidate.at(point)) is not None and not checks.stable
        ]
        cells.append(
            Cell("unstable", "fail", detail=f"at {listed(bad)}") if bad else Cell("stable", "pass")
        )
    return ("Stability", "", *cells)


def _stability_cell(checks: Checks | None) -> Cell:
    if checks is None:
        return Cell("not evaluated", "muted")
    return Cell("stable", "pass") if checks.stable else Cell("unstable", "fail")


def _box(machine: Machine) -> str:
    return (
        ", ".join(
            f"{theme.prose(item.parameter)} ±{_half_width(item)}" for item in machine.tolerances
        )
        or "all tolerances"
    )


def _half_width(tolerance: Tolerance) -> str:
    if tolerance.relative is not None:
        return f"{theme.number(100 * tolerance.relative)}\u00a0%"
    return theme.number(tolerance.absolute or 0.0)


def _mu_row(candidates: Sequence[Candidate]) -> list[Row]:
    """Mixed mu of the weighted loop: as robust verification found it, else as the synthesis did."""
    checks = [find(candidate.robust, "robust.performance") for candidate in candidates]
    uppers = [check.value if check is not None else math.nan for check in checks]
    details = [place(check).partition(",")[0] if check is not None else "" for check in checks]
    title = "Peak of mixed µ of the weighted loop, upper bound (below 1: robust performance)"
    if not any(check is not None for check in checks):
        margins = [candidate.synthesis.certificate.margins for candidate in candidates]
        uppers = [values.get("mu_mixed", math.nan) for values in margins]
        lowers = [values.get("mu_mixed_lower", math.nan) for values in margins]
        details = [
            f"lower bound {theme.number(lower)}" if math.isfinite(lower) else "" for lower in lowers
        ]
    if all(math.isnan(upper) for upper in uppers):
        return []
    return [(title, "", *_numbers(uppers, details, better=min, absent="not evaluated"))]


def _controller_rows(candidates: Sequence[Candidate]) -> list[Row]:
    syntheses = [candidate.synthesis for candidate in candidates]
    orders = [float(synthesis.controller.n_states) for synthesis in syntheses]
    factor, unit = theme.scale("rad/s")
    fastest = [synthesis.certificate.fastest_pole * factor for synthesis in syntheses]
    gammas = [
        Cell(theme.number(synthesis.gamma), detail=synthesis.method)
        if math.isfinite(synthesis.gamma)
        else Cell("none", "muted")
        for synthesis in syntheses
    ]
    return [
        ("Order (number of states)", "", *_numbers(orders, better=min)),
        (f"Fastest pole [{unit}]", "", *_numbers(fastest, better=min)),
        ("γ", "", *gammas),
    ]


def _numbers(
    values: Sequence[float], details: Sequence[str] = (), *, better: Better, absent: str = "none"
) -> list[Cell]:
    """Plain numbers as cells, the best of them marked; NaN where there is none."""
    texts = [theme.number(value) for value in values]
    known = [
        (value, text) for value, text in zip(values, texts, strict=True) if not math.isnan(value)
    ]
    best = _best(known, better)
    details = details or [""] * len(values)
    return [
        Cell(absent, "muted") if math.isnan(value) else Cell(text, "", text == best, detail)
        for value, text, detail in zip(values, texts, details, strict=True)
    ]
