"""How far a model may be trusted: line by line against a measured frequency response, and up to
which frequency.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, as_several, check_positive, invalid
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import Names, as_statespace, index_of, select
from ambrose.identification.findings import signal_rows
from ambrose.identification.frf_spectral import Frf, local_response
from ambrose.identification.output_error.periodic import shortest_period
from ambrose.identification.output_error.synchronous import without_synchronous
from ambrose.record.record import Record

# Steady sines in records: which frequency is driven when, and amplitude and phase of every signal,
# block by block.


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


# A frequency response from stepped sines: exact at its few lines, where the average over segments
# smears and leaks.


_APART = 1e-6  # least over largest singular value of the inputs at a frequency
# shares of power: what is no sine within the steps, and what lies within them (not their ends)
_BESIDE, _MOST = 2e-3, 0.6


def stepped(
    records: Record | Sequence[Record],
    inputs: Names,
    outputs: Names,
    *,
    steps: Sequence[Step] | None = None,
    settle: float = 0.3,
) -> Frf:
    """The response of ``outputs`` to ``inputs``, Y U^-1 of phasors, at the frequencies driven in as
    many ways as inputs.

    The ways may be steps of one record, or of several, driven in different directions; more of them
    are fitted by least squares. steps: the schedule of all records (None: found in each). settle
    [s]: left out of each step. Coherence: the part of a signal's power that repeats from block to
    block. Variance: from the blocks' scatter. Raises InvalidInput.
    """
    records, u, y = (as_several(given) for given in (records, inputs, outputs))
    if not records or not u or not y:
        raise InvalidInput("a frequency response needs a record, an input and an output; name them")
    plans = [find_steps(record) if steps is None else tuple(steps) for record in records]
    groups: list[list[tuple[Record, Step]]] = []
    for record, plan in zip(records, plans, strict=True):
        for step in plan:
            same_step = next(
                (
                    g
                    for g in groups
                    if abs(g[0][1].frequency - step.frequency) <= 1e-3 * step.frequency
                ),
                None,
            )
            if same_step is None:
                groups.append(same_step := [])
            same_step.append((record, step))
    enough = sorted((g for g in groups if len(g) >= len(u)), key=lambda g: g[0][1].frequency)
    if not enough:
        raise InvalidInput(
            f"no frequency was driven in as many ways as there are inputs, {len(u)}: drive every "
            "input by one schedule of "
            "frequencies, one after the other or in separate records"
        )
    parts = []
    for group in enough:
        driven = [phasors(record, step, (*u, *y), settle) for record, step in group]
        parts.append(_line(group[0][1].frequency, driven, len(u)))
    values, variance, coherence, freedom = (np.array(part) for part in zip(*parts, strict=True))
    omega, m = np.array([group[0][1].frequency for group in enough]), len(u)
    return Frf(
        values,
        omega,
        u,
        y,
        variance,
        coherence[:, m:],
        coherence[:, :m],
        float(freedom.min()),
        records[0].dt,
    )


def is_stepped(record: Record, excitations: Sequence[str]) -> bool:
    """Whether the excitations of a record are steady sines and hardly anything else."""
    try:
        steps = find_steps(record)
    except InvalidInput:
        return False
    waves = np.stack([record[name] for name in excitations if name in record.signals])
    inside = beside = 0.0
    for step in steps:
        first, last = (
            round((time - record.start_time) / record.dt) for time in (step.start, step.stop)
        )
        part = waves[:, first:last]

        # power of the steps, and what a sine leaves of it
        angle = step.frequency * np.arange(part.shape[1]) * record.dt
        X = np.stack([np.cos(angle), np.sin(angle)]).T
        left = part.T - X @ np.linalg.lstsq(X, part.T, rcond=None)[0]
        inside, beside = inside + float((part**2).sum()), beside + float((left**2).sum())
    return beside <= _BESIDE * inside and inside >= _MOST * float((waves**2).sum())


def _line(
    frequency: float, driven: Sequence[Phasors], m: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Values, variance (p, m), coherence (m + p,) and degrees of freedom at one frequency."""
    # phasors (signals, ways): the first m are the inputs
    mean = np.stack([item.mean for item in driven], axis=1)
    if np.linalg.svd(mean[:m], compute_uv=False)[m - 1] <= _APART * np.linalg.norm(mean[:m], 2):
        raise InvalidInput(
            f"at {frequency / 2 / np.pi:g} Hz the records drive all inputs with the same "
            "pattern; drive each in a separate record"
        )
    count = min(len(item.blocks) for item in driven)
    blocks = np.stack([item.blocks[:count].T for item in driven], axis=2)  # (s, b, ways)

    # Y U^-1 of each block alone; variance of the mean of b: sum |.|^2/(b (b - 1))
    single = np.moveaxis(blocks, 1, 0)
    each = single[:, m:] @ np.linalg.pinv(single[:, :m])
    variance = np.mean(np.abs(each - each.mean(axis=0)) ** 2, axis=0) / (count - 1)

    # |mean over the blocks|^2 over the mean of |.|^2
    power = np.mean(np.abs(blocks) ** 2, axis=(1, 2))
    steady = np.mean(np.abs(blocks.mean(axis=1)) ** 2, axis=1)
    coherence = np.where(power > 0, steady / np.where(power > 0, power, 1.0), 0.0)
    return mean[m:] @ np.linalg.pinv(mean[:m]), variance, coherence, count - 1.0


