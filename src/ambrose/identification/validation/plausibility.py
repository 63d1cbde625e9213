"""Can what was identified be true? Findings after the fit: signs, sizes, what the model misses,
where it stops to follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ambrose.identification.data_quality.channels import compared_responses
from ambrose.identification.findings import ERROR, WARNING, Code, Finding
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.statistics import power_of
from ambrose.identification.parameters import COVERAGE, half_width
from ambrose.identification.validation.collar_place import thrust_findings
from ambrose.identification.validation.simulated_output import SimulatedOutput
from ambrose.machine.axial import AxialMachine
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, TIMING, parse_parameter

_MISSED = 0.3
_FAR = 2.0  # factor by which a value may leave the file's
# the same of the one lag that takes in every other one of the chain; assumed: an amplifier's data
# sheet is nearer, and a filter that the file lacks is a lag of the same order
_FAR_LAG = 1.5
_KNOWN = {"bearing", "amplifier"}  # tables of what designers know
_MOVED = 0.04  # relative; a mean change below is none
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
    if not isinstance(machine, AxialMachine):
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
    if abs(mean - 1) <= max(_MOVED, _SURELY * doubt) or not alike:
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
