"""What a scenario does to the virtual rig, one stretch of control samples after the other, so that
memory does not grow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ambrose.core.checks import invalid
from ambrose.law.law import PRESSURE, SPEED, Scheduling
from ambrose.machine.attachment import attached
from ambrose.machine.part import Seal
from ambrose.machine.units import meant, suggestion
from ambrose.model.assemble import seal_poles
from ambrose.model.effect import joined, reactions
from ambrose.model.effects import seal, seal_rational
from ambrose.rig.engine.state import Rig, in_rows
from ambrose.rig.linear import directions, sample_of, waveforms, without_power
from ambrose.rig.scenario import Scenario, sensed

_SEAL_GRID = 50  # samples between the points at which a varying operating point is looked up


class Drive(NamedTuple):
    """K control samples; nodes are their K + 1 ends. a axes, p modes per plane."""

    dt: float  # control sample time [s]
    speed: np.ndarray  # (K + 1,) [rad/s]
    angle: np.ndarray  # (K + 1,) [rad]
    # (K + 1 or 1, seals, 5 + 2 l) K, k, C, c, M, then direct and cross of every state
    seal: np.ndarray
    # (K or 1, p, p) with the added mass of seals and effects, (0, p, p) where there is none
    mass_inverse: np.ndarray
    reaction: np.ndarray  # (K + 1 or 1, 2 t + e, 4 t + e) of registered effects
    # (p, 2) modal, along x and y at angle zero [kg m/sqrt(kg)]; (0, 2) where there is none
    unbalance: np.ndarray
    force: np.ndarray  # (4, m, K) cubics of the driven forces [N]
    force_at: np.ndarray  # (m, 2) station and axis of each
    powered: np.ndarray  # (a, K) 1 with power, 0 without
    excitation: np.ndarray  # (a, K) [A]
    reference: np.ndarray  # (a, K) [m]
    disturbance: np.ndarray  # (a, K) of the measurement [m]
    # (c, K) at the single sensors [m], with the disturbance that they would have to see
    noise: np.ndarray
    pressure: np.ndarray  # (K,) as its sensor tells it [Pa], the last one where it is lost
    # (K, d) what a program is told, speed [rad/s], that pressure or both, NaN where it is lost
    told: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A scenario on a rig: dt [s] of the control samples, how many of them, the sources of noise
    (of position and of pressure sensors), what a program is told.
    """

    rig: Rig
    scenario: Scenario
    dt: float
    samples: int
    noise: np.random.Generator
    pressure_noise: np.random.Generator
    along: Scheduling = SPEED

    @property
    def inputs(self) -> list[str]:
        """All signals that a scenario may drive."""
        return [f"{kind}_{a}" for kind in "edr" for a in self.rig.axes] + [
            f"f_{p}" for p in self.rig.port_names
        ]

    @property
    def driven(self) -> list[str]:
        """Those that this one does drive, other than by unbalance."""
        named = {item.signal for item in self.scenario.all_windows}
        return [name for name in self.inputs if name in named]

    @property
    def switch(self) -> int:
        """The sample at which the second controller takes over; past the end without one."""
        at = self.scenario.switch_at
        return self.samples if at is None else sample_of(at, self.dt)

    def speeds(self, time: np.ndarray) -> np.ndarray:
        """Speed [rad/s] at times (n,) [s]."""
        return np.interp(time, *self._speed_knots)

    def angles(self, time: np.ndarray) -> np.ndarray:
        """Spin angle [rad] at times (n,) [s]."""
        times, speeds = self._speed_knots
        # trapezoids: the speed is linear between its knots
        turned = np.concatenate([[0.0], np.cumsum(np.diff(times) * (speeds[1:] + speeds[:-1]) / 2)])
        k = np.searchsorted(times, time, side="right") - 1
        return np.asarray(turned[k] + (time - times[k]) * (speeds[k] + self.speeds(time)) / 2)

    @property
    def _speed_knots(self) -> tuple[np.ndarray, np.ndarray]:
        times, speeds = self.scenario.speed_knots
        return (
            (np.array(times), np.array(speeds))
            if times
            else (np.zeros(1), np.array([self.rig.point.speed]))
        )

    def pressures(self, time: np.ndarray) -> np.ndarray:
        """Seal pressure [Pa] at times (n,) [s]; a change without ramp takes one sample."""
        return np.interp(time, *self._pressure_knots)

    @property
    def _pressure_knots(self) -> tuple[list[float], list[float]]:
        return self.scenario.pressure_knots(self.rig.point.seal_pressure, self.dt)

    def measured(self, first: int, count: int) -> np.ndarray:
        """The pressure as its sensor tells it (count,) [Pa] at the samples from ``first`` on; in
        order, for its noise.
        """
        time = (first + np.arange(count)) * self.dt
        sensors = self.scenario.pressure_sensors
        if not sensors:
            return self.pressures(time)
        measured = sensed(time, sensors, *self._pressure_knots)
        noise = np.array([0.0, *(0.0 if item.fault else item.noise for item in sensors)])
        if noise.any():
            measured = measured + noise[self._sensor(time)] * self.pressure_noise.standard_normal(
                count
            )
        return measured

    def lost(self, first: int, count: int) -> np.ndarray:
        """Whether the pressure's sensor tells nothing (count,)."""
        faults = np.array(
            [False, *(item.fault == "lost" for item in self.scenario.pressure_sensors)]
        )
        return np.asarray(faults[self._sensor((first + np.arange(count)) * self.dt)])

    def _sensor(self, time: np.ndarray) -> np.ndarray:
        """Which sensor tells the pressure (n,): 0 before the first."""
        return np.searchsorted(
            [item.time for item in self.scenario.pressure_sensors], time, side="right"
        )


