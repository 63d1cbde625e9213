"""The clock of a live rig and of the pages that look at it; a test has one that it advances."""

from __future__ import annotations

import asyncio
import time


class Clock:
    """Time that goes by, and what this computer uses of it."""

    def now(self) -> float:
        """Seconds since whenever."""
        return time.perf_counter()

    def used(self) -> float:
        """Seconds of a processor that the calling thread has used."""
        return time.thread_time()

    async def until(self, due: float) -> None:
        """Waits until it is ``due`` [s]; others come to their turn in any case."""
        await asyncio.sleep(max(due - self.now(), 0.0))
