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
_MOST_BLOCKS = 20  # of a step, whose scatter gives the deviation
_LEAST_PERIODS, _LEAST_BLOCKS = 4, 3  # of a step, and of its fit
_HARMONICS = 8  # that are fitted beside the sine, as far as the sampling shows them
_SHOWN = 0.9  # of half the sample rate, below which a harmonic is told from another one
_SAMPLES_EACH = 2  # per unknown, that a block has at least


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

    Offset, drift and harmonics are fitted over all periods together: in one period alone a drift
    looks like sines, and what a harmonic has of it would pass for the sine. Each block of whole
    periods then has a sine, its harmonics and an offset of its own, so that periods need not be
    whole numbers of samples. Raises InvalidInput for a step too short for three periods after
    settling.
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

    # x = sum over n of a_n cos n angle + b_n sin n angle, with n from 1, and the phasor a_1 - j b_1
    samples = int(np.diff(edges).min())
    orders = _orders(step.frequency * record.dt, samples)
    first, last = int(edges[0]), int(edges[-1])
    angle = step.frequency * (record.start_time + np.arange(first, last) * record.dt - step.start)
    waves = np.stack([wave(n * angle) for n in orders for wave in (np.cos, np.sin)])

    # what is no sine of order 1, from all periods: harmonics, offset and drift
    ramp = np.stack([np.ones(last - first), np.linspace(-1, 1, last - first)])
    whole_record = rows[:, first:last]
    found = _least_squares(np.vstack([waves, ramp]), whole_record)
    left = whole_record - found[2:].T @ np.vstack([waves[2:], ramp])

    # block by block
    for block, (i, j) in zip(blocks, pairwise((edges - first).tolist()), strict=True):
        own = _least_squares(np.vstack([waves[:, i:j], np.ones(j - i)]), left[:, i:j])
        block[known] = own[0] - 1j * own[1]
    return Phasors(step.frequency, tuple(signals), blocks.mean(axis=0), blocks)


def _orders(per_sample: float, samples: int) -> range:
    """The multiples of a frequency [rad per sample] that a block of so many samples tells apart."""
    shown = int(_SHOWN * np.pi / per_sample)

    # a cos and a sin of every order, and an offset
    told = (samples // _SAMPLES_EACH - 1) // 2
    return range(1, max(min(_HARMONICS, shown, told), 1) + 1)


def _least_squares(basis: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The coefficients (c, s) of a basis (c, k) that values (s, k) have."""
    return np.linalg.solve(basis @ basis.T, basis @ values.T)
