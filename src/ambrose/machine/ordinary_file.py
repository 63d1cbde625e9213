"""Which files are read and replaced: ordinary ones. A pipe or a device would never end, or would be
lost under a new file.
"""

from __future__ import annotations

import os
import re
import stat
import unicodedata
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, check_path

_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe (FIFO)",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFLNK: "a symbolic link",
}
_LONGEST_NAME = 60  # characters, of at most four bytes each: file systems take 255


def check_source(path: Any, what: str) -> Path:
    """``path``, after refusing what is no ordinary file or a link to one; ``what`` it holds, for
    the message.

    Raises InvalidInput; where there is nothing at all, its cause is a FileNotFoundError.
    """
    path = check_path(path, what)
    try:
        status = path.stat()
        endless = stat.S_ISREG(status.st_mode) and not status.st_size and bool(_start(path, 1))
    except FileNotFoundError as error:
        raise InvalidInput(f"{path} is not a file; check the name") from error
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if not stat.S_ISREG(status.st_mode):
        raise InvalidInput(
            f"{path} is {_kind(status.st_mode)}, but must be a file; give the path of a {what}"
        )
    if endless:
        raise InvalidInput(
            f"{path} is a file of the system that states no size; copy what it holds into a file "
            "first"
        )
    return path


def read_text(path: Any, what: str, largest: int = 10_000_000) -> str:
    """The UTF-8 text, without a byte order mark, of an ordinary file of at most ``largest`` bytes.
    Raises InvalidInput.
    """
    path = check_source(path, what)
    try:
        data = _start(path, largest + 1)
    except OSError as error:
        raise _unreadable(path, error) from error
    if len(data) > largest:
        raise InvalidInput(f"{path} has more than {largest} bytes; that is no {what}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{error.object[error.start]:02x}"
        raise InvalidInput(f"{path} is not UTF-8 text ({byte}); save it as UTF-8 text") from None


def refuse_special(target: Path, what: str) -> None:
    """Raises InvalidInput where something stands at ``target`` that a new file would destroy: a
    link, a pipe, a device.
    """
    try:
        mode = target.lstat().st_mode
    except (OSError, ValueError):
        return  # nothing there, or writing will say why not
    if not stat.S_ISREG(mode):
        remedy = (
            "give the path of the file itself"
            if stat.S_ISLNK(mode)
            else "give another path, or remove it"
        )
        raise InvalidInput(
            f"cannot write the {what} {target}: it is {_kind(mode)}, and no file replaces one; "
            f"{remedy}"
        )


def file_name(text: str) -> str:
    """A name that users chose, fit to be (part of) the name of a file anywhere: letters, digits,
    ``_``, ``-``, ``.`` inside.
    """
    plain = re.sub(r"[^\w.-]+", "-", unicodedata.normalize("NFC", text))
    return re.sub(r"\.{2,}", ".", plain)[:_LONGEST_NAME].strip(".-") or "unnamed"


def _start(path: Path, size: int) -> bytes:
    """The first bytes of a file, without waiting: a pipe may have come there since it was looked
    at.
    """
    with open(
        path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
    ) as file:
        return file.read(size) or b""


def _kind(mode: int) -> str:
    return _KINDS.get(stat.S_IFMT(mode), "no ordinary file")


def _unreadable(path: Path, error: Exception) -> InvalidInput:
    return InvalidInput(
        f"{path} cannot be read: {getattr(error, 'strerror', None) or error}; check its name and "
        "permissions"
    )
