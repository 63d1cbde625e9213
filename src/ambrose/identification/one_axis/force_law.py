"""Whether what was identified belongs to the force law F = c (i/s)^2 of a magnet.

Of one magnet about s_0, i_0, and of a pair with the bias i_0 and the gap s_0 on both sides,

    one:   m y'' = dF/ds y + dF/di i,      k_s = 2 F_0 / s_0,       k_i = 2 F_0 / i_0,
    pair:                                  k_s = 4 c i_0^2 / s_0^3, k_i = 4 c i_0 / s_0^2,

so that k_s / k_i = a / b = i_0 / s_0 for both, whatever c and m are; and where one magnet carries
the weight, F_0 = m g, then a = 2 g / s_0 and b = 2 g / i_0 besides (Schweitzer and Maslen,
Magnetic Bearings, 2009, section 4.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import check_positive
from ambrose.machine.units import DIMENSIONS, read_quantity

GRAVITY = 9.81  # m/s^2
COVERAGE = 1.96  # standard deviations to either side: 95 % of a normal distribution


@dataclass(frozen=True, slots=True)
class ForceLaw:
    """gap s_0 [m]; current i_0 [A]; hanging: one magnet carries the weight, else a pair with bias.
    Raises InvalidInput.
    """

    gap: float
    current: float
    hanging: bool = False

    def __post_init__(self) -> None:
        for name in ("gap", "current"):
            check_positive(getattr(self, name), name, "state it in SI units")


@dataclass(frozen=True, slots=True)
class LawRow:
    """One consequence of the law: expected of it, found with its half-width (95 %), one unit."""

    name: str
    expected: float
    found: float
    half_width: float
    unit: str

    @property
    def fits(self) -> bool:
        """Whether the interval holds what the law expects."""
        return bool(abs(self.found - self.expected) <= self.half_width)


def current_scale(unit: str) -> float | None:
    """What one ``unit`` is in A; None where it is no unit of current."""
    try:
        return read_quantity(f"1 {unit}", DIMENSIONS["current"])
    except ValueError:
        return None


def compare_law(
    law: ForceLaw, stiffness: float, gain: float, covariance: np.ndarray, unit: str
) -> tuple[LawRow, ...]:
    """What the law expects beside what was found.

    stiffness a [1/s^2], gain b [m/s^2 per unit] (its sign: how y and u are counted), covariance
    (2, 2) of both; unit: of the drive, one of current.
    """
    # b per ampere, and its row and column of the covariance
    scale = current_scale(unit) or 1.0
    gain, per_ampere = gain / scale, np.array([1.0, 1 / scale])
    covariance = covariance * per_ampere * per_ampere[:, None]
    ratio = stiffness / abs(gain)
    slope = np.array([1 / abs(gain), -stiffness / (gain * abs(gain))])
    rows = [
        LawRow(
            "a/b = i0/s0",
            law.current / law.gap,
            ratio,
            COVERAGE * float(np.sqrt(slope @ covariance @ slope)),
            "A/m",
        )
    ]
    if law.hanging:
        halves = COVERAGE * np.sqrt(np.diag(covariance))
        rows.append(
            LawRow("a = 2 g/s0", 2 * GRAVITY / law.gap, stiffness, float(halves[0]), "1/s^2")
        )
        rows.append(
            LawRow(
                "b = 2 g/i0",
                2 * GRAVITY / law.current,
                abs(gain),
                float(halves[1]),
                "m/s^2/A",
            )
        )
    return tuple(rows)
