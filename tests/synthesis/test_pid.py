"""The PID controller against its formula, and tilt/translate coordinates on a rigid rotor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.chain.check import springs
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, feedback, select, series, spectral_abscissa
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop
from ambrose.law.pid import (
    chain,
    common_sections,
    lead_lag,
    low_pass,
    modes,
    notch,
    pid_controller,
    section_matrix,
    theta_system,
)
from ambrose.machine.description import Amplifier, MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.machine.part import Channel, Notch, PidSettings, Sensor, ShaftSection
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce
from eigenvalue_margins import loop_margins, opened

OMEGA = np.geomspace(1e-2, 1e5, 60)
PLAIN = PidSettings(gain=(18e3,), integral_time=0.2, derivative_time=3.5e-3, derivative_filter=0.1)
# kg, kg m2, N/A, N/m
MASS = 68.0
INERTIA = 3.1
K_I = 150.0
K_S = 1.1e6


def machine(bearings=(0.2, 0.66), sensors=(0.15, 0.71), angle=np.pi / 4, tilted=None) -> Machine:
    """A shaft with two bearings; sensors off the bearings; ``tilted``: another angle for bearing
    B.
    """
    return Machine(
        name="small",
        shaft=(ShaftSection(start=0.0, length=0.86, outer_diameter=0.1),),
        bearings=tuple(
            MagneticBearing(
                name=name,
                position=z,
                bias_current=6.0,
                angle=angle if name == "A" or tilted is None else tilted,
                force_per_current=(K_I, K_I),
                negative_stiffness=(K_S, K_S),
            )
            for name, z in zip("AB", bearings, strict=True)
        ),
        sensors=tuple(
            Sensor(bearing=name, position=z) for name, z in zip("AB", sensors, strict=True)
        ),
    )


def levitating() -> Machine:
    """The small machine with laminations, an amplifier and PID settings that hold it."""
    item = machine(sensors=(0.2, 0.66))
    return replace(
        item,
        shaft=(ShaftSection(start=0.0, length=0.86, outer_diameter=0.11, elements=8),),
        amplifier=Amplifier(order="first", bandwidth=6e3),
        controller=PLAIN,
    )


def rig(bending_modes: int = 0) -> Plant:
    """Its reduced plant."""
    return reduce(assemble(levitating()), bending_modes)


def axis_margins(plant: Plant, controller: StateSpace) -> list[float]:
    """The worst axis' gain margin, gain reduction and phase margin [rad]."""
    loop = series(controller, select(plant.system, plant.named("u"), plant.named("y")))
    rows = [loop_margins(opened(loop, axis)) for axis in range(4)]
    return [
        min(r.gain_margin for r in rows),
        max(r.gain_reduction for r in rows),
        min(r.phase_margin for r in rows),
    ]


def rigid_rotor(item: Machine) -> StateSpace:
    """A rigid rotor, symmetric about the middle between the bearings, u [A] -> y [m]; states x, y,
    tilts, and their rates.
    """
    places = np.array([b.position for b in item.bearings])
    middle = places.mean()
    B, C = np.zeros((8, 4)), np.zeros((4, 8))
    stiffness = np.zeros((4, 4))
    for k, (bearing, sensor) in enumerate(zip(item.bearings, item.sensors, strict=True)):
        c, s = np.cos(bearing.angle), np.sin(bearing.angle)
        directions = np.array([[c, s], [-s, c]])
        lever = bearing.position - middle
        rows = np.hstack([directions, lever * directions])
        B[4:, 2 * k : 2 * k + 2] = K_I * rows.T / np.array([[MASS], [MASS], [INERTIA], [INERTIA]])
        stiffness += K_S * rows.T @ rows
        C[2 * k : 2 * k + 2, :4] = np.hstack([directions, (sensor.position - middle) * directions])
    A = np.block(
        [
            [np.zeros((4, 4)), np.eye(4)],
            [stiffness / np.array([MASS, MASS, INERTIA, INERTIA])[:, None], np.zeros((4, 4))],
        ]
    )
    return StateSpace(
        A, B, C, np.zeros((4, 4)), [f"u_{a}" for a in item.axes], [f"y_{a}" for a in item.axes]
    )


