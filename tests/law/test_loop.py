"""The closed loop against the definitions in the loop diagram."""

from dataclasses import replace

import control
import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, poles, rename, select, static_gain
from ambrose.law.law import law_of
from ambrose.law.loop import closed_loop, match_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce

RNG = np.random.default_rng(4)
OMEGA = np.geomspace(1, 3e3, 30)


@pytest.fixture(scope="module")
def plant():
    return reduce(assemble(load_machine("seal-rig")))


@pytest.fixture(scope="module")
def controller():
    A = RNG.standard_normal((5, 5)) * 100 - 500 * np.eye(5)
    return StateSpace(
        A, RNG.standard_normal((5, 4)) * 1e3, RNG.standard_normal((4, 5)) * 1e3, 2e4 * np.eye(4)
    )


def between(system, inputs, outputs):
    return frequency_response(select(system, inputs, outputs), OMEGA).values


def test_every_transfer_function_of_the_diagram(plant, controller):
    loop = closed_loop(plant, controller)
    names = {kind: [f"{kind}_{a}" for a in plant.axes] for kind in "edryu"}
    G = between(plant.system, plant.named("u"), plant.named("y"))
    K = frequency_response(controller, OMEGA).values
    eye = np.eye(4)
    S_o, S_i = np.linalg.inv(eye + G @ K), np.linalg.inv(eye + K @ G)

    def equal(inputs, outputs, expected):
        got = between(loop, inputs, outputs)
        assert got == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max())

    equal(names["d"], names["y"], S_o)
    equal(names["r"], names["y"], eye - S_o)
    equal(names["r"], names["u"], K @ S_o)
    equal(names["d"], names["u"], -K @ S_o)
    equal(names["e"], names["u"], S_i - eye)  # v = u + e, e -> v is S_i
    f, q = plant.bearing_named("f"), plant.bearing_named("q")
    G_qf, G_qu, G_yf = (
        between(plant.system, *pair)
        for pair in ((f, q), (plant.named("u"), q), (f, plant.named("y")))
    )
    equal(f, q, G_qf - G_qu @ K @ S_o @ G_yf)


def test_sampled_controller_closes_the_sampled_plant(plant, controller):
    dt = 1e-4
    loop = closed_loop(plant, c2d(controller, dt, "tustin", delay=dt))
    assert loop.dt == dt
    sampled = c2d(plant.system, dt)
    K = c2d(controller, dt, "tustin", delay=dt)
    G = between(sampled, plant.named("u"), plant.named("y"))
    S_o = np.linalg.inv(np.eye(4) + G @ frequency_response(K, OMEGA).values)
    got = between(loop, [f"d_{a}" for a in plant.axes], plant.named("y"))
    assert got == pytest.approx(S_o, rel=1e-6, abs=1e-9)


def test_open_loop_is_kept_without_control(plant):
    loop = closed_loop(plant, static_gain(np.zeros((4, 4))))
    assert poles(loop) == pytest.approx(poles(plant.system), abs=1e-6)


def test_wrong_size_names_the_axes(plant):
    with pytest.raises(InvalidInput, match="A_zeta"):
        closed_loop(plant, static_gain(np.eye(3)))


ERRORS, CURRENTS = (
    [f"{kind}_{axis}" for axis in ("A_zeta", "A_eta", "B_zeta", "B_eta")] for kind in ("err", "u")
)


class TestMatching:
    """Which signal of a controller belongs to which axis."""

    @pytest.fixture
    def named(self, controller):
        return rename(controller, ERRORS, CURRENTS)

    @pytest.mark.parametrize("order", [[0, 1, 2, 3], [2, 0, 3, 1], [3, 2, 1, 0]])
    def test_the_order_of_the_names_is_free(self, plant, named, order):
        turned = select(named, [ERRORS[k] for k in order], [CURRENTS[k] for k in order[::-1]])
        for given in (turned, turned.to_control()):
            matched = match_controller(given, plant)
            assert all(np.array_equal(getattr(matched, x), getattr(named, x)) for x in "ABCD")
            assert (list(matched.inputs), list(matched.outputs)) == (ERRORS, CURRENTS)

    def test_any_name_that_ends_in_an_axis_is_one(self, plant, named):
        turned = select(named, ERRORS[::-1], CURRENTS)
        other = rename(turned, [name.replace("err_", "error of ctrl_") for name in turned.inputs])
        np.testing.assert_array_equal(match_controller(other, plant).D, named.D)

    def test_names_without_axes_go_by_place(self, plant, controller, named):
        np.testing.assert_array_equal(match_controller(controller, plant).B, named.B)
        theirs = control.ss(controller.A, controller.B, controller.C, controller.D)
        np.testing.assert_array_equal(match_controller(theirs, plant).B, named.B)

    def test_another_size_is_refused(self, plant, named):
        with pytest.raises(
            InvalidInput,
            match=r"controller's size .* is \(4, 2\), but must be \(4, 4\) for the axes A_zeta",
        ):
            match_controller(select(named, ERRORS[:2]), plant)

    @pytest.mark.parametrize("axis", ["C_zeta", "A_eta"])
    def test_other_axes_are_refused(self, plant, named, axis):
        changed = rename(
            named,
            [f"err_{axis}" if name == ERRORS[0] else f"{name[:4]}x{name[3:]}" for name in ERRORS],
        )
        with pytest.raises(
            InvalidInput,
            match=r"err_A_zeta, err_A_eta, .*for another machine: design one for '.*seal.*'",
        ):
            match_controller(changed, plant)

    def test_a_schedule_is_the_law_at_the_plants_speed(self, plant, named):
        scheduled = ScheduledSystem([0.0, 100.0], [named, named])
        for law in (scheduled, lambda speed: named):
            np.testing.assert_array_equal(match_controller(law, plant).A, named.A)
        with pytest.raises(InvalidInput, match="between 50 and 100 rad/s"):
            match_controller(ScheduledSystem([50.0, 100.0], [named, named]), plant)

    def test_a_schedule_over_pressure_is_the_law_at_the_plants_pressure(self, plant, named):
        """The speed means nothing to it, nor its range to other speeds."""
        double = StateSpace(named.A, named.B, 2 * named.C, 2 * named.D, named.inputs, named.outputs)
        scheduled = ScheduledSystem([0.0, 4e5], [named, double], "pressure", "Pa")
        for speed in (0.0, 900.0):
            here = replace(plant, point=replace(plant.point, speed=speed, seal_pressure=1e5))
            np.testing.assert_allclose(
                match_controller(scheduled, here).D, 1.25 * named.D, rtol=1e-12
            )
            assert law_of(scheduled).covers(here)
        beyond = replace(plant, point=replace(plant.point, seal_pressure=5e5))
        assert not law_of(scheduled).covers(beyond)
        with pytest.raises(
            InvalidInput, match="pressure is 500000 Pa, but must be between 0 and 400000 Pa"
        ):
            match_controller(scheduled, beyond)

    @pytest.mark.parametrize(
        ("parameter", "unit"), [("k", "N/m"), ("pressure", "bar"), ("speed", "Pa")]
    )
    def test_schedules_over_anything_else_are_refused(self, plant, named, parameter, unit):
        with pytest.raises(InvalidInput, match=r"must be speed \[rad/s\] or pressure \[Pa\]"):
            match_controller(ScheduledSystem([0.0, 1.0], [named, named], parameter, unit), plant)

    def test_other_things_are_refused(self, plant):
        with pytest.raises(
            InvalidInput, match="the controller is 'pid', but must be a StateSpace or a Synthesis"
        ):
            match_controller("pid", plant)
