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
    return StateSpace(
        *(rng.standard_normal(s) for s in shapes), ["err_a", "err_b"], ["u_a", "u_b"], dt
    )


MEMBERS = [member(i) for i in range(3)]


def test_grid_points_are_met_exactly_and_between_is_linear():
    scheduled = ScheduledSystem(GRID, MEMBERS)
    for value, system in zip(GRID, MEMBERS, strict=True):
        for x in "ABCD":
            np.testing.assert_array_equal(getattr(scheduled.at(value), x), getattr(system, x))
    found = scheduled(30.0)
    for x in "ABCD":
        np.testing.assert_allclose(
            getattr(found, x), 2 / 3 * getattr(MEMBERS[1], x) + 1 / 3 * getattr(MEMBERS[2], x)
        )
    assert (found.inputs, found.outputs) == (("err_a", "err_b"), ("u_a", "u_b"))
    assert (scheduled.n_states, scheduled.dt, scheduled.range) == (3, None, (10.0, 50.0))


def test_linear_in_between_is_continuous_across_the_grid():
    scheduled = ScheduledSystem(GRID, MEMBERS)
    np.testing.assert_allclose(scheduled.at(20 - 1e-9).A, scheduled.at(20 + 1e-9).A, atol=1e-8)


@pytest.mark.parametrize("value", [9.0, 51.0, -1e3])
def test_outside_is_refused_with_range_and_remedy(value):
    with pytest.raises(
        InvalidInput, match=r"the speed is .* rad/s, but must be between 10 and 50 rad/s; .*clamp"
    ):
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


AXES = ([10.0, 20.0, 50.0], [0.0, 4.0])
SIX = [member(i) for i in range(6)]


def rectangle(systems=SIX, outside="refuse"):
    return ScheduledSystem(AXES, systems, "speed and pressure", "rad/s and Pa", outside)


def test_a_rectangle_meets_its_points_and_is_linear_in_each_parameter():
    """The oracle: multilinear interpolation of every entry by scipy."""
    from scipy.interpolate import RegularGridInterpolator

    law = rectangle()
    for value, system in zip(law.values, SIX, strict=True):
        np.testing.assert_array_equal(law.at(value).A, system.A)
    assert law.values[:3] == [(10.0, 0.0), (10.0, 4.0), (20.0, 0.0)]
    for x in "ABCD":
        entries = np.array([getattr(s, x) for s in SIX]).reshape(3, 2, *getattr(SIX[0], x).shape)
        oracle = RegularGridInterpolator(AXES, entries)
        for value in np.random.default_rng(1).uniform([10, 0], [50, 4], (20, 2)):
            np.testing.assert_allclose(
                getattr(law.at(value), x), oracle(value)[0], rtol=1e-12, atol=1e-14
            )


def test_a_rectangle_refuses_or_clamps_each_parameter_by_itself():
    with pytest.raises(InvalidInput, match=r"the pressure is 5 Pa, but must be between 0 and 4 Pa"):
        rectangle().at((20.0, 5.0))
    with pytest.raises(InvalidInput, match=r"the speed is 9 rad/s"):
        rectangle().at((9.0, 1.0))
    with pytest.raises(InvalidInput, match=r"speed and pressure"):
        rectangle().at(20.0)
    clamped = rectangle(outside="clamp")
    np.testing.assert_array_equal(clamped.at((1e3, -1.0)).A, SIX[4].A)


def test_what_a_rectangle_says_of_itself():
    law = rectangle()
    assert law.words() == "speed 10 to 50 rad/s and pressure 0 to 4 Pa"
    assert law.range == ((10.0, 0.0), (50.0, 4.0))
    assert law.to_dict()["second"] == {"parameter": "pressure", "unit": "Pa", "grid": [0.0, 4.0]}
    with pytest.raises(InvalidInput, match="speed and pressure was given where"):
        _ = law.grid


@pytest.mark.parametrize(
    ("axes", "count", "message"),
    [
        (AXES, 5, r"number of systems is 5, but must be 6"),
        (AXES[:1], 3, r"number of the grid's axes is 1, but must be 2"),
        ((AXES[0], [4.0, 0.0]), 6, r"the grid of the pressure .*ascending"),
        ((AXES[0], [4.0]), 3, r"grid points of the pressure .*at least 2"),
    ],
)
def test_bad_rectangles_are_refused(axes, count, message):
    with pytest.raises(InvalidInput, match=message):
        ScheduledSystem(axes, SIX[:count], "speed and pressure", "rad/s and Pa")
