"""Journal bearing: the oil film's force, f = -([[K_xx, K_xy], [K_yx, K_yy]] q + [[C_xx, C_xy],
[C_yx, C_yy]] q') on the rotor, in x and y.

q is the journal's displacement from where it rests under its load; the coefficients are those of a
table over the spin speed, as bearing programs write it, linear between its speeds. With x the
horizontal and y the vertical axis K_xy > 0 > K_yx drives forward whirl. A film at rest carries
nothing, so nothing is extrapolated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ambrose.core.checks import invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.kinds import Length, ListOf, Name
from ambrose.machine.messages import as_written, complaint
from ambrose.machine.part import Part
from ambrose.model.effect import Action, Effect, Reaction

_ENTRIES = ("xx", "xy", "yx", "yy")
_SLACK = 1e-9  # of the highest speed: what rounding of units may add

_Stiffnesses = Annotated[tuple[float, ...], ListOf("stiffness", scalar=True)]
_Dampings = Annotated[tuple[float, ...], ListOf("damping", scalar=True)]


@dataclass(frozen=True, slots=True, repr=False)
class JournalBearing(Part):
    """A journal bearing: stiffness and damping of its oil film over the speed."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    K_xx: Annotated[_Stiffnesses, "force along -x per displacement along x, one per speed"]
    K_yy: Annotated[_Stiffnesses, "the same along y"]
    C_xx: Annotated[_Dampings, "force along -x per velocity along x, one per speed"]
    C_yy: Annotated[_Dampings, "the same along y"]
    speed: Annotated[
        tuple[float, ...],
        ListOf("angular rate"),
        "spin speeds of the table, ascending; left out for one row that holds at every speed",
    ] = ()
    K_xy: Annotated[_Stiffnesses, "force along -x per displacement along y; default: 0"] = ()
    K_yx: Annotated[_Stiffnesses, "force along -y per displacement along x; default: 0"] = ()
    C_xy: Annotated[_Dampings, "force along -x per velocity along y; default: 0"] = ()
    C_yx: Annotated[_Dampings, "force along -y per velocity along x; default: 0"] = ()


def coefficients(bearing: JournalBearing, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness K (2, 2) [N/m] and damping C (2, 2) [N s/m] at a spin speed [rad/s], in (x, y).

    Raises InvalidInput for a speed outside the table.
    """
    grid = np.asarray(bearing.speed, dtype=float)
    if len(grid):
        slack = _SLACK * grid[-1]
        if not grid[0] - slack <= speed <= grid[-1] + slack:
            raise invalid(
                f"the speed of journal bearing {bearing.name}",
                as_written(speed, "speed"),
                f"within its table, {as_written(grid[0], 'speed', False)} to "
                f"{as_written(grid[-1], 'speed')}",
                "extend the table or choose an operating point inside",
            )

    def at(letter: str, entry: str) -> float:
        column = getattr(bearing, f"{letter}_{entry}")
        if not column:
            return 0.0
        return float(np.interp(speed, grid, column)) if len(grid) else float(column[0])

    K, C = (np.array([at(letter, e) for e in _ENTRIES]).reshape(2, 2) for letter in "KC")
    return K, C


def _findings(where: str, bearing: JournalBearing) -> Iterator[str]:
    rows = len(bearing.speed) or 1
    for key in (f"{letter}_{entry}" for letter in "KC" for entry in _ENTRIES):
        column = getattr(bearing, key)
        required = key[2] == key[3]
        if len(column) != rows and (column or required):
            wanted = f"a list of {rows}, one per speed"
            remedy = "complete the table, or leave speed out for one row"
            yield complaint(where, key, f"a list of {len(column)}", wanted, remedy)
    if min(bearing.speed, default=0.0) < 0 or np.any(np.diff(bearing.speed) <= 0):
        remedy = "sort the rows by speed and keep one of each"
        yield complaint(where, "speed", "not ascending", "ascending, none negative", remedy)


def _reaction(bearing: JournalBearing, point: OperatingPoint) -> Reaction:
    return Reaction(*coefficients(bearing, point.speed))


def _actions(bearing: JournalBearing, point: OperatingPoint, quantity: str) -> Iterator[Action]:
    """-K_rc q_c, or -C_rc q'_c, along r."""
    row, column = quantity[2], quantity[3]
    matrix = coefficients(bearing, point.speed)[quantity[0] == "C"]
    nominal = float(matrix["xy".index(row), "xy".index(column)])
    signal = "q" if quantity[0] == "K" else "qdot"
    yield Action(f"{bearing.name}_{row}", nominal, ((f"{signal}_{bearing.name}_{column}", -1.0),))


JOURNAL_BEARING = Effect(
    table="journal_bearing",
    part=JournalBearing,
    findings=_findings,
    quantities={
        f"{letter}_{entry}": (dimension, ())
        for letter, dimension in (("K", "stiffness"), ("C", "damping"))
        for entry in _ENTRIES
    },
    on_stator=True,
    carries=True,
    reaction=_reaction,
    over_speed=True,
    knots=lambda bearing: bearing.speed,
    actions=_actions,
)
