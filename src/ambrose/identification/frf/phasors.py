"""Steady sines in records: which frequency is driven when, and amplitude and phase of every signal,
block by block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.statespace import index_of
from ambrose.record.record import Record

_ALIKE = 0.02  # relative difference of successive periods within one step
_SLACK = 1e-3  # [s] by which steps of two signals may overlap and still follow each other
_MOST_BLOCKS = 20
_LEAST_PERIODS, _LEAST_BLOCKS = 4, 3  # of a step, and of its fit


@dataclass(frozen=True, slots=True)
class Step:
    """One frequency [rad/s], driven from ``start`` to ``stop`` [s]."""

    frequency: float
    start: float
    stop: float


@dataclass(frozen=True, slots=True, eq=False)
class Phasors:
    """Complex amplitudes of the signals of one step: x(t) = Re(value exp(j frequency (t - start))).

    mean (s,): over all blocks; blocks (b, s): of whole periods one after the other, whose scatter
    tells the noise.
    """

    frequency: float
    signals: tuple[str, ...]
    mean: np.ndarray
    blocks: np.ndarray


def steps_of(frequencies: Sequence[float], dwell: float, start: float = 0.0) -> tuple[Step, ...]:
    """The steps of a schedule: each of the frequencies (f,) [rad/s] for ``dwell`` [s], one after
    the other.
    """
    dwell = check_positive(dwell, "dwell", "give it in seconds")
    return tuple(
        Step(float(w), start + i * dwell, start + (i + 1) * dwell)
        for i, w in enumerate(frequencies)
    )


def find_steps(record: Record) -> tuple[Step, ...]:
    """The stretches of a record in which an excitation is a steady sine, from the times of its
    rising zero crossings.

    Excitations e_<axis> that are driven at the same time count once. Neighbouring periods that
    differ by less than 2 % belong to one step. Raises InvalidInput where there is none of four
    periods.
    """
    names = [name for name in record.signals if name.startswith("e_")]
    if not names:
        raise InvalidInput("the record has no excitation e_<axis>; record the sine as one")
    steps: list[Step] = []
    for name in names:
        for step in _steady(record, name):
            if all(
                step.start >= other.stop - _SLACK or step.stop <= other.start + _SLACK
                for other in steps
            ):
                steps.append(step)
    if not steps:
        raise InvalidInput(
            f"no excitation of the record is a steady sine for {_LEAST_PERIODS} periods; excite "
            "by stepped sines"
        )
    return tuple(sorted(steps, key=lambda step: step.start))


def _steady(record: Record, name: str) -> list[Step]:
    """The steps of one signal."""
    wave = record[name]

    # rising zero crossings, straight lines between the samples
    up = np.flatnonzero((wave[:-1] <= 0) & (wave[1:] > 0))
    times = record.start_time + (up - wave[up] / (wave[up + 1] - wave[up])) * record.dt
    periods = np.diff(times)
    steps, first = [], 0
    for i in range(1, len(periods) + 1):
        if i < len(periods) and abs(periods[i] - periods[first:i].mean()) <= _ALIKE * periods[i]:
            continue
        if i - first >= _LEAST_PERIODS:
            inner = slice(first + 1, i)  # the outermost periods may belong half to the neighbours
            period = np.polyfit(np.arange(i - first - 1), times[inner], 1)[0]
            steps.append(Step(float(2 * np.pi / period), float(times[first]), float(times[i])))
        first = i
    return steps


def phasors(record: Record, step: Step, signals: Sequence[str], settle: float = 0.3) -> Phasors:
    """The phasors of ``signals`` in a step, after the first ``settle`` [s] of it were left to the
    transient; zero for an excitation e_<axis> that the record lacks.

    Each block of whole periods is fitted by least squares with a sine, an offset and a drift, so
    periods need not be whole numbers of samples. Raises InvalidInput for a step too short for three
    periods after settling.
    """
    check_positive(settle, "settle", "give it in seconds", zero_allowed=True)
    period = (
        2 * np.pi / check_positive(step.frequency, "the frequency of a step", "give it in rad/s")
    )
    whole = int((step.stop - step.start - settle) / period + 1e-6)
    if whole < _LEAST_BLOCKS:
        need = settle + _LEAST_BLOCKS * period
        raise invalid(
            f"the step at {step.frequency / 2 / np.pi:g} Hz",
            f"{step.stop - step.start:g} s long",
            f"at least {need:.3g} s, {_LEAST_BLOCKS} periods after {settle:g} s of settling",
            "dwell longer, or settle less",
        )
    each = -(-whole // _MOST_BLOCKS)
    count = whole // each

    # blocks counted back from the end: what is left over goes to the transient
    edges = step.stop - np.arange(count, -1, -1) * each * period
    edges = np.round((edges - record.start_time) / record.dt).astype(int)
    if edges[0] < 0 or edges[-1] > record.values.shape[1]:
        time = record.time
        remedy = "pass the steps of this record"
        raise invalid(
            "a step",
            f"up to {step.stop:g} s",
            f"within {time[0]:g} to {time[-1]:g} s of the record",
            remedy,
        )
    known = [
        i for i, name in enumerate(signals) if name in record.signals or not name.startswith("e_")
    ]
    rows = record.values[list(index_of([signals[i] for i in known], record.signals, "signal"))]
    blocks = np.zeros((count, len(signals)), complex)
    for block, (i, j) in zip(blocks, pairwise(edges.tolist()), strict=True):
        block[known] = _fit(rows[:, i:j], step, record.start_time + i * record.dt, record.dt)
    return Phasors(step.frequency, tuple(signals), blocks.mean(axis=0), blocks)


def _fit(values: np.ndarray, step: Step, start: float, dt: float) -> np.ndarray:
    """The phasors (s,) of values (s, k) that begin at ``start`` [s]."""
    k = values.shape[1]

    # x = a cos + b sin + offset + drift: the phasor is a - j b
    angle = step.frequency * (start + np.arange(k) * dt - step.start)
    X = np.stack([np.cos(angle), np.sin(angle), np.ones(k), np.linspace(-1, 1, k)])
    coefficients = np.linalg.solve(X @ X.T, X @ values.T)
    return coefficients[0] - 1j * coefficients[1]
