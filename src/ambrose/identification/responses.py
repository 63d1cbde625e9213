"""From measured frequency responses to parameters: the closed loop's responses as it runs, fitted
by weighted least squares.

With the loop's own response Y from an excitation current to the displacement, and the sampled
controller K with its delay, every response is Y's: of square matrices

    T = Y K, S = I - Y K at the sensors;  T = K Y, S = I - K Y at the commands;
    G = Y (I - K Y)^-1;  of an axis, the other loops closed, L = 1/S_aa - 1, G_a = Y_aa/S_aa.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path as File
from typing import Any

import numpy as np
from scipy.linalg import schur
from scipy.optimize import minimize as optimise, nnls

from ambrose.core.checks import InvalidInput, NumericalFailure, as_several, invalid
from ambrose.core.frequency import frequency_response, solve_shifted, times
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace, balance_matrix, poles
from ambrose.identification.data_quality.signals import point_findings
from ambrose.identification.findings import ERROR, WARNING, Code, Finding, refuse
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.measured_rotor import (
    OWN,
    RINGS,
    Layout,
    MeasuredLoop,
    first_modes,
    places_of,
)
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.loop_model import LoopModel, loop_model
from ambrose.identification.output_error.normal_equations import Linearised, Minimum, minimise
from ambrose.identification.output_error.problem import (
    FURTHER_MODES,
    FitOptions,
    deployed_controller,
    modelled_modes,
    start_values,
)
from ambrose.identification.parameters import nominal_values, reduced_plant, split_timing
from ambrose.identification.result import LoopIdentification, ResponseFit
from ambrose.identification.validation.plausibility import diagnose_values
from ambrose.law.law import LawLike
from ambrose.law.loop import timing_of
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import bending_modes_of_mesh
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.record.response import (
    QUANTITIES,
    SCATTER_DOF,
    SENSOR,
    Path,
    Response,
    agreement,
    distance,
    noise_beside,
    predicted,
    readings,
    scale_error,
    usable,
    whole,
)
from ambrose.record.response_files import holds_responses, read_response

_CYCLE = 2 * np.pi
_RELATIVE, _FLOOR = 0.01, 0.05  # noise where none is stated: of the value, and of its median
_MAINS, _HARMONICS = (50.0, 60.0), (1, 2, 3)  # [Hz], and of them and of the speed
_BESIDE, _OUT = 0.06, 6.0  # relative; of the scatter of noise
_MOST_LEFT = 0.05  # of the lines
_REWEIGHED, _LEAST_NOISE = 8, 1e-9  # rounds to find it, and of the mean square: no less anywhere
# a mistake is named where the model is this far, and a correction brings it so much nearer
_FAR, _NEARER = 0.05, 3.0
_SAME_SCALE = 0.2  # of the logarithm of factors that are the same
_LOST = 0.6  # and this far without one, it is none of it
_OTHER_LAW = 0.1  # of the controller, which is known: then it is another one
_WRONG_SIZE = 0.3  # relative: residuals with which no number can be trusted
_LOUD, _ALIKE = (
    1.5,
    0.3,
)  # residual over noise, correlation of neighbours: the model lacks something
_FEW = 12  # lines from which their scatter tells their noise
_SMALL = 0.1  # of the largest path: what is smaller may be nothing but noise
_DAMPINGS = (0.002, 0.006, 0.02)  # of a resonance that is looked for
_WIDE, _NEAR_MODE = (
    0.06,
    0.1,
)  # damping of what is one, and relative distance of a mode that is near
_BAND, _LINES = 0.25, 10  # logarithm of frequency about it, and lines within
_SHARE, _TELLING = 0.5, 60.0  # of the residuals that it explains; of twice the log likelihood
_ALONE = 1e-4  # damping below which a single line is explained
_MOST_RESONANCES, _PEAKS = 3, 12
_MOST_MODES = 8  # of a measured rotor, unless more are asked for
_NUTATION = 1.5  # times the speed, up to where a rigid rotor's nutation is
_LOOKS = 2  # from the rigid body of the last
_ENOUGH = 1.05  # of the sum of squares over noise's, below which it does not look again
_STEPS = 10  # of a fit with frequencies and damping held
_CLOSE = 1e-5  # relative, of the steps with which that fit ends
_TOLD = 20.0  # of twice the log likelihood, by which one reading is better than another
_REFITS = 10  # iterations of the fit with exchanged axes
_AWAY = 5.0  # of their size, by which the values may go from the start in it
_HOPELESS = 20.0  # times the sum of squares, at the start, from which a reading is not fitted
_KNOWN = 1e6  # degrees of freedom of a variance that is stated
_MAGNET = 0.2, 5.0  # factors of L and G that a K_i of another size might make


def as_responses(records: Any) -> tuple[Response, ...]:
    """The responses among what was given to be identified from, none where it is records. Raises
    InvalidInput for a mixture.
    """
    items = as_several(records)
    found = [
        isinstance(item, Response) or (isinstance(item, str | File) and holds_responses(item))
        for item in items
    ]
    if any(found) and not all(found):
        raise InvalidInput(
            "records in time and frequency responses are given together; identify from each alone "
            "and compare them (--compare)"
        )
    if not any(found):
        return ()
    return tuple(map(read_response, items))


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """The loop that ran, in theta (q,), and its controller K (delay within)."""

    model: LoopModel | MeasuredLoop
    axes: tuple[str, ...]
    _last: dict[bytes, tuple[StateSpace, list[SystemDerivative]]] = field(
        init=False, default_factory=dict
    )

    def at(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]:
        """The sampled loop at theta (q,) and its derivatives; of the theta that was asked for last
        the same again, as when a file is looked at for mistakes.
        """
        if (key := theta.tobytes()) not in self._last:
            found = self.model.loop(theta)
            self._last.clear()
            self._last[key] = found
        return self._last[key]

    def motion(self, theta: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y (w, a, a) and its derivatives (q, w, a, a)."""
        loop, directions = self.at(theta)
        z = np.exp(1j * omega * float(loop.dt or 1.0))

        # A = V T V^-1, T (quasi-)triangular, and so is its transpose from the last row up
        balanced, scales = balance_matrix(loop.A)
        T, Q = schur(balanced)
        V, inverse = scales[:, None] * Q, Q.T / scales
        C = loop.C @ V
        X, shown = (
            np.repeat(right[:, None, :].astype(complex), len(z), axis=1)
            for right in (inverse @ loop.B, C.T[::-1])
        )
        solve_shifted(T, X, z)
        solve_shifted(np.ascontiguousarray(T.T[::-1, ::-1]), shown, z)
        shown = np.ascontiguousarray(shown[::-1].transpose(1, 2, 0))

        # Y = C (zI - A)^-1 B, dY = C (zI - A)^-1 (dA (zI - A)^-1 B + dB) + dC (zI - A)^-1 B
        Y = times(C, X).swapaxes(0, 1)
        dY = np.empty((len(directions), *Y.shape), dtype=complex)
        for k, one in enumerate(directions):
            pushed = times(inverse @ one.A @ V, X) + (inverse @ one.B)[:, None, :]
            dY[k] = shown @ pushed.transpose(1, 0, 2)
            if one.C.any():
                dY[k] += times(one.C @ V, X).swapaxes(0, 1)
        return Y, dY

    def controller(self, omega: np.ndarray) -> np.ndarray:
        """K (w, a, a)."""
        return frequency_response(self.model.controller, omega).values


