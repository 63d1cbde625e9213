"""Which channel is which? The measured closed-loop responses against the model's, for every way
channels could be mixed up.

Responses T from the excitations to y, u and i (frf/spectral.py, free of the loop's noise) must be
those of the loop: T_y and T_u those of the model, T_u = -K T_y whatever the plant is, and T_i the
amplifier's response to u + e. A swapped or inverted channel breaks some of these and not the
others, which tells it from a changed parameter, and mostly also tells which one it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.excitation import signal_rows
from ambrose.identification.frf import spectral as frf
from ambrose.identification.output_error.normal_equations import distinct
from ambrose.law.loop import closed_loop
from ambrose.model.plant import Plant
from ambrose.record.record import Record

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
    a = len(measured.mix)
    excited = wiring.matrix("e", a).T @ measured.mix
    true = {kind: wiring.matrix(kind, a).T @ values for kind, values in measured.values.items()}
    noise = {
        kind: values @ np.abs(wiring.matrix(kind, a)) for kind, values in measured.noise.items()
    }
    unexplained: dict[str, np.ndarray] = {}
    if isinstance(expected, OpenLoop):
        command = expected.command(true, excited)
        unexplained["y"] = _share(true["y"], expected.G @ command, noise["y"])
        if {"u", "i"} <= set(true):
            unexplained["i"] = _share(true["i"], expected.amplifier @ command, noise["i"])
        return unexplained
    if "y" in true:
        unexplained["y"] = _share(true["y"], expected.y @ excited, noise["y"])
    if "u" in true:
        unexplained["u"] = _share(true["u"], expected.u @ excited, noise["u"])
        if "y" in true:
            unexplained["K"] = _share(true["u"], -expected.K @ true["y"], 0 * noise["u"])
    if "i" in true:
        command = (true["u"] if "u" in true else expected.u @ excited) + excited
        unexplained["i"] = _share(true["i"], expected.amplifier @ command, noise["i"])
    return unexplained


def _share(measured: np.ndarray, model: np.ndarray, noise: np.ndarray) -> np.ndarray:
    doubt = noise.sum(axis=0)
    left = np.sum(np.abs(measured - model) ** 2, axis=(0, 2)) - doubt
    size = np.sum(np.abs(measured) ** 2, axis=(0, 2))
    size = np.maximum(np.maximum(size - doubt, doubt), 1e-3 * float(size.max(initial=0.0)))
    return np.asarray(np.maximum(left, 0.0) / np.maximum(size, 1e-300))


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
    rows = []
    for wiring in (Wiring(), *wirings(kinds, len(measured.mix))):
        unexplained = shares(measured, expected, wiring)
        rows.append((score(unexplained) + 0.05 * wiring.changes, wiring, unexplained))
    return sorted(rows, key=lambda row: row[0])
