"""Balancing: the masses that cancel what turns with the rotor, from records with or without trial
weights.

Every record, of the speed s, gives d_s = L_s R + A_s (U + W): unknown unbalance U of the planes,
run-out R of the sensors with their lag L_s (told from U by several speeds), known trial weights W.
A_s is the model's, or measured: (d_s with W less d_s without) W^-1. U follows by weighted least
squares over sensors and speeds (Goodman 1964, J. Eng. Ind. 86, 273); the correction is -U. A row
weighs by its noise and by a common relative error of the model, as large as the misfit asks for
(Paule & Mandel 1982): speeds with large vibration do not outvote the others for their small noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, as_several, check_positive, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.presentation import Presented
from ambrose.core.sampling import hold
from ambrose.core.statespace import select
from ambrose.identification.data_quality.diagnosis import screened
from ambrose.identification.findings import Code
from ambrose.identification.frf import Phasors, Step, phasors
from ambrose.identification.output_error.synchronous import synchronous_of
from ambrose.identification.parameters import COVERAGE
from ambrose.identification.validation.places import load_doubt, machine_at_load
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import Timing, match_axes, timing_of
from ambrose.machine.machine import Machine
from ambrose.machine.units import suggestion
from ambrose.model.assemble import assemble
from ambrose.model.effects.sensor import linearised, runout_phasors
from ambrose.model.plant import Plant, ports
from ambrose.model.static_load import Unbalance, residual_unbalance
from ambrose.model.uncertainty import perturbed, tolerances_around
from ambrose.record.files import read_record
from ambrose.record.record import Record

# Weighted least squares of 1x vectors, with a relative error of the model that the misfit asks for
# (Paule & Mandel 1982, J. Res. NBS 87, 377).


ILL = 30.0  # condition of the matrix above which planes are hardly told apart
LEAST = 0.01  # relative error of a model's coefficients at the least; assumed


def weighted_fit(
    X: np.ndarray, d: np.ndarray, noise: np.ndarray, size: np.ndarray, freedom: int, least: float
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Relative error of the coefficients, solution, its covariance and the condition of the matrix
    with columns of unit length.

    X (s, a, c), d and noise (s, a), size (s,): what the relative error, at the least ``least``, is
    of.
    """
    from scipy.optimize import brentq

    # records without noise would weigh without limit
    floor = 1e-24 * float(np.max(np.abs(d) ** 2)) + 1e-40

    def solved(error: float) -> tuple[float, np.ndarray, np.ndarray]:
        # rows over their standard deviation, sqrt(noise + (error size)^2)
        w = 1 / np.sqrt(noise + (error * size[:, None]) ** 2 + floor)
        M, right = (X * w[:, :, None]).reshape(-1, X.shape[2]), (d * w).ravel()
        x = np.linalg.lstsq(M, right)[0]
        return float(np.sum(np.abs(M @ x - right) ** 2)), x, M

    # Paule & Mandel: the common error at which the weighted misfit equals its expectation, the
    # freedom; where 10 is not enough, no root is sought
    error = least
    if freedom and solved(least)[0] > freedom:
        error = (
            brentq(lambda e: solved(e)[0] - freedom, least, 10.0, xtol=1e-6)
            if solved(10.0)[0] < freedom
            else 10.0
        )
    _, x, M = solved(error)

    # columns of unit length: the condition tells planes apart, not units
    length = np.linalg.norm(M, axis=0)
    s = np.linalg.svd(M / length, compute_uv=False)
    if s[-1] < 1e-9 * s[0]:
        raise InvalidInput(
            "these sensors and speeds do not distinguish the planes; use fewer planes, or "
            "another speed"
        )
    return float(error), x, np.linalg.inv(M.conj().T @ M), float(s[0] / s[-1])


def circle_of_95(freedom: int) -> float:
    """Radius of the circle that holds 95 % of a circular complex error, per standard deviation; the
    variance was estimated with this many complex degrees of freedom (one at the least).
    """
    from scipy.special import fdtri

    # |error|^2 / variance: F(2, 2 nu)
    return float(np.sqrt(fdtri(2, 2 * max(freedom, 1), 0.95)))


