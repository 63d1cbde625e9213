"""Where the compiled rig is kept between runs, and what happens where it cannot be."""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections import namedtuple
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numba import typeof
from numba.core.caching import UserProvidedCacheLocator

from ambrose import StateSpace, load_machine
from ambrose.machine.description import OperatingPoint
from ambrose.machine.ordinary_file import claimed
from ambrose.rig.engine.controller import sampled_law
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


def test_it_waits_for_a_process_that_compiles_the_same(monkeypatch, tmp_path):
    """Workers of a new installation compiled the rig each, half a minute of all processors."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    compile_kept((doubled,))[0](2.0)
    (kept,) = compile_kept((doubled,))  # which loads what is there, in milliseconds
    found = []
    with claimed(Path(kept.stats.cache_path, "compiled"), "lock of the other process"):
        other = threading.Thread(target=lambda: found.append(kept(2.0)))
        other.start()
        other.join(1.5)
        assert not found
    other.join(60)
    assert found == [4.0]


def test_every_law_is_of_the_type_that_the_rig_is_compiled_for():
    """A lock against writing is part of numba's types: the rig was compiled anew for each set of
    matrices that came so.
    """
    pump = load_machine("turbomolecular-pump")
    m, rng = len(pump.axes), np.random.default_rng(0)
    sizes = ((6, 6), (6, m), (m, 6), (m, m))
    types = set()
    for order, dt in product("CF", (None, 1e-4)):
        A, B, C, D = (np.array(1e-3 * rng.standard_normal(size), order=order) for size in sizes)
        errors, currents = ([f"{kind}_{axis}" for axis in pump.axes] for kind in ("err", "u"))
        law = StateSpace(A - np.eye(6) * (dt is None), B, C, D, errors, currents, dt)
        for delay in (0, 1, 2):
            types.add(typeof(sampled_law(law, pump, 1e-4, OperatingPoint(), delay)))
    assert len(types) == 1
