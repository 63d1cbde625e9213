"""What magnets and amplifiers can give over the frequency, and what loads take of it.

The control current that an axis can carry at omega beside its static current i_s is the least of

    i_0 -+ |i_s|              class A: no coil current below zero; i_0 the bias current
    i_max -+ |i_s|            the largest control current
    (F_max -+ |F_s|)/k_i      the largest force, where one is stated
    (V - R (i_0 +- |i_s|))/|R + j omega L|    the slew: the link's voltage over the coil

with the upper sign on the side of the bias that carries the static load, the lower on the other.
A load takes the control current i and the voltage

    v = (R + s L) i + s k_u q,    k_u = k_i/2

of a coil (``model.effects.amplifier``), q the motion at the magnet. Both are the loop's own, as it
runs: with P the plant from currents u and a force f to displacements y, currents i and q,

    u = -(I + K P_yu)^-1 K P_yf f,    i = P_iu u + P_if f,    q = P_qu u + P_qf f.

An impulse of half a sine, F pi/T (1 + e^{-s T})/(s^2 + (pi/T)^2), is brought back to time on the
line s = sigma + j omega by a discrete Fourier transform (Wilcox 1978): the factor e^{sigma t} keeps
what has not died out within the window away from its beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.frequency import evaluate, schur_form
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.loop_response import loop_evaluator
from ambrose.judge.unbalance import orbit, worst_currents
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import running_law
from ambrose.law.timing import Timing
from ambrose.machine.attachment import attached
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.effects.load import IMPULSE, STATIC, Load
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients, static_sag
from ambrose.model.unbalance import residual_unbalance

_SETTLES = 0.25  # [s] after an impulse: where its current is looked for
_FALLS = 12.0  # e-folds within the window: what comes round again is 6e-6 of itself
_LOBES = 60.0  # times 1/T: up to where an impulse's spectrum is taken
_HIGHEST = 4e3  # [Hz], at least up to here


@dataclass(frozen=True, slots=True)
class Demand:
    """What a load takes of an axis: current [A], voltage [V] and force k_i i [N], zero to peak, at
    a frequency [rad/s]. Of an impulse it is that of the sine with the same largest current and
    slope.
    """

    name: str
    kind: str
    frequency: float
    current: float
    voltage: float
    force: float


@dataclass(frozen=True, slots=True)
class Margin:
    """What is left over what demands take together: value, able over taken.

    limited_by: what binds, of which taken and able are the amounts: "voltage" [V], "force" [N],
    "current" or "bias current" [A], zero to peak.
    """

    value: float
    demands: tuple[Demand, ...]
    limited_by: str
    taken: float
    able: float

    @property
    def of(self) -> str:
        """The demands' names."""
        return " with ".join(item.name for item in self.demands)

    @property
    def unit(self) -> str:
        """Of taken and able."""
        return {"voltage": "V", "force": "N"}.get(self.limited_by, "A")


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """What bounds an axis beside its static current [A]; None: no such bound.

    bias, largest [A]; force [N] and force_per_current k_i [N/A]; voltage [V], resistance [ohm],
    inductance [H] of a coil.
    """

    bias: float
    static: float
    force_per_current: float
    largest: float | None = None
    force: float | None = None
    voltage: float | None = None
    inductance: float | None = None
    resistance: float = 0.0

    def voltage_left(self, side: int = 1) -> float:
        """[V] beside bias and static current; side +1 carries the static load, -1 does not."""
        assert self.voltage is not None
        held = self.resistance * (self.bias + side * abs(self.static))
        return max(self.voltage - held, 0.0)

    def currents(self, side: int = 1) -> dict[str, float]:
        """The bounds of the control current [A] that hold at any frequency, by name."""
        taken = side * abs(self.static)
        rows = {"bias current": self.bias - taken}
        if self.largest:
            rows["current"] = self.largest - taken
        if self.force:
            rows["force"] = self.force / self.force_per_current - taken
        return {name: max(value, 0.0) for name, value in rows.items()}

    def over(self, omega: np.ndarray, side: int = 1) -> tuple[np.ndarray, tuple[str, ...]]:
        """Largest control current (w,) [A] zero to peak over omega (w,) [rad/s] of a rotor that
        stands still, and what limits it there.
        """
        rows = {name: np.full(len(omega), value) for name, value in self.currents(side).items()}
        if self.voltage and self.inductance:
            impedance = np.hypot(self.resistance, omega * self.inductance)
            rows["voltage"] = self.voltage_left(side) / np.maximum(impedance, 1e-9)
        names, stacked = list(rows), np.array(list(rows.values()))
        return stacked.min(axis=0), tuple(names[k] for k in stacked.argmin(axis=0))

    def margin(self, *demands: Demand) -> Margin:
        """What is left over what demands take together, their peaks added."""
        current = sum(item.current for item in demands)
        voltage = sum(item.voltage for item in demands)
        rows = [(name, current, value) for name, value in self.currents().items()]
        if self.voltage and self.inductance:
            rows.append(("voltage", voltage, self.voltage_left()))
        name, taken, able = min(rows, key=lambda row: (_over(row[2], row[1]), row[0]))
        k_i = self.force_per_current if name == "force" else 1.0
        return Margin(_over(able, taken), demands, name, k_i * taken, k_i * able)


