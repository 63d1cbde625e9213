"""Is this record what it says it is? Findings before the identification, so that no wrong number
comes out silently.

Signal by signal (data_quality/signals.py), the controller against its own output
(data_quality/controller.py), the measured responses against the model's for every way the channels
could be mixed up (data_quality/diagnosis.py).
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from ambrose.core.checks import AmbroseError, InvalidInput, as_several
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, delayed
from ambrose.core.statespace import StateSpace, select
from ambrose.identification import frf_spectral as frf
from ambrose.identification.data_quality.controller import (
    DOUBTS,
    LAGS,
    ControllerMatch,
    controller_match,
    excitation_findings,
    of_another_law,
    resolution_residual,
)
from ambrose.identification.data_quality.signals import signal_findings
from ambrose.identification.findings import ERROR, WARNING, Code, Finding, refuse, signal_rows
from ambrose.identification.frf import Step, phasors
from ambrose.identification.output_error.normal_equations import distinct
from ambrose.identification.output_error.problem import (
    deployed_controller,
    operating_points,
)
from ambrose.identification.parameters import nominal_values, plant_at, ratios
from ambrose.identification.validation.places import machine_at_load
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import closed_loop
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.record.record import Record

# Which channel is which? The measured closed-loop responses against the model's, for every way
# channels could be mixed up.
#
# Responses T from the excitations to y, u and i (identification/frf_spectral.py, free of the loop's
# noise) must be those of the loop: T_y and T_u those of the model, T_u = -K T_y whatever the plant
# is, and T_i the amplifier's response to u + e. A swapped or inverted channel breaks some of these
# and not the others, which tells it from a changed parameter, and mostly also tells which one it
# is.


KINDS = {"y": "displacement", "u": "controller output", "i": "coil current", "e": "excitation"}
_LINES = 400  # of a response that are compared, at most
_FLOOR = 1e-3  # share of power: leakage and noise below it decide nothing
SEGMENT = 64  # samples of a segment, at least
_ALL_UP_TO = 4  # axes for which every signed permutation is tried


@dataclass(frozen=True, slots=True)
class Wiring:
    """Channel number i of a kind shows axis ``order[i]`` times ``signs[i]``; kind "" is the record
    as it is labelled.
    """

    kind: str = ""
    order: tuple[int, ...] = ()
    signs: tuple[int, ...] = ()

    def matrix(self, kind: str, count: int) -> np.ndarray:
        """(a, a): the channels of a kind from the axes."""
        if kind != self.kind:
            return np.eye(count)
        return np.eye(count)[list(self.order)] * np.array(self.signs)[:, None]

    @property
    def changes(self) -> int:
        return sum(
            j != i or s < 0 for i, (j, s) in enumerate(zip(self.order, self.signs, strict=True))
        )

    def words(self, axes: Sequence[str]) -> str:
        """ "y_A_zeta and y_A_eta are swapped", "u_B_eta has the wrong sign"."""
        parts, done = [], set()
        for i, (j, sign) in enumerate(zip(self.order, self.signs, strict=True)):
            name = f"{self.kind}_{axes[i]}"
            if i in done or (i == j and sign > 0):
                continue
            if i == j:
                parts.append(f"{name} has the wrong sign")
            elif self.order[j] == i:
                done.add(j)
                turned = [f"{self.kind}_{axes[n]}" for n in (i, j) if self.signs[n] < 0]
                extra = f", {' and '.join(turned)} with the wrong sign" if turned else ""
                parts.append(f"{name} and {self.kind}_{axes[j]} are swapped{extra}")
            else:
                parts.append(f"{name} shows {'-' if sign < 0 else ''}{self.kind}_{axes[j]}")
        if len(parts) == len(axes) and all("wrong sign" in part for part in parts):
            return f"all {self.kind}_ channels have the wrong sign"
        return "; ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Responses:
    """Responses (w, a, r) of each kind of signal to the distinct excitations, at omega (w,)
    [rad/s], with the sum of squares that noise makes of them (w, a); coherence (a, w) with the
    excitations, ``chance`` what 995 of 1000 lines without any trace of them would stay below; mix
    (a, r): the excitations e from the distinct ones.
    """

    omega: np.ndarray
    values: Mapping[str, np.ndarray]
    noise: Mapping[str, np.ndarray]
    coherence: Mapping[str, np.ndarray]
    chance: float
    mix: np.ndarray


def measured_responses(
    records: Sequence[Record], axes: Sequence[str], of: str = "yui"
) -> Responses | None:
    """The responses of the records' signals of these kinds, or None where excitations or their
    number of segments do not allow any.
    """
    from scipy.special import betaincinv

    parts_of = zip(
        *(signal_rows(record, [f"e_{axis}" for axis in axes]) for record in records), strict=True
    )
    e = [rows[0] if len(rows) == 1 else np.concatenate(rows) for rows in parts_of]
    if not any(row.any() for row in e):
        return None
    _, mix = distinct(e)
    names = [f"e_{axes[int(np.flatnonzero(column)[0])]}" for column in mix.T]
    signs = np.array([column[np.flatnonzero(column)[0]] for column in mix.T])
    kinds = [
        kind
        for kind in of
        if all(f"{kind}_{axis}" in record.signals for record in records for axis in axes)
    ]
    shortest = min(record.values.shape[1] for record in records)
    total = sum(record.values.shape[1] for record in records)
    dt = records[0].dt
    L = min(round(0.5 / dt), shortest, total // (2 * mix.shape[1] + 2))
    if L < SEGMENT or not kinds:
        return None
    try:
        estimate = frf.h1(
            records, names, [f"{kind}_{axis}" for kind in kinds for axis in axes], segment=L * dt
        )
    except InvalidInput:
        return None
    kept = np.unique(
        np.round(np.linspace(0, len(estimate.omega) - 1, min(_LINES, len(estimate.omega)))).astype(
            int
        )
    )
    a = len(axes)
    parts = {kind: slice(n * a, (n + 1) * a) for n, kind in enumerate(kinds)}
    return Responses(
        estimate.omega[kept],
        {kind: estimate.values[kept][:, part] * signs for kind, part in parts.items()},
        {kind: estimate.variance[kept][:, part].sum(axis=2) for kind, part in parts.items()},
        {kind: estimate.coherence[:, part].T for kind, part in parts.items()},
        float(betaincinv(mix.shape[1], estimate.freedom, 0.995)),
        mix,
    )


def compared_responses(
    record: Record,
    names: Sequence[str],
    residual: Sequence[np.ndarray] | np.ndarray,
    axes: Sequence[str],
) -> tuple[Responses, Responses] | None:
    """The responses of a record's signals, and those of what a model leaves of them, residual (a,
    k); None as above.
    """
    driven = [name for name in record.signals if name[:2] == "e_"]
    whole = measured_responses([record], axes, names[0][0])
    left = np.empty((len(names) + len(driven), record.values.shape[1]))
    for row, values in zip(left, [*residual, *signal_rows(record, driven)], strict=True):
        row[:] = values
    left.flags.writeable = False  # or the record would copy it
    units = tuple(record.units[record.signals.index(name)] for name in (*names, *driven))
    rest = measured_responses(
        [replace(record, signals=(*names, *driven), units=units, values=left)], axes
    )
    return None if whole is None or rest is None else (whole, rest)


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """The loop of the model on the same lines: T_y, T_u (w, a, a) from e, K with its delay (w, a,
    a), amplifier (w, a, a).
    """

    y: np.ndarray
    u: np.ndarray
    K: np.ndarray
    amplifier: np.ndarray

    def shares(
        self,
        true: Mapping[str, np.ndarray],
        excited: np.ndarray,
        noise: Mapping[str, np.ndarray],
    ) -> dict[str, np.ndarray]:
        """{relation: the share of it that is unexplained (n, a)} of the signals that there are."""
        unexplained: dict[str, np.ndarray] = {}
        if "y" in true:
            unexplained["y"] = _share(true["y"], self.y @ excited, noise["y"])
        if "u" in true:
            unexplained["u"] = _share(true["u"], self.u @ excited, noise["u"])
            if "y" in true:
                unexplained["K"] = _share(true["u"], -self.K @ true["y"], 0 * noise["u"])
        if "i" in true:
            command = (true["u"] if "u" in true else self.u @ excited) + excited
            unexplained["i"] = _share(true["i"], self.amplifier @ command, noise["i"])
        return unexplained


@dataclass(frozen=True, slots=True, eq=False)
class OpenLoop:
    """What holds whatever the controller is: y = G (u + e), and i = amplifier (u + e), both (w, a,
    a).
    """

    G: np.ndarray
    amplifier: np.ndarray

    def command(self, values: Mapping[str, np.ndarray], excited: np.ndarray) -> np.ndarray:
        """Responses (w, a, r) of what the amplifiers are told, from those of u or else of i."""
        if "u" in values:
            return values["u"] + excited
        return np.linalg.solve(self.amplifier, values["i"])

    def shares(
        self,
        true: Mapping[str, np.ndarray],
        excited: np.ndarray,
        noise: Mapping[str, np.ndarray],
    ) -> dict[str, np.ndarray]:
        """As of ``Expected``."""
        command = self.command(true, excited)
        unexplained = {"y": _share(true["y"], self.G @ command, noise["y"])}
        if {"u", "i"} <= set(true):
            unexplained["i"] = _share(true["i"], self.amplifier @ command, noise["i"])
        return unexplained


def open_loop_responses(plant: Plant, dt: float, omega: np.ndarray) -> OpenLoop:
    """Of the plant behind its hold every ``dt`` [s], at omega (w,) [rad/s]."""
    y, u, i = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "yui")
    values = frequency_response(c2d(select(plant.system, u, [*y, *i]), dt), omega).values
    return OpenLoop(values[:, : len(y)], values[:, len(y) :])


def expected_responses(plant: Plant, law: StateSpace, omega: np.ndarray) -> Expected:
    """law: sampled, its computing delay included, signals err_<axis> and u_<axis>; omega (w,)
    [rad/s].
    """
    axes, dt = plant.axes, law.dt
    assert dt is not None
    e, y, u = ([f"{kind}_{axis}" for axis in axes] for kind in "eyu")
    coils = c2d(select(plant.system, u, [f"i_{axis}" for axis in axes]), dt)
    loop = frequency_response(select(closed_loop(plant, law), e, [*y, *u]), omega).values
    a = len(axes)
    return Expected(
        loop[:, :a],
        loop[:, a:],
        frequency_response(law, omega).values,
        frequency_response(coils, omega).values,
    )


def shares(measured: Responses, expected: Expected | OpenLoop, wiring: Wiring) -> dict[str, float]:
    """What part of the measured power each relation leaves unexplained under this wiring: "y" and
    "u" against the model, "K": u against the controller, "i" against the amplifier; the mean over
    the axes. Of an open loop, "y" against the plant's answer to the commands, or to the currents.
    """
    return {
        relation: float(np.mean(share))
        for relation, share in shares_by_axis(measured, expected, wiring).items()
    }


def shares_by_axis(
    measured: Responses, expected: Expected | OpenLoop, wiring: Wiring
) -> dict[str, np.ndarray]:
    """The same of every axis (a,)."""
    channels = wiring.matrix(wiring.kind, len(measured.mix))[None]
    found = _shares(measured, expected, wiring.kind, channels)
    return {relation: share[0] for relation, share in found.items()}


def _shares(
    measured: Responses, expected: Expected | OpenLoop, kind: str, channels: np.ndarray
) -> dict[str, np.ndarray]:
    """The same of n wirings of one kind, side by side: channels (n, a, a) of the kind from the
    axes; (n, a), or (1, a) of a relation that the kind has no part in.
    """
    back = channels.swapaxes(1, 2)[:, None]
    excited = back @ measured.mix if kind == "e" else measured.mix[None, None]
    true = {of: back @ row if of == kind else row[None] for of, row in measured.values.items()}
    noise = {
        of: row @ np.abs(channels) if of == kind else row[None]
        for of, row in measured.noise.items()
    }
    return expected.shares(true, excited, noise)


def _share(measured: np.ndarray, model: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(n, a) of responses (n, w, a, r), with noise (n, w, a); n may be 1 where it is of none."""
    doubt = noise.sum(axis=1)
    left = _power(measured - model) - doubt
    size = _power(measured)
    largest = size.max(axis=1, initial=0.0, keepdims=True)
    size = np.maximum(np.maximum(size - doubt, doubt), 1e-3 * largest)
    return np.asarray(np.maximum(left, 0.0) / np.maximum(size, 1e-300))


