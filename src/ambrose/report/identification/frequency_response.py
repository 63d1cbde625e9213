"""Measured plant beside the identified model over frequency: magnitude, phase, error and coherence, with confidence bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf import spectral as frf
from ambrose.identification.frf.validity import compare, model_response
from ambrose.identification.parameters import plant_at
from ambrose.identification.result import LoopIdentification
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record
from ambrose.report import units
from ambrose.report.figures.seals import response_figure

_DECADES = 4.0  # of magnitude that are shown


def frf_figure(machine: Machine, checked: LoopIdentification) -> tuple[Any, str] | None:
    """The plant from the amplifiers' command u + e to the displacements, axis by axis, measured, identified and as it was.

    Measured by the joint input-output method, or None where the records do not allow it (u_ or some excitations are missing, or
    several excitations are the same). The first four axes are shown. With the figure: up to where the model agrees, in words.
    """
    result, shown = checked.result, machine.axes[:4]
    at = (result.point.seal_pressure, result.point.speed)
    records = [o.record for o in checked.outputs if (o.record.point.seal_pressure, o.record.point.speed) == at]
    whole = _measured(records, machine.axes)
    if whole is None:
        return None
    whole = _visible(whole)
    models = {}
    for label, theta in (("identified", result.values), ("start", result.start)):
        values = dict(zip(result.paths, theta.tolist(), strict=True))
        models[label] = model_response(whole, plant_at(machine, result.point, values, checked.bending_modes).system)
    validity = compare(whole, models["identified"])
    names = {axis: units.axis_name(axis) for axis in shown}
    measured = {names[axis]: whole.select(f"v_{axis}", f"y_{axis}") for axis in shown}
    beside: Mapping[str, Mapping[str, FrequencyResponse]] = {
        names[axis]: {label: model.select(f"u_{axis}", f"y_{axis}") for label, model in models.items()} for axis in shown
    }
    reach = {names[axis]: float(validity.valid_to[i, i]) for i, axis in enumerate(machine.axes) if axis in shown}
    figure = response_figure(measured, beside, valid_to={name: end for name, end in reach.items() if end > 0})
    figure.update_annotations(font={"size": 13})
    low = min(reach.values())
    words = (
        f"On every axis the identified model agrees within 10 % and 10° up to {units.quantity(low, 'rad/s')} (dashed)."
        if low > 0
        else "The identified model leaves the measured response by more than 10 % or 10° from the first frequencies on."
    )
    return figure, words


def _measured(records: Sequence[Record], axes: Sequence[str]) -> frf.Frf | None:
    if not records:
        return None
    shortest = min(record.values.shape[1] / record.sample_rate_hz for record in records)
    inputs, outputs = [f"v_{axis}" for axis in axes], [f"y_{axis}" for axis in axes]
    try:
        return frf.closed_loop(records, inputs, outputs, segment=min(0.5, shortest / 8))
    except InvalidInput:
        return None


def _visible(measured: frf.Frf) -> frf.Frf:
    """The lines up to the last at which every axis still responds within some decades of its largest."""
    sizes = np.abs(np.diagonal(measured.values, axis1=1, axis2=2))
    visible = np.flatnonzero((sizes > sizes.max(axis=0) / 10**_DECADES).all(axis=1))
    return measured.between(float(measured.omega[0]), float(measured.omega[visible[-1] if len(visible) else -1]))
