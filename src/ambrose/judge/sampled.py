"""Verification of the sampled loop: a sampled controller with its computing delay around the plant
behind a zero-order hold.

At operating points the checks are those of ``nominal``; over the tolerances stability is examined
by eigenvalues and the sensitivity on the full plant behind its hold, at corners and samples of the
box and where a search climbs from them (loop diagram in core/lft.py).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import (
    SchurForm,
    evaluate,
    largest_gain,
    largest_gains,
    peak_near,
    schur_form,
)
from ambrose.core.lft import Ports, ports, upper_lft, upper_lft_responses
from ambrose.core.mu.all_frequencies import Chords, modal_chords
from ambrose.core.sampling import held
from ambrose.core.statespace import StateSpace, check_loop
from ambrose.core.worst_case_loop import box_points
from ambrose.judge import nominal
from ambrose.judge.checks import Check, Checks, box_label, information, judge
from ambrose.judge.loop_response import half_order_share, solid_cores
from ambrose.law.design_problem import open_model
from ambrose.law.loop import match_controller
from ambrose.machine.criteria import TWO_PI, Demand, demand
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import bending_modes_of
from ambrose.model.plant import Plant, highest_verified
from ambrose.model.uncertainty import (
    default_bending_modes,
    in_tolerances,
    perturbed,
    reduce_from,
    tolerances_around,
)

# The sampled loop at any point of its tolerances, on the full plant.
#
# Behind a zero-order hold the sampled plant repeats the continuous one at every alias,
#
#     G_T(e^{j w T}) = sum_k H(j w_k) G(j w_k),   w_k = w + 2 pi k / T,
#     H(j w_k) = (1 - e^{-j w T}) / (j w_k T),
#
# and in each term the tolerances are a linear fractional transformation of the continuous response
# at their ports,
#
#     G = M22 + M21 diag(delta) (I - M11 diag(delta))^-1 M12,
#
# whatever the number of states: no member of the box needs a matrix exponential of its own. The
# plant falls at least with 1/w^2, a term with 1/w^3; ``ALIASES`` on either side leave a relative
# error of 3e-5 at the Nyquist frequency and 1e-9 a decade below it
# (tests/judge/test_sampled_box.py).


ALIASES = 4  # on either side: see above
_SAME = 1e-3  # relative, frequencies of one peak
_FIRST_LOOK = 1  # of them, where members are only put in order
_HELD = 4000  # responses of members worked on at once, which a processor keeps near
_LOWEST = 1.0  # rad/s, of the grid
_PER_DECADE = 25  # what is not a resonance is broad
_LIGHT = 0.35  # damping ratio below which a pole has frequencies of its own
_BESIDE = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])  # half bandwidths from a light pole
_NYQUIST = 0.999  # the largest frequency, over the Nyquist frequency


class Peak(NamedTuple):
    """The largest singular value of S_o [-], the frequency [rad/s] and the point (k,) of the box
    it was found at.
    """

    value: float
    omega: float
    delta: np.ndarray

    def meets(self, other: Peak) -> bool:
        """Whether both are one peak of one point."""
        near = abs(self.omega - other.omega) <= _SAME * other.omega
        return near and np.array_equal(self.delta, other.delta)


@dataclass(frozen=True, slots=True, eq=False)
class SampledBox:
    """S_o of a sampled loop for every value of its tolerances, on the full plant.

    controller: sampled, with its delay, err_<axis> to u_<axis>; names (k,): parameters; system: of
    the full plant, from (w_delta, u) to (z_delta, y); owner (n,): the parameter that a channel of
    w_delta belongs to; ports: the channels that the others are made of; model: chords with these
    alone; law: the controller, ready to be evaluated.
    """

    controller: StateSpace
    names: tuple[str, ...]
    system: StateSpace
    owner: np.ndarray
    ports: Ports
    model: Chords
    law: SchurForm

    @property
    def nyquist(self) -> float:
        """The highest frequency [rad/s] that is examined."""
        return float(_NYQUIST * np.pi / self.sample_time)

    @property
    def sample_time(self) -> float:
        """[s]"""
        assert self.controller.dt is not None  # checked in ``sampled_box``
        return self.controller.dt

    def sensitivity(
        self, omega: np.ndarray, delta: np.ndarray, aliases: int = ALIASES
    ) -> np.ndarray:
        """S_o = (I + G_T K)^-1 (d, w, a, a) at omega (w,) [rad/s] and points delta (d, k)."""
        response = self.plant_response(omega, delta, aliases)
        law = evaluate(self.law, np.exp(1j * omega * self.sample_time))
        identity = np.eye(response.shape[-1])
        return np.asarray(np.linalg.inv(identity + response @ law))

    def plant_response(
        self, omega: np.ndarray, delta: np.ndarray, aliases: int = ALIASES
    ) -> np.ndarray:
        """G_T (d, w, a, a) [m/A] behind the hold."""
        M, hold = self._at_aliases(omega, aliases)
        gain = self.ports.gain(delta[:, self.owner])
        step = max(1, _HELD // (hold.shape[1] * len(delta)))
        parts = []
        for k in range(0, max(1, len(omega)), step):
            part = M[:, :, k : k + step]
            terms = upper_lft_responses(part.reshape(*M.shape[:2], -1), gain)
            terms = terms.reshape(*terms.shape[:3], *part.shape[2:])
            parts.append(np.einsum("dijwk,wk->dwij", terms, hold[k : k + step]))
        return np.concatenate(parts, axis=1)

    def _at_aliases(self, omega: np.ndarray, aliases: int) -> tuple[np.ndarray, np.ndarray]:
        """M (z + p, w + m, w, 2 aliases + 1) of the channels, and the hold there."""
        dt = self.sample_time
        # 1 - e^{-j w T} is the same at all aliases
        turn = 1 - np.exp(-1j * omega * dt)

        # sum_k H(j w_k) G(j w_k), all aliases at once; the hold is a scalar, so that it may stand
        # after G
        alias = omega[:, None] + 2 * np.pi / dt * np.arange(-aliases, aliases + 1)
        M = self.model.at(np.abs(alias.ravel()))
        M = np.where((alias.ravel() < 0)[:, None, None], M.conj(), M)  # M(-j w) = conj M(j w)
        M = M.transpose(1, 2, 0).reshape(*M.shape[1:], *alias.shape)
        return M, turn[:, None] / (1j * alias * dt)

    def gain_limit(self, omega: np.ndarray, aliases: int = ALIASES) -> np.ndarray:
        """What ``gains`` cannot exceed anywhere in the box, (w,), by norms alone."""
        M, hold = self._at_aliases(omega, aliases)
        z, w = self.ports.out_of.shape[1], self.ports.into.shape[0]
        M = M.transpose(2, 3, 0, 1)

        # G moves by M21 delta (I - M11 delta)^-1 M12 at every alias, |delta| <= 1
        above = self.ports.out_of @ M[:, :, :z]
        room = 1 - largest_gain(above[..., :w] @ self.ports.into)
        moved = largest_gain(M[:, :, z:, :w] @ self.ports.into) * largest_gain(above[..., w:])
        moved = (
            np.abs(hold) * np.where(room > 0, moved / np.where(room > 0, room, 1), np.inf)
        ).sum(axis=1)

        # S = S0 (I + dG K S0)^-1
        law = evaluate(self.law, np.exp(1j * omega * self.sample_time))
        nominal = np.einsum("wkij,wk->wij", M[:, :, z:, w:], hold)
        S = np.linalg.inv(np.eye(law.shape[-1]) + nominal @ law)
        left = 1 - moved * largest_gain(law @ S)
        return np.where(left > 0, largest_gain(S) / np.where(left > 0, left, 1.0), np.inf)

    def gains(self, omega: np.ndarray, delta: np.ndarray, aliases: int = ALIASES) -> np.ndarray:
        """sigma_max(S_o) (d, w) where it may be the largest of a point's; else something below."""
        return largest_gains(self.sensitivity(omega, delta, aliases))

    def closed_loop_poles(self, delta: np.ndarray, system: StateSpace | None = None) -> np.ndarray:
        """Poles (..., n) [rad/s] of the sampled loop at points (..., k), ln(z)/T; of the full plant
        unless the ``system`` of another one is given. Modes above half the rate stand at their
        aliases, where S_o of the samples has them: no damping is read of these. A delay's poles at
        z = 0 have no frequency, and stand at ln(1e-12)/T.
        """
        # every member of the stack behind its hold
        gain = delta[..., self.owner, None] * np.eye(len(self.owner))
        A, B, C, D = upper_lft(self.system if system is None else system, gain)
        A, B = held(A, B, self.sample_time)

        # u = E (Ck xk - Dk C x), E = (I + Dk D)^-1, y = C x + D u; xk+ = Ak xk - Bk y
        K = self.controller
        n = K.n_states
        check_loop(-K.D @ D)
        E = np.linalg.inv(np.eye(len(K.D)) + K.D @ D)
        u = np.concatenate([E @ K.C, -E @ K.D @ C], axis=-1)
        y = D @ u
        y[..., n:] += C
        loop = np.concatenate([-K.B @ y, B @ u], axis=-2)
        loop[..., :n, :n] += K.A
        loop[..., n:, n:] += A
        z = np.linalg.eigvals(loop).astype(complex)
        return np.asarray(np.log(np.where(np.abs(z) > 1e-12, z, 1e-12)) / self.sample_time)

    def named(self, delta: np.ndarray) -> dict[str, float]:
        """A point (k,) by its parameters' names."""
        return dict(zip(self.names, delta.tolist(), strict=True))

    def base_grid(self) -> np.ndarray:
        """Frequencies (w,) [rad/s] for what is broad."""
        decades = np.log10(self.nyquist / _LOWEST)
        return np.geomspace(_LOWEST, self.nyquist, int(_PER_DECADE * decades) + 2)

    def light(self, resonances: np.ndarray) -> np.ndarray:
        """Those of the poles (p,) [rad/s] with frequencies of their own, one of every pair, by
        frequency.
        """
        # damping ratio -Re/|s| below _LIGHT
        few = -resonances.real < _LIGHT * np.abs(resonances)
        light = resonances[(resonances.imag > 0) & few]
        return np.asarray(light[np.argsort(light.imag)])

    def beside(self, resonances: np.ndarray) -> np.ndarray:
        """Frequencies (w,) [rad/s] around the light poles among ``resonances``."""
        # half bandwidth |Re|
        light = self.light(resonances)
        around = light.imag[:, None] + np.abs(light.real)[:, None] * _BESIDE
        return np.unique(around[(around > _LOWEST) & (around < self.nyquist)])

    def peak(self, delta: np.ndarray, omega: np.ndarray) -> Peak:
        """The peak over frequency at a point (k,): the best of omega (w,), refined between its
        neighbours.
        """
        at, value = peak_near(lambda w: self.gains(w, delta[None])[0], np.unique(omega))
        return Peak(value, at, delta)

    def climb(self, start: Peak, passed: list[Peak], rounds: int = 6) -> Peak:
        """A higher peak nearby: one parameter at a time to the ends of its tolerance, or half of
        the way there, as long as that raises the peak around its frequency, and until it meets a
        path that was climbed before: ``passed`` holds the peaks on them all.
        """
        best = start
        for _ in range(rounds):
            if any(best.meets(other) for other in passed):
                break
            passed.append(best)
            # one coordinate half or all the way to either end of its tolerance
            steps = []
            for i in range(len(best.delta)):
                for end in (-1.0, 1.0):
                    for share in (0.5, 1.0):
                        step = best.delta.copy()
                        step[i] += share * (end - step[i])
                        steps.append(step)

            candidates = np.unique(np.array(steps), axis=0)

            # a resonance moves with its parameters: some per cent around it are looked at
            near = best.omega * np.linspace(0.9, 1.1, 41)
            near = near[(near > _LOWEST) & (near < self.nyquist)]
            value = self.gains(near, candidates)
            row, column = np.unravel_index(int(value.argmax()), value.shape)
            if value[row, column] <= best.value * (1 + 1e-6):
                break

            # the peak of the best one, refined between the neighbours of its frequency
            window = near[max(column - 1, 0) : column + 2]
            best = self.peak(candidates[row], window)
        return best


