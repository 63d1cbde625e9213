"""The start of the command `ambrose`, also as `python -m ambrose`: from here on SIGINT ends it with
status 130 and one line, SIGTERM with 143.

An interruption is an exception where Python runs. Libraries can lose it (in a callback, in a
destructor), and an import that it breaks may fail in other words: the status is the same, at once
or after some seconds. A design that is interrupted says that it certifies what it has: from its
last word on it has a minute. A second interruption ends the process at once.
"""

import _thread
import gc
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

_ENDS = (signal.SIGINT, signal.SIGTERM)
_PATIENCE = 5.0  # s for what is open to be closed
_AT_WORK = 60.0  # s from the last sign of work, where there was one since the interruption
_TWICE = 0.5  # s in which a second signal is the first one, passed on by another program as well
# objects made until cycles are looked for: what an import makes stays, and looking through it every
# 700 objects is a tenth of a short command
_OBJECTS = 50_000
_PROCESSORS = "/proc/cpuinfo"  # of Linux; the first of them is described in so many bytes
_ONE = 4096
_WORDS = b"ambrose: interrupted; what was finished before stays on disk\n"


def main() -> None:
    """The command, with the arguments of this process."""
    # a machine file is read without pydantic's plugins: to look for some takes longer than to read
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # OpenBLAS's kernels for AVX-512 take two to three times as long as those for AVX2 for a product
    # of small matrices, of which a design is made
    with suppress(OSError), open(_PROCESSORS, "rb") as described:
        if b" avx512f " in described.read(_ONE):
            os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")
    gc.set_threshold(_OBJECTS, *gc.get_threshold()[1:])
    asked: list[int] = []
    ends = [0.0, 0.0]  # [s] of patience, and of the time in which a second signal is the first

    def interrupt(number: int, frame: Any) -> None:
        now = time.monotonic()
        if not asked:  # what is being closed is not to be disturbed
            asked.append(number)
            ends[:] = now + _PATIENCE, now + _TWICE
            _thread.start_new_thread(_end_late, (number, ends))
            raise KeyboardInterrupt
        if now > ends[1]:
            _end(number)

    def at_work() -> None:
        if signal.SIGTERM not in asked:  # who sends that does not wait
            ends[0] = time.monotonic() + _AT_WORK

    try:
        _run(interrupt, asked, at_work)
    except KeyboardInterrupt:  # as _run was left
        os._exit(128 + asked[0] if asked else 130)


def _run(
    interrupt: Callable[[int, Any], None], asked: list[int], at_work: Callable[[], None]
) -> None:
    try:
        for number in _ENDS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, interrupt)

        def lost(what: Any) -> None:
            """An exception that Python reports and forgets."""
            if asked and issubclass(what.exc_type, KeyboardInterrupt):
                _end(asked[0])
            sys.__unraisablehook__(what)

        sys.unraisablehook = lost
        from ambrose.cli import main as command

        command(obj=at_work)
    except BaseException as error:
        if not asked:
            raise
        if not isinstance(error, SystemExit):  # while importing
            _say()
        # SystemExit would end as a death by SIGINT where the interruption passed through exec() on
        # its way
        os._exit(128 + asked[0])
    finally:
        for number in _ENDS:
            signal.signal(number, signal.SIG_IGN)
        # memory goes back with the process: to look through all of it for cycles first is a fifth
        # of a short command
        gc.freeze()


def _end_late(number: int, ends: list[float]) -> None:
    while (left := ends[0] - time.monotonic()) > 0:
        time.sleep(left)
    _end(number)


def _end(number: int) -> None:
    _say()
    os._exit(128 + number)


def _say() -> None:
    with suppress(OSError):
        os.write(2, _WORDS)


if __name__ == "__main__":
    main()
