"""The generated C code, compiled and running here: software in the loop.

``CompiledBlock`` runs in the virtual rig in place of a controller (``law.law``),
``CompiledSchedule`` in place of a scheduled one, given speed or pressure at every sample.
``read_law`` reads the law back out of the running code, so that the same verification can be made
of what the compiler made.
"""

from __future__ import annotations

import ctypes
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

from ambrose.code.block.block import REASON_AT, Block, ControlBlock
from ambrose.code.block.fixed_point import in_words
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.code import WORDS, Arithmetic, Precision, law_files
from ambrose.code.interface import KINDS, TYPES, AllAxes, Interface, Law, interface_of, parts_of
from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.core.statespace import StateSpace, append
from ambrose.law.supervision import Fault

# The C compiler of this computer.


COMPILERS = ("cc", "gcc", "clang")
_TIME_LIMIT, _PROBE_TIME = 120.0, 20.0  # s
# how shared libraries begin
_LIBRARIES = (b"\x7fELF", b"MZ", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe")


def find_compiler(compiler: str | None = None) -> str | None:
    """The compiler asked for, or the first of COMPILERS; None where it is not installed."""
    return next(
        (name for name in ((compiler,) if compiler else COMPILERS) if shutil.which(name)), None
    )


def has_compiler() -> bool:
    """Whether code can be compiled and run here."""
    return not compiler_problem()


def compiler_problem() -> str:
    """Why no code can be compiled and run here, found out with a function of one line; "" where it
    can.
    """
    compiler = find_compiler()
    if compiler is None:
        return f"there is no C compiler {' or '.join(COMPILERS)} on this computer"
    try:
        load_library(build_probe(compiler, "install another one"))
    except InvalidInput as error:
        return str(error)
    return ""


def build_probe(compiler: str, remedy: str) -> bytes:
    """The shared library of one line: quick, so that a compiler that hangs is found before it
    counts. Raises InvalidInput.
    """
    return build_library(
        compiler, {"probe.c": "int probe;\n"}, ["probe.c"], (), remedy, time_limit=_PROBE_TIME
    )


def load_library(code: bytes) -> ctypes.CDLL:
    """A shared library of these bytes in this process. Raises InvalidInput."""
    try:
        with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
            target = Path(folder) / "library.so"
            target.write_bytes(code)
            return ctypes.CDLL(str(target))
    except OSError as error:
        remedy = "set TMPDIR to a folder that has room and lets programs run"
        raise InvalidInput(f"compiled code cannot be loaded here: {error}; {remedy}") from error


def build_library(
    compiler: str,
    files: Mapping[str, str],
    sources: Sequence[str],
    flags: Sequence[str],
    remedy: str,
    libraries: str = "",
    time_limit: float = _TIME_LIMIT,
) -> bytes:
    """The shared library of ``sources``, which are among ``files`` by name. Raises InvalidInput,
    with the remedy.
    """
    command = [
        compiler,
        "-std=c99",
        "-O2",
        "-fPIC",
        "-shared",
        *flags,
        *sources,
        "-o",
        "library",
        *libraries.split(),
    ]
    try:
        with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
            for name, text in files.items():
                (Path(folder) / name).write_text(text, encoding="utf-8")
            status, message = _run(command, folder, time_limit)
            library = Path(folder) / "library"
            code = library.read_bytes() if library.is_file() else b""
    except subprocess.TimeoutExpired as error:
        raise InvalidInput(
            f"the C compiler {compiler} did not end within {time_limit:g} s; {remedy}"
        ) from error
    except OSError as error:
        reason = f"{error.strerror or error}{f' ({error.filename})' if error.filename else ''}"
        raise InvalidInput(
            f"the C compiler {compiler} cannot be run here: {reason}; {remedy}, or set TMPDIR"
        ) from error
    if status or not code.startswith(_LIBRARIES):
        raise InvalidInput(
            f"the C compiler {compiler} refused the code: {message[:500] or 'it made no library'}; "
            f"{remedy}"
        )
    return code


def _run(command: Sequence[str], folder: str, time_limit: float) -> tuple[int, str]:
    """Exit status and message of a program; beyond the limit [s], and on Ctrl-C, all processes that
    it started end with it.
    """
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    ) as process:
        try:
            message, _ = process.communicate(timeout=time_limit)
        except BaseException:
            with suppress(OSError):
                os.killpg(
                    process.pid, signal.SIGKILL
                ) if sys.platform != "win32" else process.kill()
            raise
    return process.returncode, message.decode("utf-8", "replace").strip()