def formula(settings: PidSettings, s: np.ndarray) -> np.ndarray:
    """One axis' transfer function without its gain, written out from the settings."""
    value = np.ones_like(s)
    if settings.integral_time is not None:
        value = value + 1 / (settings.integral_time * s)
    if settings.derivative_time is not None:
        T = settings.derivative_time
        value = value + T * s / (settings.derivative_filter * T * s + 1)
    for n in settings.notches:
        w = n.frequency
        value = (
            value
            * (s**2 + 2 * n.zero_damping * w * s + w**2)
            / (s**2 + 2 * n.pole_damping * w * s + w**2)
        )
    if settings.lead is not None:
        value = value * (s / settings.lead[0] + 1) / (s / settings.lead[1] + 1)
    if settings.low_pass is not None:
        w = settings.low_pass
        value = value * w**2 / (s**2 + 2 * settings.low_pass_damping * w * s + w**2)
    return value


NOTCHES = (Notch(3455.0, 0.5, 0.02), Notch(6000.0, 0.7, 0.0))
KINDS = {
    "proportional": PidSettings(gain=(18e3,)),
    "pi": PidSettings(gain=(18e3,), integral_time=0.2),
    "pd": PidSettings(gain=(18e3,), derivative_time=3.5e-3),
    "pid": PLAIN,
    "four gains": PidSettings(
        gain=(1e4, 2e4, 3e4, 4e4), integral_time=0.1, derivative_time=2e-3, derivative_filter=0.2
    ),
    "notches": PidSettings(
        gain=(18e3,), integral_time=0.2, derivative_time=3.5e-3, notches=NOTCHES
    ),
    "all": PidSettings(
        gain=(18e3,),
        integral_time=0.2,
        derivative_time=3.5e-3,
        notches=NOTCHES,
        lead=(400.0, 4e3),
        low_pass=1.2e4,
        low_pass_damping=0.6,
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_frequency_response_is_the_formula(name):
    settings, item = KINDS[name], machine()
    response = frequency_response(pid_controller(settings, item), OMEGA)
    gains = np.broadcast_to(settings.gain, 4)
    wanted = formula(settings, 1j * OMEGA)[:, None, None] * np.diag(gains)
    # relative to the gain: a notch with zero_damping 0 is exactly blocked, so relative to the value
    # would say nothing
    assert np.abs(response.values - wanted).max() < 1e-9 * np.abs(wanted).max()
    assert response.inputs == ("err_A_zeta", "err_A_eta", "err_B_zeta", "err_B_eta")
    assert response.outputs == ("u_A_zeta", "u_A_eta", "u_B_zeta", "u_B_eta")


def system(*parts) -> StateSpace:
    return theta_system(chain(1.0, parts), ("A",))


def channel(settings: PidSettings) -> StateSpace:
    return system(*map(section_matrix, common_sections(settings)))


def test_frequency_response_is_relatively_exact_too():
    values = frequency_response(channel(KINDS["all"]), OMEGA).values[:, 0, 0]
    np.testing.assert_allclose(values, formula(KINDS["all"], 1j * OMEGA), rtol=1e-9)


def test_order_has_no_superfluous_states():
    assert pid_controller(KINDS["pid"], machine()).n_states == 8
    assert pid_controller(KINDS["pd"], machine()).n_states == 4
    assert pid_controller(KINDS["proportional"], machine()).n_states == 0
    assert channel(KINDS["all"]).n_states == 2 + 4 + 1 + 2


def test_notch_depth_width_and_far_gain():
    w = 3455.0
    p = 0.5
    z = 0.02
    response = frequency_response(system(notch(w, z, w, p)), [w, w * 1e-4, w * 1e4]).values[:, 0, 0]
    np.testing.assert_allclose(response[0], z / p, rtol=1e-12)
    np.testing.assert_allclose(np.abs(response[1:]), 1.0, rtol=1e-6)
    assert abs(frequency_response(system(notch(w, 0.0, w, p)), [w]).values[0, 0, 0]) < 1e-14


def test_low_pass_and_lead_at_their_corners():
    low = frequency_response(system(low_pass(500.0, 0.6)), [0.0, 500.0, 5e6]).values[:, 0, 0]
    np.testing.assert_allclose(low[:2], [1.0, 1 / (2 * 0.6j)], rtol=1e-9)
    np.testing.assert_allclose(low[2], -1e-8, rtol=1e-3)  # second order: -(w/w0)^-2
    middle = np.sqrt(400.0 * 4000.0)
    value = frequency_response(system(lead_lag(400.0, 4000.0)), [middle]).values[0, 0, 0]
    # the largest lead of a ratio of ten
    np.testing.assert_allclose(np.angle(value), np.arcsin(9 / 11), rtol=1e-12)
    np.testing.assert_allclose(np.abs(value), np.sqrt(10.0), rtol=1e-12)


def test_positive_gain_pulls_the_rotor_back():
    item = machine()
    closed = feedback(
        series(pid_controller(PLAIN, item), rigid_rotor(item)), StateSpace([], [], [], np.eye(4))
    )
    assert np.linalg.eigvals(closed.A).real.max() < 0
    # static stiffness per axis: k_i K_p - k_s; just above the limit the rigid rotor is held, just
    # below it falls
    for factor, held in ((1.02, True), (0.98, False)):
        damped = PidSettings(gain=(factor * K_S / K_I,), derivative_time=3.5e-3)
        item = machine(sensors=(0.2, 0.66))
        loop = series(pid_controller(damped, item), rigid_rotor(item))
        poles = np.linalg.eigvals(loop.A - loop.B @ loop.C)
        assert (poles.real.max() < 0) == held


@pytest.mark.parametrize("tilted", [None, 0.3], ids=["same angle", "other angle at B"])
def test_tilt_translate_is_decentralised_control_for_collocated_sensors(tilted):
    item = machine(sensors=(0.2, 0.66), tilted=tilted)
    into, out = modes(item)
    np.testing.assert_allclose(out @ into, np.eye(4), atol=1e-14)
    settings = PidSettings(
        gain=(1e4, 2e4, 3e4, 4e4), derivative_time=2e-3, coordinates="tilt-translate"
    )
    both = [
        frequency_response(pid_controller(s, item), OMEGA).values
        for s in (settings, PidSettings(gain=settings.gain, derivative_time=2e-3))
    ]
    np.testing.assert_allclose(both[0], both[1], atol=1e-9 * np.abs(both[1]).max())


@pytest.mark.parametrize("tilt_gain", [0.4, 1.0, 1.7])
@pytest.mark.parametrize(
    "sensors", [(0.2, 0.66), (0.15, 0.71), (0.1, 0.64)], ids=["collocated", "outside", "one-sided"]
)
def test_tilt_translate_decouples_a_symmetric_rigid_rotor_exactly(sensors, tilt_gain):
    """Parallel motion answers with force and no moment, tilting with moment and no force, wherever
    the sensors sit.
    """
    item = machine(sensors=sensors, tilted=0.3)
    settings = PidSettings(
        gain=(18e3,),
        integral_time=0.2,
        derivative_time=3.5e-3,
        coordinates="tilt-translate",
        tilt_gain=tilt_gain,
    )
    rotor = rigid_rotor(item)
    # from rigid coordinates (x, y, tilt x, tilt y) through sensors, controller and magnets back to
    # force and moment
    weights = np.diag([MASS, MASS, INERTIA, INERTIA])
    K = frequency_response(pid_controller(settings, item), OMEGA).values
    action = weights @ rotor.B[4:] @ K @ rotor.C[:, :4]
    half = 0.23
    wanted = np.diag([2.0, 2.0, 2 * tilt_gain * half**2, 2 * tilt_gain * half**2]) * K_I * 18e3
    expected = formula(settings, 1j * OMEGA)[:, None, None] * wanted
    assert np.abs(action - expected).max() < 1e-11 * np.abs(expected).max()


def test_tilt_gain_moves_the_conical_poles_only():
    item = machine()

    def poles(tilt_gain: float) -> np.ndarray:
        settings = PidSettings(
            gain=(18e3,), derivative_time=3.5e-3, coordinates="tilt-translate", tilt_gain=tilt_gain
        )
        loop = series(pid_controller(settings, item), rigid_rotor(item))
        return np.linalg.eigvals(loop.A - loop.B @ loop.C)

    # parallel mode: m s^2 = 2 k_s - 2 k_i K(s), K = K_p (1 + T_d s/(eps T_d s + 1))
    T, e = 3.5e-3, 0.1
    parallel = np.roots(
        np.polyadd(
            np.polymul([MASS, 0, -2 * K_S], [e * T, 1]), 2 * K_I * 18e3 * np.array([(1 + e) * T, 1])
        )
    )
    for tilt_gain in (0.8, 1.6):
        found = poles(tilt_gain)
        assert max(np.abs(found - p).min() for p in parallel) < 1e-6 * np.abs(parallel).max()
    moved = [np.abs(poles(1.6) - p).min() for p in poles(0.8)]
    assert sum(np.array(moved) > 1.0) == 6  # three conical poles in each of two planes


@pytest.mark.parametrize("delay", [0.0, 1e-4, 3e-4])
def test_discrete_is_tustin_with_whole_samples_of_delay(delay):
    dt = 1e-4
    sampled = c2d(pid_controller(KINDS["all"], machine()), dt, "tustin", delay)
    assert sampled.dt == dt
    omega = np.geomspace(1.0, 0.98 * np.pi / dt, 40)
    z = np.exp(1j * omega * dt)
    wanted = 18e3 * formula(KINDS["all"], 2 / dt * (z - 1) / (z + 1)) * z ** -round(delay / dt)
    values = frequency_response(sampled, omega).values
    np.testing.assert_allclose(values[:, 2, 2], wanted, rtol=1e-8)
    assert np.abs(values[:, 0, 1]).max() < 1e-11 * np.abs(wanted).max()


def test_a_fractional_delay_is_refused():
    with pytest.raises(InvalidInput, match="whole number of samples"):
        c2d(pid_controller(PLAIN, machine()), 1e-4, "tustin", 1.5e-4)


class TestSynthesize:
    def test_a_loop_that_holds_is_verified(self):
        plant = rig()
        result = pid_synthesis(plant)
        assert (result.method, result.status) == ("pid", "verified")
        assert np.isnan(result.gamma)
        assert result.controller.inputs == ("err_A_zeta", "err_A_eta", "err_B_zeta", "err_B_eta")
        closed = closed_loop(plant, result.controller)
        assert result.certificate.stable
        np.testing.assert_allclose(
            result.certificate.spectral_abscissa, spectral_abscissa(closed), rtol=1e-6
        )
        axes = plant.axes
        omega = np.geomspace(1, 1e4, 4001)
        sensitivity = frequency_response(
            select(closed, [f"d_{a}" for a in axes], [f"y_{a}" for a in axes]), omega
        )
        peak = sensitivity.max_singular_value().max()
        np.testing.assert_allclose(result.certificate.closed_loop_norm, peak, rtol=1e-4)
        assert result.certificate.plant == "small, standstill, 12 states"

    def test_full_and_reduced_plant_give_the_same_margins(self):
        """The finite-element plant, with poles to 7e5 rad/s, and the one with three bending modes;
        the rigid rotor promises four times the gain margin, for it is the first bending mode that
        limits it.
        """
        plants = assemble(levitating()), rig(3), rig()
        full, reduced, _ = (pid_synthesis(plant).certificate.margins for plant in plants)
        assert full == {name: pytest.approx(value, rel=1e-5) for name, value in reduced.items()}
        controller = pid_controller(PLAIN, levitating())
        whole, near, rigid = (axis_margins(plant, controller) for plant in plants)
        assert rigid[0] > 4 * whole[0]
        np.testing.assert_allclose(whole, near, rtol=0.002)

    def test_too_little_gain_is_a_verdict_and_no_exception(self):
        result = pid_synthesis(rig(), replace(PLAIN, gain=(5e3,)))
        assert result.status == "unstable"
        assert not result.certificate.stable
        assert result.certificate.spectral_abscissa > 0

    def test_a_delay_that_the_loop_does_not_bear_is_found(self):
        """The continuous controller holds; the sampled one with 3 ms of delay does not."""
        slow = replace(PLAIN, sample_time=5e-4, delay=3e-3)
        result = pid_synthesis(rig(), slow)
        assert result.certificate.spectral_abscissa < 0  # of the continuous loop
        assert result.status == "unstable" and not result.certificate.stable
        assert result.certificate.margins["sampled_spectral_abscissa"] > 0
        quick = pid_synthesis(rig(), replace(PLAIN, sample_time=5e-5, delay=5e-5))
        assert quick.status == "verified"
        peaks = quick.certificate.margins
        assert (
            peaks["sensitivity_peak"]
            < peaks["sampled_sensitivity_peak"]
            < 1.5 * peaks["sensitivity_peak"]
        )

    def test_no_settings_at_all(self):
        plant = rig()
        bare = replace(plant, machine=replace(plant.machine, controller=None))
        with pytest.raises(InvalidInput, match="has no reference controller"):
            pid_synthesis(bare)


BAD = {
    "number of gains": (PidSettings(gain=(1e4, 2e4)), "gain is a list of 2"),
    "NaN gain": (PidSettings(gain=(float("nan"),)), "gain"),
    "integral time": (PidSettings(gain=(1e4,), integral_time=0.0), "integral_time is 0"),
    "derivative time": (
        PidSettings(gain=(1e4,), derivative_time=-1e-3),
        "derivative_time is -0.001",
    ),
    "derivative filter": (
        PidSettings(gain=(1e4,), derivative_time=1e-3, derivative_filter=0.0),
        "pure derivative",
    ),
    "notch frequency": (
        PidSettings(gain=(1e4,), notches=(Notch(-1.0, 0.5, 0.1),)),
        "zero_frequency is -1",
    ),
    "notch damping": (PidSettings(gain=(1e4,), notches=(Notch(1e3, 0.0, 0.1),)), "pole_damping"),
    "lead": (PidSettings(gain=(1e4,), lead=(0.0, 1e3)), "zero_frequency is 0"),
    "low pass": (PidSettings(gain=(1e4,), low_pass=-2.0), "low-pass.*frequency is -2"),
    "coordinates": (PidSettings(gain=(1e4,), coordinates="modal"), "tilt-translate"),
    "tilt gain": (
        PidSettings(gain=(1e4,), coordinates="tilt-translate", tilt_gain=float("inf")),
        "tilt_gain",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_settings_name_the_quantity(name):
    settings, message = BAD[name]
    with pytest.raises(InvalidInput, match=message):
        pid_controller(settings, machine())


def test_tilt_translate_needs_two_planes():
    settings = PidSettings(gain=(1e4,), coordinates="tilt-translate")
    item = machine()
    with pytest.raises(InvalidInput, match="sensor positions"):
        pid_controller(settings, machine(sensors=(0.4, 0.4)))
    one = replace(item, bearings=item.bearings[:1], sensors=item.sensors[:1])
    # there is nothing but translation
    parallel = pid_controller(replace(settings, coordinates="axes"), one)
    np.testing.assert_allclose(pid_controller(settings, one).D, parallel.D, rtol=0, atol=1e-8)


TRAIN = load_machine("three-bearing-train")
MODAL = PidSettings(gain=(2e4,), derivative_time=2e-3, coordinates="tilt-translate", tilt_gain=1.3)


def rigid(machine, places, directions):
    """What a unit translation and a unit tilt about the middle bearing show at places along
    directions, (2 n, 4).
    """
    lever = np.array(places) - machine.bearings[1].position
    rows = []
    for z, angle in zip(lever, directions, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        rows += [[c, s, z * c, z * s], [-s, c, -z * s, z * c]]
    return np.array(rows)


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_three_bearings_answer_a_rigid_motion_as_axes_do(turn):
    """Also with sensors off the bearings and turned; the forces are the least that answer it."""
    sensors = tuple(
        replace(s, angle=b.angle + turn) for s, b in zip(TRAIN.sensors, TRAIN.bearings, strict=True)
    )
    train = replace(TRAIN, sensors=sensors)
    seen = rigid(train, [s.position for s in train.sensors], [s.angle for s in train.sensors])
    moved = rigid(train, [b.position for b in train.bearings], [b.angle for b in train.bearings])
    K = pid_controller(replace(MODAL, tilt_gain=1.0), train).D
    np.testing.assert_allclose(K @ seen, gain_of(MODAL) * moved, rtol=0, atol=1e-6 * gain_of(MODAL))
    assert np.linalg.matrix_rank(K, tol=1e-6 * gain_of(MODAL)) == 4
    bent = Channel(("bend_1_x", "bend_1_y"), MODAL.gain[0], common_sections(MODAL))
    both = pid_controller(replace(MODAL, tilt_gain=1.0, channels=(bent,)), train).D
    assert np.linalg.matrix_rank(both, tol=1e-6 * gain_of(MODAL)) == 6


def gain_of(settings):
    """K_p with the derivative's share at high frequency."""
    return settings.gain[0] * (1 + 1 / settings.derivative_filter)


def test_sensors_at_three_bearings_and_equal_chains_are_axes():
    train = replace(
        TRAIN,
        sensors=tuple(
            replace(s, position=b.position)
            for s, b in zip(TRAIN.sensors, TRAIN.bearings, strict=True)
        ),
    )
    bent = Channel(("bend_1_x", "bend_1_y"), MODAL.gain[0], common_sections(MODAL))
    whole = pid_controller(replace(MODAL, tilt_gain=1.0, channels=(bent,)), train).D
    np.testing.assert_allclose(
        whole, gain_of(MODAL) * np.eye(6), rtol=0, atol=1e-9 * gain_of(MODAL)
    )
    assert springs(
        replace(train, controller=replace(MODAL, tilt_gain=1.0, channels=(bent,)))
    ).keys() == {"DE", "MID", "NDE"}


def test_the_train_is_held_in_translation_and_tilt():
    """The shaft holds what is left, better than the PID of the axes: three bearings, four
    channels.
    """
    settings = replace(TRAIN.controller, coordinates="tilt-translate", gain=(20e3,))
    closed = closed_loop(assemble(TRAIN), pid_controller(settings, TRAIN))
    assert spectral_abscissa(closed) < -10
