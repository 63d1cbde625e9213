"""What a static load makes of a magnet's coefficients: a fit finds those at the load, a machine file gives those without."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record
from ambrose.physics import magnet

_TOLD = 0.01  # relative change of a coefficient that is worth a sentence


def machine_at_load(machine: Machine, records: Iterable[Record]) -> Machine:
    """The machine with the coefficients of its magnets at the mean currents, u_ or i_ of the first record that has them."""
    means = _means(records)
    return replace(machine, bearings=tuple(_at_load(bearing, means) or bearing for bearing in machine.bearings))


def load_remarks(machine: Machine, records: Iterable[Record], loads: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """A sentence for each axis whose mean current changes k_i or k_s by over 1 %: u_ or i_ of the first record that has it,
    else the one of ``loads`` {axis: [A]}."""
    means = {**(loads or {}), **_means(records)}
    return tuple(text for bearing in machine.bearings for text in _of_bearing(bearing, means))


def _means(records: Iterable[Record]) -> dict[str, float]:
    means: dict[str, float] = {}
    for record in records:
        for prefix in ("u_", "i_"):
            for name in record.signals:
                if name.startswith(prefix):
                    means.setdefault(name.removeprefix(prefix), float(record[name].mean()))
    return means


def _at_load(bearing: MagneticBearing, means: dict[str, float]) -> MagneticBearing | None:
    """The bearing at its mean currents; None where no magnet follows from its coefficients."""
    try:
        return magnet.loaded(bearing, (means.get(f"{bearing.name}_zeta", 0.0), means.get(f"{bearing.name}_eta", 0.0)))
    except InvalidInput:
        return None


def _of_bearing(bearing: MagneticBearing, means: dict[str, float]) -> Iterable[str]:
    here, free = _at_load(bearing, means), _at_load(bearing, {})
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
