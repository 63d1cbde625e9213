"""The H-infinity controller that P5 prints (Appendix B, 20 states) on three models, beside our own
of the same design.

The table "The printed controller" of docs/research/reproduction.md is read and compared with what is
computed here; `pytest tests/literature/test_published_controller.py -s` prints its rows.
"""

import json
import re
from dataclasses import replace
from functools import cache
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from benchmarks.published_p5 import published_p5, published_p5_problem, published_p5_weights

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import close_uncertainty
from ambrose.core.response import settling_time
from ambrose.core.statespace import StateSpace, connect, poles, rename, select, spectral_abscissa
from ambrose.judge import robust
from ambrose.judge.loop_response import loop_evaluator
from ambrose.law.design_problem import design_plant, machine_weights, scale_control
from ambrose.law.loop import closed_loop
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import perturbed, reduce
from ambrose.rig import linear, virtual_rig
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trace import settling
from ambrose.synthesis.design import design
from ambrose.synthesis.hinf import hinf_synthesis

pytestmark = pytest.mark.literature
HZ = 2 * np.pi
DATA = json.loads((Path(__file__).parent / "published_hinf.json").read_text(encoding="utf-8"))
PAGE = Path(__file__).parents[2] / "docs" / "research" / "reproduction.md"
AXES = tuple(DATA["axes"])
ERROR = 20e-6  # m; the print's unit of the displacement error
TIMES_K = (0, 1, 2)  # times the nominal cross-coupled stiffness
POINTS = ("zero pressure", "nominal pressure", "twice nominal pressure")
# Bearing displacements from the sensors', which sit 1.301 times further from the middle
# (test_published_p5.py).
INWARD = np.kron([[2.301, 0.301], [0.301, 2.301]], np.eye(2)) / 2.602


def printed(axes=AXES, scale=ERROR, sign=1.0):
    """err [m] -> u [A], read with the axes in an order, the error in a unit and the output with a
    sign.
    """
    A, B, C, D = (np.array(DATA[name], dtype=float) for name in "ABCD")
    return StateSpace(
        A, B / scale, sign * C, D, [f"err_{a}" for a in axes], [f"u_{a}" for a in axes]
    )


@cache
def ours():
    return hinf_synthesis(published_p5_problem(uncertain=False)).controller


def loop(controller, times_k):
    """The published plant: d_<axis> [m] and f_<axis> [N] to y_<axis> [m], d included."""
    plant = rename(
        close_uncertainty(published_p5(), {"seal.k": times_k - 1}),
        None,
        {f"y_{a}": f"g_{a}" for a in AXES},
    )
    y = {f"y_{a}": [f"g_{a}", f"d_{a}"] for a in AXES}
    errors = {f"err_{a}": [f"-y_{a}"] for a in AXES}
    return connect(
        [plant, controller],
        [f"{kind}_{a}" for kind in "df" for a in AXES],
        list(y),
        {**y, **errors},
    )


OMEGA = HZ * np.geomspace(0.1, 300, 2500)


def summits(curve):
    """(frequency [Hz], height) of the local maxima inside the grid."""
    inside = np.flatnonzero((curve[1:-1] > curve[:-2]) & (curve[1:-1] >= curve[2:])) + 1
    return [(OMEGA[k] / HZ, curve[k]) for k in inside]


def norms(values):
    return np.linalg.norm(values, 2, axis=(1, 2))


@cache
def on_the_published_plant(which, times_k):
    """Rightmost pole [rad/s]; S_o's peak and its frequency [Hz]; compliance peaks at the bearings,
    [Hz] and [um/N].
    """
    system = loop(printed() if which == "printed" else ours(), times_k)
    S, G = (
        frequency_response(select(system, [f"{kind}_{a}" for a in AXES]), OMEGA).values
        for kind in "df"
    )
    return _figures(spectral_abscissa(system), norms(S), norms(INWARD @ G))


def _figures(abscissa, S, compliance):
    return (
        abscissa,
        S.max(),
        OMEGA[S.argmax()] / HZ,
        [(hz, 1e6 * height) for hz, height in summits(compliance)],
    )


@cache
def rig(name="seal-rig-k-only"):
    """The bundled rig: k alone follows the pressure (P5 section 4.1), or, "seal-rig", all
    coefficients (section 5.2).
    """
    return load_machine(name)


@cache
def plant(label, name="seal-rig-k-only"):
    machine = rig(name)
    return assemble(
        machine, next(point for point in machine.operation.points if point.label == label)
    )


@cache
def law(which):
    return printed() if which == "printed" else design(plant(POINTS[1]), "hinf").controller


