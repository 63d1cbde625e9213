"""A hand-made machine, and the curves of a one-mass loop per axis at three operating points: enough
for every figure.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ambrose.judge.checks import Check, Checks, Curve
from ambrose.machine.description import (
    Amplifier,
    Coupling,
    MagneticBearing,
    OperatingPoint,
    Operation,
)
from ambrose.machine.machine import Machine
from ambrose.machine.part import Disc, Seal, Sensor, ShaftSection
from needs import CHROMIUM

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
ZONES = (("zone A/B", 3.0), ("zone B/C", 4.0), ("zone C/D", 5.0))
POINTS = (("zero pressure", 0.0), ("nominal pressure", 0.4), ("twice nominal <pressure>", 0.9))
NODES = np.linspace(0.0, 0.86, 40)


def sample_machine() -> Machine:
    lengths = (0.05, 0.054, 0.116, 0.15, 0.12, 0.15, 0.116, 0.054, 0.05)
    outer = (0.08, 0.0854, 0.0854, 0.0854, 0.14, 0.0854, 0.0854, 0.0854, 0.08)
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    shaft = tuple(
        ShaftSection(
            float(s),
            n,
            d,
            mass_diameter=0.15 if i in {2, 6} else None,
            inner_diameter=0.03 if i in {3, 5} else 0.0,
        )
        for i, (s, n, d) in enumerate(zip(starts, lengths, outer, strict=True))
    )
    bearings = tuple(
        MagneticBearing(
            name, x, 4.0, np.pi / 4, (144.3, 139.4), (0.86e6, 0.87e6), gap=5e-4, max_current=4.0
        )
        for name, x in (("A", 0.162), ("B", 0.698))
    )
    points = tuple(
        OperatingPoint(0.0, 2.04e5 * i, label=label) for i, (label, _) in enumerate(POINTS)
    )
    return Machine(
        "sample <rig>",
        shaft,
        bearings,
        (Sensor("A", 0.0813), Sensor("B", 0.7787, bandwidth=6e4)),
        discs=(Disc("thrust_disc", 0.81, 6.0, 0.02, 0.0105), Disc("hub", 0.02, 0.5)),
        seals=(
            Seal("center", 0.43, K=0.43e6, k=3.2e6, C=2524.0, c=-2554.0, reference_pressure=2.04e5),
        ),
        couplings=(Coupling("coupling", 0.0, (0.40e6, 0.42e6)),),
        amplifier=Amplifier("first", bandwidth=1360.0),
        operation=Operation(points),
        description="69 kg rotor & air seal",
        source="made up for the tests",
        assumed=(
            ("shaft", "diameters chosen so that the rotor weighs 69 kg"),
            ("modal_damping", "0.5 %, usual for steel"),
        ),
    )


def sample_shapes() -> tuple[np.ndarray, np.ndarray]:
    """Two rigid and two free-free bending shapes of a uniform beam (n, 4), and their frequencies
    [rad/s].
    """
    s = NODES / NODES[-1]
    bent = []
    for root in (4.730041, 7.853205):
        sigma = (np.cosh(root) - np.cos(root)) / (np.sinh(root) - np.sin(root))
        bent.append(
            np.cosh(root * s) + np.cos(root * s) - sigma * (np.sinh(root * s) + np.sin(root * s))
        )
    return np.column_stack([np.ones_like(s), s - 0.5, *bent]), 2 * np.pi * np.array(
        [0.0, 0.0, 551.0, 1290.0]
    )


def sample_checks(label: str, whirl: float) -> Checks:
    """One operating point; ``whirl`` in [0, 1) takes damping away."""
    omega = 2 * np.pi * np.geomspace(0.5, 5000, 700)
    s = 1j * omega
    rows = []
    for i in range(4):
        gain = 1.9e4 * (1 + 0.05 * i)
        K = gain * (1 + 1 / (0.2 * s) + 3.5e-3 * s * (1 - 0.7 * whirl) / (3.5e-4 * s + 1))
        G = 150 / (34 * s**2 - 1e6) + 0.4 / (s**2 + 35 * s + 3461**2)
        rows.append((G * 1.36e3**2 / (s**2 + 1590 * s + 1.36e3**2), K))
    S = np.array([1 / (1 + G * K) for G, K in rows])
    everything = {
        "sensitivity.output": ("Output sensitivity", S, "-", ZONES),
        "complementary": ("Complementary sensitivity", 1 - S, "-", ()),
        "control": ("Control sensitivity K S", np.array([k for _, k in rows]) * S, "A/m", ()),
        "compliance": (
            "Compliance",
            np.array([g for g, _ in rows]) * S / 150,
            "m/N",
            (("required", 4e-7),),
        ),
    }
    names = ("maximum singular value", *AXES)
    curves = [
        Curve(
            name,
            title,
            "frequency",
            omega,
            np.vstack([np.abs(v).max(axis=0) * 1.07, np.abs(v)]),
            names,
            "rad/s",
            unit,
            lines,
        )
        for name, (title, v, unit, lines) in everything.items()
    ]
    orbit = np.abs(S[:1]) * 2e-7 * (omega / 200) ** 2 / (1 + (omega / 300) ** 2)
    limits = (("limit up to 200 Hz", 8e-6),)
    curves.append(
        Curve(
            "unbalance",
            "Unbalance response, G2.5",
            "frequency",
            omega,
            orbit,
            ("worst case",),
            "rad/s",
            "m",
            limits,
        )
    )
    poles = np.array(
        [
            -3.0,
            -40,
            -90 + 60j,
            -60 * (1.02 - whirl) + 250j,
            -50 * (0.95 - 1.1 * whirl) + 310j,
            -17 + 3461j,
            -5e3,
            -40 + 8105j,
        ]
    )
    poles = np.concatenate([poles, poles[poles.imag > 0].conj()])
    curves.append(
        Curve(
            "poles",
            "Closed-loop poles",
            "poles",
            poles.real,
            poles.imag[None, :],
            ("poles",),
            "rad/s",
            "rad/s",
        )
    )
    if whirl == 0.0:
        curves.append(sample_campbell())
    peak = float(curves[0].y[0].max())
    i = int(curves[0].y[0].argmax())
    return Checks(
        label,
        True,
        (
            Check(
                "stability.abscissa",
                "Stability: largest real part of the poles",
                -2.1,
                "rad/s",
                0.0,
                "<",
                True,
                None,
                "asymptotic stability",
                "rightmost: real pole -2.1 rad/s",
            ),
            Check(
                "sensitivity.output.max",
                "Peak output sensitivity, maximum singular value",
                peak,
                "-",
                3.0,
                "<=",
                peak <= 3,
                "A" if peak <= 3 else "C",
                "ISO 14839-3:2006, 7.2",
                f"at {omega[i] / 2 / np.pi:.4g} Hz",
            ),
            Check(
                "margin.phase",
                "Phase margin",
                0.61,
                "rad",
                0.35,
                ">=",
                True,
                None,
                "",
                "at 83 Hz, loop A_zeta",
            ),
            Check(
                "unbalance.orbit_0p",
                "Unbalance orbit up to 200 Hz",
                8.0004e-6,
                "m",
                8e-6,
                "<=",
                False,
                None,
                "ISO 21940-11:2016",
            ),
            Check(
                "control.max",
                "Peak control sensitivity K S, maximum singular value",
                2.1e5,
                "A/m",
                detail="at 160 Hz",
            ),
        ),
        tuple(curves),
    )


def sample_campbell() -> Curve:
    speed = np.linspace(0, 3300, 40)
    tilt = np.array(
        [2 * np.pi * np.sqrt(55**2 + (d * speed / 200) ** 2) + d * speed / 15 for d in (-1, 1)]
    )
    bent = np.array([3461 - 0.03 * speed, 3461 + 0.03 * speed])
    parallel = np.full((1, 40), 250.0)
    labels = (
        "parallel",
        "tilt backward",
        "tilt forward",
        "bending 1 backward",
        "bending 1 forward",
    )
    return Curve(
        "campbell",
        "Campbell map",
        "speed",
        speed,
        np.vstack([parallel, tilt, bent]),
        labels,
        "rad/s",
        "rad/s",
    )


def sample_response(whirl: float, quantity: str) -> Curve:
    t = np.linspace(0, 0.4, 1500)
    damping = 30 * (1 - whirl)
    y = np.array(
        [np.exp(-damping * t) * np.sin(260 * t + 0.4 * i) * (1 if i < 2 else 0.5) for i in range(4)]
    )
    if quantity == "displacement":
        return Curve(
            "impulse.displacement",
            "Impulse at A: displacement",
            "time",
            t,
            1.8e-5 * y,
            AXES,
            "s",
            "m",
            (("touchdown", 2.5e-4),),
        )
    return Curve(
        "impulse.current",
        "Impulse at A: current",
        "time",
        t,
        0.7 * y,
        AXES,
        "s",
        "A",
        (("amplifier", 1.2), ("amplifier", -1.2)),
    )


def sample_comparison() -> list[tuple[str, Curve]]:
    omega = 2 * np.pi * np.geomspace(0.5, 5000, 700)
    s = 1j * omega
    rigid = 150 / (34 * s**2 + 1e6)
    full = rigid + 0.4 / (s**2 + 35 * s + 3461**2)
    title, lines = "Plant, maximum singular value", ("maximum singular value",)
    return [
        (
            label,
            Curve("plant", title, "frequency", omega, np.abs(g)[None, :], lines, "rad/s", "m/A"),
        )
        for label, g in (("full model, 320 states", full), ("reduced, 8 states", rigid))
    ]


@pytest.fixture(scope="session")
def machine() -> Machine:
    return sample_machine()


@pytest.fixture(scope="session")
def verifications() -> list[Checks]:
    return [sample_checks(label, whirl) for label, whirl in POINTS]


@pytest.fixture(scope="session")
def shapes() -> tuple[np.ndarray, np.ndarray]:
    return sample_shapes()


@pytest.fixture(scope="session")
def responses() -> list[tuple[str, Curve]]:
    return [
        (label, sample_response(whirl, quantity))
        for quantity in ("displacement", "current")
        for label, whirl in POINTS
    ]


@pytest.fixture(scope="session")
def comparison() -> list[tuple[str, Curve]]:
    return sample_comparison()


@pytest.fixture(scope="module")  # its event loop is the thread's while it is open
def browser() -> Any:
    reason = "no playwright: install the extra dev"
    playwright = pytest.importorskip("playwright.sync_api", reason=reason)
    with playwright.sync_playwright() as driver:
        words = ["--no-sandbox", "--disable-dev-shm-usage"]
        try:
            made = driver.chromium.launch(executable_path=CHROMIUM, args=words)
        except playwright.Error as error:
            pytest.skip(f"no browser: it does not start here: {error.message.splitlines()[0]}")
        yield made
        made.close()