def sampled_box(
    plant: Plant, controller: StateSpace, tolerances: Sequence[Tolerance]
) -> SampledBox:
    """plant: full; controller: sampled, with its delay, its signals matched to the plant's.

    Raises InvalidInput for a continuous controller.
    """
    if controller.dt is None:
        raise InvalidInput(
            "the controller is continuous; give the sampled one with its delay "
            "(core.sampling.c2d, delayed)"
        )
    model = open_model(plant, tuple(tolerances), True)

    # owner: delta_k stands at ``repeat`` channels of w_delta, in the blocks' order
    blocks = model.blocks  # all real: tolerances
    owner = np.repeat(np.arange(len(blocks)), [block.repeat for block in blocks])
    names = tuple(block.name for block in blocks)

    s, n = model.system, len(owner)
    few = ports(s, n)
    chords = modal_chords(s).part(
        np.r_[few.outputs, n : len(s.outputs)], np.r_[few.inputs, n : len(s.inputs)]
    )
    K = controller
    law = schur_form(K.A, K.B, K.C, K.D, expand=True)
    return SampledBox(controller, names, s, owner, few, chords, law)


# points of the box at most at which the eigenvalues of the full plant's loop are computed, and the
# part of the outermost pole's real part by which others may be farther out unseen
_FULL_POINTS, _AS_FAR = 40, 1e-3
_STARTS = 3  # of the search inside the box, besides the nominal point
_BENDING = re.compile(r"rotor\.bending_(\d+)\.")
_MANY = 32  # members from which on it is worth a look where none can have a high gain
_INSIDE = 32  # points inside the box, beside its corners
# of a half bandwidth, by which resonances of members that share a grid may differ: the peak between
# is missed by 0.5 %, before the search goes on from the highest
_ALIKE = 0.1
Progress = Callable[[str], None]


