"""The turboexpander of paper P3 at 140 Hz: H-infinity for the nominal seal against mu over +-40 %
of its eight coefficients.

`python -m benchmarks.campaign_p3` prints the figures of statements P3.1 to P3.6 (half a minute of
computing time); `--page p3.html` draws them. The controllers are designed on the rigid rotor, as in
P3, and judged with bending modes: the families on a model with two per plane, stability on all 320
states of the shaft. Members of the box: nominal, the 256 corners, 64 samples.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.core.worst_case import gain_bound, worst_gain
from ambrose.core.worst_case_loop import (
    box_points,
    corners,
    default_grid,
    gains,
    transfers,
    unstable_poles,
)
from ambrose.judge.exploration import (
    BoxUnbalance,
    PulseFamily,
    loop_over_box,
    pulse_family,
    unbalance_over_box,
)
from ambrose.judge.robust import box_loops
from ambrose.law.design_problem import design_plant, machine_weights
from ambrose.law.loop import closed_loop
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.mu import mu_synthesis

HZ = 2 * np.pi
POINT = "140 Hz (P3)"
BENDING_MODES = 2
RATED = 525 * HZ  # 31,500 rpm
FORCE, WIDTH = 100.0, 2e-3  # N, s, at A_x


@dataclass(frozen=True, slots=True, eq=False)
class Designs:
    """Controllers for the rigid rotor at 140 Hz, and the norms they reach; naive: H-infinity with
    the uncertainty as a full block, by the factor on the block's signals.
    """

    machine: Machine
    full: Plant
    judged: Plant
    hinf: StateSpace
    mu: StateSpace
    gamma_nominal: float
    gamma_mu: float
    naive: dict[float, float]
    mu_seconds: float


def designs(time_limit: float = 600.0) -> Designs:
    """Half of the campaign's time goes into the D-K iteration."""
    import time

    machine = load_machine("turboexpander")
    full = assemble(machine, operating_point(machine, POINT))
    rigid = reduce(full)
    problem = design_plant(rigid)
    nominal = hinf_synthesis(design_plant(rigid, uncertain=False))
    start = time.process_time()
    robust = mu_synthesis(problem, order=1, time_limit=time_limit)
    seconds = time.process_time() - start
    naive = {c: hinf_synthesis(rescaled(problem, c)).gamma for c in (1e-2, 1e-1, 1.0, 1e1)}
    judged = reduce(full, BENDING_MODES)
    return Designs(
        machine,
        full,
        judged,
        nominal.controller,
        robust.controller,
        nominal.gamma,
        robust.gamma,
        naive,
        seconds,
    )


def rescaled(problem: GeneralizedPlant, factor: float) -> GeneralizedPlant:
    """The same problem with the uncertainty's inputs divided and its outputs multiplied by a
    factor: delta stays what it is.
    """
    n_w = problem.n_w_blocks
    n_z = problem.n_z_blocks
    s = problem.system
    into, out = np.ones(len(s.inputs)), np.ones(len(s.outputs))
    into[[s.inputs.index(name) for name in problem.w[:n_w]]] = 1 / factor
    out[[s.outputs.index(name) for name in problem.z[:n_z]]] = factor
    system = StateSpace(
        s.A, s.B * into, out[:, None] * s.C, out[:, None] * s.D * into, s.inputs, s.outputs
    )
    return GeneralizedPlant(system, problem.w, problem.u, problem.z, problem.y, problem.blocks)


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """omega (w,) [rad/s]; S_o, S_i [-] and K S_o [A/m] of every member (d, w); unstable (d,) how
    many poles.

    worst, bound [-]: of S_o over the box by search and by mixed mu; infinite where the box holds
    unstable loops. axis (d,): the largest diagonal element of S_o, which is what ISO 14839-3
    limits; output is its largest singular value. control [-]: K S_o over its limit 1/W_u, the
    largest over stable members and frequencies.
    """

    omega: np.ndarray
    output: np.ndarray
    axis: np.ndarray
    input: np.ndarray
    control: np.ndarray
    limit: np.ndarray
    unstable: np.ndarray
    worst: float
    bound: float

    @property
    def over_limit(self) -> float:
        return float((self.control / self.limit)[self.unstable == 0].max())

    @property
    def bandwidth(self) -> float:
        """Frequency [rad/s] above which K S_o of every stable member stays 3 dB below the
        largest.
        """
        rows = self.control[self.unstable == 0]
        above = rows.max(axis=0) > np.sqrt(0.5) * rows.max()
        return float(self.omega[np.flatnonzero(above)[-1]])


