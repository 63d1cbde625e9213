"""What a seal monitor saw: the parameters against time, and what follows from them: trend, range,
pressure, excitation.
"""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented
from ambrose.core.response import held_derivative
from ambrose.core.statespace import StateSpace, index_of
from ambrose.identification.output_error.loop_model import directions_of
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.identification.parameters import nominal_values, reduced_plant, unit_of
from ambrose.law.law import LawLike
from ambrose.machine.description import AMPLIFIER_PARAMETERS, OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import find_uncertain
from ambrose.model.effects.rotor import mass_properties
from ambrose.model.uncertainty import uncertain

# The linear filters of the seal monitor: an observer of the machine without the watched seal, and
# what the seal adds to it.
#
# Sampled, the machine with the parameters theta (what the seal is; zero: no seal) is
#
#     x+ = (A + sum theta_g D_g + sum theta_g theta_h D_gh) x
#          + (B + sum theta_g N_g + sum theta_g theta_h N_gh) v,
#     y = C x,
#
# the squares being what sampling bends. The observer x^+ = A x^ + B v + L e, e = y - C x^, of the
# machine without it errs by x - x^ = sum theta_g phi_g + sum theta_g theta_h phi_gh + ..., each
# part of the error in A - L C,
#
#     phi_g driven by D_g x^ + N_g v,    phi_gh by D_g phi_h + D_gh x^ + N_gh v,
#     e = sum theta_g C phi_g + ... + noise,
#
# and no filter knows theta. On the seal rig the squares are 3 % at nominal pressure, and the third
# power, left out, changes theta by 6e-4 there. Adaptive observers: Zhang, IEEE Trans. Automatic
# Control 47 (2002) 525; as a prediction error: Ljung & Soderstrom (1983), sec. 3.8.


_NOISE = 1e-7  # [m] of a sensor of which the machine file says nothing, per sample
_FORCE = 0.005  # disturbing force at seals and bearings, held over a sample, of the rotor's weight
# half widths of what the observer takes as known
DOUBTS = {"force_per_current": 0.03, "amplifier": 0.05}


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """What one parameter changes in the sampled machine, per unit of it: D (n, n) and N (n, m)."""

    D: np.ndarray
    N: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class SealModel:
    """Matrices of the monitor at one operating point, sampled every dt [s].

    A (n, n), B (n, m), C (p, n): the machine without the watched seal; L (n, p): the observer's
    gain; W (p, p): makes the prediction error white and of unit size for the noise assumed.
    unknown: per parameter, each in units of ``reference`` (q,), SI; squares: per two of them, half
    the second derivative. doubts: per parameter taken as known, in units of its half width; kinds:
    those of one kind err together. law: the controller as it runs, sampled, from errors to
    currents; loop: A and B of the simulated loop, from e to the states of machine and law.
    """

    paths: tuple[str, ...]
    reference: np.ndarray
    dt: float
    axes: tuple[str, ...]
    point: OperatingPoint
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    L: np.ndarray
    W: np.ndarray
    loop: tuple[np.ndarray, np.ndarray]
    unknown: tuple[Direction, ...]
    squares: tuple[Direction, ...]
    doubts: tuple[Direction, ...]
    kinds: tuple[str, ...]
    law: StateSpace

    @property
    def observer(self) -> np.ndarray:
        """A - L C (n, n), which all filters share."""
        return self.A - self.L @ self.C


