"""Displacement sensors: displacement at the sensor's position to the measured signal; linear, and as the rig's.

The rig's signal: gain (displacement + run-out) + offset, then the lag, then noise, then the converter's steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, check_positive
from ambrose.core.statespace import StateSpace
from ambrose.machine.description import Sensor


def linearised(sensors: Sequence[Sensor], axes: Sequence[str]) -> StateSpace:
    """Gains and first-order lags: inputs ``s_<axis>`` [m] at the sensors' positions, outputs ``y_<axis>`` [m].

    axes: ``<bearing>_zeta`` and ``<bearing>_eta`` in the order of the signals, as in Machine.axes. Every lag's state is its
    output. Raises InvalidInput for an axis without a sensor or with two, and for a bandwidth that is not positive.
    """
    gains, lags = [], []
    for axis in axes:
        bearing, _, direction = axis.rpartition("_")
        serving = [sensor for sensor in sensors if sensor.bearing == bearing]
        if len(serving) != 1 or direction not in _INDEX:
            raise InvalidInput(
                f"axis {axis!r} has {len(serving)} sensors, but must have one; give each bearing one sensor (axes zeta, eta)"
            )
        sensor = serving[0]
        gains.append(float(check_finite(sensor.gain[_INDEX[direction]], f"the sensor gain of axis {axis}")))
        if sensor.bandwidth is not None:
            name = f"the sensor bandwidth [rad/s] of bearing {bearing}"
            lags.append(check_positive(sensor.bandwidth, name, "leave it out for a sensor without lag"))
        else:
            lags.append(np.inf)
    gain, lag = np.array(gains), np.array(lags)
    slow = np.isfinite(lag)
    states = np.eye(len(axes))[slow]
    return StateSpace(
        np.diag(-lag[slow]), states * np.where(slow, lag * gain, 0.0), states.T, np.diag(np.where(slow, 0.0, gain)),
        [f"s_{axis}" for axis in axes], [f"y_{axis}" for axis in axes],
    )  # fmt: skip


_INDEX = {"zeta": 0, "eta": 1}


def parameters(sensor: Sensor, direction: str) -> tuple[float, ...]:
    """What the functions below need of one axis, "zeta" or "eta".

    (gain [-], offset [m], bandwidth [rad/s] or 0 for none, resolution [m] or 0 for none, noise [m] rms, angle of the axis
    from zeta [rad]).
    """
    axis = _INDEX[direction]
    bandwidth = 0.0 if sensor.bandwidth is None else sensor.bandwidth
    return (sensor.gain[axis], sensor.offset[axis], bandwidth, sensor.resolution, sensor.noise, axis * math.pi / 2)


def harmonics(sensor: Sensor) -> np.ndarray:
    """The run-out as an array (h, 3): order [-], amplitude [m], phase [rad]; (0, 3) for a perfect sensor track."""
    return np.array([(r.order, r.amplitude, r.phase) for r in sensor.runout], dtype=float).reshape(-1, 3)


def runout(angle: float, profile: np.ndarray, p: tuple[float, ...]) -> float:
    """Run-out [m] that an axis sees at a spin angle [rad] measured from its bearing's zeta; profile from ``harmonics``.

    An axis a quarter turn ahead sees the same surface a quarter turn later. Compiles with numba as it stands.
    """
    total = 0.0
    for k in range(profile.shape[0]):
        total += profile[k, 1] * math.cos(profile[k, 0] * (angle - p[5]) + profile[k, 2])
    return total


def indicated(displacement: float, p: tuple[float, ...]) -> float:
    """The signal [m] before the lag, from the displacement plus run-out [m]. Compiles with numba as it stands."""
    return p[0] * displacement + p[1]


def lag(signal: float, state: float, p: tuple[float, ...]) -> float:
    """Derivative [m/s] of the lag's state [m], which is its output; without a lag 0, and the output is ``signal`` itself.

    Compiles with numba as it stands.
    """
    return p[2] * (signal - state)


def sampled(signal: float, p: tuple[float, ...]) -> float:
    """What the converter gives [m] for a signal [m] (noise included): the nearest step. Compiles with numba as it stands."""
    return p[3] * math.floor(signal / p[3] + 0.5) if p[3] > 0.0 else signal