def verify_sampled(
    plants: Sequence[Plant], controller: StateSpace, progress: Progress = lambda stage: None
) -> tuple[tuple[Checks, ...], tuple[Checks, ...]]:
    """The checks at every plant, and over the tolerances around each with a stable loop and any
    tolerance.

    plants: full. controller: sampled, with its delay. Raises InvalidInput.
    """
    checks = []
    for plant in plants:
        progress(f"verifying the sampled loop at {plant.point.label}")
        checks.append(check_sampled(plant, controller))
    boxes = []
    for plant, point in zip(plants, checks, strict=True):
        if point.stable and (tolerances := tolerances_around(plant)):
            progress(f"verifying the sampled loop over the tolerances around {plant.point.label}")
            boxes.append(
                replace(
                    check_over_box(plant, controller, tolerances),
                    label=f"{box_label(plant.point.label)}, sampled",
                )
            )
    return tuple(checks), tuple(boxes)


def check_sampled(plant: Plant, controller: StateSpace) -> Checks:
    """``nominal.check`` of a sampled controller with its delay, its signals matched to the plant's.
    Raises InvalidInput.
    """
    return nominal.check(plant, match_controller(controller, plant))


def check_over_box(
    plant: Plant,
    controller: StateSpace,
    tolerances: Sequence[Tolerance] | None = None,
    also: Sequence[Mapping[str, float]] = (),
) -> Checks:
    """Stability and the sampled output sensitivity of a loop over its tolerances, on the full plant
    as it runs.

    plant: the full one. controller: sampled, with its delay. tolerances: None: the machine's. also:
    further points, by parameter, such as the worst ones of the continuous search.

    The sensitivity is that of the full plant behind its hold (``sampled_box``) at the nominal
    point, at corners, samples and the points given; from the worst of them the search climbs
    inside the box. The frequencies are those of a net and of every member's own resonances, which a
    reduced plant tells. Stability is decided by eigenvalues, of the full plant's loop where those
    of the reduced one lie outermost, and at the worst point found. Unlike ``robust.check`` nothing
    is proved between the points.
    Raises InvalidInput.
    """
    controller = match_controller(controller, plant)
    tolerances_varied = plant.machine.tolerances if tolerances is None else tuple(tolerances)
    box = sampled_box(plant, controller, tolerances_varied)
    names = box.names

    # the nominal point, the points given, then corners and samples
    extra = np.array([[point[name] for name in names] for point in also]).reshape(-1, len(names))
    points = box_points(len(names), _INSIDE)
    points = np.vstack([points[:1], extra, points[1:]])

    # resonances of every member: a reduced plant places them closely enough for a first look
    small = reduce_from(plant, _modes(plant, names)) if plant.bending_modes is None else plant
    poles = list(box.closed_loop_poles(points, open_model(small, tolerances_varied, True).system))
    abscissa = np.array([row.real.max() for row in poles])
    full = _FullPoles(box)

    def whole(i: int) -> float:
        poles[i] = full.at(points[i : i + 1])[0]
        return float(poles[i].real.max())

    examined = of_whole(abscissa, range(1 + len(extra)), whole)
    light = [box.light(row) for row in poles]

    # the search moves on the gain alone: where it ends the poles are looked at again
    unstable = abscissa >= 0
    worst, found = _worst(full, _first_peaks(box, points, light, unstable), unstable)
    if found.size and found.max() >= 0:
        points = np.vstack([points, worst.delta])
        abscissa = np.append(abscissa, found.max())
        unstable = np.append(unstable, True)

    outermost = int(abscissa.argmax())

    def where(delta: np.ndarray) -> str:
        return in_tolerances(box.named(delta))

    example = (
        f"; for one, {where(points[outermost])} ({abscissa[outermost]:+.4g} rad/s)"
        if unstable.any()
        else ""
    )
    extent = (
        f"{len(points)} corners, samples and worst cases found; poles on the full plant at "
        f"{examined} of them{example}"
    )
    share, words = 1.0, ""
    if solid_cores(plant):
        there = perturbed(plant, box.named(worst.delta), tolerances_varied)
        share, words = half_order_share(there, controller)
    value = np.inf if unstable.any() else worst.value * share
    top, at = highest_verified(plant.machine), worst.omega
    # a peak that is no tolerance's: the rows of the points end below it
    beyond = f", beyond the {top / TWO_PI:.4g} Hz where the rows of the points end" * (at > top)
    found_at = f"{where(worst.delta)}, at {at / TWO_PI:.4g} Hz{beyond}; full plant, search{words}"
    checks: list[Check] = [
        judge(
            "sampled.stability.box",
            "Unstable points of the tolerance box, sampled loop",
            int(unstable.sum()),
            "-",
            Demand(0.0, "<=", "every tolerance"),
            extent,
        ),
        information(
            "sampled.abscissa.box",
            "Outermost pole over the box",
            float(abscissa.max()),
            "rad/s",
            where(points[outermost]),
        ),
        judge(
            "sampled.sensitivity.box",
            "Largest sampled output sensitivity found in the box",
            value,
            "-",
            demand("maximum singular value of a sensitivity", plant.machine.requirements),
            where(points[outermost]) if unstable.any() else found_at,
        ),
    ]
    return Checks("over the tolerances, sampled", not unstable[0], tuple(checks))


