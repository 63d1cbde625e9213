"""One thread for linear algebra: the matrices here have some hundred rows, where a second thread
costs more processor time than it saves.

OpenBLAS, BLIS and MKL start as many threads as there are processors. ``one_thread`` holds them to
one while it is entered, by threadpoolctl, and gives the caller's number back at the end. Where
several Python threads are inside at once, the first one in sets the limit and lifts it at its own
end; what the others compute after that takes the caller's number, which costs time and nothing
else. Whoever sets a number in the environment (``OPENBLAS_NUM_THREADS`` and the like) keeps it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from threading import Lock
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])
VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "OMP_NUM_THREADS",
)

_limited = Lock()  # held by the one who set the limit, whatever is called within it


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra with one thread, unless one of ``VARIABLES`` is set."""
    if any(os.environ.get(name) for name in VARIABLES) or not _limited.acquire(blocking=False):
        yield
        return
    try:
        with _libraries().limit(limits=1, user_api="blas"):
            yield
    finally:
        _limited.release()


def in_one_thread(function: Function) -> Function:
    """Decorator: the function's linear algebra runs in one thread."""

    @wraps(function)
    def limited(*args: Any, **keywords: Any) -> Any:
        with one_thread():
            return function(*args, **keywords)

    return limited  # type: ignore[return-value]


@cache
def _libraries() -> Any:
    """The libraries for linear algebra in this process: that of numpy and that of scipy, which
    may be two, so both are loaded first."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
