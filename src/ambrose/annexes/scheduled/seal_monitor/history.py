"""What a seal monitor saw: the parameters against time, and what follows from them: trend, range,
pressure, excitation.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.presentation import Presented
from ambrose.identification.parameters import unit_of

_TREND = 6  # windows that a trend needs
_COVERAGE2 = 4.0  # noise is given as half widths: of about two standard deviations


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SealHistory(Presented):
    """A seal's parameters against time; every array over the estimates (b), half widths of 95 %
    intervals.

    time (b,) [s]; values, half_widths, noise, known, change (b, q), SI, NaN where nothing can be
    said; restarts: times [s] of changes faster than ``rate`` [reference/s]; reference (q,), SI;
    limits: per path the range of the tolerances, SI; measured (b,) [Pa]: the pressure that was
    measured beside it.
    """

    machine: str
    seal: str
    paths: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    half_widths: np.ndarray
    noise: np.ndarray
    known: np.ndarray
    change: np.ndarray
    restarts: tuple[float, ...]
    reference: np.ndarray
    rate: float
    window: float
    settling: float
    limits: tuple[tuple[float, float] | None, ...]
    measured: np.ndarray | None
    findings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of every parameter."""
        return tuple(unit_of(path) for path in self.paths)

    def facts(self) -> Mapping[str, Any]:
        """The seal, its last estimate, and what it says."""
        last = (
            [
                f"{value:.4g} +- {half:.2g} {unit}"
                for value, half, unit in zip(
                    self.values[-1], self.half_widths[-1], self.units, strict=True
                )
            ]
            if len(self.time)
            else []
        )
        return {
            "machine": self.machine,
            "seal": self.seal,
            **dict(zip(self.paths, last, strict=False)),
            "findings": self.findings,
        }

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data, SI; null where nothing can be said."""

        def plain(x: np.ndarray) -> list[Any]:
            return [
                [None if not np.isfinite(v) else float(v) for v in row]
                for row in np.atleast_2d(x.T)
            ]

        arrays = {
            name: plain(getattr(self, name))
            for name in ("values", "half_widths", "noise", "known", "change")
        }
        return {
            "machine": self.machine,
            "seal": self.seal,
            "paths": list(self.paths),
            "units": list(self.units),
            "reference": self.reference.tolist(),
            "window_s": self.window,
            "rate_per_s": self.rate,
            "settling_s": self.settling,
            "time_s": self.time.tolist(),
            **arrays,
            "restarts_s": list(self.restarts),
            "limits": [None if limit is None else list(limit) for limit in self.limits],
            "measured_pressure_pa": None if self.measured is None else self.measured.tolist(),
            "findings": list(self.findings),
            "notes": list(self.notes),
        }

    def to_csv(self) -> str:
        """One line per estimate: time, then value and half width of every parameter, SI; empty
        where nothing can be said.
        """
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        names = [f"{path} [{unit}]" for path, unit in zip(self.paths, self.units, strict=True)]
        table.writerow(
            [
                "time [s]",
                *(
                    name
                    for pair in zip(names, [f"+- {n}" for n in names], strict=True)
                    for name in pair
                ),
            ]
        )
        for t, row, half in zip(self.time, self.values, self.half_widths, strict=True):
            pairs = [x for pair in zip(row, half, strict=True) for x in pair]
            table.writerow([f"{t:.6g}", *("" if not np.isfinite(x) else f"{x:.6g}" for x in pairs)])
        return text.getvalue()

    @property
    def known_at(self) -> np.ndarray:
        """Whether something can be said at each time (b,)."""
        return np.isfinite(self.values).all(axis=1)

    def trend(self, i: int = 0) -> tuple[float, float] | None:
        """Slope of the i-th parameter since the last restart and half width (95 %), SI per second;
        None: too short.

        From estimates one window apart, each weighted by its noise, the width by their scatter
        where that is larger; what the model takes as known shifts all of them alike.
        """
        # estimates a window apart, counted back from the last one
        apart = (
            max(1, round(self.window / (self.time[1] - self.time[0]))) if len(self.time) > 1 else 1
        )
        since = self.restarts[-1] + self.window if self.restarts else -np.inf
        at = np.flatnonzero(self.known_at & (self.time > since))[::-1][::apart][::-1]
        if len(at) < _TREND:
            return None

        # x = mean + slope (t - mean t) by least squares, weights 1/noise^2
        t = self.time[at]
        x = self.values[at, i]
        w = 1 / self.noise[at, i] ** 2
        centred = t - np.sum(w * t) / np.sum(w)
        slope = np.sum(w * centred * x) / np.sum(w * centred**2)

        # noise is about two standard deviations: chi^2 of the residuals over n - 2, one at least
        left = x - np.sum(w * x) / np.sum(w) - slope * centred
        misfit = np.sqrt(max(1.0, _COVERAGE2 * np.sum(w * left**2) / (len(at) - 2)))
        return float(slope), float(misfit / np.sqrt(np.sum(w * centred**2)))


def findings_of(history: SealHistory, pressure: float) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What needs attention, and what is good to know; pressure [Pa]: the record's operating
    point's.
    """
    known, time = history.known_at, history.time
    notes = [f"the filters settled for {history.settling:.2g} s before the first estimate"]
    if not known.any():
        return (
            "nothing can be said: the excitation e_<axis> in the record moves the rotor too "
            "little; "
            "add a binary sequence of about 0.02 A to every axis, or record longer",
        ), tuple(notes)
    findings = []
    if not known[-1]:
        findings.append(
            f"nothing can be said after {time[known][-1]:.2f} s: the excitation ended, or is too "
            "small for the noise"
        )
    for t in history.restarts:
        findings.append(
            f"at {t:.2f} s the seal changed faster than {history.rate:g} of its reference per "
            "second; the estimate began anew"
        )
    for i, (path, unit, limit) in enumerate(
        zip(history.paths, history.units, history.limits, strict=True)
    ):
        low, high = (
            history.values[:, i] - history.half_widths[:, i],
            history.values[:, i] + history.half_widths[:, i],
        )
        if limit is not None:
            for outside, side in (
                (known & (low > limit[1]), "above"),
                (known & (high < limit[0]), "below"),
            ):
                if outside.any():
                    findings.append(
                        f"{path} is {side} its range of {limit[0]:.4g} to {limit[1]:.4g} {unit} "
                        f"from {time[outside][0]:.2f} s "
                        "on; what was proved within the tolerances does not hold there"
                    )
        trend = history.trend(i)
        if trend is not None and abs(trend[0]) > trend[1]:
            findings.append(f"{path} changes by {trend[0]:.3g} +- {trend[1]:.2g} {unit} per second")
        if path.endswith(".pressure"):
            measured = (
                np.full(len(time), pressure) if history.measured is None else history.measured
            )
            off = known & ((measured < low) | (measured > high))
            if off.sum() > 0.2 * known.sum():
                worst = int(
                    np.flatnonzero(off)[np.argmax(np.abs(measured - history.values[:, i])[off])]
                )
                findings.append(
                    f"the pressure given, {measured[worst]:.4g} Pa, is outside the estimate of "
                    f"{history.values[worst, i]:.4g} "
                    f"+- {history.half_widths[worst, i]:.2g} Pa at {time[worst]:.2f} s: the seal "
                    "is not as the file has it, or "
                    "the sensor is wrong"
                )
    return tuple(findings), tuple(notes)
