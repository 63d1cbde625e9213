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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import select
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import plant_at
from ambrose.machine.description import OperatingPoint, Operation
from ambrose.machine.machine import Condition, Machine
from ambrose.machine.parameters import TIMING, parse_parameter
from ambrose.model.axial import at_point, force, with_found
from ambrose.model.effects.magnet import LoadedMagnet, MagnetCoefficients, slopes, with_coefficients
from ambrose.model.plant import Plant, sensor_turn
from ambrose.model.static_load import operating_magnets, static_sag
from ambrose.record.record import Record

# Where a record's collar stands along the shaft: its thrust magnets' coefficients are those of that
# place.
#
# A controller without integral action lets the process thrust push the collar off, to where its
# static stiffness holds it. k_i goes with 1/g^2 and k_s with 1/g^3 of either gap, and the two
# magnets of a loaded pair do not make up for each other: 12 um of a gap of 400 um are two per cent
# of k_s.


_APART = 0.01  # of the smaller gap: places of two records that are one
_OTHER = 0.1  # of the largest process thrust: a force that the magnets found do not carry


def at_place(machine: Machine, records: Sequence[Record]) -> Machine:
    """The axis with the collar where the displacements' means in the records put it, at the
    records' operating points; as it is where these are zero, and a machine of other axes.

    Raises InvalidInput for records of one point whose collars stand at different places.
    """
    if machine.lateral:
        return machine
    (axis,) = machine.axes
    gain = machine.thrust.sensor.gain
    allowed = _APART * min(machine.thrust.gap)
    places: dict[tuple[float, float], tuple[int, float]] = {}
    for number, record in enumerate(records, 1):
        if f"y_{axis}" not in record.signals:
            continue
        # y = gain (x - place): what the mean adds to the place where the sensor reads zero
        moved = float(record[f"y_{axis}"].mean()) / gain
        at = (record.point.speed, record.point.seal_pressure)
        first, before = places.setdefault(at, (number, moved))
        if abs(moved - before) > allowed:
            raise InvalidInput(
                f"the collar stands {1e6 * before:+.4g} um off the sensor's zero in record {first} "
                f"and {1e6 * moved:+.4g} um in record {number}: its coefficients are others there; "
                "identify the records one by one"
            )
    points, conditions = list(machine.operation.points), list(machine.conditions)
    for (speed, pressure), (_, moved) in places.items():
        if not moved:
            continue
        at_record = OperatingPoint(speed, pressure)
        known = machine.condition(at_record)
        stands = Condition(known.label, known.load, known.place + moved)
        # the first at this speed and pressure is the one that a record means
        same = [(item.speed, item.seal_pressure) == (speed, pressure) for item in points]
        if any(same):
            conditions[same.index(True)] = replace(stands, label=conditions[same.index(True)].label)
        else:
            points.append(at_record)
            conditions.append(stands)
    if conditions == list(machine.conditions):
        return machine
    operation = Operation(tuple(points), design_point=machine.operation.design_point)
    stated: dict[str, Any] = {"operation": operation, "conditions": tuple(conditions)}
    return replace(machine, **stated)


def thrust_findings(
    machine: Machine,
    values: dict[str, float],
    point: OperatingPoint,
    records: Sequence[Record],
) -> Iterator[Finding]:
    """A warning where the magnets that were found, {quantity: value}, would carry another force
    with the recorded mean current than the thrust of the operating point.
    """
    (axis,), at = machine.axes, machine.condition(point)
    part, nominal = machine.thrust, at_point(machine, point)
    k_i = values.get("force_per_current", nominal.force_per_current)
    k_s = values.get("negative_stiffness", nominal.stiffness)
    try:
        part = with_found(part, at.load, at.place, k_i, k_s)
    except InvalidInput:
        return  # said where the machine is written
    largest = max(abs(item.load) for item in machine.conditions)
    for number, record in enumerate(records, 1):
        name = next((f"{kind}_{axis}" for kind in "iu" if f"{kind}_{axis}" in record.signals), "")
        if not name or record.point.speed != point.speed:
            continue
        current = float(np.mean(record[name]))
        carried = -force(part, current, at.place) + part.coupling_stiffness * at.place
        if abs(carried - at.load) > _OTHER * max(largest, abs(carried)):
            yield Finding(
                Code.OTHER_LOAD,
                WARNING,
                f"record {number} was taken under another thrust than its operating point states",
                f"a mean current of {current:.3g} A carries {carried:,.3g} N, the point states "
                f"{at.load:,.3g} N, and k_i and k_s are found for the stated one",
                "correct the point's [[thrust_bearing.load]], or the speed of the record, which "
                "selects the operating point",
            )


