"""Annular gas seals: limits, symmetries and independent solutions of the bulk-flow model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.machine.part import Seal
from ambrose.model.effects.bulkflow import (
    Friction,
    Gas,
    SealCondition,
    SealGeometry,
    _walls,
    air,
    bulk_flow,
    seal_table,
    static_flow,
    whirl_flow,
)
from ambrose.model.effects.seal import coefficients

HZ = 2 * np.pi
# the seal of the thesis' P3 (chapter 4, figure 2); the stator's friction is assumed
SEAL = SealGeometry(
    0.0857, 0.11474, 2.115e-4, 2.102e-4, 3.3e-3, 0.684, stator_friction=Friction(0.02, 0.0)
)
CONDITION = SealCondition(70e5, 31.5e5, 290.55, 20200 * HZ / 60, air(290.55))
FREQUENCIES = HZ * np.arange(20, 301, 20)
# ROSS 2.3.0: exit pressure [Pa], preswirl -> leakage [kg/s], Mach number and swirl [m/s] at the
# exit
ROSS = [
    (31.5e5, 0.0, 0.7664387917, 0.9215362897, 61.18504220),
    (50e5, 0.5, 0.6662060511, 0.5046392111, 81.53316513),
]


def coefficient_array(flow):
    return np.array([flow.K, flow.k, flow.C, flow.c])


# zeroth order


def test_isothermal_duct_formula():
    """At rest with constant friction: p1^2 - p2^2 = (G a/H)^2 ((f_s + f_r) L/H + 2 ln(p1/p2)), any
    textbook on gas dynamics.
    """
    seal = replace(
        SEAL, exit_clearance=2.115e-4, rotor_friction=Friction(0.005, 0.0), inlet_loss=0.0
    )
    condition = replace(CONDITION, speed=0.0)
    flow = bulk_flow(seal, condition, [100.0])
    G = flow.leakage / (np.pi * seal.diameter)
    a2 = condition.gas.gas_constant * condition.temperature
    H = seal.inlet_clearance

    def misfit(G):
        p1 = np.roots([1, -condition.inlet_pressure, 0.5 * a2 * (G / H) ** 2]).max()
        loss = 0.025 * seal.length / H + 2 * np.log(p1 / condition.exit_pressure)
        return p1**2 - condition.exit_pressure**2 - (G / H) ** 2 * a2 * loss

    assert G == pytest.approx(brentq(misfit, 0.3 * G, 2 * G, xtol=1e-14), rel=1e-8)


@pytest.mark.parametrize(("taper", "preswirl"), [(1.0, 0.0), (0.7, 0.6), (1.2, -0.4)])
def test_static_flow_against_momentum_balance(taper, preswirl):
    """The momentum p H + G W is integrated with scipy's DOP853 and p recovered from it."""
    seal = replace(SEAL, exit_clearance=taper * SEAL.inlet_clearance, exit_recovery=0.3)
    walls = _walls(seal, replace(CONDITION, preswirl=preswirl))
    flow = static_flow(walls, 100)
    G = flow.G
    a2 = walls.a2
    R_omega = walls.surface_speed

    def state(z, momentum):
        H = walls.H_in + (walls.H_out - walls.H_in) * z / walls.length
        p = np.roots([H, -momentum, G**2 * a2 / H]).real.max()  # the subsonic root
        return H, p, G * a2 / (p * H)

    def rhs(z, y):
        H, p, W = state(z, y[0])
        U, rho = y[1], p / a2
        stress = np.zeros(2)
        for (n, m), wall in ((walls.stator, 0.0), (walls.rotor, R_omega)):
            V = np.hypot(W, U - wall)
            stress += (
                0.5
                * rho
                * V
                * n
                * (2 * rho * H * V / walls.viscosity) ** m
                * np.array([W, U - wall])
            )
        return [p * (walls.H_out - walls.H_in) / walls.length - stress[0], -stress[1] / G]

    start = [flow.p[0] * walls.H_in + G * flow.W[0], preswirl * R_omega]
    other = solve_ivp(
        rhs, (0, walls.length), start, method="DOP853", rtol=1e-12, atol=1e-12, t_eval=flow.z
    )
    p = np.array([state(z, momentum)[1] for z, momentum in zip(other.t, other.y[0], strict=True)])
    np.testing.assert_allclose(flow.p, p, rtol=1e-7)
    np.testing.assert_allclose(flow.U, other.y[1], atol=1e-6 * R_omega)
    # and the two ends
    head = 0.5 * flow.p * flow.W**2 / a2
    assert flow.p[0] + (1 + seal.inlet_loss) * head[0] == pytest.approx(
        CONDITION.inlet_pressure, rel=1e-12
    )
    assert flow.p[-1] + seal.exit_recovery * head[-1] == pytest.approx(
        CONDITION.exit_pressure, rel=1e-9
    )
    np.testing.assert_allclose(flow.p / a2 * flow.W * flow.H, G, rtol=1e-12)  # mass


