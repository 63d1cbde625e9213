"""The two bundled cases of the seal rig: one machine but for what the pressure moves."""

import difflib
from dataclasses import replace

import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.machine.part import SealTable

RIG, K_ONLY = load_machine("seal-rig"), load_machine("seal-rig-k-only")


def test_the_files_differ_only_in_what_the_pressure_moves():
    one, other = (
        bundled_machines()[name].read_text().splitlines()
        for name in ("seal-rig", "seal-rig-k-only")
    )
    changed = {
        line[2:].split(" = ")[0]
        for line in difflib.ndiff(one, other)
        if line[0] in "-+" and not line.startswith("+ #")
    }
    named = {"name", "description", '"seal coefficients"', '"seal.center.scales_with_pressure"'}
    assert changed == named | {"scales_with_pressure", "parameter"}
    seal, tolerances = K_ONLY.seals[0], (replace(RIG.tolerances[0], parameter="seal.center.k"),)
    assert seal == replace(RIG.seals[0], scales_with_pressure=("k",))
    heads = {"name": K_ONLY.name, "description": K_ONLY.description, "assumed": K_ONLY.assumed}
    assert replace(RIG, seals=(seal,), tolerances=tolerances, **heads) == K_ONLY


def test_a_seal_of_which_only_some_follows_the_pressure_needs_a_reason():
    """Before, K, C and c stayed at zero pressure without a word."""
    with pytest.raises(
        InvalidInput,
        match=r'center: K, C, c would stay at zero pressure.*"seal.center.scales_with_pressure"',
    ):
        replace(RIG, seals=K_ONLY.seals, tolerances=())
    table = SealTable((("pressure", (0.0, 4e5)),), (("k", (0.0, 6e6)),))
    with pytest.raises(InvalidInput, match="center: K would stay"):
        replace(
            RIG,
            seals=(
                replace(RIG.seals[0], k=0.0, C=0.0, c=0.0, scales_with_pressure=(), table=table),
            ),
            tolerances=(),
        )
    # none does: no question
    assert replace(
        RIG, seals=(replace(RIG.seals[0], scales_with_pressure=()),), tolerances=()
    ).seals