def seal_model(
    machine: Machine,
    controller: LawLike,
    point: OperatingPoint,
    paths: Sequence[str],
    dt: float,
    *,
    bending_modes: int = 3,
    computing_delay: int = 1,
    doubts: Mapping[str, float] | None = None,
) -> SealModel:
    """The monitor's matrices for a machine at an operating point.

    paths: seal.<name>.pressure, k, C ... of one seal, or several. doubts: quantity -> relative half
    width (None: ``DOUBTS``). Raises InvalidInput for a path that is no seal's, whose value is zero
    at every operating point, or that the point forbids.
    """
    for path in paths:
        if find_uncertain(machine, path).table != "seal":
            raise InvalidInput(
                f'parameter "{path}" is no seal\'s; the monitor watches paths such as '
                "seal.<name>.pressure"
            )
    plant = reduced_plant(machine, point, bending_modes)
    reference = _reference(machine, paths)
    doubted = _doubted(machine, DOUBTS if doubts is None else doubts)

    # parameters of the model: the q that are watched, by one reference each, then the doubted
    every = [Tolerance(path, absolute=value) for path, value in zip(paths, reference, strict=True)]
    every += [Tolerance(path, relative=width) for path, width, _ in doubted]
    general = uncertain(plant, every)

    u, y = (
        index_of([f"{kind}_{axis}" for axis in plant.axes], names, kind)
        for kind, names in (("u", general.system.inputs), ("y", general.system.outputs))
    )
    dA, dB = directions_of(general, u)
    q = len(paths)

    # the machine without the watched seal: A - sum here_g dA_g, B likewise
    here = nominal_values(plant, paths) / reference
    A = general.system.A
    B = general.system.B[:, u]
    C = general.system.C[y]
    A, B = A - np.tensordot(here, dA[:q], 1), B - np.tensordot(here, dB[:q], 1)

    # D_g, N_g: derivatives of the sampled matrices where theta = 0
    _, _, D, N = held_derivative(A, B, dA, dB, dt)

    # D_gh, N_gh: half the second derivative, by the difference over one reference of theta_h
    squares = []
    for h in range(q):
        _, _, moved, into = held_derivative(A + dA[h], B + dB[h], dA[:q], dB[:q], dt)
        squares.append([Direction((moved[g] - D[g]) / 2, (into[g] - N[g]) / 2) for g in range(q)])

    # process noise: forces at seals and bearings, held over a sample
    forces = index_of(
        [name for name in general.system.inputs if name in plant.named("f")],
        general.system.inputs,
        "f",
    )
    inputs = np.hstack([B, general.system.B[:, forces]])
    Ad, Bd, _, _ = held_derivative(
        A, inputs, np.zeros((0, *A.shape)), np.zeros((0, *inputs.shape)), dt
    )

    # sensors' noise, of both axes of a pair
    noise = np.array([sensor.noise or _NOISE for sensor in machine.sensor_pairs]).repeat(2)
    Q = _FORCE * 9.81 * mass_properties(plant.rotor_model).mass * Bd[:, len(u) :]
    L, W = _kalman(Ad, C, Q @ Q.T, noise)

    directions = tuple(Direction(*pair) for pair in zip(D, N, strict=True))
    law = deployed_controller(plant, controller, dt, computing_delay)

    # instruments: the loop simulated with the seal at its nominal value
    pairs = list(zip(D[:q], N[:q], strict=True))
    loop = _stable_loop(
        law,
        Ad,
        Bd[:, : len(u)],
        C,
        [(here * d, here * n) for here, (d, n) in zip(here, pairs, strict=True)],
    )
    return SealModel(
        tuple(paths),
        reference,
        dt,
        plant.axes,
        plant.point,
        Ad,
        Bd[:, : len(u)],
        C,
        L,
        W,
        loop,
        directions[:q],
        tuple(squares[h][g] for g in range(q) for h in range(q)),
        directions[q:],
        tuple(kind for _, _, kind in doubted),
        law,
    )


def _reference(machine: Machine, paths: Sequence[str]) -> np.ndarray:
    """The unit (q,) of every parameter: its value at the first operating point of the file where it
    is not zero, SI.
    """
    points = (machine.operation.design, *machine.operation.envelope)
    coefficients = []
    for path in paths:
        values = (nominal_values(reduced_plant(machine, point, 0), [path])[0] for point in points)
        value = next((abs(float(value)) for value in values if value), 0.0)
        if value == 0:
            raise invalid(
                f'parameter "{path}"',
                "zero at every operating point",
                "non-zero at one",
                "give it a value to watch",
            )
        coefficients.append(value)
    return np.array(coefficients)


