"""The border of the plain notch against poles that the benchmark puts together by itself."""

import pytest
from benchmarks import synchronous as truth


def test_the_border_is_that_of_the_sampled_full_plant():
    found = truth.border_of("flywheel")
    assert found is not None
    border, brute = found
    assert border == pytest.approx(brute, rel=0.01)


@pytest.mark.study
@pytest.mark.parametrize("name", ["overhung-blower", "turbomolecular-pump", "process-compressor"])
def test_the_borders_of_other_machines(name):
    found = truth.border_of(name)
    assert found is not None
    assert found[0] == pytest.approx(found[1], rel=0.01)
