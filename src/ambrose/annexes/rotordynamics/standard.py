"""Formulas of API 617, 9th edition, part 1 (lateral analysis), with the letters of the standard.

The text of the standard was not at hand. What stands here was recalled, and compared with the open
code of ROSS 3.1 and with API tutorial 684-1, which quote it; every row of a report that rests on
it says "recalled". Units are those of the standard where its constants carry them: W [kg],
N [rpm], amounts [g mm], amplitudes [um] peak to peak.
"""

import math
from dataclasses import dataclass

EDITION = "API 617, 9th ed., part 1"
ISO_3 = "ISO 14839-3:2006"
ISO_2 = "ISO 14839-2:2004"

RPM = math.pi / 30  # [rad/s]
_FAST = 25_000.0  # [rpm]: from here on the amount no longer falls with the speed
_AMOUNT = 6350.0  # [g mm rpm/kg]
ANALYSIS_FACTOR = 2.0  # the analysis takes twice the residual amount
CRITICALLY_DAMPED = 2.5  # amplification factor below which no margin is asked for
# of the vibration limit: peaks below it are listed, not judged. Even scaled by the largest factor
# they stay below 6 % of the limit, a quarter of the runout that it allows for (25 %)
SMALL_PEAK = 0.01
# of the largest reading at a critical speed, and of one that is critically damped: smaller ones do
# not count
MINOR_READING = 0.1, 0.01
_LARGEST_VIBRATION = 25.4  # [um] peak to peak
_VIBRATION_SPEED = 12_000.0  # [rpm]
LARGEST_SCALE = 6.0  # cap of the scale factor
CLEARANCE_SHARE = 0.75  # of a minimum clearance, that the vibration may take
LEAST_LOG_DECREMENT = 0.1  # at Q_A (Level I) and with all parts (Level II)
SWEEP = 10.0  # times Q_A: how far the cross-coupling is swept
SCREEN_NEAR, SCREEN_FAR = 2.0, 10.0  # Q0/Q_A
LEAST_ANTINODE = 0.1  # of the largest: smaller ones get no unbalance
# times the maximum continuous speed: no critical speed above it needs a margin (26 % at most), and
# curves to the second show the upper half-power point of one that does
MARGIN_TO, CURVES_TO = 1.3, 1.6
MODES_TO = 1.25  # times the trip speed: up to where modes are judged or excited
# beyond them modes are listed for information, to so many times the second bending frequency of the
# free rotor: the first two bending modes in the loop, split by the gyroscopic effect
BENDING_LISTED, BEYOND_BENDING = 2, 1.25
OVERHANG = 0.5  # of the largest: from here an overhung antinode governs


def rpm(speed: float) -> str:
    """A speed [rad/s] in rpm, to five digits or to whole ones."""
    text = f"{speed / RPM:.5g}"
    return f"{speed / RPM:.0f}" if "e" in text else text


def residual_amount(weight: float, speed_rpm: float) -> float:
    """U_r [g mm] of a plane that carries ``weight`` [kg] at the maximum continuous speed N [rpm].

    U_r = 6350 W/N below 25,000 rpm, W/3.937 from there on: both are one value at that speed.
    """
    return _AMOUNT * weight / min(speed_rpm, _FAST)


def vibration_limit(speed_rpm: float) -> float:
    """A_vl [um] peak to peak: 25.4 sqrt(12,000/N), 25.4 at most."""
    return min(_LARGEST_VIBRATION, _LARGEST_VIBRATION * math.sqrt(_VIBRATION_SPEED / speed_rpm))


def margin_below(amplification: float) -> float:
    """Separation margin [%] that a critical speed below the minimum speed needs.

    min(16, 17 (1 - 1/(AF - 1.5))); 0 where it is critically damped, AF < 2.5.
    """
    if amplification < CRITICALLY_DAMPED:
        return 0.0
    return min(16.0, 17.0 * (1 - 1 / (amplification - 1.5)))


def margin_above(amplification: float) -> float:
    """Separation margin [%] that a critical speed above the maximum continuous speed needs.

    min(26, 10 + 17 (1 - 1/(AF - 1.5))); 0 where it is critically damped, AF < 2.5.
    """
    if amplification < CRITICALLY_DAMPED:
        return 0.0
    return min(26.0, 10.0 + 17.0 * (1 - 1 / (amplification - 1.5)))


def border_speed_ratio(density: float) -> float:
    """Critical speed ratio at the border of region B for a mean gas density [kg/m^3].

    2.5 up to 16.53 kg/m^3, then 2.69 - 0.0115 rho down to 2.0 at 60; above that every machine
    lies in region B: 0.
    """
    if density > 60.0:
        return 0.0
    return 2.5 if density <= 16.53 else 2.69 - 0.0115 * density


@dataclass(frozen=True, slots=True)
class Screening:
    """Whether Level I is enough, and each reason why it is not."""

    enough: bool
    reasons: tuple[str, ...]


def screen(
    q_anticipated: float,
    q_limit: float,
    log_decrement: float,
    speed_ratio: float | None,
    density: float | None,
) -> Screening:
    """Level II is asked for where Q0/Q_A < 2, where the log decrement at Q_A is below 0.1, or
    where 2 <= Q0/Q_A < 10 in region B of the critical speed ratio (R2.6 of the notes).

    q_anticipated Q_A and q_limit Q0 [N/m] (inf: stable over the whole sweep); log_decrement at
    Q_A; speed_ratio N_mc/N_c1 on rigid supports and mean gas density [kg/m^3], None where
    unknown: region B is then assumed and said so.
    """
    reasons = []
    ratio = q_limit / q_anticipated if q_anticipated else math.inf
    if ratio < SCREEN_NEAR:
        reasons.append(f"Q0/Q_A is {ratio:.3g}, below {SCREEN_NEAR:g}")
    if log_decrement < LEAST_LOG_DECREMENT:
        reasons.append(f"log decrement at Q_A is {log_decrement:.3g}, below {LEAST_LOG_DECREMENT}")
    if SCREEN_NEAR <= ratio < SCREEN_FAR:
        if density is None or speed_ratio is None:
            reasons.append(
                f"Q0/Q_A is {ratio:.3g}, below {SCREEN_FAR:g}, and no gas density was given: "
                "region B assumed"
            )
        elif speed_ratio > border_speed_ratio(density):
            reasons.append(
                f"Q0/Q_A is {ratio:.3g}, below {SCREEN_FAR:g}, in region B: speed ratio "
                f"{speed_ratio:.3g} at {density:.3g} kg/m3"
            )
    return Screening(not reasons, tuple(reasons))