def _stable_loop(
    law: StateSpace,
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    seal: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """The simulated loop, with as much of the seal's forces at the point as leaves it stable:
    instruments need not be exact.

    Raises InvalidInput where it is unstable without any.
    """
    for share in (1.0, 0.75, 0.5, 0.25, 0.0):
        a, b = A + share * sum(d for d, _ in seal), B + share * sum(n for _, n in seal)
        # u = C_k x_k - D_k y: states (machine, law)
        closed = np.block([[a - b @ law.D @ C, b @ law.C], [-law.B @ C, law.A]])
        if np.abs(np.linalg.eigvals(closed)).max() < 1:
            return closed, np.vstack([b, np.zeros((len(law.A), b.shape[1]))])
    raise InvalidInput(
        "controller and machine without the seal's forces are unstable together, as modelled; "
        "check that the controller is the "
        "one that ran, its delay (--delay-samples) and its sign"
    )


def _doubted(machine: Machine, widths: Mapping[str, float]) -> list[tuple[str, float, str]]:
    """Path, relative half width and kind of what is taken as known."""
    doubted = []
    for quantity, width in widths.items():
        if quantity == "amplifier":
            doubted += [
                (f"amplifier.{name}", width, quantity)
                for name in AMPLIFIER_PARAMETERS[machine.amplifier.order]
                if name.endswith(("bandwidth", "frequency"))
            ]
        else:
            doubted += [
                (f"bearing.{item.name}.{quantity}.{axis}", width, quantity)
                for item in machine.bearings
                for axis in ("zeta", "eta")
            ]
    return [item for item in doubted if item[1] > 0]


def _kalman(
    A: np.ndarray, C: np.ndarray, Q: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The predictor's gain L (n, p) for process noise Q (n, n) and sensors' noise (p,), and W =
    S^-1/2 of its innovation.
    """
    size = np.sqrt(np.maximum(np.diag(Q), 1e-30 * np.diag(Q).max()))  # states of one size
    # x = size x~, y = noise y~: both noises of unit size
    a = A * size / size[:, None]
    c = C * size / noise[:, None]
    r = np.eye(len(noise))

    # P~ of the prediction error, S~ = c P~ c' + I of the innovation
    P = sla.solve_discrete_are(a.T, c.T, Q / size / size[:, None], r)
    S = c @ P @ c.T + r

    # L = size L~ / noise;   W S W' = I by the Cholesky factor of S~
    return size[:, None] * (a @ P @ c.T @ np.linalg.inv(S)) / noise, np.linalg.inv(
        np.linalg.cholesky(S)
    ) / noise


# Instrumental-variable estimate of the seal's parameters over a fading window, with an interval,
# from block to block.
#
# With instruments z, sum z e = (sum z r1 + sum z r2 theta) theta over the window, each sample
# weighted by exp(-age/window). The interval has three parts: noise, by the scatter of the blocks'
# own sums around the estimate (whatever the noise's colour, with Student's t for half the blocks
# that count); what is taken as known, by its exact effect on this estimate; the rate at which the
# seal may change times the estimate's own mean age. A faster change is seen by a second, short
# window that disagrees (seal_watch.py).


BLOCK = 0.0125  # [s] whose sums count as independent
_FEWEST = 5.0  # blocks beyond one per parameter: fewer show no scatter
_Z = 1.959963984540054  # 97.5 % quantile of the normal distribution


@dataclass(frozen=True, slots=True)
class Estimate:
    """theta (q,) in units of the reference, half widths (q,) of its 95 % interval and of the parts
    of that, mean age [s].

    Parts: noise; known, of what the model takes as known; change, of a seal that changes. NaN and
    infinite where nothing excites the loop, or too little was seen.
    """

    theta: np.ndarray
    half_width: np.ndarray
    noise: np.ndarray
    known: np.ndarray
    change: np.ndarray
    age: float
    restarted: bool = False


def block_sums(signals: Mapping[str, np.ndarray], block: int) -> dict[str, np.ndarray]:
    """Sums over b successive blocks, for q parameters and c doubts (what the model takes as known):
    ze (b, q), zr1 (b, q, q), zr2 (b, q, q, q) and zd (b, q, c).
    """

    def cut(x: np.ndarray) -> np.ndarray:
        whole = x.shape[-1] // block * block
        return x[..., :whole].reshape(*x.shape[:-1], whole // block, block)

    # (..., p, b, k): output p, block b, sample k of the block
    z, e, r1, r2, d = (
        cut(signals[name]) for name in ("instruments", "error", "r1", "r2", "doubts")
    )
    q = len(z)

    # over outputs and the samples of a block: sum z e, sum z r1, sum z r2, sum z d
    products = [np.einsum("ipbk,jpbk->bij", z, x, optimize=True) for x in (e[None], r1, r2, d)]
    return {
        "ze": products[0][..., 0],
        "zr1": products[1],
        "zr2": products[2].reshape(-1, q, q, q),
        "zd": products[3],
    }


@dataclass(slots=True)
class Window:
    """Fading sums over an exponential window [s]; ``lag``: sum of weight, age and z r1."""

    q: int
    c: int
    window: float
    step: float
    sums: np.ndarray = field(init=False)
    squares: np.ndarray = field(init=False)
    known: np.ndarray = field(init=False)
    lag: np.ndarray = field(init=False)
    weight: float = 0.0
    weight2: float = 0.0

    def __post_init__(self) -> None:
        q = self.q
        size = q + q * q + q**3
        self.sums, self.squares = np.zeros(size), np.zeros((size, size))
        self.known, self.lag = np.zeros((q, self.c)), np.zeros((q, q))

    def add(self, block: Mapping[str, np.ndarray]) -> None:
        """The sums of one more block."""
        q, f = self.q, float(np.exp(-self.step / self.window))
        # a block's row: (z e; z r1; z r2), q + q^2 + q^3 entries
        row = np.concatenate([block["ze"], block["zr1"].ravel(), block["zr2"].ravel()])

        # sum w age z r1: what was there fades and ages by a step; the new block is half a step old
        before = self.sums[q : q + q * q].reshape(q, q)
        self.lag = f * (self.lag + self.step * before) + 0.5 * self.step * block["zr1"]

        # sum w row, and sum w^2 row row' for the variance of the former
        self.sums, self.squares = f * self.sums + row, f * f * self.squares + np.outer(row, row)
        self.known = f * self.known + block["zd"]
        self.weight, self.weight2 = f * self.weight + 1, f * f * self.weight2 + 1

    def estimate(self, kinds: np.ndarray, rate: float) -> Estimate:
        """theta and its interval from the sums so far.

        kinds (c,): numbers of the groups whose members err together; rate [reference/s].
        """
        q = self.q
        s, R1, R2 = np.split(self.sums, [q, q + q * q])
        R1, R2 = R1.reshape(q, q), R2.reshape(q, q, q)

        unknown = np.full(q, np.inf)
        # blocks of equal weight with the same scatter of their mean: (sum w)^2 / sum w^2
        counted = self.weight**2 / self.weight2 if self.weight2 else 0.0
        if counted < _FEWEST + q or np.linalg.cond(R1) > 1e8:  # not excited
            return Estimate(np.full(q, np.nan), unknown, unknown, unknown, unknown, np.inf)

        # s = R1 theta + (R2 theta) theta: the linear part first, then by iteration on R2 theta
        theta = np.linalg.solve(R1, s)
        for _ in range(6):
            theta = np.linalg.solve(R1 + R2 @ theta, s)

        # derivative of R1 theta + R2 theta theta: both factors of the squares count
        slope = R1 + R2 @ theta + np.einsum("igh,g->ih", R2, theta)

        # T row = z e - z r1 theta - z r2 theta theta: what the estimate leaves of a block
        T = np.hstack(
            [
                np.eye(q),
                -np.kron(np.eye(q), theta),
                -np.kron(np.eye(q), np.outer(theta, theta).ravel()),
            ]
        )

        # their scatter, q degrees of freedom being spent on theta; theta errs by slope^-1 of it
        scatter = T @ self.squares @ T.T * counted / (counted - q)
        slope_inverse = np.linalg.inv(slope)
        spread = np.sqrt(np.diag(slope_inverse @ scatter @ slope_inverse.T))

        # neighbours are not quite independent: half of them count
        noise = students_t((counted - q) / 2) * spread

        # a doubt moves theta by slope^-1 sum z d; those of a kind add up, the kinds in quadrature
        effect = np.abs(slope_inverse @ self.known)
        groups = [effect[:, kinds == kind].sum(axis=1) for kind in np.unique(kinds)]
        known = np.sqrt(np.sum(np.square(groups), axis=0)) if groups else np.zeros(q)

        # theta(t - age) = theta(t) -+ rate age, at worst, enters by slope^-1 sum w age z r1
        ages = slope_inverse @ self.lag
        change = rate * np.abs(ages).sum(axis=1)
        return Estimate(
            theta,
            np.hypot(noise, known) + change,
            noise,
            known,
            change,
            float(np.abs(np.diag(ages)).max()),
        )


def students_t(freedom: float) -> float:
    """The 97.5 % quantile of Student's t, to 1 % from 3 degrees of freedom on (Abramowitz & Stegun
    26.7.5).
    """
    z, n = _Z, freedom
    return (
        z
        + (z**3 + z) / (4 * n)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3)
    )


_TREND = 6  # windows that a trend needs
_COVERAGE2 = 4.0  # noise is given as half widths: of about two standard deviations


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SealHistory(Presented):
    """A seal's parameters against time; every array over the estimates (b), half widths of 95 %
    intervals.

    time (b,) [s]; values, half_widths, noise, known, change (b, q), SI, NaN where nothing can be
    said; restarts: times [s] of changes faster than ``rate`` [reference/s]; reference (q,), SI;
    limits: per path the range of the tolerances, SI; measured (b,) [Pa]: the pressure that was
    measured beside it; controller: what a page calls the one that ran.
    """

    machine: str
    seal: str
    paths: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    half_widths: np.ndarray
    noise: np.ndarray
    known: np.ndarray
    change: np.ndarray
    restarts: tuple[float, ...]
    reference: np.ndarray
    rate: float
    window: float
    settling: float
    limits: tuple[tuple[float, float] | None, ...]
    measured: np.ndarray | None
    findings: tuple[str, ...]
    notes: tuple[str, ...]
    controller: str = ""

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of every parameter."""
        return tuple(unit_of(path) for path in self.paths)

    def facts(self) -> Mapping[str, Any]:
        """The seal, its last estimate, and what it says."""
        last = (
            [
                f"{value:.4g} +- {half:.2g} {unit}"
                for value, half, unit in zip(
                    self.values[-1], self.half_widths[-1], self.units, strict=True
                )
            ]
            if len(self.time)
            else []
        )
        return {
            "machine": self.machine,
            "seal": self.seal,
            **dict(zip(self.paths, last, strict=False)),
            "findings": self.findings,
        }

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data, SI; null where nothing can be said."""

        def plain(x: np.ndarray) -> list[Any]:
            return [
                [None if not np.isfinite(v) else float(v) for v in row]
                for row in np.atleast_2d(x.T)
            ]

        arrays = {
            name: plain(getattr(self, name))
            for name in ("values", "half_widths", "noise", "known", "change")
        }
        return {
            "machine": self.machine,
            "seal": self.seal,
            "paths": list(self.paths),
            "units": list(self.units),
            "reference": self.reference.tolist(),
            "window_s": self.window,
            "rate_per_s": self.rate,
            "settling_s": self.settling,
            "time_s": self.time.tolist(),
            **arrays,
            "restarts_s": list(self.restarts),
            "limits": [None if limit is None else list(limit) for limit in self.limits],
            "measured_pressure_pa": None if self.measured is None else self.measured.tolist(),
            "findings": list(self.findings),
            "notes": list(self.notes),
        }

    def to_csv(self) -> str:
        """One line per estimate: time, then value and half width of every parameter, SI; empty
        where nothing can be said.
        """
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        names = [f"{path} [{unit}]" for path, unit in zip(self.paths, self.units, strict=True)]
        table.writerow(
            [
                "time [s]",
                *(
                    name
                    for pair in zip(names, [f"+- {n}" for n in names], strict=True)
                    for name in pair
                ),
            ]
        )
        for t, row, half in zip(self.time, self.values, self.half_widths, strict=True):
            pairs = [x for pair in zip(row, half, strict=True) for x in pair]
            table.writerow([f"{t:.6g}", *("" if not np.isfinite(x) else f"{x:.6g}" for x in pairs)])
        return text.getvalue()

    @property
    def known_at(self) -> np.ndarray:
        """Whether something can be said at each time (b,)."""
        return np.isfinite(self.values).all(axis=1)

    def trend(self, i: int = 0) -> tuple[float, float] | None:
        """Slope of the i-th parameter since the last restart and half width (95 %), SI per second;
        None: too short.

        From estimates one window apart, each weighted by its noise, the width by their scatter
        where that is larger; what the model takes as known shifts all of them alike.
        """
        # estimates a window apart, counted back from the last one
        apart = (
            max(1, round(self.window / (self.time[1] - self.time[0]))) if len(self.time) > 1 else 1
        )
        since = self.restarts[-1] + self.window if self.restarts else -np.inf
        at = np.flatnonzero(self.known_at & (self.time > since))[::-1][::apart][::-1]
        if len(at) < _TREND:
            return None

        # x = mean + slope (t - mean t) by least squares, weights 1/noise^2
        t = self.time[at]
        x = self.values[at, i]
        w = 1 / self.noise[at, i] ** 2
        centred = t - np.sum(w * t) / np.sum(w)
        slope = np.sum(w * centred * x) / np.sum(w * centred**2)

        # noise is about two standard deviations: chi^2 of the residuals over n - 2, one at least
        left = x - np.sum(w * x) / np.sum(w) - slope * centred
        misfit = np.sqrt(max(1.0, _COVERAGE2 * np.sum(w * left**2) / (len(at) - 2)))
        return float(slope), float(misfit / np.sqrt(np.sum(w * centred**2)))


def findings_of(history: SealHistory, pressure: float) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What needs attention, and what is good to know; pressure [Pa]: the record's operating
    point's.
    """
    known, time = history.known_at, history.time
    notes = [f"the filters settled for {history.settling:.2g} s before the first estimate"]
    if not known.any():
        return (
            "nothing can be said: the excitation e_<axis> in the record moves the rotor too "
            "little; "
            "add a binary sequence of about 0.02 A to every axis, or record longer",
        ), tuple(notes)
    findings = []
    if not known[-1]:
        findings.append(
            f"nothing can be said after {time[known][-1]:.2f} s: the excitation ended, or is too "
            "small for the noise"
        )
    for t in history.restarts:
        findings.append(
            f"at {t:.2f} s the seal changed faster than {history.rate:g} of its reference per "
            "second; the estimate began anew"
        )
    for i, (path, unit, limit) in enumerate(
        zip(history.paths, history.units, history.limits, strict=True)
    ):
        low, high = (
            history.values[:, i] - history.half_widths[:, i],
            history.values[:, i] + history.half_widths[:, i],
        )
        if limit is not None:
            for outside, side in (
                (known & (low > limit[1]), "above"),
                (known & (high < limit[0]), "below"),
            ):
                if outside.any():
                    findings.append(
                        f"{path} is {side} its range of {limit[0]:.4g} to {limit[1]:.4g} {unit} "
                        f"from {time[outside][0]:.2f} s "
                        "on; proofs over the tolerances do not apply from then on"
                    )
        trend = history.trend(i)
        if trend is not None and abs(trend[0]) > trend[1]:
            findings.append(f"{path} changes by {trend[0]:.3g} +- {trend[1]:.2g} {unit} per second")
        if path.endswith(".pressure"):
            measured = (
                np.full(len(time), pressure) if history.measured is None else history.measured
            )
            off = known & ((measured < low) | (measured > high))
            if off.sum() > 0.2 * known.sum():
                worst = int(
                    np.flatnonzero(off)[np.argmax(np.abs(measured - history.values[:, i])[off])]
                )
                findings.append(
                    f"the pressure given, {measured[worst]:.4g} Pa, is outside the estimate of "
                    f"{history.values[worst, i]:.4g} "
                    f"+- {history.half_widths[worst, i]:.2g} Pa at {time[worst]:.2f} s: the seal "
                    "is not as the file has it, or "
                    "the sensor is wrong"
                )
    return tuple(findings), tuple(notes)
