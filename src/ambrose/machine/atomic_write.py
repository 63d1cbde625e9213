"""Files that appear complete or not at all: written under a temporary name, then renamed. Several
together: all or none.
"""

from __future__ import annotations

import io
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, check_path, invalid
from ambrose.core.presentation import json_text
from ambrose.machine.claim import claimed
from ambrose.machine.ordinary_file import refuse_special

# in a folder: old and new files of a write that was killed while it replaced them
INTERRUPTED = "interrupted-write"


@contextmanager
def draft_of(path: str | os.PathLike[str], what: str, new: bool = False) -> Iterator[Path]:
    """A temporary name beside ``path``; after the block it replaces ``path``, or is removed if the
    block failed.

    What was written is on the disk before it gets its name. what: the kind of file, for the
    message; new: nothing that stands there by then is replaced. Raises InvalidInput where the place
    cannot be written.
    """
    target = check_file(path, what)
    draft = _beside(target)
    try:
        yield draft
        with draft.open("rb+") as written:
            os.fsync(written.fileno())
        if new:
            os.link(draft, target)
        else:
            os.replace(draft, target)
    except FileExistsError as error:
        raise InvalidInput(
            f"{target.name} was written by another meanwhile and is kept; write it again"
        ) from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot write the {what} {target}: {reason}; give a file in an existing, writable "
            "folder"
        ) from error
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
    _settle(target.parent)


class Steady(io.FileIO):
    """A new file for libraries that crash where a disk is full: they are told that all is well, and
    its end raises OSError.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x+")
        self.failed: OSError | None = None

    def write(self, data: Any, /) -> int:
        view = memoryview(data).cast("B")
        done = 0
        try:
            while done < len(view) and self.failed is None:
                done += super().write(view[done:]) or 0
        except OSError as error:
            self.failed = error
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.failed = self.failed or error
            return self.tell() if size is None else size

    def __exit__(self, *reason: Any) -> None:
        super().__exit__(*reason)
        if self.failed is not None:
            raise self.failed


def set_aside(path: Path) -> None:
    """What stands at ``path``, if anything, makes room and is called ``earlier-<name>``. Raises
    InvalidInput.
    """
    earlier = path.with_name(f"earlier-{path.name}")
    try:
        if os.path.lexists(path):
            if earlier.is_dir() and not earlier.is_symlink():
                shutil.rmtree(earlier)
            os.replace(path, earlier)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot rename {path} to {earlier.name}: {reason}; remove one of them"
        ) from error


def make_folder(path: str | os.PathLike[str]) -> Path:
    """The folder ``path``, made with those above it if absent. Raises InvalidInput."""
    path = check_path(path, "folder")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot make the folder {path}: {reason}; give one that can be written"
        ) from error
    return path


def check_file(path: str | os.PathLike[str], what: str) -> Path:
    """``path``, after refusing one that cannot become a file. Raises InvalidInput."""
    target = check_path(path, what)
    if not target.name or target.is_dir():
        raise invalid(
            f"the path of the {what}", repr(str(target)), "that of a file", "add a file name"
        )
    if not target.parent.is_dir():
        raise InvalidInput(
            f"cannot write the {what} {target}: {target.parent} is not a directory; "
            "give a file in an existing folder, or create the folder first"
        )
    refuse_special(target, what)
    return target


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write ``text`` (UTF-8) to ``path`` in one step. Returns the path. Raises InvalidInput."""
    with draft_of(path, what) as draft, draft.open("x", encoding="utf-8") as stream:
        stream.write(text)
    return Path(path)


def write_json(path: str | os.PathLike[str], content: Any, what: str = "result file") -> Path:
    """``content`` as a JSON file in one step, infinities and NaN as strings. Raises
    InvalidInput.
    """
    return write_text(path, json_text(content, indent=1) + "\n", what)


def write_files(
    directory: str | os.PathLike[str], files: Mapping[str, str | bytes], *, held: bool = False
) -> list[Path]:
    """Write texts (UTF-8) and bytes by name into ``directory``, made if absent (its parent must
    exist). Returns their paths.

    Everything is written and flushed beside the directory first, so that a full disk or an
    unwritable place leaves what was there before; then a new directory appears in one step. In one
    that exists the files are replaced one after the other, and put back where one cannot be; a kill
    meanwhile leaves all of them, old and new, in its folder ``interrupted-write``, and the next
    write into the directory first finishes that one. held: the caller has claimed the directory.
    Raises InvalidInput.
    """
    target = check_place(directory, files)
    with nullcontext() if held else claimed(target, "folder"):
        draft = _beside(target / INTERRUPTED if target.is_dir() else target)
        try:
            if not target.is_dir():
                _fill(draft, files)
                os.replace(draft, target)
                _settle(target.parent)
            else:
                _finish_interrupted(target, draft)
                draft.mkdir()
                _fill(draft / "new", files)
                (draft / "old").mkdir()
                for name in (name for name in files if (target / name).exists()):
                    shutil.copyfile(target / name, draft / "old" / name)
                _settle(draft)
                os.replace(draft, target / INTERRUPTED)
                _switch(target, files, draft)
        except OSError as error:
            reason = error.strerror or str(error)
            state = "nothing was changed there, give a writable folder"
            if (target / INTERRUPTED).exists():
                state = (
                    f"its files, old and new, stand in {target / INTERRUPTED}: repeat the write, "
                    "it is finished first"
                )
            raise InvalidInput(f"cannot write to {target}: {reason}; {state}") from error
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    return [target / name for name in files]


def _fill(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """A new folder with these files, all on the disk."""
    folder.mkdir()
    for name, content in files.items():
        with (folder / name).open("xb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
    _settle(folder)


def _switch(target: Path, names: Iterable[str], away: Path) -> None:
    """The new files of an interrupted write get their places, or the old ones back; what is left of
    it goes ``away``.
    """
    interrupted, done = target / INTERRUPTED, []
    try:
        for name in names:
            os.replace(interrupted / "new" / name, target / name)
            done.append(name)
        _settle(target)
    except BaseException:
        for name in done:  # at every moment each new file is whole, here or there, for a kill now
            os.replace(target / name, interrupted / "new" / name)
            if (interrupted / "old" / name).exists():
                os.replace(interrupted / "old" / name, target / name)
        os.replace(interrupted, away)
        raise
    with suppress(OSError):  # it is empty, and in nobody's way
        os.replace(interrupted, away)


def _finish_interrupted(target: Path, away: Path) -> None:
    """A write that was killed while it replaced files: the rest of them."""
    interrupted = target / INTERRUPTED
    if (interrupted / "new").is_dir() and (interrupted / "old").is_dir():
        for path in (interrupted / "new").iterdir():
            os.replace(path, target / path.name)
        _settle(target)
        os.replace(interrupted, away)
        shutil.rmtree(away)


def _beside(path: Path) -> Path:
    """A name for what becomes ``path``."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.tmp")


def _settle(folder: Path) -> None:
    """The names in a folder onto the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def check_place(directory: str | os.PathLike[str], names: Iterable[str] = ()) -> Path:
    """``directory`` as a path, after refusing one that cannot become or hold these files. Raises
    InvalidInput.
    """
    target = check_path(directory, "folder")
    if os.path.lexists(target) and not target.is_dir():
        raise InvalidInput(f"cannot write to {target}: it is no folder; give the path of one")
    if not target.parent.is_dir():
        raise InvalidInput(
            f"cannot write to {target}: {target.parent} is not a directory; create it first"
        )
    for name in names:
        refuse_special(target / name, "file")
    return target