# first order


def smooth_walls(**changes):
    return replace(
        _walls(replace(SEAL, exit_clearance=1.7e-4), replace(CONDITION, preswirl=0.3)), **changes
    )


def remainder(walls, flow, q, omega, amplitude):
    """What mass, axial and circumferential momentum (3,) leave over, relative, for flow + amplitude
    * whirl.
    """
    R, d = walls.radius, 1e-4

    def field(t, theta):
        wave = amplitude * np.exp(1j * (omega * t - theta))
        changes = [(x[0] * wave).real for x in (q.p, q.u, q.w)]
        return flow.H + wave.real, flow.p + changes[0], flow.U + changes[1], flow.W + changes[2]

    def stored(t, theta):
        H, p, U, W = field(t, theta)
        rho = p / walls.a2
        return np.array([rho * (H + walls.storage), rho * H * W, rho * H * U, rho * walls.storage])

    def around(t, theta):
        H, p, U, W = field(t, theta)
        rho = p / walls.a2
        return np.array([rho * H * U, rho * H * U * W, rho * H * U * U, p])

    left = []
    for theta in (0.0, 0.9, 2.5):
        H, p, U, W = field(0.0, theta)
        rho = p / walls.a2
        along = CubicSpline(flow.z, [rho * H * W, rho * H * W * W, rho * H * W * U, p], axis=1)(
            flow.z, 1
        )
        change = (stored(d / abs(omega), theta) - stored(-d / abs(omega), theta)) / (
            2 * d / abs(omega)
        )
        turn = (around(0.0, theta + d) - around(0.0, theta - d)) / (2 * d * R)
        stress = np.zeros((2, len(p)))
        for (n, m), wall in ((walls.stator, 0.0), (walls.rotor, walls.surface_speed)):
            V = np.hypot(W, U - wall)
            stress += (
                0.5
                * rho
                * V
                * n
                * (2 * rho * H * V / walls.viscosity) ** m
                * np.array([W, U - wall])
            )
        total = change[:3] + along[:3] + turn[:3]
        # what enters the cells takes its momentum along
        total[1] += H * along[3] + stress[0] + W * change[3]
        total[2] += H * turn[3] + stress[1] + U * change[3]
        scale = np.array([flow.G / walls.length, np.abs(stress[0]).max(), np.abs(stress[1]).max()])
        left.append(np.abs(total[:, 40:-40]).max(axis=1) / scale)
    return np.max(left, axis=0)


@pytest.mark.parametrize("omega", [-900.0, 300.0, 2000.0])
def test_first_order_solves_the_nonlinear_equations(omega):
    """Flow plus a small whirl, put into the unsteady conservation laws: what is left falls with the
    amplitude's square.
    """
    walls = _walls(replace(SEAL, exit_clearance=1.7e-4), replace(CONDITION, preswirl=0.3))
    flow = static_flow(walls, 400)
    q = whirl_flow(walls, flow, np.array([omega]))
    large, small, none = (
        remainder(walls, flow, q, omega, amplitude) for amplitude in (4e-7, 1e-7, 0.0)
    )
    assert (none < 1e-8).all()
    assert (small < large / 15).all()
    assert (small < 1e-4).all()


