"""The chain as one list."""

import pytest

from ambrose.chain import commissioning, study
from ambrose.chain.stages import Stage, walk


def test_each_stage_gets_what_it_needs_and_is_announced():
    told = []
    stages = (
        Stage("double", ("x",), lambda x: 2 * x, "doubling"),
        Stage("sum", ("double", "x"), lambda a, b: a + b),
    )
    made = walk(stages, {"x": 2, "progress": told.append})
    assert (made["double"], made["sum"], told) == (4, 6, ["doubling"])


@pytest.mark.parametrize(
    ("stages", "given"),
    [
        (study.STAGES, {"machine", "directory", "progress"}),
        (
            commissioning.STAGES,
            {"site", "machine", "reference", "controller", "directory", "progress"},
        ),
    ],
    ids=["study", "commissioning"],
)
def test_no_stage_needs_what_is_made_after_it(stages, given):
    known = set(given)
    for stage in stages:
        assert set(stage.needs) <= known, stage.name
        assert stage.name not in known
        known.add(stage.name)
