"""What a run remembers: nothing outside of one, and nothing of it afterwards."""

from __future__ import annotations

from ambrose.core.processes import recalled, remembering


def test_a_result_is_made_once_within_a_run_and_anew_outside():
    made = []

    def make():
        made.append(None)
        return len(made)

    assert [recalled("a", 1, make), recalled("a", 1, make)] == [1, 2]
    with remembering():
        with remembering():
            assert recalled("a", 1, make) == 3
        assert [recalled("a", 1, make), recalled("a", 2, make), recalled("b", 1, make)] == [3, 4, 5]
    assert recalled("a", 1, make) == 6