# What turns once with the rotor in a steady record: speed, the time of the key mark, and the
# phasors of signals.
#
# Angles count from the rotor's key mark, which points along the global x at angle zero, in the
# direction of spin.


UNBALANCE = "unbalance turns across it"  # why no axis along the shaft is balanced
# [rad] by which what turns may leave the stated speed over the record, where no mark is recorded
_OFF = 0.5
_STEADY = 0.1  # [rad] by which the angle may leave a straight line over the time


def revolution(record: Record, settle: float = 0.3) -> Step:
    """The steady turning of a record: its frequency is the speed [rad/s], its start a time [s] at
    which the mark is at angle zero, its stop the record's end.

    The angle comes from the signal ``angle`` [rad] or from the rising edges of ``key``, one per
    turn; without either the record (its time zero) begins at the mark, and the speed is the one
    that it states. What is before ``settle`` [s] is left out. Raises InvalidInput for a rotor at
    rest, and where the speed changes.
    """
    time = record.time
    if not np.ptp(time) > settle:
        raise invalid(
            "the record",
            f"{np.ptp(time):g} s long",
            f"longer than the {settle:g} s left out",
            "record longer",
        )

    # angle over time: from the edges of the key, the angle signal, or the record's own speed
    steady = record.between(time[0] + settle, np.inf)
    if "key" in record.signals:
        at, angle = _edges(steady)
    else:
        at = steady.time
        angle = (
            np.unwrap(steady["angle"]) if "angle" in record.signals else _own_angle(record, steady)
        )
    if len(at) < 3:
        raise invalid(
            "the record",
            f"{np.ptp(time):g} s long",
            f"at least three turns after {settle:g} s",
            "record longer",
        )

    # angle = speed (t - t_0) + offset by least squares; what is left of it is drift
    speed, offset = np.polyfit(at - at[0], angle, 1)
    drift = float(np.ptp(angle - speed * (at - at[0])))
    if speed <= 0:
        raise invalid(
            "the speed of the record",
            f"{speed:g} rad/s",
            "positive",
            "unbalance shows in a rotor that turns",
        )
    if drift > _STEADY:
        raise invalid(
            "the speed of the record",
            f"off a steady one by {drift:.2g} rad",
            "steady",
            "record at a held speed",
        )

    # the mark passes where the line is zero; then the first such time not before the record's start
    zero = at[0] - offset / speed
    turns = np.ceil((time[0] - zero) * speed / (2 * np.pi) - 1e-9)
    return Step(float(speed), float(zero + turns * 2 * np.pi / speed), float(time[-1] + record.dt))


def once_per_turn(
    record: Record, turn: Step, signals: tuple[str, ...], settle: float = 0.3
) -> Phasors:
    """The 1x phasors of ``signals``, y(t) = Re(value exp(j angle)), as a mean and block by block.
    Raises InvalidInput.
    """
    return phasors(record, turn, signals, settle)


def _edges(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] of the key's rising edges, and the angle 2 pi n [rad] at them."""
    key, time = record["key"], record.time
    level = (key.min() + key.max()) / 2

    # rising passages of the mid level, between samples by a straight line
    up = np.flatnonzero((key[:-1] < level) & (key[1:] >= level))
    if len(up) < 3:
        raise invalid(
            "the number of edges of the signal key",
            len(up),
            "at least 3",
            "record one pulse per turn, for longer",
        )
    at = time[up] + (level - key[up]) / (key[up + 1] - key[up]) * record.dt
    return at, 2 * np.pi * np.arange(len(at))


