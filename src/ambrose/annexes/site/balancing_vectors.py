"""The unbalance of a rotor from the amplitudes of a converged synchronous block: no trial weights.

Once a block of mode current-free has converged the control current has no 1x part, so that what is
measured is the rotor's own response, y = c = Re(exp(j theta) a):

    a(W) = sum_p G_p(W) W^2 U_p + L(W) R                                                 (1)
    G_p: displacement per forward force in plane p;  R: run-out of the sensors, L their lag

with the plant's G at the speed, magnets' negative stiffness included. Amplitudes of several speeds
are one linear least-squares problem in the complex U_p [kg m] (Fang et al., Sensors 13 (2013)
16000, balance from coil currents in one start-up). Run-out does not grow with W^2 and is solved for
beside the unbalance where the speeds are apart. No controller enters: its current is zero.

The change since an earlier table is a problem of the same form, of the difference of amplitudes:
run-out and what both have in common drop out. It tells an unbalance that grows.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ambrose.annexes.site.balancing import (
    ILL,
    LEAST,
    UNBALANCE,
    Balancing,
    Row,
    circle_of_95,
    weighted_fit,
)
from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.presentation import Presented
from ambrose.core.statespace import select
from ambrose.identification.parameters import COVERAGE
from ambrose.law.law import LawLike, law_of
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import read_text
from ambrose.machine.units import suggestion
from ambrose.model.assemble import assemble
from ambrose.model.effects.sensor import runout_phasors
from ambrose.model.plant import Plant, beyond_top_speed, ports
from ambrose.model.static_load import residual_unbalance
from ambrose.model.uncertainty import perturbed, tolerances_around

# A table of 1x amplitudes: what converged synchronous blocks hold, or vectors read off a monitor.
#
# One line per axis and speed, with this head:
#
#     speed_rpm,axis,amplitude_um_0p,angle_deg
#     7640,upper_zeta,12.1,38.2
#
# The amplitude is zero to peak; a column amplitude_um_pp, as monitors have it, is peak to peak. Its
# angle is that of y(t) = Re(a exp(j theta)), theta the angle of the key mark from x in the
# direction of spin: the angle of the block's own a. (A monitor's phase lag is minus it.) Several
# lines of one axis and speed are readings of the same vector.


COLUMNS = ("speed_rpm", "axis", "amplitude_um_0p", "angle_deg")
_PEAK_TO_PEAK = "amplitude_um_pp"  # in place of the third
_RPM = 2 * math.pi / 60  # rad/s per rpm
_SAME_SPEED = 0.01  # relative difference below which lines are of one speed
_MOST = 100_000  # lines


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudeTable:
    """speeds (s,) [rad/s]; values (s, a) complex [m], the mean of the readings; noise (s, a) [m2],
    the variance of that mean (0 where one reading is all).
    """

    speeds: np.ndarray
    values: np.ndarray
    noise: np.ndarray

    def since(self, before: AmplitudeTable) -> AmplitudeTable:
        """What has come since an earlier table, a - a_before at the speeds that both have. Run-out,
        which both hold, drops out. Raises InvalidInput where no speed is in both.
        """
        pairs = [
            (k, int(np.argmin(np.abs(before.speeds - speed))))
            for k, speed in enumerate(self.speeds)
        ]
        same = [
            (k, j) for k, j in pairs if abs(before.speeds[j] / self.speeds[k] - 1) < _SAME_SPEED
        ]
        if not same:
            raise InvalidInput(
                "no speed of the table is in the earlier one; read both at the same speeds"
            )
        now, then = [k for k, _ in same], [j for _, j in same]
        return AmplitudeTable(
            self.speeds[now],
            self.values[now] - before.values[then],
            self.noise[now] + before.noise[then],
        )


def read_amplitudes(path: str | Path, axes: Sequence[str]) -> AmplitudeTable:
    """The table of a file, in the order of a machine's axes. Raises InvalidInput for a file that is
    none, another head, an axis that the machine does not have or that a speed lacks.
    """
    name = Path(path).name
    text = read_text(path, "table of amplitudes")
    try:
        lines = list(csv.DictReader(x for x in text.splitlines() if not x.startswith("#")))
    except csv.Error as error:
        raise InvalidInput(
            f"the amplitudes {name} cannot be read ({error}); give a text file with the columns "
            f"{', '.join(COLUMNS)}"
        ) from None
    for line in lines:
        if _PEAK_TO_PEAK in line and COLUMNS[2] not in line:
            line[COLUMNS[2]] = _half(line[_PEAK_TO_PEAK])
    if not lines or any(column not in lines[0] for column in COLUMNS):
        found = "no line" if not lines else ", ".join(str(key) for key in lines[0])
        raise invalid(
            f"the head of {name}",
            found,
            f"{', '.join(COLUMNS)} (or {_PEAK_TO_PEAK})",
            "name the columns so, in these units",
        )
    if len(lines) > _MOST:
        raise invalid(f"the lines of {name}", len(lines), f"at most {_MOST}", "thin them out")

    # readings by speed, then by axis
    speeds: list[float] = []
    readings: list[dict[str, list[complex]]] = []
    for number, line in enumerate(lines, start=2):
        speed, value = _reading(line, name, number)
        axis = (line["axis"] or "").strip()
        if axis not in axes:
            raise InvalidInput(
                f"line {number} of {name}: the machine has no axis {axis!r}; "
                f"{suggestion(axis, axes)}"
            )
        near = [k for k, known in enumerate(speeds) if abs(known / speed - 1) < _SAME_SPEED]
        if not near:
            speeds.append(speed)
            readings.append({})
        at = near[0] if near else len(speeds) - 1
        readings[at].setdefault(axis, []).append(value)

    for speed, by_axis in zip(speeds, readings, strict=True):
        missing = [axis for axis in axes if axis not in by_axis]
        if missing:
            raise InvalidInput(
                f"{name} has no line of {', '.join(missing)} at {speed / _RPM:.5g} rpm; give every "
                "axis at every speed"
            )

    order = np.argsort(speeds)
    means = [[complex(np.mean(by_axis[axis])) for axis in axes] for by_axis in readings]
    noise = [[_variance(by_axis[axis]) for axis in axes] for by_axis in readings]
    return AmplitudeTable(np.array(speeds)[order], np.array(means)[order], np.array(noise)[order])


def _half(text: str | None) -> str | None:
    """Zero to peak of a number peak to peak; what is none stays as it is, for the message."""
    try:
        return repr(float(text or "") / 2)
    except ValueError:
        return text


def _reading(line: dict[str, str | None], name: str, number: int) -> tuple[float, complex]:
    """Speed [rad/s] and a [m] of a line."""
    figures = []
    for column in ("speed_rpm", COLUMNS[2], "angle_deg"):
        try:
            figures.append(float(line[column] or ""))
        except ValueError:
            figures.append(math.nan)
        if not math.isfinite(figures[-1]):
            raise InvalidInput(
                f"line {number} of {name}: {column} is {line[column]!r}, no finite number; write "
                "it with a point and without its unit"
            )
    rpm, amplitude, angle = figures
    if rpm <= 0 or amplitude < 0:
        raise InvalidInput(
            f"line {number} of {name}: {rpm:g} rpm and {amplitude:g} um; a speed is above zero and "
            "an amplitude not below, turn the angle by 180 degrees instead"
        )
    # a = |a| exp(j angle)
    turned = complex(math.cos(math.radians(angle)), math.sin(math.radians(angle)))
    return rpm * _RPM, 1e-6 * amplitude * turned


def _variance(values: Sequence[complex]) -> float:
    """Of the mean of readings, sum |a - mean|^2 / (n (n - 1)); zero of a single one."""
    n = len(values)
    if n < 2:
        return 0.0
    return float(np.sum(np.abs(np.array(values) - np.mean(values)) ** 2) / (n * (n - 1)))


# Corrections from 1x vectors as read off an instrument, without a machine: initial run and trial
# runs, or influence coefficients.
#
# With the initial vectors v (m,) and A (m, p), vectors per correction in each plane, corrections w
# leave r = v + A w (Goodman 1964, J. Eng. Ind. 86, 273). What is small of r is the norm's:
#
#     squares:  sum |r_k|^2     least squares
#     sum:      sum |r_k|       a reading that is wrong hardly counts
#     largest:  max |r_k|       the worst reading (Foiles, Allaire & Gunter 2000, IMechE C576/097)
#
# Readings and corrections have any units; those of A are theirs.


# share of a column that no other explains, below which its plane is none of its own
DEPENDENT = 0.2  # Darlow 1982 (ASME 82-GT-269), as recommended there
_ROUNDS = 300  # of weights
_STILL = 1e-12  # relative change of the corrections that ends them


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class VectorCorrection(Presented):
    """correction (p,) complex, left (m,) complex: the readings as predicted with it; condition: of
    the coefficients with columns of unit length; leave_out: planes whose column the others explain
    but for ``DEPENDENT`` of it; norm: what was made small.
    """

    planes: tuple[str, ...]
    correction: np.ndarray
    left: np.ndarray
    condition: float
    leave_out: tuple[str, ...]
    norm: str

    @property
    def sizes(self) -> np.ndarray:
        """Size (p,) of each correction."""
        return np.abs(self.correction)

    @property
    def angles(self) -> np.ndarray:
        """Angle (p,) of each correction [rad], 0 to 2 pi."""
        return np.asarray(np.angle(self.correction) % (2 * np.pi))

    def __str__(self) -> str:
        rows = [
            f"{plane}: {size:.4g} at {np.degrees(angle):.1f} deg"
            for plane, size, angle in zip(self.planes, self.sizes, self.angles, strict=True)
        ]
        if self.leave_out:
            rows.append(
                f"{' and '.join(self.leave_out)} poorly distinguished from the other "
                f"planes (condition {self.condition:.3g}): leave out"
            )
        return "\n".join(rows)


def coefficients_of_trials(
    initial: ArrayLike, trials: ArrayLike, weights: ArrayLike, kept: bool = False
) -> np.ndarray:
    """Influence coefficients (m, p) of p planes from trial runs, each with a weight in one plane.

    initial (m,), trials (m, p): readings; column j with the weight ``weights[j]`` complex in plane
    j. kept: whether a trial weight stays on in the runs after it. Raises InvalidInput.
    """
    W = _vectors(weights, "weights", "(p,)")
    v = _vectors(initial, "initial", "(m,)")
    runs = _vectors(trials, "trials", "(m, p)", m=len(v), p=len(W))
    if not W.all():
        raise invalid("a trial weight", 0, "not zero", "give the mass added, with its angle")

    # A_j = (run with W_j - run before it) / W_j
    before = np.column_stack([v, runs[:, :-1]]) if kept else v[:, None]
    return np.asarray((runs - before) / W)


def balance_vectors(
    initial: ArrayLike,
    coefficients: ArrayLike,
    *,
    norm: str = "squares",
    limits: Mapping[str, float] | None = None,
    planes: Sequence[str] = (),
) -> VectorCorrection:
    """Corrections in p planes from m readings (complex, 0 degrees and direction as they are read).

    initial (m,): run-out taken off. coefficients (m, p): readings per correction. norm: "squares",
    "sum" or "largest" of the readings left. limits: the largest correction by plane. planes: their
    names (none: "1", "2", ...). Raises InvalidInput for fewer readings than planes, and for columns
    that depend on one another.
    """
    v = _vectors(initial, "initial", "(m,)")
    A = _vectors(coefficients, "coefficients", "(m, p)", m=len(v))
    names = tuple(planes) or tuple(str(number) for number in range(1, A.shape[1] + 1))
    if len(names) != A.shape[1]:
        raise invalid("the number of planes", len(names), f"{A.shape[1]}, one per column", "name")
    if len(v) < len(names):
        raise InvalidInput(
            f"{len(v)} readings cannot tell {len(names)} planes; read more sensors or speeds, or "
            "leave planes out"
        )
    if norm not in _NORMS:
        raise invalid("norm", repr(norm), f"one of {', '.join(_NORMS)}", "choose")
    most = _limits(names, limits or {})

    condition, dependent = _independence(A)
    if not np.isfinite(condition):
        raise InvalidInput(
            f"plane {names[dependent[0]]} does what others do; leave it out, or read another speed"
        )

    # readings and columns of size one, for the solver's sake
    size, length = float(np.abs(v).max()) or 1.0, np.linalg.norm(A, axis=0)
    w = _NORMS[norm](A / length, v / size, most * length / size) * size / length
    return VectorCorrection(
        names, w, v + A @ w, condition, tuple(names[j] for j in dependent), norm
    )


def _vectors(values: ArrayLike, name: str, shape: str, **sizes: int) -> np.ndarray:
    """What was read or put on, complex. Raises InvalidInput."""
    try:
        numbers = np.asarray(values, complex)
    except (TypeError, ValueError, OverflowError):
        raise invalid(
            name, repr(values)[:40], "complex numbers", "give size * exp(1j * angle) of each"
        ) from None
    return check_shape(numbers, name, shape, **sizes)


def _limits(names: Sequence[str], limits: Mapping[str, float]) -> np.ndarray:
    """The largest correction (p,) of each plane, infinite where none is given."""
    for name, limit in limits.items():
        if name not in names:
            raise InvalidInput(f"there is no plane {name!r}; {suggestion(name, names)}")
        check_positive(limit, f"the limit of plane {name}", "leave it out for none")
    return np.array([limits.get(name, np.inf) for name in names], float)


def _independence(A: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """Condition of A with columns of unit length, and the columns that the larger ones explain but
    for ``DEPENDENT``: Gram and Schmidt, the largest rest first (Darlow 1982).
    """
    from scipy.linalg import qr

    length = np.linalg.norm(A, axis=0)
    if not length.all():
        return np.inf, tuple(np.flatnonzero(length == 0).tolist())
    R, order = qr(A, mode="r", pivoting=True)
    share = np.abs(np.diag(R)) / length[order]
    dependent = tuple(int(j) for j in order[share < DEPENDENT])
    s = np.linalg.svd(A / length, compute_uv=False)
    return (float(s[0] / s[-1]) if s[-1] > 1e-9 * s[0] else np.inf), dependent


def _least_squares(
    A: np.ndarray, v: np.ndarray, most: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray:
    """The w with the least sum of weights |v + A w|^2, |w_j| <= most_j."""
    root = 1.0 if weights is None else np.sqrt(weights / weights.max())
    M, right = A * np.reshape(root, (-1, 1)), v * root
    w = np.asarray(np.linalg.lstsq(M, -right)[0])
    if (np.abs(w) <= most).all():
        return w

    # gradient of |r|^2 with respect to Re w and Im w: 2 Re and 2 Im of A^H r
    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        r = right + M @ _complex(x)
        return float(np.vdot(r, r).real), 2 * _real(M.conj().T @ r)

    return _complex(_convex(cost, _real(_within(w, most)), [_discs(most)]))


def _least_sum(A: np.ndarray, v: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The w with the least sum of |v + A w|, by weights 1/|r_k| anew until w stands still."""
    w = _least_squares(A, v, most)
    for _ in range(_ROUNDS):
        r = np.abs(v + A @ w)

        # a reading that is met exactly would weigh without limit
        moved = _least_squares(A, v, most, 1 / np.maximum(r, 1e-9))
        still = np.abs(moved - w).max() <= _STILL * np.abs(moved).max()
        w = moved
        if still:
            break
    return w