def _power(values: np.ndarray) -> np.ndarray:
    """The sum of squares (n, a) over lines and excitations, of (n, w, a, r)."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=(1, 3)))


def score(unexplained: Mapping[str, float]) -> float:
    """The smaller, the better a wiring explains everything: the sum of the logarithms of its
    shares.
    """
    return float(sum(np.log(max(share, _FLOOR)) for share in unexplained.values()))


def wirings(kinds: Sequence[str], count: int) -> Iterator[Wiring]:
    """Every way in which the channels of one kind can be mixed up; beyond four axes one swap or any
    one or all signs.
    """
    for kind in kinds:
        if count <= _ALL_UP_TO:
            for order in permutations(range(count)):
                for signs in product((1, -1), repeat=count):
                    if order != tuple(range(count)) or min(signs) < 0:
                        yield Wiring(kind, order, signs)
        else:
            yield from _simple(kind, count)


def _simple(kind: str, count: int) -> Iterator[Wiring]:
    same = tuple(range(count))
    yield Wiring(kind, same, (-1,) * count)
    for i in range(count):
        yield Wiring(kind, same, tuple(-1 if j == i else 1 for j in range(count)))
    for i, j in combinations(range(count), 2):
        order = list(same)
        order[i], order[j] = j, i
        for one, other in product((1, -1), repeat=2):
            yield Wiring(
                kind, tuple(order), tuple(one if n == i else other if n == j else 1 for n in same)
            )


def ranked(
    measured: Responses, expected: Expected | OpenLoop, kinds: Sequence[str]
) -> list[tuple[float, Wiring, dict[str, float]]]:
    """All wirings, the record as labelled among them, by rising score plus a little for every
    changed channel.
    """
    a = len(measured.mix)
    rows = []
    for kind in ("", *kinds):
        chosen = list(wirings([kind], a)) if kind else [Wiring()]
        found = _shares(measured, expected, kind, np.array([one.matrix(kind, a) for one in chosen]))
        means = {relation: np.mean(share, axis=1) for relation, share in found.items()}
        for i, wiring in enumerate(chosen):
            unexplained = {of: float(mean[i if len(mean) > 1 else 0]) for of, mean in means.items()}
            rows.append((score(unexplained) + 0.05 * wiring.changes, wiring, unexplained))
    return sorted(rows, key=lambda row: row[0])


_RATES = (0.1, 0.2, 0.25, 0.4, 0.5, 2.0, 2.5, 4.0, 5.0, 10.0)  # true over stated
# share of power from which other explanations are tried
_SUSPECT = {"y": 0.25, "u": 0.25, "K": 0.02, "i": 0.05}
_BETTER = 1.0  # by how much a score must fall: a factor e in what is left unexplained
_CLEARLY = 3.0  # and the worst of its relations by this factor
_COARSE = 1.5  # times what the steps of a coarse converter make of the controller's residual
# findings after which the loop is not the one that is modelled
_OF_LAW = (Code.OTHER_CONTROLLER, Code.CONTROLLER_GAIN, Code.OTHER_DELAY, Code.CHANNEL_SKEW)
_MODES = (1, 6)  # bending modes per plane that are tried beside the number asked for; assumed
_JUMP = 4.0  # times what motion and noise make; noise alone stays within 1.3
# of the power of the displacements at a line: how far a tenth of K_i or K_s may move it
_TELLS = 0.1
_SOME = 100  # samples, fewer tell no usual step
_NEAR = 15  # lines over which a noise is alike
_BESIDE = 1.5  # neighbouring lines of a Hann window that err together
_LIKELIER = 12.0  # of a logarithm of likelihoods
# residual of the controller that is no matter, and that of another controller
_MINOR, _OTHER = 0.02, 0.2
_SAME = 0.005  # of u: what another law may make of it; half a percent of gain, one of a stiffness


def diagnose_records(
    machine: Machine,
    records: Record | Sequence[Record],
    controller: LawLike | None,
    *,
    start: Mapping[str, float] | None = None,
    bending_modes: int = 3,
    computing_delay: float = 1,
    excited: str = "ef",
    doubts: Mapping[str, float] = DOUBTS,
) -> tuple[Finding, ...]:
    """What is wrong or doubtful about these records, errors first; () where nothing is. Arguments
    as ``identify``.

    Looks for: no excitation of the kinds ``excited`` ("": none is needed); dead, clipped,
    saturated, held, repeated and missing samples; swapped and inverted channels; a wrong sample
    rate; a record given twice; another controller, delay or channel skew; an excitation that the
    machine does not follow, or not of the size or the time at which it does, with the model as far
    off as ``doubts`` says (relative, by quantity, or "seal"). controller: None where it is not
    known, and then signals by themselves alone. Records that do not belong together or to the
    machine are left to ``identify``, which refuses them.
    """
    records = as_several(records)
    findings = [
        finding
        for n, record in enumerate(records, 1)
        for finding in signal_findings(machine, record, n, excited)
    ]
    findings += _twice(records)
    broken = any(finding.severity == ERROR for finding in findings)
    alike = (
        len({(record.machine, record.sample_rate_hz) for record in records}) == 1
        and records[0].machine == machine.name
    )
    if (
        alike
        and controller is not None
        and not any(finding.code in {Code.NO_EXCITATION, Code.DEAD_CHANNEL} for finding in findings)
    ):
        delay = round(computing_delay)
        for chosen in _by_point(records):
            begin = _start_at(machine, records, records[chosen[0]], start or {})
            own = [records[n] for n in chosen]
            try:
                plant = plant_at(machine, own[0].point, begin, bending_modes)
                law = deployed_controller(plant, controller, own[0].dt, 0)
            except AmbroseError:  # which identify() explains with all it knows
                continue
            measured = measured_responses(own, plant.axes)
            loop = _loop_at(plant, controller, own[0].dt, delay)
            rates = _RATES if law_of(controller).sample_time is None else ()
            mixed = (
                [] if measured is None else _wiring_findings(plant, measured, own[0], loop, rates)
            )
            findings += [finding for finding in mixed if finding.severity == ERROR or not broken]
            if broken or any(finding.severity == ERROR for finding in mixed):
                continue
            of_law = [
                finding
                for n, record in zip(chosen, own, strict=True)
                for finding in _controller_findings(machine, record, n + 1, law, delay, measured)
            ]
            findings += of_law
            if measured is None or any(finding.code in _OF_LAW for finding in of_law):
                continue

            # the loop under the controller that ran, with other numbers of bending modes beside
            loaded, first = machine_at_load(machine, own), own[0].point
            given, *others = (
                plant_at(loaded, first, begin, count)
                for count in dict.fromkeys((bending_modes, *_MODES))
            )
            findings += excitation_findings(given, delayed(law, delay), own, doubts, others)
    return tuple(sorted(findings, key=lambda finding: finding.severity != ERROR))


def screened(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike | None,
    *,
    settled: Collection[Code] = (),
    **how: Any,
) -> tuple[Finding, ...]:
    """The warnings of ``diagnose_records``, for what computes from records with the controller's
    file; settled: codes that the caller decides on. A signal that is at its limit in a few samples
    is none. Raises InvalidInput with every error.
    """
    found = [
        finding
        for finding in diagnose_records(machine, records, controller, **how)
        if finding.code not in settled
    ]
    refuse(found)
    return tuple(finding for finding in found if finding.code != Code.SATURATED)


def _twice(records: Sequence[Record]) -> Iterator[Finding]:
    """Records that hold the same samples: they add nothing, and make every interval too narrow."""
    for n, record in enumerate(records):
        for other in range(n):
            if record.signals == records[other].signals and np.array_equal(
                record.values, records[other].values
            ):
                what = f"record {n + 1} is record {other + 1} once more"
                evidence = f"all {record.values.size} numbers are the same"
                remedy = "give every record once; repeats are measured anew"
                yield Finding(Code.DUPLICATE_RECORD, ERROR, what, evidence, remedy)


def _by_point(records: Sequence[Record]) -> list[list[int]]:
    """The numbers of the records at each operating point, from 0."""
    points = [replace(record.point, label="") for record in records]
    return [
        [n for n, other in enumerate(points) if other == point]
        for i, point in enumerate(points)
        if point not in points[:i]
    ]


def _start_at(
    machine: Machine, records: Sequence[Record], record: Record, start: Mapping[str, float]
) -> dict[str, float]:
    """The start values, which hold at the highest pressure of all records, at that of one of
    them.
    """
    if not start:
        return {}
    reference = max((other.point for other in records), key=lambda point: abs(point.seal_pressure))
    factors = ratios(assemble(machine, reference), assemble(machine, record.point), tuple(start))
    return {
        path: value * factor
        for (path, value), factor in zip(start.items(), factors.tolist(), strict=True)
    }


def _loop_at(
    plant: Plant, controller: LawLike, dt: float, delay: int
) -> Callable[[np.ndarray, float], Expected]:
    """The responses of the loop at omega (w,) [rad/s], sampled so many times as fast as stated."""

    def expected(omega: np.ndarray, factor: float) -> Expected:
        law = deployed_controller(plant, controller, dt / factor, delay)
        return expected_responses(plant, law, omega * factor)

    return expected


def machine_findings(machine: Machine, record: Record) -> Iterator[Finding]:
    """What shows without the controller that ran that this is no record of this machine: its name,
    its operating point, currents that no amplifier gives; no trace of the excitation; channels or a
    sample rate with which the plant answers its commands otherwise.
    """
    try:
        operating_points(machine, [record])
    except InvalidInput as refusal:
        remedy = "give the machine's own record, or the file of the machine that was recorded"
        yield Finding(Code.OTHER_MACHINE, ERROR, str(refusal), "", remedy)
        return
    try:
        plant = plant_at(machine, record.point, {})
    except AmbroseError as refusal:
        yield Finding(Code.OPERATING_POINT, ERROR, str(refusal))
        return
    yield from _torn(record, plant.axes)
    measured = measured_responses([record], plant.axes)
    if measured is None:
        yield from _no_responses(record)
    if measured is None or "y" not in measured.values:
        return
    if not {"u", "i"} & set(measured.values):
        yield from _no_trace(measured) or _deaf(measured, plant.axes)
        return

    def expected(omega: np.ndarray, factor: float) -> OpenLoop:
        return open_loop_responses(plant, record.dt / factor, omega * factor)

    measured = _kept(
        measured, _telling(machine, plant, measured, expected(measured.omega, 1.0), record.dt)
    )
    if not len(measured.omega):
        return
    found = _wiring_findings(plant, measured, record, expected, _RATES)
    yield from found or _deaf(measured, plant.axes)
    if not found:
        yield from _odd_axes(measured, expected(measured.omega, 1.0), plant.axes)


def _telling(
    machine: Machine, plant: Plant, measured: Responses, expected: OpenLoop, dt: float
) -> np.ndarray:
    """The lines (w,) at which the answer does not hang on what no file knows to a tenth: near a
    pole of the free plant, as of precession, a little stiffness is many times the answer.
    """
    moved = np.zeros(len(measured.omega))
    command = expected.command(measured.values, measured.mix)
    for quantity in ("force_per_current", "negative_stiffness"):
        paths = [path for path in machine.magnet_paths if quantity in path]
        begin = dict(zip(paths, (1.1 * nominal_values(plant, paths)).tolist(), strict=True))
        other = plant_at(machine, plant.point, begin)
        G = open_loop_responses(other, dt, measured.omega).G
        moved += np.sum(np.abs((G - expected.G) @ command) ** 2, axis=(1, 2))
    both = (measured.values["y"], expected.G @ command)
    size = np.max([np.sum(np.abs(part) ** 2, axis=(1, 2)) for part in both], axis=0)
    return np.asarray(moved <= _TELLS * size)


def _torn(record: Record, axes: Sequence[str]) -> Iterator[Finding]:
    """A sample at which several displacements jump at once, as no mass does: samples were lost."""
    names = [f"y_{axis}" for axis in axes if f"y_{axis}" in record.signals]
    if len(names) < 2 or record.values.shape[1] < _SOME:
        return
    steps = np.abs(np.diff([record[name] for name in names], axis=1))
    # far above what noise and motion make, and alone: a lift-off has large steps before and after
    usual = np.quantile(steps, 0.999, axis=1, keepdims=True)
    alone = np.maximum(np.roll(steps, 2, axis=1), np.roll(steps, -2, axis=1))
    jumps = (steps > _JUMP * usual) & (steps > _JUMP * alone)
    places = np.flatnonzero(np.count_nonzero(jumps, axis=0) >= 2) + 1
    if len(places):
        times = ", ".join(f"{record.time[at]:.5g} s" for at in places[:5])
        evidence = f"at t = {times} several displacements jump at once, which no mass does"
        remedy = "find the gap in the logger, and use the stretches between as records of their own"
        what = "samples are missing or inserted"
        yield Finding(Code.LOST_SAMPLES, WARNING, what, evidence, remedy)


def _no_responses(record: Record) -> Iterator[Finding]:
    """An excited record whose rate leaves half a second too few samples to tell anything."""
    driven = [name for name in record.signals if name[:2] == "e_" and np.ptp(record[name]) > 0]
    few = record.sample_rate_hz / 2 < SEGMENT
    if driven and few:
        what = f"at {record.sample_rate_hz:g} Hz its channels cannot be checked"
        evidence = f"half a second has fewer than {SEGMENT} samples"
        remedy = "correct sample_rate_hz (its unit), or record all samples"
        yield Finding(Code.SAMPLE_RATE, WARNING, what, evidence, remedy)


def _deaf(measured: Responses, axes: Sequence[str]) -> list[Finding]:
    """Displacements without a trace of the excitation of their own axis, beside others with one."""
    if "y" not in measured.coherence:
        return []
    traces = np.quantile(measured.coherence["y"], 0.98, axis=1)
    own = measured.mix.any(axis=1)
    deaf = [f"y_{axes[j]}" for j in np.flatnonzero((traces < measured.chance) & own).tolist()]
    if not deaf:
        return []
    what = f"no trace of the excitation of its own axis in {', '.join(deaf)}"
    evidence = "other displacements follow theirs"
    remedy = "check sensor, cable and channel, or whether its amplifier got the excitation"
    return [Finding(Code.NO_RESPONSE, WARNING, what, evidence, remedy)]


def _odd_axes(measured: Responses, expected: OpenLoop, axes: Sequence[str]) -> Iterator[Finding]:
    """Axes that answer otherwise than the model, where the mean over all axes does not."""
    for relation, share in shares_by_axis(measured, expected, Wiring()).items():
        odd = [f"{relation}_{axes[j]}" for j in np.flatnonzero(share > _SUSPECT[relation]).tolist()]
        if odd:
            what = f"another response than the model's in {', '.join(odd)}"
            evidence = f"of its power {_percent(float(share.max()))} is unexplained"
            remedy = "check its scale, its time and its cable, or that axis of the machine file"
            yield Finding(Code.FAR_FROM_START, WARNING, what, evidence, remedy)


def _wiring_findings(
    plant: Plant,
    measured: Responses,
    record: Record,
    expected_at: Callable[[np.ndarray, float], Expected | OpenLoop],
    rates: Sequence[float],
) -> list[Finding]:
    """Mixed-up channels, or another sample rate, or a response that is no response at all.

    expected_at: the responses at omega (w,) [rad/s], if the record was sampled so many times as
    fast as it says; rates: these factors.
    """
    untouched = _no_trace(measured)
    if untouched:
        return untouched
    now = shares(measured, expected_at(measured.omega, 1.0), Wiring())
    if all(share <= _SUSPECT[relation] for relation, share in now.items()):
        return []
    kinds = [kind for kind in KINDS if kind == "e" or kind in measured.values]
    few = _thinned(measured, 60)
    expected = expected_at(few.omega, 1.0)
    now = shares(few, expected, Wiring())
    rows = ranked(few, expected, kinds)
    best, here = rows[0], score(now)
    tried = [(f, shares(few, expected_at(few.omega, f), Wiring())) for f in rates]
    rate = min(tried, key=lambda row: score(row[1]), default=None)
    if rate is not None and score(rate[1]) < min(best[0], here - _BETTER) and _clear(now, rate[1]):
        stated, true = record.sample_rate_hz, rate[0] * record.sample_rate_hz
        what = (
            f"the records were not sampled at {stated:g} Hz, as they say, but at about {true:g} Hz"
        )
        evidence = (
            "left unexplained of the power: "
            f"{_compared(now, rate[1], 'as stated', f'at {true:g} Hz')}"
        )
        remedy = (
            "correct sample_rate_hz; a record that leaves samples out does not show the "
            "controller's own rate: record all"
        )
        return [Finding(Code.SAMPLE_RATE, ERROR, what, evidence, f"{remedy} of them")]
    if best[1].kind and best[0] < here - _BETTER and _clear(now, best[2]):
        return [_mixed_finding(plant.axes, rows, now)]
    return _unexplained(now)


def _thinned(measured: Responses, lines: int) -> Responses:
    """The strongest lines: where the displacements respond most."""
    strength = np.sum(
        np.abs(measured.values["y" if "y" in measured.values else "u"]) ** 2, axis=(1, 2)
    )
    return _kept(measured, np.sort(np.argsort(strength)[::-1][:lines]))


def _kept(measured: Responses, kept: np.ndarray) -> Responses:
    """Some of the lines, by their numbers or as flags (w,)."""
    values, noise = (
        {kind: of[kind][kept] for kind in of} for of in (measured.values, measured.noise)
    )
    return replace(measured, omega=measured.omega[kept], values=values, noise=noise)


def _clear(now: Mapping[str, float], then: Mapping[str, float]) -> bool:
    """Whether the worst relation of the record as labelled gets clearly better, and none that holds
    is lost.
    """
    worst = max(now, key=lambda relation: now[relation] / _SUSPECT[relation])
    kept = all(
        then[relation] <= max(2 * share, _SUSPECT[relation]) for relation, share in now.items()
    )
    return then[worst] * _CLEARLY < now[worst] and kept


def _mixed_finding(
    axes: Sequence[str],
    rows: Sequence[tuple[float, Wiring, dict[str, float]]],
    now: Mapping[str, float],
) -> Finding:
    best = rows[0]
    alike = [
        row[1]
        for row in rows[1:]
        if row[1].kind and row[0] < best[0] + 0.3 and row[1].changes <= best[1].changes
    ]
    other = (
        f" (or, equally well: {' / '.join(wiring.words(axes) for wiring in alike[:3])})"
        if alike
        else ""
    )
    return Finding(
        Code.MIXED_CHANNELS,
        ERROR,
        f"channels are mixed up: {best[1].words(axes)}{other}",
        f"left unexplained of the power: {_compared(now, best[2], 'as labelled', 'so corrected')}",
        f"correct the names or signs of the {KINDS[best[1].kind]} channels (ambrose convert "
        "--columns), and check the cables",
    )


_RELATIONS = {
    "y": "displacements against the model",
    "u": "controller outputs against the model",
    "K": "u = K(-y)",
    "i": "coil currents against the amplifier",
}


def _compared(now: Mapping[str, float], then: Mapping[str, float], one: str, other: str) -> str:
    return ", ".join(
        f"{_RELATIONS[name]} {_percent(share)} {one}, {_percent(then[name])} {other}"
        for name, share in now.items()
        if abs(share - then[name]) > 0.1 * max(share, then[name])
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def _no_trace(measured: Responses) -> list[Finding]:
    coherence = (
        float(np.quantile(measured.coherence["y"], 0.98)) if "y" in measured.coherence else 1.0
    )
    if coherence >= measured.chance:
        return []
    what = "the displacements contain no trace of the excitation"
    evidence = (
        f"their coherence with it stays below {coherence:.2f}, and {measured.chance:.2f} would be "
        "chance"
    )
    remedy = "check that the recorded excitation reaches the amplifiers, or excite more"
    return [Finding(Code.NO_RESPONSE, ERROR, what, evidence, remedy)]


def _unexplained(now: Mapping[str, float]) -> list[Finding]:
    share = now.get("y", 0.0)
    if share <= _SUSPECT["y"]:
        return []
    what = (
        "the machine as it is described, with the start values, responds otherwise than the record"
    )
    evidence = f"it leaves {_percent(share)} of the displacements' power unexplained"
    remedy = (
        "usual where unknown parameters are far from their start; else it is another machine, "
        "point or controller"
    )
    return [Finding(Code.FAR_FROM_START, WARNING, what, evidence, remedy)]


def _following(record: Record, match: ControllerMatch) -> float | None:
    """The part of the residual that follows the excitation, over the part of u that does: noise
    between the controller and the recorder has none. None where the record allows no such estimate.
    """
    responses = compared_responses(
        record, [f"u_{axis}" for axis in match.axes], match.left, match.axes
    )
    if responses is None:
        return _turning(record, match)
    rest = responses[1]
    size, doubt = (np.sum(np.abs(one.values["u"]) ** 2, axis=2) for one in responses)
    # smoothed, or the lines that stand out would be those that noise itself makes stand out
    noise, level = np.maximum(_smoothed(rest.noise["u"]), 1e-300), _smoothed(size)
    found = np.zeros(len(match.axes))
    for i in range(len(match.axes)):
        # the lines where noise matters least, each by its own noise: the mean of doubt/noise is 1
        # where nothing follows, and its scatter tells by how much more it may be by chance
        clear = np.argsort(level[:, i] / noise[:, i])[-max(len(size) // 4, 1) :]
        ratio = doubt[clear, i] / noise[clear, i]
        chance = 3 * float(np.std(ratio)) * np.sqrt(_BESIDE / len(clear))
        if ratio.mean() - 1 > chance:
            found[i] = np.sqrt(np.sum(ratio - 1) / np.sum(size[clear, i] / noise[clear, i]))
    return float(found.max())


def _smoothed(lines: np.ndarray) -> np.ndarray:
    """The means (w, a) over ``_NEAR`` neighbouring lines, fewer at both ends."""
    window = np.ones(min(_NEAR, len(lines)))
    count = np.convolve(np.ones(len(lines)), window, "same")
    return np.array([np.convolve(row, window, "same") / count for row in lines.T]).T


def _turning(record: Record, match: ControllerMatch) -> float | None:
    """The same of what turns with the rotor, in a record without excitation; None at rest."""
    speed = abs(record.point.speed)
    if not speed:
        return None
    turns = Step(speed, record.start_time, float(record.time[-1] + record.dt))
    names = tuple(f"u_{axis}" for axis in match.axes)
    u = record.select(names)
    try:
        whole, rest = (
            phasors(item, turns, names, 0.0).blocks for item in (u, replace(u, values=match.left))
        )
    except InvalidInput:  # fewer than three turns
        return None

    # noise of one block has nothing to do with that of the next
    size, excess = (np.abs(np.sum(one[1:] * one[:-1].conj(), axis=0)) for one in (whole, rest))
    return float(np.sqrt((excess / np.maximum(size, 1e-300)).max()))


def _late_turning(record: Record, law: StateSpace, delay: int, where: str) -> list[Finding]:
    """Another delay than assumed, by what turns with the rotor: u = -K y, so many samples later."""
    speed = abs(record.point.speed)
    axes = [name.removeprefix("u_") for name in law.outputs]
    turns = Step(speed or 1.0, record.start_time, float(record.time[-1] + record.dt))
    try:
        found = phasors(record, turns, [f"{kind}_{axis}" for kind in "yu" for axis in axes], 0.0)
    except InvalidInput:
        return []
    y, u = found.blocks[:, : len(axes)], found.blocks[:, len(axes) :]
    K = frequency_response(law, np.array([turns.frequency])).values[0]
    lags = np.arange(LAGS + 1)
    turned = np.exp(-1j * turns.frequency * lags * record.dt)

    # the mean of the blocks' differences over its standard deviation, squared, of all axes
    left = u + turned[:, None, None] * (y @ K.T)
    mean = left.mean(axis=1)
    variance = np.sum(np.abs(left - mean[:, None]) ** 2, axis=1) / max(len(u) * (len(u) - 1), 1)
    off = np.sum(np.abs(mean) ** 2 / np.maximum(variance, 1e-300), axis=1)
    best = int(np.argmin(off))
    if not speed or best == delay or off[delay] - off[best] < _LIKELIER:
        return []
    return [_other_delay(where, best, delay, "so does what turns with the rotor in it")]


def _controller_findings(
    machine: Machine,
    record: Record,
    number: int,
    law: StateSpace,
    delay: int,
    measured: Responses | None,
) -> list[Finding]:
    match = controller_match(machine, record, law)
    if match is None:
        return []
    where = f"record {number}"
    jumps = _jump_findings(record, match, where)
    worst = int(np.argmax(match.least))
    if jumps:
        return [*jumps, *_size(match, where), *_timing(match, delay, where)]
    size = _size(match, where)
    if match.least[worst] <= _MINOR:
        findings = size + _timing(match, delay, where)
        return findings or _another_law(record, match, where)
    if (match.least <= _MINOR + _COARSE * resolution_residual(machine, record, law)).all():
        return size or _another_law(record, match, where)

    # noise between the controller and the recorder follows no excitation
    following = _following(record, match)
    if following is not None and following <= _MINOR:
        if not size and (found := _another_law(record, match, where)):
            return found
        if measured is None:
            return _late_turning(record, law, delay, where)
        return _late(measured, law, delay, where)
    if found := _size(match, where):
        return found + _timing(match, delay, where)
    residual = (
        float(match.least[worst])
        if following is None
        else min(float(match.least[worst]), following)
    )
    return [_other_controller(match, where, residual)]


def _another_law(record: Record, match: ControllerMatch, where: str) -> list[Finding]:
    """What is left of u and follows y and u alike, as no noise and no converter's step does."""
    if match.least.max() <= _SAME:
        return []
    residual = float(of_another_law(record, match).max())
    return [_other_controller(match, where, residual)] if residual > _SAME else []


