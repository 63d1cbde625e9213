"""The page of a landing: verdict, slow motion, distribution, whip before any simulation."""

from __future__ import annotations

import numpy as np

from ambrose.annexes.touchdown.analysis import HEADS, WHIP_MODEL, Landing
from ambrose.annexes.touchdown.campaign import FRICTION, MOUNT, SPEED, WHIRLS
from ambrose.annexes.touchdown.drop_figures import (
    FRAME_TIME,
    FRAMES,
    SHOWN,
    axial_figure,
    distribution_figure,
    history_figure,
    slow_motion,
)
from ambrose.annexes.touchdown.thrust_face import AxialDrop
from ambrose.annexes.touchdown.whip_figures import map_figure, needed_figure
from ambrose.machine.file.toml import machine_hash
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

_WHIP = (
    "Backward whip: friction at the touchdown bearing drives the rotor around against its spin. "
    "It speeds up where friction exceeds what whip needs, and settles at the edge, where the need "
    f"rises through it. Model: {WHIP_MODEL}."
)
_NEEDED = "Whip settles where a curve rises through the dotted line."
_MAP = (
    "Where whip of the kind '{kind}' settles, over friction and mount stiffness at the mount's own "
    "damping. White: no whip, or a force that nothing "
    "bounds."
)
_DROP = (
    "The magnets lose their power at t = 0 at the operating point, the rotor on the orbit of its "
    "residual unbalance. Rotor in {modes} bending modes per plane, seals and couplings linear."
)
_MOTION = (
    "Centre of the rotor in each bearing. Red: how far it may go in what it meets, which gives "
    "way; grey: the same at rest. Slow motion, {slow:.0f} times slower."
)
_HISTORY = "Forces and speeds: a race that has caught up with the rotor slips no more."
_MANY = (
    "{count:,} drops of {duration:.3g} s with friction {f[0]:g} to {f[1]:g} and mount {m[0]:g} to "
    "{m[1]:g} times the file's values, speed {s[0]:g} to {s[1]:g} times the operating point's, and "
    "every phase of unbalance; seed {seed}; {wall:.0f} s on {workers} processors.\n\n"
    "{share:.3g} % whirl within {duration:.3g} s: {turns:g} whole turns against the spin without "
    "going back, counted on this nonlinear model. That is no statement on stability."
)
_DISTRIBUTION = "Left: share of drops with at most a force. Right: at most 1,500 drops."
_COST = (
    "Over all drops where there is a campaign, else over the one drop; the rest of the run-down is "
    "estimated. Not covered: wear, heat that changes friction or clearance."
)
_ALONG = (
    "The thrust bearing loses its power with the others: rotor, coupling and stop of the machine "
    "file, from rest at the middle, under the process thrust of {thrust:.4g} N. Left out: what the "
    "magnets still pull as their flux decays (the rig has it), friction on the face."
)
_FACE = "The collar against its stop, and how near it comes to the magnet."
_HEADS = (
    "The heads of ISO 14839-5:2022, recalled from its published scope (its text was not at hand; "
    "it states no numeric limits), and where this page has something on them."
)
_WORDS = {"none": "for information", "pass": "holds", "fail": "fails"}
_NO_MOUNT = " The machine file states no mount: the map shows what one would do."


def whip_rows(result: Landing) -> tuple[tuple[str, str, str, str], ...]:
    """Kind, friction, frequency and force of every whip, as text."""
    rows = []
    for whip in result.whips:
        if whip.frequency == 0:
            at, force = "no whip", "-"
        elif np.isfinite(whip.frequency):
            at = f"{whip.frequency / (2 * np.pi):.4g} Hz"
            force = force_text(max(whip.force))
            if whip.stop:
                force += " (at the stop)" if whip.with_stop else " (without the stop, which is met)"
        else:
            at, force = "up to rolling", "not bounded"
        rows.append((whip.kind, f"{whip.friction:g}", at, force))
    return tuple(rows)


def force_text(force: float) -> str:
    """A force in kN; what the linear model does not bound says so."""
    return f"{force / 1e3:.3g} kN" if np.isfinite(force) else "not bounded"


