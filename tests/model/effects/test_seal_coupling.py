"""Seal coefficients (constants, scaling, tables) and the matrices of seals and couplings."""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import Coupling
from ambrose.machine.part import Seal, SealTable
from ambrose.model.effects import stations as coupling
from ambrose.model.effects.seal import SealCoefficients, coefficients, matrices

CONSTANT = Seal("center", 0.4, K=1e5, k=4e5, C=200.0, c=30.0, M=0.5)


def test_constants_hold_at_every_operating_point():
    expected = SealCoefficients(1e5, 4e5, 200.0, 30.0, 0.5)
    assert coefficients(CONSTANT) == expected
    assert coefficients(CONSTANT, 2e5, 3000.0, 500.0) == expected


def test_named_coefficients_are_proportional_to_pressure():
    seal = Seal(
        "s", 0.4, K=1e5, k=4e5, C=200.0, reference_pressure=2e5, scales_with_pressure=("k", "C")
    )
    assert coefficients(seal, 2e5) == SealCoefficients(1e5, 4e5, 200.0)
    at = coefficients(seal, 3e5)
    assert (at.K, at.k, at.C) == pytest.approx((1e5, 6e5, 300.0))
    assert coefficients(seal, 0.0) == SealCoefficients(1e5, 0.0, 0.0)


def table(axes, **values):
    return SealTable(tuple(axes.items()), tuple(values.items()))


def test_table_is_interpolated_over_its_axes():
    """k = a + b p + c Omega + d p Omega is reproduced exactly by multilinear interpolation."""
    p, speed = np.array([0.0, 1e5, 3e5]), np.array([0.0, 1000.0])

    def k(p, speed):
        return 10.0 + 2e0 * p + 5.0 * speed + 1e-3 * p * speed

    grid = k(p[:, None], speed[None, :])
    axes = {"pressure": tuple(p), "speed": tuple(speed)}
    seal = Seal("s", 0.4, K=7.0, table=table(axes, k=grid.tolist(), M=(0 * grid + 2).tolist()))
    for at in ((0.0, 0.0), (3e5, 1000.0), (1.7e5, 321.0), (5e4, 999.0)):
        found = coefficients(seal, *at, frequency=1e9)  # frequency is not an axis: any value goes
        assert found.k == pytest.approx(k(*at), rel=1e-12)
        assert (found.K, found.M, found.C) == (7.0, 2.0, 0.0)


def test_order_of_the_axes_is_the_tables():
    values = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    seal = Seal(
        "s", 0.4, table=table({"frequency": (0.0, 1.0, 2.0), "pressure": (0.0, 1.0)}, K=values)
    )
    assert coefficients(seal, pressure=1.0, frequency=2.0).K == 6.0
    assert coefficients(seal, pressure=0.0, frequency=1.0).K == 3.0


def test_frequency_defaults_to_the_speed():
    seal = Seal("s", 0.4, table=table({"frequency": (0.0, 100.0)}, K=(0.0, 1e5)))
    assert coefficients(seal, speed=40.0).K == pytest.approx(4e4)
    assert coefficients(seal, speed=40.0, frequency=70.0).K == pytest.approx(7e4)
    assert coefficients(seal, speed=40.0, frequency=0.0).K == 0.0


def test_table_without_pressure_can_scale_with_pressure():
    seal = Seal(
        "s",
        0.4,
        reference_pressure=2e5,
        scales_with_pressure=("k",),
        table=table({"speed": (0.0, 100.0)}, k=(0.0, 1e5)),
    )
    assert coefficients(seal, pressure=1e5, speed=50.0).k == pytest.approx(2.5e4)


def test_an_axis_of_one_point_holds_only_there():
    seal = Seal("s", 0.4, table=table({"pressure": (2e5,), "speed": (0.0, 100.0)}, k=((1.0, 3.0),)))
    assert coefficients(seal, 2e5, 50.0).k == pytest.approx(2.0)
    with pytest.raises(
        InvalidInput,
        match=r"pressure of seal s is 1 bar.* within its table, 2 to 2 bar",
    ):
        coefficients(seal, 1e5, 50.0)
    single = Seal("s", 0.4, table=table({"pressure": (2e5,)}, k=(5.0,)))
    assert coefficients(single, 2e5).k == 5.0


def test_rounding_at_the_end_of_a_table_is_forgiven():
    seal = Seal("s", 0.4, table=table({"pressure": (0.0, 0.3)}, k=(0.0, 1.0)))
    assert coefficients(seal, 0.1 + 0.2).k == 1.0


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (
            {"pressure": 4e5},
            "pressure of seal s is 4 bar, but must be within its table, 1 to 3 bar; extend",
        ),
        ({"pressure": 0.0}, "pressure of seal s is 0 bar"),
        (
            {"pressure": 2e5, "frequency": 2000.0},
            "frequency of seal s is 318.31 Hz, but must be within its table, 0 to 159.155 Hz",
        ),
        ({"pressure": 2e5, "frequency": -1.0}, "frequency of seal s is -0.159155 Hz"),
        ({"pressure": 2e5, "frequency": np.nan}, "frequency of seal s is nan"),
        ({"pressure": -1.0}, "pressure.*zero or positive"),
        ({"pressure": np.nan}, "pressure.*finite"),
    ],
)
def test_nothing_is_extrapolated(point, message):
    axes = {"pressure": (1e5, 3e5), "frequency": (0.0, 1000.0)}
    seal = Seal("s", 0.4, table=table(axes, k=((1.0, 2.0), (3.0, 4.0))))
    with pytest.raises(InvalidInput, match=message):
        coefficients(seal, **point)


def test_missing_reference_pressure_is_named():
    with pytest.raises(InvalidInput, match="reference_pressure of seal s is missing"):
        coefficients(Seal("s", 0.4, k=1.0, scales_with_pressure=("k",)), 1e5)


def test_seal_matrices_drive_forward_whirl():
    stiffness, damping, mass = matrices(SealCoefficients(K=1.0, k=2.0, C=3.0, c=4.0, M=5.0))
    assert stiffness.tolist() == [[1.0, 2.0], [-2.0, 1.0]]
    assert damping.tolist() == [[3.0, 4.0], [-4.0, 3.0]]
    assert mass.tolist() == [[5.0, 0.0], [0.0, 5.0]]
    # Work on one turn of a circular orbit from x to y, per radius^2: 2 pi (k - C w) > 0 when k
    # outweighs damping.
    angle = np.linspace(0, 2 * np.pi, 721)
    orbit = np.stack([np.cos(angle), np.sin(angle)])
    velocity = np.stack([-np.sin(angle), np.cos(angle)])
    for frequency in (0.1, 1.0):
        force = -(stiffness @ orbit + frequency * damping @ velocity - frequency**2 * mass @ orbit)
        work = np.trapezoid((force * velocity).sum(axis=0), angle)
        assert work == pytest.approx(2 * np.pi * (2.0 - 3.0 * frequency))


def test_coupling_matrices_are_diagonal_in_its_axes():
    stiffness, damping = coupling.matrices(
        Coupling("c", 0.0, (4.0e5, 4.2e5), (10.0, 12.0), angle=0.3)
    )
    assert stiffness.tolist() == [[4.0e5, 0.0], [0.0, 4.2e5]]
    assert damping.tolist() == [[10.0, 0.0], [0.0, 12.0]]
    with pytest.raises(InvalidInput, match=r"stiffness of coupling c.*finite"):
        coupling.matrices(Coupling("c", 0.0, (np.nan, 1.0)))
