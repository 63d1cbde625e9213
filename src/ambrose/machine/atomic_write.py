"""Files that appear complete or not at all: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ambrose.core.checks import InvalidInput, invalid


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