def test_breathing_clearance_against_finite_differences():
    """A uniform, very slow change of the clearance (no waves around) is the difference of two
    zeroth-order flows.
    """
    seal, condition = (
        replace(SEAL, exit_clearance=1.7e-4, exit_recovery=0.4),
        replace(CONDITION, preswirl=0.3),
    )
    walls = _walls(seal, condition)
    q = whirl_flow(walls, static_flow(walls, 200), np.array([0.0]), harmonic=0)
    d = 1e-9
    wide, narrow = (
        static_flow(replace(walls, H_in=walls.H_in + x, H_out=walls.H_out + x), 200)
        for x in (d, -d)
    )
    for amplitude, name in ((q.p, "p"), (q.u, "U"), (q.w, "W")):
        difference = (getattr(wide, name) - getattr(narrow, name)) / (2 * d)
        np.testing.assert_allclose(
            amplitude[0, ::2], difference[::2], atol=2e-6 * np.abs(difference).max()
        )


def test_coefficients_settle_at_low_frequency():
    """Even in the frequency: the distance to the limit falls with its square."""
    flow = bulk_flow(SEAL, CONDITION, [0.01, 2.0, 4.0])
    limit, near, far = coefficient_array(flow).T
    np.testing.assert_allclose((far - limit) / (near - limit), 4.0, rtol=1e-3)


def black(xi, sigma, dp, R, L, H, rho, Omega, omega):
    """K, k, C, c of a short incompressible seal, friction factors constant, swirl R Omega/2.

    Mass j s h + H w' = 0 and momentum rho (j s w + W w') = -p' - (f/H)(rho W w - rho W^2 h/(2 H)),
    s = omega - Omega/2, are polynomials in z (Black 1969; Childs 1983 without the circumferential
    flow).
    """
    W = np.sqrt(2 * dp / (rho * (1 + xi + 2 * sigma)))
    f = 2 * sigma * H / L
    P = np.polynomial.Polynomial
    result = []
    for sign in (1, -1):
        s = sign * omega - Omega / 2
        h = -1.0
        squeezed = P([0, -1j * s * h / H])  # w = w0 + squeezed
        slope_of_one = P([-rho * (1j * s + f * W / H)])  # p' per w0
        slope = (
            -rho * (1j * s * squeezed + W * squeezed.deriv())
            - f * rho * W / H * squeezed
            + 0.5 * f * rho * W**2 * h / H**2
        )
        inlet = -(1 + xi) * rho * W  # p(0) per w0
        w0 = -slope.integ()(L) / (inlet + slope_of_one.integ()(L))
        p = w0 * (inlet + slope_of_one.integ()) + slope.integ()
        result.append(np.pi * R * p.integ()(L))
    Z, back = result
    return np.array(
        [
            (Z + back).real / 2,
            -(Z + back).imag / 2,
            (Z - back).imag / (2 * omega),
            (Z - back).real / (2 * omega),
        ]
    )


@pytest.mark.literature
def test_incompressible_short_seal():
    """A heavy, hardly compressible fluid in a seal much shorter than its radius: Black's solution,
    error as (L/R)^2.
    """
    L = 0.02
    H = 2e-4
    xi = 0.5
    f = 0.02
    rho = 1000.0
    a = 3e4
    dp = 1e6
    Omega = 1.0
    omega = 300.0
    errors = []
    for R in (0.1, 0.2):
        friction = Friction(f / 2, 0.0)
        seal = SealGeometry(
            L, 2 * R, H, H, rotor_friction=friction, stator_friction=friction, inlet_loss=xi
        )
        fluid = SealCondition(
            rho * a**2 + dp, rho * a**2, 300.0, Omega, Gas(a**2 / 300.0, 1e-3), preswirl=0.5
        )
        expected = black(xi, f * L / H / 2, dp, R, L, H, rho, Omega, omega)
        got = coefficient_array(bulk_flow(seal, fluid, [omega]))[:, 0]
        errors.append(got / expected - 1)
    assert (np.abs(errors[1]) < 4e-3).all()
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.1)


