"""Can what was identified be true? Findings after the fit: signs, sizes, what the model misses, where it stops to follow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ambrose.identify.closed_loop import Identification
from ambrose.identify.explained import Explained
from ambrose.identify.record_finding import ERROR, WARNING, RecordFinding
from ambrose.identify.record_wiring import measured_responses
from ambrose.identify.timed_loop import COMMAND, TIMING
from ambrose.machine.description import Machine
from ambrose.machine.parameters import parse_parameter

_MISSED, _FAR, _ALIKE, _MOVED = 0.3, 2.0, 0.02, 0.05
_BURST = 15.0  # over the median size of the residual


def diagnose_result(machine: Machine, result: Identification, pieces: Sequence[Explained]) -> tuple[RecordFinding, ...]:
    """What is impossible (errors) or doubtful (warnings) about an identification; pieces: its records beside the model."""
    findings = [*_signs(result), *_sizes(result), *_common_factor(result)]
    for number, piece in enumerate(pieces, 1):
        findings += [*_missed(machine, piece, number), *_bursts(piece, number)]
    return tuple(sorted(findings, key=lambda finding: finding.severity != ERROR))


def _signs(result: Identification) -> list[RecordFinding]:
    """Values that no machine has."""
    findings = []
    for path, value in zip(result.paths, result.values, strict=True):
        if path in TIMING:
            continue
        parameter = parse_parameter(path)
        positive = parameter.table == "amplifier" or parameter.quantity == "force_per_current"
        if positive and value <= 0:
            findings.append(
                RecordFinding(
                    ERROR,
                    f"{path} = {value:.4g} cannot be",
                    "it must be positive",
                    "look for an inverted channel, another machine or another controller; or take it as known",
                )
            )
        elif parameter.quantity == "negative_stiffness" and value <= 0:
            findings.append(
                RecordFinding(
                    WARNING,
                    f"{path} = {value:.4g} N/m is not destabilising",
                    "a biased magnet always is",
                    "look for another controller or gain, a stiffness that is missing in the model, or too little excitation",
                )
            )
    return findings


def _sizes(result: Identification) -> list[RecordFinding]:
    """Values far from where they began, of parameters that designers know."""
    far = []
    for path, value, start in zip(result.paths, result.values, result.start, strict=True):
        known = path not in TIMING and parse_parameter(path).table in {"bearing", "amplifier"}
        if known and start > 0 and value > 0 and not 1 / _FAR < value / start < _FAR:
            far.append(f"{path} is {value / start:.3g} times its start")
    if not far:
        return []
    remedy = "compare with the data sheet or a static load; a wrong scale of a channel, mass or bias does this"
    return [RecordFinding(WARNING, "values are far from the machine file's", ", ".join(far), remedy)]


def _common_factor(result: Identification) -> list[RecordFinding]:
    """All K_i and K_s moved by one factor: that is what a wrong mass does, and the fit cannot tell."""
    ratios = [
        value / start
        for path, value, start in zip(result.paths, result.values, result.start, strict=True)
        if path.startswith("bearing.") and start > 0
    ]
    kinds = {parse_parameter(path).quantity for path in result.paths if path.startswith("bearing.")}
    if len(ratios) < 4 or len(kinds) < 2:
        return []
    mean = float(np.mean(ratios))
    if abs(mean - 1) <= _MOVED or float(np.ptp(ratios)) > 2 * _ALIKE * mean:
        return []
    return [
        RecordFinding(
            WARNING,
            "every force_per_current and negative_stiffness moved by the same factor",
            f"{mean:.4g} times the start, all within {100 * float(np.ptp(ratios)) / 2 / mean:.2g} %",
            "a rotor mass that is wrong by this factor does exactly that, and no closed-loop record can tell: weigh the rotor",
        )
    ]


def _missed(machine: Machine, piece: Explained, number: int) -> list[RecordFinding]:
    """What follows the excitation in the record but not in the model, over what follows it at all."""
    axes = machine.axes
    if any(f"y_{axis}" not in piece.signals for axis in axes):
        return []
    names = [f"y_{axis}" for axis in axes]
    driven = [name for name in piece.record.signals if name[:2] == "e_"]
    kept = piece.record.select([*names, *driven])
    rows = [piece.signals.index(name) for name in names]
    measured = measured_responses([kept], axes)
    rest = measured_responses([replace(kept, values=np.vstack([piece.residual[rows], kept.values[len(axes) :]]))], axes)
    if measured is None or rest is None:
        return []

    def power(found: np.ndarray) -> np.ndarray:
        return np.sum(np.abs(found) ** 2, axis=(0, 2))

    left = np.maximum(power(rest.values["y"]) - rest.noise["y"].sum(axis=0), 0.0)
    share = np.sqrt(left / np.maximum(power(measured.values["y"]), 1e-300))
    worst = int(np.argmax(share))
    if share[worst] <= _MISSED:
        return []
    return [
        RecordFinding(
            ERROR,
            f"record {number}: no values of these parameters make the model respond as the machine did",
            f"{100 * share[worst]:.2g} % of what follows the excitation in {names[worst]} is missing in the model (amplitude)",
            "another machine, operating point, controller or delay; or a parameter that is taken as known is not",
        )
    ]


def _bursts(piece: Explained, number: int) -> list[RecordFinding]:
    """Short times in which a signal leaves the model: lost samples, knocks, contact."""
    findings = []
    for name, row in zip(piece.signals, piece.residual, strict=True):
        size = np.abs(row)
        quiet = 1.4826 * float(np.median(size))
        large = np.flatnonzero(size > max(_BURST * quiet, 1e-3 * float(np.std(piece.measured))))
        starts = [int(at) for j, at in enumerate(large) if j == 0 or at - large[j - 1] > 500]
        if quiet > 0 and 0 < len(starts) <= 20:
            at = ", ".join(f"{piece.record.time[i]:.4g} s" for i in starts[:4])
            findings.append(
                RecordFinding(
                    WARNING,
                    f"record {number}: {name} leaves the model for a short time",
                    f"at t = {at}{' and later' if len(starts) > 4 else ''} by up to {size.max() / quiet:.0f} times the usual",
                    "a knock, contact or lost samples: cut the record there and identify again",
                )
            )
    return findings


def delay_findings(result: Identification, delay: float, again: Callable[[float], Identification]) -> tuple[RecordFinding, ...]:
    """Whether another computing delay explains the records clearly better; ``again`` identifies with a given one.

    Only asked where the residuals still follow the excitation.
    """
    if all(test.passed for test in result.tests) or COMMAND in result.paths:
        return ()

    def left(found: Identification) -> float:
        return float(np.sqrt(np.mean([(100.0 - percent) ** 2 for _, _, percent in found.fit])))

    trials = {delay: left(result)}
    for other in (delay - 1, delay + 1):
        if other >= 0:
            try:
                trials[other] = left(again(other))
            except ValueError:  # refused: an unstable loop, for instance
                continue
    best = min(trials, key=trials.__getitem__)
    if best == delay or trials[best] > 0.7 * trials[delay]:
        return ()
    figures = ", ".join(f"{value:.2g} % with {count}" for count, value in sorted(trials.items()))
    return (
        RecordFinding(
            WARNING,
            f"a computing delay of {best} instead of {delay} samples explains the records better",
            f"left unexplained of the signals: {figures}",
            f"give {best} as delay if the controller may have it; one sample is 2 to 5 % in the stiffness",
        ),
    )