def _other_controller(match: ControllerMatch, where: str, residual: float) -> Finding:
    worst = int(np.argmax(match.least))
    gains = ", ".join(f"{gain:.3g}" for gain in match.gain)
    severity = ERROR if residual > _OTHER else WARNING
    what = f"{where}: the controller that was given is not the one that ran"
    evidence = (
        f"u_{match.axes[worst]} differs from K(-y) by {100 * residual:.2g} % of its size at the "
        "best delay "
        f"({_samples(int(match.lag[worst]))}); recorded over computed: {gains}"
    )
    remedy = (
        "give the controller of this record, and record every sample of it; one percent of gain is "
        "two in the stiffness"
    )
    return Finding(Code.OTHER_CONTROLLER, severity, what, evidence, remedy)


def _samples(count: int) -> str:
    return f"{count} sample{'' if count == 1 else 's'}"


def _jump_findings(record: Record, match: ControllerMatch, where: str) -> list[Finding]:
    """Samples that are missing in all channels, or a disturbed one in a single channel."""
    if not match.jumps:
        return []
    jumps = sorted(at for _, at in match.jumps)
    starts = [at for i, at in enumerate(jumps) if i == 0 or at - jumps[i - 1] > 2 * LAGS]
    places = ", ".join(f"{at} (t = {record.time[at]:.5g} s)" for at in starts[:5])
    more = f" and {len(starts) - 5} more" if len(starts) > 5 else ""
    axes = sorted({axis for axis, _ in match.jumps})
    names = ", ".join(f"y_{match.axes[axis]} or u_{match.axes[axis]}" for axis in axes)
    what = "samples are missing or inserted" if len(axes) > 1 else f"{names} has disturbed samples"
    severity = WARNING if len(starts) <= 5 else ERROR
    evidence = f"u stops following K(-y) at sample {places}{more}"
    remedy = (
        "find the gap in the logger, and identify the stretches between as records of their own"
    )
    return [Finding(Code.LOST_SAMPLES, severity, f"{where}: {what}", evidence, remedy)]