def plan(rig: Rig, scenario: Scenario, dt: float, seed: int, along: Scheduling = SPEED) -> Plan:
    """The scenario on the rig at a control sample time [s]. Raises InvalidInput for signals, ports
    or axes it has not.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise invalid(
            "seed", repr(seed), "a whole number, zero or more", "0 is as good as any other"
        )
    count = int(min(scenario.duration / dt, 1e15) + 1e-6) + 1
    result = Plan(
        rig,
        scenario,
        dt,
        count,
        np.random.default_rng(seed),
        np.random.default_rng([seed, 1]),
        along,
    )
    for item in scenario.all_windows:
        if item.signal not in result.inputs:
            alike = [
                name
                for name in result.inputs
                if name.partition("_")[0] == item.signal.partition("_")[0]
            ]
            known = f"one of the inputs {', '.join(alike or result.inputs)}"
            close = meant(item.signal, result.inputs)
            remedy = f'did you mean "{close}"?' if close else "correct its name"
            raise invalid(f"the signal {item.signal!r}", "unknown", known, remedy)
    for failure in scenario.failures:
        if failure.axis is not None and failure.axis not in rig.axes:
            raise invalid(
                "the axis of a failure",
                repr(failure.axis),
                "a control axis",
                suggestion(failure.axis, rig.axes),
            )
    return result


def stretch(plan: Plan, first: int, count: int) -> Drive:
    """The control samples first .. first + count - 1; call them in order, for the noise's sake.
    Raises InvalidInput.
    """
    rig = plan.rig
    scenario = plan.scenario
    dt = plan.dt
    nodes = np.arange(first, first + count + 1) * dt
    speed = plan.speeds(nodes)
    names, c = waveforms(scenario, plan.inputs, dt, count, first=first, turning=False)
    rows = {name: c[:, i] for i, name in enumerate(names)}

    def held(kind: str) -> np.ndarray:
        return np.array(
            [
                rows[f"{kind}_{axis}"][0] if f"{kind}_{axis}" in rows else np.zeros(count)
                for axis in rig.axes
            ]
        )

    forces = [i for i, port in enumerate(rig.port_names) if f"f_{port}" in rows]
    sigma, disturbance = rig.constants.sensor[:, 4], held("d")
    noise = (
        plan.noise.standard_normal((count, len(sigma))).T * sigma[:, None]
        if sigma.any()
        else np.zeros((len(sigma), count))
    )
    noise += _spread(rig.constants.mean) @ disturbance
    coefficients, pressure = _seals(plan, first, nodes, speed), plan.measured(first, count)
    drive = Drive(
        dt,
        speed,
        plan.angles(nodes),
        coefficients,
        _mass_inverse(rig, coefficients),
        _reactions(plan, first, nodes, speed),
        _unbalance(plan),
        np.stack([rows[f"f_{rig.port_names[i]}"] for i in forces], axis=1)
        if forces
        else np.zeros((4, 0, count)),
        np.array([divmod(i, 2) for i in forces], dtype=np.int64).reshape(-1, 2),
        _powered(plan, first, count),
        held("e"),
        held("r"),
        disturbance,
        noise,
        pressure,
        np.stack(
            [
                np.where(plan.lost(first, count), np.nan, pressure)
                if one is PRESSURE
                else speed[:-1]
                for one in plan.along.each
            ],
            axis=1,
        ),
    )
    return in_rows(drive)


def _spread(mean: np.ndarray) -> np.ndarray:
    """(c, a): what every sensor sees of a disturbance of the measurement, so that the mean sees it
    whole.
    """
    weight = np.linalg.norm(mean, axis=0)
    return np.asarray((mean / np.where(weight > 0, weight, 1.0)).T)


def _powered(plan: Plan, first: int, count: int) -> np.ndarray:
    """``Drive.powered``, (a, count)."""
    powered = np.ones((len(plan.rig.axes), count))
    for failure in plan.scenario.failures:
        axis = slice(None) if failure.axis is None else plan.rig.axes.index(failure.axis)
        powered[axis, without_power(failure, plan.dt, first, count)] = 0.0
    return powered


def _unbalance(plan: Plan) -> np.ndarray:
    """``Drive.unbalance``, (p, 2): masses times radius at their angles, on the modes."""
    rig = plan.rig
    if not plan.scenario.unbalances:
        return np.zeros((0, 2))
    total = np.zeros((rig.modes, 2))
    for item in plan.scenario.unbalances:
        station = (
            rig.port_names.index(directions(item.port, plan.inputs)[0].removeprefix("f_")) // 2
        )
        # from x: the station's first axis is turned by its angle
        phase = item.phase + rig.constants.angle[station]
        amount = item.mass_times_radius(rig.mass)
        total += amount * np.outer(rig.constants.shape[station], [np.cos(phase), np.sin(phase)])
    return total


def _seals(plan: Plan, first: int, nodes: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Coefficients (nodes or 1, seals, 5 + 2 l) from sample ``first`` on, looked up at every so
    many-th sample since the start, where the pressure bends, and linear between.
    """
    machine = plan.rig.machine
    lags = plan.rig.constants.seal_lags.shape[1]
    whirl = plan.rig.point.whirl_frequency
    seals = machine.seals
    poles = [seal_poles(machine, s) if seal_rational.has_states(s) else np.zeros(0) for s in seals]
    pressure = plan.pressures(nodes)
    constant = np.ptp(pressure) == 0 and (
        np.ptp(speed) == 0 or all(item.table is None and item.geometry is None for item in seals)
    )
    if constant or not seals:
        at = [
            _coefficients(s, p, float(pressure[0]), float(speed[0]), whirl, lags)
            for s, p in zip(seals, poles, strict=True)
        ]
        return np.array(at, dtype=float).reshape(1, len(seals), 5 + 2 * lags)
    result = np.empty((len(nodes), len(seals), 5 + 2 * lags))
    for i, item in enumerate(seals):
        result[:, i] = _over_time(
            plan,
            first,
            len(nodes),
            lambda p, v, i=i, item=item: _coefficients(item, poles[i], p, v, whirl, lags),  # type: ignore[misc]
        )
    return result