_FLAGS = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off")
_PLACES = """#include <stddef.h>
#include "{name}.h"
extern const size_t loaded_places[];
const size_t loaded_places[] = {{sizeof({memory}){places}}};
"""
_CALL = """#include <math.h>
#include <stddef.h>
#include "{name}.h"
typedef struct {{ {memory} *memory; double told[4]; int status; }} called;
int loaded_call(void *running, const double *errors, const double *told, double *currents);
int loaded_call(void *running, const double *errors, const double *told, double *currents)
{{
    static const double metre[] = {{{error}}}, ampere[] = {{{current}}};
    called *self = (called *)running;
    {word} in[{m}], out[{p}];
    int i;
    (void)told;
    for (i = 0; i < {m}; i++) in[i] = ({word}){counted};
    for (i = 0; i < {d}; i++) self->told[i] = told[i];
    self->status = (int){name}_step(self->memory, in, NULL, {told}out);
    for (i = 0; i < {p}; i++) currents[i] = (double)out[i] * ampere[i];
    return 0;
}}
"""
_ESTIMATE = (2, 3)  # places of an estimate and its half width among what is told
# as a converter does at its ends
_COUNTED = "fmin(fmax(rint(errors[i] / metre[i]), {least:.0f}.0), {most:.0f}.0)"


