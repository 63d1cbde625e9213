"""Where the compiled rig is kept between runs, and what happens where it cannot be."""

from __future__ import annotations

import shutil
import tempfile
from collections import namedtuple
from pathlib import Path

import pytest
from numba.core.caching import UserProvidedCacheLocator

from ambrose.rig.engine.kernel import entry_points
from ambrose.rig.engine.products import compile_kept, is_kept, private_folder


@pytest.mark.parametrize(("free", "kept"), [(1 << 30, True), (1 << 20, False)])
def test_nothing_is_kept_on_a_full_disk(monkeypatch, tmp_path, free, kept):
    """Writing it there failed in the first run of the rig, and ended a study after its designs."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    usage = namedtuple("usage", "total used free")(free, 0, free)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    advance, slope = entry_points("test")
    assert (advance.stats.cache_path is not None) is kept
    assert (slope.stats.cache_path is not None) is kept


def doubled(x):
    return 2 * x


def test_where_numba_has_no_place_a_private_folder_keeps_it(monkeypatch, tmp_path):
    """A read-only image run by a user without a home compiled the rig at every run."""
    (tmp_path / "file").touch()
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "file" / "none"))
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [UserProvidedCacheLocator])
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for already in (False, True):  # the second stands for the next process
        (kept,) = compile_kept((doubled,))
        assert is_kept(kept) is already
        assert kept(2.0) == 4.0
    folder = Path(private_folder())
    assert folder.parent == tmp_path and folder.stat().st_mode & 0o077 == 0
    folder.chmod(0o777)
    with pytest.raises(PermissionError, match="alone"):
        private_folder()
    assert compile_kept((doubled,))[0].stats.cache_path is None
