"""The C code of a scheduled block, compiled and running here: in the virtual rig, told the speed at every sample."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_shape
from ambrose.core.statespace import StateSpace
from ambrose.deployment.block.scheduled import ScheduledBlock, transfers
from ambrose.deployment.c.compiled import library, pointer, probed
from ambrose.deployment.c.scheduled import Precision, generate_scheduled


class CompiledSchedule:
    """A scheduled block's C code in this process: errors [m] and speeds [rad/s] to currents [A].

    sample_time [s], delay [samples], system, schedule: as the rig asks of a program; called with a speed [rad/s]: the law
    there, frozen; status: the bits of the last step.
    """

    def __init__(self, block: ScheduledBlock, arithmetic: Precision = "double", compiler: str | None = None) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        self.block, self.arithmetic, self.status = block, arithmetic, 0
        self._kind: Any = np.float64 if arithmetic == "double" else np.float32
        self._word = ctypes.c_double if arithmetic == "double" else ctypes.c_float
        self._library = library(block.name, generate_scheduled(block, arithmetic), compiler)
        size = self._library[f"{block.name}_size"]
        size.restype = ctypes.c_size_t
        self._memory = ctypes.create_string_buffer(size())
        self._errors: np.ndarray = np.zeros(len(block.inputs), self._kind)
        self._currents: np.ndarray = np.zeros(len(block.outputs), self._kind)
        self.speed = block.range[0]
        self._call("init")

    @property
    def sample_time(self) -> float:
        return self.block.sample_time

    @property
    def delay(self) -> int:
        return self.block.delay

    @property
    def system(self) -> StateSpace:
        """The law at the speed of the next step."""
        return self.block.at(self.speed)

    def __call__(self, speed: float) -> StateSpace:
        return self.block.at(speed)

    def schedule(self, speed: float) -> None:
        """The speed [rad/s] of the next step; NaN: not known."""
        self.speed = speed

    def begin(self, states: np.ndarray) -> None:
        """Everything as after its first call, then the states (n,)."""
        self._call("init")
        self._state_memory()[:] = states

    def track(self, errors: np.ndarray, currents: np.ndarray) -> None:
        """Bumpless transfer to errors (m,) [m] and currents (p,) [A]. Raises InvalidInput for a block that cannot."""
        if not transfers(self.block):
            raise InvalidInput("this block has no bumpless transfer: its states do not reach every output; begin it at rest")
        self._errors[:], self._currents[:] = errors, currents
        self._call("track", pointer(self._errors), None, self._word(self.speed), pointer(self._currents))

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample at the scheduled speed: currents (p,) [A] from errors (m,) [m]."""
        self._errors[:] = errors
        self.status = int(self._call("step", pointer(self._errors), None, self._word(self.speed), pointer(self._currents)))
        return self._currents.astype(float)

    def run(self, errors: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """currents (k, p) [A] over errors (k, m) [m] and speeds (k,) [rad/s], from the present state."""
        e = check_shape(errors, "errors", "(k, m)", m=len(self.block.inputs))
        found = []
        for row, speed in zip(e, np.asarray(speeds, float), strict=True):
            self.schedule(float(speed))
            found.append(self.step(row))
        return np.array(found).reshape(len(e), len(self.block.outputs))

    def states(self) -> np.ndarray:
        """The states (n,) as they stand in the code's memory, 1 being their bound at a frozen speed."""
        return self._state_memory().astype(float)

    def _state_memory(self) -> np.ndarray:
        return np.frombuffer(memoryview(self._memory), self._kind, self.block.n_states)

    def _call(self, verb: str, *arguments: Any) -> Any:
        return self._library[f"{self.block.name}_{verb}"](self._memory, *arguments)


def probed_at(code: CompiledSchedule, speed: float) -> StateSpace:
    """The law that the running code follows at a frozen speed [rad/s], as ``compiled.probed`` reads it.

    Raises InvalidInput where a current stays limited, or the speed clamped, however small the step.
    """
    code.schedule(speed)
    return probed(code)
