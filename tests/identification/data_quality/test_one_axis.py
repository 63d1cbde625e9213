"""First look at one levitated axis: records of a real apparatus (MIT licence, see
tests/records/levitation), and a simulated one that nothing is wrong with.
"""

from pathlib import Path

import numpy as np
import pytest

from ambrose.identification.findings import Code
from ambrose.identification.one_axis.identify import (
    coarse_steps,
    coil_equation,
    dead_channels,
    levitation,
    rate_by_weight,
)

RECORDS = Path(__file__).parents[2] / "records" / "levitation"


def read(name):
    rows = (RECORDS / name).read_text("latin-1").splitlines()
    return np.array([line.split() for line in rows if line and line[0] != "#"], float).T


def first_look(t, position, current, voltage=None, gap=None):
    """What the checks find, as identify --generic asks them; a dead channel alone where one is."""
    signals = {"position": position, "current": current}
    signals |= {} if voltage is None else {"voltage": voltage}
    return tuple(dead_channels(signals)) or (
        *levitation(t, position, gap),
        *rate_by_weight(t, position),
        *coarse_steps(signals),
        *coil_equation(t, signals),
    )


def codes(*arguments, **options):
    return {finding.code for finding in first_look(*arguments, **options)}


@pytest.mark.parametrize(
    "name, levitated",
    [
        ("levitador_dataset_chirp_20251217_210058.txt", False),
        ("levitador_dataset_multiescalon_20251217_210203.txt", True),
    ],
)
def test_what_a_laboratory_delivers(name, levitated):
    t, y, observed, _, i, u, _ = read(name)
    found = codes(t, y, i, voltage=u, gap=0.02)
    assert {Code.SAMPLE_RATE, Code.MIXED_CHANNELS} <= found
    assert (Code.TOUCHDOWN not in found) == levitated
    assert codes(t, observed, i) == {Code.DEAD_CHANNEL}


def test_the_first_position_of_the_third_record_is_a_reference():
    t, y, second, _, i, u = read("levitador_datos_levitador.txt")
    assert codes(t, y, i) == {Code.DEAD_CHANNEL}
    assert {Code.TOUCHDOWN, Code.MIXED_CHANNELS} <= codes(t, second, i, voltage=u, gap=0.02)


def loop(rate, seconds=4.0):
    """m y'' = m g - C (i/y)^2 under a PD about 5 mm with a reference that moves; R = 3 ohm, L = 10
    mH, the voltage behind what the current needs; steps of 1/20 of a sample.
    """
    y0, m, C, fine = 5e-3, 0.02, 1e-4, 20
    i0 = y0 * np.sqrt(9.81 * m / C)
    y, v, rows = y0, 0.0, []
    for k in range(int(seconds * rate)):
        aim = y0 + 3e-4 * np.sin(2 * np.pi * 2 * k / rate) + 2e-4 * np.sin(2 * np.pi * 7 * k / rate)
        i = i0 * (1 + 600 * (y - aim) + 6 * v)
        rows.append((k / rate, y, i))
        for _ in range(fine):
            v += (9.81 - C / m * (i / y) ** 2) / (rate * fine)
            y += v / (rate * fine)
    t, y, i = np.array(rows).T
    return t, y, i, 3.0 * i + 0.01 * np.gradient(i, t)


def test_nothing_is_wrong_with_a_good_record():
    t, y, i, u = loop(2000.0)
    assert np.ptp(y) < 2e-3  # it hovers
    assert first_look(t, y, i, voltage=u, gap=0.02) == ()
    assert codes(t[::20], y[::20], i[::20], gap=0.02) == {Code.SAMPLE_RATE}
    step = 0.2 * i.std()
    assert codes(t, y, np.round(i / step) * step, gap=0.02) == {Code.CLIPPED}