def _first_peaks(
    box: SampledBox, points: np.ndarray, light: Sequence[np.ndarray], unstable: np.ndarray
) -> list[Peak]:
    """The peak of every member on the grid, which all share but for what lies beside resonances;
    members whose resonances are alike share that, too.

    Where no member can have more than the nominal point they are left out, unless that would
    change which are the highest.
    """
    base, everyone = box.base_grid(), np.arange(len(points))
    alike = _alike(light)
    parts = [(base, everyone), *((box.beside(light[m[0]]), np.array(m)) for m in alike)]
    # the limit takes as long as the gains of a few members
    limits = [
        box.gain_limit(grid, _FIRST_LOOK) if len(members) > _MANY else np.full(len(grid), np.inf)
        for grid, members in parts
    ]
    least = float(box.gains(base, points[:1], _FIRST_LOOK).max())
    peaks = [Peak(-np.inf, float(base[0]), point) for point in points]

    def look(*, above: bool) -> None:
        for (grid, members), limit in zip(parts, limits, strict=True):
            part = grid[(limit >= least) == above]
            if not len(part):
                continue
            rows = box.gains(part, points[members], _FIRST_LOOK)
            for i, row in zip(members.tolist(), rows, strict=True):
                if row.max() > peaks[i].value:
                    peaks[i] = Peak(float(row.max()), float(part[row.argmax()]), points[i])

    look(above=True)
    highest = sorted(peak.value for peak, lost in zip(peaks, unstable, strict=True) if not lost)
    if len(highest) <= _STARTS or highest[-_STARTS - 1] < least:
        look(above=False)
    return peaks


