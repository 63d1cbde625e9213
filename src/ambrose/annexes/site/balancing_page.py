"""A balancing as tables: the masses to add, and 1x before and after."""

from __future__ import annotations

import numpy as np

from ambrose.annexes.site.balancing.correction import Balancing
from ambrose.report import units
from ambrose.report.page import Cell, Row, Table, numbers


def balancing_tables(result: Balancing) -> tuple[Table, Table]:
    """Corrections, then 1x of every sensor axis at every speed, now and as predicted."""
    rows: list[Row] = []
    for plane, radius, u, limit, mass, angle in zip(
        result.planes,
        result.radii,
        result.correction,
        result.uncertainty,
        result.masses,
        result.angles,
        strict=True,
    ):
        share = min(float(limit / abs(u)), 1.0) if u else 1.0
        spread = (
            "any"
            if share >= 1
            else f"{np.degrees(angle):.1f}° ± {np.degrees(np.arcsin(share)):.1f}°"
        )
        cells = numbers(
            units.quantity(radius, "m"),
            f"{1e3 * mass:.4g} ± {1e3 * limit / radius:.2g} g",
            spread,
            units.quantity(abs(u), "kg m"),
            units.quantity(float(limit), "kg m"),
        )
        rows.append((plane, *cells))
    note = (
        "Degrees from the key mark in the direction of spin; to remove mass, take the opposite "
        "angle. Left at most: what the "
        "plane keeps, with 95 %."
    )
    columns = ("Plane", "Radius", "Add", "At", "Unbalance", "Left at most")
    masses = Table("Correction masses", columns, tuple(rows), note)
    shown: list[Row] = [
        (
            Cell(units.axis_name(row.axis)),
            *numbers(
                f"{row.speed * units.RPM:.5g} rpm",
                units.quantity(abs(row.before), "m"),
                units.quantity(abs(row.after), "m"),
                units.quantity(abs(row.after) + row.radius, "m"),
            ),
        )
        for row in result.rows
    ]
    what = (
        "of the measured y, less its run-out"
        if result.quantity == "y"
        else "of y - G u, less run-out (no controller is known)"
    )
    head = ("Axis", "Speed", "Now", "Predicted", "At most (95 %)")
    return masses, Table(
        "1x, zero to peak",
        head,
        tuple(shown),
        f"What unbalance makes {what}; run-out, which a monitor shows as well, is not in it.",
    )


def in_words(result: Balancing) -> list[str]:
    """How it was found, and what the balance quality becomes, in lines of text."""
    lines = [
        f"Coefficients: {result.method}; condition of the matrix {units.number(result.condition)}; "
        f"their error, by the misfit: {units.number(100 * result.model_error, 2)} %",
        "1x is zero in every row: there is nothing to lower"
        if result.remaining is None
        else f"1x falls to {units.number(100 * result.remaining, 2)} % or less (95 %)",
    ]
    now, then = result.grade(np.abs(result.correction)), result.grade(result.uncertainty)
    if now is not None and then is not None and result.allowed is not None:
        allowed = f"G{1e3 * result.allowed.grade:g} at {result.allowed.speed * units.RPM:.5g} rpm"
        lines.append(
            f"Balance quality (ISO 21940-11) now G{1e3 * now:.3g}, then G{1e3 * then:.3g} or "
            f"better; to be {allowed}"
        )
    if result.runout_found and result.runout.any():
        told = ", ".join(
            f"{1e6 * abs(r):.3g} µm at {np.degrees(np.angle(r)):.0f}°" for r in result.runout
        )
        lines.append(f"Run-out at 1x, by the speeds: {told}")
    if result.scale is not None:
        scale = result.scale
        lines.append(
            f"The model's coefficients are {abs(scale):.3f} times the measured, turned by "
            f"{np.degrees(np.angle(scale)):.1f}°"
        )
    return [*lines, *(f"note: {note}" for note in result.notes)]
