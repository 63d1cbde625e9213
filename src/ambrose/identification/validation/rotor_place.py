"""Where the rotor stood in a record, and the magnets' coefficients at the sensors' zero.

A controller without integral action lets the weight pull the rotor off the sensors' zero. The
record then tells k_i and k_s of that place and of the currents there; the machine file states them
at the zero, where the next controller may hold the rotor. On the seal rig 2 um make 0.9 % of k_s,
twenty standard deviations.

The plant, at rest, says what the way back takes. With its gains G_y and G_q from currents to
sensors and magnets, about the same load,

    i_off = G_y^-1 mean(y),   q = G_q i_off,   i_zero = i - i_off,

and both coefficients change by the ratio of the force law's slopes at (i_zero, 0) and at (i, q).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.statespace import select
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import plant_at
from ambrose.identification.validation.operating_load import mean_currents, sensor_scales
from ambrose.machine.axial import AxialMachine
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter
from ambrose.model.effects.loaded_magnet import slopes
from ambrose.model.plant import Plant
from ambrose.model.static_load import operating_magnets, static_sag
from ambrose.record.record import Record

_STANDS = 1e-3  # of the gap: a mean displacement below is the excitation's, or noise
_OF_LAW = 0.05  # of the change: how well the force law tells it, standard deviation; assumed
_TOLD = 1e-3  # relative change of a coefficient that is worth a sentence


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """places {axis: [m]} of the rotor at the magnets off the sensors' zero, currents {axis: [A]}
    that would hold it there, of the first record; ratios (q,): of the parameters at the zero over
    those where it stood, the mean of all records, and their spread (q,) between records.
    """

    places: Mapping[str, float]
    currents: Mapping[str, float]
    ratios: np.ndarray
    spread: np.ndarray

    @property
    def words(self) -> str:
        """One sentence without its stop; "" where it changes nothing to speak of."""
        change = float(np.abs(self.ratios - 1).max(initial=0.0))
        if change < _TOLD:
            return ""
        axis = max(self.places, key=lambda name: abs(self.places[name]))
        return (
            f"the rotor stood {1e6 * self.places[axis]:+.2g} um off the sensors' zero at {axis}, "
            f"which makes up to {100 * change:.2g} % of a magnet's coefficient: the values are "
            "those at the zero"
        )

    def carried(self, result: ParameterEstimate) -> ParameterEstimate:
        """The estimate with its values at the sensors' zero."""
        moved = replace(
            result,
            values=result.values * self.ratios,
            covariance=result.covariance * np.outer(self.ratios, self.ratios),
        )
        unsure = np.hypot(self.spread, _OF_LAW * (self.ratios - 1))
        return moved.widened(np.hypot(moved.standard_deviations, np.abs(moved.values) * unsure))


def standing(
    machine: Machine,
    records: Sequence[Record],
    result: ParameterEstimate,
    loads: Mapping[str, float],
    bending_modes: int,
) -> Standing | None:
    """Where the rotor stood; None where the records do not say so, or it is at the zero.

    loads {axis: [A]}: static currents found, for records without currents; else those that the
    machine file's weight needs.
    """
    if isinstance(machine, AxialMachine) or not machine.bearings:
        return None
    values = {
        path: float(value)
        for path, value in zip(result.paths, result.values, strict=True)
        if path not in TIMING
    }
    found = []
    for record in records:
        place = _offset(machine, record, values, bending_modes)
        if place is None:
            return None
        found.append((*place, *_ratios(machine, record, result.paths, place, loads)))
    ratios = np.array([item[-1] for item in found])
    q, _, currents, _ = found[0]
    return Standing(
        dict(zip(machine.axes, q.tolist(), strict=True)),
        dict(zip(machine.axes, currents.tolist(), strict=True)),
        ratios.mean(axis=0),
        np.ptp(ratios, axis=0) / 2,
    )


def _offset(
    machine: Machine, record: Record, values: Mapping[str, float], bending_modes: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Place (a,) [m] at the magnets and the currents (a,) [A] that it takes, about the load; None
    where not all displacements are recorded, or their means are next to nothing.
    """
    names = [f"y_{axis}" for axis in machine.axes]
    if not set(names) <= set(record.signals):
        return None
    # what the sensors read at their zero is no displacement
    y = np.array([float(record[name].mean()) for name in names]) - sensor_scales(machine)[1]
    gaps = [bearing.gap or bearing.touchdown_gap or np.inf for bearing in machine.bearings]
    if np.abs(y).max() < _STANDS * min(gaps):
        return None
    plant = plant_at(machine, record.point, values, bending_modes)
    G_y, G_q = _at_rest(plant, "y"), _at_rest(plant, "q")
    i_off = np.linalg.lstsq(G_y, y)[0]
    return G_q @ i_off, i_off


def _at_rest(plant: Plant, kind: str) -> np.ndarray:
    """D - C A^-1 B (a, a) from currents u_<axis> to the signals <kind>_<axis>."""
    axes = plant.axes
    part = select(plant.system, [f"u_{a}" for a in axes], [f"{kind}_{a}" for a in axes])
    return np.asarray(part.D - part.C @ np.linalg.solve(part.A, part.B))


def _ratios(
    machine: Machine,
    record: Record,
    paths: Sequence[str],
    place: tuple[np.ndarray, np.ndarray],
    loads: Mapping[str, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Currents (a,) [A] at the sensors' zero, and the ratios (q,) of ``Standing``."""
    bias = record.point.bias_current
    magnets, axes = operating_magnets(machine, bias), machine.axes
    by_file = dict(zip(axes, (i for item in magnets for i in item.currents), strict=True))
    q, i_off = place
    measured = mean_currents(machine, record)
    currents = np.array(
        [
            measured[axis] - i_off[j] if axis in measured else loads.get(axis, by_file[axis])
            for j, axis in enumerate(axes)
        ]
    )
    sag = static_sag(machine)[0].ravel()
    ratio_of: dict[tuple[str, str, str], float] = {}
    for n, (bearing, item) in enumerate(zip(machine.bearings, magnets, strict=True)):
        if item.parameters is None:
            continue
        own = slice(2 * n, 2 * n + 2)
        there, here = (
            slopes(item.parameters, (i[0], i[1]), (x[0], x[1]))
            for i, x in (
                ((currents + i_off)[own].tolist(), (sag + q)[own].tolist()),
                (currents[own].tolist(), sag[own].tolist()),
            )
        )
        for quantity in ("force_per_current", "negative_stiffness"):
            pairs = zip(getattr(here, quantity), getattr(there, quantity), strict=True)
            for way, (at_zero, stood) in zip(("zeta", "eta"), pairs, strict=True):
                ratio_of[bearing.name, quantity, way] = float(at_zero / stood)
    ratios = np.ones(len(paths))
    for k, path in enumerate(paths):
        if path in TIMING:
            continue
        parameter = parse_parameter(path)
        if parameter.table == "bearing":
            ways = [parameter.component] if parameter.component else ["zeta", "eta"]
            own_ratios = [
                ratio_of.get((parameter.name, parameter.quantity, way), 1.0) for way in ways
            ]
            ratios[k] = float(np.mean(own_ratios))
    return currents, ratios
