"""Frequency responses of a running loop from whatever it was excited by: sines, repeated sequences,
sweeps, noise.

Steady sines give their lines (stepped.py). An excitation that repeats is averaged over its periods,
the first left out, and what remains is free of transient and leakage; all else takes the whole
record (local.py). The excitation is known without noise, so what is measured against it has no bias
by feedback; the plant is the quotient of two such responses.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.identification.excitation import signal_rows
from ambrose.identification.frf.local import local_response
from ambrose.identification.frf.phasors import find_steps
from ambrose.identification.frf.spectral import Frf
from ambrose.identification.frf.stepped import is_stepped, stepped
from ambrose.identification.output_error.periodic import shortest_period
from ambrose.identification.output_error.synchronous import without_synchronous
from ambrose.record.record import Record

METHODS = ("sines", "periods", "polynomials")
IN_WORDS = {
    "sines": "steady sines, line by line",
    "periods": "mean over the periods, local polynomials",
    "polynomials": "local polynomials over the whole record",
}
_ALIKE = 1e-6  # relative difference of two excitations that are one
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
            "method", repr(method), " or ".join(METHODS), "leave it out: the excitation tells"
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
            ) <= _ALIKE * np.linalg.norm(row):
                group.append(name)
                break
        else:
            groups.append([name])
    if not groups:
        raise InvalidInput(
            "the records hold no excitation e_<axis>, r_<axis> or f_<port> that changes; excite "
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
