"""Can what was identified be true? Findings after the fit: signs, sizes, what the model misses,
where it stops to follow.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import AmbroseError, InvalidInput, invalid
from ambrose.identification.data_quality.diagnosis import compared_responses
from ambrose.identification.findings import ERROR, WARNING, Code, Finding
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.closed_loop import (
    LeastSquares,
    ParameterEstimate,
    excitation_names,
)
from ambrose.identification.output_error.normal_equations import (
    Minimum,
    normal_equations,
    synchronised,
)
from ambrose.identification.output_error.problem import (
    Experiment,
    FitOptions,
    build_experiment,
    slowest,
)
from ambrose.identification.output_error.statistics import power_of, residual_scores
from ambrose.identification.parameters import COVERAGE, Estimate, half_width, nominal_values
from ambrose.identification.validation.places import thrust_findings
from ambrose.identification.validation.repeatability import SimulatedOutput
from ambrose.identification.validation.suspects import FILE, equations_at, file_numbers
from ambrose.law.law import LawLike
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, TIMING, parse_parameter
from ambrose.model.assemble import assemble
from ambrose.record.record import Record

# An estimate against what another identification wrote into its machine file: do two methods agree?


@dataclass(frozen=True, slots=True)
class Agreement:
    """A parameter found twice, SI: value with the half-width of its 95 % interval, and the other's
    (0: it states none).
    """

    path: str
    value: float
    half_width: float
    other: float
    other_half_width: float

    @property
    def difference(self) -> float:
        """Of the value from the other [%]; NaN where that is zero."""
        return 100 * (self.value / self.other - 1) if self.other else float("nan")

    @property
    def difference_half_width(self) -> float:
        """By how much the difference may be noise alone [%], 95 %."""
        if not (self.other and self.value):
            return float("nan")
        relative = np.hypot(self.half_width / self.value, self.other_half_width / self.other)
        return float(100 * abs(self.value / self.other) * relative)

    @property
    def agree(self) -> bool:
        """Whether noise alone may make the difference."""
        return bool(abs(self.difference) <= self.difference_half_width)

    def to_dict(self) -> dict[str, float | str | bool | None]:
        """JSON-ready data, SI and percent."""
        return {
            "path": self.path,
            "value": self.value,
            "other": self.other,
            "other_half_width_95": self.other_half_width,
            "difference_percent": self.difference if self.other else None,
            "agree": self.agree,
        }


def compare(result: Estimate, other: Machine) -> tuple[Agreement, ...]:
    """Every estimated parameter, at its operating point, with its value and tolerance in another
    machine file.

    Raises InvalidInput for another machine's file.
    """
    check_comparable(result.machine, other)
    plant = assemble(other, result.point)
    rows = []
    for path, value, deviation in zip(
        result.paths, result.values.tolist(), result.standard_deviations.tolist(), strict=True
    ):
        if path not in TIMING:
            in_plant = float(nominal_values(plant, [path])[0])
            rows.append(
                Agreement(
                    path, value, COVERAGE * deviation, in_plant, _half_width(other, path, in_plant)
                )
            )
    if not rows:
        raise InvalidInput(
            "only delays were identified; a machine file has nothing to compare them with"
        )
    return tuple(rows)


def check_comparable(name: str, other: Machine) -> None:
    """Raises InvalidInput for another machine's file than the one of a name."""
    if other.name != name:
        remedy = "give the file that another method wrote for the same machine"
        raise invalid("the machine to compare with", repr(other.name), repr(name), remedy)


def _half_width(machine: Machine, path: str, value: float) -> float:
    parameter = parse_parameter(path)
    widths = [
        half_width(item, value)
        for item in machine.tolerances
        if parse_parameter(item.parameter).overlaps(parameter)
    ]
    return widths[0] if widths else 0.0


# The machine file's own numbers found beside those that were asked for, each held to the file.
#
# A fit takes the numbers of the machine file as they are, which no drawing gives exactly: c, one of
# them, is c_0 (1 + s z), z normal, s = 3 % (assumed; suspects.FILE). Where a record does not follow
# them, the likeliest values are those of Bayes' rule (maximum a posteriori; Ljung 1999, section
# 7.4). With H = J'J, g = J'r and M the covariance of g under the colour of the residuals, a step d
# from theta leaves g - H d, and the best one is the least of
#
#     (g - H d)' M^-1 (g - H d) + (theta + d - theta_0)' L (theta + d - theta_0)
#
# L: diagonal, 1/(s c_0)^2 for the file's numbers and zero for those asked for
# (statistics.step_with_prior), which also holds where the records cannot tell two numbers apart:
# then the file does.