def _timing(match: ControllerMatch, delay: int, where: str) -> list[Finding]:
    """Another delay than assumed, or channels that are recorded at different times."""
    if delay > LAGS:
        return []
    given = match.residual[:, delay]
    late = [
        i
        for i in range(len(match.axes))
        if match.lag[i] != delay and match.least[i] < 0.5 * given[i]
    ]
    if not late:
        return []
    lags = {int(match.lag[i]) for i in late}
    if len(late) == len(match.axes) and len(lags) == 1:
        lag = lags.pop()
        what = f"{where}: the recorded u follows the controller after {_samples(lag)}, not {delay}"
        evidence = (
            f"u differs from K(-y) by {100 * float(given.max()):.2g} % after {delay} and by "
            f"{100 * float(match.least.max()):.2g} % after {_samples(lag)}"
        )
        remedy = (
            f"give --delay-samples {lag}, unless u is recorded before it acts: one is 2 to 5 % of "
            "the stiffness"
        )
        return [Finding(Code.OTHER_DELAY, WARNING, what, evidence, remedy)]
    names = ", ".join(f"{match.axes[i]} ({_samples(int(match.lag[i]))})" for i in late)
    what = f"{where}: channels are not recorded at the same time"
    evidence = (
        f"u follows K(-y) best after other delays than {delay} in {names}: from "
        f"{100 * float(given[late].max()):.2g} % to {100 * float(match.least[late].max()):.2g} %"
    )
    remedy = "shift y or u of these axes by the difference, or record all channels in one scan"
    return [Finding(Code.CHANNEL_SKEW, WARNING, what, evidence, remedy)]


