"""Where the compiled rig is kept between runs.

Numba keeps it beside the source, else in the user's cache folder (NUMBA_CACHE_DIR, XDG_CACHE_HOME
or the system's own). A service on a read-only image may have neither: then in a private folder of
the temporary ones, which lasts until the system clears it.

This module imports numba: import it only inside functions.
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import config

_ROOM = 16 << 20  # bytes free where compiled code is kept, or it is compiled anew in every run


def compile_kept(functions: tuple[Callable[..., Any], ...], **options: Any) -> tuple[Any, ...]:
    """The functions as numba compiles them, kept on disk where there is a place with room."""
    for place in (None, private_folder):
        with suppress(RuntimeError, OSError), _kept_in(place):  # no folder to write to
            kept = tuple(njit(cache=True, **options)(function) for function in functions)
            if shutil.disk_usage(kept[0].stats.cache_path).free > _ROOM:
                return kept
    return tuple(njit(**options)(function) for function in functions)


def is_kept(function: Any) -> bool:
    """Whether a compiled function of ``compile_kept`` has been kept by an earlier run."""
    path = function.stats.cache_path
    return path is not None and any(Path(path).glob(f"*.{function.py_func.__name__}-*.nbi"))


def private_folder() -> str:
    """A folder of this user alone among the temporary ones. Raises OSError where that name is
    another user's, or others may write there: what is loaded from it runs.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"ambrose-compiled-{user}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o022:
        raise PermissionError(f"{folder} is not this user's alone")
    return str(folder)


@contextmanager
def _kept_in(place: Callable[[], str] | None) -> Iterator[None]:
    """Numba's cache in another folder; None: where numba has it."""
    settings: Any = config
    before = settings.CACHE_DIR
    try:
        if place is not None:
            settings.CACHE_DIR = place()
        yield
    finally:
        settings.CACHE_DIR = before