@pytest.mark.literature
def test_lomakin_stiffness():
    """Static stiffness of Black (1969): pi R dp L/(H sigma) mu_0, mu_0 = (1 + xi) sigma^2/(1 + xi +
    2 sigma)^2, no rotation.
    """
    L = 0.01
    H = 2e-4
    xi = 0.5
    f = 0.02
    R = 0.5
    rho = 1000.0
    a = 3e4
    dp = 1e6
    friction = Friction(f / 2, 0.0)
    seal = SealGeometry(
        L, 2 * R, H, H, rotor_friction=friction, stator_friction=friction, inlet_loss=xi
    )
    flow = bulk_flow(
        seal, SealCondition(rho * a**2 + dp, rho * a**2, 300.0, 0.0, Gas(a**2 / 300.0, 1e-3)), [1.0]
    )
    sigma = f * L / H / 2
    expected = np.pi * R * dp * L / (H * sigma) * (1 + xi) * sigma**2 / (1 + xi + 2 * sigma) ** 2
    assert flow.K[0] == pytest.approx(expected, rel=2e-4)
    assert flow.leakage == pytest.approx(
        2 * np.pi * R * H * np.sqrt(2 * dp * rho / (1 + xi + 2 * sigma)), rel=1e-5
    )


# symmetries


def test_no_rotation_has_no_cross_coupling():
    flow = bulk_flow(SEAL, replace(CONDITION, speed=0.0), FREQUENCIES)
    assert np.abs(flow.k).max() < 1e-9 * np.abs(flow.K).max()
    assert np.abs(flow.c).max() < 1e-9 * np.abs(flow.C).max()
    assert np.abs(flow.swirl).max() == 0.0


def test_opposed_swirl_turns_the_cross_coupling():
    """Swirl against a rotor that hardly turns: k and c change sign with it."""
    slow = replace(CONDITION, speed=40.0)
    with_spin, against = (
        bulk_flow(SEAL, replace(slow, preswirl=sign * 2.0), FREQUENCIES) for sign in (1, -1)
    )
    assert (with_spin.k > 0).all() and (against.k < 0).all()
    np.testing.assert_allclose(with_spin.K, against.K, rtol=0.02)


@pytest.mark.parametrize("changes", [{"hole_depth": 0.0}, {"hole_area_ratio": 0.0}])
def test_no_cells_is_the_smooth_seal(changes):
    smooth = bulk_flow(replace(SEAL, hole_depth=0.0, hole_area_ratio=0.0), CONDITION, FREQUENCIES)
    np.testing.assert_array_equal(
        coefficient_array(bulk_flow(replace(SEAL, **changes), CONDITION, FREQUENCIES)),
        coefficient_array(smooth),
    )
    holes = bulk_flow(SEAL, CONDITION, FREQUENCIES)
    assert holes.leakage == smooth.leakage  # the cells only store
    assert np.abs(coefficient_array(holes) - coefficient_array(smooth)).max() > 1e6


def test_vanishing_holes_approach_the_smooth_seal():
    smooth = coefficient_array(bulk_flow(replace(SEAL, hole_depth=0.0), CONDITION, FREQUENCIES[:3]))
    near, far = (
        coefficient_array(bulk_flow(replace(SEAL, hole_depth=d), CONDITION, FREQUENCIES[:3]))
        for d in (1e-8, 2e-8)
    )
    np.testing.assert_allclose((far - smooth) / (near - smooth), 2.0, rtol=2e-3)