_STEPS = 4  # of Gauss and Newton; the numbers are few per cent off, so two do
_SETTLED = 0.05  # standard deviations of a last step
# of the file's own uncertainty: numbers that the records know better, or move by more, are found
_TOLD, _MOVED = 0.7, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    """Values theta (q,) of an experiment's parameters, their covariance (q, q), and J'J (q, q)."""

    theta: np.ndarray
    covariance: np.ndarray
    H: np.ndarray

    @property
    def deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def fit_with_priors(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
) -> tuple[Experiment, ParameterEstimate] | None:
    """The estimate of ``result``'s parameters and of the file's numbers that the records tell, and
    its experiment; None where one would have to move by more than the file may be off.
    """
    asked, options = len(result.paths), replace(options, period=None)
    try:
        whole = build_experiment(
            machine,
            records,
            controller,
            (*result.paths, *file_numbers(machine, result.paths)),
            options,
        )
        first = _posterior(whole, _begin(whole, result), asked)
        if first is None:
            return None

        # those that the records tell, alone: the others stay what the file says
        prior = FILE * np.abs(whole.nominal)
        told = first.deviations < _TOLD * prior
        told |= np.abs(first.theta - whole.nominal) > _MOVED * prior
        chosen = [path for path, one in zip(whole.paths, told, strict=True) if one]
        chosen = [path for path in chosen if path not in result.paths]
        if not chosen:
            return None
        paths = (*result.paths, *chosen)
        experiment = build_experiment(machine, records, controller, paths, options)
        found = _posterior(experiment, _begin(experiment, result), asked)
    except AmbroseError:  # one of them cannot be an unknown here
        return None
    if found is None or experiment.paths != paths:
        return None

    # beyond its 95 % interval and the file's, a number is no correction: that is another machine
    moved = np.abs(found.theta - experiment.nominal)[asked:]
    width = FILE * np.abs(experiment.nominal) + found.deviations
    if (moved > COVERAGE * width[asked:]).any():
        return None
    return experiment, _estimate(experiment, found, result)


def prior_of(experiment: Experiment, asked: int) -> np.ndarray:
    """The standard deviations (q,) that the file's numbers have before a record; the first
    ``asked`` are not known.
    """
    prior = FILE * np.abs(experiment.nominal)
    prior[:asked] = np.inf
    return prior


def _begin(experiment: Experiment, result: ParameterEstimate) -> np.ndarray:
    """The file's values (q,), but for those found."""
    theta = experiment.nominal.copy()
    theta[[experiment.paths.index(path) for path in result.paths]] = result.values
    return theta


def _posterior(experiment: Experiment, theta: np.ndarray, asked: int) -> _Posterior | None:
    """The likeliest values from theta (q,) on, the first ``asked`` without a prior; None where the
    steps do not settle, or leave the stable loops.
    """
    problem = LeastSquares(experiment, normal_equations)
    prior = prior_of(experiment, asked)
    for _ in range(_STEPS):
        H, g, _, middle = equations_at(experiment, theta, coloured=True)
        step, covariance = statistics.step_with_prior(
            H, g, middle, prior, theta - experiment.nominal
        )
        theta = theta + step
        if not slowest(loop for loop, _ in problem.loops(theta)) < 1:
            return None
        if (np.abs(step) < _SETTLED * np.sqrt(np.diag(covariance))).all():
            return _Posterior(theta, covariance, H)
    return None


