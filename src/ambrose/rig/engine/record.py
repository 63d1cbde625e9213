"""What a run of the virtual rig leaves: its signals collected in memory and, while it runs, in a
file.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ambrose.core.checks import invalid
from ambrose.record.record import Record, signal_dimension
from ambrose.rig.engine.inputs import Drive, Plan

_LARGEST = 100_000_000  # numbers in one record: 0.8 GB


class Recorder:
    """Takes the logs of one stretch after the other, keeps each ``every``-th sample; a context
    manager for the file's sake.

    Raises InvalidInput for ``every`` below 1 or so small that the record would be too large.
    """

    def __init__(
        self,
        task: Plan,
        every: int,
        seed: int,
        path: str | Path | None,
        beside: Plan | None = None,
    ) -> None:
        """beside: another rig that runs along, whose signals follow."""
        self.task = task
        self.every = every
        self.path = path
        self.names = (*_names(task), *(() if beside is None else _names(beside)))
        count = (task.samples - 1) // max(every, 1) + 1
        if every < 1 or count * len(self.names) > _LARGEST:
            requirement = f"at least 1, and so large that a record has {_LARGEST:g} numbers at most"
            remedy = f"the run has {task.samples} samples of {len(self.names)} signals"
            raise invalid("every", every, requirement, remedy)
        self.units = tuple(signal_dimension(name).unit for name in self.names)
        self.point = replace(task.rig.point, speed=float(task.speeds(np.zeros(1))[0]))
        self.notes = (("scenario", task.scenario.name), ("seed", str(seed)))
        self.values, self.filled = np.empty((len(self.names), count)), 0
        self._writer: Any = None
        self._stack = ExitStack()

    @property
    def rate(self) -> float:
        """Samples per second of the record [Hz]."""
        return 1 / (self.task.dt * self.every)

    def __enter__(self) -> Self:
        if self.path is not None:
            from ambrose.record.writer import RecordWriter

            name = self.task.rig.machine.name
            writer = RecordWriter(
                self.path, name, self.rate, self.names, self.units, self.point, notes=self.notes
            )
            self._writer = self._stack.enter_context(writer)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def add(
        self, number: int, drive: Drive, log: np.ndarray, *beside: tuple[Plan, Drive, np.ndarray]
    ) -> None:
        """One stretch: number of its first sample, what acted, log (k, columns); beside: the same
        of a rig that runs along.
        """
        parts = [(self.task, drive, log), *beside]
        rows = [row for part in parts for row in signals(*part, number)]
        first = (-number) % self.every
        count = len(range(first, len(log), self.every))
        kept = self.values[:, self.filled : self.filled + count]
        at = 0
        for some in rows:
            kept[at : at + len(some)] = some[:, first :: self.every]
            at += len(some)
        self.filled += count
        if self._writer is not None and count:
            self._writer.append(kept)

    def finish(self, outcome: str) -> Record:
        """The record, with the outcome in words among its notes."""
        if self._writer is not None:
            self._writer.note("outcome", outcome)
        values = (
            self.values
            if self.filled == self.values.shape[1]
            else self.values[:, : self.filled].copy()
        )
        values.flags.writeable = False  # a Record then takes it as it is
        notes = (*self.notes, ("outcome", outcome))
        return Record(
            self.task.rig.machine.name,
            self.rate,
            self.names,
            self.units,
            values,
            self.point,
            notes=notes,
        )


def _names(task: Plan) -> tuple[str, ...]:
    """The names of the signals in a record."""
    axes, scenario = task.rig.axes, task.scenario
    names = [f"{kind}_{a}" for kind in ("y", "u", "i", "f_magnet") for a in axes] + [
        f"q_{p}" for p in task.rig.port_names
    ]
    varying = ["speed"] * scenario.runs_up + ["p_seal"] * bool(scenario.pressures)
    varying += ["p_measured"] * bool(scenario.pressure_sensors)
    return (*names, *task.driven, *varying)


def signals(task: Plan, drive: Drive, log: np.ndarray, number: int) -> list[np.ndarray]:
    """All recorded signals of a stretch, a list of rows (some, k)."""
    k = len(log)
    rig = task.rig
    scenario = task.scenario
    sources = {"e": drive.excitation, "r": drive.reference, "d": drive.disturbance}
    rows = [log.T]
    driven = task.driven
    forces = [port for port in rig.port_names if f"f_{port}" in driven]
    for name in driven:
        kind, _, rest = name.partition("_")
        row = (
            drive.force[0, forces.index(rest)]
            if kind == "f"
            else sources[kind][rig.axes.index(rest)]
        )
        rows.append(row[None, :k])
    if scenario.runs_up:
        rows.append(drive.speed[None, :k])
    if scenario.pressures:
        rows.append(task.pressures((number + np.arange(k)) * task.dt)[None])
    if scenario.pressure_sensors:
        rows.append(drive.pressure[None, :k])
    return rows