def test_similarity():
    """All pressures and the viscosity times s: forces times s. All lengths times s, times s,
    viscosity times s: forces s^2.
    """
    s = 2.5
    flow = bulk_flow(SEAL, CONDITION, FREQUENCIES)
    gas = replace(CONDITION.gas, viscosity=s * CONDITION.gas.viscosity)
    denser = replace(
        CONDITION,
        inlet_pressure=s * CONDITION.inlet_pressure,
        exit_pressure=s * CONDITION.exit_pressure,
        gas=gas,
    )
    np.testing.assert_allclose(
        coefficient_array(bulk_flow(SEAL, denser, FREQUENCIES)),
        s * coefficient_array(flow),
        rtol=1e-7,
    )
    lengths = ("length", "diameter", "inlet_clearance", "exit_clearance", "hole_depth")
    larger = replace(SEAL, **{name: s * getattr(SEAL, name) for name in lengths})
    big = bulk_flow(larger, replace(CONDITION, speed=CONDITION.speed / s, gas=gas), FREQUENCIES / s)
    np.testing.assert_allclose(
        coefficient_array(big),
        coefficient_array(flow) * np.array([[s], [s], [s**2], [s**2]]),
        rtol=1e-7,
    )
    assert big.leakage == pytest.approx(s**2 * flow.leakage, rel=1e-8)


def test_compressibility_acts_as_the_gas_constant():
    gas = CONDITION.gas
    real = replace(CONDITION, gas=replace(gas, compressibility=0.9))
    other = replace(CONDITION, gas=replace(gas, gas_constant=0.9 * gas.gas_constant))
    a, b = (bulk_flow(SEAL, condition, FREQUENCIES) for condition in (real, other))
    np.testing.assert_allclose(coefficient_array(a), coefficient_array(b), rtol=1e-9)
    assert a.leakage > 1.04 * bulk_flow(SEAL, CONDITION, FREQUENCIES).leakage  # about Z^(-1/2)


def test_grid_converges_with_fourth_order():
    cells = (16, 32, 64)
    walls = _walls(SEAL, replace(CONDITION, exit_pressure=50e5))
    omega = np.concatenate([FREQUENCIES, -FREQUENCIES])
    fine = whirl_flow(walls, static_flow(walls, 512), omega).mean_p
    errors = [
        np.abs(whirl_flow(walls, static_flow(walls, n), omega).mean_p - fine).max() for n in cells
    ]
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 3.6).all() and (order < 4.6).all(), order
    assert bulk_flow(SEAL, CONDITION, FREQUENCIES).grid_error < 3e-5


# the seal of the thesis


def isothermal_mach(flux):
    """m with m exp(-m^2/2) = mass flux * a/total pressure, subsonic."""
    return brentq(lambda m: m * np.exp(-(m**2) / 2) - flux, 0, 1)


@pytest.mark.literature
@pytest.mark.parametrize(
    ("exit_pressure", "preswirl", "leakage", "mach", "swirl"),
    [pytest.param(*ROSS[0]), ROSS[1]],
)
def test_static_flow_against_ross(exit_pressure, preswirl, leakage, mach, swirl):
    """ROSS 2.3.0's HolePatternSeal (its energy equation at gamma = 1.0001, no cells, 640 steps)
    integrates Mach numbers.

    Its walls follow Moody's formula 1.375e-3 (1 + (x/Re)^(1/3)), x = 2e6 and a quarter of it at the
    stator, x = 1e6 at the rotor; here each is Blasius' law tangent to it at a third of the length.
    Its inlet loss is one of total pressure; here the inlet_loss is chosen that leaves the same
    p(0).
    """
    H = 2.115e-4
    R = 0.05737
    speed = 20200 * HZ / 60
    gas = Gas(8314 / 28.97, 1.458e-6 * 290.55**1.5 / (110.4 + 290.55))
    condition = SealCondition(70e5, exit_pressure, 290.55, speed, gas, preswirl)
    walls, loss = [Friction(), Friction()], 0.1
    for _ in range(12):
        seal = SealGeometry(
            0.0857, 2 * R, H, H, rotor_friction=walls[0], stator_friction=walls[1], inlet_loss=loss
        )
        flow = bulk_flow(seal, condition, [100.0])
        flux = (
            flow.leakage
            / (2 * np.pi * R * H)
            * np.sqrt(gas.gas_constant * condition.temperature)
            / condition.inlet_pressure
        )
        nozzle = isothermal_mach(flux)
        mach0 = isothermal_mach(flux / (1 - 0.1 / 2 * nozzle**2 * np.exp(-(nozzle**2) / 2)))
        p0 = flux / mach0
        loss = 2 * (1 - p0) / (p0 * mach0**2) - 1
        middle = len(flow.z) // 3
        U, W = flow.swirl[middle], flow.axial_velocity[middle]
        for i, (share, x, V) in enumerate(
            ((1.0, 1e6, np.hypot(W, U - R * speed)), (0.25, 2e6, np.hypot(W, U)))
        ):
            reynolds = flow.reynolds * V / W
            root = (x / reynolds) ** (1 / 3)
            exponent = -root / (1 + root) / 3
            walls[i] = Friction(share * 1.375e-3 * (1 + root) / reynolds**exponent, exponent)
    assert flow.leakage == pytest.approx(leakage, rel=3e-4)
    assert flow.exit_mach == pytest.approx(mach, rel=2e-4)
    assert flow.swirl[-1] == pytest.approx(swirl, rel=3e-3)