def _estimate(
    experiment: Experiment, found: _Posterior, result: ParameterEstimate
) -> ParameterEstimate:
    """What ``fit`` would give of these values: fit, residual tests, warnings; with what widened the
    intervals of ``result`` beyond noise.
    """
    theta, asked = found.theta, len(result.paths)
    loops = LeastSquares(experiment, normal_equations).loops(theta)
    count = sum(len(experiment.signals) * len(task.e) for task in experiment.tasks)
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    for number, given in enumerate(experiment.tasks, 1):
        loop, directions = loops[given.place]
        task = synchronised(loop, given)
        part = normal_equations(loop, directions, task)
        names = [excitation_names(experiment.models[task.place], mix) for mix in task.mix.T]
        scores = residual_scores(loop, task, part, names, experiment.signals, count)
        fits += [
            (number, name, float(value))
            for name, value in zip(experiment.signals, scores.fit, strict=True)
        ]
        tests += scores.tests

    # variances add: these, and what else than noise widened the ones before (magnets)
    covariance = found.covariance
    bare = _noise_alone(experiment, theta, asked)
    extra = np.maximum(result.standard_deviations**2 - bare**2, 0.0)
    wider = np.ones(len(theta))
    wider[:asked] = np.sqrt(1 + extra / np.diag(covariance)[:asked])
    covariance = covariance * wider * wider[:, None]
    correlation = covariance / found.deviations / found.deviations[:, None] / wider / wider[:, None]
    verdict = statistics.verdict_of(tests, True)
    minimum = Minimum(theta, 0.0, True, result.iterations, 0)
    warnings = statistics.warnings_of(
        experiment.paths, minimum, covariance, correlation, tests, verdict
    )
    cosine = statistics.column_cosine(found.H)
    return replace(
        result,
        paths=experiment.paths,
        values=theta,
        start=np.concatenate([result.start, experiment.nominal[asked:]]),
        covariance=covariance,
        correlation=correlation,
        column_cosine=cosine,
        fit=tuple(fits),
        tests=tuple(tests),
        condition=float(np.linalg.cond(cosine)),
        warnings=tuple(warnings),
        verdict=verdict,
    )


def _noise_alone(experiment: Experiment, theta: np.ndarray, asked: int) -> np.ndarray:
    """The standard deviations (asked,) of noise alone, the file's numbers known."""
    H, _, _, middle = equations_at(experiment, theta, coloured=True)
    own = np.s_[:asked]
    return np.sqrt(np.diag(statistics.sandwich_covariance(H[own, own], middle[own, own])))


def words(result: ParameterEstimate, asked: int) -> str:
    """One sentence without its stop on the numbers behind the first ``asked``."""
    rows = zip(
        result.paths[asked:],
        result.values[asked:] / result.start[asked:] - 1,
        result.standard_deviations[asked:] / np.abs(result.start[asked:]),
        strict=True,
    )
    numbers = ", ".join(
        f"{path} {100 * off:+.2g} % (deviation {100 * deviation:.2g} %)"
        for path, off, deviation in rows
    )
    return (
        "the records do not follow the machine file's own numbers, so these were found along, each "
        f"taken as known to {100 * FILE:g} % before (assumed): {numbers}; a [[tolerance]] of them "
        "makes them unknowns"
    )


_MISSED = 0.3
_FAR = 2.0  # factor by which a value may leave the file's
# the same of the one lag that takes in every other one of the chain; assumed: an amplifier's data
# sheet is nearer, and a filter that the file lacks is a lag of the same order
_FAR_LAG = 1.5
_KNOWN = {"bearing", "amplifier"}  # tables of what designers know
_SHIFTED = 0.04  # relative; a mean change below is none
_SURELY = 3.0  # standard deviations of a mean, by which its change is none of the single ratios'
_ALIKE = 0.02  # relative, by which two means of one cause differ at least
_OTHER_RATIO = 0.15  # relative change of a bearing's K_s/K_i, bias over gap; assumed
# of what is left unexplained, or of what still follows the excitation: another delay must leave
# less
_CLEARLY = 0.7
_DELAYED, _SURE = 0.1, 5.0  # samples, and standard deviations, by which a delay must differ
# share of what is left at one frequency, from which it is told; an excitation's line over all about
# it
_MOST, _PEAK = 0.5, 5.0
# share of a response from which one that is missing must show, else a tone hides it; assumed, as
# suspects.py's harmless move
_HIDDEN = 0.02
_BURST, _APART = 15.0, 500  # over the median size of the residual; samples from one to the next
# samples at a record's beginning, a tenth of them beyond so many median sizes: not settled
_SETTLING, _UNSETTLED = 100, 3.0