def _late(measured: Responses | None, law: StateSpace, delay: int, where: str) -> list[Finding]:
    """Another delay than assumed, by what follows the excitation: T_u = -K T_y, so many samples
    later, each line by its noise; told where the likelihood is e^12 times larger (five standard
    deviations).
    """
    if measured is None or not {"y", "u"} <= set(measured.values) or delay > LAGS:
        return []
    K = frequency_response(law, measured.omega).values
    expected = -K @ measured.values["y"]

    # variance of T_u + K T_y, at most: noise that goes round the loop is in both and cancels
    noise = measured.noise["u"] + np.einsum("wij,wj->wi", np.abs(K) ** 2, measured.noise["y"])
    lags = np.arange(LAGS + 1)
    turned = np.exp(-1j * measured.omega[:, None] * lags * (law.dt or 0.0))
    left = np.abs(measured.values["u"][:, None] - turned[..., None, None] * expected[:, None]) ** 2
    off = np.sum(left.sum(axis=3) / np.maximum(noise, 1e-300)[:, None], axis=(0, 2)) / _BESIDE
    best = int(np.argmin(off))
    if best == delay or off[delay] - off[best] < _LIKELIER:
        return []
    evidence = "so does what follows the excitation in it, each line by its noise"
    return [_other_delay(where, best, delay, evidence)]


def _other_delay(where: str, best: int, delay: int, evidence: str) -> Finding:
    what = f"{where}: the recorded u follows the controller after {_samples(best)}, not {delay}"
    remedy = f"give --delay-samples {best}, unless u is recorded before it acts"
    return Finding(Code.OTHER_DELAY, WARNING, what, evidence, remedy)


def _size(match: ControllerMatch, where: str) -> list[Finding]:
    """A factor between the recorded and the computed output."""
    off = [
        i
        for i, gain in enumerate(match.gain)
        if abs(gain - 1) > 0.005 and match.scaled[i] < 0.5 * match.least[i]
    ]
    if not off:
        return []
    names = ", ".join(f"u_{match.axes[i]} is {match.gain[i]:.4g} times K(-y)" for i in off)
    severity = ERROR if max(abs(match.gain[i] - 1) for i in off) > _OTHER else WARNING
    what = f"{where}: the controller has another gain than the one given"
    remedy = (
        "correct the gain or the scale of the channels; every percent of it is two in the negative "
        "stiffness"
    )
    return [Finding(Code.CONTROLLER_GAIN, severity, what, names, remedy)]