def landing_page(result: Landing, *, date: str = "") -> Page:
    """The page of a ``Landing``; date: ISO (today if empty)."""
    rows: tuple[Row, ...] = tuple((kind, *numbers(*values)) for kind, *values in whip_rows(result))
    table = Table("Whip of this machine", ("Kind", "Friction", "Settles at", "Force"), rows)
    item = result.whip_map
    words = _MAP.format(kind=item.kind) + (_NO_MOUNT if item.place is None else "")
    pictures = (
        Figure("Friction that whip needs", needed_figure(result), _NEEDED),
        Figure("Frequency of whip", map_figure(item, "frequency"), words),
        Figure("Force of whip", map_figure(item, "force"), words),
    )
    drawing = Figure("Rotor and its parts", machine_drawing(result.machine))
    sections = (
        Section("Rotor", "", (drawing,)),
        Section("What landings cost", _COST, (), (cost_table(result),)),
        drop_section(result),
        *map(axial_section, result.along),
        *([] if result.campaign is None else [campaign_section(result)]),
        Section(
            "Whip before any simulation", _WHIP, pictures, (table, damping_table(result)), True
        ),
        Section("ISO 14839-5", _HEADS, (), (heads_table(),)),
    )
    facts = (
        ("Machine file", machine_hash(result.machine)),
        ("Operating point", f"{result.point_name}, {result.point.speed * 30 / np.pi:.6g} rpm"),
        ("Rotor", f"{result.fallen.mass:.4g} kg"),
    )
    return Page(
        "Landing",
        result.machine,
        sections,
        (),
        facts,
        date,
        result=Verdict("Result", result.passed, verdict_text(result)),
    )


def verdict_text(result: Landing) -> str:
    """How it turned out, in a sentence."""
    judged = [row for row in result.rows if row.passed is not None]
    failed = [row for row in judged if not row.passed]
    over = "one drop" if result.campaign is None else f"{result.campaign.count:,} drops"
    if not judged:
        return f"no limits in [bearing.touchdown.limits]; {over} for information"
    if not failed:
        return f"all {len(judged)} rows with a limit hold over {over}"
    names = "; ".join(f"{row.title} ({row.place})" for row in failed)
    return f"{len(failed)} of {len(judged)} rows with a limit fail over {over}: {names}"


def cost_rows(result: Landing) -> tuple[tuple[str, str, str, str, str], ...]:
    """(place, quantity, value, limit, mark) of every row, as text."""
    rows = []
    for row in result.rows:
        limit = "" if row.limit is None else f"{row.relation} {_valued(row.limit, row.unit)}"
        mark = {None: "none", True: "pass", False: "fail"}[row.passed]
        rows.append((row.place, row.title, _valued(row.value, row.unit), limit, mark))
    return tuple(rows)


