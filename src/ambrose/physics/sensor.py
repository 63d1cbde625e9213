"""Displacement sensors, linear view: displacement at the sensor's position to the measured signal."""

from __future__ import annotations

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