def diagnose_result(
    machine: Machine, result: ParameterEstimate, outputs: Sequence[SimulatedOutput]
) -> tuple[Finding, ...]:
    """What is impossible (errors) or doubtful (warnings) about an estimate; outputs: of the model,
    for every record. A tone that hides nothing, for the residual tests see what is missing from 2 %
    of a response on, is none.
    """
    findings = [
        *diagnose_values(machine, result, outputs),
        *diagnose_fit(machine, result, outputs),
    ]
    return tuple(sorted(findings, key=lambda finding: finding.severity != ERROR))


def diagnose_values(
    machine: Machine, result: ParameterEstimate, outputs: Sequence[SimulatedOutput]
) -> tuple[Finding, ...]:
    """The part of ``diagnose_result`` about the values and their intervals: to be asked again where
    these became wider.
    """
    return (
        *_signs(result),
        *_chain_lag(machine, result, outputs),
        *_sizes(machine, result),
        *_stiffness_alone(machine, result),
        *_common_factor(result),
        *_thrust(machine, result, outputs),
    )


def diagnose_fit(
    machine: Machine, result: ParameterEstimate, outputs: Sequence[SimulatedOutput]
) -> tuple[Finding, ...]:
    """The part of ``diagnose_result`` about what the model leaves of the records."""
    power = power_of(result.tests).values()
    sharp = bool(power) and max(power) <= _HIDDEN
    return tuple(
        item for item in diagnose_outputs(machine, outputs) if item.code != Code.TONE or not sharp
    )


def _thrust(
    machine: Machine, result: ParameterEstimate, outputs: Sequence[SimulatedOutput]
) -> Iterator[Finding]:
    if not machine.conditions:
        return
    values = {
        parse_parameter(path).quantity: float(value)
        for path, value in zip(result.paths, result.values, strict=True)
        if path not in TIMING
    }
    records = [output.record for output in outputs]
    yield from thrust_findings(machine, values, result.point, records)


def diagnose_outputs(
    machine: Machine, outputs: Sequence[SimulatedOutput], numbers: Sequence[int] = ()
) -> tuple[Finding, ...]:
    """What a model misses in its records: responses (errors), short bursts (warnings). numbers: of
    the records (1, 2, ...).
    """
    findings: list[Finding] = []
    for number, output in zip(numbers or range(1, len(outputs) + 1), outputs, strict=True):
        findings += [
            *_missed(machine, output, number),
            *_bursts(output, number),
            *_tone(output, number),
        ]
    return tuple(findings)


def _signs(result: ParameterEstimate) -> Iterator[Finding]:
    """Values that no machine has."""
    for path, value in zip(result.paths, result.values, strict=True):
        if path in TIMING:
            continue
        parameter = parse_parameter(path)
        positive = (
            parameter.table in {"amplifier", "rotor"} or parameter.quantity == "force_per_current"
        )
        if positive and value <= 0:
            what = f"{path} = {value:.4g} cannot be"
            evidence = "it must be positive"
            remedy = (
                "look for an inverted channel, another machine or another controller; or take it "
                "as known"
            )
            yield Finding(Code.IMPOSSIBLE_VALUE, ERROR, what, evidence, remedy)
        elif parameter.quantity == "negative_stiffness" and value <= 0:
            what = f"{path} = {value:.4g} N/m is not destabilising"
            evidence = "a biased magnet always is"
            remedy = (
                "look for another controller or gain, a stiffness that is missing in the model, or "
                "too little excitation"
            )
            yield Finding(Code.NOT_DESTABILISING, WARNING, what, evidence, remedy)


def chain_lags(machine: Machine, result: ParameterEstimate) -> list[tuple[int, float, float]]:
    """The places of the amplifier's lags in an estimate, with the time constants [s] found and of
    the start; none where the values are none of a lag.

    Of bandwidth/(s + bandwidth) it is 1/bandwidth, of w^2/(s^2 + d s + w^2) at low frequency d/w^2.
    """
    damping = machine.amplifier.damping or 0.0
    lags: list[tuple[int, float, float]] = []
    for k, path in enumerate(result.paths):
        value, start = float(result.values[k]), float(result.start[k])
        if path.startswith("amplifier.") and not path.endswith("damping") and min(value, start) > 0:
            second = path.endswith("natural_frequency")
            lag, stated = (damping / w**2 if second else 1 / w for w in (value, start))
            lags.append((k, lag, stated))
    return lags


