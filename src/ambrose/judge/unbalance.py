"""Response to the residual unbalance of a balance grade: orbits, currents and bearing forces
against speed.

A rotor of mass m balanced to grade G [m/s] at W_b keeps the unbalance U = m G / W_b [kg m]; at W it
pulls with F = U W^2 (ISO 21940-11). How U is spread is unknown, so that three cases are reported:

* worst: largest singular value of the compliance between the bearings, times F (Lauridsen, PhD
  thesis, papers P3, P5). It bounds the root sum square of the orbits for circular forces with root
  sum square F.
* in phase, in antiphase: rotating forces in the bearing planes, shared by the lever rule about the
  centre of mass; orbits are semi-major axes.

| check | what | unit |
|---|---|---|
| unbalance.orbit_0p | largest worst-case orbit, zero to peak, up to the required speed | m |
| unbalance.in_phase_0p | largest orbit with the unbalance in phase | m |
| unbalance.antiphase_0p | the same in antiphase | m |
| unbalance.clearance | worst-case orbit over the smallest touchdown or air gap (ISO 14839-2) | - |
| unbalance.current_0p | worst-case control current of the axis nearest to its limit | A |
| unbalance.force_0p | worst-case force k_i i + k_s q of the axis nearest to its limit | N |
| unbalance.voltage_0p | worst-case voltage w L i of a coil, with a max_voltage | V |
| unbalance.separation | amplification factor over the allowed near running speeds (API 617) | - |
| unbalance.assembled_0p | worst-case orbit with the rotor assembled anew at every speed | m |

The curves are "unbalance" (frozen at the plant's speed), "unbalance.assembled_0p" and
"unbalance.current_0p".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.frequency import evaluate, largest_gain, schur_form
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.campbell import separation_check
from ambrose.judge.checks import Check, Curve, judge
from ambrose.judge.loop_response import (
    Evaluator,
    LoopResponse,
    Peak,
    loop_at,
    loop_evaluator,
    peaks_of,
)
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import Timing, running_law
from ambrose.machine.criteria import TWO_PI, demand, machine_limit
from ambrose.machine.description import Requirements
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.effects.stations import IMPULSE, STATIC, Load
from ambrose.model.plant import Plant, top_speed
from ambrose.model.static_load import (
    Unbalance,
    magnet_coefficients,
    residual_unbalance,
    running_range,
    runs_within,
    static_sag,
)

# What magnets and amplifiers can give over the frequency, and what loads take of it.
#
# The control current that an axis can carry at omega beside its static current i_s is the least of
#
#     i_0 -+ |i_s|              class A: no coil current below zero; i_0 the bias current
#     i_max -+ |i_s|            the largest control current
#     (F_max -+ |F_s|)/k_i      the largest force, where one is stated
#     (V - R (i_0 +- |i_s|))/|R + j omega L|    the slew: the link's voltage over the coil
#
# with the upper sign on the side of the bias that carries the static load, the lower on the other.
# A load takes the control current i and the voltage
#
#     v = (R + s L) i + s k_u q,    k_u = k_i/2
#
# of a coil (``model.effects.amplifier``), q the motion at the magnet. Both are the loop's own, as
# it runs: with P the plant from currents u and a force f to displacements y, currents i and q,
#
#     u = -(I + K P_yu)^-1 K P_yf f,    i = P_iu u + P_if f,    q = P_qu u + P_qf f.
#
# An impulse of half a sine, F pi/T (1 + e^{-s T})/(s^2 + (pi/T)^2), is brought back to time on the
# line s = sigma + j omega by a discrete Fourier transform (Wilcox 1978): the factor e^{sigma t}
# keeps what has not died out within the window away from its beginning.


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
    for load in machine.parts(Load):
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
    loads = [load for load in plant.machine.parts(Load) if load.kind != STATIC]
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


# from a critical speed, over its damping, where speeds are packed
_AROUND = np.array([-8.0, -2.5, -0.8, -0.25, 0.0, 0.25, 0.8, 2.5, 8.0])
_WORTH = 0.5  # of the largest orbit: a lower local maximum is not refined
_NEAR = 1.4  # times the highest running speed: where critical speeds are looked for


def orbit(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Semi-major axis of the ellipse with complex amplitudes x, y in two perpendicular
    directions.
    """
    # x + j y = (X + j Y)/2 e^{j w t} + conj(X - j Y)/2 e^{-j w t}: two circles, radii added
    return 0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y))


