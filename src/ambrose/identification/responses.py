"""From measured frequency responses to parameters: the closed loop's responses as it runs, fitted
by weighted least squares.

With the loop's own response Y from an excitation current to the displacement, and the sampled
controller K with its delay, every response is Y's: of square matrices

    T = Y K, S = I - Y K at the sensors;  T = K Y, S = I - K Y at the commands;
    G = Y (I - K Y)^-1;  of an axis, the other loops closed, L = 1/S_aa - 1, G_a = Y_aa/S_aa.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as File
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles
from ambrose.identification.data_quality.signals import point_findings
from ambrose.identification.findings import ERROR, WARNING, Code, Finding, refuse
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.loop_model import LoopModel, loop_model
from ambrose.identification.output_error.normal_equations import Linearised, Minimum, minimise
from ambrose.identification.output_error.problem import deployed_controller, start_values
from ambrose.identification.parameters import nominal_values, reduced_plant, split_timing
from ambrose.identification.result import LoopIdentification
from ambrose.identification.validation.plausibility import diagnose_values
from ambrose.law.law import LawLike
from ambrose.law.loop import timing_of
from ambrose.machine.machine import Machine
from ambrose.record.response import QUANTITIES, Path, Response, distance, predicted, usable, whole
from ambrose.record.response_files import holds_responses, read_response

_CYCLE = 2 * np.pi
_RELATIVE, _FLOOR = 0.01, 0.05  # noise where none is stated: of the value, and of its median
# a mistake is named where the model is this far, and a correction brings it so much nearer
_FAR, _NEARER = 0.05, 3.0
_LOST = 0.6  # and this far without one, it is none of it
_OTHER_LAW = 0.1  # of the controller, which is known: then it is another one
_WRONG_SIZE = 0.3  # relative: residuals with which no number can be trusted
_LOUD, _ALIKE = (
    1.5,
    0.3,
)  # residual over noise, correlation of neighbours: the model lacks something
_SMALL = 0.1  # of the largest path: what is smaller may be nothing but noise
_VALID = 0.1, np.radians(10.0)
_RADIUS = 1.73  # of a complex value's deviation: sqrt(-ln 0.05), the circle that holds 95 %


def as_responses(records: Any) -> tuple[Response, ...]:
    """The responses among what was given to be identified from, none where it is records. Raises
    InvalidInput for a mixture.
    """
    items = [records] if isinstance(records, Response | str | File) else records
    if not isinstance(items, Sequence):
        return ()
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
    return tuple(item if isinstance(item, Response) else read_response(item) for item in items)


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """The loop that ran, in theta (q,), and its controller K (delay within)."""

    model: LoopModel
    axes: tuple[str, ...]

    def motion(self, theta: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y (w, a, a) and its derivatives (q, w, a, a)."""
        loop, directions = self.model.loop(theta)
        z = np.exp(1j * omega * float(loop.dt or 1.0))
        eye = np.eye(loop.n_states)

        # Y = C (zI - A)^-1 B, dY = C (zI - A)^-1 (dA (zI - A)^-1 B + dB)
        inner = z[:, None, None] * eye - loop.A
        X = np.linalg.solve(inner, np.broadcast_to(loop.B, (len(z), *loop.B.shape)))
        C = np.broadcast_to(loop.C.T, (len(z), *loop.C.T.shape))
        shown = np.linalg.solve(inner.swapaxes(1, 2), C).swapaxes(1, 2)
        dY = np.array([shown @ (one.A @ X + one.B) for one in directions])
        return loop.C @ X, dY

    def controller(self, omega: np.ndarray) -> np.ndarray:
        """K (w, a, a)."""
        return frequency_response(self.model.controller, omega).values

    def stable(self, theta: np.ndarray) -> bool:
        return bool((np.abs(poles(self.model.loop(theta)[0])) < 1).all())


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

    Weights: the variances that are stated, else the residual's own size, path by path; intervals
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
    modes = 3 if bending_modes is None else bending_modes
    plant = reduced_plant(machine, point, modes, paths)
    law = deployed_controller(plant, controller, timing.sample_time, delay)
    values = nominal_values(plant, paths)
    e, y = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "ey")
    loop = Loop(loop_model(plant, law, paths, values, e, y), tuple(plant.axes))
    begin = start_values(paths, values, start)
    problem = Problem(loop, tuple(usable(one, loop.axes, timing.sample_time) for one in responses))
    progress("checking what was measured")
    refuse(problem.mistakes(begin))
    progress(f"identifying {len(paths)} parameters from {problem.count} paths")
    scale = np.where(begin == 0, 1.0, np.abs(begin))
    statistics.check_visible(paths, problem.linearise(begin).H, scale)
    minimum = minimise(problem.linearise, begin, scale, lambda theta: True, max_iterations)
    if problem.unstated:  # again, with the size of every path's own residual
        problem = problem.weighed(minimum.x)
        minimum = minimise(problem.linearise, minimum.x, scale, lambda theta: True, max_iterations)
    progress("checking the result")
    if not loop.stable(minimum.x):
        raise InvalidInput(
            "the loop that fits these responses best is unstable, but it ran; check the "
            "controller's file, its rate and its delay"
        )
    result = _estimate(machine, problem, paths, begin, minimum)
    checks = diagnose_values(machine, result, ())
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
        notes=problem.notes(minimum.x),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Responses beside the loop; sizes: by which the noise of every path is multiplied where none
    was stated.
    """

    loop: Loop
    responses: tuple[Response, ...]
    sizes: tuple[float, ...] = ()

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
            Y, dY = self.loop.motion(theta, omega)
            K, every = self.loop.controller(omega), whole(one, axes)
            for path in one.paths:
                read, injected = (named.get(x, x) for x in (path.read, path.injected))
                as_named = replace(path, read=read, injected=injected)
                yield path, *predicted(as_named, axes, Y, dY, K, every)

    def largest(self, path: Path) -> float:
        """The median size of the largest path of the same quantity."""
        alike = [p for _, p in self.items if (p.quantity, p.at) == (path.quantity, path.at)]
        return max(float(np.median(np.abs(p.values))) for p in alike)

    def noise(self, path: Path, number: int) -> np.ndarray:
        """Deviation (w,) of a path's values."""
        if path.variance is not None:
            return np.asarray(np.sqrt(path.variance))
        size = np.hypot(np.abs(path.values), _FLOOR * self.largest(path))
        return np.asarray((self.sizes[number] if self.sizes else _RELATIVE) * size)

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
        H, g = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
        cost = 0.0
        for path, r, J in self.residuals(theta):
            if path.quantity != "K":
                H += (J.conj() @ J.T).real
                g += (J.conj() @ r).real
                cost += float(np.vdot(r, r).real)
        return Linearised(cost, H, g)

    def weighed(self, theta: np.ndarray) -> Problem:
        """With the sizes of the residuals at theta."""
        share = len(theta) / (2 * sum(len(path.values) for _, path in self.items))
        sizes = []
        for number, (path, r, _) in enumerate(self.residuals(theta)):
            mean = float(np.mean(np.abs(r) ** 2)) / 2 / (1 - min(share, 0.5))
            before = self.sizes[number] if self.sizes else _RELATIVE
            sizes.append(before * np.sqrt(max(mean, 1e-20)) if path.variance is None else 1.0)
        return replace(self, sizes=tuple(sizes))

    def mistakes(self, theta: np.ndarray) -> Iterator[Finding]:
        """What the file says wrongly, told by the model at theta and by the controller: the one
        correction that brings a quantity much nearer; and what nothing brings near.
        """
        known = list(self.models(theta))
        others = [(words, list(self.models(theta, *how))) for words, how in self._readings()]
        groups: dict[tuple[int, str, str], list[int]] = {}
        for k, (omega, path) in enumerate(self.items):
            groups.setdefault((id(omega), path.quantity, path.at), []).append(k)
        for (_, quantity, _), places in groups.items():
            items = [known[k][:2] for k in places]
            far = distance([(path.values, values) for path, values in items])
            if far < _FAR:
                continue
            tries = [
                (distance([(change(path), values) for path, values in items]), words)
                for words, change in _CORRECTIONS.items()
                if quantity in "ST" or words != _OTHER
            ]
            for words, other in others:
                pairs = [(other[k][0].values, other[k][1]) for k in places]
                tries.append((distance(pairs), words))
            best, words = min(tries)
            name = f"{quantity} ({QUANTITIES[quantity][0]}) as stated"
            apart = f"{far:.0%} off what the machine file and the controller make"
            if best * _NEARER < far:
                what, remedy = words.split(": ")
                yield Finding(
                    Code.MIXED_CHANNELS,
                    ERROR,
                    f"{name} is {apart}, and {best:.0%} where {what}",
                    remedy=remedy,
                )
            elif far > (_OTHER_LAW if quantity == "K" else _LOST):
                code = Code.OTHER_CONTROLLER if quantity == "K" else Code.OTHER_MACHINE
                remedy = "say what was measured, at which axis, and give the controller that ran"
                yield Finding(code, ERROR, f"{name} is {apart}", remedy=remedy)

    def _readings(self) -> Iterator[tuple[str, tuple[float, Mapping[str, str]]]]:
        """Other frequencies and other axes that the file may have meant."""
        top = max(float(one.omega[-1]) for one in self.responses)
        half = np.pi / float(self.loop.model.controller.dt or 1.0)
        yield "frequencies are in rad/s, not Hz: state their unit rad/s", (1 / _CYCLE, {})
        if top * _CYCLE < half:
            yield "frequencies are in Hz, not rad/s: state their unit Hz", (_CYCLE, {})
        axes = self.loop.axes
        for i, one in enumerate(axes):
            for other in axes[:i]:
                text = f"{other} and {one} are exchanged: exchange them in the file's names"
                yield text, (1.0, {one: other, other: one})

    def notes(self, theta: np.ndarray) -> tuple[str, ...]:
        """What was fitted and how far the model holds, in words."""
        reach = []
        for number, ((omega, path), (_, values, _)) in enumerate(
            zip(self.items, self.models(theta), strict=True)
        ):
            ratio = values / path.values
            if np.median(np.abs(path.values)) < _SMALL * self.largest(path):
                continue
            margin = _RADIUS * self.noise(path, number) / np.abs(path.values)
            off = (np.abs(np.abs(ratio) - 1) > _VALID[0] + margin) | (
                np.abs(np.angle(ratio)) > _VALID[1] + np.arcsin(np.minimum(margin, 1.0))
            )
            off &= margin <= _VALID[0]  # others are too noisy to tell
            reach.append(float(omega[max(int(np.argmax(off)) - 1, 0) if off.any() else -1]))
        lines = sum(len(one.omega) for one in self.responses)
        return (
            f"fitted to {self.count} frequency responses at {lines} frequencies; model and "
            f"measurement agree within 10 % and 10 degrees up to {min(reach) / _CYCLE:.4g} Hz",
            *(("no noise is stated: the residuals' size stands for it",) if self.unstated else ()),
            # exchanged names give exchanged values, and as good a fit
            *((_NAMES,) if all(path.read == path.injected for _, path in self.items) else ()),
        )


