"""The time limit of a synthesis, in computing time, so that a busy machine does not change its
result.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from ambrose.core.checks import check_positive

_PATIENCE = 5.0  # times the limit: the guard by the clock on the wall


# the methods of ``design`` and the command line have a limit of their own, and no option for it
REMEDY = "take fewer states, modes or points (in Python a function's time_limit gives it more)"


def _computing() -> float:
    return time.thread_time()


def _wall() -> float:
    return time.monotonic()


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """``seconds`` of computing by the thread that made this object, and five times as many on the
    wall as an outer guard.

    The thread's own time: other programs, other threads of the process and the threads of a linear
    algebra library do not count. Raises InvalidInput unless the limit is positive.
    """

    seconds: float
    _computed: float = field(default_factory=_computing)
    _begun: float = field(default_factory=_wall)

    def __post_init__(self) -> None:
        check_positive(self.seconds, "time_limit", "give seconds")

    @property
    def elapsed(self) -> float:
        """Seconds on the wall since the start."""
        return _wall() - self._begun

    @property
    def left(self) -> float:
        """Seconds that remain, of computing or on the wall, whichever ends first; not positive when
        the limit is reached.
        """
        return min(
            self.seconds - (_computing() - self._computed),
            _PATIENCE * self.seconds - self.elapsed,
        )

    @property
    def reached(self) -> str:
        """What to say when nothing is left."""
        if _computing() - self._computed < self.seconds:
            return (
                f"{_PATIENCE:g} times the time limit of {self.seconds:g} s passed, on a busy "
                f"machine; {REMEDY}"
            )
        return f"the time limit of {self.seconds:g} s was reached; {REMEDY}"