def sensitivities(plant: Plant, controller: Any) -> Sensitivities:
    """Of all members of the box."""
    output, input_, control = box_loops(plant, controller)
    members = box_points(output.parameters)
    omega = np.geomspace(1 * HZ, 5e3 * HZ, 240)
    unstable = unstable_poles(output, members)
    weights = machine_weights(plant.machine)
    W = np.abs(frequency_response(weights.control, omega).values[:, 0, 0])
    worst = bound = np.inf
    if not unstable.any():
        found = worst_gain(output)
        near = found.frequency * np.linspace(0.9, 1.1, 11)
        worst, bound = (
            found.value,
            gain_bound(output, np.unique([*default_grid(output)[::12], *near]), found.value),
        )
    S_o, S_i, KS = (gains(loop.at(omega), loop, members) for loop in (output, input_, control))
    each = np.einsum("dwii->dwi", transfers(output.at(omega), output, members))
    axis = np.abs(each).max(axis=(1, 2))
    return Sensitivities(
        omega,
        S_o,
        axis,
        S_i,
        KS,
        weights.current_scale / weights.error_scale / W,
        unstable,
        worst,
        bound,
    )


def families(plant: Plant, controller: Any) -> tuple[PulseFamily, PulseFamily]:
    """Displacements at the bearings and currents after 100 N for 2 ms at A_x, and after a step of
    100 N there.
    """
    outputs = [*plant.bearing_named("q"), *plant.named("i")]
    pulse, step = (
        pulse_family(plant, controller, "A_zeta", FORCE, width, outputs)
        for width in (WIDTH, np.inf)
    )
    return pulse, step


def unbalance(
    found: Designs, controller: Any, count: int = 15
) -> tuple[BoxUnbalance, BoxUnbalance]:
    """20 to 300 Hz: on the plant of 140 Hz, as in P3 (14), and with rotor and seal of every
    speed.
    """
    speeds = HZ * np.linspace(20, 300, count)

    def at(speed: float) -> Plant:
        return reduce(assemble(found.machine, replace(found.full.point, speed=speed)), 1)

    return unbalance_over_box(found.judged, controller, speeds), unbalance_over_box(
        at, controller, speeds
    )


def readings(curve: BoxUnbalance, rated: float) -> dict[str, tuple[float, float]]:
    """The largest bound [um] and where [Hz], by what "balanced to G2.5" may mean: at the rated
    speed [rad/s], at the top of the range, or at whatever speed the rotor turns. P3 does not say.
    """
    found = {}
    speeds = {"rated speed": rated, "300 Hz": 300 * HZ, "each speed": curve.speeds}
    for name, speed in speeds.items():
        orbit = 1e6 * curve.bound * rated / speed
        found[name] = float(orbit.max()), float(curve.speeds[orbit.argmax()] / HZ)
    return found


def with_states(found: Designs) -> Plant:
    """The judged plant with the seal's true frequency dependence in place of the constants of 140
    Hz.
    """
    seal = replace(found.machine.seals[0], frequency_dependence="states")
    return reduce(assemble(replace(found.machine, seals=(seal,)), found.full.point), BENDING_MODES)


def unstable_corners(plant: Plant, controller: Any) -> int:
    """Of 256, on any model."""
    loop = loop_over_box(plant, controller, plant.bearing_named("f"), plant.bearing_named("q"))
    return int((unstable_poles(loop, corners(loop.parameters)) > 0).sum())