def worst_orbit(response: LoopResponse, residual: Unbalance) -> np.ndarray:
    """Largest singular value of the compliance times F, (w,) [m]."""
    return largest_gain(response.compliance()) * residual.force(response.omega)


def distributed_orbits(
    response: LoopResponse, residual: Unbalance, machine: Machine, *, antiphase: bool
) -> np.ndarray:
    """Orbits at the bearings (bearings, w) [m] for forward rotating forces in the bearing planes,
    in phase or alternating.
    """
    sign = np.array([(-1.0) ** k if antiphase else 1.0 for k in range(len(residual.share))])
    # forward in the common directions is (1, -j); an axis turned by alpha lags by it
    turned = np.exp(-1j * np.array([bearing.angle for bearing in machine.bearings]))
    amplitude = sign * np.array(residual.share) * turned

    # zeta, eta of each bearing: forward circles
    pattern = np.stack([amplitude, -1j * amplitude], axis=1).ravel()

    # q per unit force times F at every speed
    q = (response.compliance() @ pattern) * residual.force(response.omega)[:, None]
    return orbit(q[:, 0::2], q[:, 1::2]).T


def worst_currents(response: LoopResponse, residual: Unbalance) -> np.ndarray:
    """Largest control current of every axis (a, w) [A] over force vectors of Euclidean length F."""
    # max |row f| over |f| = F is |row| F
    return (
        np.linalg.norm(response.current_per_force(), axis=2)
        * residual.force(response.omega)[:, None]
    ).T


def worst_forces(response: LoopResponse, residual: Unbalance, plant: Plant) -> np.ndarray:
    """Largest magnetic force k_i i + k_s q of every axis (a, w) [N] over force vectors of Euclidean
    length F.
    """
    k_i, k_s = magnet_coefficients(plant.machine, plant.point)

    # k_i i + k_s q per unit force, axis by axis
    per_force = k_i[:, None] * response.current_per_force() + k_s[:, None] * response.compliance()
    return (np.linalg.norm(per_force, axis=2) * residual.force(response.omega)[:, None]).T


def worst_voltages(
    response: LoopResponse, residual: Unbalance, inductance: float, resistance: float = 0.0
) -> np.ndarray:
    """Largest voltage |R + j w L| i of every axis' coil (a, w) [V]: what the virtual rig limits.

    What motion induces is left out. inductance [H]; resistance [ohm], of a "current-loop" alone.
    """
    impedance = np.hypot(resistance, inductance * response.omega)
    return np.asarray(worst_currents(response, residual) * impedance)


