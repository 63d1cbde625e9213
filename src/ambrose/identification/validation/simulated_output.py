"""The identified model driven by every record's excitation: its signals beside the measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.identification.output_error.delays import TimedLoop
from ambrose.identification.output_error.loop_model import ParametricModel, over_weights
from ambrose.identification.output_error.normal_equations import fit, synchronised
from ambrose.identification.output_error.problem import Experiment
from ambrose.machine.record.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedOutput:
    """measured (p, k) and model (p, k) of ``signals``, SI; the model with the estimated initial state and offset, and what
    turns with the rotor."""

    record: Record
    signals: tuple[str, ...]
    measured: np.ndarray
    model: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        return self.measured - self.model


def simulate_outputs(experiment: Experiment, records: Sequence[Record], theta: np.ndarray) -> tuple[SimulatedOutput, ...]:
    """Every record of an experiment with the model's outputs at theta (q,); the signals are those of the experiment."""
    signals, unit, outputs = experiment.signals, experiment.sizes[:, None], []
    for record, task in zip(records, experiment.tasks, strict=True):
        model, free = experiment.models[task.place], replace(task, initial_state=True, offset=True)
        loop = over_weights(model, theta, experiment.sizes)[0]
        residual = fit(loop, synchronised(loop, free))[0] * unit
        part = _fitted_part(record, model, task.samples)
        measured = part.select(signals).values
        outputs.append(SimulatedOutput(part, signals, measured, measured - residual))
    return tuple(outputs)


def _fitted_part(record: Record, model: ParametricModel, samples: int) -> Record:
    """The part of a record that was fitted: with an unknown delay of the excitation some samples at both ends are not."""
    skipped = model.skipped if isinstance(model, TimedLoop) else 0
    if samples == record.values.shape[1]:
        return record
    values = record.values[:, skipped : skipped + samples].copy()
    return replace(record, values=values, start_time=record.start_time + skipped * record.dt)