def _chain_lag(
    machine: Machine, result: ParameterEstimate, outputs: Sequence[SimulatedOutput]
) -> Iterator[Finding]:
    """A lag far from the file's: what the chain from displacement to force has of lags and delays
    beside those that the file states is in this one number.
    """
    for k, lag, stated in chain_lags(machine, result):
        path = result.paths[k]
        value, start = float(result.values[k]), float(result.start[k])
        beyond = abs(value - start) - COVERAGE * float(result.standard_deviations[k])
        told = _stated(machine, result, path, start)
        if 1 / _FAR_LAG < value / start < _FAR_LAG or beyond <= (told if np.isfinite(told) else 0):
            continue
        what = f"{path}, the lag of the whole chain, is {value / start:.3g} times its start"
        evidence = (
            f"{1e6 * lag:.3g} us where the file has {1e6 * stated:.3g} us: filters and delays that "
            "the file does not state are in this number"
        )
        yield Finding(
            Code.FAR_FROM_FILE, WARNING, what, evidence, _stating(machine, lag - stated, outputs)
        )


def _stating(machine: Machine, extra: float, outputs: Sequence[SimulatedOutput]) -> str:
    """What to look for, and how to state it; extra [s]: by how much the lag is longer."""
    if extra <= 0:
        return (
            "look for a delay, filter or sensor lag that the file states and the machine does not "
            "have (--delay-samples, bandwidth of [[sensor]]), or another amplifier"
        )
    # sqrt(2)/w_c: the delay at low frequencies of a Butterworth filter of second order
    corner = np.sqrt(2) / extra / (2 * np.pi)
    own = [item.bandwidth for item in getattr(machine, "sensors", ()) if item.bandwidth]
    sensor = 1 / (extra + (1 / min(own) if own else 0.0)) / (2 * np.pi)
    samples = f", {extra / outputs[0].record.dt:.2g} samples" if outputs else ""
    return (
        "suspect an anti-alias or sensor filter first (one of second order at "
        f"{_hertz(corner)} has these {1e6 * extra:.3g} us): state it as the bandwidth of every "
        f'[[sensor]], "{_hertz(sensor)}", and identify again; else a longer delay of computing or '
        f"hold{samples} (--unknown delay), or another amplifier or current loop"
    )


def _hertz(value: float) -> str:
    """Three significant digits of a frequency [Hz]."""
    return f"{value / 1e3:.3g} kHz" if value >= 1e3 else f"{value:.3g} Hz"


def _sizes(machine: Machine, result: ParameterEstimate) -> list[Finding]:
    """Values far from where they began, of parameters that designers know or whose tolerance the
    machine states.
    """
    far = []
    lags = [result.paths[k] for k, _, _ in chain_lags(machine, result)]
    for path, value, start in zip(result.paths, result.values, result.start, strict=True):
        known = path not in (*TIMING, *lags) and parse_parameter(path).table in _KNOWN
        if known and start > 0 and value > 0 and not 1 / _FAR < value / start < _FAR:
            far.append(f"{path} is {value / start:.3g} times its start")
    rows = zip(result.paths, result.values, result.start, result.standard_deviations, strict=True)
    for path, value, start, deviation in rows:
        width = _stated(machine, result, path, float(start))
        if abs(value - start) > width + COVERAGE * deviation and not any(
            path in text for text in far
        ):
            share = 100 * width / abs(start) if start else 0.0
            far.append(
                f"{path} is {value / start:.3g} times its start, beyond its tolerance of "
                f"{share:.3g} %"
            )
    if not far:
        return []
    remedy = (
        "compare with the data sheet or a static load; a wrong scale of a channel, mass, bias or "
        "seal pressure does this"
    )
    return [
        Finding(
            Code.FAR_FROM_FILE,
            WARNING,
            "values are far from the machine file's",
            ", ".join(far),
            remedy,
        )
    ]