@cache
def on_the_rig(which, label):
    """As on the published plant, full finite-element model; then settling [ms] to 10 and 5 % on it
    and on the virtual rig.
    """
    item, controller = plant(label), law(which)
    system, response = closed_loop(item, controller), loop_evaluator(item, controller)(OMEGA)
    figures = _figures(
        spectral_abscissa(system),
        norms(response.output_sensitivity()),
        norms(response.compliance()),
    )
    scenario = load_scenario("impulse-orthogonal")
    times = []
    for trace in (
        linear.run(system, scenario),
        virtual_rig.run(rig(), controller, scenario, point=item.point),
    ):
        assert trace.outcome == "completed"
        y = np.stack([trace.record[f"y_{a}"] for a in AXES])
        # on the rig from where it rests, which is not zero: the printed integrators leak
        moved = y - y[:, :1]
        times += [
            1e3 * settling_time(trace.record.time, moved, band, start=0.05) for band in (0.10, 0.05)
        ]
    return *figures, times


def table():
    """{(model, k, controller): figures} as docs/research/reproduction.md states them."""
    section = (
        PAGE.read_text(encoding="utf-8")
        .partition("## The printed controller")[2]
        .partition("\n## ")[0]
    )
    rows = {}
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == 7 and cells[1] in ("0", "1", "2"):
            rows[cells[0], int(cells[1]), cells[2]] = [
                [float(x) for x in re.findall(r"-?\d+\.?\d*", c)] for c in cells[3:]
            ]
    return rows


def test_the_print_is_a_controller_of_twenty_states_with_four_integrators():
    """Rounded to 0.1 in its last rows, it leaves them at most 0.05 rad/s from zero, one on the
    wrong side.
    """
    found = np.sort_complex(poles(printed()))
    slow = found[np.abs(found) < 1]
    assert len(found) == 20 and len(slow) == 4
    assert np.abs(slow).max() < 0.05
    assert slow.real.max() == pytest.approx(0.0377, abs=1e-3)
    assert found[np.abs(found) >= 1].real.max() < -400


@pytest.mark.parametrize("which", ["printed", "ours"])
@pytest.mark.parametrize("times_k", TIMES_K)
def test_on_the_published_plant(which, times_k):
    """The row of the table: stable at zero, nominal and twice the nominal k."""
    found = on_the_published_plant(which, times_k)
    _compare(table()["published plant", times_k, which], found)


@pytest.mark.parametrize("which", ["printed", "ours"])
@pytest.mark.parametrize("times_k", TIMES_K)
def test_on_the_finite_element_and_the_virtual_rig(which, times_k):
    *found, times = on_the_rig(which, POINTS[times_k])
    row = table()["rig", times_k, which]
    _compare(row, found)
    np.testing.assert_allclose(row[3], times, atol=0.6)


def _compare(row, found):
    """The table's figures are the computed ones, rounded."""
    abscissa, peak, hertz, heights = found
    print(
        f"\n{abscissa:.2f} | {peak:.2f} at {hertz:.0f} Hz | "
        + ", ".join(f"{h:.3f} at {f:.2f} Hz" for f, h in heights)
    )
    assert abscissa < 0
    assert row[0] == pytest.approx([abscissa], abs=0.011)
    assert row[1] == [pytest.approx(peak, abs=0.007), pytest.approx(hertz, abs=0.7)]
    assert row[2] == pytest.approx([x for f, h in heights for x in (h, f)], rel=0.01, abs=0.006)


def test_low_frequency_peak_at_the_bearings():
    """P5.6, second half: H-infinity has one at low pressure, at the bearings and below 1 Hz; at the
    sensors there is none.

    Its frequency follows w_B: 1.70 and 2.22 Hz with 3 and 4 rad/s in place of the 1.5 that fits the
    printed controller.
    """
    low, high = on_the_published_plant("printed", 0)[3]
    assert low == pytest.approx((0.857, 0.448), abs=0.01)
    assert high == pytest.approx((50.5, 1.027), rel=0.01)
    at_sensors = summits(
        norms(
            frequency_response(select(loop(printed(), 0), [f"f_{a}" for a in AXES]), OMEGA).values
        )
    )
    assert len(at_sensors) == 1
    for bandwidth, hertz in ((3.0, 1.70), (4.0, 2.22)):
        weights = machine_weights(replace(rig().weights, bandwidth=bandwidth))
        controller = hinf_synthesis(published_p5_problem(weights, uncertain=False)).controller
        G = frequency_response(select(loop(controller, 0), [f"f_{a}" for a in AXES]), OMEGA).values
        assert summits(norms(INWARD @ G))[0][0] == pytest.approx(hertz, abs=0.03)