def identify_responses(
    machine: Machine,
    responses: Sequence[Response],
    controller: LawLike,
    unknown: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    computing_delay: float | None = None,
    bending_modes: int | None = None,
    max_iterations: int = 50,
    progress: Callable[[str], None] = lambda stage: None,
) -> LoopIdentification:
    """The parameters at the paths ``unknown`` from responses at one operating point, between a
    check of what was measured and one of the residuals; ``machine`` is not yet updated.

    bending_modes: per plane (None: as many as the responses tell, from the default on). Weights:
    the variances that are stated, else the residual's own size, path by path; intervals
    are widened by what the residuals exceed the noise, and by the likeness of their neighbours.
    Raises InvalidInput for responses of another machine, of two operating points or beyond half the
    sample rate, for delays among the unknown, and for every mistake that is told.
    """
    point = responses[0].point
    for number, one in enumerate(responses, 1):
        refuse(point_findings(machine, one))
        if one.machine != machine.name:
            remedy = "take that machine's file, or correct the machine that the responses name"
            what = f"the machine of responses {number}"
            raise invalid(what, repr(one.machine), repr(machine.name), remedy)
        if replace(one.point, label="") != replace(point, label=""):
            raise InvalidInput(
                f"responses {number} are of another operating point than the first; identify from "
                "each alone"
            )
    paths, timing_paths = split_timing(machine, unknown)
    if timing_paths:
        raise InvalidInput(
            f"{timing_paths[0]} is not identified from responses; identify it from records in "
            "time, or give it (--delay-samples)"
        )
    timing = timing_of(machine, controller, responses[0].sample_rate_hz)
    if timing is None:
        raise InvalidInput(
            "the controller's sample rate is unknown; state sample_rate_hz with the responses, "
            "or sample_time in [controller] of the machine file"
        )
    delay = timing.delay_samples if computing_delay is None else computing_delay
    if machine.measured_rotor is not None:
        return _without_drawing(
            machine,
            responses,
            controller,
            paths,
            start,
            timing.sample_time,
            delay,
            bending_modes,
            max_iterations,
            progress,
        )
    modes = FitOptions().bending_modes if bending_modes is None else bending_modes
    plant = reduced_plant(machine, point, modes, paths, residual=True)
    values = nominal_values(plant, paths)

    def modelled(plant: Plant) -> Loop:
        law = deployed_controller(plant, controller, timing.sample_time, delay)
        e, y = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "ey")
        return Loop(loop_model(plant, law, paths, values, e, y), tuple(plant.axes))

    loop = modelled(plant)
    begin = start_values(paths, values, start)
    problem = Problem(loop, tuple(usable(one, loop.axes, timing.sample_time) for one in responses))
    progress("checking what was measured")
    refuse(problem.mistakes(begin))
    progress(f"identifying {len(paths)} parameters from {problem.count} paths")
    scale = np.where(begin == 0, 1.0, np.abs(begin))
    statistics.check_visible(paths, problem.linearise(begin).H, scale)

    def fitted(problem: Problem, begin: np.ndarray) -> Minimum:
        return minimise(problem.linearise, begin, scale, lambda theta: True, max_iterations)

    minimum = fitted(problem, begin)
    if problem.unstated:  # again, with the size of every path's own residual
        problem = problem.weighed(minimum.x)
        minimum = fitted(problem, minimum.x)
    problem, hidden = problem.without_hum(minimum.x)
    if hidden:
        minimum = fitted(problem, minimum.x)
    most = bending_modes_of_mesh(machine) if bending_modes is None else modes
    count = min(modes + FURTHER_MODES, most)
    while modes < count:  # more, as long as they explain a part of what is left
        again = reduced_plant(machine, point, count, paths, residual=True)
        further = replace(problem, loop=modelled(again))
        found = fitted(further, minimum.x)
        if found.cost <= minimum.cost - _TOLD * further.excess(found):
            progress(f"identifying again with {count} bending modes, which the responses tell")
            modes, problem = count, further
            minimum = found
            if problem.unstated:
                problem = problem.weighed(minimum.x)
                minimum = fitted(problem, minimum.x)
            count = min(modes + FURTHER_MODES, most)
        else:  # one high mode may stand, at its alias, among the lines: all at once, or no more
            count = most if count < most else modes
    progress("checking the result")
    problem.refuse_unstable(minimum.x)
    result = _estimate(machine, problem, paths, begin, minimum)
    untold, exchange = problem.exchanged(minimum, begin, scale)
    checks = (*exchange, *diagnose_values(machine, result, ()))
    refuse(checks)
    return LoopIdentification(
        given=machine,
        machine=machine,
        result=result,
        checks=checks,
        outputs=(),
        controller=controller,
        computing_delay=delay,
        bending_modes=modes,
        notes=(*problem.notes(minimum.x, untold), *hidden, *modelled_modes(modes)),
        responses=tuple(problem.beside(minimum.x, begin)),
    )