def _over(able: float, taken: float) -> float:
    return able / taken if taken > 0 else float("inf")


def axis_limits(plant: Plant, static: np.ndarray) -> tuple[AxisLimits, ...]:
    """The bounds of every axis beside static forces (a,) [N]."""
    machine, bias = plant.machine, plant.point.bias_current
    drive, (k_i, _) = machine.amplifier, magnet_coefficients(machine, plant.point)
    return tuple(
        AxisLimits(
            bearing.bias_current if bias is None else bias,
            float(force / per_current),
            float(per_current),
            bearing.max_current,
            bearing.max_force,
            drive.max_voltage,
            drive.inductance,
            drive.resistance or 0.0,
        )
        for bearing, force, per_current in zip(machine.axis_bearings, static, k_i, strict=True)
    )


def loads_of(machine: Machine) -> tuple[Load, ...]:
    """The machine file's loads."""
    return tuple(part for _, part in attached(machine) if isinstance(part, Load))


def levers(machine: Machine, position: float) -> np.ndarray:
    """The share of a radial force at an axial position [m] that each magnet carries (b,): the rigid
    rotor in balance; the least squares of those for more than two magnets.
    """
    places = np.array([bearing.position for bearing in machine.bearings])
    # sum f = 1, sum f z = z_0
    balance = np.vstack([np.ones_like(places), places])
    return np.asarray(np.linalg.pinv(balance) @ np.array([1.0, position]))


def on_axes(machine: Machine, position: float, force: np.ndarray) -> np.ndarray:
    """A force (2,) in x and y at a position [m], by levers along every control axis (a,)."""
    angles = np.array([bearing.angle for bearing in machine.bearings])
    along = np.column_stack(
        [
            np.cos(angles) * force[0] + np.sin(angles) * force[1],
            np.cos(angles) * force[1] - np.sin(angles) * force[0],
        ]
    )
    return np.asarray(levers(machine, position)[:, None] * along).ravel()


