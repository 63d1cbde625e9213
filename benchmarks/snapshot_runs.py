"""Which commands the snapshot runs: the lines of ``snapshot_runs.txt``."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

TABLE = Path(__file__).with_suffix(".txt")
_LINE = re.compile(r"(quick|full) +([^:=]+): ([^=]+?) =(.*)")


@dataclass(frozen=True)
class Run:
    """One call of the command line.

    command: the name in `ambrose --help`. label: what is special about this call, unique within
    the command. words: the arguments behind the command. quick: whether the quick level has it.
    """

    command: str
    label: str
    words: tuple[str, ...]
    quick: bool

    @property
    def name(self) -> str:
        return f"{self.command}: {self.label}"

    @property
    def arguments(self) -> list[str]:
        return [*self.command.split(), *self.words]


def every_run() -> list[Run]:
    """All runs of the full level in their order. Raises ValueError for a line of no known form."""
    listed = []
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            match = _LINE.fullmatch(line)
            if not match:
                raise ValueError(
                    f"{TABLE.name}: {line!r} is no 'level  command: label = arguments'"
                )
            level, command, label, words = match.groups()
            listed.append(Run(command, label, tuple(shlex.split(words)), level == "quick"))
    return listed


def runs(*, quick: bool) -> list[Run]:
    """The runs of a level in their order: the quick ones are a part of the full ones."""
    return [run for run in every_run() if run.quick or not quick]