def _without_drawing(
    machine: Machine,
    responses: Sequence[Response],
    controller: LawLike,
    paths: tuple[str, ...],
    start: Mapping[str, float] | None,
    sample_time: float,
    delay: float,
    bending_modes: int | None,
    max_iterations: int,
    progress: Callable[[str], None],
) -> LoopIdentification:
    """Of a measured rotor: its rigid body, and as many bending modes as the responses tell or
    ``bending_modes``, beside the parameters at the paths. Returned: the machine with its rotor.
    """
    point = responses[0].point
    paths = tuple(path for path in paths if not path.startswith("rotor."))  # all are found
    body = machine.measured_rotor
    assert body is not None
    plant = assemble(machine, point)
    law = deployed_controller(plant, controller, sample_time, delay)
    weightless = replace(machine, gravity_direction=None)  # theta has what holds at the load
    nominal = nominal_values(plant, paths)
    values = start_values(paths, nominal, start)
    places = body.places or places_of(machine)
    axes, steps = tuple(plant.axes), max_iterations
    measured = tuple(usable(one, axes, sample_time) for one in responses)
    low = min(float(one.omega[0]) for one in measured)
    high = max(float(one.omega[-1]) for one in measured)
    layout = Layout(weightless, point, paths, places, tuple(values.tolist()), highest=high)
    e, y = (tuple(f"{kind}_{axis}" for axis in axes) for kind in "ey")
    model = MeasuredLoop(layout, law, e, y)
    problem = Problem(Loop(model, axes), measured)
    _plant_between(problem)  # refused before anything is fitted
    theta = layout.begin(values)
    for mode in machine.bending_modes:
        turns = mode.gyroscopic[: layout.whirling]
        one = np.array([mode.frequency, layout.damping_of(mode), *turns, *mode.shape])
        layout, theta = layout.with_mode(theta, one)

    progress(f"identifying {len(paths)} parameters and a rigid rotor from {len(measured)} files")
    most = _MOST_MODES if bending_modes is None else bending_modes
    rigid = _up_to(problem, np.sqrt(low * high))
    below = _up_to(problem, max(np.sqrt(low * high), _NUTATION * point.speed))
    if not layout.modes:  # the rigid body first
        rigid, minimum = _fitted(rigid, layout, theta, steps)
        told = rigid.mistakes(minimum.x)
        refuse([one for one in told if one.code == Code.MIXED_CHANNELS])
        theta, steps = minimum.x, 0
    problem, minimum = _fitted(problem, layout, theta, steps)

    # from a better rigid body the modes are seen better; of what lies beyond the lines the
    # responses tell little, and what makes the loop unstable that ran is none
    variants, vain = range(len(machine.bearings), -1, -1), 0
    for nearest in _LOOKS * list(variants):
        vain += 1
        enough = layout.modes and not problem.unstated and problem.excess(minimum) < _ENOUGH
        if enough or vain > len(variants):
            break
        begin = minimum.x
        try:
            for own in OWN:
                begin = begin[: layout.rigid.stop]
                larger, begin = _with_modes(problem, layout, begin, most, nearest, own)
                begin = _fitted(below, replace(larger, held="all"), begin, max_iterations)[1].x
            begin = _fitted(problem, replace(larger, held="rates"), begin, _STEPS)[1].x
            further, found = _fitted(problem, larger, begin, max_iterations)
            further.refuse_unstable(found.x)
        except (InvalidInput, NumericalFailure, np.linalg.LinAlgError):
            continue
        if found.cost > minimum.cost - _TOLD * further.excess(found):
            continue
        problem, minimum = further, found
        layout, vain = larger, 0
        inside = range(layout.within(minimum.x))
        rates = np.exp([minimum.x[layout.mode(k)][0] for k in inside])
        shown = ", ".join(f"{rate / _CYCLE:.4g}" for rate in rates) or "none"
        progress(f"bending modes: {shown} Hz")
    if not layout.modes:  # none was seen, or none held: the rigid body is to explain all lines
        problem, minimum = _fitted(problem, layout, minimum.x, max_iterations)
    refuse(problem.mistakes(minimum.x))
    if problem.unstated:
        problem = problem.weighed(minimum.x)
        problem, minimum = _fitted(problem, layout, minimum.x, max_iterations)
    problem, hidden = problem.without_hum(minimum.x)
    if hidden:
        problem, minimum = _fitted(problem, layout, minimum.x, max_iterations)
    progress("checking the result")
    problem.refuse_unstable(minimum.x)
    found_machine = replace(layout, machine=machine).machine_of(minimum.x)
    begun = np.concatenate([values, minimum.x[len(paths) :]])
    result = _estimate(machine, problem, layout.reported(minimum.x)[0], begun, minimum, layout)
    checks = tuple(diagnose_values(found_machine, result, ()))
    refuse(checks)
    return LoopIdentification(
        given=found_machine,
        machine=found_machine,
        result=result,
        checks=checks,
        outputs=(),
        controller=controller,
        computing_delay=delay,
        bending_modes=layout.within(minimum.x),
        notes=(
            layout.words(minimum.x),
            *problem.notes(minimum.x, ("the bearings, or the two planes,",)),
            *hidden,
        ),
        responses=tuple(problem.beside(minimum.x, minimum.x)),
    )


def _measured(problem: Problem, layout: Layout) -> MeasuredLoop:
    """The problem's loop with another layout of its rotor."""
    model = problem.loop.model
    assert isinstance(model, MeasuredLoop)
    return replace(model, layout=layout)


def _up_to(problem: Problem, top: float) -> Problem:
    """With the lines up to there [rad/s], where these are enough."""
    lines = [one.omega <= top for one in problem.responses]
    if min(int(few.sum()) for few in lines) < _FEW:
        return problem
    band = tuple(one.at(few) for one, few in zip(problem.responses, lines, strict=True))
    return replace(problem, responses=band)


