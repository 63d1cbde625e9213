"""The difference of parameters between two controllers, and the way back."""

from __future__ import annotations

import ctypes
import json
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

import ambrose as amb
from ambrose.code.sampled import Change, Difference, checksum_of, parameter_difference
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from needs import needs

_AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
# no machine: its loop has been judged elsewhere
_LIMITS = {"force": True, "error_limit": 4e-4, "current_limit": 5.0}
_HOW = {"to": "c", "rate": 10e3, "delay_samples": 1, **_LIMITS}


def _bank(gain: float, corner: float) -> StateSpace:
    """Four alike channels, gain (s/w + 1)/(s/8w + 1), with its own names."""
    pole, four = -8 * corner, np.eye(4)
    return StateSpace(
        pole * four,
        four,
        gain * 8 * (corner + pole) * four,
        8 * gain * four,
        [f"err_{axis}" for axis in _AXES],
        [f"u_{axis}" for axis in _AXES],
    )


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Folder of the running controller, folder of the one that replaces it, its delivery."""
    folder = tmp_path_factory.mktemp("difference")
    old, new = _bank(4.0e4, 900.0), _bank(5.1e4, 700.0)
    amb.export(old, folder / "old", **_HOW)
    delivery = amb.export(new, folder / "new", replaces=old, **_HOW)
    return folder / "old", folder / "new", delivery


def _source(folder: Path) -> str:
    return (folder / "controller.c").read_text()


def _same_code(one: str, other: str) -> bool:
    """The same but for the comments at the head."""
    return [line for line in one.splitlines() if "/*" not in line] == [
        line for line in other.splitlines() if "/*" not in line
    ]


def test_difference_makes_the_new_unit_of_the_old_one_and_back(exported):
    old, new, delivery = exported
    difference = delivery.difference
    assert difference is not None
    assert difference.changes
    assert _same_code(difference.apply(_source(old)), _source(new))
    assert _same_code(difference.reversed().apply(_source(new)), _source(old))
    # tables are changed, limits are not
    tables = {change.table for change in difference.changes}
    assert "direct" in tables
    assert tables.isdisjoint({"error_limit", "current_limit"})


def test_files_say_the_same(exported):
    old, new, delivery = exported
    said = json.loads((new / "parameters.json").read_text())
    back = json.loads((new / "parameters-back.json").read_text())
    assert said["checksum_before"] == back["checksum_after"] == checksum_of(_source(old))
    assert said["checksum_after"] == back["checksum_before"] == checksum_of(_source(new))
    assert [(row["before"], row["after"]) for row in said["changes"]] == [
        (row["after"], row["before"]) for row in back["changes"]
    ]
    assert {new / "parameters.json", new / "parameters-back.json"} <= set(delivery.paths)


@needs("C compiler")
def test_checksum_is_that_of_the_doubles_in_memory(exported, tmp_path):
    """A program of the test's own walks over the tables in memory and forms the CRC by zlib."""
    old, _, delivery = exported
    names = list(delivery.difference.sizes)
    reader = "".join(
        f"const double *table_{n}(void) {{ return (const double *){n}; }}\n" for n in names
    )
    (tmp_path / "unit.c").write_text(f'#include "{old / "controller.c"}"\n{reader}')
    library = tmp_path / "unit.so"
    command = ["cc", "-shared", "-fPIC", f"-I{old}", "-o", str(library), str(tmp_path / "unit.c")]
    subprocess.run(command, check=True)
    unit, crc = ctypes.CDLL(str(library)), 0
    for name, size in delivery.difference.sizes.items():
        place = getattr(unit, f"table_{name}")
        place.restype = ctypes.POINTER(ctypes.c_double)
        crc = zlib.crc32(struct.pack(f"<{size}d", *(x + 0.0 for x in place()[:size])), crc)
    assert f"{crc:08x}" == delivery.difference.checksum_before


def test_it_refuses_a_unit_that_holds_another_controller(exported):
    _, new, delivery = exported
    with pytest.raises(InvalidInput, match="read out which controller runs"):
        delivery.difference.apply(_source(new))


def test_a_damaged_difference_is_noticed(exported):
    old, _, delivery = exported
    whole = delivery.difference
    first = whole.changes[0]
    changes = (Change(first.table, first.index, first.before, "1.25"), *whole.changes[1:])
    damaged = Difference(changes, whole.sizes, whole.checksum_before, whole.checksum)
    with pytest.raises(InvalidInput, match="damaged"):
        damaged.apply(_source(old))


def test_another_structure_has_no_difference(tmp_path):
    stiff = StateSpace(
        np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((4, 0)), 4e4 * np.eye(4), *_names()
    )
    delivery = amb.export(_bank(4e4, 900.0), tmp_path, replaces=stiff, **_HOW)
    assert delivery.difference is None
    assert "not the same structure" in delivery.not_alike
    assert not (tmp_path / "parameters.json").exists()


def _names() -> tuple[list[str], list[str]]:
    return [f"err_{axis}" for axis in _AXES], [f"u_{axis}" for axis in _AXES]


def test_tables_of_other_sizes_are_refused():
    one = "static const real gain[N] = {1.0, 2.0};"
    with pytest.raises(InvalidInput, match="not the same size"):
        parameter_difference(one, "static const real gain[N] = {1.0};")


def test_only_c_has_tables(tmp_path):
    with pytest.raises(InvalidInput, match="write C"):
        amb.export(_bank(4e4, 900.0), tmp_path, to="mat", **_LIMITS, replaces=_bank(1e4, 9.0))