class Loaded:
    """A unit's C code in this process: its memory, its functions by verb, and ``at`` the places of
    its interface as arrays.
    """

    def __init__(
        self,
        interface: Interface,
        files: Mapping[str, str],
        compiler: str | None = None,
        flags: Sequence[str] = _FLAGS,
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        self.interface = interface
        chosen, remedy = find_compiler(compiler), "install one to run the C code here"
        if chosen is None:
            raise InvalidInput(
                f"there is no C compiler {compiler or ' or '.join(COMPILERS)} on this computer; "
                f"{remedy}"
            )
        places, memory = interface.places, interface.memory
        offsets = "".join(f", offsetof({memory}, {place})" for place, *_ in places.values())
        text = _PLACES.format(name=interface.name, memory=memory, places=offsets)
        texts = {**files, "places.c": text}
        sources = [name for name in texts if name in {*interface.sources, "places.c", "call.c"}]
        code = build_library(chosen, texts, sources, flags, "give another compiler", "-lm")
        self.library = load_library(code)
        size, *starts = (ctypes.c_size_t * (1 + len(places))).in_dll(self.library, "loaded_places")
        self.memory = ctypes.create_string_buffer(size)
        self.at = {
            name: np.frombuffer(memoryview(self.memory), KINDS[word], count, start)
            for (name, (_, word, count)), start in zip(places.items(), starts, strict=True)
        }

    @property
    def address(self) -> int:
        return ctypes.addressof(self.memory)

    def begin(self) -> None:
        """Everything as after its first call."""
        self._function(self.interface.begin)(ctypes.c_void_p(self.address))

    def call(self, verb: str = "step", **given: Any) -> tuple[np.ndarray, int]:
        """The array that a function fills, its last argument, and its status. given: its arguments
        by name, in its own numbers; one left out is a null pointer, or 0.
        """
        arguments: list[Any] = [ctypes.c_void_p(self.address)]
        filled = np.empty(0)
        for one in self.interface.arguments:
            value = given.get(one.name)
            if not one.count:
                number = np.ctypeslib.as_ctypes_type(one.kind)
                arguments.append(number(np.array(value or 0, one.kind).item()))
            elif value is None and one.given:
                arguments.append(None)
            else:
                filled = np.empty(one.count, one.kind)
                filled[:] = 0 if value is None else value
                arguments.append(filled.ctypes.data_as(ctypes.c_void_p))
        return filled, self._function(verb)(*arguments)

    def _function(self, verb: str) -> Any:
        """The library's function <name>_<verb>."""
        function = self.library[f"{self.interface.name}_{verb}"]
        function.restype = ctypes.c_uint
        return function


class _Running(ctypes.Structure):
    """What the C function gets first: its memory, and where it leaves what it was told and the
    status of the last step.
    """

    _fields_ = (
        ("memory", ctypes.c_void_p),
        ("told", ctypes.c_double * 4),
        ("status", ctypes.c_int),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Words:
    """The code's numbers: dtype of signals and states, and what one count is: error (m,) [m],
    current (p,) [A], state [-].
    """

    signal: str
    stored: str
    error: np.ndarray
    current: np.ndarray
    state: float | np.ndarray
    whole: bool

    @classmethod
    def of(cls, block: Block, arithmetic: Arithmetic) -> Words:
        """The numbers of a block's code in an arithmetic; floating point counts in SI."""
        signal, stored = TYPES[arithmetic]
        if arithmetic in {"double", "float"}:
            ones = np.ones(len(block.inputs)), np.ones(len(block.outputs))
            return cls(signal, stored, *ones, 1.0, False)
        fixed = in_words(cast(ControlBlock, block), WORDS[arithmetic])
        one = 2.0**fixed.signal_bits
        state = 2.0**-fixed.state_bits * block.state_range
        return cls(signal, stored, block.error_limit / one, block.current_limit / one, state, True)

    def counts(self, values: np.ndarray, unit: np.ndarray | float) -> np.ndarray:
        """Values as numbers of the code, one count being ``unit``."""
        scaled = np.asarray(values, float) / unit
        return np.rint(scaled) if self.whole else scaled

    @property
    def counted(self) -> str:
        """C that makes errors[i], in metres, a number of the code, within its word."""
        if not self.whole:
            return "(errors[i] / metre[i])"
        ends = np.iinfo(KINDS[self.signal])
        return _COUNTED.format(least=ends.min, most=ends.max)


L = TypeVar("L", bound=Law)
B = TypeVar("B", bound=ControlBlock | ScheduledBlock)


class CompiledLaw(Generic[L]):
    """A law's C code in this process, as the rig runs a program: errors [m] and currents [A],
    whatever the code's arithmetic; status: the bits of the last step.
    """

    def __init__(
        self,
        law: L,
        arithmetic: Arithmetic = "double",
        compiler: str | None = None,
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        self.block, self.arithmetic = law, arithmetic
        self.blocks: tuple[Any, ...] = parts_of(law)
        self._words = tuple(Words.of(part, arithmetic) for part in self.blocks)
        interface = interface_of(law, arithmetic)
        files = {**law_files(law, arithmetic), "call.c": self._call(interface)}
        self._code = Loaded(interface, files, compiler)
        self._running = _Running(self._code.address, (0.0, 0.0, math.nan, math.inf))
        self._step = self._code.library["loaded_call"]
        self._step.argtypes = (ctypes.c_void_p,) * 4
        self._code.begin()

    def _call(self, interface: Interface) -> str:
        """C that calls the step with errors [m] and currents [A] as numbers, whatever its words."""
        first = self._words[0]
        error, current = (
            [repr(value) for one in self._words for value in getattr(one, side).tolist()]
            for side in ("error", "current")
        )
        arguments = [f"({first.signal})self->told[{i}], " for i in self._told.values()]
        return _CALL.format(
            name=interface.name,
            memory=interface.memory,
            error=", ".join(error),
            current=", ".join(current),
            word=first.signal,
            counted=first.counted,
            told="".join(arguments),
            d=sum(i not in _ESTIMATE for i in self._told.values()),
            m=len(error),
            p=len(current),
        )

    @property
    def _told(self) -> dict[str, int]:
        """What the step is told (speed, pressure, estimate), and its place in ``_Running.told``."""
        places = {"estimate": _ESTIMATE[0], "half_width": _ESTIMATE[1]}
        return {name: places.get(name, i) for i, name in enumerate(self.block.base.told)}

    @property
    def sample_time(self) -> float:
        return self.block.base.sample_time

    @property
    def delay(self) -> int:
        return self.block.base.delay

    @property
    def status(self) -> int:
        """The bits of the last step, of a unit of all axes the radial part's."""
        return self._running.status

    @property
    def entry(self) -> tuple[int, int]:
        """Addresses of the compiled step and of what it gets first, for the rig's compiled loop."""
        address = cast(int, ctypes.cast(self._step, ctypes.c_void_p).value)
        return address, ctypes.addressof(self._running)

    def begin(self, states: np.ndarray) -> None:
        """Everything as after its first call, then the states (n,), part by part."""
        self._code.begin()
        self.set_states(states)

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (p,) [A] from errors (m,) [m]."""
        given = np.array(errors, float)
        currents = np.empty(sum(len(part.outputs) for part in self.blocks))
        told = np.array(self._running.told)
        addresses = (array.ctypes.data for array in (given, told, currents))
        self._step(ctypes.addressof(self._running), *addresses)
        return currents

    def states(self) -> np.ndarray:
        """The states (n,) as they stand in the code's memory, 1 being their bound."""
        return np.concatenate([m.astype(float) * words.state for m, words in self._state_memory()])

    def set_states(self, states: np.ndarray) -> None:
        """Writes the states (n,) into the code's memory."""
        for memory, words in self._state_memory():
            memory[:] = words.counts(states[: len(memory)], words.state)
            states = states[len(memory) :]

    def _state_memory(self) -> Iterator[tuple[np.ndarray, Words]]:
        """The states of every part where the code keeps them, with its words."""
        for part, words in zip(self.blocks, self._words, strict=True):
            yield self._code.at.get(f"states of {part.name}", np.zeros(0)), words


class _CompiledBlock(CompiledLaw[B]):
    """What compiled fixed and scheduled blocks share."""

    def __init__(
        self, block: B, arithmetic: Arithmetic = "double", compiler: str | None = None
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        if not isinstance(cast(object, block), Block):
            remedy = "build_block and build_scheduled_block make one"
            raise invalid("block", f"of type {type(block).__name__}", "a controller block", remedy)
        super().__init__(block, arithmetic, compiler)

    def track(self, errors: np.ndarray, currents: np.ndarray) -> None:
        """Bumpless transfer to errors (m,) [m] and currents (p,) [A]. Raises InvalidInput for a
        block that cannot.
        """
        if not self.block.transfers:
            raise InvalidInput(
                "this block has no bumpless transfer: its states do not reach every output; begin "
                "it at rest"
            )
        words = self._words[0]
        given = words.counts(errors, words.error)
        meant = words.counts(currents, words.current)
        told = {name: self._running.told[i] for name, i in self._told.items()}
        self._code.call("track", error=given, current=meant, **told)


class CompiledBlock(_CompiledBlock[ControlBlock]):
    """A block's C code in this process. errors [m] and currents [A], whatever the code's
    arithmetic.

    sample_time [s], delay [samples], system, entry: as the rig asks of a native program; status:
    the bits of the last step.
    """

    @property
    def system(self) -> StateSpace:
        return self.block.system

    def run(self, errors: np.ndarray) -> np.ndarray:
        """currents (k, p) [A] over errors (k, m) [m], from the present state."""
        e = check_shape(errors, "errors", "(k, m)", m=len(self.block.inputs))
        return np.array([self.step(row) for row in e]).reshape(len(e), len(self.block.outputs))


class CompiledSchedule(_CompiledBlock[ScheduledBlock]):
    """A scheduled block's C code in this process: errors [m] and speeds [rad/s] or pressures [Pa]
    to currents [A].

    As ``CompiledBlock``, and schedule, parameter: as the rig asks of a program; called with a
    value: the law there, frozen.
    """

    def __init__(
        self, block: ScheduledBlock, arithmetic: Precision = "double", compiler: str | None = None
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        super().__init__(block, arithmetic, compiler)
        self.schedule(block.range[0])

    @property
    def parameter(self) -> str:
        return self.block.along.name

    @property
    def told(self) -> Any:
        """Speed [rad/s] or pressure [Pa] (or both) of the last step, or the next one."""
        both = tuple(self._running.told[:2])
        return both if self.block.along.parts else both[0]

    @property
    def system(self) -> StateSpace:
        """The law of the next step."""
        return self.block.at(self.block.known(self.told))

    def __call__(self, value: Any) -> StateSpace:
        return self.block.at(value)

    @property
    def estimate(self) -> tuple[float, float]:
        """Of a supervised block: a monitor's pressure and its half width [Pa] from the next step
        on; NaN, infinity: none.
        """
        value, half_width = (self._running.told[i] for i in _ESTIMATE)
        return value, half_width

    @estimate.setter
    def estimate(self, given: tuple[float, float]) -> None:
        for i, one in zip(_ESTIMATE, given, strict=True):
            self._running.told[i] = one

    @property
    def fault(self) -> Fault:
        """Of a supervised block: why the last reading is not trusted."""
        return Fault(self.status >> REASON_AT & 7 if self.block.watch else 0)

    def schedule(self, value: Any) -> None:
        """Speed [rad/s] or pressure [Pa] of the next step, or both; NaN: not known."""
        for i, one in enumerate(value if self.block.along.parts else (value,)):
            self._running.told[i] = one

    def run(self, errors: np.ndarray, told: np.ndarray) -> np.ndarray:
        """currents (k, p) [A] over errors (k, m) [m] and speeds or pressures (k,), or both (k, 2),
        from the present state.
        """
        e = check_shape(errors, "errors", "(k, m)", m=len(self.block.inputs))
        currents = np.empty((len(e), len(self.block.outputs)))
        for k, value in enumerate(np.asarray(told, float).tolist()):
            self.schedule(value)
            currents[k] = self.step(e[k])
        return currents


class CompiledAxes(CompiledLaw[AllAxes]):
    """A radial and an axial block as one compiled function, a ``law.law.AllAxesProgram``: what
    ``export --axial`` writes, in place of a controller on the rig.
    """

    def __init__(
        self,
        radial: ControlBlock,
        axial: ControlBlock,
        arithmetic: Arithmetic = "double",
        compiler: str | None = None,
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, where it fails, or
        the two have not one clock and two names.
        """
        for block in (radial, axial):
            if not isinstance(cast(object, block), ControlBlock):
                remedy = "give the blocks of an export: done.block, done.axial.block"
                kind = f"of type {type(block).__name__}"
                raise invalid("a block", kind, "a fixed controller block", remedy)
        super().__init__(AllAxes(radial, axial), arithmetic, compiler)

    @property
    def parts(self) -> tuple[StateSpace, StateSpace]:
        """The laws of the radial axes and of the one along the shaft, in the code's states."""
        radial, axial = self.blocks
        return radial.system, axial.system

    @property
    def system(self) -> StateSpace:
        """Both side by side."""
        return append(*self.parts)


def read_law(code: CompiledBlock | CompiledSchedule, at: Any = None) -> StateSpace:
    """The law that the running code follows: its states are set one by one, its inputs too, and one
    step is taken from each.

    at: the value at which a schedule is frozen. Every column is what the compiled code made of it,
    rounding of its words included. Raises InvalidInput where a current stays limited, or the
    schedule clamped, however small the step.
    """
    if at is not None:
        cast(CompiledSchedule, code).schedule(at)
    block = code.block
    n, m = block.n_states, len(block.inputs)
    columns = [_response(code, state, np.zeros(m)) for state in np.diag(block.state_range)]
    columns += [_response(code, np.zeros(n), error) for error in np.eye(m) * block.error_limit]
    table = np.array(columns).reshape(n + m, -1).T  # (next states and currents, states and errors)
    table[:, :n] /= block.state_range
    table[:, n:] /= block.error_limit
    return StateSpace(
        table[:n, :n],
        table[:n, n:],
        table[n:, :n],
        table[n:, n:],
        block.inputs,
        block.outputs,
        block.sample_time,
    )


def _response(
    code: CompiledBlock | CompiledSchedule, state: np.ndarray, errors: np.ndarray
) -> np.ndarray:
    """Next states and currents (n + p,) from a state and errors, taken so small that nothing is
    limited, and scaled back.
    """
    for power in range(1, 40):
        size = 0.5**power
        code.begin(size * state)
        currents = code.step(size * errors)
        if not code.status:
            return np.concatenate([code.states(), currents]) / size
    raise InvalidInput(
        "the code limits its currents (or clamps its readings) for any step size; give larger "
        "limits, or readings within its range"
    )


# The self-test of exported C code, compiled and run on this computer.


_SECONDS = 30.0  # of compiler and test, each
_WORDS = ("-std=c99", "-O2", "-o", "test")
_SHOWN = 4000  # letters of what was printed


@dataclass(frozen=True, slots=True)
class SelfTest:
    """Whether every sample agreed; text: what compiler or test printed."""

    passed: bool
    text: str


def run_self_test(sources: Sequence[Path]) -> SelfTest:
    """Compile C files, of which one has main, and run the program, in a folder of its own. Raises
    InvalidInput without a compiler, and where it takes too long.
    """
    compiler = find_compiler()
    if compiler is None:
        raise InvalidInput(
            f"there is no C compiler {' or '.join(COMPILERS)} on this computer; install one"
        )
    with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
        files = [str(Path(path).resolve()) for path in sources]
        try:
            status, text = _run([compiler, *_WORDS, *files, "-lm"], folder, _SECONDS)
            if not status:
                status, text = _run([str(Path(folder, "test"))], folder, _SECONDS)
        except subprocess.TimeoutExpired:
            raise InvalidInput(
                f"the self-test took longer than {_SECONDS:g} s and was ended; run it by hand"
            ) from None
    said = "it fails without a word" if status else "every sample agrees"
    return SelfTest(not status, text[-_SHOWN:] or said)