def _stated(machine: Machine, result: ParameterEstimate, path: str, start: float) -> float:
    """The widest tolerance that the machine states of a parameter, itself or by its seal's
    pressure; none: infinite.
    """
    widths = []
    for item in () if path in TIMING or not start else machine.tolerances:
        parameter, other = parse_parameter(path), parse_parameter(item.parameter)
        if parameter.overlaps(other):
            widths.append(half_width(item, start))
        elif (
            other.quantity == "pressure"
            and parameter.name == other.name
            and parameter.table == "seal"
            and result.point.seal_pressure
        ):
            widths.append(
                half_width(item, result.point.seal_pressure)
                / abs(result.point.seal_pressure)
                * abs(start)
            )
    return max(widths, default=float("inf"))


def _ratios(result: ParameterEstimate) -> dict[str, dict[str, list[float]]]:
    """Values over their starts: quantity of the magnets -> bearing -> one per axis."""
    found: dict[str, dict[str, list[float]]] = {}
    for path, value, start in zip(result.paths, result.values, result.start, strict=True):
        if path.startswith("bearing.") and start > 0:
            parameter = parse_parameter(path)
            named = found.setdefault(parameter.quantity, {}).setdefault(parameter.name, [])
            named.append(float(value / start))
    return found


def _stiffness_alone(machine: Machine, result: ParameterEstimate) -> list[Finding]:
    """A bearing whose K_s moved and whose K_i did not, where the file states no tolerance of its
    K_s: a magnet's K_s/K_i is bias over gap, and a spring that the file lacks changes it.
    """
    ratios = _ratios(result)
    found = []
    for name, values in ratios.get("negative_stiffness", {}).items():
        others = ratios.get("force_per_current", {}).get(name)
        rows = zip(result.paths, result.start, result.standard_deviations, strict=True)
        own = [row for row in rows if row[0].startswith(f"bearing.{name}.negative_stiffness")]
        stated = [_stated(machine, result, path, float(start)) for path, start, _ in own]
        if not others or np.isfinite(stated).any():
            continue
        ks, ki = float(np.mean(values)), float(np.mean(others))

        # the K_s of a bearing's axes err alike where what is beside them is not known well
        doubt = COVERAGE * float(np.mean([deviation / start for _, start, deviation in own]))
        if abs(ks / ki - 1) > _OTHER_RATIO + doubt:
            found.append(
                f"bearing.{name}: K_s is {ks:.3g} times its start, K_i {ki:.3g} times, so bias "
                f"over gap {ks / ki:.3g} times"
            )
    if not found:
        return []
    remedy = (
        "no record tells a bearing's K_s from a coupling, seal or other spring beside it that the "
        "file lacks, or another seal pressure: look for one, measure bias and gap, or state the "
        "tolerance of K_s"
    )
    what = "negative_stiffness moved where force_per_current did not"
    return [Finding(Code.FAR_FROM_FILE, WARNING, what, ", ".join(found), remedy)]


def _common_factor(result: ParameterEstimate) -> list[Finding]:
    """All K_i and K_s moved by one factor: that is what a wrong mass does, and the fit cannot
    tell.

    One factor: the mean change is large beside what the values of a kind scatter about their own
    mean, and K_i and K_s have the same one.
    """
    kinds = [np.concatenate([*by_name.values()]) for by_name in _ratios(result).values()]
    count = sum(map(len, kinds))
    if count < 4 or len(kinds) < 2:
        return []
    mean, apart = float(np.mean(np.concatenate(kinds))), float(np.ptp([v.mean() for v in kinds]))
    spread = float(np.sqrt(sum(np.sum((v - v.mean()) ** 2) for v in kinds) / (count - len(kinds))))
    doubt = spread / np.sqrt(count)

    # the difference of two means of half the values each has twice the mean's deviation
    alike = apart <= max(2 * _SURELY * doubt, 2 * _ALIKE * mean)
    if abs(mean - 1) <= max(_SHIFTED, _SURELY * doubt) or not alike:
        return []
    what = "every force_per_current and negative_stiffness moved by the same factor"
    evidence = f"{mean:.4g} times the start, with {100 * spread / mean:.2g} % of scatter"
    remedy = (
        "a rotor mass that is wrong by this factor does exactly that, and no closed-loop record "
        "can tell: weigh the rotor"
    )
    return [Finding(Code.COMMON_FACTOR, WARNING, what, evidence, remedy)]


