"""What landings cost a touchdown bearing, against the limits of its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.fallen import FallenRotor
from ambrose.machine.machine import Machine
from ambrose.machine.touchdown import Touchdown, TouchdownLimits


@dataclass(frozen=True, slots=True)
class Row:
    """One quantity of one place. value and limit [SI]; relation "<=" or ">="; passed None: for
    information.
    """

    name: str
    place: str
    title: str
    value: float
    unit: str
    relation: str = "<="
    limit: float | None = None
    note: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether the limit holds; None without one."""
        if self.limit is None:
            return None
        return self.value <= self.limit if self.relation == "<=" else self.value >= self.limit

    def to_dict(self) -> dict[str, Any]:
        """Plain data; what is not finite is null."""
        value = self.value if math.isfinite(self.value) else None
        return {
            "name": self.name,
            "place": self.place,
            "value": value,
            "unit": self.unit,
            "relation": self.relation,
            "limit": self.limit,
            "passed": self.passed,
            "note": self.note,
        }


def judge_landing(
    machine: Machine,
    fallen: FallenRotor,
    force: np.ndarray,
    load: np.ndarray,
    slip: np.ndarray,
    reach: np.ndarray,
    seals: np.ndarray,
    after: float,
) -> tuple[Row, ...]:
    """Rows of one drop or of a campaign. force, load [N] and slip [J] (d, b), until the races turn
    with the rotor; reach (d, b) [m]: largest displacement; seals (d, s): displacement over the gap;
    after [J]: slip of the run-down at every bearing that was met.
    """
    rows = []
    for k, bearing in enumerate(machine.bearings):
        table = bearing.touchdown or Touchdown()
        limits = table.limits or TouchdownLimits()
        race, name = table.race, bearing.name
        largest = float(force[:, k].max())
        cost = slip[:, k] + after * (force[:, k] > 0)
        rows.append(
            Row("force", name, "largest contact force", largest, "N", "<=", limits.max_force)
        )
        if bearing.gap is not None:
            far = float(reach[:, k].max()) / bearing.gap
            title = "largest displacement over the magnet's gap"
            rows.append(Row("magnet_gap", name, title, far, "-", "<=", 1.0))
        mass = race.mass if race is not None else table.mount.mass if table.mount else 0.0
        if mass:
            heat = race.specific_heat if race is not None else 460.0
            start = race.temperature if race is not None else 293.15
            # all slip into the race, none out of it
            hottest = start + float(cost.max()) / (mass * heat)
            note = "adiabatic: all slip energy of one landing into the race"
            row = Row(
                "temperature",
                name,
                "race temperature",
                hottest,
                "K",
                "<=",
                limits.temperature,
                note,
            )
            rows.append(row)
        mean = float(cost.mean())
        factor = math.inf
        if race is not None and race.static_capacity is not None:
            factor = race.static_capacity / max(float(load[:, k].max()), 1e-9)
            rows.append(
                Row(
                    "static_factor",
                    name,
                    "C_0 over the largest load",
                    factor,
                    "-",
                    ">=",
                    limits.static_factor,
                )
            )
        rows.append(Row("slip_energy", name, "slip energy per landing, mean", mean, "J"))
        allowed = _allowed(limits, mean, factor)
        if allowed is not None:
            note = "energy of its life over the mean slip energy; none where C_0 is exceeded"
            wanted = None if limits.landings is None else float(limits.landings)
            rows.append(Row("landings", name, "landings allowed", allowed, "-", ">=", wanted, note))
    for s, name in enumerate(fallen.seal_names):
        rows.append(
            Row(
                "penetration",
                name,
                "largest displacement over the clearance",
                float(seals[:, s].max()),
                "-",
                "<=",
                1.0,
            )
        )
    return tuple(rows)


def _allowed(limits: TouchdownLimits, mean: float, factor: float) -> float | None:
    """How many landings the energy allows; None where the file states no energy."""
    if limits.static_factor is not None and factor < limits.static_factor:
        return 0.0
    if limits.energy is None:
        return None
    return float(math.floor(limits.energy / mean)) if mean > 0 else math.inf