@pytest.mark.literature
def test_water_seal_of_kanki():
    """Kanki & Kawakami (1984), long seal, 2000 rpm, 9.8 bar: measured 4634 cm3/s, K 3.59, k 10.8
    MN/m, C 147, c 55.3 kN s/m, M 221.5 kg (as listed in the public repository trosny/bulk_flow).
    """
    rho = 996.9
    a = 1e4
    mu = 8.78e-4
    seal = SealGeometry(0.2, 0.2, 5e-4, 5e-4, inlet_loss=0.2)
    water = SealCondition(
        rho * a**2 + 9.8e5, rho * a**2, 300.0, 2000 * HZ / 60, Gas(a**2 / 300.0, mu), preswirl=0.2
    )
    omega = np.array([10.0, 100.0])
    flow = bulk_flow(seal, water, omega)
    M = -(flow.K[1] - flow.K[0]) / (omega[1] ** 2 - omega[0] ** 2)
    K = flow.K[0] + M * omega[0] ** 2
    assert flow.leakage / rho == pytest.approx(4634e-6, rel=0.15)
    assert flow.k[0] == pytest.approx(10.8e6, rel=0.05)
    assert flow.C[0] == pytest.approx(147e3, rel=0.15)
    assert flow.c[0] == pytest.approx(55.3e3, rel=0.1)
    assert K == pytest.approx(3.59e6, rel=0.3)
    assert M == pytest.approx(221.5, rel=0.45)


@pytest.mark.literature
def test_thesis_seal_behaves_as_hole_pattern_seals_do():
    """In words, what Childs and co-workers publish: K and effective stiffness rise with the
    frequency, C and k fall, the effective damping is negative below a cross-over frequency,
    preswirl raises k and the cross-over.
    """
    flow = bulk_flow(SEAL, CONDITION, FREQUENCIES)
    assert (np.diff(flow.K) > 0).all() and (np.diff(flow.K + flow.c * flow.frequencies) > 0).all()
    assert (np.diff(flow.C) < 0).all() and (np.diff(flow.k) < 0).all()
    assert flow.effective_damping[0] < 0 < flow.effective_damping[3]
    fine = HZ * np.linspace(10, 120, 56)
    swirled = bulk_flow(SEAL, replace(CONDITION, preswirl=0.6), fine)
    straight = bulk_flow(SEAL, CONDITION, fine)
    assert (swirled.k > straight.k).all()
    cross_over = [fine[np.argmax(x.effective_damping > 0)] for x in (straight, swirled)]
    assert cross_over[0] < cross_over[1]


def test_fifteen_frequencies_take_a_blink():
    """Three hundredths of a second of a processor, which may be ten times as slow."""
    import time

    bulk_flow(SEAL, CONDITION, FREQUENCIES)
    start = time.process_time()
    bulk_flow(SEAL, CONDITION, FREQUENCIES)
    assert time.process_time() - start < 0.3