def _missed(machine: Machine, output: SimulatedOutput, number: int) -> list[Finding]:
    """What follows the excitation in the record but not in the model, over what follows it at
    all.
    """
    axes = machine.axes
    if any(f"y_{axis}" not in output.signals for axis in axes):
        return []
    names = [f"y_{axis}" for axis in axes]
    residual = dict(output.rows(names))
    responses = compared_responses(output.record, names, [residual[name] for name in names], axes)
    del residual
    if responses is None:
        return []
    measured, rest = responses

    def power(values: np.ndarray) -> np.ndarray:
        return np.sum(np.abs(values) ** 2, axis=(0, 2))

    left = np.maximum(power(rest.values["y"]) - rest.noise["y"].sum(axis=0), 0.0)
    share = np.sqrt(left / np.maximum(power(measured.values["y"]), 1e-300))
    worst = int(np.argmax(share))
    if share[worst] <= _MISSED:
        return []
    what = (
        f"record {number}: no values of these parameters make the model respond as the machine did"
    )
    evidence = (
        f"{100 * share[worst]:.2g} % of what follows the excitation in {names[worst]} is missing "
        "in the model (amplitude)"
    )
    remedy = (
        "another machine, operating point, controller or delay; or a parameter that is taken as "
        "known is not"
    )
    return [Finding(Code.MISSING_RESPONSE, ERROR, what, evidence, remedy)]


def _bursts(output: SimulatedOutput, number: int) -> Iterator[Finding]:
    """Short times in which a signal leaves the model: lost samples, knocks, contact."""
    spread = float(np.std(output.measured))
    for name, row in output.rows():
        size = np.abs(row)
        quiet = 1.4826 * float(np.median(size))
        large = np.flatnonzero(size > max(_BURST * quiet, 1e-2 * spread))
        starts = [int(at) for j, at in enumerate(large) if j == 0 or at - large[j - 1] > _APART]
        if starts and starts[0] < _APART and np.mean(size[:_SETTLING] > _UNSETTLED * quiet) > 0.1:
            # the machine had not settled yet, at amplitudes where the magnets are another machine
            starts = starts[1:]
        if quiet > 0 and 0 < len(starts) <= 20:
            at = ", ".join(f"{output.record.time[i]:.4g} s" for i in starts[:4])
            what = f"record {number}: {name} leaves the model for a short time"
            evidence = (
                f"at t = {at}{' and later' if len(starts) > 4 else ''} by up to "
                f"{size.max() / quiet:.0f} times the usual"
            )
            remedy = (
                "a knock, contact or lost samples: identify from the time before or after it "
                "(identify --between)"
            )
            yield Finding(Code.BURST, WARNING, what, evidence, remedy)


def _tone(output: SimulatedOutput, number: int) -> Iterator[Finding]:
    """A frequency that holds most of what is left of a signal, and no line of the excitation: it
    hides all else.
    """
    # f_magnet_ is measured, and turns as all else does
    named = zip(output.record.signals, output.record.values, strict=True)
    excited = [
        row for name, row in named if name[:2] in {"e_", "f_"} and not name.startswith("f_magnet_")
    ]
    for name, row in output.rows():
        share, frequency = _strongest(row)
        if share > _MOST and not any(_has_line(e, frequency) for e in excited):
            what = (
                f"record {number}: a tone at {frequency * output.record.sample_rate_hz:.4g} Hz "
                "hides what the model lacks"
            )
            evidence = f"it is {100 * share:.0f} % of the power that is left of {name}"
            remedy = (
                "give the record's speed (speed_rad_s or a channel speed) if the rotor turns so, "
                "else the tone (--tone)"
            )
            yield Finding(Code.TONE, WARNING, what, evidence, remedy)
            return


def _strongest(row: np.ndarray) -> tuple[float, float]:
    """The share of a signal's power at its strongest frequency, and that [1/sample]."""
    near = _lines(row)
    at = int(np.argmax(near))
    return float(near[at] * 4 / max(float(near.sum()), 1e-300)), at / len(row)


def _has_line(row: np.ndarray, frequency: float) -> bool:
    """Whether a signal has far more power at a frequency [1/sample] than about it."""
    near, at = _lines(row), round(frequency * len(row))
    return bool(near[at] > _PEAK * near[max(at - 20, 0) : at + 21].mean())


