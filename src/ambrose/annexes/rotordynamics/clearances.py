"""Motion at everything that must not touch, and at the vibration probes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.annexes.rotordynamics.response import Response
from ambrose.annexes.rotordynamics.result import Rub
from ambrose.model.static_load import sag_line


@dataclass(frozen=True, slots=True)
class Reading:
    """The largest reading of the vibration probes: p-p [m], probe, case and speed [rad/s]."""

    peak_to_peak: float
    probe: str
    case: str
    speed: float


def largest_reading(response: Response, lowest: float, highest: float) -> Reading:
    """A_max: over all probes and placements, between two speeds [rad/s].

    Without probes in the machine file the journals' major axes stand for them.
    """
    fine = response.fine
    speeds = np.union1d(fine[(fine > lowest) & (fine < highest)], [lowest, highest])
    best = Reading(0.0, "", "", highest)
    for k, case in enumerate(response.cases):
        curves = [(item.name, response.read(item, k, speeds)) for item in response.layout.readings]
        if not curves:
            curves = [
                (j.name, response.major_axis(response.layout.nearest(j.position), k, speeds))
                for j in response.layout.journals
            ]
        for name, amplitude in curves:
            top = int(np.argmax(amplitude))
            if 2 * amplitude[top] > best.peak_to_peak:
                best = Reading(float(2 * amplitude[top]), name, case.name, float(speeds[top]))
    return best


def rubs(response: Response, scale: float) -> tuple[Rub, ...]:
    """Scaled major axis, peak to peak, at every clearance: worst placement and speed of each."""
    layout = response.layout
    offsets = np.abs(sag_line(layout.machine, tuple(gap.position for gap in layout.gaps)))
    found = []
    for gap, offset in zip(layout.gaps, offsets, strict=True):
        station = layout.nearest(gap.position)
        curves = [response.major_axis(station, k) for k in range(len(response.cases))]
        k = int(np.argmax([curve.max() for curve in curves]))
        top = int(np.argmax(curves[k]))
        found.append(
            Rub(
                gap.name,
                gap.kind,
                gap.position,
                gap.diametral,
                float(2 * scale * curves[k][top]),
                float(offset),
                gap.share * gap.diametral,
                float(response.fine[top]),
                response.cases[k].name,
            )
        )
    return tuple(found)