def _times(factor: float, path: Path) -> np.ndarray:
    return factor * path.values


_NAMES = (
    "no response is between two axes, so that nothing tells whether the file has exchanged axes: "
    "each axis has its values by its name in the file"
)
_OTHER = "it is the other of S and T: exchange S and T"
_CORRECTIONS: Mapping[str, Callable[[Path], np.ndarray]] = {
    "its sign is turned: add sign = -1 to the path, or turn the channel": lambda p: -p.values,
    _OTHER: lambda p: float(p.read == p.injected) - p.values,
    "a lag is positive: turn the sign of the phase": lambda p: p.values.conj(),
    "the gain is absolute, not in dB: state gain in abs": lambda p: (
        20 * np.log10(np.abs(p.values)) * np.exp(1j * np.angle(p.values))
    ),
    "the gain is in dB, not absolute: state gain in dB": lambda p: (
        10 ** np.minimum(np.abs(p.values) / 20, 20) * np.exp(1j * np.angle(p.values))
    ),
    "the gain is in dB and below 1, not absolute: state gain in dB": lambda p: (
        -(10 ** (-np.abs(p.values) / 20)) * np.exp(1j * np.angle(p.values))
    ),
    "the gain is 10 log10: double it": lambda p: p.values * np.abs(p.values),
    "the gain is 40 log10: halve it": lambda p: p.values / np.sqrt(np.abs(p.values)),
    "the phase is in radians, not degrees: state phase in rad": lambda p: (
        np.abs(p.values) * np.exp(1j * np.degrees(np.angle(p.values)))
    ),
    **{
        f"it is {1 / factor:g} times larger: correct its unit": partial(_times, factor)
        for factor in (1e-6, 1e-3, 1e3, 1e6)
    },
}


