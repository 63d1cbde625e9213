"""The page of a landing: whip before any simulation."""

from __future__ import annotations

import numpy as np

from ambrose.annexes.touchdown.analysis import WHIP_MODEL, Landing
from ambrose.annexes.touchdown.whip_figures import map_figure, needed_figure
from ambrose.machine.file.toml import machine_hash
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, numbers

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
        Section(
            "Whip before any simulation", _WHIP, pictures, (table, damping_table(result)), True
        ),
    )
    facts = (
        ("Machine file", machine_hash(result.machine)),
        ("Operating point", f"{result.point_name}, {result.point.speed * 30 / np.pi:.6g} rpm"),
        ("Rotor", f"{result.fallen.mass:.4g} kg"),
    )
    return Page("Landing", result.machine, sections, (), facts, date, signatures=())


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
