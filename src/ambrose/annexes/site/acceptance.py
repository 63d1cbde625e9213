"""Acceptance: the loop as measured on the running machine, with its intervals, held against its
limits and the prediction.

Excitation currents e_<axis> give T_o = S_o G K = M K of the measured M = y/e, with the controller's
K as it runs, which is known exactly; references r_<axis> give T_o = y/r. Then S_o = I - T_o, and L
= 1/S_ii - 1 of every axis with the other loops closed, as in ISO 14839-3. M is free of the bias of
feedback, its error known line by line (identification/frf_spectral.py).

accepted = accept(machine, controller, ["standstill.h5", "running.h5"])

From an analyser's responses S comes as they are (judge/measured.py), with the same checks.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, as_several, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.presentation import Presented
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.identification.data_quality.controller import KNOWN, LoopModel, doubted
from ambrose.identification.data_quality.diagnosis import screened
from ambrose.identification.data_quality.signals import check_point
from ambrose.identification.findings import Finding
from ambrose.identification.frf_spectral import Frf, band_width, local_response
from ambrose.identification.output_error.problem import check_machine
from ambrose.identification.responses import as_responses
from ambrose.identification.validation.places import machine_at_load
from ambrose.judge.checks import Check, Checks, holds, information, judge
from ambrose.judge.measured import refuse_misread, sensitivity_of
from ambrose.law.law import LawLike
from ambrose.law.loop import Timing, check_clock, closed_loop, running_law, timing_of
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR, TWO_PI, Demand, demand
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import check_source
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant, top_speed
from ambrose.record.files import read_record
from ambrose.record.record import Record
from ambrose.record.response import Measured, Response, digest_of, usable

# Which lines of a measured loop tell anything of a limit, and where to excite for the others.
#
# Where the excitation has no power, or the noise is as large as what is sought, a response comes
# out as anything: such a line speaks neither for the loop nor against it. The sensitivity of no
# loop at all is 1. Of the way from there to the limit a third is left to the loop itself, one to
# the noise in the value and one to its half-width; where noise takes more, a good loop would fail.


_PART = 1 / 3  # of the way from 1, no loop, to the limit: for loop, noise and half-width each
# half-widths that noise alone reaches once in half a million lines, of 20 degrees of freedom:
# (1 + (3 t)^2 / 40)^-20 with t = 2.02
_STANDS_OUT = 3.0
_NO_LIMIT = 3.0  # sensitivity that is asked about where none is a limit: zone A of ISO 14839-3
_ENOUGH = 0.95  # of the band, that has to tell; assumed
_NEAR_PEAK = 0.9  # of the predicted peak, where a line has to tell; assumed
_MOST = 3  # bands that are named


def _part(limit: float | None) -> float:
    return _PART * ((_NO_LIMIT if limit is None else limit) - 1)


def telling(
    value: np.ndarray, noise: np.ndarray, limit: float | None, lift: float | np.ndarray = 0.0
) -> np.ndarray:
    """Whether every value (w,) of a sensitivity with that 95 % half-width of noise tells on which
    side of ``limit`` it is (None: of zone A's), or stands out of its noise. lift (w,): what noise
    alone makes of the value where that is more.
    """
    allowed = _part(limit)
    alone = np.maximum(noise, lift)
    return np.asarray((noise <= allowed) | (value > _STANDS_OUT * alone))


def share(omega: np.ndarray, told: np.ndarray) -> float:
    """Of the band that the lines omega (w,) span, the part around those that tell."""
    width = np.gradient(omega) if len(omega) > 1 else np.ones(1)
    return float(width[told].sum() / width.sum())


def silent_bands(omega: np.ndarray, told: np.ndarray) -> list[tuple[float, float]]:
    """First and last of every run of lines that tell nothing [rad/s], the widest first."""
    edge = np.diff(np.r_[0, ~told, 0].astype(int))
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    found = [(float(omega[i]), float(omega[k])) for i, k in zip(first, last, strict=True)]
    return sorted(found, key=lambda ends: ends[0] - ends[1])


def where(omega: np.ndarray, told: np.ndarray) -> str:
    """The bands that tell nothing, in words, as they lie; empty without any."""
    bands = silent_bands(omega, told)
    named = ", ".join(
        f"{low / TWO_PI:.4g} Hz" if low == high else f"{low / TWO_PI:.4g} to {high / TWO_PI:.4g} Hz"
        for low, high in sorted(bands[:_MOST])
    )
    more = f" and {len(bands) - _MOST} more" if len(bands) > _MOST else ""
    return f"{named}{more}"


def judged_reach(
    names: Sequence[str],
    omega: np.ndarray,
    told: np.ndarray,
    predicted: np.ndarray,
    limits: Sequence[float | None],
) -> Check:
    """Whether the lines that tell, told (w, n), are enough of the band and about those peaks of
    predicted (w, n) that take more of the way to their limit than is the loop's, where a gap would
    hide what is asked for.
    """
    parts = np.array([share(omega, column) for column in told.T])
    title = "Share of the band with usable lines, worst axis"
    wanted = Demand(_ENOUGH, ">=", "")
    if told.all():
        return judge("sensitivity.told", title, 1.0, "-", wanted, "every line")
    high = np.array([1 + _part(limit) for limit in limits])
    hidden = ~told & (predicted >= np.maximum(_NEAR_PEAK * predicted.max(axis=0), high))
    at_peak = [
        f"the predicted peak of {name} at {omega[predicted[:, i].argmax()] / TWO_PI:.4g} Hz is "
        "not measured"
        for i, name in enumerate(names)
        if hidden[:, i].any()
    ]
    low = f"{names[int(parts.argmin())]}: " if parts.min() < parts.max() else ""
    detail = "; ".join(
        [
            f"{low}excite there: {where(omega, told[:, int(parts.argmin())])}, where noise hides "
            "it; a binary sequence has no power at 1 over its bit time",
            *at_peak[:_MOST],
        ]
    )
    value = float(parts.min())
    check = judge("sensitivity.told", title, value, "-", wanted, detail)
    return replace(check, passed=False) if at_peak else check


# What lines resolve of a closed loop: its predicted resonances, how wide each is, and what rises
# between two lines.
#
# A pole s of the loop makes a resonance at Im s that is -2 Re s wide at half its power. A
# polynomial of second order over a band B about it errs by 3/35 (B/width)^4 of its height: of x^4,
# the first power that it lacks at the centre, x from -1 to 1 over the band.


_SHARP = 0.3  # damping ratio below which a pole makes a peak
_HIGH = 0.5  # of the largest predicted sensitivity, below which a resonance decides nothing
_OUT = 0.05  # by which a resonance stands out of what is beside it
_OFF = 0.02  # of its frequency, by which the true resonance may lie elsewhere; assumed
_PER_WIDTH, _MOST_LINES = 4, 40  # lines over the width of a resonance, and in all for one
_POINTS = 6  # of the prediction between two lines


@dataclass(frozen=True, slots=True)
class Resonance:
    """frequency and width at half power [rad/s]."""

    frequency: float
    width: float

    @property
    def reach(self) -> float:
        """How far from its frequency [rad/s] it shows, also where it lies a little elsewhere."""
        return max(2 * self.width, _OFF * self.frequency)

    @property
    def band(self) -> tuple[float, float, float]:
        """Between which frequencies it shows, and the widest band that follows it [rad/s]: over its
        own width a polynomial errs by 3/35 of its height, over more of it by the fourth power.
        """
        return self.frequency - self.reach, self.frequency + self.reach, self.width

    def lines(self) -> list[float]:
        """Frequencies [rad/s] that show it."""
        reach = self.reach
        count = min(int(2 * reach * _PER_WIDTH / self.width) + 1, _MOST_LINES)
        return [float(w) for w in self.frequency + np.linspace(-reach, reach, count) if w > 0]


def predicted_resonances(plant: Plant, law: StateSpace, highest: float) -> list[Resonance]:
    """Those up to ``highest`` [rad/s] that may make the largest sensitivity of the sampled loop."""
    z = poles(closed_loop(plant, law))
    s = np.log(z[np.abs(z) > 0]) / (law.dt or 1.0)
    s = s[(s.imag > 0) & (s.imag < highest) & (s.real < 0)]
    s = s[-s.real < _SHARP * np.abs(s)]
    if not len(s):
        return []

    # sigma_max at each resonance and three half-widths beside it, and over the whole range
    at = s.imag[:, None] - 3 * s.real[:, None] * np.array([-1.0, 0.0, 1.0])
    height = _sigma(plant, law, np.clip(at, 1e-3, None).ravel()).reshape(-1, 3)
    largest = max(
        float(height[:, 1].max()), float(_sigma(plant, law, np.geomspace(10, highest, 200)).max())
    )
    told = (height[:, 1] > _HIGH * largest) & (
        height[:, 1] > height[:, [0, 2]].min(axis=1) + _OUT * largest
    )
    return [Resonance(float(p.imag), float(-2 * p.real)) for p in s[told]]


def between(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    """By what factor (w - 1, a + 1) the predicted |S_ii| and sigma_max rise between two lines above
    both ends.
    """
    share = np.arange(1, _POINTS + 1) / (_POINTS + 1)
    inner = omega[:-1, None] + np.diff(omega)[:, None] * share
    ends, inside = (_sizes(plant, law, w) for w in (omega, inner.ravel()))
    top = inside.reshape(len(inner), _POINTS, -1).max(axis=1)
    return np.asarray(np.maximum(top / np.maximum(ends[:-1], ends[1:]), 1.0))


def risen(high: np.ndarray, factor: np.ndarray) -> float:
    """The largest of values (w,) at the lines and, by ``factor`` (w - 1,), between them."""
    inner = np.maximum(high[:-1], high[1:]) * factor
    return float(max(high.max(), inner.max(initial=0.0)))


def _sizes(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    S = _sensitivity(plant, law, omega)
    own = np.abs(np.einsum("wii->wi", S))
    return np.column_stack([own, np.linalg.norm(S, 2, axis=(1, 2))])


def _sigma(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(_sensitivity(plant, law, omega), 2, axis=(1, 2)))


def _sensitivity(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    # S_o = (I + G K)^-1 with G sampled through its hold
    held = c2d(select(plant.system, plant.named("u"), plant.named("y")), law.dt or 1.0)
    G, K = (frequency_response(system, omega).values for system in (held, law))
    return np.asarray(np.linalg.inv(np.eye(len(plant.axes)) + G @ K))


_LATE = 4  # samples of delay that are tried beyond those told; assumed
# another delay is taken for the true one where its misfit is below this share of the told one's;
# assumed
_BETTER = 0.5
_EXACT = 1e-3  # misfit of the told delay, relative, below which no other is asked for; assumed
_SAME_LAW = 0.1  # of the measured response of the controller, by which the file's may differ
# by how much the magnets' curvature may move the plant at the size of the test's motion; assumed
_CURVED = 0.01
_ALL_LINES = 2.3  # half-widths of one line that hold a thousand lines together (Bonferroni)
_DOUBTED = 1.5  # times the half-widths of the file's parameters: 99.7 %
_COMPONENT = 1.43  # half-width of a component, 95 % of 20 degrees of freedom: 2.02/sqrt(2)
_WHOLE = 0.8  # coherence of a line that tells


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLoop:
    """The loop at one operating point.

    omega (w,) [rad/s]; S (w, a, a): output sensitivity; half (w, a): 95 % half-width of |S_ii|;
    sigma, low, high (w,): its maximum singular value and the ends of its interval; predicted:
    (label, S (w, a, a)) by the machine file and, where the records hold currents, with the magnets
    at their static load; coherence (w, a); checks: its verdict; between (w - 1, a + 1): by what
    factor the prediction of every axis, and of sigma, rises between two lines above both; told
    (w, a + 1): the lines of every axis, and of sigma, that the excitation reached, so that they
    tell something of the limit (acceptance.py).
    """

    point: OperatingPoint
    axes: tuple[str, ...]
    omega: np.ndarray
    S: np.ndarray
    half: np.ndarray
    sigma: np.ndarray
    low: np.ndarray
    high: np.ndarray
    predicted: tuple[tuple[str, np.ndarray], ...]
    coherence: np.ndarray
    checks: Checks
    between: np.ndarray
    told: np.ndarray

    @property
    def modulus(self) -> np.ndarray:
        """|S_ii| (w, a)."""
        return np.abs(np.einsum("wii->wi", self.S))

    @property
    def peaks(self) -> list[tuple[float, float]]:
        """Ends of the 95 % interval of the peak of |S_ii| over all lines that tell, of every
        axis; -inf where none does.
        """
        told = self.told[:, :-1]
        low = np.where(told, self.modulus - _ALL_LINES * self.half, -np.inf)
        high = np.where(told, self.modulus + self.half, -np.inf)
        top = [risen(high[:, i], self.between[:, i]) for i in range(len(self.axes))]
        return list(zip(low.max(axis=0).tolist(), top, strict=True))

    @property
    def largest(self) -> float:
        """The largest |S_ii| at a line that tells; nan without any."""
        told = self.told[:, :-1]
        return float(self.modulus[told].max()) if told.any() else float("nan")

    @property
    def loops(self) -> np.ndarray:
        """L_i = 1/S_ii - 1 (w, a), each with the other loops closed."""
        return np.asarray(1 / np.einsum("wii->wi", self.S) - 1)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Acceptance(Presented):
    """What was measured at every operating point; records: the name of each and its SHA-256, of the
    file, or of its samples where it was none.
    """

    machine: Machine
    controller: LawLike
    timing: str
    points: tuple[MeasuredLoop, ...]
    records: tuple[tuple[str, str], ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every limit is met, at the outer end of the intervals."""
        return all(point.checks.passed for point in self.points)

    def facts(self) -> dict[str, Any]:
        """The verdict and the largest measured sensitivity."""
        peaks = {
            loop.point.label or f"{loop.point.speed:.4g} rad/s": loop.largest
            for loop in self.points
        }
        return {
            "machine": self.machine.name,
            "passed": self.passed,
            "sensitivity": [f"{k}: {v:.3g}" for k, v in peaks.items()],
        }

    def to_dict(self) -> dict[str, Any]:
        """Checks and curves at every operating point, ready for JSON."""
        points = [
            {
                **loop.checks.to_dict(),
                "omega": loop.omega.tolist(),
                "axes": list(loop.axes),
                "sensitivity": loop.modulus.T.tolist(),
                "half_width": loop.half.T.tolist(),
                "told": loop.told[:, :-1].T.tolist(),
                "sigma": loop.sigma.tolist(),
                "sigma_95": [loop.low.tolist(), loop.high.tolist()],
                "sigma_told": loop.told[:, -1].tolist(),
            }
            for loop in self.points
        ]
        return {
            "machine": self.machine.name,
            "passed": self.passed,
            "timing": self.timing,
            "records": [{"name": name, "sha256": digest} for name, digest in self.records],
            "points": points,
        }


def accept(
    machine: Machine,
    controller: LawLike,
    records: Measured | Sequence[Measured],
    *,
    harmonics: int = 3,
    delay_samples: int | None = None,
) -> Acceptance:
    """The loop of a machine measured from records with its controller running, one operating point
    or several.

    controller: the one that ran, a Synthesis or anything with A, B, C, D. records: as they are or
    their files, with displacements y_<axis> and excitations e_<axis> [A] or r_<axis> [m] of every
    axis, alike in no two of them; with u_<axis> the controller is checked, too; or frequency
    responses or their files, one for each operating point. harmonics:
    multiples of the speed up to which unbalance and run-out are taken out. delay_samples: of the
    controller (None: as it or the machine file says). Raises InvalidInput.
    """
    several = as_several(records)
    if not several:
        raise InvalidInput(
            "no record was given; record y_<axis> with an excitation e_<axis> or r_<axis> on "
            "every axis"
        )
    names = tuple(_named(item, number) for number, item in enumerate(several, 1))
    if responses := as_responses(several):
        return _accept_responses(machine, controller, responses, delay_samples, names)
    read = [read_record(item) for item in several]
    points: dict[OperatingPoint, list[Record]] = {}
    for number, record in enumerate(read, 1):
        _check(machine, record, number)
        if any(
            record.values.shape == other.values.shape and (record.values == other.values).all()
            for other in read[: number - 1]
        ):
            raise InvalidInput(f"record {number} is the same as one before; give each record once")
        points.setdefault(replace(record.point, label=""), []).append(record)
    timing = timing_of(machine, controller) or Timing(read[0].dt)
    if delay_samples is not None:
        timing = Timing(timing.sample_time, delay_samples)
    for number, record in enumerate(read, 1):
        check_clock(record.dt, timing, f"record {number}")
    findings = screened(
        machine, read, controller, computing_delay=timing.delay_samples, excited="er"
    )
    said = _told(findings)
    measured = tuple(
        _measure(machine, controller, timing, group, harmonics, said) for group in points.values()
    )
    return Acceptance(machine, controller, str(timing), measured, names)


def _accept_responses(
    machine: Machine,
    controller: LawLike,
    responses: Sequence[Response],
    delay_samples: int | None,
    names: tuple[tuple[str, str], ...],
) -> Acceptance:
    """The loop as an analyser measured it."""
    rate = responses[0].sample_rate_hz
    timing = timing_of(machine, controller, rate)
    if timing is None:
        raise InvalidInput(
            "nothing says how often the controller runs; state sample_rate_hz with the responses, "
            "or sample_time in [controller] of the machine file"
        )
    if delay_samples is not None:
        timing = Timing(timing.sample_time, delay_samples)
    points = [replace(response.point, label="") for response in responses]
    for number, (response, point) in enumerate(zip(responses, points, strict=True), 1):
        if response.machine != machine.name:
            remedy = "take that machine's file"
            what = f"the machine of responses {number}"
            raise invalid(what, repr(response.machine), repr(machine.name), remedy)
        if point in points[: number - 1]:
            raise InvalidInput(
                f"responses {number} are of the same operating point as others; give one file for "
                "each point"
            )
    measured = tuple(_of_response(machine, controller, timing, one) for one in responses)
    return Acceptance(machine, controller, str(timing), measured, names)


def _of_response(
    machine: Machine, controller: LawLike, timing: Timing, response: Response
) -> MeasuredLoop:
    """S and its intervals from the variances of the responses; what was not measured between the
    axes, and with it the largest singular value, is NaN and not told.
    """
    axes, point = machine.axes, response.point
    plant = assemble(machine, point)
    law = running_law(controller, plant, timing)
    response = usable(response, axes, timing.sample_time)
    highest = max(
        SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * max(top_speed(machine), point.speed)
    )
    omega = response.omega
    K = frequency_response(law, omega).values
    held = c2d(select(plant.system, plant.named("u"), plant.named("y")), timing.sample_time)

    def modelled(omega: np.ndarray) -> np.ndarray:
        return frequency_response(held, omega).values

    refuse_misread(response, axes, modelled(omega), K)
    s = poles(closed_loop(plant, law))
    s = np.log(s[np.abs(s) > 1e-6].astype(complex)) / timing.sample_time
    modes = s[(s.imag > 0) & (s.real < 0)]
    S, deviation, rise = sensitivity_of(response, axes, law, modes, modelled)

    # lines above the range of the limits tell nothing of them
    kept = omega <= highest
    omega, K, S, deviation = (item[kept] for item in (omega, K, S, deviation))
    noise = _COMPONENT * deviation[:, :-1]
    own = np.abs(np.einsum("wii->wi", S))
    half = np.hypot(noise, _CURVED * own * np.abs(1 - np.einsum("wii->wi", S)))
    whole = bool(np.isfinite(S).all())
    sigma = np.linalg.norm(S, 2, axis=(1, 2)) if whole else np.zeros(len(omega))
    high = sigma + _COMPONENT * np.nan_to_num(deviation[:, -1])

    # between two lines: what the prediction rises, and what the lines themselves may hide
    ends = np.column_stack([own + half, high])
    hidden = rise[: len(omega) - 1] / np.maximum(ends[:-1], ends[1:])
    rises = np.fmax(between(plant, law, omega), hidden)
    limits = [
        demand(words, machine.requirements).limit
        for words in ("sensitivity of an axis", "maximum singular value of a sensitivity")
    ]
    last = telling(sigma, high - sigma, limits[1]) & whole
    told = np.column_stack([telling(own, noise, limits[0]), last])
    stated = sum(path.variance is not None for path in response.paths)
    loop = MeasuredLoop(
        point,
        axes,
        omega,
        S,
        half,
        sigma,
        np.maximum(2 * sigma - high, 0.0),
        high,
        (("predicted", _predicted(plant, K, omega, timing.sample_time)),),
        np.ones((len(omega), len(axes))),
        Checks(point.label or f"{point.speed / TWO_PI:.4g} Hz", True, (), (), ()),
        rises,
        told,
    )
    resonances = predicted_resonances(plant, law, min(highest, float(omega[-1])))
    seen = [item for item in resonances if omega[0] < item.frequency]
    widest, where = max(
        (
            (float(np.interp(r.frequency, omega, np.gradient(omega))) / r.width, r.frequency)
            for r in seen
        ),
        default=(0.0, 0.0),
    )
    title = "Spacing of the lines over the width of a predicted resonance, at most"
    wanted = Demand(1.0, "<=", "")
    detail = "the lines show every one"
    if widest > 1:
        detail = f"sweep closer about {where / TWO_PI:.4g} Hz: its peak may be above all lines"
    checks = (
        *_checks(loop, machine, highest, _allowed(plant, law, omega)),
        judge("sensitivity.resolution", title, widest, "-", wanted, detail),
    )
    notes = (
        f"{len(omega)} lines of {len(response.paths)} responses; noise is stated for {stated}, the "
        "scatter of the lines tells the others. Limits apply to the outer end of the 95 % "
        "interval.",
        "Responses contain no time signal: clipping, the currents beside the controller's and the "
        "delay are not checked; accept from records for these.",
    )
    return replace(loop, checks=replace(loop.checks, checks=checks, notes=notes))


def _told(findings: Sequence[Finding]) -> list[Check]:
    """What the records show of themselves: a failed check for every kind of finding, or one that
    says that there is none.
    """
    none = Demand(0.0, "<=", "")
    if not findings:
        title = "Findings in the records"
        detail = "y, u and e fit the controller file, the loop and each other"
        return [judge("record.findings", title, 0.0, "-", none, detail)]
    codes = dict.fromkeys(finding.code for finding in findings)
    return [
        judge(
            f"record.{code}",
            own[0].what[0].upper() + own[0].what[1:],
            float(len(own)),
            "-",
            none,
            "; ".join(f"{item.evidence}; {item.remedy}" for item in own),
        )
        for code in codes
        if (own := [finding for finding in findings if finding.code == code])
    ]


def _named(item: Measured, number: int) -> tuple[str, str]:
    """The name of a record, or of responses, and its SHA-256."""
    if isinstance(item, Response):
        return digest_of(item, number)
    if not isinstance(item, Record):
        path = check_source(item, "record")
        with path.open("rb") as file:
            return path.name, hashlib.file_digest(file, "sha256").hexdigest()
    digest = hashlib.sha256(repr((item.signals, item.units, item.sample_rate_hz)).encode())
    digest.update(np.ascontiguousarray(item.values).tobytes())
    return f"record {number}", digest.hexdigest()


def _check(machine: Machine, record: Record, number: int) -> None:
    check_machine(machine, record, f"record {number}")
    check_point(machine, record, f"record {number}")
    outcome = dict(record.notes).get("outcome", "")
    if outcome.startswith(("touchdown", "diverged", "not levitated")):
        raise InvalidInput(
            f"in record {number} the rotor did not stay free ({outcome}); excite less and record "
            "again"
        )
    missing = [f"y_{axis}" for axis in machine.axes if f"y_{axis}" not in record.signals]
    if missing:
        raise invalid(
            f"record {number}",
            f"without {', '.join(missing)}",
            "with every displacement",
            "record them together",
        )


def _measure(
    machine: Machine,
    controller: LawLike,
    timing: Timing,
    records: list[Record],
    harmonics: int,
    said: list[Check],
) -> MeasuredLoop:
    from scipy.special import stdtrit

    axes, point = machine.axes, records[0].point
    plant = assemble(machine, point)
    loaded = machine_at_load(machine, records)
    law = running_law(controller, plant, timing)
    kind = _excitation(records, axes)
    a, currents = (
        len(axes),
        all(f"u_{axis}" in record.signals for record in records for axis in axes),
    )

    # the range that limits are judged in: of the standard, or of the highest speed
    highest = max(
        SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * max(top_speed(machine), point.speed)
    )

    # M: y per excitation; with the currents u per excitation below it
    signals = [f"{name}_{axis}" for name in ("y", "u")[: 1 + currents] for axis in axes]
    band = (0.0, min(highest, 0.95 * np.pi / timing.sample_time))
    models = [("predicted", plant)]
    if loaded != machine:
        models.append(("at the static load", assemble(loaded, point)))
    last = models[-1][1]
    resonances = predicted_resonances(last, law, band[1])
    both = local_response(
        records,
        [f"{kind}_{axis}" for axis in axes],
        signals,
        band=band,
        harmonics=harmonics,
        beside=[w for item in resonances for w in item.lines()],
        sharp=[item.band for item in resonances],
    )

    # T_o = M K from excitation currents, M itself from references: S_o = I - M through
    M, omega = both.select(outputs=both.outputs[:a]), both.omega
    K = frequency_response(law, omega).values
    through = K if kind == "e" else np.broadcast_to(np.eye(a), K.shape)
    S = np.eye(a) - M.values @ through
    t = float(stdtrit(2 * M.freedom, 0.975)) / np.sqrt(2)  # of one component of a circular error

    # half-width of S_ii: variance of e_i^T dM through e_i, with that of the curvature
    unit = np.eye(a)
    noise = t * np.sqrt(
        np.array(
            [_spread(M, np.tile(unit[i], (len(omega), 1)), through[:, :, i]) for i in range(a)]
        ).T
    )

    # currents that push (1 + d) times as much, every axis by itself: dS = -(S G) d (K S)
    pushed, driven = M.values if kind == "e" else M.values @ np.linalg.pinv(K), K @ S
    half = np.hypot(noise, _CURVED * np.linalg.norm(pushed * driven.swapaxes(1, 2), axis=2))

    # largest singular value u^H S v: first order d sigma = -Re(u^H dM through v), v = conj(right)
    left, sigma, right = np.linalg.svd(S)
    top = np.einsum("wij,wj->wi", through, right[:, 0].conj())
    first = np.einsum("wi,wij->wj", left[:, :, 0].conj(), pushed)
    last_of = np.einsum("wij,wj->wi", driven, right[:, 0].conj())
    curved = _CURVED * np.linalg.norm(first * last_of, axis=1)
    above = t * np.sqrt(_spread(M, left[:, :, 0], top))

    # the noise lifts the largest singular value, so that the lower end allows for its norm
    lift = _norm_of_error(M, through)

    # the lines that the excitation reached
    own, largest = (
        demand(words, machine.requirements).limit
        for words in ("sensitivity of an axis", "maximum singular value of a sensitivity")
    )
    told = np.column_stack(
        [
            telling(np.abs(np.einsum("wii->wi", S)), noise, own),
            telling(sigma[:, 0], above, largest, lift),
        ]
    )
    above = np.hypot(above, curved)
    low, high = sigma[:, 0] - np.maximum(above, lift), sigma[:, 0] + above

    # the prediction, and beside it the one with the magnets at the load that the currents tell
    predicted = tuple(
        (words, _predicted(item, K, omega, timing.sample_time)) for words, item in models
    )
    label = point.label or f"{point.speed / TWO_PI:.4g} Hz"
    spacing = float(np.diff(omega).min()) / TWO_PI
    notes = (
        f"{len(omega)} lines, {spacing:.3g} Hz apart, each with {M.freedom:.0f} degrees of "
        "freedom. Limits, and the zones of an axis, apply to the outer end of the 95 % interval.",
    )
    loop = MeasuredLoop(
        point,
        axes,
        omega,
        S,
        half,
        sigma[:, 0],
        np.maximum(low, 0.0),
        high,
        predicted,
        M.coherence,
        Checks(label, True, (), (), notes),
        between(last, law, omega),
        told,
    )
    checks = [
        *_checks(loop, machine, highest, _allowed(last, law, omega)),
        _resolution(resonances, omega, records, len(axes)),
    ]
    if currents:
        checks += _law_checks(both, K, kind, timing)
    checks += said
    return replace(loop, checks=replace(loop.checks, checks=tuple(checks)))


def _predicted(plant: Plant, K: np.ndarray, omega: np.ndarray, dt: float) -> np.ndarray:
    """S_o (w, a, a) of the sampled loop, without approximation."""
    # S_o = (I + G K)^-1 with G sampled through its hold
    G = frequency_response(
        c2d(select(plant.system, plant.named("u"), plant.named("y")), dt), omega
    ).values
    return np.linalg.inv(np.eye(K.shape[1]) + G @ K)


def _excitation(records: list[Record], axes: tuple[str, ...]) -> str:
    for kind in "er":
        driven = [
            axis
            for axis in axes
            if any(
                f"{kind}_{axis}" in r.signals and np.ptp(r[f"{kind}_{axis}"]) > 0 for r in records
            )
        ]
        if driven and len(driven) < len(axes):
            missing = ", ".join(f"{kind}_{axis}" for axis in axes if axis not in driven)
            raise invalid(
                "the excitation",
                f"none at {missing}",
                "on every axis",
                "excite it in a separate record, or with the others",
            )
        if driven:
            return kind
    raise InvalidInput(
        "the records have no excitation e_<axis> or r_<axis>; inject one, as the scenario "
        "acceptance does"
    )


def _spread(T: Frf, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Variance (w,) of left^H dT right, left and right (w, a)."""
    noise, share = _together(T)
    out = np.einsum("wi,wij,wj->w", left.conj(), noise, left).real
    return np.asarray(
        np.maximum(out * np.einsum("wi,wij,wj->w", right, share, right.conj()).real, 0.0)
    )


def _law_checks(both: Frf, K: np.ndarray, kind: str, timing: Timing) -> Iterator[Check]:
    """Whether the currents in the records are those of the controller, u = -K y or K (r - y), and
    as late as was told.
    """
    a = K.shape[1]

    # u per excitation: K (I - M) from references, -K M from currents
    y, u = both.values[:, :a], both.values[:, a:]
    expected = K @ ((np.eye(a) if kind == "r" else 0.0) - y)

    # lines whose displacements are coherent; all of them where none are
    told = (both.coherence[:, :a] > _WHOLE).all(axis=1)
    told = told if told.any() else np.ones_like(told)

    # delays from none to _LATE more than told, which sits at the index delay_samples
    late = np.arange(-timing.delay_samples, _LATE + 1)
    turned = np.exp(-1j * both.omega[told, None] * late * timing.sample_time)
    left = np.linalg.norm(
        u[told, None] - turned[..., None, None] * expected[told, None], axis=(2, 3)
    )
    off = np.median(left / np.linalg.norm(u[told], axis=(1, 2))[:, None], axis=0)
    value, best = float(off[timing.delay_samples]), int(np.argmin(off))
    title = "Currents compared with those of the controller file"
    detail = (
        "median over the lines that tell; more: another controller, delay or sample rate ran, or "
        "currents at their limit"
    )
    yield judge("controller.difference", title, value, "-", Demand(_SAME_LAW, "<=", ""), detail)

    # another delay is told where it agrees clearly better and the stated one does not agree already
    other = int(late[best]) if off[best] < _BETTER * value and value > _EXACT else 0
    words = (
        f"with {timing.delay_samples + other} samples instead of {timing.delay_samples} they agree "
        f"to {off[best]:.2g}"
    )
    remedy = (
        "tell it (delay_samples, --delay-samples), and design for it"
        if other
        else "no other delay agrees clearly better"
    )
    title = "Samples of delay compared with those stated"
    yield judge(
        "controller.delay",
        title,
        abs(other),
        "-",
        Demand(0.0, "<=", ""),
        f"{words}: {remedy}" if other else remedy,
    )


def _together(T: Frf) -> tuple[np.ndarray, np.ndarray]:
    if T.noise is None or T.share is None:
        raise InvalidInput(
            "the response does not tell how its errors go together; estimate it with local_response"
        )
    return T.noise, T.share


def _norm_of_error(T: Frf, through: np.ndarray) -> np.ndarray:
    """What the norm (w,) of dT through hardly exceeds (Chevet): singular values that lie close are
    lifted by all of the noise, so that the largest of them is measured too large.
    """
    noise, share = _together(T)

    # E |A N B| <= |A| |B|_F + |A|_F |B| for N of independent unit entries; noise = A A^H, and
    # share behind through = B B^H
    share = np.einsum("wji,wjk,wkl->wil", through, share, through.conj())
    a, b = (np.sqrt(np.maximum(np.linalg.eigvalsh(item), 0.0)) for item in (noise, share))
    return np.asarray(a[:, -1] * np.linalg.norm(b, axis=1) + np.linalg.norm(a, axis=1) * b[:, -1])


def _allowed(plant: Plant, law: StateSpace, omega: np.ndarray) -> np.ndarray:
    """By how much |S_ii| (w, a) may differ from the prediction for what the machine file does not
    know: S = I - T K, the half-widths of the parameters as independent errors.
    """
    loop = LoopModel.of(plant, law, omega, doubted(plant, KNOWN))
    K, slopes = loop.K, loop.at(np.zeros(len(loop.blocks)))[1]
    return np.asarray(np.sqrt(np.sum(np.abs(np.einsum("pwij,wji->pwi", slopes, K)) ** 2, axis=0)))


def _resolution(
    resonances: Sequence[Resonance], omega: np.ndarray, records: Sequence[Record], a: int
) -> Check:
    """The band that is fitted together about a line, over the width of the sharpest resonance."""
    span = sum(record.values.shape[1] * record.dt for record in records)
    band = band_width(a, len(records), span)
    seen = [item for item in resonances if omega[0] < item.frequency < omega[-1]]
    title = "Bandwidth fitted at a line over the width of the sharpest predicted resonance"
    wanted = Demand(1.0, "<=", "")
    if not seen:
        return judge("sensitivity.resolution", title, 0.0, "-", wanted, "none is sharp")
    sharp = min(seen, key=lambda item: item.width)
    detail = (
        f"at {sharp.frequency / TWO_PI:.4g} Hz, {sharp.width / TWO_PI:.3g} Hz wide; band "
        f"{band / TWO_PI:.3g} Hz"
    )
    if band > sharp.width:
        detail += f"; the record is too short: {span * band / sharp.width:.2g} s would do"
    return judge("sensitivity.resolution", title, band / sharp.width, "-", wanted, detail)


def _checks(
    loop: MeasuredLoop, machine: Machine, highest: float, allowed: np.ndarray
) -> list[Check]:
    requirements, found = machine.requirements, []
    file, last = loop.predicted[0][1], loop.predicted[-1]
    own, predicted = loop.modulus, np.abs(np.einsum("wii->wi", file))
    told = loop.told[:, :-1]

    # the lower end holds for all lines together: the peak is the largest of many
    low, high = own - _ALL_LINES * loop.half, own + loop.half
    for i, axis in enumerate(loop.axes):
        wanted = demand("sensitivity of an axis", requirements)
        found.append(
            _peak(
                f"sensitivity.output.{axis}",
                axis,
                loop.omega,
                own[:, i],
                low[:, i],
                high[:, i],
                predicted[:, i],
                loop.between[:, i],
                loop.told[:, i],
                wanted,
            )
        )
    wanted = demand("maximum singular value of a sensitivity", requirements)
    largest = np.linalg.norm(file, 2, axis=(1, 2))
    name, words = "sensitivity.output.max", "maximum singular value"
    if np.isfinite(loop.S).all():
        found.append(
            _peak(
                name,
                words,
                loop.omega,
                loop.sigma,
                loop.low,
                loop.high,
                largest,
                loop.between[:, -1],
                loop.told[:, -1],
                wanted,
            )
        )
    names = [*loop.axes, words][: len(found)]
    both, limits = np.column_stack([predicted, largest]), [check.limit for check in found]
    count = len(names)
    reach = judged_reach(names, loop.omega, loop.told[:, :count], both[:, :count], limits)
    if count == len(loop.axes):
        title, remedy = f"Measured peak sensitivity, {words}", "sweep every axis, record all"
        detail = f"not measured between the axes: {remedy} displacements"
        found.append(judge(name, title, float("nan"), "-", wanted, detail))
    for i, axis in enumerate(loop.axes):
        phase, at = phase_margin(loop.omega, loop.loops[:, i], told[:, i])
        detail = (
            f"at {at / TWO_PI:.4g} Hz"
            if np.isfinite(at)
            else "no crossing of unit gain in the range"
        )
        wanted = demand("phase margin", requirements)
        found.append(
            judge(
                f"margin.phase.output.{axis}",
                f"Measured phase margin, {axis}",
                phase,
                "rad",
                wanted,
                detail,
            )
        )
    found.append(reach)

    # distance from the last prediction, with the magnets at their load where that is known, over
    # what noise on a thousand lines and the doubts of the machine file make of it; of the lines
    # that tell
    off = np.where(told, np.abs(own - np.abs(np.einsum("wii->wi", last[1]))), 0.0)
    doubt = np.hypot(_ALL_LINES * loop.half, _DOUBTED * allowed)
    worst = int(np.argmax((off / doubt).max(axis=1)))
    inside = (
        f"{100 * float((off <= loop.half)[told].mean()) if told.any() else 0:.0f} % of the lines "
        "within 95 % of the measured"
    )
    detail = (
        f"at {loop.omega[worst] / TWO_PI:.4g} Hz, where it is {off[worst].max():.3g}, {last[0]}; "
        f"{inside}; more than 1: another machine, controller or delay than the files', or a wrong "
        "scale of the excitation"
    )
    found.append(
        judge(
            "sensitivity.agreement",
            "Difference from the prediction over its 95 % uncertainty, worst axis",
            float((off / doubt).max()),
            "-",
            Demand(1.0, "<=", ""),
            detail,
        )
    )
    measured = float(loop.omega[-1])
    reach = information(
        "sensitivity.range",
        "Highest frequency measured",
        measured,
        "rad/s",
        f"required: {highest / TWO_PI:.4g} Hz",
    )

    # not measured as high as asked, and still near the peak at the last lines: the peak may
    # lie beyond
    size = np.where(told, own, 0.0)
    edge = size[-max(len(own) // 20, 1) :].max() if measured < 0.95 * highest else 0.0
    rises = bool(edge and edge >= 0.9 * size.max())
    found.append(
        replace(
            reach, relation=">=", limit=highest if rises else None, passed=False if rises else None
        )
    )
    return found


def _peak(
    name: str,
    what: str,
    omega: np.ndarray,
    value: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    predicted: np.ndarray,
    between: np.ndarray,
    told: np.ndarray,
    wanted: Any,
) -> Check:
    """The largest value that was measured at a line that tells; the limit and the zone judge the
    outer end of its interval, and of what the prediction rises between the lines.
    """
    title = f"Measured peak sensitivity, {what}"
    if not told.any():
        words = "no line tells anything; excite more, or record longer"
        return information(name, title, float("nan"), "-", words)
    value, low = np.where(told, value, -np.inf), np.where(told, low, -np.inf)
    high = np.where(told, high, -np.inf)
    k = int(np.argmax(value))
    top, at = risen(high, between), omega[np.argmax(predicted)] / TWO_PI
    beside = (
        f"95 %: {low.max():.3g} to {top:.3g}; predicted peak {predicted.max():.4g} at {at:.4g} Hz"
    )
    if not told.all():
        beside += f"; {100 * share(omega, told):.3g} % of the band measured"
    detail = f"at {omega[k] / TWO_PI:.4g} Hz; {beside}"
    check = judge(name, title, top, "-", wanted, detail)
    met = None if check.limit is None else holds(top, check.relation, check.limit)
    if (
        met is False
        and check.limit is not None
        and holds(float(value[k]), check.relation, check.limit)
    ):
        furthest = omega[np.argmax(high)] / TWO_PI
        words = f"the interval reaches past the limit at {furthest:.4g} Hz"
        remedy = "record longer, or excite more there"
        check = replace(check, detail=f"{check.detail}; {words}: {remedy}")
    return replace(check, value=float(value[k]), passed=met)


def phase_margin(
    omega: np.ndarray, L: np.ndarray, told: np.ndarray | None = None
) -> tuple[float, float]:
    """Smallest angle [rad] between the loop at unit gain and the critical point, and where [rad/s];
    inf, nan without any. told (w,): the lines that are looked at (None: all).
    """
    size = np.log(np.abs(L))

    # crossings of unit gain: log |L| changes its sign; between the lines by a straight line
    # in log |L|
    crossed = size[:-1] * size[1:] <= 0
    i = np.flatnonzero(crossed if told is None else crossed & told[:-1] & told[1:])
    if not len(i):
        return float("inf"), float("nan")
    share = size[i] / (size[i] - size[i + 1])

    # angle of -L, measured from the critical point
    angle = np.abs(np.angle(-(L[i] + share * (L[i + 1] - L[i]))))
    k = int(np.argmin(angle))
    return float(angle[k]), float(omega[i[k]] + share[k] * (omega[i[k] + 1] - omega[i[k]]))
