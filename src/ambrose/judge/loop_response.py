"""The loop at many frequencies: plant and controller are evaluated once, everything else is
small-matrix algebra. The axis along a shaft has the exact half-order lag of its solid cores here.

Signs and letters are those of the loop diagram in core/lft.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import singledispatch, wraps
from typing import TypeVar, cast

import numpy as np

from ambrose.core.aliasing import least_sensitivity
from ambrose.core.checks import check_shape, named_failure
from ambrose.core.frequency import SchurForm, check_nyquist, evaluate, largest_gain, schur_form
from ambrose.core.sampling import hold
from ambrose.core.statespace import StateSpace, index_of, select
from ambrose.judge.checks import Check, Curve, judge, required_line, zone_lines
from ambrose.law.law import LawLike
from ambrose.law.loop import Timing, machine_timing, match_controller
from ambrose.machine.criteria import SENSITIVITY, TWO_PI, demand
from ambrose.machine.description import Requirements
from ambrose.model.axial import left_out
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce_from

_TWINS = 1e-9  # relative distance of frequencies that are one
_LIGHTLY_DAMPED = 0.3  # damping ratio below which a pole has points of its own on a grid

Matrices = np.ndarray  # (w, p, m) complex: one matrix per frequency


Response = TypeVar("Response", bound="LoopResponse")


def _once(matrices: Callable[[Response], Matrices]) -> Callable[[Response], Matrices]:
    """Decorator of a method: what it gives is kept, as checks of one response share it."""

    @wraps(matrices)
    def kept(self: Response) -> Matrices:
        if matrices.__name__ not in self.kept:
            self.kept[matrices.__name__] = matrices(self)
        return self.kept[matrices.__name__]

    return kept


@dataclass(frozen=True, slots=True, eq=False)
class LoopResponse:
    """Open-loop matrices (w, a, a) at omega (w,) [rad/s]; a control axes; forces f and
    displacements q at the bearings.

    G: u -> y [m/A], K: err -> u [A/m], G_yf: f -> y [m/N], G_qu: u -> q, G_qf: f -> q, G_iu: u ->
    i, G_if: f -> i.
    """

    omega: np.ndarray
    axes: tuple[str, ...]
    G: Matrices
    K: Matrices
    G_yf: Matrices
    G_qu: Matrices
    G_qf: Matrices
    G_iu: Matrices
    G_if: Matrices
    kept: dict[str, Matrices] = field(default_factory=dict, init=False, repr=False)

    def __getitem__(self, at: np.ndarray) -> LoopResponse:
        """The same at some of the frequencies."""
        matrices = (self.G, self.K, self.G_yf, self.G_qu, self.G_qf, self.G_iu, self.G_if)
        return LoopResponse(self.omega[at], self.axes, *(each[at] for each in matrices))

    @_once
    @named_failure("the output sensitivity")
    def output_sensitivity(self) -> Matrices:
        """S_o = (I + G K)^-1, d -> y."""
        return np.linalg.inv(np.eye(len(self.axes)) + self.G @ self.K)

    @_once
    @named_failure("the input sensitivity")
    def input_sensitivity(self) -> Matrices:
        """S_i = (I + K G)^-1, e -> v."""
        return np.linalg.inv(np.eye(len(self.axes)) + self.K @ self.G)

    @_once
    def complementary(self) -> Matrices:
        """T_o = G K S_o = I - S_o."""
        return self.G @ self.K @ self.output_sensitivity()

    @_once
    def control_sensitivity(self) -> Matrices:
        """K S_o, r -> u [A/m]."""
        return self.K @ self.output_sensitivity()

    @_once
    def compliance(self) -> Matrices:
        """f -> q at the bearings, loop closed [m/N]."""
        return self.G_qf - self.G_qu @ self.control_sensitivity() @ self.G_yf

    @_once
    def current_per_force(self) -> Matrices:
        """f at the bearings -> coil current i, loop closed [A/N]."""
        return self.G_if - self.G_iu @ self.control_sensitivity() @ self.G_yf


Evaluator = Callable[[np.ndarray], LoopResponse]
Rows = Callable[[LoopResponse], np.ndarray]  # (k, w) real, non-negative, or (w, p, m)


def loop_evaluator(plant: Plant, controller: LawLike, exact: bool = True) -> Evaluator:
    """A function omega (w,) [rad/s] -> LoopResponse; the Schur forms of plant and controller are
    kept for all its calls.

    exact: with the half-order lags of solid cores themselves, not the plant's rational models.

    A sampled controller acts through the base band of its zero-order hold, K(exp(j w T)) (1 -
    exp(-j w T)) / (j w T): exact but for aliasing (Franklin, Powell & Workman 1998, sec. 5.2).
    Raises InvalidInput above its Nyquist frequency, at a pole of plant or controller, and when the
    controller's size does not match.
    """
    part, controller = _parts(plant, controller)
    plant_form, controller_form = _form(part), _form(controller)

    def at(omega: np.ndarray) -> LoopResponse:
        omega = check_shape(omega, "omega", "(w)").astype(float)
        K = _held(lambda s: evaluate(controller_form, s), omega, controller.dt)
        P = evaluate(plant_form, 1j * omega)
        return _parted(plant.axes, omega, _with_cores(plant, omega, P) if exact else P, K)

    return at


def _held(K: Callable[[np.ndarray], Matrices], omega: np.ndarray, dt: float | None) -> Matrices:
    """K(j w) of a continuous controller, K(exp(j w dt)) times its hold of a sampled one."""
    if dt is None:
        return K(1j * omega)
    check_nyquist(omega, dt)
    return K(np.exp(1j * omega * dt)) * hold(omega, dt)[:, None, None]


@named_failure("the response of the loop")
def loop_at(plant: Plant, controller: LawLike, omega: float) -> LoopResponse:
    """The loop at one frequency [rad/s], by one direct solution: cheaper than an evaluator that is
    used once.
    """
    part, controller = _parts(plant, controller)
    at = np.array([omega])
    K = _held(lambda s: _direct(controller, s[0])[None], at, controller.dt)
    P = _with_cores(plant, at, _direct(part, 1j * omega)[None])
    return _parted(plant.axes, at, P, K)


@singledispatch
def solid_cores(plant: object) -> bool:
    """Whether it is the axis along a shaft, with eddy currents in a core; no system alone is."""
    return False


@solid_cores.register
def _(plant: Plant) -> bool:
    return any(name.startswith("core_") for name in plant.rotor.outputs)


def half_order_share(
    plant: Plant | StateSpace,
    controller: LawLike,
    rows: Rows = LoopResponse.output_sensitivity,
) -> tuple[float, str]:
    """By how much the peak of S_o (or of other ``rows``) is higher with the half-order lags of
    solid cores than with the plant's rational models, on a grid: a factor, at least 1, and in
    words.

    With dL of the lags: S = 1/(1 + L + dL) = S_r/(1 + S_r dL) of the rational loop's S_r, which is
    evaluated as it stands and not bounded by |S_r|/(1 - |S_r dL|).
    """
    if not solid_cores(plant):
        return 1.0, ""
    plant = cast(Plant, plant)
    dt = match_controller(controller, plant).dt
    omega = np.geomspace(1.0, 2e5 if dt is None else 0.999 * np.pi / dt, 2000)

    def peak(exact: bool) -> float:
        at = loop_evaluator(plant, controller, exact)
        k = int(np.argmax(largest_gain(rows(at(omega)))))
        near = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], 101)
        return float(largest_gain(rows(at(near))).max())

    share = max(1.0, peak(True) / peak(False))
    return share, f"; {share - 1:.2%} of it for the cores' half order, at this point on a grid"


def _parts(plant: Plant, controller: LawLike) -> tuple[StateSpace, StateSpace]:
    """u, f at the bearings -> y, q at the bearings, i; and the controller with the loop's names."""
    part = select(
        plant.system,
        [*plant.named("u"), *plant.bearing_named("f")],
        [*plant.named("y"), *plant.bearing_named("q"), *plant.named("i")],
    )
    return part, match_controller(controller, plant)


