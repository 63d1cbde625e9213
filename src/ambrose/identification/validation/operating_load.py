"""What a static load makes of a magnet's coefficients: a fit finds those at the load, a machine file gives those without."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record
from ambrose.physics import magnet
from ambrose.plant.sag import static_sag

_TOLD = 0.01  # relative change of a coefficient that is worth a sentence


def machine_at_load(machine: Machine, records: Sequence[Record]) -> Machine:
    """The machine with the coefficients of its magnets at the mean currents, u_ or i_ of the first record that has them, and as
    far off the magnets' centre as the rotor hangs through there; as it is, where the records hold no currents."""
    means = _means(records)
    if not means:
        return machine
    hangs, _ = static_sag(machine)
    bearings = (
        _at_load(bearing, means, _bias(records), place) or bearing
        for bearing, place in zip(machine.bearings, hangs, strict=True)
    )
    return replace(machine, bearings=tuple(bearings))


def load_remarks(machine: Machine, records: Sequence[Record], loads: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """A sentence for each axis whose mean current changes k_i or k_s by over 1 %: u_ or i_ of the first record that has it,
    else the one of ``loads`` {axis: [A]}."""
    means = {**(loads or {}), **_means(records)}
    return tuple(text for bearing in machine.bearings for text in _of_bearing(bearing, means, _bias(records)))


def _bias(records: Sequence[Record]) -> float | None:
    """The bias current [A] of the records, which is one for all; None: the bearings' own."""
    return records[0].point.bias_current if records else None


def _means(records: Iterable[Record]) -> dict[str, float]:
    means: dict[str, float] = {}
    for record in records:
        for prefix in ("u_", "i_"):
            for name in record.signals:
                if name.startswith(prefix):
                    means.setdefault(name.removeprefix(prefix), float(record[name].mean()))
    return means


def _at_load(
    bearing: MagneticBearing, means: dict[str, float], bias: float | None, place: np.ndarray | None = None
) -> MagneticBearing | None:
    """The bearing at its mean currents, the rotor at a place (2,) [m] in it (None: the magnets' centre); None where no magnet
    follows from its coefficients."""
    zeta, eta = (means.get(f"{bearing.name}_{axis}", 0.0) for axis in ("zeta", "eta"))
    off = (0.0, 0.0) if place is None else np.subtract(place, bearing.magnetic_offset)
    try:
        return magnet.loaded(bearing, (zeta, eta), bias, displacement=(float(off[0]), float(off[1])))
    except InvalidInput:
        return None


def _of_bearing(bearing: MagneticBearing, means: dict[str, float], bias: float | None) -> Iterable[str]:
    here, free = _at_load(bearing, means, bias), _at_load(bearing, {}, bias)
    if here is None or free is None:
        return
    k_i, k_s = (
        np.array(getattr(here, name)) / np.array(getattr(free, name)) - 1
        for name in ("force_per_current", "negative_stiffness")
    )
    for axis, of_k_i, of_k_s in zip((f"{bearing.name}_zeta", f"{bearing.name}_eta"), k_i, k_s, strict=True):
        if max(abs(of_k_i), abs(of_k_s)) > _TOLD:
            yield (
                f"{axis} carries a mean current of {means.get(axis, 0.0):.3g} A: a magnet as in the machine file has there "
                f"{100 * of_k_i:+.2g} % of k_i and {100 * of_k_s:+.2g} % of k_s, which the values found contain"
            )
