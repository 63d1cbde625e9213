"""What a static load makes of a magnet's coefficients: a fit finds those at the load, a machine file gives those without."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record
from ambrose.physics import magnet

_TOLD = 0.01  # relative change of a coefficient that is worth a sentence
_STEP = 1e-3  # of bias current and gap, for the derivatives


def load_remarks(machine: Machine, records: Iterable[Record]) -> tuple[str, ...]:
    """A sentence for each axis whose mean current, u_ or i_ of the first record that has it, changes k_i or k_s by over 1 %."""
    means: dict[str, float] = {}
    for record in records:
        for prefix in ("u_", "i_"):
            for name in record.signals:
                if name.startswith(prefix):
                    means.setdefault(name.removeprefix(prefix), float(record[name].mean()))
    return tuple(text for bearing in machine.bearings for text in _of_bearing(bearing, means))


def _of_bearing(bearing: MagneticBearing, means: dict[str, float]) -> Iterable[str]:
    axes = [f"{bearing.name}_zeta", f"{bearing.name}_eta"]
    try:
        p = magnet.parameters(bearing)
    except InvalidInput:
        return  # no magnet follows from the coefficients
    here, free = (_slopes(p, *currents) for currents in ([means.get(axis, 0.0) for axis in axes], (0.0, 0.0)))
    for axis, (k_i, k_s) in zip(axes, here / free - 1, strict=True):
        if max(abs(k_i), abs(k_s)) > _TOLD:
            yield (
                f"{axis} carries a mean current of {means.get(axis, 0.0):.3g} A: a magnet as in the machine file has there "
                f"{100 * k_i:+.2g} % of k_i and {100 * k_s:+.2g} % of k_s, which the values found contain"
            )


def _slopes(p: tuple[float, ...], *currents: float) -> np.ndarray:
    """k_i [N/A] and k_s [N/m] of zeta and eta (2, 2) at control currents [A], by central differences of the force."""
    found = []
    for axis, gap in ((0, p[5]), (1, p[8])):
        row = []
        for place, step in ((axis, _STEP * p[0]), (2 + axis, _STEP * gap)):
            ends = []
            for sign in (1.0, -1.0):
                at = [*currents, 0.0, 0.0]
                at[place] += sign * step
                ends.append(magnet.force(*at, p)[axis])
            row.append((ends[0] - ends[1]) / (2 * step))
        found.append(row)
    return np.array(found)
