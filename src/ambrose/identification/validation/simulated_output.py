"""The identified model driven by every record's excitation: its signals beside the measured
ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.identification.output_error.delays import TimedLoop
from ambrose.identification.output_error.loop_model import ParametricModel, over_weights
from ambrose.identification.output_error.normal_equations import fit, synchronised
from ambrose.identification.output_error.problem import Experiment
from ambrose.record.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedOutput:
    """measured (p, k), as in the record, and model (p, k) of ``signals``, SI; the model with the
    estimated initial state and offset, and what turns with the rotor.
    """

    record: Record
    signals: tuple[str, ...]
    model: np.ndarray

    @property
    def measured(self) -> np.ndarray:
        return np.array([self.record[name] for name in self.signals])

    @property
    def residual(self) -> np.ndarray:
        return self.measured - self.model

    def rows(self, names: Sequence[str] | None = None) -> Iterator[tuple[str, np.ndarray]]:
        """Name and residual (k,) of one signal after the other, all or those named."""
        for name, model in zip(self.signals, self.model, strict=True):
            if names is None or name in names:
                yield name, self.record[name] - model


def simulate_outputs(
    experiment: Experiment, records: Sequence[Record], theta: np.ndarray
) -> tuple[SimulatedOutput, ...]:
    """Every record of an experiment with the model's outputs at theta (q,); the signals are those
    of the experiment.
    """
    signals = experiment.signals
    unit = experiment.sizes
    outputs = []
    for record, task in zip(records, experiment.tasks, strict=True):
        model, free = experiment.models[task.place], replace(task, initial_state=True, offset=True)
        loop = over_weights(model, theta, experiment.sizes)[0]
        part, response = (
            _fitted_part(record, model, task.samples),
            fit(loop, synchronised(loop, free))[0],
        )
        for name, row, size in zip(
            signals, response, unit, strict=True
        ):  # of the residual, the model
            row[:] = part[name] - row * size
        outputs.append(SimulatedOutput(part, signals, response))
    return tuple(outputs)


def _fitted_part(record: Record, model: ParametricModel, samples: int) -> Record:
    """The part of a record that was fitted: with an unknown delay of the excitation some samples at
    both ends are not.
    """
    skipped = model.skipped if isinstance(model, TimedLoop) else 0
    if samples == record.values.shape[1]:
        return record
    values = record.values[:, skipped : skipped + samples].copy()
    return replace(record, values=values, start_time=record.start_time + skipped * record.dt)