# What the load in a record makes of the magnets' coefficients, beside the load that the machine
# file lets them carry.


_TOLD = 0.01  # relative change of a coefficient that is worth a sentence
# relative difference of the static currents from which on the machine file is doubted
_DOUBTED = 0.1
_CARRIED = 0.1  # of the current that the weight needs, below which a record's mean is not the load


def machine_at_load(machine: Machine, records: Sequence[Record]) -> Machine:
    """The machine with the coefficients of its magnets at the mean currents, u_ or i_ of the first
    record that has them, and as far off the magnets' centre as the rotor stands there; as it
    is, where the records hold no currents, or hold them without their mean. The axis along the
    shaft: with the collar at its mean place.
    """
    if not machine.lateral:
        return at_place(machine, records)
    means = recorded_means(records)
    if not means or _without_mean(machine, means, _bias(records)):
        return machine
    bias, bearings = _bias(records), list(machine.bearings)
    stands = _displaced(machine, records)
    for j, (item, coefficients) in enumerate(_at_currents(machine, means, bias, stands)):
        if coefficients is not None and item.parameters is not None:
            bearings[j] = with_coefficients(bearings[j], item.parameters[0], coefficients)
    return replace(machine, bearings=tuple(bearings))


def load_remarks(
    machine: Machine,
    records: Sequence[Record],
    loads: Mapping[str, float] | None = None,
    at_zero: Mapping[str, float] | None = None,
) -> tuple[str, ...]:
    """A sentence for each axis whose mean current changes k_i or k_s by over 1 % against the load
    of the machine file: u_ or i_ of the first record that has it, else the one of ``loads`` {axis:
    [A]}; ``at_zero`` {axis: [A]}, where the rotor stood off the sensors' zero, before all.
    """
    if not machine.bearings:  # the load of the thrust axis is stated with the operating point
        return ()
    means = recorded_means(records)
    if _without_mean(machine, means, _bias(records)):
        means = {}
    means = {**(loads or {}), **means, **(at_zero or {})}
    at_bearings = zip(machine.bearings, _at_currents(machine, means, _bias(records)), strict=True)
    return tuple(
        text
        for bearing, (item, coefficients) in at_bearings
        for text in _of_bearing(bearing.name, item, coefficients, means)
    )


def load_doubt(machine: Machine, records: Sequence[Record]) -> str:
    """Why a machine file whose magnets need other currents for the weight than were recorded is not
    to be relied on; "" where they agree within a tenth, or there is nothing to compare.
    """
    if not machine.bearings:
        return ""
    means, bias = recorded_means(records), _bias(records)
    needed = _needed_currents(machine, bias)
    known = [axis for axis in means if axis in needed]
    size = float(np.linalg.norm([needed[axis] for axis in known]))
    if size == 0.0 or _without_mean(machine, means, bias):
        return ""
    share = float(np.linalg.norm([means[axis] for axis in known])) / size
    if abs(share - 1) <= _DOUBTED:
        return ""
    return (
        f"the magnets carry the rotor with {share:.3g} times the current that the machine file "
        "says: k_i, bias or weight are "
        "others, and what the model says is as wrong; identify the machine first"
    )


def mean_currents(machine: Machine, record: Record) -> dict[str, float]:
    """{axis: [A]} of a record's u_ or i_, as far as it has them; none where they hold no mean."""
    means = recorded_means([record])
    return {} if _without_mean(machine, means, record.point.bias_current) else means


def _bias(records: Sequence[Record]) -> float | None:
    """The bias current [A] of the records, which is one for all; None: the bearings' own."""
    return records[0].point.bias_current if records else None


def recorded_means(records: Iterable[Record]) -> dict[str, float]:
    """{axis: [A]} of u_ or i_ of the first record that has it."""
    means: dict[str, float] = {}
    for record in records:
        for prefix in ("u_", "i_"):
            for name in record.signals:
                if name.startswith(prefix):
                    means.setdefault(name.removeprefix(prefix), float(record[name].mean()))
    return means


def _displaced(machine: Machine, records: Sequence[Record]) -> np.ndarray:
    """Mean displacements (b, 2) [m] of the first record, zero where it has none: at the sensors,
    taken for those at the magnets.
    """
    names = [f"y_{axis}" for axis in machine.axes]
    signals = records[0].signals if records else ()
    if not set(names) <= set(signals):
        return np.zeros((len(machine.bearings), 2))
    gain, offset = sensor_scales(machine)
    y = np.array([float(records[0][name].mean()) for name in names])
    return np.asarray(sensor_turn(machine) @ ((y - offset) / gain)).reshape(-1, 2)