def _own_angle(record: Record, steady: Record) -> np.ndarray:
    """The angle (k,) [rad] of the steady part by the record's own speed, zero at its time zero."""
    turning, k = synchronous_of(steady, 1), steady.values.shape[1]
    if turning is None:
        raise InvalidInput(
            "the record is of a rotor at rest; unbalance is found with the rotor turning"
        )
    if "speed" not in record.signals:
        # the turning as the displacements show it: away is what it gains on the stated speed [rad]
        shown = [
            row - row.mean()
            for name, row in zip(steady.signals, steady.values, strict=True)
            if name[:2] == "y_"
        ]
        refined = turning.refined([np.array(shown)], k) or turning
        away = float(refined.frequencies(k)[0] - turning.rate) * k
        if abs(away) > _OFF:
            raise invalid(
                "the speed of the record",
                f"{turning.rate / steady.dt:.6g} rad/s",
                f"the true one: what turns gains {away:.2g} rad on it",
                "record key (a pulse per turn) or angle, or state the speed with more digits",
            )
        return np.asarray(turning.rate * steady.time / steady.dt)

    # the recorded speed's integral by trapezoids, from the record's time zero
    speed = np.abs(record["speed"])
    within = np.concatenate([[0.0], np.cumsum(speed[:-1] + speed[1:]) / 2]) * record.dt
    return np.asarray(within + speed[0] * record.start_time)[-k:]


# Influence coefficients: the 1x displacement that an unbalance in a plane makes, from the machine's
# model.
#
# Runs are compared by d = y - G v, the displacement that forces and run-out would make without the
# currents v: whatever the controller does, unbalance U enters it as W^2 G_f U, run-out as itself.
# In y alone slow-roll subtraction fails, for a magnetic bearing holds what its sensors read,
# run-out included. With S = (I + G K)^-1, y = S d. Letters: core/lft.py.


CURRENTS = "u_ of the record"
COILS = "i_ of the record"
LAW = "the controller"
NONE = ""


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """At one speed: per_unbalance (a, p) [m per kg m], d per unbalance of each plane; per_runout
    (a,), d per run-out: the sensors' lag; closed (a, a), y per d, or None where no controller is
    known; blocks (b, a) [m]: d of the record, block by block; size [m]: of d - y, of which the
    model's error is a share.
    """

    per_unbalance: np.ndarray
    per_runout: np.ndarray
    closed: np.ndarray | None
    blocks: np.ndarray
    size: float


def source_of_currents(record: Record, plant: Plant, controller: LawLike | None) -> str:
    """Where the currents at 1x are known from: the record's u_ or i_, else the controller; "" from
    nowhere.
    """
    if all(name in record.signals for name in plant.named("u")):
        return CURRENTS
    if all(name in record.signals for name in plant.named("i")):
        return COILS
    return NONE if controller is None else LAW


def influence(
    plant: Plant,
    planes: tuple[str, ...],
    controller: LawLike | None,
    record: Record,
    turn: Step,
    settle: float,
) -> Influence:
    """The coefficients of the model at a record's speed, and the record's d. Raises
    InvalidInput.
    """
    omega = np.array([turn.frequency])
    axes = plant.axes
    dt = record.dt
    forces = [name for plane in planes for name in _forces(plant, plane)]
    inputs, outputs = [*plant.named("u"), *forces], [*plant.named("y"), *plant.named("i")]

    # y, i (rows) from u, f (columns): G = y/u, G_i = i/u, H = y/f, two columns of H per plane
    P = frequency_response(select(plant.system, inputs, outputs), omega).values[0]
    a = len(axes)
    G = P[:a, :a]
    G_i = P[a:, :a]
    H = P[:a, a:]

    # W^2 U exp(j W t) in a plane: the force's phasor is (1, -j) along x and y, and exp(-j angle)
    # times that along ports turned by angle
    angle = {port.name: port.direction for port in ports(plant.machine)}
    first = np.array([angle[forces[2 * i].removeprefix("f_")] for i in range(len(planes))])
    along = np.exp(-1j * first)  # U exp(j angle) rotates as (1, -j) along x and y
    per_unbalance = omega[0] ** 2 * (H[:, 0::2] - 1j * H[:, 1::2]) * along

    # S = (I + G K)^-1, K with its hold where it is sampled
    closed = None
    if controller is not None:
        timing = timing_of(plant.machine, controller) or Timing(dt)
        law = law_of(controller).at(plant.point)
        law = match_axes(timing.in_loop(law), axes, repr(plant.machine.name))
        K = frequency_response(law, omega).values[0] * (
            1.0 if law.dt is None else hold(omega, law.dt)[0]
        )
        closed = np.linalg.inv(np.eye(a) + G @ K)

    # d = y - G v, block by block as rows
    source = source_of_currents(record, plant, controller)
    kinds = {CURRENTS: ("y", "u", "e"), COILS: ("y", "i")}.get(source, ("y",))
    blocks = once_per_turn(
        record, turn, tuple(f"{kind}_{axis}" for kind in kinds for axis in axes), settle
    ).blocks
    y = shown = blocks[:, :a]
    if source == CURRENTS:
        # v = hold (u + e): the commands are held over a sample
        y = y - (blocks[:, a : 2 * a] + blocks[:, 2 * a :]) @ (G * hold(omega, dt)[0]).T
    elif source == COILS:
        # coil currents i = G_i v, hence G v = G G_i^-1 i
        y = y - blocks[:, a:] @ np.linalg.solve(G_i.T, G.T)
    elif closed is not None:
        # d = S^-1 y
        y = y @ np.linalg.inv(closed).T

    # root mean square of d - y over the axes
    size = float(np.sqrt(np.mean(np.abs(np.mean(y - shown, axis=0)) ** 2)))
    return Influence(per_unbalance, _sensors_lag(plant, omega), closed, y, size)


