"""What `identify --generic` found about one axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.presentation import Presented, with_unit
from ambrose.identification.findings import Finding
from ambrose.identification.one_axis.axis_record import AxisRecord
from ambrose.identification.one_axis.estimate import Estimate
from ambrose.identification.one_axis.force_law import COVERAGE, LawRow


@dataclass(frozen=True, slots=True)
class PlantValue:
    """A quantity of the plant with the half-width of its 95 % interval, all in ``unit``.

    formal, halves: the half-widths that the residual and that both halves of the record tell; the
    larger is half_width. second: the value of the other way, None: there is none.
    """

    name: str
    symbol: str
    value: float
    half_width: float
    formal: float
    halves: float
    unit: str
    second: float | None = None

    @property
    def source(self) -> str:
        """Where the interval comes from: "formal" or "halves"."""
        return "halves" if self.halves > self.formal else "formal"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GenericIdentification(Presented):
    """One axis, y'' = a y + b u(t - tau), as identified.

    verdict: "identified" or "not this model". frequency (k,) [Hz], coherence (k,) of the
    displacement with what drives the loop, chance: what of it noise would show in 5 of 100. law:
    what a stated force law expects, beside what was found. findings: doubts.
    """

    record: AxisRecord
    values: tuple[PlantValue, ...]
    estimate: Estimate
    verdict: str
    findings: tuple[Finding, ...]
    frequency: np.ndarray
    coherence: np.ndarray
    chance: float
    law: tuple[LawRow, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.findings

    @property
    def pole(self) -> float:
        """The unstable pole [rad/s]; 0 where the axis is stable without control."""
        return self.value("pole").value

    @property
    def coherence_in_band(self) -> float:
        """Mean coherence from 0.3 to 3 times the pole; of all frequencies where there is none."""
        edge = max(self.pole, 1e-9) / (2 * np.pi)
        inside = (self.frequency >= 0.3 * edge) & (self.frequency <= 3 * edge)
        return float((self.coherence[inside] if inside.any() else self.coherence).mean())

    def value(self, name: str) -> PlantValue:
        """One of "pole", "stiffness", "gain", "delay", "lag", "k_s", "k_i". Raises KeyError."""
        for item in self.values:
            if item.name == name:
                return item
        raise KeyError(name)

    def facts(self) -> dict[str, Any]:
        rows = {item.name: _in_words(item) for item in self.values}
        return {"record": self.record.name, "verdict": self.verdict, **rows}

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, SI."""
        done, ahead = self.estimate, self.estimate.prediction
        values = {
            item.name: {
                "value": item.value,
                "half_width": item.half_width,
                "formal_half_width": item.formal,
                "halves_half_width": item.halves,
                "interval_from": item.source,
                "unit": item.unit,
                "other_way": item.second,
            }
            for item in self.values
        }
        return {
            "record": self.record.name,
            "columns": dict(self.record.columns),
            "sample_rate_hz": self.record.rate,
            "samples": len(self.record.position),
            "verdict": self.verdict,
            "passed": self.passed,
            "values": values,
            "way": done.way,
            "noise_order": 2 + done.structure.colour,
            "coherence": self.coherence_in_band,
            "coherence_by_chance": self.chance,
            "residual": {
                "white": done.white,
                "share_from_its_past": done.white_share,
                "follows": done.follows,
                "share_that_follows": done.follows_share,
                "both_ways_agree": done.agree,
                "straight": done.curved,
            },
            "prediction": {
                "ahead_s": ahead.horizon,
                "error_m": ahead.error,
                "expected_m": ahead.expected,
                "staying_m": ahead.still,
            },
            "law": [
                {
                    "name": row.name,
                    "expected": row.expected,
                    "found": row.found,
                    "half_width": row.half_width,
                    "unit": row.unit,
                    "fits": row.fits,
                }
                for row in self.law
            ],
            "findings": [
                {
                    "code": str(finding.code),
                    "severity": finding.severity,
                    "text": str(finding),
                }
                for finding in self.findings
            ],
        }


def _in_words(item: PlantValue) -> str:
    return f"{with_unit(item.value, item.unit)} +- {item.half_width:.2g}"


def plant_values(done: Estimate, unit: str, mass: float | None = None) -> tuple[PlantValue, ...]:
    """Pole, stiffness, gain, delay and lag, with a mass [kg] k_s and k_i too; unit: of the drive.

    p = sqrt(a), and its deviation that of a over 2 p.
    """
    names = [
        ("stiffness", "a", "1/s^2"),
        ("gain", "b", f"m/s^2/{unit}"),
        ("delay", "tau", "s"),
        ("lag", "T", "s"),
    ]
    rows = []
    for place, (name, symbol, its_unit) in enumerate(names[: done.structure.plant]):
        second = None if done.second is None else float(done.second[place])
        rows.append(
            PlantValue(
                name,
                symbol,
                float(done.plant[place]),
                COVERAGE * float(done.deviations[place]),
                COVERAGE * float(done.formal[place]),
                COVERAGE * float(done.halves[place]),
                its_unit,
                second,
            )
        )
    stiffness = rows[0]
    pole = float(np.sqrt(max(stiffness.value, 0.0)))
    # dp = da / 2 p; where a is not above zero, as far as its interval reaches
    slope = 1 / (2 * pole) if pole else 1 / np.sqrt(max(stiffness.half_width, 1e-30))
    second = None if stiffness.second is None else float(np.sqrt(max(stiffness.second, 0.0)))
    first = PlantValue(
        "pole",
        "p",
        pole,
        stiffness.half_width * slope,
        stiffness.formal * slope,
        stiffness.halves * slope,
        "rad/s",
        second,
    )
    forces = [] if mass is None else [("k_s", "k_s", "N/m"), ("k_i", "k_i", f"N/{unit}")]
    for item, (name, symbol, its_unit) in zip(rows[:2], forces, strict=False):
        scaled = {
            key: mass * getattr(item, key) for key in ("value", "half_width", "formal", "halves")
        }
        rows.append(PlantValue(name, symbol, **scaled, unit=its_unit))
    return (first, *rows)
