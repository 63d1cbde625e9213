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

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.frequency import largest_gain
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import judge
from ambrose.judge.critical_speeds import separation_check
from ambrose.judge.loop_response import Evaluator, LoopResponse, loop_at
from ambrose.judge.peaks import Peak, peaks_of
from ambrose.law.law import LawLike
from ambrose.machine.criteria import TWO_PI, demand, machine_limit
from ambrose.machine.description import Requirements
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant, top_speed
from ambrose.model.separation import running_range, runs_within
from ambrose.model.static_load import magnet_coefficients
from ambrose.model.unbalance import Unbalance, residual_unbalance

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
    (worst,), in_phase, antiphase, currents, forces = peaks_of(cases, response, evaluator, within)
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
        turning = np.vstack([case(response)[:, near] for case in cases[1:3]])
        checks.append(separation_check(response.omega[near], turning, requirements, running))
    in_range = response.omega <= max(highest, residual.speed)
    orbits = np.vstack([case(response)[:, in_range] for case in cases[:3]])
    omega = response.omega[in_range]
    return checks, [
        _orbit_curve(machine, omega, orbits, requirements),
        Curve(
            "unbalance.current_0p",
            "Worst-case unbalance current, 0-p",
            "speed",
            omega,
            cases[3](response)[:, in_range],
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
) -> Curve:
    """Unbalance orbits with the rotor's matrices assembled anew at every speed (gyroscopic forces,
    speed-dependent seals).

    plant_at: speed [rad/s] -> Plant, a stable loop with the controller; speeds (s,) [rad/s],
    ascending, positive. residual: default that of the machine. critical: (speed, damping) [rad/s]
    of the loop's critical speeds, around which speeds are packed. The curve has the lines of the
    fixed-speed curve "unbalance"; at every large local maximum of the worst case a refined point is
    added. Raises InvalidInput when no balancing speed is known.
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
        response = loop_at(plant_at(speed), controller, speed)
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