def static_forces(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """The lasting loads of the file along every axis (a,) [N]: those with a direction, signed, and
    the sizes of those without one.
    """
    count = len(machine.axes)
    signed, free = np.zeros(count), np.zeros(count)
    for load in loads_of(machine):
        if load.kind != STATIC:
            continue
        if load.direction is None:
            free += load.force * np.repeat(np.abs(levers(machine, load.position)), 2)
        else:
            way = np.array([np.cos(load.direction), np.sin(load.direction)])
            signed += on_axes(machine, load.position, load.force * way)
    return signed, free


def load_demands(
    plant: Plant, law: LawLike, timing: Timing | None
) -> tuple[tuple[Demand, ...], ...]:
    """What impulses and surges of the machine file take of every axis, in the loop as it runs,
    which must be stable.
    """
    loads = [load for load in loads_of(plant.machine) if load.kind != STATIC]
    if not loads:
        return tuple(() for _ in plant.axes)
    loop = _Loop(plant, running_law(law_of(law), plant, timing), loads)
    per_load = [
        loop.of_impulse(k) if load.kind == IMPULSE else loop.of_surge(k)
        for k, load in enumerate(loads)
    ]
    return tuple(zip(*per_load, strict=True))


def residual_demands(
    plant: Plant, law: LawLike, timing: Timing | None
) -> tuple[Demand | None, ...]:
    """What the residual unbalance takes of every axis at the plant's speed, the worst case over
    bearing planes; None: at rest, or no balance grade is known. Motion's share of the voltage is
    left out.
    """
    residual, w = residual_unbalance(plant.machine), plant.point.speed
    if residual is None or not w:
        return tuple(None for _ in plant.axes)
    fixed = running_law(law_of(law), plant, timing)
    response = loop_evaluator(plant, fixed)(np.array([w]))
    current = worst_currents(response, residual)[:, 0]
    drive = drive_of(plant)
    impedance = float(np.hypot(drive.resistance, w * drive.inductance))
    return tuple(
        Demand("residual unbalance", "unbalance", w, float(i), impedance * float(i), float(k_i * i))
        for i, k_i in zip(current, drive.force_per_current, strict=True)
    )


@dataclass(frozen=True, slots=True)
class _Drive:
    """k_i (a,) [N/A]; inductance [H], resistance [ohm]; k_u (a,) [V s/m] of a coil."""

    force_per_current: np.ndarray
    inductance: float
    resistance: float

    @property
    def back_emf(self) -> np.ndarray:
        return self.force_per_current / 2 if self.inductance else 0 * self.force_per_current

    def voltage(self, s: np.ndarray, current: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """v (w, ...) of complex current and motion (w, a, ...) at s (w,)."""
        s = s.reshape((-1,) + (1,) * (current.ndim - 1))
        k_u = self.back_emf.reshape((1, -1) + (1,) * (current.ndim - 2))
        return np.asarray((self.resistance + s * self.inductance) * current + s * k_u * motion)


def drive_of(plant: Plant) -> _Drive:
    """What turns current and motion into the voltage of a coil."""
    amplifier = plant.machine.amplifier
    k_i, _ = magnet_coefficients(plant.machine, plant.point)
    return _Drive(k_i, amplifier.inductance or 0.0, amplifier.resistance or 0.0)


class _Loop:
    """The closed loop from forces at loads to currents and motion of the axes, over complex s."""

    def __init__(self, plant: Plant, law: StateSpace, loads: Sequence[Load]) -> None:
        self.plant, self.law = plant, law
        self.loads = loads
        self.drive = drive_of(plant)
        u, y, i = (plant.named(name) for name in "uyi")
        forces = [f"f_{load.name}_{axis}" for load in loads for axis in "xy"]
        q = [f"q_{axis}" for axis in plant.axes]
        part = select(plant.system, [*u, *forces], [*y, *i, *q])
        self._plant = schur_form(part.A, part.B, part.C, part.D, expand=True)
        self._law = schur_form(law.A, law.B, law.C, law.D, expand=True)

    def response(self, s: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Currents and motion (w, a, 2) per unit force in x and y of load k, at s (w,)."""
        a = len(self.plant.axes)
        P, K = evaluate(self._plant, s), self._gain(s)
        u, f = slice(0, a), slice(a + 2 * k, a + 2 * k + 2)
        y, i, q = (slice(j * a, (j + 1) * a) for j in range(3))
        command = -np.linalg.solve(np.eye(a) + K @ P[:, y, u], K @ P[:, y, f])
        return P[:, i, u] @ command + P[:, i, f], P[:, q, u] @ command + P[:, q, f]

    def _gain(self, s: np.ndarray) -> np.ndarray:
        """K (w, a, a): of a sampled law within its base band K(e^{s T}) (1 - e^{-s T})/(s T)."""
        if self.law.dt is None:
            return evaluate(self._law, s)
        x = s * self.law.dt
        held = np.where(x == 0, 1.0, -np.expm1(-x) / np.where(x == 0, 1.0, x))
        return evaluate(self._law, np.exp(x)) * held[:, None, None]

    def of_surge(self, k: int) -> tuple[Demand, ...]:
        """What a sine takes of every axis."""
        load = self.loads[k]
        assert load.frequency is not None
        s = np.array([1j * load.frequency])
        current, motion = self.response(s, k)
        voltage = self.drive.voltage(s, current, motion)
        largest = _amplitude(load)
        return tuple(
            self._demand(load, a, load.frequency, largest(current[0, a]), largest(voltage[0, a]))
            for a in range(len(self.plant.axes))
        )

    def of_impulse(self, k: int) -> tuple[Demand, ...]:
        """The largest current, voltage and slope of every axis after half a sine."""
        load = self.loads[k]
        assert load.duration is not None
        T = load.duration
        # twice as long as looked at: towards its end e^{sigma t} lifts what the spectrum's end cuts
        window = 2 * (_SETTLES + T)
        sigma = _FALLS / window
        count = int(np.ceil(2 * window * max(_LOBES / T, _HIGHEST)))
        s = sigma + 2j * np.pi * np.fft.rfftfreq(count, window / count)
        # F pi/T (1 + e^{-s T})/(s^2 + (pi/T)^2)
        spectrum = np.pi / T * (1 + np.exp(-s * T)) / (s**2 + (np.pi / T) ** 2)
        current, motion = (part * spectrum[:, None, None] for part in self.response(s, k))
        voltage = self.drive.voltage(s, current, motion)
        growth = np.exp(sigma * window / count * np.arange(count))

        def peaks(values: np.ndarray) -> np.ndarray:
            # x(t_n) = e^{sigma t_n} (1/window) sum_k X(s_k) e^{j w_k t_n}
            series = np.fft.irfft(values, count, axis=0) * count / window
            kept = slice(0, count // 2)
            return _largest(load, (growth[:, None, None] * series)[kept])

        most, volts = peaks(current), peaks(voltage)
        slope = peaks(s[:, None, None] * current)
        return tuple(
            self._demand(load, a, slope[a] / most[a] if most[a] else 0.0, most[a], volts[a])
            for a in range(len(most))
        )

    def _demand(
        self, load: Load, axis: int, frequency: float, current: float, voltage: float
    ) -> Demand:
        i, v = float(load.force * current), float(load.force * voltage)
        k_i = float(self.drive.force_per_current[axis])
        return Demand(load.name, load.kind, float(frequency), i, v, k_i * i)


def _amplitude(load: Load) -> Callable[[np.ndarray], float]:
    """Complex amplitudes per force in x and y (2,) -> amplitude along the load's direction, or
    along the worst one.
    """
    if load.direction is None:
        # max over theta of |a cos theta + b sin theta|: the major axis of the ellipse
        return lambda xy: float(orbit(xy[:1], xy[1:])[0])
    way = np.array([np.cos(load.direction), np.sin(load.direction)])
    return lambda xy: float(np.abs(xy @ way))


def _largest(load: Load, series: np.ndarray) -> np.ndarray:
    """Largest values (a,) over time of series (t, a, 2) per force in x and y."""
    if load.direction is None:
        return np.asarray(np.hypot(series[..., 0], series[..., 1]).max(axis=0))
    way = np.array([np.cos(load.direction), np.sin(load.direction)])
    return np.asarray(np.abs(series @ way).max(axis=0))


def together(limits: AxisLimits, steady: Demand | None, loads: Sequence[Demand]) -> list[Margin]:
    """The margin of a steady demand alone, then of every load on top of it."""
    sets: list[tuple[Demand, ...]] = [] if steady is None else [(steady,)]
    sets += [(load,) if steady is None else (load, steady) for load in loads]
    return [limits.margin(*demands) for demands in sets]


def capacity_margin(
    machine: Machine, law: LawLike, timing: Timing | None, *, weight_taken: bool = False
) -> tuple[float, str]:
    """The least margin over all axes at the fastest operating point of what residual unbalance,
    impulses, surges and lasting loads take, and of which; inf where nothing is asked.
    weight_taken: the machine's largest control current is what the weight leaves.
    """
    point = max(machine.operation.envelope, key=lambda item: item.speed)
    plant = assemble(machine, point)
    weight = static_sag(machine)[1].ravel()
    signed, free = static_forces(machine)
    rows = [(float("inf"), "", "")]
    for axis, limits, steady, loads, held in zip(
        plant.axes,
        axis_limits(plant, np.abs(weight + signed) + free),
        residual_demands(plant, law, timing),
        load_demands(plant, law, timing),
        np.abs(weight),
        strict=True,
    ):
        # off the largest current already
        if weight_taken and limits.largest is not None:
            whole = replace(limits, largest=limits.largest + held / limits.force_per_current)
        else:
            whole = limits
        rows += [
            (item.value, f"{item.of}, axis {axis}", item.limited_by)
            for item in together(whole, steady, loads)
        ]
    margin, what, why = min(rows)
    return margin, f"{what}, by {why}" if what else ""
