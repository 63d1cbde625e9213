"""What the campaigns of P4 and P5 find, as text with the truth beside it (campaign_p4.py)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.identification.seal.by_pressure import COEFFICIENTS, SealFit
from benchmarks.campaign_p4_results import (
    BAR,
    HZ,
    NOMINAL,
    Columns,
    Coupled,
    Impulses,
    Stepped,
    Swept,
    truth,
)


def chirps(found: Sequence[Swept]) -> str:
    lines = [
        "P4.1 chirp 0-150 Hz against models, within 2 % and 1.1 degrees (plus the measurement's "
        "own 95 %)"
    ]
    for item in found:
        f = item.measured.omega / HZ
        for name, validity in item.validity.items():
            size, angle = (
                np.abs(np.abs(validity.ratio[:, 0, 0]) - 1),
                np.degrees(np.abs(np.angle(validity.ratio[:, 0, 0]))),
            )
            at = [int(np.argmin(np.abs(f - x))) for x in (30, 60, 100, 140)]
            errors = ", ".join(f"{100 * size[i]:.2f} % {angle[i]:.2f} deg" for i in at)
            lines.append(
                f"  {item.axis:4s} {name:27s} valid to {validity.valid_to[0, 0] / HZ:5.1f} Hz; at "
                f"30, 60, 100, 140 Hz: {errors}"
            )
            ends = ", ".join(f"{100 * t:g} %: {hz:.0f} Hz" for t, hz in item.limits[name].items())
            lines.append(f"  {item.axis:4s} {name:27s} valid to, by tolerance: {ends}")
        c = item.measured.coherence
        lines.append(
            f"  {item.axis:4s} coherence direct {c[:, 0].min():.3f} (least) "
            f"{np.median(c[:, 0]):.3f} (median), cross "
            f"{c[:, 1].min():.2f}, {np.median(c[:, 1]):.2f}; cross over direct response "
            f"{np.median(np.abs(item.measured.values[:, 1, 0] / item.measured.values[:, 0, 0])):.3f}"
        )
    return "\n".join(lines)


def cosines(found: Columns) -> str:
    lines = [
        "P4.2, P4.7 K_i and K_s from parallel PRBS: column cosine (what P4 prints) and parameter "
        "correlation from (J'J)^-1",
        "  bit [ms]  K_i-K_s of one axis (A_zeta .. B_eta)     K_iA-K_iB  K_sA-K_sB  across axes "
        "| correlation of K_i-K_s",
    ]
    for bit_time, results in found.items():
        for result, what in zip(results, ("y", "y, i", "i"), strict=True):
            J, R = result.column_cosine, result.correlation
            own = " ".join(f"{J[i, 4 + i]:6.3f}" for i in range(4))
            across = max(abs(J[i, j]) for i in (0, 2, 4, 6) for j in (1, 3, 5, 7))
            lines.append(
                f"  {1e3 * bit_time:4g} {what:5s} {own}   {J[0, 2]:6.3f}   {J[4, 6]:6.3f}   "
                f"{across:.4f} | " + " ".join(f"{R[i, 4 + i]:6.3f}" for i in range(4))
            )
    lines.append("  printed: -0.95 to -0.96, K_iA-K_iB -0.08, K_sA-K_sB -0.09, across axes 0.00")
    return "\n".join(lines)


def coupling(found: Coupled) -> str:
    lines = ["P4.3 coupling stiffness [N/m], truth 400e3 and 420e3 (as printed)"]
    for name, item in (
        ("bearings known from a record without coupling", found.separate),
        ("bearings as in the machine file (no weight)", found.untrue_bearings),
        ("bearings and coupling from one record", found.at_once),
    ):
        values, sd = item.values[-2:] / 1e3, item.standard_deviations[-2:] / 1e3
        lines.append(
            f"  {name:46s} {values[0]:6.1f} +- {sd[0]:4.1f}, {values[1]:6.1f} +- {sd[1]:4.1f} e3; "
            f"{item.verdict[:52]}"
        )
    J = found.at_once.column_cosine
    lines.append(
        f"  column cosine of K_s at A and coupling, all in one record: {J[4, 8]:.3f}, {J[5, 9]:.3f}"
    )
    return "\n".join(lines)


def stepped(found: Stepped) -> str:
    lines = [
        "P4.4 seal from stepped sines (both directions, reference without pressure taken off), +- "
        "1 sd; truth below"
    ]
    for pressure in found.fit.pressures:
        rows = found.fit.at(pressure)
        for row in range(len(rows)):
            lines.append(
                f"  {pressure / BAR:.1f} bar {rows.frequency[row] / HZ:5.0f} Hz "
                + _four(rows.values[row], rows.deviations[row])
            )
        constant = found.constants.at(pressure)
        lines.append(
            f"  {pressure / BAR:.1f} bar to 100 Hz "
            + _four(constant.values[0], constant.deviations[0])
        )
        lines.append(f"  {pressure / BAR:.1f} bar  truth    " + _four(truth(pressure), None))
        k = rows.values[rows.frequency < 100.1 * HZ, 1]
        lines.append(
            f"           spread of k to 100 Hz: {100 * np.ptp(k) / k.mean():.1f} % of its mean"
        )
    lines.append(
        "P4.6 response of the middle along the excitation, peak over the value at the lowest "
        "frequency; constant model"
    )
    for pressure, measured in found.measured.items():
        size = np.abs(measured.values)
        direct, cross = size[:, 0, 0] / size[0, 0, 0], size[:, 1, 0] / size[0, 0, 0]
        at = measured.omega[direct.argmax()] / HZ
        text = (
            f"  {pressure / BAR:.1f} bar: direct {direct.max():.2f} at {at:.0f} Hz, cross "
            f"{cross.max():.2f}"
        )
        if pressure in found.model:
            error = np.abs(found.model[pressure].values - measured.values) / size[:, :1, :1]
            low = measured.omega < 100.1 * HZ
            text += (
                f"; model within {100 * error[low].max():.1f} % of the direct response to 100 Hz"
            )
        lines.append(text)
    return "\n".join(lines)


def _four(values: np.ndarray, deviations: np.ndarray | None) -> str:
    parts = []
    for i, letter in enumerate(COEFFICIENTS):
        scale, digits = (1e-3, 1) if i < 2 else (1.0, 0)
        spread = "" if deviations is None else f" +- {scale * deviations[i]:6.{digits}f}"
        parts.append(f"{letter} {scale * values[i]:9.{digits}f}{spread}")
    return "  ".join(parts) + "  [kN/m, N s/m]"


def correlations(found: dict[float, dict[float, np.ndarray]], pair: tuple[SealFit, SealFit]) -> str:
    lines = ["P4.5 column cosines, sine along zeta, time domain (printed at 40 Hz: at most 0.04)"]
    for frequency, pressure, J in ((f, p, J) for f, each in found.items() for p, J in each.items()):
        pairs = {
            "K-C": J[0, 1],
            "K-k": J[0, 2],
            "K-c": J[0, 3],
            "C-k": J[1, 2],
            "C-c": J[1, 3],
            "k-c": J[2, 3],
        }
        lines.append(
            f"  {frequency:3.0f} Hz {pressure / BAR:.1f} bar: "
            + ", ".join(f"{name} {value:6.3f}" for name, value in pairs.items())
        )
    for name, fit in zip(
        ("zeta, then eta", "forward, then stronger backward whirl"), pair, strict=True
    ):
        lines.append(
            f"  at 1.2 bar, {name}: K-c {fit.cosine[0][0, 3]:.3f}; sd of "
            + _four(fit.deviations[0], None)
        )
    return "\n".join(lines)


def impulses(found: Impulses) -> str:
    lines = [
        "P5.1 impulses: fit of the model to the mean response (A_zeta, A_eta, B_zeta, B_eta), peaks"
    ]
    for pressure, (_, y, model) in found.responses.items():
        fits = [
            100 * (1 - np.linalg.norm(a - b) / np.linalg.norm(a - a.mean()))
            for a, b in zip(y, model, strict=True)
        ]
        peaks = 1e6 * np.abs(model).max(axis=1)
        lines.append(
            f"  {pressure / BAR:.2f} bar: fit "
            + " ".join(f"{x:5.1f}" for x in fits)
            + " %; peaks "
            + " ".join(f"{x:5.2f}" for x in peaks)
            + " um"
        )
    lines.append("P5.2 coefficients against pressure")
    for pressure, values, deviations in zip(
        found.fit.pressure, found.fit.values, found.fit.deviations, strict=True
    ):
        lines.append(f"  {pressure / BAR:.2f} bar " + _four(values, deviations))
        lines.append("   truth    " + _four(truth(pressure), None))
    for i, (letter, line) in enumerate(found.lines.items()):
        at, half = float(line.at(NOMINAL)), float(line.confidence(NOMINAL))
        relative = f"{100 * half / abs(at):.1f} % of it"
        lines.append(
            f"  {letter} at 2.04 bar: {at:.4g} +- {half:.2g} (95 %, {relative}); truth "
            f"{truth(NOMINAL)[i]:.4g}; "
            f"r^2 {line.r_squared:.4f}, no slope with probability {line.slope_probability:.1g}"
        )
    return "\n".join(lines)


def misjudged(found: dict[str, SealFit]) -> str:
    """What a wrong amplifier does to the coefficients, and what is left of it."""
    lines = [
        "Amplifier's damping misjudged (0.9 of its natural frequency, truth 1.17), 1.2 bar: C [N "
        "s/m]"
    ]
    for currents, fit in found.items():
        at = ", ".join(f"{f:.0f}" for f in fit.frequency / HZ)
        apparent = " ".join(f"{x:6.0f}" for x in fit.systematic[:, 2])
        left = " ".join(f"{x:5.0f}" for x in fit.values[:, 2] - truth(float(fit.pressures[0]))[2])
        lines.append(
            f"  {currents} currents, {at} Hz: without pressure {apparent}; error after taking it "
            f"off {left}"
        )
    return "\n".join(lines)
