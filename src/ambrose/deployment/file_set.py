"""Several files that belong together: all of them appear, or none."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from ambrose.core.checks import InvalidInput


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
    if target.exists() and not target.is_dir():
        raise InvalidInput(f"cannot write to {target}: it is a file; give the path of a folder")
    if not target.parent.is_dir():
        raise InvalidInput(f"cannot write to {target}: {target.parent} is not a directory; create it first")
    blocked = [name for name in names if (target / name).is_dir()]
    if blocked:
        raise InvalidInput(f"cannot write {target / blocked[0]}: it is a directory; remove it or give another folder")
    return target