# Frequency responses of a running loop from whatever it was excited by: sines, repeated sequences,
# sweeps, noise.
#
# Steady sines give their lines (frf.py). An excitation that repeats is averaged over its periods,
# the first left out, and what remains is free of transient and leakage; all else takes the whole
# record (frf_spectral.py). The excitation is known without noise, so what is measured against it
# has no bias by feedback; the plant is the quotient of two such responses.


METHODS = ("sines", "periods", "polynomials")
IN_WORDS = {
    "sines": "steady sines, line by line",
    "periods": "mean over the periods, local polynomials",
    "polynomials": "local polynomials over the whole record",
}
_ALIKE_MEASURED = 1e-6  # relative difference of two excitations that are one
_WEAK = 1e4  # times the least variance per unit of noise: lines that the excitation hardly reaches
_SETTLE = 0.3  # [s]
# degrees of freedom of the noise at a line of repeated excitations, whose lines are few
_FREEDOM = 12


@dataclass(frozen=True, slots=True, eq=False)
class LoopFrf:
    """What one operating point's records show. closed: from the excitations to y_<axis> and, where
    currents were recorded, to the amplifiers' commands v_<axis> = u + e; method: one of METHODS;
    together: per excitation all that were driven alike, of which it is the first; periods: how many
    were averaged.
    """

    closed: Frf
    method: str
    together: tuple[tuple[str, ...], ...]
    periods: int = 0

    @property
    def commanded(self) -> bool:
        """Whether the commands v_<axis> are known."""
        return any(name.startswith("v_") for name in self.closed.outputs)

    @property
    def motion(self) -> Frf:
        """From the excitations to the displacements."""
        return self.closed.select(
            outputs=[name for name in self.closed.outputs if name.startswith("y_")]
        )

    @property
    def plant(self) -> Frf | None:
        """From every command v_<axis> to every displacement, G = T_y T_v^-1; None: not all axes
        were driven, or no currents.
        """
        y, v = (
            [name for name in self.closed.outputs if name.startswith(kind)] for kind in ("y_", "v_")
        )
        if not v or len(self.together) < len(v):
            return None

        # T_y = G T_v: both from the same excitations
        Ty, Tv = self.closed.select(outputs=y), self.closed.select(outputs=v)
        back = np.linalg.pinv(Tv.values)
        G = Ty.values @ back
        noise = None
        share = None
        variance = np.zeros_like(Ty.variance)
        if self.closed.noise is not None and self.closed.share is not None:
            order = [self.closed.outputs.index(name) for name in (*y, *v)]
            whole = self.closed.noise[:, order][:, :, order]
            A = np.concatenate(
                [np.broadcast_to(np.eye(len(y)), (len(G), len(y), len(y))), -G], axis=2
            )
            noise = A @ whole @ A.conj().swapaxes(1, 2)  # dG = (dT_y - G dT_v) T_v^-1
            share = np.einsum("wji,wjk,wkl->wil", back, self.closed.share, back.conj())
            variance = (
                np.einsum("wii->wi", noise).real[:, :, None]
                * np.einsum("wii->wi", share).real[:, None, :]
            )
        return replace(
            Ty,
            values=G,
            inputs=tuple(v),
            variance=np.maximum(variance, 0.0),
            input_coherence=Tv.coherence,
            noise=noise,
            share=share,
        )