def test_our_synthesis_gives_the_printed_controller():
    """All sixteen elements together within 2.2 % of its norm from 1 to 100 Hz (below, its
    integrators leak), 9 % at 200 Hz.
    """
    found, wanted = (frequency_response(c, OMEGA).values for c in (ours(), printed()))
    error = norms(found - wanted) / norms(wanted)
    band = (OMEGA > HZ) & (OMEGA < 100 * HZ)
    print(
        f"\nlargest difference {100 * error[band].max():.1f} % to 100 Hz, "
        f"{100 * error[OMEGA < 200 * HZ][-1]:.1f} % at 200 Hz"
    )
    assert error[band].max() == pytest.approx(0.0225, abs=0.001)
    assert error[OMEGA < 200 * HZ][-1] == pytest.approx(0.085, abs=0.01)


@pytest.mark.parametrize(("factor", "difference"), [(0.9, 0.091), (1.0, 0.022), (1.1, 0.059)])
def test_the_print_confirms_the_force_per_current(factor, difference):
    """Designed for 10 % less or more force per ampere, W_u scaled alike, ours moves away from the
    printed one.
    """
    model, weights = published_p5(), published_p5_weights()
    s = model.system
    scaled = replace(s, B=s.B * [factor if name in model.u else 1.0 for name in s.inputs])
    problem = design_plant(
        replace(model, system=scaled), scale_control(weights, factor), uncertain=False
    )
    omega = HZ * np.geomspace(1, 200, 100)
    found, wanted = (
        frequency_response(c, omega).values for c in (hinf_synthesis(problem).controller, printed())
    )
    error = np.linalg.norm(found - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))
    assert np.sqrt(np.mean(error**2)) == pytest.approx(difference, abs=0.002)


def test_no_other_reading_of_the_print_holds_the_published_plant():
    """The other sign, metres or micrometres, or another order of the axes: unstable somewhere
    between zero and twice k, save the four orders that mirror the nearly symmetrical rotor; of
    these the printed one is the best at nominal k.
    """
    reach = {}
    for order in permutations(AXES):
        assert spectral_abscissa(loop(printed(order, sign=-1.0), 1)) > 100
        if max(spectral_abscissa(loop(printed(order), k)) for k in TIMES_K) < 0:
            S = frequency_response(
                select(loop(printed(order), 1), [f"d_{a}" for a in AXES]), OMEGA
            ).values
            reach[order] = norms(S).max()
    assert len(reach) == 4
    assert min(reach, key=reach.get) == AXES
    for scale in (1e-6, 1e-5, 3e-5, 1e-3):
        assert max(spectral_abscissa(loop(printed(scale=scale), k)) for k in TIMES_K) > 10


def test_without_pressure_when_damping_follows_it_too():
    """K, C and c gone with k: S_o 10.8 and 75 ms with the printed controller, 9.8 and 73 ms with
    ours.
    """
    item, found = plant(POINTS[0], "seal-rig"), {}
    for which in ("printed", "ours"):
        S = norms(loop_evaluator(item, law(which))(OMEGA).output_sensitivity())
        trace = linear.run(closed_loop(item, law(which)), load_scenario("impulse-orthogonal"))
        found[which] = S.max(), 1e3 * settling(trace, band=0.10, start=0.05)
    assert found["printed"] == pytest.approx((10.76, 75), rel=0.01)
    assert found["ours"] == pytest.approx((9.79, 73), rel=0.01)


def test_how_far_beyond_the_range():
    """On the published plant: stable to 1.68 tolerances of k, proved to 1.65; worst S_o 4.15 (bound
    4.16).
    """
    found = robust.check(published_p5(), printed())
    assert found["robust.stability.box"].value == 0
    assert found["robust.stability.margin"].value == pytest.approx(1.678, abs=0.01)
    assert found["robust.stability.margin"].value >= found["robust.stability.proved"].value > 1.6
    assert found["robust.sensitivity.worst"].value == pytest.approx(4.153, abs=0.02)
    k = Tolerance("seal.center.k", relative=1.0)
    # on the full rig, beyond zero k
    for which, inside, outside in (("printed", 1.64, 1.67), ("ours", 1.67, 1.70)):
        held = [
            spectral_abscissa(
                closed_loop(perturbed(plant(POINTS[1]), {k.parameter: -d}, [k]), law(which))
            )
            < 0
            for d in (inside, outside)
        ]
        assert held == [True, False]


def test_rounded_integrators_leave_the_virtual_rig_off_centre():
    """Under the rotor's weight it rests up to 3.8 um from the middle; our own controller within 0.1
    um.
    """
    scenario = replace(load_scenario("impulse-orthogonal"), duration=0.06)
    rest = {}
    for which in ("printed", "ours"):
        record = virtual_rig.run(rig(), law(which), scenario, point=plant(POINTS[1]).point).record
        rest[which] = max(abs(record[f"y_{a}"][0]) for a in AXES)
    print(f"\nrests at {rest}")
    assert rest["printed"] == pytest.approx(3.8e-6, abs=0.2e-6)
    assert rest["ours"] < 0.2e-6
    # a fixed offset, no drift
    assert spectral_abscissa(closed_loop(reduce(plant(POINTS[1])), printed())) < -4