def _with_cores(plant: Plant, omega: np.ndarray, P: Matrices) -> Matrices:
    """P with what the rational cores of an axis along the shaft leave out: one more force,
    f + g_i i + g_q q.
    """
    if not solid_cores(plant):
        return P
    # P: u, f -> y, q, i of the one axis
    machine = plant.machine
    per_current, per_place = left_out(machine, plant.point, omega, plant.offsets)[:, :, None, None]
    extra = per_current * P[:, 2:] + per_place * P[:, 1:2]
    return np.asarray(P + P[:, :, 1:] @ extra / (1 - extra[:, :, 1:]))


def _parted(axes: tuple[str, ...], omega: np.ndarray, P: Matrices, K: Matrices) -> LoopResponse:
    n = len(axes)
    u, f = slice(0, n), slice(n, None)
    y = slice(0, n)
    q = slice(n, 2 * n)
    i = slice(2 * n, None)
    return LoopResponse(
        omega, axes, P[:, y, u], K, P[:, y, f], P[:, q, u], P[:, q, f], P[:, i, u], P[:, i, f]
    )


def _direct(system: StateSpace, s: complex) -> np.ndarray:
    n = system.n_states
    return system.C @ np.linalg.solve(s * np.eye(n) - system.A, system.B.astype(complex)) + system.D