def _sensors_lag(plant: Plant, omega: np.ndarray) -> np.ndarray:
    """The response (a,) of the measured signals to what their sensors see, over that at rest."""
    sensors = linearised(plant.machine.sensor_pairs, plant.axes)

    # least squares of the response turning on that at rest, row by row: 1 for sensors without lag
    rest, turning = frequency_response(sensors, np.array([0.0, omega[0]])).values
    return np.asarray(np.sum(turning * rest, axis=1) / np.sum(rest * rest, axis=1))


def _forces(plant: Plant, plane: str) -> list[str]:
    found = [f"f_{port}" for port in plant.ports if port.rpartition("_")[0] == plane]
    if not found:
        known = dict.fromkeys(port.rpartition("_")[0] for port in plant.ports)
        raise InvalidInput(
            f"there is no plane {plane!r}: it names a bearing, coupling, seal or disc; "
            f"{suggestion(plane, known)}"
        )
    return found


_SAME_SPEED = 0.01  # relative difference below which two records are of one speed
_APART = 1.3  # least ratio of speeds that tells run-out from unbalance
_REFINEMENTS = 6
# of records without excitation: what is turning is checked by ``revolution``
_SETTLED = (Code.MOVING_POINT, Code.FAR_FROM_START, Code.NO_RESPONSE, Code.DUPLICATE_RECORD)


