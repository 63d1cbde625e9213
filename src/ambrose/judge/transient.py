"""Response to a short pulse of excitation current: settling time, peak displacements, currents and
forces.

| check | what | unit |
|---|---|---|
| impulse.settling | time after the pulse until all displacements stay in the band | s |
| impulse.displacement_0p | largest measured displacement | m |
| impulse.current_0p | largest control current of the axis nearest to its limit | A |
| impulse.force_0p | largest magnetic force k_i i + k_s q of the axis nearest to its limit | N |

Curves: "impulse.displacement" and "impulse.current", the response to the pulse on the axis that
settles last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.response import pulses
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import information, judge
from ambrose.judge.peaks import Peak
from ambrose.judge.unbalance import axis_limit_check
from ambrose.machine.criteria import CURRENT_PULSE, Pulse, demand
from ambrose.machine.description import Requirements
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients

_STEP = 1e-4  # s; a 550 Hz mode has 18 samples a period
_FIRST_RECORD = 0.25  # s
_LONGEST_RECORD = 4.0  # s


@dataclass(frozen=True, slots=True, eq=False)
class PulseResponse:
    """time (k,) [s] from the start of the pulse; displacement, current and bearing displacement
    (pulsed axis, axis, k).
    """

    time: np.ndarray
    displacement: np.ndarray
    current: np.ndarray
    bearing_displacement: np.ndarray
    pulse: Pulse

    def settling(self) -> np.ndarray:
        """Per pulsed axis the time [s] from the end of the pulse until every displacement stays
        inside the band; inf when it has not, or not for the last tenth of the record.
        """
        size = np.abs(self.displacement)
        outside = (size > self.pulse.band * size.max(axis=(1, 2), keepdims=True)).any(axis=1)
        last = np.where(
            outside.any(axis=1), outside.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1), 0
        )
        settled = np.maximum(self.time[last] - self.pulse.duration, 0.0)
        return np.where(last < 0.9 * len(self.time), settled, np.inf)


def pulse_response(
    closed: StateSpace,
    plant: Plant,
    pulse: Pulse = CURRENT_PULSE,
    longest: float = _LONGEST_RECORD,
) -> PulseResponse:
    """The closed loop's exact response to the pulse on every axis in turn, recorded until it has
    settled (a quarter of a second at least, ``longest`` [s] at most).

    closed: ``law.loop.closed_loop``; sampled loops keep their own sample time. Raises
    NumericalFailure when unstable.
    """
    axes = plant.axes
    outputs = [*plant.named("y"), *plant.named("i"), *plant.bearing_named("q")]
    part = select(closed, [f"e_{axis}" for axis in axes], outputs)
    sampled = c2d(part, _STEP) if part.dt is None else part
    dt = sampled.dt or _STEP
    record = _FIRST_RECORD
    while True:
        samples = int(np.ceil((record + pulse.duration) / dt))
        pulse_samples = max(1, round(pulse.duration / dt))
        answers = pulses(sampled, pulse.amplitude, pulse_samples, samples)
        stacked = answers.reshape(len(axes), 3, len(axes), samples)
        response = PulseResponse(
            np.arange(samples) * dt, stacked[:, 0], stacked[:, 1], stacked[:, 2], pulse
        )
        if record >= longest or np.isfinite(response.settling()).all():
            return response
        record = min(4 * record, longest)


def pulse_checks(
    response: PulseResponse, plant: Plant, requirements: Requirements
) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table."""
    axes, pulse = plant.axes, response.pulse
    settling = response.settling()
    worst = int(np.argmax(settling))
    words = (
        f"{pulse.amplitude:g} A for {pulse.duration * 1e3:g} ms on one axis after the other, band "
        f"{pulse.band:.0%}"
    )
    open_end = (
        "" if np.isfinite(settling[worst]) else f"; not settled after {response.time[-1]:.3g} s"
    )
    k_i, k_s = magnet_coefficients(plant.machine, plant.point)
    force = k_i[:, None] * response.current + k_s[:, None] * response.bearing_displacement
    largest = np.abs(response.displacement).max(axis=2)
    at = np.unravel_index(np.argmax(largest), largest.shape)
    checks = [
        judge(
            "impulse.settling",
            "Settling time after a current pulse",
            settling[worst],
            "s",
            demand("settling time", requirements),
            f"pulse on {axes[worst]}: {words}{open_end}",
        ),
        information(
            "impulse.displacement_0p",
            "Largest displacement after a current pulse",
            largest[at],
            "m",
            f"axis {axes[at[1]]}, pulse on {axes[at[0]]}",
        ),
        axis_limit_check(
            plant,
            "impulse.current_0p",
            "Largest control current after a current pulse",
            _peaks(response.current),
            requirements,
        ),
        axis_limit_check(
            plant,
            "impulse.force_0p",
            "Largest magnetic force after a current pulse",
            _peaks(force),
            requirements,
        ),
    ]
    curves = [
        Curve(
            f"impulse.{name}",
            f"{title}, pulse on {axes[worst]}",
            "time",
            response.time,
            values[worst],
            axes,
            "s",
            unit,
        )
        for name, title, values, unit in (
            ("displacement", "Displacement", response.displacement, "m"),
            ("current", "Control current", response.current, "A"),
        )
    ]
    return checks, curves


def _peaks(values: np.ndarray) -> list[Peak]:
    """Largest modulus per axis of values (pulsed axis, axis, k)."""
    return [Peak(float(value), np.nan, False) for value in np.abs(values).max(axis=(0, 2))]