def _form(system: StateSpace) -> SchurForm:
    return schur_form(system.A, system.B, system.C, system.D, expand=True)


def frequency_grid(
    poles: np.ndarray,
    lowest: float,
    highest: float,
    per_decade: int = 150,
) -> np.ndarray:
    """A logarithmic grid over ``[lowest, highest]`` [rad/s] with points packed around lightly
    damped poles (n,).

    The packing reaches from a quarter to ten half-bandwidths on either side of each pole's
    resonance, so that a peak lies within a few per cent of a grid point whatever its damping.
    """
    count = max(2, int(np.ceil(np.log10(highest / lowest) * per_decade)))
    return add_poles(np.geomspace(lowest, highest, count), poles)


def add_poles(omega: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """omega (w,) with points packed around the lightly damped poles inside its range, sorted,
    without repeats.
    """
    modulus = np.abs(poles)
    with np.errstate(invalid="ignore", divide="ignore"):
        chosen = poles[(poles.imag > 0) & (np.abs(poles.real) < _LIGHTLY_DAMPED * modulus)]
    half_bandwidth = np.maximum(np.abs(chosen.real), 1e-9 * np.abs(chosen))
    resonance = np.sqrt(np.maximum(chosen.imag**2 - chosen.real**2, (0.1 * chosen.imag) ** 2))
    steps = np.array([0.25, 0.5, 0.75, 1.0, 1.5, 2.5, 5.0, 10.0])
    steps = np.concatenate([-steps[::-1], [0.0], steps])
    extra = (resonance[:, None] + half_bandwidth[:, None] * steps).ravel()
    every = np.unique(np.concatenate([omega, extra[(extra > omega.min()) & (extra < omega.max())]]))
    # points apart by rounding alone, as of two planes alike, count once: between such two there is
    # no peak, and beside them none is looked for
    return np.asarray(every[np.append(~(np.diff(every) <= _TWINS * every[:-1]), True)])


# Peaks of frequency curves, refined between grid points: what is reported must not depend on the
# grid.


_INSIDE = 7  # points inside a bracket per round: each round narrows it fourfold
_ROUNDS = 4  # refinements of the grid around a peak
_CANDIDATES = 4  # local maxima followed per curve
_WORTH = 0.5  # of the largest grid value: a lower local maximum is not followed


@dataclass(frozen=True, slots=True)
class Peak:
    """The largest value of a curve and where it lies [rad/s]; at_edge: on the end of the range, so
    it may rise beyond.
    """

    value: float
    frequency: float
    at_edge: bool


@dataclass(slots=True)
class _Bracket:
    row: int
    omega: np.ndarray  # (3,) left, middle, right
    value: np.ndarray  # (3,)


def peaks_of(
    quantities: Sequence[Rows],
    response: LoopResponse,
    evaluator: Evaluator,
    within: tuple[float, float] | None = None,
    values: Sequence[np.ndarray] | None = None,
) -> list[tuple[Peak, ...]]:
    """The peak of every row of several quantities over the response's grid, refined around the best
    local maxima.

    within: frequency range [rad/s], default the whole grid; its ends are evaluated too. values: the
    quantities over the grid, where they are known. All
    brackets share each round's evaluation of the loop and are narrowed 256 times; the error left is
    the non-parabolic part of the curve within them.
    """
    values = [rows(response) for rows in quantities] if values is None else values
    sizes = [len(v) for v in values]
    stacked = np.vstack(values)
    low, high = within or (response.omega[0], response.omega[-1])
    inside = (response.omega > low) & (response.omega < high)
    ends = evaluator(np.array([low, high]))
    left, right = np.hsplit(np.vstack([rows(ends) for rows in quantities]), 2)
    omega, stacked = (
        np.concatenate([[low], response.omega[inside], [high]]),
        np.hstack([left, stacked[:, inside], right]),
    )
    brackets = [b for row in range(len(stacked)) for b in _brackets(row, omega, stacked[row])]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    first = np.concatenate([[0], np.cumsum(sizes)])
    for _ in range(_ROUNDS if brackets else 0):
        _narrow(brackets, quantities, owner, first, evaluator)
    peaks = [_grid_peak(omega, row) for row in stacked]
    for bracket in brackets:
        frequency, value = _vertex(bracket)
        if value >= peaks[bracket.row].value:
            peaks[bracket.row] = Peak(value, frequency, False)
    return [tuple(peaks[first[k] : first[k + 1]]) for k in range(len(sizes))]


def _brackets(row: int, omega: np.ndarray, values: np.ndarray) -> list[_Bracket]:
    middle = values[1:-1]
    top = (
        np.flatnonzero(
            (middle >= values[:-2]) & (middle >= values[2:]) & (middle >= _WORTH * values.max())
        )
        + 1
    )
    top = top[np.argsort(values[top])[::-1][:_CANDIDATES]]
    return [_Bracket(row, omega[i - 1 : i + 2].copy(), values[i - 1 : i + 2].copy()) for i in top]


def _narrow(
    brackets: list[_Bracket],
    quantities: Sequence[Rows],
    owner: np.ndarray,
    first: np.ndarray,
    evaluator: Evaluator,
) -> None:
    """Replace every bracket by the neighbours of the best of its own and the new points."""
    fraction = np.arange(1, _INSIDE + 1) / (_INSIDE + 1)
    points = np.array([b.omega[0] + (b.omega[2] - b.omega[0]) * fraction for b in brackets])
    # the old middle stays: it replaces its nearest new point
    for bracket, line in zip(brackets, points, strict=True):
        line[np.argmin(np.abs(line - bracket.omega[1]))] = bracket.omega[1]
    response = evaluator(points.ravel())
    # every quantity at the points of its own brackets alone
    groups = owner[[bracket.row for bracket in brackets]]
    lines = np.empty(points.shape)
    for group in np.unique(groups):
        mine = np.flatnonzero(groups == group)
        at = (mine[:, None] * _INSIDE + np.arange(_INSIDE)).ravel()
        new = quantities[group](response[at]).reshape(-1, len(mine), _INSIDE)
        lines[mine] = new[[brackets[k].row - first[group] for k in mine], np.arange(len(mine))]
    for k, (bracket, line) in enumerate(zip(brackets, lines, strict=True)):
        omega = np.concatenate([bracket.omega[:1], points[k], bracket.omega[2:]])
        value = np.concatenate([bracket.value[:1], line, bracket.value[2:]])
        i = int(np.clip(np.argmax(value), 1, _INSIDE))
        bracket.omega, bracket.value = omega[i - 1 : i + 2], value[i - 1 : i + 2]


def _vertex(bracket: _Bracket) -> tuple[float, float]:
    """Vertex of the parabola through the three points; the best point itself where the parabola has
    none inside.
    """
    (a, b, c), (fa, fb, fc) = bracket.omega, bracket.value
    left, right = (b - a) * (fb - fc), (b - c) * (fb - fa)
    if left == right or fb < max(fa, fc):
        best = int(np.argmax(bracket.value))
        return float(bracket.omega[best]), float(bracket.value[best])
    x = b - 0.5 * ((b - a) * left - (b - c) * right) / (left - right)
    if not a <= x <= c:
        return float(b), float(fb)
    curvature = ((fc - fb) / (c - b) - (fb - fa) / (b - a)) / (c - a)
    return float(x), float(fb - curvature * (x - b) ** 2)


def _grid_peak(omega: np.ndarray, values: np.ndarray) -> Peak:
    i = int(np.argmax(values))
    return Peak(float(values[i]), float(omega[i]), i in {0, len(omega) - 1})


# Sensitivities, complementary and control sensitivity, compliance: per axis and as maximum singular
# value.
#
# | check | what | unit |
# |---|---|---|
# | sensitivity.output.<axis> | peak of a diagonal element of S_o (ISO 14839-3, others closed) | - |
# | sensitivity.output.max | peak of its maximum singular value | - |
# | sensitivity.input.<axis> | peak of the diagonal element of S_i | - |
# | sensitivity.input.max | peak of its maximum singular value | - |
# | complementary.<axis>, .max | the same of T_o = I - S_o | - |
# | control.<axis>, .max | the same of K S_o | A/m |
# | control.roll_off | peak of K S_o times sqrt(1 + (w/w_r)^2), for a roll_off w_r | A/m |
# | compliance.<axis>, .max | the same of force to displacement at the bearings | m/N |
#
# Each has a curve of the name before the last dot.


ALL_AXES = "maximum singular value"  # label of the line of a curve that no zone judges


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A matrix of the loop that is judged per axis and by its maximum singular value."""

    name: str
    title: str
    unit: str
    matrix: Callable[[LoopResponse], np.ndarray]
    axis_rule: str = "information"
    max_rule: str = "information"

    def rows(self, response: LoopResponse) -> np.ndarray:
        """Maximum singular value first, then the moduli of the diagonal, (1 + a, w)."""
        values = self.matrix(response)
        largest = largest_gain(values)
        return np.vstack([largest[None, :], np.abs(np.einsum("wii->iw", values))])


_QUANTITIES = (
    _Quantity(
        "sensitivity.output",
        "output sensitivity",
        "-",
        LoopResponse.output_sensitivity,
        "sensitivity of an axis",
        "maximum singular value of a sensitivity",
    ),
    _Quantity(
        "sensitivity.input",
        "input sensitivity",
        "-",
        LoopResponse.input_sensitivity,
        "input sensitivity of an axis",
    ),
    _Quantity("complementary", "complementary sensitivity", "-", LoopResponse.complementary),
    _Quantity(
        "control",
        "control sensitivity K S",
        "A/m",
        LoopResponse.control_sensitivity,
        "information",
        "control gain",
    ),
    _Quantity(
        "compliance", "compliance", "m/N", LoopResponse.compliance, "information", "compliance"
    ),
)


def sensitivity_checks(
    response: LoopResponse,
    evaluator: Evaluator,
    requirements: Requirements,
    within: tuple[float, float],
) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table; peaks are refined inside ``within`` [rad/s].

    Where a curve rises higher on the grid beyond that range, the check's detail says so.
    """
    every = [quantity.rows(response) for quantity in _QUANTITIES]
    rows = [quantity.rows for quantity in _QUANTITIES]
    peaks = peaks_of(rows, response, evaluator, within, every)
    labels = ("max", *response.axes)
    checks, curves = [], []
    for quantity, values, row in zip(_QUANTITIES, every, peaks, strict=True):
        for label, peak, curve in zip(labels, row, values, strict=True):
            rule = quantity.max_rule if label == "max" else quantity.axis_rule
            what = ALL_AXES if label == "max" else label
            detail = _where(peak) + _beyond(response.omega, curve, within[1], peak)
            wanted = demand(rule, requirements)
            checks.append(
                judge(
                    f"{quantity.name}.{label}",
                    f"Peak {quantity.title}, {what}",
                    peak.value,
                    quantity.unit,
                    wanted,
                    detail,
                )
            )
        curves.append(_curve(quantity, response, values, labels, requirements))
    if requirements.roll_off is not None:
        checks.append(_roll_off(response, evaluator, requirements, requirements.roll_off))
    return checks, curves


def sensitivity_curve(response: LoopResponse, requirements: Requirements) -> Curve:
    """The output sensitivity of every axis alone, with its limits."""
    rows = np.abs(np.einsum("wii->iw", response.output_sensitivity()))
    return _curve(_QUANTITIES[0], response, rows, response.axes, requirements)


def _roll_off(
    response: LoopResponse, evaluator: Evaluator, requirements: Requirements, corner: float
) -> Check:
    """Over the whole grid of the response: what lies beyond the range of ISO 14839-3 counts
    here.
    """

    def rows(at: LoopResponse) -> np.ndarray:
        size = largest_gain(at.control_sensitivity())
        return np.asarray(size * np.hypot(1, at.omega / corner))[None, :]

    ((peak,),) = peaks_of([rows], response, evaluator)
    title = (
        f"Control sensitivity with a roll-off from {corner / TWO_PI:.4g} Hz, maximum singular value"
    )
    return judge(
        "control.roll_off",
        title,
        peak.value,
        "A/m",
        demand("control gain", requirements),
        _where(peak),
    )


def _where(peak: Peak) -> str:
    edge = " (the end of the range: it may rise beyond)" if peak.at_edge else ""
    return f"at {peak.frequency / TWO_PI:.4g} Hz{edge}"


def _beyond(omega: np.ndarray, curve: np.ndarray, highest: float, peak: Peak) -> str:
    outside = omega > highest
    if not outside.any() or curve[outside].max() <= peak.value:
        return ""
    i = np.flatnonzero(outside)[np.argmax(curve[outside])]
    return (
        f"; beyond the range of {highest / TWO_PI:.4g} Hz it reaches {curve[i]:.4g} at "
        f"{omega[i] / TWO_PI:.4g} Hz"
    )


def _curve(
    quantity: _Quantity,
    response: LoopResponse,
    values: np.ndarray,
    labels: tuple[str, ...],
    requirements: Requirements,
) -> Curve:
    wanted = demand(quantity.max_rule, requirements).limit
    limits = required_line(wanted)
    if quantity.name.startswith("sensitivity"):
        limits = zone_lines(SENSITIVITY, wanted, "an axis" if "max" in labels else "")
    title = quantity.title[0].upper() + quantity.title[1:]
    labels = tuple(ALL_AXES if label == "max" else label for label in labels)
    return Curve(
        quantity.name,
        title,
        "frequency",
        response.omega,
        values,
        labels,
        "rad/s",
        quantity.unit,
        limits,
    )


# What the unstable poles and the delay of a plant make unavoidable, whatever controller closes its
# loop.


_HERTZ = 2 * math.pi  # rad/s per Hz


def unavoidable_sensitivity(
    plant: Plant, timing: Timing | None = None
) -> tuple[float, float, float]:
    """The least sigma_max(S_o) that any linear controller reaches, the fastest unstable pole
    [rad/s] and the delay [s].

    timing: when the controller acts (None: as the machine file says; where that says nothing,
    without delay). (1, 0, delay) for a plant without unstable poles. The amplifiers' lags, which a
    controller could invert at the price of current, do not count: what is reached in practice lies
    above.
    """
    runs = timing or machine_timing(plant.machine)
    delay = 0.0 if runs is None else runs.lag
    small = plant if plant.bending_modes is not None else reduce_from(plant, 1)
    A = small.system.A
    C = small.system.C[index_of(small.named("y"), small.system.outputs, "output")]
    fastest = float(np.linalg.eigvals(A).real.max(initial=0.0))
    return least_sensitivity(A, C, delay), fastest, delay


def unavoidable_words(least: float, pole: float, delay: float) -> str:
    """What the delay does, as half a sentence."""
    return (
        f"the unstable pole at {pole / _HERTZ:.3g} Hz and the delay of {1e3 * delay:.3g} ms keep S "
        f"above {least:.3g}"
    )


def beyond_reach(least: float, pole: float, delay: float, limit: float) -> str:
    """Why no controller meets a limit of the sensitivity; "" where one may."""
    if least < limit:
        return ""
    remedy = "sample faster, shorten the delay, or lower k_s"
    if not math.isfinite(least):
        invisible = (
            f"the unstable motion at {pole / _HERTZ:.3g} Hz shows in no sensor, or the delay "
            "outlasts it"
        )
        return f"no controller can: {invisible}; {remedy}"
    return (
        f"no controller can: {unavoidable_words(least, pole, delay)}, and the limit is "
        f"{limit:.3g}; {remedy}"
    )