def _estimate(
    machine: Machine,
    problem: Problem,
    paths: tuple[str, ...],
    begin: np.ndarray,
    minimum: Minimum,
) -> ParameterEstimate:
    H = problem.linearise(minimum.x).H
    findings: list[Finding] = []
    fits: list[tuple[int, str, float]] = []
    excess = 1.0
    for number, ((omega, path), (_, r, _)) in enumerate(
        zip(problem.items, problem.residuals(minimum.x), strict=True)
    ):
        if path.quantity == "K":
            continue
        mean = float(np.mean(np.abs(r) ** 2)) / 2  # 1 where nothing but noise is left
        alike = max(float(np.vdot(r[:-1], r[1:]).real / max(np.vdot(r, r).real, 1e-300)), 0.0)
        left = np.abs(r) * problem.noise(path, number) / np.sqrt(2)
        spread = float(np.linalg.norm(path.values - path.values.mean()))
        fits.append((1, path.name, 100 * (1 - float(np.linalg.norm(left)) / spread)))
        size = np.maximum(np.abs(path.values), _SMALL * problem.largest(path))
        relative = float(np.median(left / size))
        worst = f"most at {omega[int(np.argmax(np.abs(r)))] / _CYCLE:.4g} Hz"
        remedy = "model what is missing there (--bending-modes, a casing mode), or leave lines out"
        loud = mean > _LOUD + 5 / np.sqrt(len(r))
        follows = alike > max(_ALIKE, 4 / np.sqrt(2 * len(r)))
        if relative > _WRONG_SIZE:
            text = f"the model is {relative:.0%} off {path.name} at any parameter values, {worst}"
            findings.append(Finding(Code.MISSING_RESPONSE, ERROR, text, remedy=remedy))
        elif loud or follows:
            # errors alike at neighbours count as fewer lines
            excess = max(excess, mean * (1 + alike) / (1 - min(alike, 0.9)))
            why = (
                f"{np.sqrt(mean):.2g} times the noise"
                if loud
                else f"{relative:.2g} of it, alike at neighbouring lines"
            )
            text = f"the model leaves of {path.name} {why}, {worst}"
            findings.append(Finding(Code.RESIDUALS, WARNING, text, remedy=remedy))
    refuse(findings)
    covariance = np.linalg.inv(H) * excess
    correlation = statistics.parameter_correlation(H)
    verdict = (
        f"{len(findings)} of {problem.count} responses hold what the model lacks; the first: "
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