@dataclass(frozen=True, slots=True)
class Row:
    """One sensor axis at one speed [rad/s]: 1x of unbalance before, and as predicted after the
    correction (complex) [m]; radius [m] of the circle about the prediction that holds the truth
    with 95 %.
    """

    axis: str
    speed: float
    before: complex
    after: complex
    radius: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Balancing(Presented):
    """What to add to a rotor: correction (p,) complex [kg m] of the planes, angles from the key
    mark in the direction of spin.

    covariance (p, p) [kg2 m2] of the correction; factor: radius of a 95 % circle per standard
    deviation. radii (p,) [m] where the masses go. condition: of the weighted matrix. model_error:
    the relative error of the coefficients that the misfit asks for. method: "model" or "trial
    weights". quantity: what the rows are of. runout (a,) [m], complex, and whether it was found.
    scale: model over measured coefficients, where trial weights tell. allowed: by the machine's
    grade, or None. trusted: whether the records show no fault, and the machine file's magnets carry
    the rotor with the currents that were recorded.
    """

    machine: str
    planes: tuple[str, ...]
    radii: tuple[float, ...]
    correction: np.ndarray
    covariance: np.ndarray
    factor: float
    condition: float
    model_error: float
    method: str
    quantity: str
    rows: tuple[Row, ...]
    runout: np.ndarray
    runout_found: bool
    scale: complex | None
    allowed: Unbalance | None
    notes: tuple[str, ...] = ()
    trusted: bool = True

    @property
    def masses(self) -> np.ndarray:
        """Correction masses (p,) [kg] at the radii."""
        return np.abs(self.correction) / np.array(self.radii)

    @property
    def angles(self) -> np.ndarray:
        """Their angles (p,) [rad], 0 to 2 pi."""
        return np.asarray(np.angle(self.correction) % (2 * np.pi))

    @property
    def uncertainty(self) -> np.ndarray:
        """95 % radius (p,) [kg m] of each correction: as much unbalance may be left in its
        plane.
        """
        return self.factor * np.sqrt(np.real(np.diag(self.covariance)))

    @property
    def remaining(self) -> float | None:
        """Predicted 1x after over before, root mean square over all rows, at the outer end of the
        intervals; None where nothing turns with the rotor.
        """
        before = float(np.linalg.norm([row.before for row in self.rows]))
        left = np.array([abs(row.after) + row.radius for row in self.rows])
        return float(np.linalg.norm(left)) / before if before else None

    @property
    def passed(self) -> bool:
        """Whether the planes are told apart, run-out is known, the model is trusted, and the
        vibration falls with 95 %.
        """
        known = self.runout_found or bool(self.runout.any())
        left = self.remaining
        falls = left is not None and left < 1
        return self.condition <= ILL and falls and known and self.trusted

    def grade(self, moments: np.ndarray) -> float | None:
        """Balance quality G [m/s] at the balancing speed of planes with these moments (p,) [kg m]
        all in phase.
        """
        return (
            None
            if self.allowed is None
            else float(np.sum(moments)) * self.allowed.speed / self.allowed.mass
        )

    def to_dict(self) -> dict[str, Any]:
        """The corrections in g and degrees with their intervals, the rows, and all that was
        told.
        """
        whole = Presented.to_dict(self)
        sure = np.minimum(self.uncertainty / np.maximum(np.abs(self.correction), 1e-300), 1.0)
        whole["corrections"] = [
            {
                "plane": plane,
                "radius_mm": 1e3 * r,
                "mass_g": 1e3 * m,
                "angle_deg": at,
                "mass_95_g": 1e3 * u / r,
                "angle_95_deg": a,
            }
            for plane, r, m, at, u, a in zip(
                self.planes,
                self.radii,
                self.masses.tolist(),
                np.degrees(self.angles).tolist(),
                self.uncertainty.tolist(),
                np.degrees(np.arcsin(sure)).tolist(),
                strict=True,
            )
        ]
        # before, after and radius are amplitudes zero to peak
        whole["rows"] = [
            {
                key if key in ("axis", "speed") else f"{key}_m_0p": value
                for key, value in row.items()
            }
            for row in whole["rows"]
        ]
        return {**whole, "remaining": self.remaining}


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """A record with its plant, its turning and the trial weights (p,) [kg m] in it."""

    record: Record
    plant: Plant
    speed: float
    weights: np.ndarray
    at: Influence

    @property
    def d(self) -> np.ndarray:
        return np.asarray(self.at.blocks.mean(axis=0))

    @property
    def noise(self) -> np.ndarray:
        """Variance (a,) [m2] of the mean of the blocks."""
        # sum |block - mean|^2 / (b (b - 1))
        b = len(self.at.blocks)
        return np.asarray(np.sum(np.abs(self.at.blocks - self.d) ** 2, axis=0) / (b - 1) / b)


