"""A project is a folder of ordinary files: what the page does, the command line reads.

    machine.toml   controllers/*.json   records/*.h5   reports/*.html   code/*/   jobs/*/
    plans/*.toml   campaign/   study/   retuning/

Nothing is kept elsewhere. A name from a page is a slug and an ending that its kind knows; no name
leads out of the folder, also not through a symbolic link.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

from ambrose.core.checks import InvalidInput
from ambrose.machine.atomic_write import make_folder

MACHINE = "machine.toml"
# endings of what a folder of the project holds; the first one is written
KINDS: dict[str, tuple[str, ...]] = {
    "controllers": (".json",),
    "machines": (".toml", ".csv", ".json"),
    "records": (".h5", ".csv", ".hdf5", ".mat", ".tdms", ".uff", ".unv", ".txt", ".toml"),
    "runs": (".h5",),
    "code": (".zip",),
    "plans": (".toml",),
    "campaign": (".html", ".csv", ".jsonl", ".nc"),
    "study": (".html", ".json"),
    "retuning": (".html", ".json", ".toml"),
    "reports": (".html", ".json"),
}
_SLUG = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_LINKS = "symbolic links may not lead out of the project; put the file itself there"


def slug(text: object, what: str) -> str:
    """``text``, after refusing what is no plain name. Raises InvalidInput."""
    if not isinstance(text, str) or not _SLUG.fullmatch(text):
        raise InvalidInput(
            f"the name of the {what} is {str(text)[:60]!r}, but must be letters, digits, _ and -, "
            "60 at most; choose such a name"
        )
    return text


class Project:
    """The files of one folder, which is made where it is absent. Raises InvalidInput."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.root = Path(os.path.realpath(make_folder(folder)))

    @property
    def machine(self) -> Path:
        """The machine file, whether it is there or not. Raises InvalidInput for a link that leads
        out.
        """
        return self.inside(self.root / MACHINE)

    def path(self, kind: str, name: object) -> Path:
        """Where a file of a kind stands or will stand, its folder made. Raises InvalidInput for
        what is no name of such a file.
        """
        if kind not in KINDS:
            raise InvalidInput(
                f"there is no folder {kind[:60]!r}; choose one of {', '.join(KINDS)}"
            )
        text = name if isinstance(name, str) else ""
        stem, dot, ending = text.partition(".")
        if dot + ending.lower() not in KINDS[kind]:
            raise InvalidInput(
                f"{text[:60]!r} is no name of a file in {kind}; "
                f"it ends with {' or '.join(KINDS[kind])}"
            )
        slug(stem, f"file in {kind}")
        return self.inside(self.folder(kind) / text)

    def folder(self, name: str) -> Path:
        """A folder of the project, made where it is absent. Raises InvalidInput for a link that
        leads out, before anything is made there.
        """
        return make_folder(self.inside(self.root / name))

    def newest(self, kind: str, endings: tuple[str, ...] = ("",)) -> str:
        """The file of a kind that was written last; "" where there is none."""
        found = []
        for name in self.names(kind):
            with suppress(OSError):  # gone meanwhile
                if name.endswith(endings):
                    found.append((self.path(kind, name).stat().st_mtime, name))
        return max(found, default=(0.0, ""))[1]

    def names(self, kind: str) -> list[str]:
        """The files of a kind that can be named, sorted."""
        try:
            folder = self.inside(self.root / kind)
            entries = sorted(entry.name for entry in os.scandir(folder))
        except (InvalidInput, OSError):
            return []
        found = []
        for name in entries:
            try:
                if self.path(kind, name).is_file():
                    found.append(name)
            except InvalidInput:
                continue
        return found

    def free(self, kind: str, stem: str, ending: str = "") -> Path:
        """A path of a kind at which nothing stands yet: the stem, with a number where need be.

        ending: another one than the first of the kind.
        """
        ending = ending or KINDS[kind][0]
        number = 1
        path = self.path(kind, stem + ending)
        while os.path.lexists(path):
            number += 1
            path = self.path(kind, f"{stem}-{number}{ending}")
        return path

    def relative(self, path: Path) -> str:
        """A path as a command line in the project's folder writes it."""
        return path.relative_to(self.root).as_posix()

    def inside(self, path: Path) -> Path:
        """``path`` itself. Raises InvalidInput for one whose real place is outside."""
        real = Path(os.path.realpath(path))
        if real != self.root and self.root not in real.parents:
            raise InvalidInput(f"{path.name} leads out of the project: {_LINKS}")
        return path


def begin(project: Project, name: object) -> None:
    """A bundled machine becomes the project's, where it has none. Raises InvalidInput."""
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.file.toml import bundled_machines

    known = bundled_machines()
    if not isinstance(name, str) or name not in known:
        raise InvalidInput(
            f"there is no bundled machine {str(name)[:60]!r}; choose one that the page lists"
        )
    if project.machine.exists():
        raise InvalidInput("the project has a machine file already; remove it first")
    text = known[name].read_text(encoding="utf-8")
    write_text(project.machine, text, "machine file")
