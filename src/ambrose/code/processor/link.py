"""A program on its processor, in an emulator, and the pipe that it takes samples from and gives
currents to.
"""

from __future__ import annotations

import math
import re
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ambrose.code.processor.build import Program
from ambrose.code.processor.machines import COUNT_SHIFT, Processor
from ambrose.code.processor.unit import Unit
from ambrose.core.checks import InvalidInput

_PATIENCE = 60.0  # [s] for one answer, which takes a tenth of a second
_LOOK = 1.0  # [s] between two looks at it
_AT_ONCE = 64  # samples on the way: less than a pipe holds
_LEAVE, _INIT, _SELF_TEST, _STEPS, _STATES, _IDENTITY, _STEPS_ALONE = range(7)
_HELLO = (
    0x01020304  # first word of the program; every byte of it differs, so that a wrong order shows
)
_PC = re.compile(rb"Trace \d+: \S+ \[[0-9a-f]+/0*([0-9a-f]+)/")


class Link:
    """A running program. A context: the emulator ends with it, whatever happens."""

    def __init__(
        self, unit: Unit, processor: Processor, program: Program, *, counting: bool = False
    ) -> None:
        """counting: of a processor whose instructions the emulator's log counts, write that log
        (slow). Raises InvalidInput where the program does not answer.
        """
        self.unit = unit
        self.processor = processor
        self.given, self.answered = unit.given(processor.order), unit.answered(processor.order)
        self._word = np.dtype(f"{processor.order}u4")
        self._log: Path | None = None
        command = [
            part.replace("{program}", str(program.path))
            for part in processor.emulator or ("{program}",)
        ]
        if processor.kind in {"cortex-m", "cortex-r"}:
            shift = COUNT_SHIFT if processor.kind == "cortex-m" else 0
            command += ["-icount", f"shift={shift},sleep=off"]
        elif counting and processor.kind == "linux":
            self._log = program.path.with_name("instructions.log")
            logged = ["-singlestep", "-d", "exec,nochain", "-D", str(self._log)]
            command[1:1] = logged
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the link
        self._process = subprocess.Popen(
            command,
            cwd=program.path.parent,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            bufsize=0,
        )
        self._program = program
        self._due, self._late = math.inf, False
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            if self._asked() != _HELLO:
                raise InvalidInput(
                    f"the program on {processor.name} does not answer in its byte order"
                )
            self.memory = self._asked()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Link:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the program."""
        self._over.set()
        process = self._process
        if process.poll() is None:
            try:
                self._say(_LEAVE)
                process.wait(timeout=5)
            except (OSError, InvalidInput, subprocess.TimeoutExpired):
                process.kill()
                process.wait()
        for stream in (process.stdin, process.stdout, self._errors):
            if stream is not None:
                stream.close()

    def begin(self) -> None:
        """Everything as after the first call of init."""
        self._say(_INIT)

    def self_test(self) -> bool:
        """Whether the self-test that is delivered passes there."""
        self._say(_SELF_TEST)
        return self._asked() == 0

    def checksum(self) -> tuple[int, int, str]:
        """CRC of the tables as the program reads them, as it was written, and its identity."""
        self._say(_IDENTITY)
        found, meant = self._asked(), self._asked()
        text = b""
        while not text.endswith(b"\0"):
            text += self._read(1)
        return found, meant, text[:-1].decode("ascii", "replace")

    def steps(self, samples: np.ndarray, *, watching: bool = True) -> np.ndarray:
        """Answers (k,) to samples (k,), as ``Unit.given`` and ``answered`` have them; watching: how
        deep the stack is written (slow).
        """
        found = []
        what = _STEPS if watching and self._log is None else _STEPS_ALONE
        for i in range(0, len(samples), _AT_ONCE):
            part = samples[i : i + _AT_ONCE].astype(self.given)
            self._say(what, len(part))
            self._write(part.tobytes())
            found.append(self._read(len(part) * self.answered.itemsize))
        return np.frombuffer(b"".join(found), self.answered)

    def set_states(self, states: np.ndarray) -> None:
        """The states (n,) as numbers of the code."""
        self._say(_STATES)
        self._write(states.astype(self.unit.stored(self.processor.order)).tobytes())

    def counted(self) -> list[int]:
        """Instructions of every step so far by the emulator's log; after ``close``."""
        if self._log is None:
            return []
        begin, end = (self._program.symbols[name] for name in ("counting", "counted"))
        found = []
        count, within = 0, False
        for at in _traced(self._log):
            if at == begin:
                count, within = 0, True
            elif at == end and within:
                found.append(count)
                within = False
            elif within:
                count += 1
        return found

    def _say(self, *words: int) -> None:
        self._write(np.array(words, self._word).tobytes())

    def _asked(self) -> int:
        return int(np.frombuffer(self._read(4), self._word)[0])

    def _write(self, content: bytes) -> None:
        stream: Any = self._process.stdin
        self._due = time.monotonic() + _PATIENCE
        try:
            while content:
                content = content[stream.write(content) :]
            self._due = math.inf
        except OSError as error:
            raise InvalidInput(self._ended()) from error

    def _read(self, count: int) -> bytes:
        stream: Any = self._process.stdout
        content = b""
        self._due = time.monotonic() + _PATIENCE
        while len(content) < count:
            part = stream.read(count - len(content))
            if not part:
                raise InvalidInput(self._ended())
            content += part
        self._due = math.inf
        return content

    def _watch(self) -> None:
        """Ends a program that owes an answer for too long: who waits for it reads its end."""
        while not self._over.wait(_LOOK):
            if time.monotonic() > self._due:
                self._late = True
                self._process.kill()
                return

    def _ended(self) -> str:
        runs = self.processor.emulator[0] if self.processor.emulator else "this computer"
        if self._late:
            return (
                f"the program on {self.processor.name} did not answer within {_PATIENCE:g} s and "
                f"was ended; see that {runs} runs here"
            )
        self._errors.seek(0)
        said = self._errors.read().decode("utf-8", "replace").strip()[-300:]
        return (
            f"the program on {self.processor.name} ended too soon ({said or 'without a word'}); "
            f"see that {runs} runs here"
        )


def _traced(path: Path) -> Iterator[int]:
    """The addresses of the instructions in an emulator's log, in their order."""
    with path.open("rb") as lines:
        for line in lines:
            found = _PC.match(line)
            if found:
                yield int(found[1], 16)