def balance(
    machine: Machine,
    records: Record | str | Path | Sequence[Record | str | Path],
    planes: Mapping[str, float],
    *,
    trials: Sequence[tuple[Record | str | Path, Mapping[str, complex]]] = (),
    controller: LawLike | None = None,
    settle: float = 0.3,
) -> Balancing:
    """Correction masses in ``planes`` from the 1x of displacements and currents of records at
    steady speeds.

    records: as they are or their files, of the rotor as it is, at one speed or several; one at
    slow roll gives the run-out. planes: bearings, couplings, seals or discs of the machine file,
    each
    with the radius [m] where masses go. trials: records with known weights on, each with m r exp(j
    angle) [kg m] by plane; as many as planes at one speed measure the coefficients there, fewer are
    fitted beside the model's. controller: the one that ran; needed where the records hold neither
    u_<axis> nor i_<axis>, and for 1x as it will be measured. settle [s]: left out at the beginning
    of every record. Raises InvalidInput.
    """
    machine.across_the_shaft(UNBALANCE)
    names = tuple(planes)
    if not names:
        raise InvalidInput(
            "no correction plane is given; name a bearing, disc, seal or coupling of the machine, "
            "and a radius"
        )

    # planes, their radii, and the records read
    radii = tuple(
        check_positive(r, f"the radius of plane {name}", "give it in m")
        for name, r in planes.items()
    )
    several = as_several(records)
    if not several:
        raise InvalidInput(
            "no record of the rotor without trial weights is given; record it as it is first"
        )
    read = [read_record(item) for item in several]
    tried = [(read_record(item), _weights(given, names)) for item, given in trials]

    # what the records show of themselves, and of the controller where it is known
    every = [*read, *(record for record, _ in tried)]
    found = screened(
        machine,
        every,
        controller,
        computing_delay=_delay(machine, controller),
        excited="",
        settled=_SETTLED,
    )

    def run(record: Record, weights: np.ndarray) -> _Run:
        turn = revolution(record, settle)
        plant = assemble(machine_at_load(machine, [record]), record.point)
        return _Run(
            record,
            plant,
            turn.frequency,
            weights,
            influence(plant, names, controller, record, turn, settle),
        )

    # every record's d, A and L at its speed; those as they are carry no weights
    none = np.zeros(len(names), complex)
    runs, with_weights = (
        [run(record, none) for record in read],
        [run(record, weights) for record, weights in tried],
    )

    # what the angle and the currents rest on; one d for all: without currents anywhere d = y
    notes = [f"finding: {item}" for item in found]
    notes += [doubt] if (doubt := load_doubt(machine, read)) else []
    if controller is None and any(name.startswith("u_") for r in every for name in r.signals):
        notes.append(
            "u_ was not held against the controller; give it (--controller), and scale and time of "
            "y and u are checked"
        )
    if not any(name in r.signals for r in read for name in ("key", "angle")):
        notes.append(
            "no record contains key or angle: its time zero is taken as the passage of the key mark"
        )
    sources = {
        source_of_currents(one.record, one.plant, controller) for one in (*runs, *with_weights)
    }
    if NONE in sources and len(sources) > 1:
        raise InvalidInput(
            "some records have the currents u_ or i_ and others do not; give --controller, or "
            "record them in all"
        )
    blind = sources == {NONE}

    # U, then its change with each uncertain parameter at the end of its tolerance, taken as
    # COVERAGE standard deviations: covariance += (dU/c) (dU/c)^H
    first = _estimate(machine, names, runs, with_weights, blind)
    spread = np.zeros((len(names), len(names)), complex)
    if not blind:
        around = dict.fromkeys(
            tolerance.parameter
            for one in (*runs, *with_weights)
            for tolerance in tolerances_around(one.plant)
        )
        for parameter in around:
            moved = _moved(machine, names, runs, with_weights, parameter, controller, settle)
            change = (moved.unbalance - first.unbalance) / COVERAGE
            spread += np.outer(change, change.conj())
    covariance = first.covariance + spread
    if first.condition > ILL:
        notes.append(
            f"the unknowns are poorly distinguished (condition {first.condition:.3g}): add a "
            "record at another speed, or use "
            "fewer planes"
        )
    if not first.runout_found:
        what = (
            "from the machine file"
            if first.runout.any()
            else "zero, and balanced as if it were unbalance"
        )
        notes.append(
            f"the records are of one speed: run-out was taken as {what}; a record at slow roll "
            "measures it"
        )

    # rows in y = S d where the loop is known at every run (blind: d is y as it is), else in d
    closed = [one.at.closed for one in runs]
    in_y = blind or all(S is not None for S in closed)
    rows = []
    for one, A, var in zip(runs, first.influence, first.noise, strict=True):
        S = one.at.closed if in_y and one.at.closed is not None else np.eye(len(A))

        # before: d - L R, what unbalance makes; after the correction -U: d - L R - A U
        turning = one.d - one.at.per_runout * first.runout
        left = turning - A @ first.unbalance

        # covariance of what is left, S (A cov(U) A^H + noise) S^H, as a circle of 95 % per axis
        C = S @ (A @ covariance @ A.conj().T + np.diag(var)) @ S.conj().T
        before = S @ turning
        after = S @ left
        radius = first.factor * np.sqrt(np.real(np.diag(C)))
        for axis, b, c, r in zip(machine.axes, before, after, radius, strict=True):
            rows.append(Row(axis, one.speed, complex(b), complex(c), float(r)))
    return Balancing(
        machine.name,
        names,
        radii,
        -first.unbalance,
        covariance,
        first.factor,
        first.condition,
        first.model_error,
        first.method,
        "y" if in_y else "y - G u",
        tuple(rows),
        first.runout,
        first.runout_found,
        first.scale,
        residual_unbalance(machine),
        tuple(notes),
        not (doubt or found),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """U (p,), its covariance by noise and misfit, and with what it was found; influence and noise
    per run without weights.
    """

    unbalance: np.ndarray
    covariance: np.ndarray
    runout: np.ndarray
    runout_found: bool
    influence: list[np.ndarray]
    noise: list[np.ndarray]
    condition: float
    model_error: float
    factor: float
    method: str
    scale: complex | None


def _estimate(
    machine: Machine,
    planes: tuple[str, ...],
    runs: Sequence[_Run],
    trials: Sequence[_Run],
    blind: bool,
) -> _Estimate:
    p, a = len(planes), len(machine.axes)
    speeds = [run.speed for run in runs]

    # run-out is an unknown where speeds are apart: it does not grow as unbalance does
    free = len(runs) > 1 and max(speeds) > _APART * min(speeds)
    R = np.zeros(a, complex) if free else runout_phasors(machine.sensor_pairs, machine.axes)

    # A_s of every run: the model's, or measured where trial weights span all planes there
    influences = []
    extra = []
    measured = False
    scales = []
    for run in runs:
        own = [trial for trial in trials if abs(trial.speed / run.speed - 1) < _SAME_SPEED]
        A, back = run.at.per_unbalance, None
        if own:
            # W (p, t): the weights of the trial runs at this speed, a column each
            W = np.array([trial.weights for trial in own]).T
            if np.linalg.matrix_rank(W, 1e-6 * float(np.abs(W).max())) == p:
                back = np.linalg.pinv(W)
                change = np.array([trial.d - run.d for trial in own]).T
                if not change.any(axis=0).all():
                    raise InvalidInput(
                        "a trial run is the very run without weights; give the record with the "
                        "weight on"
                    )

                # A_s = (d with W - d without) W^+
                A = change @ back
                measured = True

                # model = scale * measured by least squares
                scales.append(np.vdot(A, run.at.per_unbalance) / np.vdot(A, A))
        influences.append(A)
        extra.append((own, back))
    if blind and not all(back is not None for _, back in extra):
        raise InvalidInput(
            "the records have neither u_<axis> nor i_<axis>; give the controller that ran, or "
            "trial weights in every plane at "
            "every speed"
        )

    # the error of measured coefficients is in their noise; a model's is never taken as nothing
    least = 0.0 if measured else LEAST

    # trial runs that do not span the planes are rows of their own, beside the model's A_s
    beside = (
        []
        if measured
        else [t for t in trials if any(abs(t.speed / s - 1) < _SAME_SPEED for s in speeds)]
    )
    if trials and not measured and not beside:
        raise invalid(
            "the speed of the trial runs",
            f"{trials[0].speed:.5g} rad/s",
            "that of a run without weights",
            "repeat it",
        )

    # rows (s, a): runs as they are, then trial runs less A_s W; unknowns U (p), then R (a) if free:
    # d_s = A_s U + L_s R
    d = np.array(
        [run.d for run in runs] + [run.d - run.at.per_unbalance @ run.weights for run in beside]
    )
    A = np.array(influences + [run.at.per_unbalance for run in beside])
    lag = np.array([run.at.per_runout for run in (*runs, *beside)])
    X = np.concatenate([A, lag[:, :, None] * np.eye(a)], axis=2) if free else A
    target = d if free else d - lag * R

    # complex equations less complex unknowns
    freedom = target.size - X.shape[2]
    if freedom < 0:
        raise invalid(
            "the number of unknowns",
            X.shape[2],
            f"at most {target.size}, that of 1x vectors",
            "add a record",
        )

    # what the model's relative error is of: |A_s U| and the part of d that the currents make, both
    # the model's; U is not known at first, so that the size of d itself begins
    by_currents = np.array([run.at.size for run in (*runs, *beside)])
    size, U = np.sqrt(np.mean(np.abs(target) ** 2, axis=1)), np.zeros(p, complex)

    # noise of measured coefficients and size depend on U: weights and U in turn
    for _ in range(_REFINEMENTS):
        noise = np.array(
            [_noise(run, own, back, U) for run, (own, back) in zip(runs, extra, strict=True)]
            + [r.noise for r in beside]
        )
        error, x, C, condition = weighted_fit(X, target, noise, size, freedom, least)
        U = x[:p]
        size = np.hypot(np.sqrt(np.mean(np.abs(A @ U) ** 2, axis=1)), by_currents)
    if free:
        R = x[p:]

    # the variance was told by the misfit where that is the larger, else by the blocks' scatter
    blocks = min(len(run.at.blocks) for run in runs)
    factor = circle_of_95(freedom if error > least else (blocks - 1) * a)
    with_error = [*(noise + (error * size[:, None]) ** 2)][: len(runs)]
    return _Estimate(
        U,
        C[:p, :p],
        R,
        free,
        influences,
        with_error,
        condition,
        error,
        factor,
        "trial weights" if measured else "model",
        complex(np.mean(scales)) if scales and not blind else None,
    )


def _noise(run: _Run, own: Sequence[_Run], back: np.ndarray | None, U: np.ndarray) -> np.ndarray:
    """Variance (a,) of a run's equation: its own noise, and that of the coefficients measured with
    trial weights.
    """
    if back is None:
        return run.noise

    # d - A U = (1 + sum c_t) d - sum c_t d_t with c = W^+ U: var = |1 + sum c_t|^2 var d +
    # sum |c_t|^2 var d_t
    c = back @ U
    trials = sum(abs(share) ** 2 * trial.noise for share, trial in zip(c, own, strict=True))
    return np.asarray(abs(1 + c.sum()) ** 2 * run.noise + trials)


def _moved(
    machine: Machine,
    planes: tuple[str, ...],
    runs: Sequence[_Run],
    trials: Sequence[_Run],
    path: str,
    controller: LawLike | None,
    settle: float,
) -> _Estimate:
    """The estimate with one uncertain parameter at the end of its tolerance, in the runs around
    which it has one.
    """

    def moved(run: _Run) -> _Run:
        held = [item for item in tolerances_around(run.plant) if item.parameter == path]
        if not held:
            return run
        plant = perturbed(run.plant, {path: 1.0}, held)
        turn = revolution(run.record, settle)
        at = influence(plant, planes, controller, run.record, turn, settle)
        return _Run(run.record, plant, run.speed, run.weights, at)

    return _estimate(
        machine, planes, [moved(run) for run in runs], [moved(run) for run in trials], False
    )


def _delay(machine: Machine, controller: LawLike | None) -> int:
    """Samples from measured errors to currents set."""
    timing = None if controller is None else timing_of(machine, controller)
    return 1 if timing is None else timing.delay_samples


def _weights(given: Mapping[str, complex], planes: tuple[str, ...]) -> np.ndarray:
    for name in given:
        if name not in planes:
            raise InvalidInput(
                f"there is a trial weight in {name!r}, which is not a correction plane; "
                f"{suggestion(name, planes)}"
            )
    weights = np.array([complex(given.get(name, 0.0)) for name in planes])
    if not np.isfinite(weights).all() or not weights.any():
        raise invalid(
            "a trial weight",
            weights,
            "finite and not zero",
            "give m r exp(j angle) in kg m by plane",
        )
    return weights
