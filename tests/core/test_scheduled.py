"""Scheduled systems: interpolation, range, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem, interval_points
from ambrose.core.statespace import StateSpace, rename

GRID = [10.0, 20.0, 50.0]


def member(seed: int, n: int = 3, dt: float | None = None) -> StateSpace:
    rng = np.random.default_rng(seed)
    shapes = ((n, n), (n, 2), (2, n), (2, 2))
    return StateSpace(*(rng.standard_normal(s) for s in shapes), ["err_a", "err_b"], ["u_a", "u_b"], dt)


MEMBERS = [member(i) for i in range(3)]


def test_grid_points_are_met_exactly_and_between_is_linear():
    scheduled = ScheduledSystem(GRID, MEMBERS)
    for value, system in zip(GRID, MEMBERS, strict=True):
        for x in "ABCD":
            np.testing.assert_array_equal(getattr(scheduled.at(value), x), getattr(system, x))
    found = scheduled(30.0)
    for x in "ABCD":
        np.testing.assert_allclose(getattr(found, x), 2 / 3 * getattr(MEMBERS[1], x) + 1 / 3 * getattr(MEMBERS[2], x))
    assert (found.inputs, found.outputs) == (("err_a", "err_b"), ("u_a", "u_b"))
    assert (scheduled.n_states, scheduled.dt, scheduled.range) == (3, None, (10.0, 50.0))


def test_linear_in_between_is_continuous_across_the_grid():
    scheduled = ScheduledSystem(GRID, MEMBERS)
    np.testing.assert_allclose(scheduled.at(20 - 1e-9).A, scheduled.at(20 + 1e-9).A, atol=1e-8)


@pytest.mark.parametrize("value", [9.0, 51.0, -1e3])
def test_outside_is_refused_with_range_and_remedy(value):
    with pytest.raises(InvalidInput, match=r"the speed is .* rad/s, but must be between 10 and 50 rad/s; .*clamp"):
        ScheduledSystem(GRID, MEMBERS).at(value)


def test_rounding_of_the_ends_is_no_excursion():
    scheduled = ScheduledSystem(GRID, MEMBERS)
    np.testing.assert_array_equal(scheduled.at(50 * (1 + 1e-12)).A, MEMBERS[2].A)
    np.testing.assert_array_equal(scheduled.at(10 * (1 - 1e-12)).A, MEMBERS[0].A)


def test_clamped_outside_is_the_nearest_end():
    scheduled = ScheduledSystem(GRID, MEMBERS, outside="clamp")
    np.testing.assert_array_equal(scheduled.at(1e3).A, MEMBERS[2].A)
    np.testing.assert_array_equal(scheduled.at(0.0).D, MEMBERS[0].D)


@pytest.mark.parametrize(
    ("grid", "systems", "message"),
    [
        ([10.0], MEMBERS[:1], r"at least 2"),
        ([10.0, 10.0, 20.0], MEMBERS, r"ascending"),
        ([20.0, 10.0, 50.0], MEMBERS, r"ascending"),
        ([10.0, np.nan, 50.0], MEMBERS, r"finite"),
        (GRID, MEMBERS[:2], r"number of systems is 2"),
        (GRID, [*MEMBERS[:2], member(2, 4)], r"n_states of system 3 is 4"),
        (GRID, [*MEMBERS[:2], rename(MEMBERS[2], ["err_a", "err_c"])], r"inputs of system 3"),
        (GRID, [*MEMBERS[:2], member(2, dt=1e-4)], r"dt of system 3"),
    ],
)
def test_bad_schedules_are_refused(grid, systems, message):
    with pytest.raises(InvalidInput, match=message):
        ScheduledSystem(grid, systems)


def test_unknown_way_to_treat_the_outside_is_refused():
    with pytest.raises(InvalidInput, match="outside"):
        ScheduledSystem(GRID, MEMBERS, outside="extrapolate")


@pytest.mark.parametrize("value", [np.nan, [10.0, 20.0], "fast"])
def test_a_value_that_is_no_number_is_refused(value):
    with pytest.raises(InvalidInput, match="speed"):
        ScheduledSystem(GRID, MEMBERS).at(value)


def test_points_between():
    np.testing.assert_allclose(interval_points(GRID, 1), [10, 15, 20, 35, 50])
    np.testing.assert_allclose(interval_points(GRID, 0), GRID)
