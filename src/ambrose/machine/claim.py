"""One run at a time into a file or a folder: the second is refused, and nothing that a killed run
leaves is in the way.

The lock is the operating system's, on an empty file beside the place: it ends with the process that
holds it, also by a kill. Where a file system has no locks (some network folders), two runs are not
told apart.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ambrose.core.checks import InvalidInput, check_path

_ATTEMPTS = 100  # to open a lock file that others are removing
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)

if sys.platform == "win32":
    import msvcrt

    def _held_by_another(descriptor: int) -> bool:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return True
        return False

else:
    import fcntl

    def _held_by_another(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            pass
        return False


@contextmanager
def claimed(path: str | os.PathLike[str], what: str, held: str = "") -> Iterator[None]:
    """Holds the file or folder ``path`` against every other run that claims it, until the block
    ends.

    what: the kind of file, for the message; held: what is said where another run holds it. The lock
    file is ``.<name>.lock`` beside it; ``.lock`` in a folder whose own cannot be written. Raises
    InvalidInput where another run holds it, and where no file can be made there.
    """
    target = Path(os.path.realpath(check_path(path, what)))
    lock = target.with_name(f".{target.name}.lock")
    try:
        try:
            descriptor = _hold(lock)
        except PermissionError:
            if not target.is_dir():
                raise
            descriptor = _hold(lock := target / ".lock")
    except BlockingIOError:
        remedy = f"wait until it ends, or write the {what} elsewhere"
        raise InvalidInput(held or f"another run is writing {path}; {remedy}") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot write the {what} {path}: {reason}; give a place in a writable folder"
        ) from error
    try:
        yield
    finally:
        try:
            if sys.platform != "win32":  # there a file that is open cannot be removed
                _remove(lock)
        finally:
            os.close(descriptor)
        if sys.platform == "win32":
            _remove(lock)


def _hold(lock: Path) -> int:
    """The descriptor of the lock file, locked. Raises OSError where it cannot be made,
    BlockingIOError where it is held.
    """
    for _ in range(_ATTEMPTS):
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o666)
        except PermissionError:
            if not lock.is_file():
                raise
            descriptor = os.open(lock, os.O_RDONLY | _NO_LINK)  # somebody else's run left it
        if _held_by_another(descriptor):
            os.close(descriptor)
            break
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                return descriptor
        os.close(descriptor)  # removed by its holder in between
    raise BlockingIOError


def _remove(lock: Path) -> None:
    with suppress(OSError):  # another run may have opened it, or it is gone: harmless either way
        lock.unlink()
