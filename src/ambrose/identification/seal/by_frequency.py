"""A seal's coefficients over frequency and pressure from records, into the machine: no controller
is needed, nothing is fitted.

    done = identify_by_frequency(machine, ["zero.h5", "one-bar.h5", "two-bar.h5"])
    done.machine, done.fit, done.findings

Stepped sines give their frequencies; chirps, binary sequences and noise give those asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.data_quality.signals import signal_findings
from ambrose.identification.findings import WARNING, Code, Finding, refuse
from ambrose.identification.frf import Phasors, Step, driven_groups, find_steps, is_stepped, phasors
from ambrose.identification.frf_spectral import local_response
from ambrose.identification.output_error.problem import operating_points
from ambrose.identification.output_error.synchronous import without_synchronous
from ambrose.identification.seal.by_pressure import (
    COEFFICIENTS,
    FORMS,
    SealFit,
    averaged,
    beyond_tolerance,
    line,
    scattered,
    update_seal,
)
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Seal
from ambrose.model.assemble import assemble, seal_coefficients
from ambrose.model.effects import amplifier, sensor
from ambrose.model.static_load import magnet_coefficients
from ambrose.record.files import names_of_files, read_record
from ambrose.record.record import Record

# Seal coefficients frequency by frequency from stepped sines in closed loop: no controller, no
# noise model, no iteration.
#
# At a frequency the measured displacements and the magnets' forces are phasors. The rotor with
# bearings and couplings, but without the seal, says which force at the seal is missing, f = H_ys^-1
# (y - H_yb F_b), and how the rotor moves there; the dynamic stiffness Z = K + j w C of the seal is
# what turns one into the other, f = -Z q. Whatever acts on both (controller, pressure, noise that
# does not repeat) drops out. What the model lacks shows as a Z without pressure, and is taken off
# (P4, Fig. 12).


CURRENTS = ("measured", "commanded")
# of the larger singular value: below, the motions at the seal do not span the plane
_ONE_DIRECTION = 1e-3
_NEAR_SPEED = 1.0  # [Hz]
_UNSURE = 0.3  # standard deviation over value that is worth a warning
_UNDECIDABLE = 1e-6  # eigenvalue of the scaled normal matrix of K, k, C, c


def identify(
    machine: Machine,
    records: Sequence[Record],
    *,
    seal: str | None = None,
    steps: Sequence[Step] | None = None,
    settle: float = 0.3,
    currents: str | None = None,
    reference: bool = True,
    lines: Sequence[float] | None = None,
    harmonics: int = 3,
) -> SealFit:
    """The coefficients of a seal at every pressure and frequency of the records.

    records: closed-loop records with y_<axis> [m] and i_<axis> [A] or u_<axis> and e_<axis> [A],
    one or several per pressure (record.point.seal_pressure); several directions of excitation give
    all eight entries. seal: its name, where there are several. steps: the schedule of all records
    (None: found in each). settle [s]: left out at the begin of each step. currents: "measured" coil
    currents or "commanded" ones through the amplifier's model (None: measured where recorded).
    reference: the records at zero pressure tell what the model lacks, which is taken off all others
    and reported as ``systematic``; without, the machine must be exact. lines (f,) [rad/s]: instead
    of stepped sines the records hold chirps, binary sequences or noise along both directions, whose
    responses are taken at these frequencies (by_frequency.py), harmonics: multiples of the speed
    taken out of them. Raises InvalidInput.
    """
    name = seal_name(machine, seal)
    operating_points(machine, records, one_rate=False)
    groups: dict[float, list[Record]] = {}
    for record in records:
        groups.setdefault(record.point.seal_pressure, []).append(record)
    if reference and 0.0 not in groups:
        raise InvalidInput(
            "no record was taken without pressure; add one, or pass reference=False and trust the "
            "model"
        )
    if currents not in (None, *CURRENTS):
        raise invalid("currents", repr(currents), " or ".join(CURRENTS), "correct it")

    def driven(group: list[Record]) -> dict[float, list[Driven]]:
        if lines is None:
            return _steps(machine, group, steps, settle, currents)
        return at_lines(
            group, _signals(machine, group, currents), [_key(w) for w in lines], harmonics
        )

    stiffness = {
        pressure: _at_pressure(machine, name, groups[pressure], driven)
        for pressure in sorted(groups)
    }
    lacking = _lacking(machine, name, stiffness[0.0], groups[0.0][0].point) if reference else {}
    rows = [
        (pressure, _corrected(item, lacking, stiffness[0.0] if reference else []))
        for pressure, items in stiffness.items()
        for item in items
        if not lacking or (pressure and _key(item.frequency) in lacking)
    ]
    if not rows:
        raise InvalidInput(
            "no frequency was driven both with and without pressure; add records under pressure, "
            "with the same frequencies"
        )
    fit = _result(machine, name, rows)
    how = "stepped sine" if lines is None else "responses to broadband excitation"
    method = how + (", less the reference without pressure" if lacking else "")
    return replace(
        fit, method=method, warnings=tuple(_warnings(records if lines is None else (), rows))
    )


def _warnings(
    records: Sequence[Record], rows: Sequence[tuple[float, _Stiffness]]
) -> Iterator[Finding]:
    """What makes rows doubtful: unbalance at the same frequency, and k lost in noise."""
    speeds = {abs(record.point.speed) for record in records if record.point.speed}
    for w in dict.fromkeys(item.frequency for _, item in rows):
        for speed in speeds:
            if abs(w - speed) < _NEAR_SPEED * 2 * np.pi:
                what = (
                    f"the step at {w / 2 / np.pi:g} Hz lies at the speed of {speed / 2 / np.pi:g} "
                    "Hz"
                )
                remedy = "leave it out, or take records with and without excitation"
                yield Finding(Code.AT_SPEED, WARNING, what, "unbalance answers too", remedy)
    for pressure, item in rows:
        k, deviation = (
            item.pair[1].real,
            float(np.std(item.pairs[:, 1].real, ddof=1)) / len(item.pairs) ** 0.5,
        )
        if pressure and deviation > _UNSURE * abs(k):
            where = f"at {pressure:g} Pa and {item.frequency / 2 / np.pi:g} Hz"
            what = f"{where} k = {k:.3g} has the standard deviation {deviation:.2g}"
            remedy = "excite more, dwell longer, or leave the frequency out"
            yield Finding(Code.NOISY, WARNING, what, "the motion drowns in noise", remedy)


@dataclass(frozen=True, slots=True, eq=False)
class _Stiffness:
    """Z at one pressure and frequency: symmetric (direct, cross) complex and, or NaN, the matrix
    (2, 2); per block too.
    """

    frequency: float
    pair: np.ndarray  # (2,)
    matrix: np.ndarray  # (2, 2)
    pairs: np.ndarray  # (b, 2)
    matrices: np.ndarray  # (b, 2, 2)
    normal: np.ndarray  # (4, 4) J'J of K, k, C, c
    taken_off: np.ndarray  # (2,)


def _at_pressure(
    machine: Machine,
    name: str,
    records: list[Record],
    driven: Callable[[list[Record]], dict[float, list[Driven]]],
) -> list[_Stiffness]:
    experiments = driven(records)
    model = _Model(machine, name, records[0].point, np.array(list(experiments)), records[0].dt)
    stiffnesses = [_stiffness(model, i, steps) for i, steps in enumerate(experiments.values())]
    return sorted(stiffnesses, key=lambda item: item.frequency)


def _steps(
    machine: Machine,
    records: list[Record],
    steps: Sequence[Step] | None,
    settle: float,
    currents: str | None,
) -> dict[float, list[Driven]]:
    """The phasors of all steps at every frequency."""
    schedules = [find_steps(record) if steps is None else tuple(steps) for record in records]
    keys = [key for key in dict.fromkeys(_key(s.frequency) for plan in schedules for s in plan)]
    result: dict[float, list[Driven]] = {}
    for key in keys:
        pairs = [
            (r, s)
            for r, plan in zip(records, schedules, strict=True)
            for s in plan
            if _key(s.frequency) == key
        ]
        signals = [(_signals(machine, [r], currents), r, s) for r, s in pairs]
        result[key] = [
            (phasors(r, s, names, settle), names[-1].startswith("i_")) for names, r, s in signals
        ]
    return result


def _key(frequency: float) -> float:
    """Frequencies [rad/s] found in several records are one when they agree to 0.01 Hz or better."""
    return 2 * np.pi * round(frequency / 2 / np.pi, 2)


def _signals(machine: Machine, records: Sequence[Record], currents: str | None) -> list[str]:
    """Displacements and measured currents, or what the amplifiers were told."""
    axes = machine.axes
    all_currents = all(f"i_{a}" in record.signals for record in records for a in axes)
    measured = currents == "measured" or (currents is None and all_currents)
    return [f"y_{a}" for a in axes] + [
        f"{kind}_{a}" for kind in ("i" if measured else "ue") for a in axes
    ]


class _Model:
    """The rotor on bearings and couplings without the seal, at the frequencies (f,) [rad/s] of the
    steps.
    """

    def __init__(
        self, machine: Machine, name: str, point: OperatingPoint, omega: np.ndarray, dt: float
    ) -> None:
        seals = tuple(
            Seal(item.name, item.position) if item.name == name else item for item in machine.seals
        )
        bare = replace(machine, seals=seals, tolerances=())
        plant = assemble(bare, point)
        b, s = [f"f_{a}" for a in machine.axes], [f"f_{name}_x", f"f_{name}_y"]
        sensed_by = sensor.linearised(machine.sensor_pairs, machine.axes)
        sensed, moved = sensed_by.inputs, [f"q_{name}_x", f"q_{name}_y"]
        H = frequency_response(select(plant.rotor, [*b, *s], [*sensed, *moved]), omega).values
        lag = frequency_response(sensed_by, omega).values
        n, c = len(b), len(sensed)
        self.omega, self.axes = omega, machine.axes
        self.measured_by_force = lag @ H[:, :c, :n]
        self.measured_by_seal = lag @ H[:, :c, n:]
        self.moved_by_force, self.moved_by_seal = H[:, c:, :n], H[:, c:, n:]
        self.k_i = magnet_coefficients(machine, point)[0]
        hold = (1 - np.exp(-1j * omega * dt)) / (1j * omega * dt)
        drive: StateSpace = amplifier.linearised(machine.amplifier, machine.axes)
        self.current_by_command = frequency_response(drive, omega).values * hold[:, None, None]

    def seal_force(
        self, i: int, driven: Driven, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Force on the rotor and displacement at the seal, (2,) each, from the signals' phasors
        (s,) at frequency i.
        """
        item, measured = driven
        at = dict(zip(item.signals, values, strict=True))
        y = np.array([at[f"y_{a}"] for a in self.axes])
        if measured:
            current = np.array([at[f"i_{a}"] for a in self.axes])
        else:
            command = np.array([at[f"u_{a}"] + at[f"e_{a}"] for a in self.axes])
            current = self.current_by_command[i] @ command
        force = self.k_i * current
        f, *_ = np.linalg.lstsq(
            self.measured_by_seal[i], y - self.measured_by_force[i] @ force, rcond=None
        )
        return f, self.moved_by_force[i] @ force + self.moved_by_seal[i] @ f


