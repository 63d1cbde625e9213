"""The workbench's server in this process, with a live rig on a clock that the test advances."""

import asyncio
import threading
import time

import pytest
import uvicorn

from ambrose.annexes.workbench import server
from ambrose.annexes.workbench.live import Clock
from ambrose.core.processes import listening, names_of

POLL = 0.005  # [s] between two looks at a condition
LIMIT = 800.0  # [s] after which a condition is given up: a hang, whatever else the computer does
STEP = 0.1  # [s] of the clock from frame to frame: as much as a frame makes up for


def eventually(condition, what="it"):
    """Until it is so; what came of it."""
    end = time.monotonic() + LIMIT
    while not (found := condition()):
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(POLL)
    return found


class SteppedClock(Clock):
    """Stands until it is advanced; no processor is ever busy. A frame follows the one before once
    every page has drawn that, so that what is shown depends on the clock alone.
    """

    def __init__(self):
        self.drawn = lambda: True
        self._now = self._end = 0.0
        self._rested = None  # the end that was reached, and drawn

    def now(self):
        return self._now

    def used(self):
        return 0.0

    async def until(self, due):
        while True:
            drawn, end = self.drawn(), self._end
            if drawn and self._now < end:
                break
            self._rested = end if drawn else None
            await asyncio.sleep(POLL)
        self._now = min(self._now + STEP, end)

    def advance(self, seconds):
        """Until that much time went by and is drawn."""
        end = self._end = self._now + seconds
        eventually(lambda: self._rested == end, "the rig's time")


class Served:
    """A project's server behind a port of this computer, until ``end``; the rig by a stepped clock.

    told: how many orders the rig has carried out.
    """

    def __init__(self, project):
        self.clock = SteppedClock()
        self.told = 0
        self.room = None
        self._tokens = []
        listener = listening("127.0.0.1", 0)
        self.host = names_of(listener)[0]
        served = self

        class Room(server.LiveRoom):
            def __init__(self, *given):
                super().__init__(*given)
                served.room = self

            async def _do(self, viewer, message):
                await super()._do(viewer, message)
                served.told += 1

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(server, "LiveRoom", Room)
            app = server.build(project, names_of(listener), self._tokens.append, clock=self.clock)
        self.clock.drawn = self._drawn
        self._server = uvicorn.Server(server.settings(app))
        serving = self._server._serve([listener])  # which leaves the signals alone
        self._thread = threading.Thread(target=asyncio.run, args=(serving,), daemon=True)
        self._thread.start()
        eventually(lambda: self._server.started, "the server")

    def _drawn(self):
        viewers = self.room._viewers
        return all(v.confirmed.is_set() and not v.fresh.is_set() for v in viewers)

    def address(self):
        """One that was not used yet."""
        return f"http://{self.host}/?token={self._tokens[-1]}"

    def obeyed(self, act):
        """Until the rig has carried out what ``act`` asks for, while its clock stands."""
        before = self.told
        act()
        eventually(lambda: self.told > before, "the order")

    def end(self):
        self._server.should_exit = True
        self._thread.join(LIMIT)
        assert not self._thread.is_alive()