def _lines(row: np.ndarray) -> np.ndarray:
    """The power of a signal about each frequency (k // 2 + 1,), over as many bins as a window makes
    of a line.
    """
    power = np.abs(np.fft.rfft((row - row.mean()) * np.hanning(len(row)))) ** 2
    power[:3] = 0.0  # slow drift is no tone
    return np.convolve(power, [0.5, 1.0, 1.0, 1.0, 0.5], "same")


def delay_findings(
    fitted: ParameterEstimate,
    delay: float,
    dt: float,
    free: Callable[[], ParameterEstimate],
    whole: Callable[[float], ParameterEstimate],
) -> tuple[Finding, ...]:
    """Whether another computing delay explains the records clearly better than the ``delay``
    [samples of dt, s] of ``fitted``.

    free: identifies with the delay as an unknown, too; whole: with another whole one, asked where
    the first is refused or leads nowhere. Only asked where the residuals still follow the
    excitation.
    """
    if all(test.passed for test in fitted.tests) or CONTROLLER_DELAY in fitted.paths:
        return ()
    try:
        estimate = free()
    except ValueError:  # a fitted controller output has no instant between samples, for instance
        estimate = None
    if estimate is None or not estimate.converged:
        return _whole_delays(fitted, delay, whole)
    place = estimate.paths.index(CONTROLLER_DELAY)
    count, deviation = (
        float(estimate.values[place]) / dt,
        float(estimate.standard_deviations[place]) / dt,
    )
    left, follows = (_left(fitted), _left(estimate)), (_follows(fitted), _follows(estimate))
    sure = abs(count - delay) > max(_DELAYED, _SURE * deviation)
    if not sure or (left[1] > _CLEARLY * left[0] and follows[1] > _CLEARLY * follows[0]):
        return ()
    number = _fixed(count, deviation)
    what = f"a computing delay of {number} instead of {delay:g} samples explains the records better"
    evidence = (
        f"found as an unknown: {number} samples ({1e3 * count * dt:.4g} ms), standard deviation "
        f"{deviation:.2g} samples; "
        f"it leaves {left[1]:.3g} % of the signals instead of {left[0]:.3g} %, and the residuals "
        "follow the excitation by "
        f"{follows[1]:.2g} times their limit instead of {follows[0]:.2g}"
    )
    remedy = (
        'ask for it ("delay" among the unknowns), or give it if the controller may have it; a lag '
        "of amplifier or sensor "
        "that the model lacks looks the same. One sample is 2 to 5 % in the stiffness"
    )
    return (Finding(Code.OTHER_DELAY, WARNING, what, evidence, remedy),)


def _left(estimate: ParameterEstimate) -> float:
    """What the model leaves of the signals [%], rms over them."""
    return float(np.sqrt(np.mean([(100.0 - percent) ** 2 for _, _, percent in estimate.fit])))


def _follows(estimate: ParameterEstimate) -> float:
    """The worst residual test over its limit."""
    return max(abs(test.correlation) / test.limit for test in estimate.tests)


def _fixed(value: float, deviation: float) -> str:
    """As many decimals as the deviation makes sense of, two to four; none for a whole number."""
    digits = min(max(1 - int(np.floor(np.log10(max(deviation, 1e-9)))), 2), 4)
    return f"{round(value, digits):g}"


def _whole_delays(
    estimate: ParameterEstimate, delay: float, whole: Callable[[float], ParameterEstimate]
) -> tuple[Finding, ...]:
    trials = {delay: _left(estimate)}
    for other in (delay - 1, delay + 1):
        if other >= 0:
            try:
                trials[other] = _left(whole(other))
            except ValueError:  # refused: an unstable loop, for instance
                continue
    best = min(trials, key=trials.__getitem__)
    if best == delay or trials[best] > _CLEARLY * trials[delay]:
        return ()
    figures = ", ".join(f"{value:.2g} % with {count:g}" for count, value in sorted(trials.items()))
    what = f"a computing delay of {best:g} instead of {delay:g} samples explains the records better"
    evidence = f"left unexplained of the signals: {figures}"
    remedy = (
        f"give --delay-samples {best:g} if the controller may have it; one sample is 2 to 5 % in "
        "the stiffness"
    )
    return (Finding(Code.OTHER_DELAY, WARNING, what, evidence, remedy),)