def measure(
    records: Sequence[Record],
    axes: Sequence[str],
    *,
    method: str | None = None,
    band: tuple[float, float] = (0.0, np.inf),
    harmonics: int = 3,
    settle: float | None = None,
) -> LoopFrf:
    """The loop's responses from records of one operating point, to all excitations e_<axis>,
    r_<axis> and f_<port> in them.

    method: one of METHODS; None: the one that suits the excitation. Excitations that are driven
    alike in all records are one, the response to both together. band [rad/s]: kept. harmonics:
    multiples of the speed that are taken out of the signals; settle [s]: left out of each sine
    (None: 0.3 s, or what three periods leave of the shortest). Raises InvalidInput.
    """
    if method is not None and method not in METHODS:
        raise invalid(
            "method", repr(method), " or ".join(METHODS), "leave it out: the excitation decides"
        )
    together = driven_groups(records, axes)
    inputs = tuple(group[0] for group in together)
    commanded = all(f"u_{axis}" in record.signals for record in records for axis in axes)
    ready = [_with_commands(record, axes, inputs) if commanded else record for record in records]
    outputs = [f"{kind}_{axis}" for kind in ("y", "v")[: 1 + commanded] for axis in axes]
    sines = all(
        is_stepped(record, [name for group in together for name in group]) for record in records
    )
    if method == "sines" or (method is None and sines):
        frf = stepped(ready, inputs, outputs, settle=_settling(ready) if settle is None else settle)
        return LoopFrf(_kept(frf, band), "sines", together)
    calm = [without_synchronous(record, harmonics) for record in ready]
    folded = None if method == "polynomials" else _folded(calm, inputs, outputs)
    if folded is not None:
        # a period too short for its lines to tell the inputs apart
        with suppress(*(() if method else (InvalidInput,))):
            options: dict[str, Any] = {"harmonics": 0, "freedom": _FREEDOM, "periodic": True}
            frf = local_response(folded[0], inputs, outputs, band=band, **options)
            return LoopFrf(_reached(frf), "periods", together, folded[1])
    if method == "periods":
        raise InvalidInput(
            "the excitation does not repeat twice in every record; take the method polynomials"
        )
    return LoopFrf(
        _reached(local_response(calm, inputs, outputs, band=band, harmonics=0)),
        "polynomials",
        together,
    )


