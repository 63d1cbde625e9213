"""What was computed before within one run, and need not be computed again.

    with remembering():
        one = recalled("plant", (machine, point), lambda: assemble(machine, point))
        same = recalled("plant", (machine, point), lambda: assemble(machine, point))

Outside of ``remembering`` nothing is kept. What is kept is shared by all who ask for it: results
that nobody changes (rule 2 of docs/design.md).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

Result = TypeVar("Result")
_kept: ContextVar[dict[tuple[str, Hashable], Any] | None] = ContextVar("kept", default=None)


@contextmanager
def remembering() -> Iterator[None]:
    """Results of ``recalled`` are kept until the outermost of these ends."""
    if _kept.get() is not None:
        yield
        return
    before = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(before)


def recalled(kind: str, key: Hashable, make: Callable[[], Result]) -> Result:
    """What ``make`` gave for this kind of result and this key before, else what it gives now.

    key: all that the result depends on.
    """
    kept = _kept.get()
    if kept is None:
        return make()
    if (kind, key) not in kept:
        kept[kind, key] = make()
    result: Result = kept[kind, key]
    return result