def test_table_feeds_a_seal():
    speeds, drops = (1000.0, 2115.0), (20e5, 38.5e5)
    table = seal_table(SEAL, CONDITION, FREQUENCIES, speeds, drops)
    at = coefficients(
        Seal("piston", 0.5, table=table), pressure=38.5e5, speed=2115.0, frequency=FREQUENCIES[4]
    )
    flow = bulk_flow(SEAL, replace(CONDITION, speed=2115.0), FREQUENCIES[4:5])
    assert (at.K, at.k, at.C, at.c) == pytest.approx(
        (flow.K[0], flow.k[0], flow.C[0], flow.c[0]), rel=1e-9
    )
    assert [name for name, _ in table.axes] == ["pressure", "speed", "frequency"]


# bad input


@pytest.mark.parametrize(
    ("part", "changes", "words"),
    [
        (SEAL, {"inlet_clearance": 0.0}, "inlet_clearance"),
        (SEAL, {"exit_clearance": -1e-4}, "exit_clearance"),
        (SEAL, {"inlet_clearance": 0.2}, "radial"),
        (SEAL, {"length": np.nan}, "length"),
        (SEAL, {"hole_area_ratio": 1.2}, "hole_area_ratio"),
        (SEAL, {"hole_depth": -1.0}, "hole_depth"),
        (SEAL, {"exit_recovery": 2.0}, "exit_recovery"),
        (SEAL, {"rotor_friction": Friction(0.0, -0.25)}, "rotor_friction"),
        (SEAL, {"stator_friction": Friction(0.02, -3.0)}, "stator_friction"),
        (CONDITION, {"exit_pressure": 71e5}, "reverse"),
        (CONDITION, {"exit_pressure": 0.0}, "exit_pressure"),
        (CONDITION, {"preswirl": 20.0}, "preswirl"),
        (CONDITION, {"preswirl": np.nan}, "preswirl"),
        (CONDITION, {"preswirl": 0.5, "speed": 0.0}, "preswirl"),
        (CONDITION, {"speed": -1.0}, "speed"),
        (CONDITION.gas, {"viscosity": 0.0}, "viscosity"),
    ],
)
def test_bad_descriptions_are_refused(part, changes, words):
    with pytest.raises(InvalidInput, match=words):
        replace(part, **changes)


@pytest.mark.parametrize("frequencies", [[0.0], [-10.0, 10.0], [], [np.nan], [[1.0]]])
def test_bad_frequencies_are_refused(frequencies):
    with pytest.raises(InvalidInput, match="frequenc"):
        bulk_flow(SEAL, CONDITION, frequencies)


def test_choked_seal_is_refused_with_the_pressure_it_can_follow():
    with pytest.raises(InvalidInput, match="chokes") as caught:
        bulk_flow(SEAL, replace(CONDITION, exit_pressure=5e5), FREQUENCIES)
    lowest = float(str(caught.value).split("above ")[1].split(" bar")[0]) * 1e5
    assert 5e5 < lowest < 31.5e5
    near = bulk_flow(SEAL, replace(CONDITION, exit_pressure=1.1 * lowest), FREQUENCIES)
    assert 0.85 < near.exit_mach < 1


def test_stiff_flow_is_a_numerical_failure():
    """A long, tight, fast seal that four cells cannot follow."""
    tight = replace(SEAL, inlet_clearance=5e-6, exit_clearance=5e-6)
    with pytest.raises(NumericalFailure, match="cells"):
        bulk_flow(tight, CONDITION, FREQUENCIES, cells=4)


def test_bad_grids_and_tables_are_refused():
    for cells in (2, 7):
        with pytest.raises(InvalidInput, match="cells"):
            bulk_flow(SEAL, CONDITION, FREQUENCIES, cells)
    with pytest.raises(InvalidInput, match="ascending"):
        seal_table(SEAL, CONDITION, FREQUENCIES[::-1])
    with pytest.raises(InvalidInput, match="speed"):
        seal_table(SEAL, CONDITION, FREQUENCIES, speeds=[])
