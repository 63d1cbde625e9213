"""What the identified model says of every record: its signals beside the measured ones, with the best initial state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.closed_loop import Identification
from ambrose.identification.output_error.delays import AHEAD, TimedLoop
from ambrose.identification.output_error.normal_equations import fit
from ambrose.identification.output_error.problem import experiment
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """measured (p, k) and model (p, k) of ``signals``, SI; the model with the estimated initial state and offset."""

    record: Record
    signals: tuple[str, ...]
    measured: np.ndarray
    model: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        return self.measured - self.model


def explained(
    machine: Machine,
    records: Sequence[Record],
    controller: Any,
    result: Identification,
    *,
    signals: Sequence[str] | None = None,
    bending_modes: int = 1,
    computing_delay: float = 1,
) -> tuple[Explained, ...]:
    """Every record beside the identified model; the arguments as they were identified with. Raises InvalidInput as identify.

    signals: those shown (None: those fitted).
    """
    signals = tuple(signals or dict.fromkeys(signal for _, signal, _ in result.fit))
    given = experiment(machine, records, controller, result.paths, signals, None, bending_modes, computing_delay, True, True)
    found = []
    for record, task in zip(records, given.tasks, strict=True):
        model = given.models[task.place]
        loop, _ = model.loop(result.values)
        unit = given.sizes[:, None]
        mixed = StateSpace(loop.A, loop.B @ task.mix, loop.C / unit, loop.D @ task.mix / unit, None, loop.outputs, loop.dt)
        residual = fit(mixed, task).residual * unit
        part = _aligned(record, model, task.samples)
        measured = part.select(signals).values
        found.append(Explained(part, signals, measured, measured - residual))
    return tuple(found)


def _aligned(record: Record, model: Any, samples: int) -> Record:
    """The part of a record that was fitted: with an unknown delay of the excitation some samples at both ends are not."""
    skipped = model.longest[1] - AHEAD if isinstance(model, TimedLoop) and model.longest[1] else 0
    if samples == record.values.shape[1]:
        return record
    values = record.values[:, skipped : skipped + samples].copy()
    return replace(record, values=values, start_time=record.start_time + skipped * record.dt)