def _least_largest(A: np.ndarray, v: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The w with the least t such that |v + A w|^2 <= t^2 in every row."""
    w = _least_squares(A, v, most)
    t = float(np.abs(v + A @ w).max())
    objective = np.append(np.zeros(2 * len(w)), 1.0)

    # t^2 - |r_k|^2 >= 0; its slope over Re w and Im w is -2 Re and -2 Im of conj(A_k) r_k
    def room(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[-1] ** 2 - np.abs(v + A @ _complex(x[:-1])) ** 2)

    def slope(x: np.ndarray) -> np.ndarray:
        rows = A.conj() * (v + A @ _complex(x[:-1]))[:, None]
        return np.column_stack(
            [-2 * rows.real, -2 * rows.imag, np.full(len(v), 2 * x[-1])],
        )

    rows = {"type": "ineq", "fun": room, "jac": slope}
    found = _convex(
        lambda x: (float(x[-1]), objective), np.append(_real(w), t), [rows, _discs(most)]
    )
    return _complex(found[:-1])


_NORMS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "squares": _least_squares,
    "sum": _least_sum,
    "largest": _least_largest,
}


def _convex(
    cost: Callable[[np.ndarray], tuple[float, np.ndarray]],
    start: np.ndarray,
    constraints: Sequence[dict[str, object]],
) -> np.ndarray:
    """The minimum of a convex problem by sequential quadratic programming (SLSQP, Kraft 1988)."""
    from scipy.optimize import minimize

    options = {"ftol": 1e-14, "maxiter": 1000}
    found = minimize(
        cost, start, jac=True, method="SLSQP", constraints=list(constraints), options=options
    )
    return np.asarray(found.x)


def _discs(most: np.ndarray) -> dict[str, object]:
    """The constraints 1 - |w_j|^2 / most_j^2 >= 0 of the planes that have a limit; x begins with
    Re w, Im w.
    """
    p, limited = len(most), np.flatnonzero(np.isfinite(most))
    scale = most[limited] ** -2.0

    def room(x: np.ndarray) -> np.ndarray:
        return np.asarray(1 - scale * (x[limited] ** 2 + x[p + limited] ** 2))

    def slope(x: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(limited), len(x)))
        k = np.arange(len(limited))
        rows[k, limited] = -2 * scale * x[limited]
        rows[k, p + limited] = -2 * scale * x[p + limited]
        return rows

    return {"type": "ineq", "fun": room, "jac": slope}


def _within(w: np.ndarray, most: np.ndarray) -> np.ndarray:
    return np.asarray(w * np.minimum(1.0, most / np.maximum(np.abs(w), 1e-300)))


def _real(w: np.ndarray) -> np.ndarray:
    return np.concatenate([w.real, w.imag])


def _complex(x: np.ndarray) -> np.ndarray:
    half = len(x) // 2
    return np.asarray(x[:half] + 1j * x[half:])


APART = 1.3  # least ratio of speeds that tells run-out from unbalance
_NO_CURRENT = (
    "the amplitudes are taken as those of converged blocks of mode current-free: no 1x current"
)


_UNCHECKED = "that one was on is not checked (--controller names the one that ran)"
_IN_RPM = 30 / np.pi  # rpm per rad/s


def balance_amplitudes(
    machine: Machine,
    amplitudes: AmplitudeTable,
    planes: Mapping[str, float],
    *,
    before: AmplitudeTable | None = None,
    pressure: float | None = None,
    controller: LawLike | None = None,
) -> Balancing:
    """Correction masses from amplitudes of converged current-free blocks.

    planes: bearings, couplings, seals or discs, each with the radius [m] where masses go. before:
    an earlier table; what is balanced is then what has come since, and ``grown`` of the result
    tells whether it is more than its own uncertainty. pressure [Pa]: of the seals (None: the design
    point's). controller: whose blocks they are (None: the machine file's). The covariance holds the
    scatter of the readings, the misfit between axes and speeds, and the tolerances of the machine
    file. Raises InvalidInput, also for a speed at which no current-free block is on.
    """
    machine.across_the_shaft(UNBALANCE)
    radii = {
        name: check_positive(r, f"the radius of plane {name}", "give it in m")
        for name, r in planes.items()
    }
    if not radii:
        raise InvalidInput(
            "no correction plane is given; name a bearing, disc, seal or coupling of the machine, "
            "and a radius"
        )
    known = _check_speeds(machine, amplitudes, controller)
    names, table = tuple(radii), amplitudes if before is None else amplitudes.since(before)
    design = machine.operation.design
    at = replace(
        design, label="", seal_pressure=design.seal_pressure if pressure is None else pressure
    )
    plants = [assemble(machine, replace(at, speed=float(speed))) for speed in table.speeds]

    # run-out: in no difference; an unknown where speeds are apart; else as the machine file has it
    axes, speeds = len(machine.axes), table.speeds
    free = before is None and float(speeds.max()) > APART * float(speeds.min())
    R = np.zeros(axes, complex)
    if before is None and not free:
        R = runout_phasors(machine.sensor_pairs, machine.axes)

    first = _fit(plants, names, table, R, free)
    spread = np.zeros((len(names), len(names)), complex)
    for path in dict.fromkeys(t.parameter for plant in plants for t in tolerances_around(plant)):
        # dU with a parameter at the end of its tolerance, COVERAGE standard deviations
        moved = _fit([_moved(plant, path) for plant in plants], names, table, R, free)
        change = (moved.unbalance - first.unbalance) / COVERAGE
        spread += np.outer(change, change.conj())
    covariance = first.covariance + spread

    # each axis and speed: what unbalance makes now, and what is left of it, with its 95 % circle
    rows = []
    for k, speed in enumerate(speeds):
        A = first.influence[k]
        turning = table.values[k] - (0 if before is not None else 1) * first.runout
        C = A @ covariance @ A.conj().T + np.diag(first.variance[k])
        radius = first.factor * np.sqrt(np.real(np.diag(C)))
        left = turning - A @ first.unbalance
        for axis, b, c, r in zip(machine.axes, turning, left, radius, strict=True):
            rows.append(Row(axis, float(speed), complex(b), complex(c), float(r)))

    notes = [_NO_CURRENT if known else f"{_NO_CURRENT}; {_UNCHECKED}"]
    if first.condition > ILL:
        notes.append(
            f"the unknowns are poorly distinguished (condition {first.condition:.3g}): read "
            "another speed, or use fewer planes"
        )
    if before is None and not free:
        what = "from the machine file" if R.any() else "zero, and balanced as if it were unbalance"
        notes.append(
            f"the amplitudes are of one speed: run-out was taken as {what}; a reading at another "
            "speed tells it"
        )
    result = Balancing(
        machine.name,
        names,
        tuple(radii.values()),
        -first.unbalance,
        covariance,
        first.factor,
        first.condition,
        first.model_error,
        "model",
        "y, current-free",
        tuple(rows),
        first.runout,
        free or before is not None,
        None,
        residual_unbalance(machine),
        tuple(notes),
    )
    if before is None:
        return result
    # a change has no balance quality: what was there before is not known
    return replace(result, allowed=None, notes=(*notes, *_growth(result)))


def _check_speeds(machine: Machine, table: AmplitudeTable, controller: LawLike | None) -> bool:
    """Whether it is known where the blocks are on; every speed of the table is there then.

    Raises InvalidInput for a speed that no current-free block is on at, or that is above the
    machine's own.
    """
    settings = machine.controller
    if controller is not None:
        blocks, whose = law_of(controller).synchronous, "the controller"
    else:
        blocks, whose = () if settings is None else settings.synchronous, "the machine file"
    for speed in map(float, table.speeds):
        if beyond := beyond_top_speed(machine, speed):
            raise InvalidInput(
                f"the amplitudes have a speed above the machine's range: {beyond}; correct "
                "speed_rpm"
            )
    if controller is None and not blocks:
        return False
    free = [b for b in blocks if b.mode == "current-free" and b.harmonic == 1]
    if not free:
        raise InvalidInput(
            f"{whose} has no current-free block, and other amplitudes are not the rotor's own; "
            "balance from records, or give the controller that ran"
        )
    for speed in map(float, table.speeds):
        if not any(block.band[0] <= speed <= block.band[1] for block in free):
            bands = ", ".join("{:.5g} to {:.5g}".format(*np.array(b.band) * _IN_RPM) for b in free)
            raise InvalidInput(
                f"a line of the amplitudes is at {speed * _IN_RPM:.5g} rpm, where no current-free "
                f"block of {whose} is on ({bands} rpm); leave it out, or give the controller that "
                "ran"
            )
    return True


def grown(result: Balancing) -> bool:
    """Whether the unbalance that a balancing found is more than its own 95 %, in any plane."""
    return bool((np.abs(result.correction) > result.uncertainty).any())


def per_unbalance(plant: Plant, planes: Sequence[str], speed: float) -> np.ndarray:
    """A (a, p) complex [m per kg m]: y per unbalance of each plane, no control current."""
    direction = {port.name: port.direction for port in ports(plant.machine)}
    columns = []
    for name in planes:
        pair = [port for port in plant.ports if port.rpartition("_")[0] == name]
        if len(pair) != 2:
            known = dict.fromkeys(port.rpartition("_")[0] for port in plant.ports)
            raise invalid(
                "a balancing plane",
                repr(name),
                "a bearing, disc, seal or coupling",
                suggestion(name, known),
            )
        # a forward force of phase zero at x is (1, -j) along x and y, and exp(-j b) times that
        # along ports turned by b
        pattern = np.exp(-1j * direction[pair[0]]) * np.array([1.0, -1j])
        system = select(plant.system, [f"f_{port}" for port in pair], plant.named("y"))
        G = frequency_response(system, np.array([speed])).values[0]
        columns.append(speed**2 * (G @ pattern))
    return np.array(columns).T


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """U (p,) with its covariance, run-out (a,), and with what they were found; influence and
    variance by speed.
    """

    unbalance: np.ndarray
    covariance: np.ndarray
    runout: np.ndarray
    influence: np.ndarray
    variance: np.ndarray
    condition: float
    model_error: float
    factor: float


def _fit(
    plants: Sequence[Plant],
    names: tuple[str, ...],
    table: AmplitudeTable,
    R: np.ndarray,
    free: bool,
) -> _Fit:
    """(1) by weighted least squares; R (a,): the run-out where it is no unknown."""
    p, a = len(names), table.values.shape[1]
    A = np.array(
        [per_unbalance(one, names, float(w)) for one, w in zip(plants, table.speeds, strict=True)]
    )
    eye = np.broadcast_to(np.eye(a), (len(plants), a, a))
    X = np.concatenate([A, eye], axis=2) if free else A
    target = table.values if free else table.values - R
    freedom = target.size - X.shape[2]
    if freedom < 0:
        raise invalid(
            "the number of unknowns",
            X.shape[2],
            f"at most {target.size}, that of amplitudes",
            "read another speed, or use fewer planes",
        )

    # the model's relative error is of |A U|; U is not known at first, so that |a| begins
    size = np.sqrt(np.mean(np.abs(target) ** 2, axis=1))
    for _ in range(2):
        error, x, C, condition = weighted_fit(X, target, table.noise, size, freedom, LEAST)
        size = np.sqrt(np.mean(np.abs(A @ x[:p]) ** 2, axis=1))
    return _Fit(
        x[:p],
        C[:p, :p],
        x[p:] if free else R,
        A,
        table.noise + (error * size[:, None]) ** 2,
        condition,
        error,
        circle_of_95(freedom),
    )


def _moved(plant: Plant, path: str) -> Plant:
    """The plant with one parameter at the upper end of its tolerance, where it has one."""
    held = [item for item in tolerances_around(plant) if item.parameter == path]
    return perturbed(plant, {path: 1.0}, held) if held else plant


def _growth(result: Balancing) -> tuple[str, ...]:
    """What has come since the earlier table, plane by plane."""
    lines = []
    for plane, u, limit in zip(result.planes, result.correction, result.uncertainty, strict=True):
        at = round(float(np.degrees(np.angle(-u)))) % 360
        verdict = "more than" if abs(u) > limit else "within"
        lines.append(
            f"unbalance of {plane} since the earlier table: {1e6 * abs(u):.3g} g mm at {at}°, "
            f"{verdict} its 95 % of {1e6 * limit:.2g} g mm"
        )
    return tuple(lines)