def sensor_scales(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Gain (a,) and offset (a,) [m] of every measured displacement; of several pairs the mean, as a
    record holds it.
    """
    rows = [
        [(sensor.gain, sensor.offset) for sensor in machine.sensors if sensor.bearing == item.name]
        for item in machine.bearings
    ]
    # gain and offset of a bearing without a sensor: as they are
    means = np.array([np.mean(row or [((1.0, 1.0), (0.0, 0.0))], axis=0) for row in rows])
    return means[:, 0].ravel(), means[:, 1].ravel()


def _needed_currents(machine: Machine, bias: float | None) -> dict[str, float]:
    """Mean control current [A] of every axis that carries the machine's static load."""
    currents = (i for item in operating_magnets(machine, bias) for i in item.currents)
    return dict(zip(machine.axes, currents, strict=True))


def _without_mean(machine: Machine, means: Mapping[str, float], bias: float | None) -> bool:
    """Whether recorded currents hold next to nothing of what the weight needs: a logger or a linear
    loop left it out.
    """
    needed = _needed_currents(machine, bias)
    known = [axis for axis in means if axis in needed]
    return float(np.linalg.norm([means[a] for a in known])) < _CARRIED * float(
        np.linalg.norm([needed[a] for a in known])
    )


def _at_currents(
    machine: Machine,
    means: Mapping[str, float],
    bias: float | None,
    stands: np.ndarray | float = 0.0,
) -> Iterator[tuple[LoadedMagnet, MagnetCoefficients | None]]:
    """Every bearing's magnets as the machine file lets them work, and their coefficients at mean
    currents and ``stands`` (b, 2) [m] off the sensors' zero; None where it has none of them, or no
    magnet follows from the file.
    """
    magnets, places = operating_magnets(machine, bias), static_sag(machine)[0] + stands
    for bearing, item, place in zip(machine.bearings, magnets, places, strict=True):
        axes = [f"{bearing.name}_{way}" for way in ("zeta", "eta")]
        if item.parameters is None or not any(axis in means for axis in axes):
            yield item, None
            continue
        zeta, eta = (
            means.get(axis, current) for axis, current in zip(axes, item.currents, strict=True)
        )
        yield item, slopes(item.parameters, (zeta, eta), (float(place[0]), float(place[1])))


def _of_bearing(
    name: str,
    item: LoadedMagnet,
    coefficients: MagnetCoefficients | None,
    means: Mapping[str, float],
) -> Iterator[str]:
    """A sentence for each axis of a bearing whose ``coefficients`` at the mean currents differ from
    those at the file's load, ``item``.
    """
    if coefficients is None:
        return
    k_i, k_s = (
        np.array(getattr(coefficients, quantity)) / np.array(getattr(item.coefficients, quantity))
        - 1
        for quantity in ("force_per_current", "negative_stiffness")
    )
    for way, current, of_k_i, of_k_s in zip(("zeta", "eta"), item.currents, k_i, k_s, strict=True):
        axis = f"{name}_{way}"
        if axis in means and max(abs(of_k_i), abs(of_k_s)) > _TOLD:
            yield (
                f"{axis} carries a mean current of {means[axis]:.3g} A, by the weight in the "
                f"machine file {current:.3g} A: this "
                f"makes {100 * of_k_i:+.2g} % of k_i and {100 * of_k_s:+.2g} % of k_s, which the "
                "values found contain"
            )


_STANDS = 1e-3  # of the gap: a mean displacement below is the excitation's, or noise
_OF_LAW = 0.05  # of the change: how well the force law tells it, standard deviation; assumed
_SAID = 1e-3  # relative change of a coefficient that is worth a sentence


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
        if change < _SAID:
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
    if not machine.bearings:
        return None
    values = {
        path: float(value)
        for path, value in zip(result.paths, result.values, strict=True)
        if path not in TIMING
    }
    of_records = []
    for record in records:
        place = _offset(machine, record, values, bending_modes)
        if place is None:
            return None
        of_records.append((*place, *_ratios(machine, record, result.paths, place, loads)))
    ratios = np.array([item[-1] for item in of_records])
    q, _, currents, _ = of_records[0]
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
        # the bearing's two axes: slopes where the rotor stood, and at the sensors' zero
        both = slice(2 * n, 2 * n + 2)
        there, here = (
            slopes(item.parameters, (i[0], i[1]), (x[0], x[1]))
            for i, x in (
                ((currents + i_off)[both].tolist(), (sag + q)[both].tolist()),
                (currents[both].tolist(), sag[both].tolist()),
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
            of_ways = [ratio_of.get((parameter.name, parameter.quantity, way), 1.0) for way in ways]
            ratios[k] = float(np.mean(of_ways))
    return currents, ratios
