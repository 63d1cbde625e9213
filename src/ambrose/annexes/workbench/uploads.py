"""Files that a page sends: into a folder of the project, under a name that it can have, of limited
size; what is in them is looked at later, by readers in a process of their own.
"""

from __future__ import annotations

import os
import re
from collections.abc import AsyncIterator
from pathlib import Path

from ambrose.annexes.workbench.project import KINDS, Project
from ambrose.core.checks import InvalidInput
from ambrose.machine.atomic_write import draft_of

# bytes of a file of a kind that is taken
LIMITS = {"records": 500_000_000, "controllers": 64_000_000, "machines": 1_000_000}
_PREFIX = "/api/files/"


def limit(path: str) -> int | None:
    """The largest body for an address; None where no file is taken."""
    kind, slash, _ = path.removeprefix(_PREFIX).partition("/")
    return LIMITS.get(kind) if path.startswith(_PREFIX) and slash else None


def place(project: Project, kind: str, name: str) -> Path:
    """Where a file of that name will stand, beside those that are there. Raises InvalidInput."""
    if kind not in LIMITS:
        raise InvalidInput(
            f"no files are taken for {kind[:60]!r}; send them to {' or '.join(LIMITS)}"
        )
    stem, ending = os.path.splitext(name)
    if ending.lower() not in KINDS[kind]:
        raise InvalidInput(f"{name[:60]!r} is none of {', '.join(KINDS[kind])}; choose such a file")
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", stem).strip("-_")[:50] or "file"
    return project.free(kind, plain, ending.lower())


async def receive(path: Path, body: AsyncIterator[bytes]) -> Path:
    """A body as the file at ``path``, complete or not at all. Raises InvalidInput."""
    with draft_of(path, "file", new=True) as draft, draft.open("xb") as file:
        async for part in body:
            file.write(part)
    return path
