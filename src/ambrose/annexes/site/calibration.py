"""Sensors and centres from standard tests, as a machine file holds them: gain, offset, clearance,
run-out, magnetic centre.

* Static circle: the rotor is moved slowly around inside its touchdown bearings, all in phase. What
  the sensors of a bearing show is an ellipse about their offset; its half-axes are gain times
  clearance, so that one of the two is known from the other.
* Slow roll: multiples of the turning in y - G u, which run-out alone makes
  (site/balancing.py).
* Levitation at rest: magnet forces and weight are in balance, which tells where the magnets' centre
  is; at several bias currents the weight as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ambrose.annexes.site.balancing import NONE, influence, revolution, source_of_currents
from ambrose.core.checks import InvalidInput, as_several, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import select
from ambrose.identification.findings import signal_rows
from ambrose.identification.frf import Step
from ambrose.identification.validation.places import load_doubt, machine_at_load
from ambrose.machine.description import Pair
from ambrose.machine.machine import Machine
from ambrose.machine.part import Runout, Sensor
from ambrose.model.assemble import assemble
from ambrose.model.effects import magnet
from ambrose.model.plant import measured_ports, sensor_turn
from ambrose.model.static_load import (
    magnet_coefficients,
    operating_magnets,
    residual_unbalance,
    static_sag,
)
from ambrose.record.files import read_record
from ambrose.record.record import Record

_SAMPLES = 2000  # of a circle that are fitted, about
# of a turn, and how many of them a circle must pass; a heavy rotor jumps at the top
_SECTORS, _OCCUPIED = 24, 20
_OUTSIDE = 4.0  # times the median distance from the ellipse: not in contact
_THICK = (0.02, 0.15)  # of its radius, within which that limit lies
_DEAD = 0.02  # of the widest motion of any channel, below which one does not move
_IN_PHASE = 0.35  # [rad] by which the bearings' circles may differ
_WEIGHT = 0.02  # relative error of a weight that is computed; assumed
_REFINEMENTS = 3
_UNIT = 1e-4  # [m] of the unknowns
_SEEN = 3.0  # times its half-width: a harmonic that is written down
Files = Record | str | Path


@dataclass(frozen=True, slots=True)
class Calibrated:
    """One entry: what and where, its value before and now, half-width of 95 % (SI ``unit``)."""

    name: str
    unit: str
    before: float
    value: float
    half: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(Presented):
    """The machine with what was found, and each entry beside what it was."""

    machine: Machine
    entries: tuple[Calibrated, ...]
    notes: tuple[str, ...] = ()

    def facts(self) -> dict[str, Any]:
        """How many entries were found."""
        return {"machine": self.machine.name, "entries": len(self.entries)}

    def to_dict(self) -> dict[str, Any]:
        """The entries and notes, ready for JSON."""
        rows = [
            {k: getattr(row, k) for k in ("name", "unit", "before", "value", "half")}
            for row in self.entries
        ]
        return {"machine": self.machine.name, "entries": rows, "notes": list(self.notes)}


def calibrate(
    machine: Machine,
    *,
    circle: Files | None = None,
    slow_roll: Files | None = None,
    levitated: Files | Sequence[Files] = (),
    find: Literal["gain", "clearance"] = "gain",
    harmonics: int = 3,
    settle: float = 0.3,
) -> Calibration:
    """The machine with sensors and centres as standard tests show them, one test after the other.

    circle: a record of y_<axis> while the rotor goes around in the touchdown bearings, whose gaps
    are known (find "gain") or found with the gains known ("clearance"). slow_roll: y_<axis> and u_
    or i_<axis> of the levitated rotor turning slowly; harmonics: of its run-out. levitated: the
    same at rest, one record or several at other bias currents or positions. settle [s]: left out at
    the beginning of every record. Raises InvalidInput.
    """
    machine.across_the_shaft("these tests go around it")
    if find not in {"gain", "clearance"}:
        raise invalid(
            "find", repr(find), '"gain" or "clearance"', "the other of the two must be known"
        )
    several = as_several(levitated)
    if circle is None and slow_roll is None and not several:
        raise InvalidInput(
            "no test was given; give a record of a static circle, of slow roll or of the "
            "levitated rotor"
        )
    around = None if circle is None else _read(circle, settle)
    rolling = None if slow_roll is None else read_record(slow_roll)
    levitated_records = [_read(item, settle) for item in several]
    calibrated = machine
    before: dict[str, float] = {}
    # a circle is bent by the magnets' centre and by run-out, which are found later
    for _ in range(2 if around else 1):
        centres = {bearing.name: bearing.magnetic_offset for bearing in calibrated.bearings}
        calibrated = replace(
            machine,
            bearings=tuple(replace(b, magnetic_offset=centres[b.name]) for b in machine.bearings),
            sensors=tuple(
                replace(own, runout=new.runout)
                for own, new in zip(machine.sensors, calibrated.sensors, strict=True)
            ),
        )
        entries: list[Calibrated] = []
        notes: list[str] = []
        if around is not None:
            calibrated = _circle(calibrated, around, find, entries, notes)
        if rolling is not None:
            calibrated = _runout(calibrated, rolling, harmonics, settle, entries, notes)
            if doubt := load_doubt(machine, [rolling]):
                notes.append(doubt)
        if levitated_records:
            calibrated = _centres(calibrated, levitated_records, entries, notes)
        before = {entry.name: entry.before for entry in entries} | before
    return Calibration(
        calibrated,
        tuple(replace(entry, before=before[entry.name]) for entry in entries),
        tuple(notes),
    )


def _read(item: Files, settle: float) -> Record:
    record = read_record(item)
    return record.between(record.start_time + settle, np.inf)


def _pairs(machine: Machine) -> tuple[Sensor, ...]:
    """The sensors of every bearing. Raises InvalidInput where one has several pairs, whose mean
    alone is recorded.
    """
    for bearing in machine.bearings:
        sensors = [sensor for sensor in machine.sensors if sensor.bearing == bearing.name]
        if len(sensors) > 1:
            remedy = "calibrate them one by one, by records and machine files with one pair each"
            raise invalid(
                f"the number of sensor pairs of bearing {bearing.name}",
                len(sensors),
                "one, for records hold their mean",
                remedy,
            )
    return tuple(
        sensor
        for bearing in machine.bearings
        for sensor in machine.sensors
        if sensor.bearing == bearing.name
    )


def _levers(machine: Machine) -> np.ndarray:
    """(bearings, bearings): displacement at every bearing's sensors from those at the bearings, by
    a straight rotor.
    """
    places = np.array([bearing.position for bearing in machine.bearings])
    levers = np.zeros((len(places), len(places)))
    for k, port in enumerate(measured_ports(machine)[0::2]):
        # the straight line through the two nearest bearings; one bearing alone: its
        # own displacement
        near = np.argsort(np.abs(places - port.position))[:2]
        if len(near) < 2:
            levers[k, near] = 1.0
            continue
        i, j = near
        share = (port.position - places[i]) / (places[j] - places[i])
        levers[k, i], levers[k, j] = 1 - share, share
    return levers


def _with_sensors(machine: Machine, changed: Sequence[Sensor]) -> Machine:
    by_bearing = {sensor.bearing: sensor for sensor in changed}
    return replace(machine, sensors=tuple(by_bearing[sensor.bearing] for sensor in machine.sensors))


def _circle(
    machine: Machine, record: Record, find: str, entries: list[Calibrated], notes: list[str]
) -> Machine:
    """What the circle tells: |(y - offset)/gain| at a sensor is the lever's mean of clearance +
    compliance * contact force.
    """
    from scipy.optimize import least_squares

    gaps = [bearing.touchdown_gap for bearing in machine.bearings]
    if find == "gain" and None in gaps:
        raise InvalidInput(
            "a touchdown_gap is not stated; add it to the bearing, or find the clearance with the "
            "gains known"
        )
    pairs, levers = _pairs(machine), _levers(machine)

    # y (pairs, 2, k) [m]: the two axes of every sensor pair
    y = record.select([f"y_{axis}" for axis in machine.axes]).values.reshape(len(pairs), 2, -1)
    step = max(y.shape[2] // _SAMPLES, 1)

    # a channel that stays still beside the others is dead
    spread = np.ptp(y.reshape(len(machine.axes), -1), axis=1)
    for axis, width in zip(machine.axes, spread.tolist(), strict=True):
        if width <= _DEAD * spread.max():
            remedy = "look for a dead channel, or move the rotor all around"
            raise invalid(
                f"y_{axis}", f"still within {1e6 * width:.3g} um", "moved as all others are", remedy
            )

    # z (pairs, k): samples about the unit circle, in the sensors' own directions
    ellipses = [_ellipse(own[:, ::step], pair.bearing) for own, pair in zip(y, pairs, strict=True)]
    z = np.array([e.normal(own[:, ::step]) for e, own in zip(ellipses, y, strict=True)])

    # all pairs must go around in phase: mean of z_k conj(z_1), both in global directions
    directions = np.array([port.direction for port in measured_ports(machine)[0::2]])
    for pair, own in zip(pairs[1:], (z * np.exp(1j * directions)[:, None])[1:], strict=True):
        apart = float(np.abs(np.angle(np.mean(own * (z[0] * np.exp(1j * directions[0])).conj()))))
        if apart > _IN_PHASE:
            remedy = "move all bearings in phase; a sensor turned or exchanged shows like this, too"
            where = f"the circle at bearing {pair.bearing}"
            raise invalid(
                where, f"{np.degrees(apart):.0f} degrees off", "in phase with the first", remedy
            )

    # samples on the ellipse at every pair
    used = np.all([e.used for e in ellipses], axis=0)

    # reach: mean radius over gain, the displacement at the sensors; reach = levers clearance
    gains = np.array([pair.gain for pair in pairs])
    reach = np.array(
        [np.mean(np.array(e.radius) / g) for e, g in zip(ellipses, gains, strict=True)]
    )
    known = np.array(gaps, float) if find == "gain" else np.linalg.solve(levers, reach)

    # every step-th sample that is used, of the displacements and of the whole record
    n, y, kept = len(pairs), y[:, :, ::step][:, :, used], record.values[:, ::step][:, used]
    part = replace(record, values=kept, start_time=0.0)

    # back: displacements at the bearings from those at the sensors
    scale, bearings_from_sensors = (
        np.array([np.mean(e.radius) for e in ellipses]),
        np.linalg.inv(levers),
    )

    def model(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        # x = (offset / radius (2n), gain (2n) or clearance / mean radius (n), compliance (n)),
        # the last in 1e-3 mean radii per kN: unknowns of order one
        offset, compliance = x[: 2 * n].reshape(n, 2) * scale[:, None], x[-n:] * scale.mean() * 1e-3
        gain = x[2 * n : 4 * n].reshape(n, 2) if find == "gain" else gains
        return (
            offset,
            gain,
            known if find == "gain" else x[2 * n : 3 * n] * scale.mean(),
            compliance,
        )

    def displaced(x: np.ndarray) -> np.ndarray:
        """At the sensors (n, k) [m], in global directions."""
        # q = ((y_1 - offset_1)/gain_1 + j (y_2 - offset_2)/gain_2) exp(j direction)
        offset, gain, *_ = model(x)
        along = (y - offset[:, :, None]) / gain[:, :, None]
        return np.asarray((along[:, 0] + 1j * along[:, 1]) * np.exp(1j * directions)[:, None])

    # the first guess: the ellipses, and a stiff contact
    x = np.concatenate(
        [
            np.ravel([np.array(e.offset) / s for e, s in zip(ellipses, scale, strict=True)]),
            np.ravel(
                [np.array(e.radius) / r for e, r in zip(ellipses, levers @ known, strict=True)]
            )
            if find == "gain"
            else known / scale.mean(),
            np.zeros(n),
        ]
    )
    for _ in range(_REFINEMENTS):  # the contact force follows from where the rotor is
        pressed = _pressed(machine, part, bearings_from_sensors @ displaced(x)) / 1e3

        def residual(unknowns: np.ndarray, pressed: np.ndarray = pressed) -> np.ndarray:
            # |q| - levers (clearance + compliance force), in radii
            *_, gap, compliance = model(unknowns)
            return np.ravel(
                (
                    np.abs(displaced(unknowns))
                    - levers @ (gap[:, None] + compliance[:, None] * pressed)
                )
                / scale[:, None]
            )

        fit = least_squares(residual, x, loss="soft_l1", f_scale=1e-3)
        x = fit.x
    if not pressed.any():
        notes.append(
            "the record contains no currents, so that the compliance of the contact is in gain or "
            "clearance"
        )

    # covariance (J^T J)^-1 |residual|^2 / freedom: each sector of each pair counts as
    # one independent observation
    freedom = max(_SECTORS * n - len(x), 1)  # neighbouring samples err together
    spread = np.sqrt(
        np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * float(fit.fun @ fit.fun) / freedom
    )
    offset, gain, gap, _ = model(x)

    # half-widths of 95 %: model() is linear in x, so that it scales two standard deviations, too
    wide, wide_gain, wide_gap, _ = model(2 * spread)
    wide = wide + gains * [
        [sum(item.amplitude for item in pair.runout)] for pair in pairs
    ]  # at what angle the rotor stood is not known

    # entries as found, and the machine with them
    bearings = list(machine.bearings)
    for k, pair in enumerate(pairs):
        for way, axis in enumerate(("zeta", "eta")):
            at = f"sensor {pair.bearing}"
            if find == "gain":
                own = float(gain[k, way])
                entries.append(
                    Calibrated(
                        f"{at} gain {axis}", "-", pair.gain[way], own, float(wide_gain[k, way])
                    )
                )
            entries.append(
                Calibrated(
                    f"{at} offset {axis}",
                    "m",
                    pair.offset[way],
                    float(offset[k, way]),
                    float(wide[k, way]),
                )
            )
        if find == "clearance":
            before = float("nan") if gaps[k] is None else float(gaps[k] or 0.0)
            entries.append(
                Calibrated(
                    f"bearing {pair.bearing} touchdown_gap",
                    "m",
                    before,
                    float(gap[k]),
                    float(wide_gap[k]),
                )
            )
            bearings[k] = replace(bearings[k], touchdown_gap=float(gap[k]))
    sensors = [
        replace(pair, gain=(float(g[0]), float(g[1])), offset=(float(o[0]), float(o[1])))
        for pair, g, o in zip(pairs, gain, offset, strict=True)
    ]
    return _with_sensors(replace(machine, bearings=tuple(bearings)), sensors)


def _pressed(machine: Machine, record: Record, q: np.ndarray) -> np.ndarray:
    """Contact force (bearings, k) [N] of magnets and weight, outward, at displacements q (bearings,
    k) [m], x + j y; zero where the record holds no currents.
    """
    forces = np.zeros(q.shape)

    # measured coil currents i before commanded ones u + e
    kind = next(
        (kind for kind in "iu" if all(f"{kind}_{axis}" in record.signals for axis in machine.axes)),
        "",
    )
    _, weight = static_sag(machine)
    magnets = operating_magnets(machine, record.point.bias_current)
    for b, bearing in enumerate(machine.bearings if kind else ()):
        rows = [f"{bearing.name}_{axis}" for axis in ("zeta", "eta")]
        i = record.select([f"{kind}_{row}" for row in rows]).values
        if kind == "u":
            i = i + np.stack(signal_rows(record, [f"e_{row}" for row in rows]))

        # displacement along the bearing's own axes
        local = q[b] * np.exp(-1j * bearing.angle)
        constants, load = magnets[b].of_force, weight[b]
        pulls = (
            np.array(
                [
                    magnet.force(*ends, constants)
                    for ends in zip(i[0], i[1], local.real, local.imag, strict=True)
                ]
            )
            + load
        )

        # F . q / |q|; a magnet that pulls inward leaves the contact without force
        outward = pulls[:, 0] * local.real + pulls[:, 1] * local.imag
        forces[b] = np.maximum(outward / np.abs(local), 0.0)
    return forces


@dataclass(frozen=True, slots=True, eq=False)
class _Ellipse:
    """Centre and half-axes [m] along the sensors, and which samples lie on it."""

    offset: Pair
    radius: Pair
    used: np.ndarray

    def normal(self, y: np.ndarray) -> np.ndarray:
        """Samples (2, k) as points (k,) about the unit circle."""
        return np.asarray(
            (y[0] - self.offset[0]) / self.radius[0] + 1j * (y[1] - self.offset[1]) / self.radius[1]
        )


def _ellipse(y: np.ndarray, bearing: str) -> _Ellipse:
    """The ellipse that most samples y (2, k) lie on. Raises InvalidInput where they do not go all
    around.
    """
    scale, used = float(np.ptp(y)), np.ones(y.shape[1], bool)
    centre, radius = np.zeros(2), np.zeros(2)
    for _ in range(8):
        # A z1^2 + B z2^2 + C z1 + D z2 = 1 by least squares, axes along the sensors
        z = y[:, used] / scale
        A, B, C, D = np.linalg.lstsq(np.vstack([z**2, z]).T, np.ones(z.shape[1]))[0]
        if A <= 0 or B <= 0:
            radius = np.zeros(2)
            break

        # A (z1 + C/2A)^2 + B (z2 + D/2B)^2 = 1 + C^2/4A + D^2/4B
        level = 1 + C**2 / (4 * A) + D**2 / (4 * B)
        centre, radius = (
            np.array([-C / (2 * A), -D / (2 * B)]) * scale,
            np.sqrt(level / np.array([A, B])) * scale,
        )

        # relative distance from the ellipse; what is far off was not in contact, and the rest
        # is fitted anew until the choice stays
        off = np.abs(np.linalg.norm((y - centre[:, None]) / radius[:, None], axis=0) - 1)
        inner = off <= np.clip(_OUTSIDE * float(np.median(off[used])), *_THICK)
        if (inner == used).all():
            break
        used = inner

    # sectors of the turn that the samples on the ellipse pass
    angle = np.arctan2(
        *((y[:, used] - centre[:, None]) / np.where(radius > 0, radius, 1.0)[:, None])[::-1]
    )
    sectors = len(np.unique((angle % (2 * np.pi) * _SECTORS / 2 / np.pi).astype(int)))
    if not radius.all() or sectors < _OCCUPIED or used.mean() < 0.5:
        raise invalid(
            f"the motion at bearing {bearing}",
            f"in contact over {360 * sectors // _SECTORS} degrees",
            "a circle all around",
            "press the rotor against its touchdown bearing by a slowly turning current, and go "
            "round once at least",
        )
    return _Ellipse(
        (float(centre[0]), float(centre[1])), (float(radius[0]), float(radius[1])), used
    )


def _runout(
    machine: Machine,
    record: Record,
    harmonics: int,
    settle: float,
    entries: list[Calibrated],
    notes: list[str],
) -> Machine:
    pairs, turn = _pairs(machine), revolution(record, settle)
    plant = assemble(machine_at_load(machine, [record]), record.point)
    if source_of_currents(record, plant, None) == NONE:
        raise InvalidInput(
            "the record of slow roll has neither u_<axis> nor i_<axis>; the controller follows "
            "run-out: record them"
        )
    profiles: list[list[Runout]] = [[] for _ in pairs]
    allowed = residual_unbalance(machine)
    for order in range(1, harmonics + 1):
        # the multiple of the turning; unbalance makes 1x alone
        step = Step(order * turn.frequency, turn.start, turn.stop)
        names = (
            tuple(bearing.name for bearing in machine.bearings) if order == 1 and allowed else ()
        )
        at = influence(plant, names, None, record, step, settle)

        # d without the currents' part and without the sensors' lag: run-out itself, block by block
        d = at.blocks / at.per_runout

        # standard deviation of the mean: half the distance between the record's halves, with the
        # scatter of the blocks
        drift = np.abs(d[: len(d) // 2].mean(axis=0) - d[len(d) // 2 :].mean(axis=0)) / 2
        spread = np.hypot(drift, np.std(d, axis=0) / np.sqrt(len(d) - 1))

        # the unbalance that the grade allows counts as two standard deviations
        if names and allowed:
            spread = np.hypot(
                spread, np.abs(at.per_unbalance) @ (allowed.moment * np.array(allowed.share)) / 2
            )
        for k, (pair, port) in enumerate(zip(pairs, measured_ports(machine)[0::2], strict=True)):
            # a profile p of order n reads p exp(-j n phi) at the angle phi: turned back
            # for each sensor
            ahead = np.exp(1j * order * (port.direction + np.array([0.0, np.pi / 2])))
            own = d.mean(axis=0)[2 * k : 2 * k + 2] / pair.gain * ahead

            # both sensors of a pair see one profile; half their difference is doubt
            p, apart = own.mean(), float(np.abs(own[0] - own[1])) / 2
            half = 2 * float(np.hypot(spread[2 * k : 2 * k + 2].max(), apart))
            before = next((r.amplitude for r in pair.runout if r.order == order), 0.0)
            entries.append(
                Calibrated(
                    f"sensor {pair.bearing} run-out {order}x", "m", before, float(np.abs(p)), half
                )
            )
            if np.abs(p) > _SEEN * half / 2:
                profiles[k].append(Runout(order, float(np.abs(p)), float(np.angle(p))))
    if allowed:
        notes.append(
            f"half-widths of 1x hold the unbalance of G{1e3 * allowed.grade:g}; slower rolling "
            "makes it less"
        )
    return _with_sensors(
        machine,
        [replace(pair, runout=tuple(own)) for pair, own in zip(pairs, profiles, strict=True)],
    )


def _held(machine: Machine, record: Record) -> np.ndarray:
    """Stiffness (a, a) [N/m] at the magnets of all that holds the rotor at rest but them: seals,
    couplings, supports.

    The plant's compliance from forces to displacements there, q = G f, has the magnets' negative
    stiffness in it: G^-1 = S - K_s.
    """
    plant = assemble(machine, record.point)
    axes = plant.axes
    part = select(plant.system, [f"f_{a}" for a in axes], [f"q_{a}" for a in axes])
    G = part.D - part.C @ np.linalg.solve(part.A, part.B)
    return np.asarray(np.linalg.inv(G) + np.diag(magnet_coefficients(machine, record.point)[1]))


def _centres(
    machine: Machine, records: list[Record], entries: list[Calibrated], notes: list[str]
) -> Machine:
    from scipy.optimize import least_squares

    pairs, back = _pairs(machine), np.linalg.inv(_levers(machine))
    gain, offset = (
        np.array([getattr(pair, name) for pair in pairs]).ravel() for name in ("gain", "offset")
    )
    places = []
    currents = []
    biases = []
    for number, record in enumerate(records, 1):
        kind = next(
            (k for k in "iu" if all(f"{k}_{axis}" in record.signals for axis in machine.axes)), ""
        )
        if not kind:
            raise InvalidInput(
                f"record {number} of the levitated rotor lacks i_<axis> and u_<axis>; record the "
                "currents"
            )

        # means of the record: (y - offset)/gain along the actuators' axes, then at the bearings
        x = sensor_turn(machine) @ (
            (record.select([f"y_{axis}" for axis in machine.axes]).values.mean(axis=1) - offset)
            / gain
        )
        places.append(back @ x.reshape(-1, 2))
        currents.append(
            record.select([f"{kind}_{axis}" for axis in machine.axes])
            .values.mean(axis=1)
            .reshape(-1, 2)
        )
        biases.append(record.point.bias_current)

    # between sensor and bearing the shaft hangs through: a straight line does not tell that
    hangs, weight = static_sag(machine)
    held = [
        _held(machine, record) @ place.ravel()
        for record, place in zip(records, places, strict=True)
    ]
    places = [place + hangs for place in places]

    # weight and centre are told apart by another bias or another position alone
    free = (
        len(
            {
                (bias, tuple(np.round(place.ravel(), 6)))
                for bias, place in zip(biases, places, strict=True)
            }
        )
        > 1
    )

    # magnets without an offset, at each record's bias: displacements are then from the centre
    bearings = []
    bare = replace(
        machine,
        bearings=tuple(replace(item, magnetic_offset=(0.0, 0.0)) for item in machine.bearings),
    )
    centred = [operating_magnets(bare, bias) for bias in biases]
    for k, bearing in enumerate(machine.bearings):
        # v = (centre (2), and where free the load's change over k_s (2)) in 1e-4 m
        magnets = [own[k].of_force for own in centred]
        guess = weight[k]
        others = [force.reshape(-1, 2)[k] for force in held]
        k_s = np.array(centred[0][k].coefficients.negative_stiffness)

        def residual(
            v: np.ndarray,
            k: int = k,
            magnets: Any = magnets,
            guess: Any = guess,
            k_s: Any = k_s,
            others: Any = others,
        ) -> np.ndarray:
            # (force of the magnets at q - centre + weight - what holds the rotor) / k_s = 0, as a
            # displacement
            load = guess + v[2:] * k_s * _UNIT if free else guess
            pulls = []
            for i, q, p in zip(currents, places, magnets, strict=True):
                at = q[k] - v[:2] * _UNIT
                pulls.append(magnet.force(i[k, 0], i[k, 1], at[0], at[1], p))
            return np.ravel((np.array(pulls) + load - np.array(others)) / k_s / _UNIT)

        fit = least_squares(residual, np.zeros(4 if free else 2))

        # (J^T J)^-1 times the residual's variance per degree of freedom
        covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
        power = float(np.sum(fit.fun**2)) / max(len(fit.fun) - len(fit.x), 1)
        noise = np.sqrt(np.diag(covariance) * power)[:2] * _UNIT

        # a wrong weight moves the centre by dW / k_s; where it is an unknown, not at all
        doubt = np.zeros(2) if free else _WEIGHT * np.abs(guess) / k_s
        centre = fit.x[:2] * _UNIT
        for way, axis in enumerate(("zeta", "eta")):
            # run-out adds to the half-width whole: at what angle the rotor stood is not known
            half = float(2 * np.hypot(noise[way], doubt[way] / 2)) + sum(
                item.amplitude for item in pairs[k].runout
            )
            entries.append(
                Calibrated(
                    f"bearing {bearing.name} magnetic_offset {axis}",
                    "m",
                    bearing.magnetic_offset[way],
                    float(centre[way]),
                    half,
                )
            )
        bearings.append(replace(bearing, magnetic_offset=(float(centre[0]), float(centre[1]))))
    if not free:
        notes.append(
            "the weight is the model's, taken as right to 2 %; a record at another bias current "
            "makes it an unknown"
        )
    return replace(machine, bearings=tuple(bearings))
