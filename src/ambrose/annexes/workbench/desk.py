"""Where screens are computed: one process beside the server, so that nothing that takes long or
goes wrong there touches the live rig or what is served.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Any

from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import Project
from ambrose.core.answering import Answering, Unanswered
from ambrose.core.checks import AmbroseError

_LONGEST = 60.0  # [s] of an answer
_FIRST = 0.7  # [s] that the first page has the processors for itself
_Question = tuple[str, str, Mapping[str, Any]]  # screen, action, what the page gives
_Told = tuple[bool, dict[str, Any]]  # whether it was refused, and what the page is told


class Desk:
    """The process of a project's screens, which is asked one thing at a time."""

    def __init__(self, project: Project, longest: float = _LONGEST) -> None:
        self.process = Answering(_screens, str(project.root), longest=longest)
        self._turn = asyncio.Lock()

    async def begin(self) -> None:
        """The process starts, a moment after the server, unless it was asked before."""
        await asyncio.sleep(_FIRST)
        async with self._turn:
            await asyncio.to_thread(self.process.begin)

    async def ask(self, screen: str, action: str, given: Mapping[str, Any]) -> dict[str, Any]:
        """What a screen shows, or what an action made of it. Raises Refusal."""
        question: _Question = screen, action, dict(given)
        async with self._turn:
            try:
                refused, told = await asyncio.to_thread(self.process.ask, question)
            except Unanswered as error:
                words = f"this could not be computed: {error}; try a job or the command line"
                raise Refusal(words) from None
        if refused:
            raise Refusal(told["error"], told["fields"], told["stale"])
        answer: dict[str, Any] = told
        return answer


def _screens(root: str) -> Callable[[_Question], _Told]:
    """In the process: what answers."""
    from ambrose.annexes.workbench.screens import answer, load_all

    project = Project(root)
    load_all()

    def told(question: _Question) -> _Told:
        begun = time.perf_counter()
        try:
            shown = answer(project, *question)
        except Refusal as error:
            return True, error.content
        except AmbroseError as error:
            return True, Refusal(str(error)).content
        except Exception as error:  # a mistake of ours: it is said, and the next question answered
            words = f"this could not be computed, by a mistake of the program: {error!r}"
            return True, Refusal(words).content
        return False, {**shown, "computing": round(1e3 * (time.perf_counter() - begun), 1)}

    return told
