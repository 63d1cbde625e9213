"""Work in processes beside this one: what it says arrives, what it fails with too, none is left."""

from __future__ import annotations

import multiprocessing
import operator
import os
from multiprocessing import connection

import pytest

from ambrose.chain.stages import beside

SAYS = operator.methodcaller("__call__", "a word")  # called with the progress alone


def test_words_and_failures_of_a_process_arrive_and_no_process_is_left():
    """A function that Python itself has: a process beside this one imports no test."""
    told = []
    before = multiprocessing.active_children()
    with beside(1, told.append) as work:
        future = work.start(SAYS)
        assert work.wait([future]) == {future} and future.result() is None
    assert told == ["a word"] and multiprocessing.active_children() == before
    with pytest.raises(TypeError, match="indices"), beside(1, told.append) as work:
        future = work.start(operator.getitem, [])  # the progress is no index
        work.wait([future])
        future.result()
    assert "OPENBLAS_NUM_THREADS" not in os.environ or os.environ["OPENBLAS_NUM_THREADS"] == "1"


def test_who_listens_may_end_it_all():
    def listens(word):
        raise KeyboardInterrupt

    before = multiprocessing.active_children()
    with pytest.raises(KeyboardInterrupt), beside(1, listens) as work:
        work.wait([work.start(SAYS)])
    left = {child.sentinel for child in set(multiprocessing.active_children()) - set(before)}
    # of the end of a process its own pipe tells: the executor's thread asks for its status too, and
    # whoever asks second is told that the process is still alive
    while left:
        ended = connection.wait(left, 60)
        assert ended
        left.difference_update(ended)