def _stiffness(model: _Model, i: int, driven: list[Driven]) -> _Stiffness:
    """Z from all experiments at one frequency, from the means and again from every block."""
    omega = float(model.omega[i])

    def solve(values: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        f, q = (
            np.stack(part, axis=1)
            for part in zip(*map(model.seal_force, [i] * len(driven), driven, values), strict=True)
        )
        # f = -Z q, row by row
        A = np.concatenate([np.stack([q[0], q[1]], axis=1), np.stack([q[1], -q[0]], axis=1)])
        pair, *_ = np.linalg.lstsq(A, -np.concatenate([f[0], f[1]]), rcond=None)
        size = np.linalg.svd(q, compute_uv=False)
        whole = len(size) == 2 and q.shape[1] > 1 and size[1] > _ONE_DIRECTION * size[0]
        return pair, -f @ np.linalg.pinv(q) if whole else np.full((2, 2), np.nan + 1j * np.nan), A

    pair, matrix, A = solve([item.mean for item, _ in driven])
    J = np.column_stack([A, 1j * omega * A])
    normal = np.real(J.conj().T @ J)
    size = np.sqrt(np.diag(normal))
    if np.linalg.eigvalsh(normal / size / size[:, None])[0] < _UNDECIDABLE:
        raise NumericalFailure(
            f"at {omega / 2 / np.pi:g} Hz the rotor whirls in a circle at the seal, where "
            "direct and cross-coupled coefficients cannot be distinguished; excite along both "
            "axes, in separate records"
        )
    count = min(len(item.blocks) for item, _ in driven)
    parts = [solve([item.blocks[b] for item, _ in driven]) for b in range(count)]
    return _Stiffness(
        omega,
        pair,
        matrix,
        np.array([p[0] for p in parts]),
        np.array([p[1] for p in parts]),
        normal,
        np.zeros(2, complex),
    )


def _lacking(
    machine: Machine, name: str, items: list[_Stiffness], point: OperatingPoint
) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """Per frequency, pair (2,) and matrix (2, 2) found at zero pressure beyond what the machine
    states there.
    """
    item = next(one for one in machine.seals if one.name == name)
    result = {}
    for reference in items:
        w = reference.frequency
        coefficients = seal_coefficients(item, replace(point, whirl_frequency=w))
        a, b = coefficients.K + 1j * w * coefficients.C, coefficients.k + 1j * w * coefficients.c
        result[_key(w)] = (
            reference.pair - np.array([a, b]),
            reference.matrix - np.array([[a, b], [-b, a]]),
        )
    return result


def _corrected(item: _Stiffness, lacking: dict[float, Any], zero: list[_Stiffness]) -> _Stiffness:
    if not lacking:
        return item
    pair, matrix = lacking[_key(item.frequency)]
    matrix = np.where(np.isnan(matrix), 0.0, matrix) if np.isnan(item.matrix).any() else matrix
    shifted = replace(item, pair=item.pair - pair, matrix=item.matrix - matrix, taken_off=pair)
    other = next((one for one in zero if _key(one.frequency) == _key(item.frequency)), None)
    if other is None:
        return shifted
    # the blocks' means then scatter as the difference does
    count = min(len(item.pairs), len(other.pairs))
    return replace(
        shifted,
        pairs=item.pairs[:count] - other.pairs[:count],
        matrices=item.matrices[:count] - other.matrices[:count],
    )


def _result(machine: Machine, name: str, rows: list[tuple[float, _Stiffness]]) -> SealFit:
    items = [item for _, item in rows]
    omega = np.array([item.frequency for item in items])
    normal = np.array([item.normal for item in items])
    size = np.sqrt(np.einsum("nii->ni", normal))
    cosine = normal / size[:, :, None] / size[:, None, :]
    inverse = np.linalg.inv(cosine)
    scale = np.sqrt(np.einsum("nii->ni", inverse))
    taken = np.array([item.taken_off for item in items])
    return SealFit(
        machine.name,
        name,
        np.array([pressure for pressure, _ in rows]),
        omega,
        _four(np.array([item.pair for item in items]), omega),
        np.array(
            [
                _deviation(_four(item.pairs, np.full(len(item.pairs), item.frequency)))
                for item in items
            ]
        ),
        _eight(np.array([item.matrix for item in items]), omega),
        np.array(
            [
                _deviation(_eight(item.matrices, np.full(len(item.matrices), item.frequency)))
                for item in items
            ]
        ),
        cosine,
        inverse / scale[:, :, None] / scale[:, None, :],
        _four(taken, omega),
        "",
    )


def _four(pairs: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """K, k, C, c (n, 4) of pairs (n, 2) = K + j w C, k + j w c."""
    return np.column_stack([pairs.real, pairs.imag / omega[:, None]])


def _eight(matrices: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """The eight entries (n, 8) of matrices (n, 2, 2)."""
    signed = np.column_stack(
        [matrices[:, 0, 0], matrices[:, 0, 1], -matrices[:, 1, 0], matrices[:, 1, 1]]
    )
    stiffness, damping = signed.real, signed.imag / omega[:, None]
    return np.column_stack([stiffness, damping[:, 0], damping[:, 1], damping[:, 2], damping[:, 3]])


def _deviation(blocks: np.ndarray) -> np.ndarray:
    """Standard deviation (p,) of the mean over blocks (b, p)."""
    return blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))


def seal_name(machine: Machine, seal: str | None) -> str:
    """The name of the seal meant: the only one, or the one named. Raises InvalidInput."""
    names = [item.name for item in machine.seals]
    if seal is None and len(names) == 1:
        return names[0]
    if seal not in names:
        known = ", ".join(names) or "none"
        raise invalid(
            "seal",
            repr(seal),
            f"one of the machine's seals: {known}",
            "name the one that is identified",
        )
    return str(seal)


# What a broadband record says about a seal, frequency by frequency: its responses to every
# excitation, as phasors.
#
# A column of the response matrix at a frequency is the steady answer to a sine of one ampere, so
# that what is found from stepped sines is found from chirps, binary sequences and noise by the same
# equations. The noise of the responses becomes draws from their distribution, which stand for the
# blocks of a step.


_DRAWS = 60  # their standard deviation is good to 9 %

# the phasors of one experiment, and whether their currents were measured
Driven = tuple[Phasors, bool]


def at_lines(
    records: Sequence[Record],
    signals: Sequence[str],
    frequencies: Sequence[float],
    harmonics: int = 3,
) -> dict[float, list[Driven]]:
    """Frequency [rad/s] -> an experiment for each independent excitation e_ of the records: phasors
    of ``signals`` per ampere.

    frequencies (f,) [rad/s]: those that the records do not tell are left out. Raises InvalidInput
    where none remains, or all excitations are alike: two directions are needed.
    """
    axes = list(dict.fromkeys(name[2:] for name in signals))
    groups = driven_groups(records, axes)
    if any(name[:2] != "e_" for group in groups for name in group):
        raise InvalidInput(
            "a seal is identified from currents e_<axis> added to the controller's; leave other "
            "excitations out"
        )
    if len(groups) < 2:
        raise InvalidInput(
            "all excitations of the records at one pressure have the same pattern; drive the "
            "two directions with different patterns"
        )
    inputs, measured = (
        [group[0] for group in groups],
        any(name.startswith("i_") for name in signals),
    )
    outputs = [name for name in signals if not name.startswith("e_")]
    calm = [without_synchronous(record, harmonics) for record in records]
    frf = local_response(calm, inputs, outputs, harmonics=0, at=frequencies)
    assert frf.noise is not None and frf.share is not None
    seed, result = np.random.default_rng(0), {}
    group_of = {name: j for j, group in enumerate(groups) for name in group}
    for w, omega in enumerate(frf.omega.tolist()):
        left, right = _root(frf.noise[w]), _root(frf.share[w])
        shape = (_DRAWS, len(outputs), len(inputs))
        white = (seed.standard_normal(shape) + 1j * seed.standard_normal(shape)) / np.sqrt(2)
        white -= white.mean(axis=0)
        # The scatter of the mean over draws is to be that of one value: each is as wide as that of
        # a block would be.
        draws = frf.values[w] + np.sqrt(_DRAWS) * left @ white @ right.T
        experiments: list[Driven] = []
        for j in range(len(inputs)):
            mean, blocks = (
                np.zeros(len(signals), complex),
                np.zeros((_DRAWS, len(signals)), complex),
            )
            for i, name in enumerate(signals):
                if name.startswith("e_"):
                    mean[i] = blocks[:, i] = float(group_of.get(name) == j)
                else:
                    mean[i], blocks[:, i] = (
                        frf.values[w, outputs.index(name), j],
                        draws[:, outputs.index(name), j],
                    )
            experiments.append((Phasors(omega, tuple(signals), mean, blocks), measured))
        result[omega] = experiments
    return result


def _root(matrix: np.ndarray) -> np.ndarray:
    """A with A A^H = matrix (n, n), positive semidefinite."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


# [Hz], of broadband records where nothing else is asked for; assumed
_LOWEST, _HIGHEST = 5.0, 100.0
_LINES = 20  # from the one to the other


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SealByFrequency(Presented):
    """fit: a row per pressure and frequency; machine: the one given, with the seal as found in the
    form "line", "table" or "frequency"; reference: whether what the model lacks was found without
    pressure and taken off; records: their names.
    """

    given: Machine
    machine: Machine
    fit: SealFit
    form: str
    reference: bool
    findings: tuple[Finding, ...]
    records: tuple[str, ...] = ()

    @property
    def constants(self) -> SealFit:
        """One row per pressure: means over the frequencies."""
        return averaged(self.fit)

    @property
    def passed(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.findings

    def facts(self) -> dict[str, Any]:
        """Where it was measured and what it is at the highest pressure."""
        top, f = self.constants.values[-1], self.fit.frequency / 2 / np.pi
        at = (
            f"{len(self.fit.pressures)} pressures to {self.fit.pressure.max() / 1e5:.4g} bar, "
            f"{f.min():.4g} to {f.max():.4g} Hz"
        )
        values = {letter: float(value) for letter, value in zip(COEFFICIENTS, top, strict=True)}
        return {"seal": self.fit.seal, "measured at": at, **values, "findings": len(self.findings)}

    @property
    def comment(self) -> str:
        """What the file says above the machine about its seal."""
        forms = {
            "line": "regression lines over pressure",
            "table": "the values at these pressures",
            "frequency": "every row",
        }
        rows = [
            f"Seal {self.fit.seal} from {', '.join(self.records) or 'records'}: {self.fit.method}."
        ]
        rows += [
            "Means over the frequencies (standard deviations in brackets); in the file: "
            f"{forms[self.form]}."
        ]
        mean = self.constants
        for i, pressure in enumerate(mean.pressure):
            texts = [
                f"{c} {mean.values[i, j]:.4g} ({mean.deviations[i, j]:.2g})"
                for j, c in enumerate(COEFFICIENTS)
            ]
            rows.append(f"  {pressure:g} Pa: {', '.join(texts)}")
        rows += [f"Doubt: {finding}" for finding in self.findings]
        return "".join(f"# {row}\n" for row in rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI; deviations are standard deviations."""
        fit, mean = self.fit, self.constants
        entries = None if np.isnan(fit.entries).any() else fit.entries.tolist()
        return {
            "machine": self.given.name,
            "seal": fit.seal,
            "form": self.form,
            "method": fit.method,
            "reference": self.reference,
            "pressure": fit.pressure.tolist(),
            "frequency": fit.frequency.tolist(),
            "coefficients": list(COEFFICIENTS),
            "values": fit.values.tolist(),
            "deviations": fit.deviations.tolist(),
            "entries": entries,
            "systematic": fit.systematic.tolist(),
            "means": {
                "pressure": mean.pressure.tolist(),
                "values": mean.values.tolist(),
                "deviations": mean.deviations.tolist(),
            },
            "lines": _lines(mean),
            "findings": [str(finding) for finding in self.findings],
            "records": list(self.records),
        }


def identify_by_frequency(
    machine: Machine,
    records: Sequence[Record | str | Path],
    *,
    seal: str | None = None,
    form: str | None = None,
    frequencies: Sequence[float] | None = None,
    settle: float = 0.3,
    currents: str | None = None,
    harmonics: int = 3,
    progress: Callable[[str], None] = lambda stage: None,
) -> SealByFrequency:
    """The seal's K, k, C, c at every pressure of the records (record.point.seal_pressure) and every
    frequency driven.

    records: with y_<axis>, excitations e_<axis> along both directions, and i_<axis> or u_<axis>;
    those without pressure, where there are any, tell what the model lacks (couplings and bearings a
    little off, run-out of the model), which is taken off the others: the baseline. seal: its name,
    where there are several. form: "line" over pressure, "table" or "frequency" (None: lines from
    three pressures on, else a table). frequencies [rad/s]: of broadband records (None: 20 from 5 to
    100 Hz); settle [s]: left out of each sine; currents: "measured" or "commanded" (None: measured
    where recorded). Raises InvalidInput.
    """
    if not records:
        raise InvalidInput(
            "no record was given; record at several seal pressures, without pressure too"
        )
    if form is not None and form not in FORMS:
        raise invalid("form", repr(form), f"one of {', '.join(FORMS)}", "correct it")
    progress(f"reading {len(records)} record{'s' * (len(records) > 1)}")
    loaded, names = [read_record(item) for item in records], names_of_files(records)
    checked = [
        finding
        for number, record in enumerate(loaded, 1)
        for finding in signal_findings(machine, record, number)
    ]
    refuse(checked)
    kinds = [is_stepped(record, [n for n in record.signals if n[:2] == "e_"]) for record in loaded]
    if len(set(kinds)) > 1:
        raise InvalidInput("some records have stepped sines and others do not; give one kind only")
    reference = any(record.point.seal_pressure == 0 for record in loaded)
    lines = None
    if not kinds[0]:
        lines = list(frequencies or 2 * np.pi * np.linspace(_LOWEST, _HIGHEST, _LINES))
    elif frequencies:
        raise InvalidInput(
            "frequencies are those of the steps where the records have stepped sines; leave "
            "them out"
        )
    progress(f"the seal at {len({record.point.seal_pressure for record in loaded})} pressures")
    fit = identify(
        machine,
        loaded,
        seal=seal,
        settle=settle,
        currents=currents,
        reference=reference,
        lines=lines,
        harmonics=harmonics,
    )
    fit = with_baseline(machine, fit, loaded) if reference else fit
    mean = averaged(fit)
    form = form or ("line" if len(mean.pressures) > 2 else "table")
    if form == "line" and len(mean.pressures) < 3:
        raise invalid(
            "the number of seal pressures for a line",
            len(mean.pressures),
            "at least 3",
            "take the form table",
        )
    off = [item for item, matters in scattered(mean) if matters] if form == "line" else []
    findings = (*checked, *fit.warnings, *off, *beyond_tolerance(machine, mean))
    return SealByFrequency(
        machine, update_seal(machine, fit, form), fit, form, reference, findings, names
    )


def with_baseline(machine: Machine, fit: SealFit, records: Sequence[Record]) -> SealFit:
    """The fit with the rows without pressure, from which all others were measured: the machine's
    own coefficients there, each with the largest deviation found at its frequency.
    """
    item = next(one for one in machine.seals if one.name == fit.seal)
    point = next(record.point for record in records if record.point.seal_pressure == 0)
    keys, first = np.unique(fit.frequency, return_index=True)
    rows = []
    for w, at in zip(keys.tolist(), first.tolist(), strict=True):
        baseline = seal_coefficients(item, replace(point, whirl_frequency=w))
        row, same = fit.rows(np.array([at])), fit.rows(fit.frequency == w)
        values = np.array([[baseline.K, baseline.k, baseline.C, baseline.c]])
        whole = np.array(
            [
                [
                    baseline.K,
                    baseline.k,
                    baseline.k,
                    baseline.K,
                    baseline.C,
                    baseline.c,
                    baseline.c,
                    baseline.C,
                ]
            ]
        )
        rows.append(
            replace(
                row,
                pressure=np.zeros(1),
                values=values,
                deviations=same.deviations.max(axis=0, keepdims=True),
                entries=np.where(np.isnan(row.entries), np.nan, whole),
                entry_deviations=same.entry_deviations.max(axis=0, keepdims=True),
            )
        )
    return fit.joined(*rows)


def _lines(mean: SealFit) -> dict[str, Any] | None:
    if len(mean.pressures) < 3:
        return None
    lines = {letter: line(mean, letter) for letter in COEFFICIENTS}
    return {
        letter: {
            "intercept": one.intercept,
            "slope": one.slope,
            "scatter": one.scatter,
            "covariance": one.covariance.tolist(),
        }
        for letter, one in lines.items()
    }
