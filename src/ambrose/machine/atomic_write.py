"""Files that appear complete or not at all: written under a temporary name, then renamed. Several together: all or none."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import to_plain
from ambrose.machine.ordinary_file import refuse_special


@contextmanager
def draft_of(path: str | os.PathLike[str], what: str) -> Iterator[Path]:
    """A temporary name beside ``path``; after the block it replaces ``path``, or is removed if the block failed.

    what: the kind of file, for the message. Raises InvalidInput where the place cannot be written.
    """
    target = Path(path)
    if not target.name or target.is_dir():
        raise invalid(f"the path of the {what}", repr(str(target)), "that of a file", "add a file name")
    if not target.parent.is_dir():
        raise InvalidInput(
            f"cannot write the {what} {target}: {target.parent} is not a directory; "
            "give a file in an existing folder, or create the folder first"
        )
    refuse_special(target, what)
    draft = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.tmp")
    try:
        yield draft
        os.replace(draft, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot write the {what} {target}: {reason}; give a file in an existing, writable folder"
        ) from error
    finally:
        draft.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write ``text`` (UTF-8) to ``path`` in one step. Returns the path. Raises InvalidInput."""
    with draft_of(path, what) as draft, draft.open("x", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    return Path(path)


def write_json(path: str | os.PathLike[str], content: Any, what: str = "result file") -> Path:
    """``content`` as a JSON file in one step, infinities and NaN as strings. Raises InvalidInput."""
    return write_text(path, json.dumps(to_plain(content), indent=1) + "\n", what)


def write_files(directory: str | os.PathLike[str], files: Mapping[str, str | bytes]) -> list[Path]:
    """Write texts (UTF-8) and bytes by name into ``directory``, made if absent (its parent must exist). Returns their paths.

    Everything is written and flushed beside the directory first, so that a full disk or an unwritable place leaves what was
    there before; then a new directory appears in one step, and in one that exists the files are replaced one after the other.
    Raises InvalidInput.
    """
    target = check_place(directory, files)
    draft: Path | None = None
    try:
        draft = Path(
            tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".tmp", dir=target if target.is_dir() else target.parent)
        )
        for name, content in files.items():
            with (draft / name).open("xb") as stream:
                stream.write(content.encode() if isinstance(content, str) else content)
                stream.flush()
                os.fsync(stream.fileno())
        if target.is_dir():
            for name in files:
                os.replace(draft / name, target / name)
        else:
            draft.chmod(0o755)
            os.replace(draft, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(f"cannot write to {target}: {reason}; nothing was changed there, give a writable folder") from error
    finally:
        if draft is not None and draft.exists():
            shutil.rmtree(draft, ignore_errors=True)
    return [target / name for name in files]


def check_place(directory: str | os.PathLike[str], names: Iterable[str] = ()) -> Path:
    """``directory`` as a path, after refusing one that cannot become or hold these files. Raises InvalidInput."""
    target = Path(directory)
    if os.path.lexists(target) and not target.is_dir():
        raise InvalidInput(f"cannot write to {target}: it is no folder; give the path of one")
    if not target.parent.is_dir():
        raise InvalidInput(f"cannot write to {target}: {target.parent} is not a directory; create it first")
    for name in names:
        refuse_special(target / name, "file")
    return target
