"""The residual system S(theta) of realisation/coprime.py as a function of the unknown parameters,
with exact derivatives.

Sampled: the loop as it runs (identification/output_error/loop_model.py), driven by alpha in place
of the excitation and watched by the nominal plant's observer. Held: the continuous loop of an
observer-based controller into which alpha is fed, held between the samples (P1's experiment); there
theta is a feedback around the nominal S, P1 (13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import NumericalFailure
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.realisation.coprime import CoprimeFactors, residual_lft
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace, index_of
from ambrose.identification.output_error.loop_model import LoopModel, directions_of, loop_model
from ambrose.machine.description import Tolerance
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import uncertain


@dataclass(frozen=True, slots=True, eq=False)
class SampledResidual:
    """S(theta) from alpha (m) to eps (p) of a sampled loop; eps is weighted by ``whitening`` (p,
    p).

    inner: the loop from e_<axis> to y_<axis>, u_<axis>; factors: those of the sampled nominal plant
    and controller.
    """

    inner: LoopModel
    factors: CoprimeFactors
    whitening: np.ndarray

    @property
    def excitations(self) -> tuple[str, ...]:
        return self.factors.alpha

    @property
    def signals(self) -> tuple[str, ...]:
        return self.factors.eps

    def loop(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]:
        """S at theta (q,), of the states (plant, controller, observer), and its derivative for each
        parameter.
        """
        loop, changes = self.inner.loop(theta)
        G = self.factors.plant
        L = self.factors.plant_gain
        L_K = self.factors.controller_gain
        p, n = len(G.outputs), G.n_states
        loop_states, k = loop.n_states, L_K.shape[0]

        # x_o+ = (A + L C) x_o + B (u + alpha) - L y,   eps = y - C x_o
        C_y, C_u = loop.C[:p], loop.C[p:]
        A = np.block([[loop.A, np.zeros((loop_states, n))], [G.B @ C_u - L @ C_y, G.A + L @ G.C]])

        # alpha enters as the excitation, and the controller's states by -L_K
        B = np.vstack([loop.B - np.vstack([np.zeros((loop_states - k, L_K.shape[1])), L_K]), G.B])
        C = self.whitening @ np.hstack([C_y, -G.C])
        D = np.zeros((p, B.shape[1]))

        # the observer is the nominal plant's: it does not move
        directions = []
        for change in changes:
            dA, dB = np.zeros_like(A), np.zeros_like(B)
            dA[:loop_states, :loop_states], dB[:loop_states] = change.A, change.B
            directions.append(SystemDerivative(dA, dB, np.zeros_like(C), D))
        return StateSpace(A, B, C, D, self.excitations, self.signals, loop.dt), directions


def sampled_residual(
    plant: Plant,
    factors: CoprimeFactors,
    paths: Sequence[str],
    nominal: np.ndarray,
    whitening: np.ndarray,
) -> SampledResidual:
    """S(theta) of the sampled loop in the parameters at ``paths``; nominal (q,): their values in
    ``plant``, SI.

    factors: of ``plant`` sampled with a zero-order hold and the controller as it runs (u = K y);
    whitening (p, p).
    """
    K = factors.controller

    # the factors' K is from y, the loop's law from err = -y
    err = [f"err_{axis}" for axis in plant.axes]
    law = StateSpace(K.A, -K.B, K.C, -K.D, err, K.outputs, K.dt)
    signals = [f"{kind}_{axis}" for kind in "yu" for axis in plant.axes]
    inner = loop_model(plant, law, paths, nominal, [f"e_{axis}" for axis in plant.axes], signals)
    return SampledResidual(inner, factors, whitening)


def uncertain_residual(
    plant: Plant, factors: CoprimeFactors, paths: Sequence[str]
) -> GeneralizedPlant:
    """S with the changes of the parameters at ``paths`` pulled out: delta is the change in SI
    units, z and w as the plant's.
    """
    general = uncertain(plant, [Tolerance(path, absolute=1.0) for path in paths])
    count = general.n_w_blocks
    named = GeneralizedPlant(
        general.system,
        general.w[:count],
        factors.plant.inputs,
        general.z[: general.n_z_blocks],
        factors.plant.outputs,
        general.blocks,
    )
    return residual_lft(factors, named)


def held_residual(
    plant: Plant, factors: CoprimeFactors, paths: Sequence[str], nominal: np.ndarray, dt: float
) -> LoopModel:
    """S(theta) of the continuous loop of ``factors``, alpha held over dt [s]: a loop whose
    controller is in the plant.

    nominal (q,): the parameters' values, SI.
    """
    general = uncertain_residual(plant, factors, paths)
    system = general.system
    u, y = (
        index_of(general.u, system.inputs, "input"),
        index_of(general.y, system.outputs, "output"),
    )
    dA, dB = directions_of(general, u)
    count = general.n_w_blocks
    if (
        system.D[: general.n_z_blocks, :count].any()
        or system.D[np.ix_(y, [*range(count), *u])].any()
    ):
        raise NumericalFailure(
            "the plant has feedthrough at its ports; take one reduced without static correction"
        )

    # no controller of its own: alpha is the excitation, and LoopModel's loop is the plant held
    empty = np.zeros((0, 0))
    no_law = StateSpace(empty, empty, empty, empty, (), (), dt)
    B, C = system.B[:, u], system.C[y]
    return LoopModel(
        nominal, system.A, B, C, dA, dB, no_law, factors.alpha, factors.eps, np.ones(len(nominal))
    )