def _fitted(
    problem: Problem, layout: Layout, begin: np.ndarray, most: int
) -> tuple[Problem, Minimum]:
    """The problem of a measured rotor with this layout, and its minimum near ``begin``."""
    model = _measured(problem, layout)
    loop = replace(problem.loop, model=model)
    whole = replace(problem, loop=loop, prior=layout.prior(begin))
    bare = replace(whole, loop=replace(loop, model=replace(model, slopes=False)))
    return whole, minimise(
        whole.linearise,
        begin,
        layout.scale(begin),
        layout.allowed,
        most,
        tolerance=_CLOSE,
        negligible=_CLOSE,
        cost=bare.cost,
    )


def _plant_between(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (w,), the plant (w, a, a) that the first responses between all axes tell, and to
    first order its noise (w,). Raises InvalidInput where none do.
    """
    axes = problem.loop.axes
    noises = {id(path): problem.noise(path, k) for k, (_, path) in enumerate(problem.items)}
    for one in problem.responses:
        for quantity in ("G", "motion", "T", "S"):
            paths = {(p.read, p.injected): p for p in one.kind(quantity) if p.at == SENSOR}
            if len(paths) < len(axes) ** 2:
                continue
            X, noise = (
                np.array([[of(paths[i, j]) for j in axes] for i in axes]).transpose(2, 0, 1)
                for of in (lambda path: path.values, lambda path: noises[id(path)])
            )
            K, eye = problem.loop.controller(one.omega), np.eye(len(axes))
            if quantity == "G":
                left = right = np.broadcast_to(eye, X.shape)
                G = X
            elif quantity == "motion":  # G = Y (I - K Y)^-1, dG = (I - Y K)^-1 dY (I - K Y)^-1
                left, right = np.linalg.inv(eye - X @ K), np.linalg.inv(eye - K @ X)
                G = X @ right
            else:  # G = (S^-1 - I) K^-1, dG = -S^-1 dS S^-1 K^-1
                left = np.linalg.inv(X if quantity == "S" else eye - X)
                right = left @ np.linalg.inv(K)
                G = right - np.linalg.inv(K)
            sizes = [np.linalg.norm(part, 2, axis=(1, 2)) for part in (left, noise, right)]
            return one.omega, G, np.prod(sizes, axis=0)
    raise InvalidInput(
        "a measured rotor needs the responses between its bearings: those of each axis alone do "
        "not part the magnets from the rotor's inertia; sweep every axis, injected at the sensors, "
        "and record all displacements"
    )


def _with_modes(
    problem: Problem, layout: Layout, theta: np.ndarray, most: int, nearest: int, own: float
) -> tuple[Layout, np.ndarray]:
    """A rigid rotor at theta with the ``first_modes`` of the measured plant, at most ``most`` that
    ring, and ``nearest`` at one frequency beyond the lines; own: as there.
    """
    layout = replace(layout, ties=(), compliances=())
    omega, G, noise = _plant_between(problem)
    K = problem.loop.controller(omega)

    def plant(model: MeasuredLoop, theta: np.ndarray) -> np.ndarray:
        bare = replace(problem.loop, model=replace(model, slopes=False))
        Y = bare.motion(theta, omega)[0]
        return np.asarray(Y @ np.linalg.inv(np.eye(len(K[0])) - K @ Y))

    seen = first_modes(_measured(problem, layout), theta, omega, G, noise, plant, nearest, own)
    ringing = [one for one in seen if one[1] < RINGS][:most]
    for one in (*ringing, *(one for one in seen if one[1] >= RINGS)):
        layout, theta = layout.with_mode(theta, one)
    return layout, theta


def response_fit(
    omega: np.ndarray, path: Path, after: np.ndarray, before: np.ndarray, dt: float
) -> ResponseFit:
    """A measured path with its noise beside a model's values (w,), those found and those before."""
    one, unknown = (len(omega), 1, 1), np.full((len(omega), 1), np.nan)
    measured = Frf(
        path.values.reshape(one),
        omega,
        (path.injected,),
        (path.read,),
        noise_beside(omega, path, after).reshape(one),
        unknown,
        unknown,
        SCATTER_DOF if path.variance is None else _KNOWN,
        dt,
    )
    return ResponseFit(path.quantity, measured, after, before)


def _noise_of(values: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Variance (w,) of a path from its squared residuals (w,): a part of the response itself and
    one that is the same at every line, sigma^2 = a |X|^2 + b, a and b >= 0.
    """
    mean = max(float(np.mean(squares)), 1e-300)
    parts = np.column_stack([np.abs(values) ** 2, np.ones(len(values))])
    variance = np.full(len(values), mean)
    for _ in range(_REWEIGHED):  # a square of such a size scatters by as much
        found, _ = nnls(parts / variance[:, None], squares / variance)
        variance = np.maximum(parts @ found, _LEAST_NOISE * mean)
    return variance


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Responses beside the loop; noises: the deviation (w,) of every path's values, from the
    residuals where none was stated (none: 1 % of the values is assumed). prior: what was known
    of theta (q,) before, and its precision (None: nothing).
    """

    loop: Loop
    responses: tuple[Response, ...]
    noises: tuple[np.ndarray, ...] = ()
    prior: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def items(self) -> list[tuple[np.ndarray, Path]]:
        """Frequencies (w,) and path of everything measured."""
        return [(one.omega, path) for one in self.responses for path in one.paths]

    @property
    def count(self) -> int:
        return len(self.items)

    @property
    def unstated(self) -> bool:
        return any(path.variance is None for _, path in self.items)

    def models(
        self, theta: np.ndarray, factor: float = 1.0, named: Mapping[str, str] | None = None
    ) -> Iterator[tuple[Path, np.ndarray, np.ndarray]]:
        """Every path with its model's values (w,) and derivatives (q, w); factor: of the
        frequencies; named: other axes for those of the file.
        """
        named, axes = named or {}, self.loop.axes
        for one in self.responses:
            omega = one.omega * factor
            try:
                with np.errstate(over="raise", invalid="raise", divide="raise"):
                    Y, dY = self.loop.motion(theta, omega)
            except (FloatingPointError, NumericalFailure) as error:  # no such machine
                raise InvalidInput(f"the model overflows at these values: {error}") from None
            K, every = self.loop.controller(omega), whole(one, axes)
            for path in one.paths:
                read, injected = (named.get(x, x) for x in (path.read, path.injected))
                as_named = replace(path, read=read, injected=injected)
                yield path, *predicted(as_named, axes, Y, dY, K, every)

    def largest(self, path: Path) -> float:
        """The median size of the largest path of the same quantity."""
        alike = [p for _, p in self.items if (p.quantity, p.at) == (path.quantity, path.at)]
        return max(float(np.median(np.abs(p.values))) for p in alike)

    def small(self, path: Path) -> float:
        """What is smaller may be nothing but noise."""
        return _SMALL * self.largest(path)

    def noise(self, path: Path, number: int) -> np.ndarray:
        """Deviation (w,) of a path's values."""
        if path.variance is not None:
            return np.asarray(np.sqrt(path.variance))
        if self.noises:
            return self.noises[number]
        return _RELATIVE * np.hypot(np.abs(path.values), _FLOOR * self.largest(path))

    def residuals(self, theta: np.ndarray) -> list[tuple[Path, np.ndarray, np.ndarray]]:
        """Every path with residual (w,) and derivatives (q, w) over the deviation of their real
        and imaginary parts.
        """
        found = []
        for number, (path, values, slopes) in enumerate(self.models(theta)):
            sigma = self.noise(path, number) / np.sqrt(2)
            found.append((path, (path.values - values) / sigma, slopes / sigma))
        return found

    def linearise(self, theta: np.ndarray) -> Linearised:
        """The sums of squares of real and imaginary parts."""
        known, precision = np.zeros((2, len(theta))) if self.prior is None else self.prior
        H, g = np.diag(precision), precision * (known - theta)
        cost = float(precision @ (known - theta) ** 2)
        for path, r, J in self.residuals(theta):
            if path.quantity != "K":
                H += (J.conj() @ J.T).real
                g += (J.conj() @ r).real
                cost += float(np.vdot(r, r).real)
        if not np.isfinite(cost) or not np.isfinite(H).all():
            raise InvalidInput("the model is not finite at these values; start elsewhere (--start)")
        return Linearised(cost, H, g)

    def cost(self, theta: np.ndarray) -> float:
        """That of ``linearise``."""
        known, precision = np.zeros((2, len(theta))) if self.prior is None else self.prior
        own = float(precision @ (known - theta) ** 2)
        return own + sum(
            float(np.vdot(r, r).real) for p, r, _ in self.residuals(theta) if p.quantity != "K"
        )

    def refuse_unstable(self, theta: np.ndarray) -> None:
        """Raises InvalidInput where the loop that ran is unstable at theta, and says where."""
        found = poles(self.loop.at(theta)[0]).astype(complex)
        worst = found[int(np.argmax(np.abs(found)))]
        if np.abs(worst) < 1:
            return
        rate = float(self.loop.model.controller.dt or 1.0) * _CYCLE
        place = abs(float(np.angle(worst))) / rate
        top = max(float(omega[-1]) for omega, _ in self.items) / _CYCLE
        remedy = "check the controller's file, its rate and its delay"
        if place > top:
            remedy = f"the lines end at {top:.4g} Hz: sweep beyond it"
        raise InvalidInput(
            "the loop that fits these responses best is unstable, but it ran: it grows at "
            f"{place:.4g} Hz; {remedy}"
        )

    def excess(self, minimum: Minimum) -> float:
        """The residuals' variance over the noise's, at least 1: what the model lacks counts as
        noise.
        """
        return max(minimum.cost / (2 * sum(len(path.values) for _, path in self.items)), 1.0)

    def weighed(self, theta: np.ndarray) -> Problem:
        """With the noise that the residuals at theta tell, path by path."""
        share = len(theta) / (2 * sum(len(path.values) for _, path in self.items))
        noises = []
        for number, (path, r, _) in enumerate(self.residuals(theta)):
            # r is over the deviation of one part
            squares = np.abs(r * self.noise(path, number)) ** 2 / 2
            noises.append(np.sqrt(_noise_of(path.values, squares) / (1 - min(share, 0.5))))
        return replace(self, noises=tuple(noises))

    def without_hum(self, theta: np.ndarray) -> tuple[Problem, list[str]]:
        """Without the lines beside mains or the speed that stand out alone, and which, in words."""
        left: dict[int, np.ndarray] = {}
        rows = iter(self.residuals(theta))
        for k, one in enumerate(self.responses):
            # |r|^2 of noise is exponential, its median ln 2 of its mean; the mean over all paths
            sizes = np.array([np.abs(next(rows)[1]) ** 2 for _ in one.paths])
            level = np.maximum(np.median(sizes, axis=1, keepdims=True), 1e-300) / np.log(2)
            out = (sizes / level).mean(axis=0) > 1 + _OUT / np.sqrt(len(sizes))
            sources = [_CYCLE * f * n for f in _MAINS for n in _HARMONICS]
            sources += [one.point.speed * n for n in _HARMONICS if one.point.speed]
            near = np.abs(one.omega[:, None] / np.array(sources) - 1).min(axis=1) < _BESIDE
            # three in a row are no hum: a resonance, which stays and is doubted
            middle = out & np.roll(out, 1) & np.roll(out, -1)
            left[k] = near & out & ~(middle | np.roll(middle, 1) | np.roll(middle, -1))
        count = sum(int(lines.sum()) for lines in left.values())
        if not count or count > _MOST_LEFT * sum(len(one.omega) for one in self.responses):
            return self, []
        kept = [~left[k] for k in range(len(self.responses))]
        responses = tuple(one.at(lines) for one, lines in zip(self.responses, kept, strict=True))
        owner = [k for k, one in enumerate(self.responses) for _ in one.paths]
        noises = tuple(noise[kept[k]] for noise, k in zip(self.noises, owner, strict=False))
        hertz = sorted(
            float(w) / _CYCLE
            for one, lines in zip(self.responses, kept, strict=True)
            for w in one.omega[~lines]
        )
        shown = ", ".join(f"{f:.4g}" for f in hertz[:6])
        words = f"{count} lines left out that stand out beside mains or the speed: {shown} Hz" + (
            " and others" if len(hertz) > 6 else ""
        )
        return replace(self, responses=responses, noises=noises), [words]

    def mistakes(self, theta: np.ndarray) -> Iterator[Finding]:
        """What the file says wrongly, told by the model at theta and by the controller: the one
        correction that brings a quantity, or a path of it, much nearer; and what nothing brings
        near.
        """
        known = list(self.models(theta))
        others = [(words, list(self.models(theta, *how))) for words, how in self._readings()]
        groups: dict[tuple[int, str, str], list[int]] = {}
        for k, (omega, path) in enumerate(self.items):
            groups.setdefault((id(omega), path.quantity, path.at), []).append(k)
        alone = {quantity for _, quantity, _ in groups} <= set("LGK")
        for places in groups.values():
            named = self._mistake(places, known, others, alone)
            loud = [
                k
                for k in places
                if np.median(np.abs(known[k][0].values)) >= self.small(known[k][0])
            ]
            for k in loud if named is None or named.code != Code.MIXED_CHANNELS else ():
                one = self._mistake([k], known, (), alone)
                named = one if one is not None and one.code == Code.MIXED_CHANNELS else named
            if named is not None:
                yield named

    def _mistake(
        self,
        places: Sequence[int],
        known: Sequence[tuple[Path, np.ndarray, np.ndarray]],
        others: Sequence[tuple[str, Sequence[tuple[Path, np.ndarray, np.ndarray]]]],
        alone: bool,
    ) -> Finding | None:
        """Of the paths at those places. alone: nothing tells a scale from K_i."""
        items = [known[k][:2] for k in places]
        quantity = items[0][0].quantity
        far = distance([(path.values, values) for path, values in items])
        factors = [scale_error(*item) for item in items if item[0].read == item[0].injected]
        known_factors = [factor for factor in factors if factor is not None]
        factor = float(np.median(known_factors)) if known_factors else 0.0
        alike = len(known_factors) == len(factors) and all(
            abs(np.log(one / factor)) < _SAME_SCALE for one in known_factors
        )
        if far < _FAR and not (factor and alike):
            return None
        tries = readings(items)
        for words, other in others:
            pairs = [(other[k][0].values, other[k][1]) for k in places]
            tries.append((distance(pairs), words))
        best, words = min(tries)
        name = f"{quantity} ({QUANTITIES[quantity][0]})" if len(places) > 1 else items[0][0].name
        name, apart = f"{name} as stated", f"{far:.0%} off what the machine file and the controller"
        scaled = distance([(path.values / (factor or 1.0), values) for path, values in items])
        if factor and alike and (scaled < best or best * _NEARER >= far):
            remedy = "correct its unit or scale"
            if alone and quantity != "K" and _MAGNET[0] < factor < _MAGNET[1]:
                remedy += "; if K_i is so far off the machine file's, begin there (--start)"
            size = f"{factor:.2g} times larger" if factor > 1 else f"{1 / factor:.2g} times smaller"
            text = f"{name} is {apart} make: it is about {size}"
            return Finding(Code.MIXED_CHANNELS, ERROR, text, remedy=remedy)
        if best * _NEARER < far:
            what, remedy = words.split(": ")
            text = f"{name} is {apart} make, and {best:.0%} where {what}"
            return Finding(Code.MIXED_CHANNELS, ERROR, text, remedy=remedy)
        if far > (_OTHER_LAW if quantity == "K" else _LOST):
            code = Code.OTHER_CONTROLLER if quantity == "K" else Code.OTHER_MACHINE
            remedy = "say what was measured, at which axis, and give the controller that ran"
            return Finding(code, ERROR, f"{name} is {apart} make", remedy=remedy)
        return None

    def _readings(self) -> Iterator[tuple[str, tuple[float, Mapping[str, str]]]]:
        """Other frequencies and other axes that the file may have meant."""
        top = max(float(one.omega[-1]) for one in self.responses)
        half = np.pi / float(self.loop.model.controller.dt or 1.0)
        yield "frequencies are in rad/s, not Hz: state their unit rad/s", (1 / _CYCLE, {})
        if top * _CYCLE < half:
            yield "frequencies are in Hz, not rad/s: state their unit Hz", (_CYCLE, {})
        for words, named in self._exchanges():
            yield f"{words} are exchanged: exchange them in the file's names", (1.0, named)

    def _exchanges(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """Two axes, two bearings, or two directions of all, where a path has a name of them."""
        parts = {axis: axis.rpartition("_")[::2] for axis in self.loop.axes}
        read = {name for _, path in self.items for name in (path.read, path.injected)}
        kinds = [
            list(self.loop.axes),
            *(list(dict.fromkeys(pair)) for pair in zip(*parts.values(), strict=True)),
        ]
        seen: list[Mapping[str, str]] = []
        for kind, names in enumerate(kinds):
            for one, other in combinations(names, 2):
                swap = {one: other, other: one}
                named = {}
                for axis, pair in parts.items():
                    new = axis if kind else swap.get(axis, axis)
                    if kind:
                        new = "_".join(
                            swap.get(x, x) if k == kind - 1 else x for k, x in enumerate(pair)
                        )
                    if new != axis and new in parts:
                        named[axis] = new
                if named and named not in seen and read & set(named):
                    seen.append(named)
                    yield f"{one} and {other}", named

    def exchanged(
        self, minimum: Minimum, begin: np.ndarray, scale: np.ndarray
    ) -> tuple[list[str], tuple[Finding, ...]]:
        """Which axes could be exchanged in the file with no worse a fit, and which with a better
        one: twice the log likelihood of the best fit with exchanged names from the values at begin,
        beside that as named.
        """
        size, as_named = self.excess(minimum), self.linearise(begin).cost
        untold: list[str] = []
        better: list[tuple[float, str]] = []
        for words, named in self._exchanges():
            responses = tuple(
                replace(
                    one,
                    paths=tuple(
                        replace(
                            path,
                            read=named.get(path.read, path.read),
                            injected=named.get(path.injected, path.injected),
                        )
                        for path in one.paths
                    ),
                )
                for one in self.responses
            )
            other = replace(self, responses=responses)
            if other.linearise(begin).cost > _HOPELESS * as_named:
                continue

            def near(theta: np.ndarray) -> bool:
                return bool((np.abs(theta - begin) <= _AWAY * scale).all())

            cost = minimise(other.linearise, begin, scale, near, _REFITS).cost
            if cost < minimum.cost - _TOLD * size:
                better.append((cost, words))
            elif cost < minimum.cost + _TOLD * size:
                untold.append(words)
        if not better:
            return untold, ()
        text = f"the responses fit {min(better)[1]} exchanged better than as the file names them"
        remedy = "exchange them in the file's names"
        return untold, (Finding(Code.MIXED_CHANNELS, ERROR, text, remedy=remedy),)

    def beside(self, theta: np.ndarray, begin: np.ndarray) -> Iterator[ResponseFit]:
        """Every path with its model's values at theta and at begin."""
        models = zip(self.models(theta), self.models(begin), strict=True)
        dt = float(self.loop.model.controller.dt or 0.0)
        for (omega, path), (after, before) in zip(self.items, models, strict=True):
            yield response_fit(omega, path, after[1], before[1], dt)

    def notes(self, theta: np.ndarray, untold: Sequence[str] = ()) -> tuple[str, ...]:
        """What was fitted and how far the model holds, in words."""
        items = [
            (omega, path, values)
            for (omega, path), (_, values, _) in zip(self.items, self.models(theta), strict=True)
        ]
        large = [item for item in items if np.median(np.abs(item[1].values)) >= self.small(item[1])]
        left = len(items) - len(large)
        lines = sum(len(one.omega) for one in self.responses)
        return (
            f"fitted to {self.count} frequency responses at {lines} frequencies; "
            f"{agreement(large)}"
            + (f"; {left} paths below 10 % of the largest are left out of this" if left else ""),
            *((_UNSTATED,) if self.unstated else ()),
            *((_NAMES.format(", or ".join(untold[:3])),) if untold else ()),
        )


_NAMES = (
    "nothing tells whether the file has exchanged axes: {} exchanged fit as well; "
    "each axis has its values by its name in the file"
)
_UNSTATED = (
    "no noise is stated: the residuals' size weighs every path, the lines' own scatter is its noise"
)


# A resonance that nothing models: what a common pole explains, in all paths together, of what the
# model leaves in a band about it beside a straight line,
#
#     e(w) = (a + j w b)/(w0^2 - w^2 + 2 j zeta w0 w) + c + d (w - w0),  a, b real, c, d complex.


def missing_resonances(
    problem: Problem, theta: np.ndarray
) -> Iterator[tuple[float, float, float, str]]:
    """Frequency [rad/s] and damping ratio of each, as the running loop has it, the share that it
    explains of the residuals about it, and the path in which it shows most; the largest first.
    """
    left = []
    for (omega, path), (_, values, _) in zip(problem.items, problem.models(theta), strict=True):
        if path.quantity != "K" and np.median(np.abs(path.values)) >= problem.small(path):
            sigma = np.sqrt(np.maximum(noise_beside(omega, path, values), 1e-300) / 2)
            left.append((omega, path.name, (path.values - values) / sigma))
    for _ in range(_MOST_RESONANCES):

        def gained(w: float, zeta: float, left: Sequence[Any] = left) -> float:
            return sum(one[0] for one in _explained(left, float(w), float(np.abs(zeta))))

        # where most is left, line by line
        lines = [
            (float(np.abs(r[k])), float(omega[k]))
            for omega, _, r in left
            for k in np.argsort(np.abs(r))[-_PEAKS:]
        ]
        lines.sort(reverse=True)
        places = list(dict.fromkeys(w for _, w in lines))[:_PEAKS]
        if not places:
            return
        _, w, zeta = max((gained(w, zeta), w, zeta) for w in places for zeta in _DAMPINGS)
        start = np.array([w, zeta])
        found = optimise(
            lambda x, start=start, gained=gained: -gained(*(start * np.exp(x))),
            np.zeros(2),
            method="Nelder-Mead",
            options={"initial_simplex": [[0, 0], [0.01, 0], [0, 0.3]], "maxfev": 60},
        )
        w, zeta = (start * np.exp(found.x)).tolist()
        parts = _explained(left, w, zeta)
        gain, whole, count = (float(sum(one[k] for one in parts)) for k in range(3))
        rest = max((whole - gain) / max(2 * count - 6 * len(parts), 1.0), 1.0)
        if gain < _TELLING * rest + 2 * len(parts) or gain < _SHARE * whole or zeta > _WIDE:
            return
        largest = int(np.argmax([one[0] for one in parts]))
        yield w, zeta, gain / whole, left[largest][1]
        left = [
            (omega, name, r - one[3]) for (omega, name, r), one in zip(left, parts, strict=True)
        ]


def _explained(
    left: Sequence[tuple[np.ndarray, str, np.ndarray]], w: float, zeta: float
) -> list[tuple[float, float, int, np.ndarray]]:
    """Of every path: the sum of squares that a pole explains beside a straight line, that beside
    the line alone, the lines of the band, and the pole's part (w,).
    """
    found = []
    for omega, _, r in left:
        band = np.abs(np.log(omega / w)) < _BAND
        if band.sum() < _LINES:
            found.append((0.0, 0.0, 0, np.zeros_like(r)))
            continue
        pole = 1 / (1 - (omega / w) ** 2 + 2j * zeta * omega / w)
        away = omega[band] / w - 1
        ones = np.ones_like(away)
        line = np.stack([ones, 1j * ones, away, 1j * away], axis=1)
        own = np.stack([pole, 1j * omega / w * pole], axis=1)
        y = np.concatenate([r[band].real, r[band].imag])
        A, B = (np.concatenate([M.real, M.imag]) for M in (line, own[band]))
        Q = np.linalg.qr(A)[0]
        y, B = y - Q @ (Q.T @ y), B - Q @ (Q.T @ B)
        x = np.linalg.lstsq(B, y, rcond=None)[0]
        gain = float(y @ (B @ x))
        found.append((gain, float(y @ y), int(band.sum()), own @ x))
    return found


def _named(problem: Problem, theta: np.ndarray, severity: str) -> Iterator[Finding]:
    """The resonances that nothing models, each beside the mode of the model that lies near."""
    loop = problem.loop.at(theta)[0]
    s = np.log(poles(loop).astype(complex) + 1e-300) / float(loop.dt or 1.0)
    modes = s.imag[(s.imag > 0) & (-s.real < _WIDE * np.abs(s))]
    for w, zeta, share, name in missing_resonances(problem, theta):
        near = modes[np.abs(modes / w - 1) < _NEAR_MODE] if modes.size else modes
        what = (
            f"a resonance that nothing models: {w / _CYCLE:.4g} Hz, damping ratio {zeta:.2g}, most "
            f"in {name}; it explains {share:.0%} of what the model leaves about it"
        )
        remedy = "a casing, a free mode or a pipe: find it by a hammer test, or leave its lines out"
        if zeta < _ALONE:
            what = f"the line at {w / _CYCLE:.4g} Hz stands out alone, most in {name}"
            remedy = (
                "hum, the speed, or a resonance narrower than the lines: leave it out, or sweep "
                "closer there"
            )
        elif near.size:
            mode = near[int(np.argmin(np.abs(near / w - 1)))] / _CYCLE
            remedy = (
                f"the model's mode at {mode:.4g} Hz may be off (--unknown bending); or {remedy}"
            )
        yield Finding(Code.RESIDUALS, severity, what, remedy=remedy)


def _estimate(
    machine: Machine,
    problem: Problem,
    paths: tuple[str, ...],
    begin: np.ndarray,
    minimum: Minimum,
    layout: Layout | None = None,
) -> ParameterEstimate:
    """layout: of theta, of which the paths are a part (None: they are theta)."""
    H = problem.linearise(minimum.x).H
    findings: list[Finding] = []
    fits: list[tuple[int, str, float]] = []
    excess = 1.0
    models = [values for _, values, _ in problem.models(minimum.x)]
    for number, ((omega, path), (_, r, _)) in enumerate(
        zip(problem.items, problem.residuals(minimum.x), strict=True)
    ):
        if path.quantity == "K":
            continue
        mean = float(np.mean(np.abs(r) ** 2)) / 2  # 1 where nothing but noise is left
        beside = mean
        if path.variance is None and len(omega) >= _FEW:
            alone = noise_beside(omega, path, models[number])
            beside = float(np.mean(np.abs(path.values - models[number]) ** 2 / alone))
        alike = max(float(np.vdot(r[:-1], r[1:]).real / max(np.vdot(r, r).real, 1e-300)), 0.0)
        left = np.abs(r) * problem.noise(path, number) / np.sqrt(2)
        spread = float(np.linalg.norm(path.values - path.values.mean()))
        fits.append((1, path.name, 100 * (1 - float(np.linalg.norm(left)) / spread)))
        size = np.maximum(np.abs(path.values), _SMALL * problem.largest(path))
        relative = float(np.median(left / size))
        worst = f"most at {omega[int(np.argmax(np.abs(r)))] / _CYCLE:.4g} Hz"
        remedy = "model what is missing there (--bending-modes, a casing mode), or leave lines out"
        loud = beside > _LOUD + 5 / np.sqrt(len(r))
        follows = alike > max(_ALIKE, 4 / np.sqrt(2 * len(r)))
        if relative > _WRONG_SIZE:
            text = f"the model is {relative:.0%} off {path.name} at any parameter values, {worst}"
            findings.append(Finding(Code.MISSING_RESPONSE, ERROR, text, remedy=remedy))
        elif loud or follows:
            # errors alike at neighbours count as fewer lines
            excess = max(excess, mean * (1 + alike) / (1 - min(alike, 0.9)))
            why = (
                f"{np.sqrt(beside):.2g} times the noise"
                if loud
                else f"{relative:.2g} of it, alike at neighbouring lines"
            )
            text = f"the model leaves of {path.name} {why}, {worst}"
            findings.append(Finding(Code.RESIDUALS, WARNING, text, remedy=remedy))
    lacking = len(findings)  # one of a path
    if findings:
        worst = ERROR if any(item.severity == ERROR for item in findings) else WARNING
        findings[:0] = _named(problem, minimum.x, worst)
    refuse(findings)
    covariance = np.linalg.inv(H) * excess
    if layout is not None:  # what is stated of theta, and what is left for it of the information
        chosen = np.array(layout.reported(minimum.x)[1])
        values, slopes = layout.stated(minimum.x[chosen])
        begin = layout.stated(begin[chosen])[0]
        covariance = covariance[np.ix_(chosen, chosen)] * slopes * slopes[:, None]
        H = np.linalg.inv(covariance / excess)
        minimum = replace(minimum, x=values)
    correlation = statistics.parameter_correlation(H)
    verdict = (
        f"{lacking} of {problem.count} responses hold what the model lacks; the first: "
        f"{findings[0].what}"
        if findings
        else "what the residuals of the responses hold is noise"
    )
    warnings = statistics.warnings_of(paths, minimum, covariance, correlation, (), verdict)
    cosine = statistics.column_cosine(H)
    return ParameterEstimate(
        machine.name,
        problem.responses[0].point,
        paths,
        minimum.x,
        begin,
        covariance,
        correlation,
        cosine,
        tuple(fits),
        (),
        float(np.linalg.cond(cosine)),
        minimum.converged,
        minimum.iterations,
        (*warnings, *findings),
        verdict,
    )
