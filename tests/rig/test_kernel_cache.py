"""Where the compiled rig is kept between runs, and what happens where it cannot be."""

from __future__ import annotations

import shutil
from collections import namedtuple

import pytest

from ambrose.rig.engine.kernel import entry_points


@pytest.mark.parametrize(("free", "kept"), [(1 << 30, True), (1 << 20, False)])
def test_nothing_is_kept_on_a_full_disk(monkeypatch, tmp_path, free, kept):
    """Writing it there failed in the first run of the rig, and ended a study after its designs."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    usage = namedtuple("usage", "total used free")(free, 0, free)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    advance, slope = entry_points("test")
    assert (advance.stats.cache_path is not None) is kept
    assert (slope.stats.cache_path is not None) is kept
