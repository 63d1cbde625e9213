"""Displacement sensors: displacement at the sensor's position to the measured signal; linear, and
as the rig's.

The rig's signal: gain (displacement + run-out) + offset, then the lag, then noise, then the
converter's steps.
"""

import math
from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, check_positive
from ambrose.core.statespace import StateSpace
from ambrose.machine.part import Sensor


def linearised(sensors: Sequence[Sensor], axes: Sequence[str]) -> StateSpace:
    """Gains, first-order lags and means: inputs ``s_<channel>`` [m] at the sensors (``channels``),
    outputs ``y_<axis>`` [m].

    axes: ``<bearing>_zeta`` and ``<bearing>_eta`` in the order of the signals, as in Machine.axes;
    sensors as in Machine.sensor_pairs. Every lag has its state. Raises InvalidInput for an axis
    without a sensor, and for a bandwidth that is not positive.
    """
    gains = []
    lags = []
    rows = channels(sensors, axes)
    for name, sensor, axis in rows:
        gains.append(float(check_finite(sensor.gain[axis], f"the sensor gain of axis {name}")))
        if sensor.bandwidth is not None:
            place = f"the sensor bandwidth [rad/s] of bearing {sensor.bearing}"
            lags.append(
                check_positive(sensor.bandwidth, place, "leave it out for a sensor without lag")
            )
        else:
            lags.append(np.inf)
    gain = np.array(gains)
    lag = np.array(lags)
    mean = means(sensors, axes)
    slow = np.isfinite(lag)
    states = np.eye(len(rows))[slow]
    return StateSpace(
        np.diag(-lag[slow]),
        states * np.where(slow, lag * gain, 0.0),
        mean @ states.T,
        mean * np.where(slow, 0.0, gain),
        [f"s_{name}" for name, *_ in rows],
        [f"y_{axis}" for axis in axes],
    )


def channels(sensors: Sequence[Sensor], axes: Sequence[str]) -> tuple[tuple[str, Sensor, int], ...]:
    """Name, pair and direction (0: at the pair's angle, 1: a quarter turn on) of every single
    sensor, in the order of ``axes``.

    The first pair's are named after the axes, those of the second A_zeta.2 and A_eta.2. Raises
    InvalidInput.
    """
    rows: list[tuple[str, Sensor, int]] = []
    for bearing in dict.fromkeys(axis.rpartition("_")[0] for axis in axes):
        of_bearing = [axis for axis in axes if axis.rpartition("_")[0] == bearing]
        serving = [sensor for sensor in sensors if sensor.bearing == bearing]
        for axis in of_bearing:
            if not serving or axis.rpartition("_")[2] not in _INDEX:
                raise InvalidInput(
                    f"axis {axis!r} has no sensor; give each bearing a [[sensor]] (axes zeta, eta)"
                )
        for k, sensor in enumerate(serving):
            rows += [
                (axis + (f".{k + 1}" if k else ""), sensor, _INDEX[axis.rpartition("_")[2]])
                for axis in of_bearing
            ]
    return tuple(rows)


def means(sensors: Sequence[Sensor], axes: Sequence[str]) -> np.ndarray:
    """The controller's signals from the single sensors', (axes, channels): by weight, turned to
    each bearing's first pair.
    """
    rows = channels(sensors, axes)
    result = np.zeros((len(axes), len(rows)))
    for i, axis in enumerate(axes):
        of_axis = [
            (j, item, way)
            for j, (_, item, way) in enumerate(rows)
            if item.bearing == axis.rpartition("_")[0]
        ]
        # weights of one direction of all pairs
        total = sum(item.weight for _, item, way in of_axis if way == of_axis[0][2])
        for j, item, way in of_axis:
            # signals of a turned pair in the first pair's directions
            turned = (item.angle or 0.0) - (of_axis[0][1].angle or 0.0)
            result[i, j] = (
                item.weight / total * rotation(turned)[_INDEX[axis.rpartition("_")[2]], way]
            )
    return result


def rotation(angle: float) -> np.ndarray:
    """(2, 2): components along two directions from those along directions that are turned by
    ``angle`` [rad] from them.
    """
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


# the axis along the shaft has one direction
_INDEX = {"zeta": 0, "eta": 1, "z": 0}


def parameters(sensor: Sensor, axis: int) -> tuple[float, ...]:
    """What the functions below need of one sensor of the pair, 0 or 1.

    (gain [-], offset [m], bandwidth [rad/s] or 0 for none, resolution [m] or 0 for none, noise [m]
    rms, angle of the axis from the pair's first one [rad]).
    """
    bandwidth = 0.0 if sensor.bandwidth is None else sensor.bandwidth
    return (
        sensor.gain[axis],
        sensor.offset[axis],
        bandwidth,
        sensor.resolution,
        sensor.noise,
        axis * math.pi / 2,
    )


def harmonics(sensor: Sensor) -> np.ndarray:
    """The run-out as an array (h, 3): order [-], amplitude [m], phase [rad]; (0, 3) for a perfect
    sensor track.
    """
    return np.array([(r.order, r.amplitude, r.phase) for r in sensor.runout], dtype=float).reshape(
        -1, 3
    )


def runout_phasors(sensors: Sequence[Sensor], axes: Sequence[str], order: int = 1) -> np.ndarray:
    """The run-out in the measured signals (axes,) [m] as phasors on exp(j order angle), of the spin
    angle from the global x.
    """
    # cos(n (angle - pair - way pi/2) + phase)
    phasors = [
        sum(
            amplitude * np.exp(1j * (phase - order * ((sensor.angle or 0.0) + way * math.pi / 2)))
            for n, amplitude, phase in harmonics(sensor)
            if n == order
        )
        * sensor.gain[way]
        for _, sensor, way in channels(sensors, axes)
    ]
    return np.asarray(means(sensors, axes) @ np.array(phasors, complex))


def runout(angle: float, profile: np.ndarray, p: tuple[float, ...]) -> float:
    """Run-out [m] that an axis sees at a spin angle [rad] measured from its pair's angle; profile
    from ``harmonics``.

    An axis a quarter turn ahead sees the same surface a quarter turn later. Compiles with numba as
    it stands.
    """
    total = 0.0
    for k in range(profile.shape[0]):
        total += profile[k, 1] * math.cos(profile[k, 0] * (angle - p[5]) + profile[k, 2])
    return total


def indicated(displacement: float, p: tuple[float, ...]) -> float:
    """The signal [m] before the lag, from the displacement plus run-out [m]. Compiles with numba as
    it stands.
    """
    return p[0] * displacement + p[1]


def lag(signal: float, state: float, p: tuple[float, ...]) -> float:
    """Derivative [m/s] of the lag's state [m], which is its output; without a lag 0, and the output
    is ``signal`` itself.

    Compiles with numba as it stands.
    """
    return p[2] * (signal - state)


def sampled(signal: float, p: tuple[float, ...]) -> float:
    """What the converter gives [m] for a signal [m] (noise included): the nearest step. Compiles
    with numba as it stands.
    """
    return p[3] * math.floor(signal / p[3] + 0.5) if p[3] > 0.0 else signal
