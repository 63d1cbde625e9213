"""The generated C code, compiled and running here: software in the loop.

``CompiledBlock`` runs in the virtual rig in place of a controller (``simulate.control_program``), and ``probed`` reads the law
back out of the running code, sample by sample, so that the same verification can be made of what the compiler made.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ambrose.core.checks import InvalidInput, check_shape
from ambrose.core.statespace import StateSpace
from ambrose.deployment.block.cost import diagonals_of
from ambrose.deployment.block.fixed import ControlBlock, transfers
from ambrose.deployment.block.fixed_point import fixed_point
from ambrose.deployment.c.fixed import Arithmetic, generate

COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-Wall", "-Wextra", "-pedantic", "-Werror")
_TIME_LIMIT = 120.0  # s, for the compiler
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
    state: float
    whole: bool

    @classmethod
    def of(cls, block: ControlBlock, arithmetic: Arithmetic) -> _Words:
        if arithmetic in {"double", "float"}:
            real = np.float64 if arithmetic == "double" else np.float32
            return cls(real, real, np.ones(len(block.inputs)), np.ones(len(block.outputs)), 1.0, False)
        word = int(arithmetic.removeprefix("fixed"))
        fixed = fixed_point(block, word)
        one = 2.0**fixed.signal_bits
        signal, stored = (np.int32, np.int64) if word == 32 else (np.int16, np.int32)
        return cls(signal, stored, block.error_limit / one, block.current_limit / one, 2.0**-fixed.state_bits, True)

    def counts(self, values: np.ndarray, unit: np.ndarray | float) -> np.ndarray:
        scaled = np.asarray(values, float) / unit
        return np.rint(scaled) if self.whole else scaled


class CompiledBlock:
    """A block's C code in this process. errors [m] and currents [A], whatever the code's arithmetic.

    sample_time [s], delay [samples], system: as the rig asks of a program; status: the bits of the last step.
    """

    def __init__(self, block: ControlBlock, arithmetic: Arithmetic = "double", compiler: str | None = None) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        self.block, self.arithmetic, self.status = block, arithmetic, 0
        self._words = _Words.of(block, arithmetic)
        self._library = library(block.name, generate(block, arithmetic), compiler)
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

    @property
    def system(self) -> StateSpace:
        return self.block.system

    def begin(self, states: np.ndarray) -> None:
        """Everything as after its first call, then the states (n,)."""
        self._call("init")
        self.set_states(states)

    def track(self, errors: np.ndarray, currents: np.ndarray) -> None:
        """Bumpless transfer to errors (m,) [m] and currents (p,) [A]. Raises InvalidInput for a block that cannot."""
        if not transfers(self.block):
            raise InvalidInput("this block has no bumpless transfer: its states do not reach every output; begin it at rest")
        self._errors[:] = self._words.counts(errors, self._words.error)
        self._currents[:] = self._words.counts(currents, self._words.current)
        self._call("track", pointer(self._errors), None, pointer(self._currents))

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (p,) [A] from errors (m,) [m]."""
        self._errors[:] = self._words.counts(errors, self._words.error)
        self.status = int(self._call("step", pointer(self._errors), None, pointer(self._currents)))
        return self._currents * self._words.current

    def run(self, errors: np.ndarray) -> np.ndarray:
        """currents (k, p) [A] over errors (k, m) [m], from the present state."""
        e = check_shape(errors, "errors", "(k, m)", m=len(self.block.inputs))
        return np.array([self.step(row) for row in e]).reshape(len(e), len(self.block.outputs))

    def states(self) -> np.ndarray:
        """The states (n,) as they stand in the code's memory, 1 being their bound."""
        return self._state_memory() * self._words.state

    def set_states(self, states: np.ndarray) -> None:
        """Writes the states (n,) into the code's memory."""
        self._state_memory()[:] = self._words.counts(states, self._words.state)

    def _state_memory(self) -> np.ndarray:
        """The states where the code keeps them: first in the block, after the zeros that its diagonals reach into."""
        diagonals = diagonals_of(self.block.increment)
        before = max(0, -diagonals[0][0]) if diagonals else 0
        kind = np.dtype(self._words.stored)
        return np.frombuffer(memoryview(self._memory), kind, self.block.n_states, before * kind.itemsize)

    def _call(self, verb: str, *arguments: Any) -> Any:
        return self._library[f"{self.block.name}_{verb}"](self._memory, *arguments)


class Running(Protocol):
    """What ``probed`` asks of running code; block: with n_states, inputs, outputs, error_limit [m], sample_time [s]."""

    status: int

    @property
    def block(self) -> Any: ...
    def begin(self, states: np.ndarray) -> None: ...
    def step(self, errors: np.ndarray) -> np.ndarray: ...
    def states(self) -> np.ndarray: ...


def probed(code: Running) -> StateSpace:
    """The law that the running code follows: its states are set one by one, its inputs too, and one step is taken from each.

    Every column is what the compiled code made of it, rounding of its words included. Raises InvalidInput where a current stays
    limited however small the step.
    """
    n, m = code.block.n_states, len(code.block.inputs)
    columns = [_response(code, state, np.zeros(m)) for state in np.eye(n)]
    columns += [_response(code, np.zeros(n), error) for error in np.eye(m) * code.block.error_limit]
    table = np.array(columns).reshape(n + m, -1).T  # (next states and currents, states and errors)
    table[:, n:] /= code.block.error_limit
    block = code.block
    return StateSpace(
        table[:n, :n], table[:n, n:], table[n:, :n], table[n:, n:], block.inputs, block.outputs, block.sample_time
    )  # fmt: skip


def _response(code: Running, state: np.ndarray, errors: np.ndarray) -> np.ndarray:
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


def pointer(values: np.ndarray) -> Any:
    return values.ctypes.data_as(ctypes.c_void_p)


def has_compiler() -> bool:
    """Whether the code can be compiled here."""
    return any(shutil.which(name) for name in COMPILERS)


def library(block: str, files: Mapping[str, str], compiler: str | None) -> Any:
    """The generated ``files`` of a block by this name, compiled and loaded. Raises InvalidInput."""
    found = compiler or next((name for name in COMPILERS if shutil.which(name)), None)
    if found is None or shutil.which(found) is None:
        wanted = compiler or " or ".join(COMPILERS)
        raise InvalidInput(f"there is no C compiler {wanted} on this computer; install one to run the C code here")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for name, text in {**files, "size.c": _SIZE.format(name=block)}.items():
            (place / name).write_text(text)
        target = place / "block.so"
        sources = [str(place / f"{block}.c"), str(place / "size.c")]
        done = subprocess.run(
            [found, *_FLAGS, *sources, "-o", str(target)], capture_output=True, text=True, check=False, timeout=_TIME_LIMIT
        )
        if done.returncode:
            raise InvalidInput(f"{found} does not compile the code: {done.stderr.strip()[:500]}")
        return ctypes.CDLL(str(target))
