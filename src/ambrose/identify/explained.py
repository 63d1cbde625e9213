"""What the identified model says of every record: its signals beside the measured ones, with the best initial state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.response import simulate
from ambrose.core.statespace import StateSpace
from ambrose.identify.closed_loop import Identification
from ambrose.identify.experiment import experiment
from ambrose.machine.description import Machine
from ambrose.machine.record import Record

_EARLY = 5000  # samples from which the initial state is estimated


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
    bending_modes: int = 1,
    computing_delay: int = 1,
) -> tuple[Explained, ...]:
    """Every record beside the identified model; the arguments as they were identified with. Raises InvalidInput as identify."""
    signals = tuple(dict.fromkeys(signal for _, signal, _ in result.fit))
    given = experiment(
        machine, records, controller, result.paths, signals, None, bending_modes, computing_delay, True, True
    )  # fmt: skip
    found = []
    for record, task in zip(records, given.tasks, strict=True):
        loop, _ = given.models[task.place].loop(result.values)
        mixed = StateSpace(loop.A, loop.B @ task.mix, loop.C, loop.D @ task.mix, None, loop.outputs, loop.dt)
        measured = record.select(signals).values
        found.append(Explained(record, signals, measured, _with_start(mixed, simulate(mixed, np.array(task.e)), measured)))
    return tuple(found)


def _with_start(loop: StateSpace, forced: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """The forced response plus the free one and the offsets that come nearest to what was measured (p, k)."""
    p, k = measured.shape
    early = min(k, _EARLY)
    size = np.maximum(measured.std(axis=1), 1e-300)
    still = np.zeros((len(loop.inputs), early))
    free = [(simulate(loop, still, x0=row) / size[:, None]).ravel() for row in np.eye(loop.n_states)]
    columns = np.column_stack([*free, np.kron(np.eye(p), np.ones((early, 1)))])
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left = ((measured - forced)[:, :early] / size[:, None]).ravel()
    x0 = (np.linalg.lstsq(columns / scale, left, rcond=1e-9)[0] / scale)[: loop.n_states]
    model = forced + simulate(loop, np.zeros((len(loop.inputs), k)), x0=x0)
    return model + (measured - model).mean(axis=1, keepdims=True)
