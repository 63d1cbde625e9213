"""The generated C code, compiled and running here: software in the loop.

``CompiledBlock`` runs in the virtual rig in place of a controller (``plant.control_program``), ``CompiledSchedule`` in
place of a scheduled one, given the speed at every sample. ``read_law`` reads the law back out of the running code, so that the
same verification can be made of what the compiler made.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

import numpy as np

from ambrose.core.checks import InvalidInput, check_shape
from ambrose.core.statespace import StateSpace
from ambrose.deployment.block.cost import padding_of
from ambrose.deployment.block.fixed import ControlBlock
from ambrose.deployment.block.scheduled import ScheduledBlock
from ambrose.deployment.c.code import Arithmetic, Precision, generate, in_words
from ambrose.deployment.c.compiler import COMPILERS, build_library, find_compiler, load_library

_FLAGS = ("-Wall", "-Wextra", "-pedantic", "-Werror")
_SIZE = """#include <stddef.h>
#include "{name}.h"
size_t {name}_size(void);
size_t {name}_size(void) {{ return sizeof({name}_block); }}
"""


@dataclass(frozen=True, slots=True, eq=False)
class _Words:
    """The code's numbers: dtype of signals and states, and what one count is: error (m,) [m], current (p,) [A], state [-]."""

    signal: type
    stored: type
    error: np.ndarray
    current: np.ndarray
    state: float | np.ndarray
    whole: bool

    @classmethod
    def of(cls, block: ControlBlock | ScheduledBlock, arithmetic: Arithmetic) -> _Words:
        if arithmetic in {"double", "float"}:
            real = np.float64 if arithmetic == "double" else np.float32
            return cls(real, real, np.ones(len(block.inputs)), np.ones(len(block.outputs)), 1.0, False)
        word = int(arithmetic.removeprefix("fixed"))
        fixed = in_words(cast(ControlBlock, block), word)
        one = 2.0**fixed.signal_bits
        signal, stored = (np.int32, np.int64) if word == 32 else (np.int16, np.int32)
        return cls(
            signal,
            stored,
            block.error_limit / one,
            block.current_limit / one,
            2.0**-fixed.state_bits * block.state_range,
            True,
        )

    def counts(self, values: np.ndarray, unit: np.ndarray | float) -> np.ndarray:
        scaled = np.asarray(values, float) / unit
        return np.rint(scaled) if self.whole else scaled


B = TypeVar("B", ControlBlock, ScheduledBlock)


class _Compiled(Generic[B]):
    """What compiled fixed and scheduled blocks share."""

    def __init__(self, block: B, arithmetic: Arithmetic = "double", compiler: str | None = None) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        self.block: B = block
        self.arithmetic, self.status = arithmetic, 0
        files = generate(block, arithmetic)
        self._words = _Words.of(block, arithmetic)
        self._library = _load(block.name, files, compiler)
        size = self._library[f"{block.name}_size"]
        size.restype = ctypes.c_size_t
        self._memory = ctypes.create_string_buffer(size())
        self._errors: np.ndarray = np.zeros(len(block.inputs), self._words.signal)
        self._currents: np.ndarray = np.zeros(len(block.outputs), self._words.signal)
        self._call("init")

    @property
    def sample_time(self) -> float:
        return self.block.sample_time

    @property
    def delay(self) -> int:
        return self.block.delay

    def begin(self, states: np.ndarray) -> None:
        """Everything as after its first call, then the states (n,)."""
        self._call("init")
        self.set_states(states)

    def track(self, errors: np.ndarray, currents: np.ndarray) -> None:
        """Bumpless transfer to errors (m,) [m] and currents (p,) [A]. Raises InvalidInput for a block that cannot."""
        if not self.block.transfers:
            raise InvalidInput("this block has no bumpless transfer: its states do not reach every output; begin it at rest")
        self._currents[:] = self._words.counts(currents, self._words.current)
        self._call_with_signals("track", errors)

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (p,) [A] from errors (m,) [m]."""
        self.status = int(self._call_with_signals("step", errors))
        return self._currents * self._words.current

    def states(self) -> np.ndarray:
        """The states (n,) as they stand in the code's memory, 1 being their bound."""
        return self._state_memory().astype(float) * self._words.state

    def set_states(self, states: np.ndarray) -> None:
        """Writes the states (n,) into the code's memory."""
        self._state_memory()[:] = self._words.counts(states, self._words.state)

    def _state_memory(self) -> np.ndarray:
        """The states where the code keeps them: first in the block, after the zeros that its diagonals reach into."""
        before = padding_of(self.block)[0] if isinstance(self.block, ControlBlock) else 0
        kind = np.dtype(self._words.stored)
        return np.frombuffer(memoryview(self._memory), kind, self.block.n_states, before * kind.itemsize)

    def _call_with_signals(self, verb: str, errors: np.ndarray) -> Any:
        """step or track: errors in, all of them valid, currents in place."""
        self._errors[:] = self._words.counts(errors, self._words.error)
        return self._call(verb, _pointer(self._errors), None, *self._speed_argument(), _pointer(self._currents))

    def _speed_argument(self) -> tuple[Any, ...]:
        return ()

    def _call(self, verb: str, *arguments: Any) -> Any:
        return self._library[f"{self.block.name}_{verb}"](self._memory, *arguments)