def driven_groups(records: Sequence[Record], axes: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """The excitations that change, those together that are proportional in every record by one
    factor.
    """
    named = dict.fromkeys(name for record in records for name in record.signals)
    wanted = [
        n
        for n in named
        if (n[:2] in {"e_", "r_"} and n[2:] in axes) or (n[:2] == "f_" and n[:9] != "f_magnet_")
    ]
    rows = {
        name: np.concatenate([signal_rows(record, [name])[0] for record in records])
        for name in wanted
    }
    groups: list[list[str]] = []
    for name, row in rows.items():
        if not np.ptp(row):
            continue
        for group in groups:
            first = rows[group[0]]

            # least squares on the group's first: proportional where it leaves nothing
            factor = float(first @ row) / float(first @ first)
            if group[0][:2] == name[:2] and np.linalg.norm(
                row - factor * first
            ) <= _ALIKE_MEASURED * np.linalg.norm(row):
                group.append(name)
                break
        else:
            groups.append([name])
    if not groups:
        raise InvalidInput(
            "the records have no excitation e_<axis>, r_<axis> or f_<port> that changes; excite "
            "the loop, as the scenarios "
            "chirp, prbs, stepped-sine and acceptance do, and record what was added"
        )
    return tuple(map(tuple, groups))


def _settling(records: Sequence[Record]) -> float:
    """Seconds left out of every sine, so that three periods of each remain (and a little, as ends
    are found to a sample).
    """
    steps = [(step, record.dt) for record in records for step in find_steps(record)]
    return min(
        _SETTLE,
        *(max(s.stop - s.start - 3.01 * 2 * np.pi / s.frequency - dt, 0.0) for s, dt in steps),
    )


def _with_commands(record: Record, axes: Sequence[str], inputs: Sequence[str]) -> Record:
    """The record with v_<axis> [A], what the amplifiers were told, and without all that is not
    needed.
    """
    e = signal_rows(record, [f"e_{axis}" for axis in axes])
    v = [record[f"u_{axis}"] + wave for axis, wave in zip(axes, e, strict=True)]
    kept = [
        name
        for name in record.signals
        if name in inputs or name[:2] in {"y_", "e_"} or name.partition("_")[0] == "speed"
    ]
    part = record.select(kept)
    return replace(
        part,
        signals=(*part.signals, *(f"v_{axis}" for axis in axes)),
        units=(*part.units, *("A" for _ in axes)),
        values=np.vstack([part.values, *v]),
    )


def _folded(
    records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[tuple[Record, ...], int] | None:
    """The records as means over their periods but the first, and the least number of periods
    averaged; None: none repeats.
    """
    means, least = [], 0
    for record in records:
        driven = [name for name in inputs if name in record.signals and np.ptp(record[name])]
        P = shortest_period(np.stack([record[name] for name in driven])) if driven else None
        if P is None or record.values.shape[1] < 2 * P:
            return None
        part = record.select([*driven, *outputs])

        # the first period is left to the transient, and so is what is no whole one
        count = part.values.shape[1] // P - 1
        mean = part.values[:, -count * P :].reshape(len(part.values), count, P).mean(axis=1)
        means.append(replace(part, values=mean))
        least = min(least or count, count)
    return tuple(means), least


def _reached(frf: Frf) -> Frf:
    """The lines at which every excitation has a power worth the name."""
    if frf.share is None:
        return frf
    size = np.einsum("wii->wi", frf.share).real
    return frf.at_lines((size <= _WEAK * size.min(axis=0)).all(axis=1))


def _kept(frf: Frf, band: tuple[float, float]) -> Frf:
    inside = (frf.omega >= band[0]) & (frf.omega <= band[1])
    if not inside.any():
        raise invalid(
            "the band", f"{band[0]:g} to {band[1]:g} rad/s", "one that holds a sine", "move it"
        )
    return frf.at_lines(inside)


AGREES = 1
UNDECIDED = 0
DISAGREES = -1


@dataclass(frozen=True, slots=True, eq=False)
class Validity:
    """A model against a measured response, at omega (w,) [rad/s].

    ratio (w, p, m): model over measured; margin (w, p, m): the measurement's own relative radius at
    the confidence asked for. verdict (w, p, m): 1 within the tolerances widened by the margin, -1
    outside, 0 where the margin is wider than the tolerance and the model inside: the record cannot
    tell. valid_to (p, m) [rad/s]: the last line that agrees below the first that disagrees; 0 where
    the first decided line disagrees or nothing is decided. decided (p, m): share of lines below it.
    """

    omega: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    ratio: np.ndarray
    margin: np.ndarray
    verdict: np.ndarray
    valid_to: np.ndarray
    decided: np.ndarray

    @property
    def worst(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest deviation of magnitude [-] and phase [rad] (p, m) over the decided lines of the
        valid band.
        """
        inside = (self.omega[:, None, None] <= self.valid_to) & (self.verdict != UNDECIDED)
        size = np.where(inside, np.abs(np.abs(self.ratio) - 1), 0.0).max(axis=0)
        return size, np.where(inside, np.abs(np.angle(self.ratio)), 0.0).max(axis=0)


def compare(
    measured: Frf,
    model: Any,
    *,
    magnitude_tolerance: float = 0.1,
    phase_tolerance: float = 0.1745,
    confidence: float = 0.95,
) -> Validity:
    """Where ``model`` agrees with ``measured`` in magnitude (relative) and phase [rad] (default 10
    %, 10 degrees).

    model: a FrequencyResponse on the same lines, or a system with the same signals; a continuous
    one is sampled at the record's rate with a zero-order hold first, because that is what the
    controller's commands see: half a sample of delay is 1.8 degrees at 100 Hz and 10 kHz. Raises
    InvalidInput.
    """
    check_positive(magnitude_tolerance, "magnitude_tolerance", "0.1 is 10 %")
    check_positive(phase_tolerance, "phase_tolerance", "give it in rad")
    expected = model_response(measured, model).values
    size = np.abs(measured.values)
    if not size.all():
        raise InvalidInput(
            "the measured response is exactly zero at some line: a dead channel; leave it out"
        )
    ratio, margin = expected / measured.values, measured.radius(confidence) / size

    # a circle of relative radius r about 1 reaches 1 + r and the angle arcsin r, any beyond r = 1
    turn = np.where(margin < 1, np.arcsin(np.minimum(margin, 1.0)), np.pi)
    wide = (np.abs(np.abs(ratio) - 1) <= magnitude_tolerance + margin) & (
        np.abs(np.angle(ratio)) <= phase_tolerance + turn
    )
    told = margin <= min(magnitude_tolerance, phase_tolerance)
    verdict = np.where(~wide, DISAGREES, np.where(told, AGREES, UNDECIDED))

    # only what lies below the first line that disagrees
    before = np.cumsum(verdict == DISAGREES, axis=0) == 0
    good = before & (verdict == AGREES)
    last = np.where(good, measured.omega[:, None, None], 0.0).max(axis=0)
    below = before & (measured.omega[:, None, None] <= last)
    decided = good.sum(axis=0) / np.maximum(below.sum(axis=0), 1)
    return Validity(
        measured.omega, measured.inputs, measured.outputs, ratio, margin, verdict, last, decided
    )


def model_response(measured: Frf, model: Any) -> FrequencyResponse:
    """The model on the lines and between the signals of ``measured``; v_<axis> of the measurement
    is u_<axis> of a plant.

    Raises InvalidInput where it lacks a signal or, a FrequencyResponse, was computed on other
    lines.
    """
    if isinstance(model, FrequencyResponse):
        if model.omega.shape != measured.omega.shape or not np.allclose(
            model.omega, measured.omega, rtol=1e-9
        ):
            raise InvalidInput(
                "the model's frequencies are not those of the measured response; evaluate it at "
                "measured.omega"
            )
        return model.select(_named(measured.inputs, model.inputs), measured.outputs)
    system = as_statespace(model)
    system = select(system, _named(measured.inputs, system.inputs), measured.outputs)
    return frequency_response(
        c2d(system, measured.dt) if system.dt is None else system, measured.omega
    )


def _named(wanted: tuple[str, ...], known: tuple[str, ...]) -> list[str]:
    return [
        f"u_{name[2:]}" if name not in known and name.startswith("v_") else name for name in wanted
    ]