class _FullPoles:
    """Poles [rad/s] of the full plant's loop at points of its tolerances, each computed once."""

    def __init__(self, box: SampledBox) -> None:
        self.box = box
        self._known: dict[bytes, np.ndarray] = {}

    def at(self, points: np.ndarray) -> list[np.ndarray]:
        """Poles (n,) at each of points (d, k)."""
        new = {point.tobytes(): point for point in points if point.tobytes() not in self._known}
        if new:
            self._known |= zip(
                new, self.box.closed_loop_poles(np.array([*new.values()])), strict=True
            )
        return [self._known[point.tobytes()] for point in points]


def of_whole(
    abscissa: np.ndarray,
    first: Sequence[int],
    whole: Callable[[int], float],
    most: int = _FULL_POINTS,
) -> int:
    """In place: the abscissa (k,) [rad/s] of loops of smaller models raised to that of the whole
    ones, ``whole``(number), of the ``first``, the largest other and wherever it may be larger yet,
    or not negative. How many were asked, ``most`` at most.

    From a smaller model to the whole one none is assumed to rise by more than those known did.
    """
    highest = rise = -np.inf
    order = dict.fromkeys([*first, *np.argsort(-abscissa, kind="stable").tolist()])
    for asked, i in enumerate(order):
        limit = min(0.0, highest) * (1 - _AS_FAR)
        if asked > len(first) and (asked >= most or abscissa[i] + rise <= limit):
            return asked
        own = whole(i)
        rise = max(rise, own - abscissa[i], 0.0)
        abscissa[i] = max(abscissa[i], own)
        highest = max(highest, float(abscissa[i]))
    return len(order)


