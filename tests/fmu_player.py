"""Runs an FMU through FMPy (an importer that is not ours), FMI 2.0 or 3.0 alike, sample by
sample.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave


class Player:
    """One instance of an FMU file, with its variables by name."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.description = fmpy.read_model_description(str(path), validate=True)
        self.folder = fmpy.extract(str(path), str(folder))
        self.refs = {v.name: v.valueReference for v in self.description.modelVariables}
        self.three = self.description.fmiVersion == "3.0"
        self.time = 0.0
        self.fmu = self.loaded()

    def loaded(self, token: str | None = None) -> Any:
        make = FMU3Slave if self.three else FMU2Slave
        found = make(
            guid=token or self.description.guid,
            unzipDirectory=self.folder,
            instanceName="one",
            modelIdentifier=self.description.coSimulation.modelIdentifier,
        )
        found.instantiate()
        return found

    def begin(self) -> None:
        self.time = 0.0
        if not self.three:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()

    def set(self, names: list[str], values: Any) -> None:
        (self.fmu.setFloat64 if self.three else self.fmu.setReal)(
            [self.refs[n] for n in names], list(values)
        )

    def set_flags(self, names: list[str], values: Any) -> None:
        self.fmu.setBoolean([self.refs[n] for n in names], [bool(v) for v in values])

    def get(self, names: list[str]) -> list[float]:
        return (self.fmu.getFloat64 if self.three else self.fmu.getReal)(
            [self.refs[n] for n in names]
        )

    def get_flags(self, names: list[str]) -> list[bool]:
        return [bool(v) for v in self.fmu.getBoolean([self.refs[n] for n in names])]

    def step(self, dt: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=dt)
        self.time += dt

    def saved(self) -> Any:
        return self.fmu.getFMUState() if self.three else self.fmu.getFMUstate()

    def restore(self, state: Any) -> None:
        (self.fmu.setFMUState if self.three else self.fmu.setFMUstate)(state)

    def free(self, state: Any) -> None:
        (self.fmu.freeFMUState if self.three else self.fmu.freeFMUstate)(state)

    def as_bytes(self, state: Any) -> bytes:
        return (self.fmu.serializeFMUState if self.three else self.fmu.serializeFMUstate)(state)

    def from_bytes(self, content: bytes) -> Any:
        return (self.fmu.deserializeFMUState if self.three else self.fmu.deSerializeFMUstate)(
            content
        )

    def play(
        self,
        block: Any,
        errors: np.ndarray,
        valid: np.ndarray | None = None,
        direct: bool = False,
        told: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Currents (k, p) and status (k,): read after each step, or, where they answer at once,
        before it. told (k,): what a scheduled block is told.
        """
        inputs, outputs = list(block.inputs), list(block.outputs)
        flags, every = [f"valid_{name}" for name in inputs], ["held", "fault", "limited"]
        every += [] if told is None else ["clamped", f"{block.along.name}_held", "behind"]
        currents, status = np.empty((len(errors), len(outputs))), np.empty(len(errors), int)
        for k, e in enumerate(errors):
            self.set(inputs, e)
            if valid is not None:
                self.set_flags(flags, valid[k])
            if told is not None:
                self.set([block.along.name], [told[k]])
            if not direct:
                self.step(block.sample_time)
            currents[k] = self.get(outputs)
            status[k] = sum(flag << bit for bit, flag in enumerate(self.get_flags(every)))
            if direct:
                self.step(block.sample_time)
        return currents, status