def _valued(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "not bounded"
    if unit == "N":
        return f"{value / 1e3:.3g} kN"
    if unit == "K":
        return f"{value - 273.15:.4g} °C"
    if unit == "s":
        return f"{1e3 * value:.4g} ms"
    return f"{value:.4g}" if unit == "-" else f"{value:.4g} {unit}"


def cost_table(result: Landing) -> Table:
    """Forces, heat, load, slip energy and landings allowed, with the file's limits."""
    rows: tuple[Row, ...] = tuple(
        (place, title, *numbers(value, limit), Cell(_WORDS[mark], mark))
        for place, title, value, limit, mark in cost_rows(result)
    )
    notes = dict.fromkeys(row.note for row in result.rows if row.note)
    return Table(
        "Against the limits of the file",
        ("Place", "Quantity", "Value", "Limit", "Verdict"),
        rows,
        "; ".join(notes),
    )


def drop_section(result: Landing) -> Section:
    """The one drop."""
    rows: list[Row] = []
    turn = 2 * np.pi
    for k, name in enumerate(result.fallen.names):
        figures = result.fall.figures[k]
        touched = f"{1e3 * figures[0]:.4g} ms" if figures[0] >= 0 else "never"
        values = (
            touched,
            f"{figures[1] / 1e3:.3g} kN",
            f"{figures[2] / 1e3:.3g} kN",
            f"{1e6 * figures[5]:.4g} um",
            f"{figures[6] / turn:.2f} / {figures[7] / turn:.2f}",
            f"{result.fall.energy[k]:.4g} J",
            f"{figures[10] * 30 / np.pi:,.0f} rpm",
        )
        rows.append((name, *numbers(*values)))
    columns = (
        "Bearing",
        "First contact",
        "First peak",
        "Largest force",
        "Displacement",
        "Turns against / with spin",
        "Slip energy",
        "Race",
    )
    down = result.down
    stands = f"{down.time:.4g} s" if np.isfinite(down.time) else "no time: nothing slows it"
    note = f"After these {result.duration:.3g} s the rotor stands within {stands} (estimated)."
    if result.recovery is not None:
        at, back = 1e3 * result.recovery.start, result.recovery.time
        found = f"free of contact {1e3 * back:.4g} ms later" if np.isfinite(back) else "not free"
        note += (
            f" Power back after {at:.4g} ms in another drop: {found}, at most "
            f"{result.recovery.force / 1e3:.3g} kN; no statement on stability."
        )
    table = Table("As the machine is written down", columns, tuple(rows), note)
    slow = FRAME_TIME * FRAMES / (1e3 * SHOWN)
    pictures = (
        Figure("Slow motion", slow_motion(result), _MOTION.format(slow=slow)),
        Figure("Forces and speeds", history_figure(result), _HISTORY),
    )
    modes = (len(result.fallen.mass_matrix) - 4) // 2
    return Section("One drop", _DROP.format(modes=modes), pictures, (table,), True)


def axial_section(drop: AxialDrop) -> Section:
    """The motion along the axis of one thrust bearing."""
    touched, settled = drop.first_contact, drop.settled
    row: Row = (
        f"{drop.bearing} {drop.side}",
        *numbers(
            "never" if touched is None else f"{1e3 * touched:.4g} ms",
            f"{drop.largest_force / 1e3:.3g} kN",
            f"{drop.bound / 1e3:.3g} kN",
            f"{1e6 * drop.reach:.4g} um",
            f"{1e6 * drop.gap:.4g} um",
            "not yet" if settled is None else f"{1e3 * settled:.4g} ms",
        ),
    )
    columns = (
        "Face",
        "First contact",
        "Largest force",
        "Without damping",
        "Displacement",
        "Magnet at",
        "At rest from",
    )
    table = Table("Along the shaft", columns, (row,))
    picture = Figure("On the thrust face", axial_figure(drop), _FACE)
    words = _ALONG.format(thrust=drop.thrust)
    return Section("Landing on the thrust face", words, (picture,), (table,), True)


def campaign_section(result: Landing) -> Section:
    """Many drops."""
    campaign = result.campaign
    assert campaign is not None
    words = _MANY.format(
        count=campaign.count,
        duration=campaign.duration,
        f=FRICTION,
        m=MOUNT,
        s=SPEED,
        seed=campaign.seed,
        wall=campaign.wall,
        workers=campaign.workers,
        share=100 * campaign.whirls.mean(),
        turns=WHIRLS,
    )
    rows: list[Row] = []
    for k, name in enumerate(result.fallen.names):
        for title, values, scale, unit in (
            ("largest force", campaign.force[:, k], 1e3, "kN"),
            ("slip energy", campaign.slip[:, k], 1.0, "J"),
        ):
            found = campaign.quantiles(values)
            cells = numbers(*(f"{value / scale:,.4g} {unit}" for value in found.values()))
            rows.append((name, title, *cells))
    for s, name in enumerate(result.fallen.seal_names):
        found = campaign.quantiles(campaign.seals[:, s])
        cells = numbers(*(f"{value:.3g}" for value in found.values()))
        rows.append((name, "displacement over clearance", *cells))
    columns = ("Place", "Quantity", "5 %", "Median", "95 %", "Largest")
    picture = Figure(
        "Distribution", distribution_figure(campaign, result.fallen.names), _DISTRIBUTION
    )
    table = Table("Over all drops", columns, tuple(rows))
    return Section("Many drops", words, (picture,), (table,), True)


def heads_table() -> Table:
    """The nine heads."""
    rows = tuple(
        (head, here, Cell("not covered" if here == "not covered" else "recalled", "muted"))
        for head, here in HEADS
    )
    return Table("Nine heads", ("Head", "Here", "Basis"), rows)


def damping_table(result: Landing) -> Table:
    """The edge at the machine's friction over the mount's damping."""
    item = result.whip_map
    mu = max(bearing.friction for bearing in result.fallen.bearings)
    f = int(np.argmin(np.abs(np.log(item.friction / mu))))
    k = len(item.stiffness) // 2
    rows = []
    for d, damping in enumerate(item.damping):
        w, force = item.frequency[d, k, f], item.force[d, k, f]
        found = np.isfinite(w) and w > 0
        at = f"{w / (2 * np.pi):.4g} Hz" if found else "no whip" if w == 0 else "up to rolling"
        rows.append(
            (
                Cell(f"{damping / 1e3:.3g} kN s/m", "number"),
                *numbers(at, force_text(force) if found else "-"),
            )
        )
    title = f"Over the mount's damping, at friction {item.friction[f]:.2g}"
    return Table(title, ("Mount damping", "Settles at", "Force"), tuple(rows))
