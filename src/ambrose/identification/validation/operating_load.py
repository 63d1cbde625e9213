"""What the load in a record makes of the magnets' coefficients, beside the load that the machine
file lets them carry.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ambrose.identification.validation.collar_place import at_place
from ambrose.machine.axial import AxialMachine
from ambrose.machine.machine import Machine
from ambrose.model.effects.loaded_magnet import LoadedMagnet, slopes, with_coefficients
from ambrose.model.effects.magnet import MagnetCoefficients
from ambrose.model.ports import sensor_turn
from ambrose.model.static_load import operating_magnets, static_sag
from ambrose.record.record import Record

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
    if isinstance(machine, AxialMachine):
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
    if isinstance(machine, AxialMachine):
        return ()  # its load is the process thrust, stated with the operating point
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
    if isinstance(machine, AxialMachine):
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