def unbalance_checks(
    plant: Plant,
    response: LoopResponse,
    evaluator: Evaluator,
    requirements: Requirements,
    residual: Unbalance,
) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table, with the rotor's matrices frozen at the plant's
    speed.
    """
    machine = plant.machine
    highest = requirements.unbalance_to or top_speed(machine) or residual.speed
    highest = min(highest, float(response.omega[-1]))
    cases: list[Callable[[LoopResponse], np.ndarray]] = [
        lambda r: worst_orbit(r, residual)[None, :],
        lambda r: distributed_orbits(r, residual, machine, antiphase=False),
        lambda r: distributed_orbits(r, residual, machine, antiphase=True),
        lambda r: worst_currents(r, residual),
        lambda r: worst_forces(r, residual, plant),
    ]
    within = (float(response.omega[0]), highest)
    values = [case(response) for case in cases]
    (worst,), in_phase, antiphase, currents, forces = peaks_of(
        cases, response, evaluator, within, values
    )
    note = (
        f"G{residual.grade * 1e3:g} at {residual.speed / TWO_PI:.4g} Hz, {residual.mass:.4g} kg: "
        f"{float(residual.force(residual.speed)):.4g} N there"
    )
    names = [bearing.name for bearing in machine.bearings]
    checks = [
        judge(
            "unbalance.orbit_0p",
            f"Worst-case unbalance orbit up to {highest / TWO_PI:.4g} Hz, 0-p",
            worst.value,
            "m",
            demand("unbalance orbit", requirements),
            f"{_at(worst)}; {note}",
        ),
        _distribution("unbalance.in_phase_0p", "in phase", in_phase, names),
        _distribution("unbalance.antiphase_0p", "in antiphase", antiphase, names),
        *_clearance(machine, worst, requirements),
        axis_limit_check(
            plant,
            "unbalance.current_0p",
            "Worst-case unbalance current, 0-p",
            currents,
            requirements,
        ),
        axis_limit_check(
            plant,
            "unbalance.force_0p",
            "Worst-case magnetic force under unbalance, 0-p",
            forces,
            requirements,
        ),
        *_voltage(plant, response, evaluator, residual, within),
    ]
    points = machine.operation.envelope
    running = running_range(requirements.running_speeds, (point.speed for point in points))
    if running is not None and runs_within(plant.point.speed, running):
        near = response.omega <= _NEAR * running[1]
        turning = np.vstack([each[:, near] for each in values[1:3]])
        checks.append(separation_check(response.omega[near], turning, requirements, running))
    in_range = response.omega <= max(highest, residual.speed)
    orbits = np.vstack([each[:, in_range] for each in values[:3]])
    omega = response.omega[in_range]
    return checks, [
        _orbit_curve(machine, omega, orbits, requirements),
        Curve(
            "unbalance.current_0p",
            "Worst-case unbalance current, 0-p",
            "speed",
            omega,
            values[3][:, in_range],
            response.axes,
            "rad/s",
            "A",
        ),
    ]


def _voltage(
    plant: Plant,
    response: LoopResponse,
    evaluator: Evaluator,
    residual: Unbalance,
    within: tuple[float, float],
) -> list[Check]:
    amplifier = plant.machine.amplifier
    most, inductance = amplifier.max_voltage, amplifier.inductance
    if most is None or inductance is None:
        return []
    # the bias current takes its share of the voltage in the coil's resistance
    resistance = amplifier.resistance or 0.0
    most -= resistance * max(bearing.bias_current for bearing in plant.machine.bearings)
    (peaks,) = peaks_of(
        [lambda r: worst_voltages(r, residual, inductance, resistance)], response, evaluator, within
    )
    k = int(np.argmax([peak.value for peak in peaks]))
    wanted, detail = (
        machine_limit(most, "the amplifier's max_voltage"),
        f"axis {plant.axes[k]} {_at(peaks[k])}",
    )
    return [
        judge(
            "unbalance.voltage_0p",
            "Worst-case coil voltage under unbalance, 0-p",
            peaks[k].value,
            "V",
            wanted,
            detail,
        )
    ]


def _orbit_curve(
    machine: Machine, speeds: np.ndarray, orbits: np.ndarray, requirements: Requirements
) -> Curve:
    """Orbits (1 + 2 bearings, w) [m]: the worst case, then every bearing in phase, then in
    antiphase.
    """
    names = [bearing.name for bearing in machine.bearings]
    labels = (
        "worst case",
        *(f"{n}, in phase" for n in names),
        *(f"{n}, in antiphase" for n in names),
    )
    limits = (
        ()
        if requirements.unbalance_orbit is None
        else (("required", requirements.unbalance_orbit),)
    )
    return Curve(
        "unbalance",
        "Unbalance response, zero to peak",
        "speed",
        speeds,
        orbits,
        labels,
        "rad/s",
        "m",
        limits,
    )


def _at(peak: Peak) -> str:
    return f"at {peak.frequency / TWO_PI:.4g} Hz"


def _distribution(name: str, words: str, peaks: tuple[Peak, ...], names: list[str]) -> Check:
    k = int(np.argmax([peak.value for peak in peaks]))
    title = f"Unbalance orbit, planes {words}, 0-p"
    return Check(name, title, peaks[k].value, "m", detail=f"bearing {names[k]} {_at(peaks[k])}")


def _clearance(machine: Machine, worst: Peak, requirements: Requirements) -> list[Check]:
    gaps = [bearing.touchdown_gap or bearing.gap for bearing in machine.bearings]
    known = [gap for gap in gaps if gap]
    if not known:
        return []
    kind = "touchdown gap" if all(bearing.touchdown_gap for bearing in machine.bearings) else "gap"
    return [
        judge(
            "unbalance.clearance",
            "Worst-case unbalance orbit, 0-p, relative to the clearance",
            worst.value / min(known),
            "-",
            demand("orbit over clearance", requirements),
            f"{kind} {1e6 * min(known):.4g} um, {_at(worst)}",
        )
    ]


def axis_limit_check(
    plant: Plant, name: str, title: str, peaks: Sequence[Peak], requirements: Requirements
) -> Check:
    """One check for a current or force (by ``name``) known per axis: of the axis that comes nearest
    to its limit.
    """
    current = name.endswith("current_0p")
    bearings = plant.machine.axis_bearings
    limits = [bearing.max_current if current else bearing.max_force for bearing in bearings]
    required = demand("current" if current else "information", requirements)
    known = [required.limit if required.limit is not None else limit for limit in limits]

    # without a limit an axis counts only where none has one
    ratio = [
        peak.value / limit if limit else peak.value * 1e-12
        for peak, limit in zip(peaks, known, strict=True)
    ]
    k = int(np.argmax(ratio))
    source = f"bearing {bearings[k].name}, {'max_current' if current else 'max_force'}"
    wanted = required if required.limit is not None else machine_limit(limits[k], source)
    at = "" if np.isnan(peaks[k].frequency) else f" {_at(peaks[k])}"
    return judge(
        name, title, peaks[k].value, "A" if current else "N", wanted, f"axis {plant.axes[k]}{at}"
    )


def unbalance_curve(
    plant_at: Callable[[float], Plant],
    speeds: np.ndarray,
    controller: LawLike,
    residual: Unbalance | None = None,
    critical: Sequence[tuple[float, float]] = (),
    law_at: Callable[[Plant], LawLike] | None = None,
) -> Curve:
    """Unbalance orbits with the rotor's matrices assembled anew at every speed (gyroscopic forces,
    speed-dependent seals).

    plant_at: speed [rad/s] -> Plant, a stable loop with the controller, or with law_at(plant) in
    its place; speeds (s,) [rad/s], ascending, positive. residual: default that of the machine.
    critical: (speed, damping) [rad/s] of the loop's critical speeds, around which speeds are
    packed. The curve has the lines of the fixed-speed curve "unbalance"; at every large local
    maximum of the worst case a refined point is added. Raises InvalidInput when no balancing speed
    is known.
    """
    from scipy.optimize import minimize_scalar

    speeds = np.asarray(check_finite(speeds, "speeds"), float)
    if speeds.size == 0 or speeds.min() <= 0 or (np.diff(speeds) <= 0).any():
        raise invalid(
            "speeds",
            speeds,
            "positive, ascending, at least one",
            "leave standstill out: it has no unbalance force",
        )
    machine = plant_at(float(speeds[0])).machine
    residual = residual_unbalance(machine) if residual is None else residual
    if residual is None:
        raise InvalidInput(
            "no balancing speed is known; give requirements.balance_speed or a speed range"
        )

    # every evaluation is kept by its speed: (worst, in phase, in antiphase)
    columns: dict[float, np.ndarray] = {}

    def worst(speed: float) -> float:
        plant = plant_at(speed)
        response = loop_at(plant, controller if law_at is None else law_at(plant), speed)
        orbits = [
            distributed_orbits(response, residual, machine, antiphase=flag)[:, 0]
            for flag in (False, True)
        ]
        columns[speed] = np.concatenate([worst_orbit(response, residual), *orbits])
        return float(columns[speed][0])

    packed = [speed + damping * _AROUND for speed, damping in critical]
    every = np.unique(np.concatenate([speeds, *packed]))
    speeds = every[(every >= speeds[0]) & (every <= speeds[-1])]
    values = np.array([worst(float(speed)) for speed in speeds])

    # local maxima of at least half the largest that is judged are refined between their neighbours
    judged = values[speeds <= (machine.requirements.unbalance_to or np.inf) * (1 + 1e-9)]
    least = _WORTH * float(judged.max(initial=values.min()))
    kept = set(speeds.tolist())
    for k in range(1, len(speeds) - 1):
        if values[k] >= max(values[k - 1], values[k + 1], least):
            bounds = (float(speeds[k - 1]), float(speeds[k + 1]))
            best = minimize_scalar(
                lambda w: -worst(float(w)),
                bounds=bounds,
                method="bounded",
                options={"xatol": 1e-4 * (bounds[1] - bounds[0])},
            )
            kept.add(float(best.x))
    x = np.array(sorted(kept))
    return _orbit_curve(machine, x, np.array([columns[w] for w in x]).T, machine.requirements)


def assembled_check(curve: Curve, requirements: Requirements) -> Check:
    """The largest worst-case orbit of an ``unbalance_curve`` up to the required speed, held against
    the required orbit.
    """
    limit = requirements.unbalance_to or np.inf
    inside = curve.x <= limit * (1 + 1e-9)
    values = np.where(inside, curve.y[0], 0.0)
    k = int(np.argmax(values))
    return judge(
        "unbalance.assembled_0p",
        f"Worst-case unbalance orbit, rotor assembled at {len(curve.x)} speeds, refined at peaks, "
        "0-p",
        values[k],
        "m",
        demand("unbalance orbit", requirements),
        f"at {curve.x[k] / TWO_PI:.4g} Hz",
    )