def _alike(light: Sequence[np.ndarray]) -> list[list[int]]:
    """Members of the box in groups whose light poles lie within a small part of their half
    bandwidths of each other, where their responses peak at the same frequencies.
    """
    groups: list[list[int]] = []
    for i, own in enumerate(light):
        for members in groups:
            first = light[members[0]]
            if len(first) == len(own) and bool(
                (np.abs(own - first) <= _ALIKE * np.abs(first.real)).all()
            ):
                members.append(i)
                break
        else:
            groups.append([i])
    return groups


def _worst(
    full: _FullPoles, peaks: Sequence[Peak], unstable: np.ndarray
) -> tuple[Peak, np.ndarray]:
    """The highest peak that the search reaches from the nominal point and the worst stable ones;
    and the poles [rad/s] of the full plant's loop there, real parts, empty where none was searched.

    Every start is looked at anew around the resonances of the full plant, which lie elsewhere than
    those of a reduced one.
    """
    stable = [peak for peak, lost in zip(peaks, unstable, strict=True) if not lost]
    if not stable:
        return peaks[0], np.empty(0)
    starts = sorted(stable[1:], key=lambda peak: -peak.value)[:_STARTS]
    best: Peak | None = None
    passed: list[Peak] = []
    starts, box = [stable[0], *starts], full.box
    poles = full.at(np.array([start.delta for start in starts]))
    for start, row in zip(starts, poles, strict=True):
        grid = np.union1d(np.append(box.base_grid(), start.omega), box.beside(row))
        peak = box.climb(box.peak(start.delta, grid), passed)
        if best is None or peak.value > best.value:
            best = peak
    assert best is not None
    return best, full.at(best.delta[None])[0].real


def _modes(plant: Plant, names: Sequence[str]) -> int:
    """Bending modes per plane of the plant that tells where resonances are: those that matter, and
    every one that a tolerance names, with the next one.
    """
    named = [int(match[1]) for name in names if (match := _BENDING.match(name)) is not None]
    available = bending_modes_of(plant.rotor_model)
    return min(max([default_bending_modes(plant), *named]) + 1, available)