def _over_time(
    plan: Plan,
    first: int,
    count: int,
    row: Callable[[float, float], Sequence[float] | np.ndarray],
) -> np.ndarray:
    """``row`` of pressure [Pa] and speed [rad/s] (count, len(row)) at the nodes from sample
    ``first`` on: looked up at every so many-th sample since the start, where the pressure bends,
    and linear between.
    """
    # the grid starts at sample 0, whatever piece is asked for
    before, after = first % _SEAL_GRID, -(first + count - 1) % _SEAL_GRID
    time = np.arange(first - before, first + count + after) * plan.dt
    pressure, speed = plan.pressures(time), plan.speeds(time)

    # and at the pressure's corners, where its second difference is not zero
    kinks = np.flatnonzero(np.abs(np.diff(pressure, 2)) > 1e-9 * np.abs(pressure).max()) + 1
    grid = np.unique([*range(0, len(time), _SEAL_GRID), *kinks])
    rows = np.array([row(float(pressure[g]), float(speed[g])) for g in grid])
    nodes = np.arange(before, before + count)
    return np.column_stack([np.interp(nodes, grid, column) for column in rows.T])


def _reactions(plan: Plan, first: int, nodes: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """The block of ``Constants.reaction`` (nodes or 1, 2 t + e, 4 t + e) over time."""
    machine, shape = plan.rig.machine, plan.rig.constants.reaction.shape

    def row(pressure: float, speed: float) -> np.ndarray:
        point = replace(plan.rig.point, seal_pressure=pressure, speed=speed)
        return joined([item for _, item in reactions(machine, point)]).block().ravel()

    effects = [effect for effect, _ in attached(machine)]
    pressure = plan.pressures(nodes)
    steady = np.ptp(speed) == 0 and np.ptp(pressure) == 0
    if not any(effect.over_speed for effect in effects):
        return plan.rig.constants.reaction[None]
    if steady:
        return row(float(pressure[0]), float(speed[0])).reshape(1, *shape)
    return _over_time(plan, first, len(nodes), row).reshape(-1, *shape)


def _coefficients(
    item: Seal, poles: np.ndarray, pressure: float, speed: float, whirl: float | None, lags: int
) -> list[float]:
    """One row: coefficients at the whirl frequency, or the model of a seal with states on given
    poles.
    """
    row = np.zeros(5 + 2 * lags)
    if seal_rational.has_states(item):
        model = seal_rational.rational(item, pressure, speed, poles)
        row[:5] = seal.parameters(model.static)
        row[5 : 5 + model.n_states] = np.column_stack([model.direct, model.cross]).ravel()
    else:
        row[:5] = seal.parameters(seal.coefficients(item, pressure, speed, whirl))
    return row.tolist()


def _mass_inverse(rig: Rig, coefficients: np.ndarray) -> np.ndarray:
    """(I + sum M phi phi^T)^-1 in the middle of every sample; M the seals' added masses.

    Of one plane, (p, p); of all coordinates, (n, n), where such a seal is on a support or a
    registered effect has mass.
    """
    p = rig.modes
    added = coefficients[:, :, 4]
    more = rig.constants.reaction_mass
    if not (added.any() or more.any()):
        return np.zeros((0, p, p))
    first = len(rig.machine.bearings) + rig.attached_stations
    shape = rig.constants.shape[first : first + added.shape[1]]

    # in the middle of a sample: the mean of its ends
    middle = added if len(added) == 1 else (added[1:] + added[:-1]) / 2
    on = rig.constants.support_shape[first : first + added.shape[1]]
    if on[added.any(axis=0)].any() or more.any():
        # x, y of the seals over all coordinates: modes in both planes, less the supports
        rows = np.concatenate(
            [np.einsum("sp,de->sdpe", shape, np.eye(2)).reshape(len(shape), 2, 2 * p), -on], axis=2
        )
        whole = np.einsum("ks,sdi,sdj->kij", middle, rows, rows)
        whole += _attached_mass(rig)
        return np.linalg.inv(np.eye(rows.shape[2]) + whole)
    return np.linalg.inv(np.eye(p) + np.einsum("ks,sp,sq->kpq", middle, shape, shape))


def _attached_mass(rig: Rig) -> np.ndarray:
    """N^T M N (n, n) of the added mass M of registered effects, N their ports over all
    coordinates.
    """
    k = rig.constants
    count = rig.attached_stations
    first = len(rig.machine.bearings)
    here = slice(first, first + count)
    # to the axes of the effects' ports
    turn = np.array([[[c, s], [-s, c]] for c, s in k.direction[here]]).reshape(-1, 2, 2)
    plane = np.einsum("sp,de->sdpe", k.shape[here], np.eye(2)).reshape(count, 2, 2 * rig.modes)
    rows = np.concatenate([plane, -k.support_shape[here]], axis=2)
    rows = (turn @ rows).reshape(2 * count, -1)
    return np.asarray(rows.T @ k.reaction_mass @ rows)