class CompiledBlock(_Compiled[ControlBlock]):
    """A block's C code in this process. errors [m] and currents [A], whatever the code's arithmetic.

    sample_time [s], delay [samples], system: as the rig asks of a program; status: the bits of the last step.
    """

    @property
    def system(self) -> StateSpace:
        return self.block.system

    def run(self, errors: np.ndarray) -> np.ndarray:
        """currents (k, p) [A] over errors (k, m) [m], from the present state."""
        e = check_shape(errors, "errors", "(k, m)", m=len(self.block.inputs))
        return np.array([self.step(row) for row in e]).reshape(len(e), len(self.block.outputs))


class CompiledSchedule(_Compiled[ScheduledBlock]):
    """A scheduled block's C code in this process: errors [m] and speeds [rad/s] to currents [A].

    As ``CompiledBlock``, and schedule: as the rig asks of a program; called with a speed [rad/s]: the law there, frozen.
    """

    def __init__(self, block: ScheduledBlock, arithmetic: Precision = "double", compiler: str | None = None) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        self.speed = block.range[0]
        super().__init__(block, arithmetic, compiler)

    @property
    def system(self) -> StateSpace:
        """The law at the speed of the next step."""
        return self.block.at(self.speed)

    def __call__(self, speed: float) -> StateSpace:
        return self.block.at(speed)

    def schedule(self, speed: float) -> None:
        """The speed [rad/s] of the next step; NaN: not known."""
        self.speed = speed

    def run(self, errors: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """currents (k, p) [A] over errors (k, m) [m] and speeds (k,) [rad/s], from the present state."""
        e = check_shape(errors, "errors", "(k, m)", m=len(self.block.inputs))
        currents = np.empty((len(e), len(self.block.outputs)))
        for k, speed in enumerate(np.asarray(speeds, float).tolist()):
            self.schedule(speed)
            currents[k] = self.step(e[k])
        return currents

    def _speed_argument(self) -> tuple[Any, ...]:
        return (ctypes.c_double(self.speed) if self.arithmetic == "double" else ctypes.c_float(self.speed),)


def read_law(code: CompiledBlock | CompiledSchedule, speed: float | None = None) -> StateSpace:
    """The law that the running code follows: its states are set one by one, its inputs too, and one step is taken from each.

    speed [rad/s]: at which a schedule is frozen. Every column is what the compiled code made of it, rounding of its words
    included. Raises InvalidInput where a current stays limited, or the speed clamped, however small the step.
    """
    if isinstance(code, CompiledSchedule) and speed is not None:
        code.schedule(speed)
    block = code.block
    n, m = block.n_states, len(block.inputs)
    columns = [_response(code, state, np.zeros(m)) for state in np.diag(block.state_range)]
    columns += [_response(code, np.zeros(n), error) for error in np.eye(m) * block.error_limit]
    table = np.array(columns).reshape(n + m, -1).T  # (next states and currents, states and errors)
    table[:, :n] /= block.state_range
    table[:, n:] /= block.error_limit
    return StateSpace(
        table[:n, :n], table[:n, n:], table[n:, :n], table[n:, n:], block.inputs, block.outputs, block.sample_time
    )  # fmt: skip


def _response(code: CompiledBlock | CompiledSchedule, state: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Next states and currents (n + p,) from a state and errors, taken so small that nothing is limited, and scaled back."""
    for power in range(1, 40):
        size = 0.5**power
        code.begin(size * state)
        currents = code.step(size * errors)
        if not code.status:
            return np.concatenate([code.states(), currents]) / size
    raise InvalidInput(
        "the code limits its currents (or clamps its speed) however small the step; give larger limits, stay in its range"
    )


def _pointer(values: np.ndarray) -> Any:
    return values.ctypes.data_as(ctypes.c_void_p)


def _load(name: str, files: dict[str, str], compiler: str | None) -> Any:
    """The generated files of a block by this name, compiled and loaded. Raises InvalidInput."""
    remedy = "install one to run the C code here"
    chosen = find_compiler(compiler)
    if chosen is None:
        raise InvalidInput(f"there is no C compiler {compiler or ' or '.join(COMPILERS)} on this computer; {remedy}")
    sources = [f"{name}.c", "size.c"]
    code = build_library(chosen, {**files, "size.c": _SIZE.format(name=name)}, sources, _FLAGS, "give another compiler")
    return load_library(code)
