"""A project is a folder of ordinary files: what the page does, the command line reads.

    machine.toml   controllers/*.json   records/*.h5   reports/*.html   code/*/   jobs/*/
    plans/*.toml   campaign/   study/   retuning/

Nothing is kept elsewhere. A name from a page is a slug and an ending that its kind knows; no name
leads out of the folder, also not through a symbolic link.
"""

from __future__ import annotations

import os
import re
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block, Refusal, word
from ambrose.chain.new_machine import new_machine, text_of_file
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import bundled_machines, loads_machine, read_machine_text
from ambrose.machine.file.update import machine_text
from ambrose.machine.ordinary_file import draft_of, make_folder, write_text

# How a project gets its machine: a bundled one, a shaft in a few words, a file that is dropped (a
# machine file, a model of ROSS, a table of stations). One that was there before is kept.


_SHAFT = {"length": "600 mm", "diameter": "40 mm", "speed": "12000 rpm"}


def forms(project: Project) -> list[Block]:
    """The ways to a machine; folded where there is one already."""
    there = project.machine.is_file()
    found = []
    if not there:
        known = blocks.choice("machine", "Machine", list(bundled_machines()), "seal-rig")
        title = "This folder has no machine yet"
        found.append(
            blocks.form("begin", [known], [blocks.button("Begin", "begin", main=True)], title)
        )
        shaft = [blocks.field(key, key.capitalize(), text) for key, text in _SHAFT.items()]
        stands = blocks.field("vertical", "It stands upright", False, "check")
        button = blocks.button("Make it", "template", main=True)
        hint = "All the rest is chosen so that it levitates, and marked as assumed."
        title = "A plain shaft to start from"
        found.append(blocks.form("template", [*shaft, stands], [button], title, hint=hint))
    drop = blocks.field("drop", "Drop a file here, or choose it", kind="file", to="machines")
    files = project.names("machines")
    fields = [drop]
    buttons = []
    if files:
        fields += [
            blocks.choice("source", "Taken from", files),
            blocks.field("speed", "Highest speed, for a rotor alone", "0 rpm"),
        ]
        buttons = [blocks.button("Take it", "take", main=True)]
    hint = f"A machine file, a model of ROSS, a table of stations. {MACHINE} of before is kept."
    title = "A machine from a file"
    found.append(blocks.form("import", fields, buttons, title, folded=there, hint=hint))
    return found


def bundled(project: Project, given: Mapping[str, Any]) -> str:
    """A bundled machine becomes the machine; what was done, in words."""
    begin(project, given.get("machine"))
    return f"{MACHINE} is written."


def template(project: Project, given: Mapping[str, Any]) -> str:
    """A plain shaft becomes the machine; what was done, in words."""
    said: dict[str, Any] = {key: word(given, key) for key in _SHAFT}
    try:
        machine = new_machine(project.root.name, vertical=given.get("vertical") is True, **said)
    except InvalidInput as error:
        beside = {key: str(error) for key in _SHAFT if str(error).startswith(key)}
        raise Refusal(str(error), beside) from None
    return keep(project, machine_text(machine))


def take(project: Project, given: Mapping[str, Any]) -> str:
    """A file of the folder machines becomes the machine; what was done, in words."""
    path = project.path("machines", given.get("source"))
    text = text_of_file(path, word(given, "speed"))
    try:
        loads_machine(text, path.name)
    except InvalidInput as error:
        raise Refusal(str(error)) from None
    return keep(project, text)


def keep(project: Project, text: str) -> str:
    """A text as the machine file, the one before beside it; what was done, in words."""
    told = f"{MACHINE} is written."
    if project.machine.is_file():
        before = project.free("machines", "before")
        write_text(before, read_machine_text(project.machine), "machine file")
        told += f" What it was is machines/{before.name}."
    write_text(project.machine, text, "machine file")
    return told


MACHINE = "machine.toml"
# endings of what a folder of the project holds; the first one is written
KINDS: dict[str, tuple[str, ...]] = {
    "controllers": (".json", ".csv", ".mat"),
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
                f"{text[:60]!r} is not a file name in {kind}; "
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
    known = bundled_machines()
    if not isinstance(name, str) or name not in known:
        raise InvalidInput(
            f"there is no bundled machine {str(name)[:60]!r}; choose one that the page lists"
        )
    if project.machine.exists():
        raise InvalidInput("the project has a machine file already; remove it first")
    text = known[name].read_text(encoding="utf-8")
    write_text(project.machine, text, "machine file")


# Files that a page sends: into a folder of the project, under a name that it can have, of limited
# size; what is in them is looked at later, by readers in a process of their own.


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