def main(page: Path | None) -> None:
    found = designs()
    print(
        f"P3.1  H-infinity, nominal {found.gamma_nominal:.3f}; uncertainty as a full block, by "
        "the scale of its signals:"
    )
    print("      " + ", ".join(f"{c:g}: {g:.1f}" for c, g in found.naive.items()))
    print(f"      mu {found.gamma_mu:.3f}, order {found.mu.n_states}, {found.mu_seconds:.1f} s")
    shown = {}
    for name, controller in (("H-infinity", found.hinf), ("mu", found.mu)):
        s = sensitivities(found.judged, controller)
        stable = s.unstable == 0
        print(
            f"P3.2  {name}: nominal S_o {s.output[0].max():.2f}, S_i {s.input[0].max():.2f}; "
            f"{(~stable).sum()} of {len(stable)}"
        )
        print(
            f"      members unstable ({unstable_corners(found.full, controller)} of 256 corners, "
            "full model); worst S_o of"
        )
        print(
            f"      stable members {s.output[stable].max():.2f}, by search {s.worst:.3f}, bound "
            f"{s.bound:.3f}"
        )
        print(
            f"      per axis: nominal {s.axis[0]:.2f}, stable members up to "
            f"{s.axis[stable].max():.2f}"
        )
        print(
            f"P3.3  {name}: K S_o over its limit {s.over_limit:.3f}, bandwidth "
            f"{s.bandwidth / HZ:.0f} Hz"
        )
        pulse, step = families(found.judged, controller)
        for what, family in (("P3.4 pulse", pulse), ("P3.6 step", step)):
            q, i = (
                np.abs(family.responses[:, :4]).max(axis=2) * 1e6,
                np.abs(family.responses[:, 4:]).max(axis=(1, 2)),
            )
            held = family.stable
            wide = family.settling(0.05, family.outputs[:4])
            close = family.settling(0.02, family.outputs[:4])
            print(
                f"{what}  {name}: peak {q[0].max():.2f} um, stable ones to {q[held].max():.2f}, "
                f"A_y {q[held, 1].max():.2f};"
            )
            print(
                f"      current {i[held].max():.2f} A; settling to 2 % {close[0] * 1e3:.1f} ms, "
                f"worst {close.max() * 1e3:.1f}"
            )
            print(f"      to 5 % {wide[0] * 1e3:.1f} ms, worst {wide.max() * 1e3:.1f}")
        shown[name] = (s, pulse)
    for what, curve in zip(
        ("plant of 140 Hz", "plant of every speed"), unbalance(found, found.mu), strict=True
    ):
        k = int(np.argmax(curve.bound))
        print(
            f"P3.5  {what}: nominal {curve.nominal.max() * 1e6:.3f} um, search "
            f"{curve.found.max() * 1e6:.3f}, bound "
            f"{curve.bound[k] * 1e6:.3f} at {curve.speeds[k] / HZ:.0f} Hz; bound with G2.5 at "
            + ", ".join(
                f"{name} {um:.1f} um, {hz:.0f} Hz"
                for name, (um, hz) in readings(curve, RATED).items()
            )
        )
    states = with_states(found)
    abscissa = spectral_abscissa(closed_loop(states, found.hinf))
    s = sensitivities(states, found.mu)
    print(
        "Seal with states: the H-infinity controller's nominal loop has a pole at "
        f"{abscissa:+.1f} rad/s;"
    )
    print(
        f"      mu: nominal S_o {s.output[0].max():.2f}, {(s.unstable > 0).sum()} of "
        f"{len(s.unstable)} members unstable,"
    )
    print(f"      worst S_o by search {s.worst:.3f}, bound {s.bound:.3f}")
    if page is not None:
        draw(shown, page)


def draw(shown: dict[str, tuple[Sensitivities, PulseFamily]], page: Path) -> None:
    """Two columns, H-infinity and mu: S_o, K S_o, and the pulse response in x and y with the
    current.
    """
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    rows = (
        "output sensitivity [-]",
        "control sensitivity K S_o [A/um]",
        "A_x [um]",
        "A_y [um]",
        "current A_x [A]",
    )
    titles = [f"{name}: {row}" for row in rows for name in shown]
    figure = make_subplots(
        rows=5, cols=2, subplot_titles=titles, vertical_spacing=0.06, shared_yaxes="rows"
    )
    for column, (s, pulse) in enumerate(shown.values(), 1):
        for k in range(len(pulse.delta) - 1, -1, -2):
            stable = s.unstable[k] == 0
            colour = (
                "black" if k == 0 else "rgba(31,119,180,0.25)" if stable else "rgba(214,39,40,0.35)"
            )
            line = {"color": colour, "width": 2 if k == 0 else 1}
            traces = [
                (pulse.time * 1e3, pulse.responses[k, j] * f)
                for j, f in ((0, 1e6), (1, 1e6), (4, 1.0))
            ]
            if stable:
                traces = [(s.omega / HZ, s.output[k]), (s.omega / HZ, s.control[k] * 1e-6), *traces]
            for row, (x, y) in enumerate(traces, 1 if stable else 3):
                figure.add_trace(
                    go.Scatter(x=x, y=y, line=line, showlegend=False), row=row, col=column
                )
        figure.add_hline(y=3.0, line_dash="dash", line_color="orange", row=1, col=column)
        limit = {"color": "orange", "dash": "dash"}
        figure.add_trace(
            go.Scatter(x=s.omega / HZ, y=s.limit * 1e-6, line=limit, showlegend=False),
            row=2,
            col=column,
        )
        for row in (1, 2):
            figure.update_xaxes(type="log", title="Hz", row=row, col=column)
            figure.update_yaxes(type="log", row=row, col=column)
        for row in (3, 4, 5):
            figure.update_xaxes(title="ms", row=row, col=column)
    for row, size in ((3, 14), (4, 4), (5, 1.2)):
        figure.update_yaxes(range=[-size, size], row=row)
    figure.update_layout(
        height=1700,
        width=1300,
        template="plotly_white",
        title="P3 at 140 Hz, seal +-40 %: red is unstable",
    )
    figure.write_html(page, include_plotlyjs=True, config={"displayModeBar": False})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    main(parser.parse_args().page)
