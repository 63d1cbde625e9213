"""The sheet of every magnet with a geometry."""

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ambrose.core.checks import InvalidInput, names_wrong_types
from ambrose.core.presentation import Presented
from ambrose.machine.description import MagneticBearing, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.part import Magnet
from ambrose.model.magnetics import (
    DrivenMagnet,
    LinearityMap,
    coefficients_of,
    linearity,
    magnet_of,
)
from ambrose.report import theme
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

_HALF_ANGLE = math.pi / 8  # of the eight poles that [bearing.geometry] is read as
_PERMEABILITY = 3000.0  # of the iron that [bearing.iron] is read as; its path follows
AXES = ("zeta", "eta")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MagnetSheet(Presented):
    """One magnet at its bias current, SI.

    part: its geometry; current [A]: the bearing's bias current; bias [A]: that of the opposing pair
    of the same coefficients, which full modulation means. force_per_current, negative_stiffness
    (2,); inductance [H] that a control current sees in a coil. flux_density [T] in the gap without
    and with full modulation. capacity [N]: force along zeta at full modulation. lost_force [N] that
    acts at once when the first coil opens at the bias, lost_share: what is left of its axis' k_i.
    maps: the straightness per axis.
    """

    _FACTS: ClassVar = ("bearing", "force_per_current", "negative_stiffness", "capacity")

    bearing: str
    part: Magnet
    current: float
    bias: float
    force_per_current: tuple[float, float]
    negative_stiffness: tuple[float, float]
    inductance: float
    flux_density: tuple[float, float]
    capacity: float
    lost_force: float
    lost_share: float
    maps: tuple[LinearityMap, LinearityMap]
    driven: DrivenMagnet

    @property
    def tolerances(self) -> tuple[Tolerance, Tolerance]:
        """Tolerances that cover k_i and k_s over the maps, for the machine file."""
        rows = []
        for name in ("force_per_current", "negative_stiffness"):
            ends = [end - 1 for item in self.maps for end in getattr(item, name)]
            width = math.ceil(1e3 * max(map(abs, ends))) / 1e3
            rows.append(Tolerance(f"bearing.{self.bearing}.{name}", relative=width))
        return rows[0], rows[1]

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; of the maps what they say."""
        plain = {
            "bearing": self.bearing,
            "magnet": self.part.to_dict(defaults=True),
            "bias_current": self.bias,
            "force_per_current": list(self.force_per_current),
            "negative_stiffness": list(self.negative_stiffness),
            "inductance": self.inductance,
            "flux_density_at_bias": self.flux_density[0],
            "flux_density_at_full_modulation": self.flux_density[1],
            "force_at_full_modulation_0p": self.capacity,
            "force_when_a_coil_opens": self.lost_force,
            "force_per_current_left": self.lost_share,
        }
        for axis, item in zip(AXES, self.maps, strict=True):
            plain[f"linearity_{axis}"] = {
                "largest_error": item.worst,
                "force_per_current": list(item.force_per_current),
                "negative_stiffness": list(item.negative_stiffness),
            }
        return plain


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MagnetSheets(Presented):
    """The sheets of a machine's magnets; share: of gap and current that the maps cover."""

    _FACTS: ClassVar = ("machine=machine_name", "bearings")

    machine: Machine
    share: float
    sheets: tuple[MagnetSheet, ...]

    @property
    def machine_name(self) -> str:
        return self.machine.name

    @property
    def bearings(self) -> tuple[str, ...]:
        return tuple(sheet.bearing for sheet in self.sheets)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return {
            "machine": self.machine.name,
            "share": self.share,
            "magnets": [sheet.to_dict() for sheet in self.sheets],
            "tolerances": [item.to_dict() for sheet in self.sheets for item in sheet.tolerances],
        }


@names_wrong_types
def magnet_sheets(
    machine: Machine, bearing: str | None = None, *, share: float = 0.25
) -> MagnetSheets:
    """The sheets of the magnets with a [bearing.magnet] or [bearing.geometry].

    bearing: the one of that name alone. share: of the gap, and of the full control current, over
    which the force law is compared with its straight line. Raises InvalidInput where no magnet has
    a geometry, or the share is not between 0 and 1.
    """
    machine.across_the_shaft(
        "the sheets are those of radial magnets",
        "ambrose check of it tells those of the axis: k_i, k_s, core, capacity",
    )
    names = [item.name for item in machine.bearings]
    if bearing is not None and bearing not in names:
        raise InvalidInput(
            f"there is no bearing {bearing!r} in {machine.name}; it has {', '.join(names)}"
        )
    chosen = [item for item in machine.bearings if bearing in (None, item.name)]
    sheets = []
    for item in chosen:
        part = geometry_of(item)
        if part is not None:
            sheets.append(sheet_of(item, part, share))
    if not sheets:
        raise InvalidInput(
            f"no magnet of {machine.name} has a geometry; give [bearing.magnet] in its machine file"
        )
    return MagnetSheets(machine, share, tuple(sheets))


def geometry_of(bearing: MagneticBearing) -> Magnet | None:
    """The magnet as a network's: its [bearing.magnet], or the eight poles that its
    [bearing.geometry] means, with the iron of [bearing.iron]; None without either, or for other
    pole angles.
    """
    if bearing.magnet is not None:
        return bearing.magnet
    stated = bearing.geometry
    if stated is None or abs(stated.pole_half_angle - _HALF_ANGLE) > 1e-3:
        return None
    part = Magnet("heteropolar", stated.turns / 2, stated.pole_area, stated.gap)
    if bearing.iron is None or bearing.iron.equivalent_gap == 0:
        return part
    # the iron's equivalent gap is its path over 2 mu_r, both poles together
    return replace(
        part,
        iron_path=bearing.iron.equivalent_gap * _PERMEABILITY,
        iron_permeability=_PERMEABILITY,
        iron_flux_density=bearing.iron.flux_density,
    )


def sheet_of(bearing: MagneticBearing, part: Magnet, share: float) -> MagnetSheet:
    """The sheet of one magnet. Raises InvalidInput."""
    driven = magnet_of(part)
    current = bearing.bias_current
    k_i, k_s, bias = coefficients_of(part, current, bearing.name)
    rest = driven.at(current)
    full = driven.at(current, bias * np.array([1.0, 0.0]))
    gaps = driven.network.normals.any(axis=1)
    lost = driven.without(0)
    left = lost.coefficients(current)[0][0, 0] / k_i[0]
    maps = [linearity(driven, current, part.gap, axis, share, bias) for axis in (0, 1)]
    return MagnetSheet(
        bearing.name,
        part,
        current,
        bias,
        k_i,
        k_s,
        driven.inductance(current),
        (_largest(rest.flux_density[gaps]), _largest(full.flux_density[gaps])),
        float(full.force[0]),
        float(np.hypot(*lost.at(current).force)),
        float(left),
        (maps[0], maps[1]),
        driven,
    )


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max())


# The page of the magnets: their sheets, poles with their fluxes, and maps of the linear law.


_SHEET = (
    "From a magnetic network of the poles, their gaps, coils, iron and permanent magnets: force by "
    "Maxwell's stress, the coefficients by its derivatives. No eddy currents, no hysteresis."
)
_POLES = "Flux density in the gap of every pole at the bias current, the arrow out of the stator."
_MAP = (
    "Force of the linear law k_i i + k_s x less the magnet's, over k_i times the bias current, "
    "along one axis with the other at rest."
)
_ONE = {"row": 1, "col": 1}


def sheet_rows(sheet: MagnetSheet, share: float) -> tuple[tuple[str, str], ...]:
    """Name and value of what the sheet says."""
    within = f"within {100 * share:g} % of gap and current"
    ranges = [
        [end for item in sheet.maps for end in getattr(item, name)]
        for name in ("force_per_current", "negative_stiffness")
    ]
    return (
        ("bias current of the pair", f"{sheet.bias:.4g} A"),
        ("k_i (zeta, eta)", " / ".join(f"{v:.4g}" for v in sheet.force_per_current) + " N/A"),
        (
            "k_s (zeta, eta)",
            " / ".join(f"{v / 1e6:.4g}" for v in sheet.negative_stiffness) + " MN/m",
        ),
        ("inductance of a coil", f"{1e3 * sheet.inductance:.4g} mH"),
        ("flux density in the gap at the bias", f"{sheet.flux_density[0]:.3g} T"),
        ("at full modulation", f"{sheet.flux_density[1]:.3g} T"),
        ("force at full modulation", f"{sheet.capacity:.4g} N"),
        (f"error of the linear law {within}", f"{100 * _error(sheet):.3g} % of k_i i_0"),
        ("k_i within that range", f"{min(ranges[0]):.3g} to {max(ranges[0]):.3g} times"),
        ("k_s within that range", f"{min(ranges[1]):.3g} to {max(ranges[1]):.3g} times"),
        ("first coil open: force at once", f"{sheet.lost_force:.4g} N"),
        ("first coil open: k_i left along zeta", f"{100 * sheet.lost_share:.3g} %"),
    )


def magnets_table(result: MagnetSheets) -> Table:
    """What decides of every magnet, a row for each."""
    rows: list[Row] = []
    for sheet in result.sheets:
        ends = [
            f"{100 * max(abs(end - 1) for item in sheet.maps for end in getattr(item, name)):.3g} %"
            for name in ("force_per_current", "negative_stiffness")
        ]
        both = (sheet.force_per_current, np.divide(sheet.negative_stiffness, 1e6))
        cells = (
            *(" / ".join(dict.fromkeys(f"{value:.4g}" for value in pair)) for pair in both),
            f"{sheet.flux_density[1]:.3g}",
            f"{sheet.capacity:.4g}",
            f"{100 * _error(sheet):.3g} %",
            *ends,
            f"{100 * sheet.lost_share:.3g} %",
        )
        rows.append((sheet.bearing, *numbers(*cells)))
    columns = (
        "Magnet",
        "k_i [N/A]",
        "k_s [MN/m]",
        "Peak flux [T]",
        "Peak force [N]",
        "Error of the linear law",
        "k_i changes by",
        "k_s changes by",
        "k_i left, one coil open",
    )
    within = f"within {100 * result.share:g} % of gap and control current"
    note = (
        "Peak: full control current on top of the bias current. Error: over k_i times the bias "
        f"current, {within}, as are the changes of k_i and k_s."
    )
    return Table("", columns, tuple(rows), note)


def magnets_verdict(result: MagnetSheets) -> str:
    """How far the linear force law is off at most, and at which magnet."""
    worst = max(result.sheets, key=_error)
    return (
        f"Linear force law: off by at most {100 * _error(worst):.3g} % of k_i times the bias "
        f"current within {100 * result.share:g} % of gap and control current, at magnet "
        f"{worst.bearing}. To cover it, add the tolerances that --tolerances prints."
    )


def _error(sheet: MagnetSheet) -> float:
    return max(item.worst for item in sheet.maps)


def magnet_page(result: MagnetSheets, *, date: str = "") -> Page:
    """The page of ``MagnetSheets``; date: ISO (today if empty)."""
    sections = []
    for sheet in result.sheets:
        rows = tuple(
            (name, Cell(value, "number")) for name, value in sheet_rows(sheet, result.share)
        )
        table = Table("All values", ("Quantity", "Value"), rows, folded=True)
        pictures = (
            Figure("Poles", poles_figure(sheet), _POLES),
            Figure("Error of the linear law [%]", map_figure(sheet), _MAP),
        )
        sections.append(
            Section(f"{sheet.bearing}: {sheet.part.kind}", _SHEET, pictures, (table,), True)
        )
    return Page(
        "Magnets",
        result.machine,
        tuple(sections),
        date=date,
        signatures=(),
        result=Verdict("Result", None, magnets_verdict(result)),
        opening=Section("", tables=(magnets_table(result),)),
    )


def poles_figure(sheet: MagnetSheet) -> Any:
    """The poles around the journal, each with its flux density."""
    figure = theme.subplots(rows=1, cols=1)
    turn = np.linspace(0, 2 * np.pi, 73)
    theme.guide(figure, _ONE, np.cos(turn), np.sin(turn), color=theme.INK, width=1.5)
    network = sheet.driven.network
    density = sheet.driven.at(sheet.current).flux_density
    moving = np.flatnonzero(network.normals.any(axis=1))
    shown = moving[: sheet.part.pole_count]
    widest = max(network.area[shown])
    for branch in shown:
        n, b = network.normals[branch], density[branch]
        # width of the pole by its face, length of the arrow by its flux density
        across = np.array([-n[1], n[0]]) * 0.17 * network.area[branch] / widest
        corners = np.array([1.06 * n - across, 1.55 * n - across, 1.55 * n + across])
        corners = np.vstack([corners, 1.06 * n + across, corners[:1]])
        theme.scatter(
            figure,
            _ONE,
            corners[:, 0],
            corners[:, 1],
            fill="toself",
            fillcolor="#dfeaf3" if b > 0 else "#f8e3d4",
            line={"color": theme.INK, "width": 1},
            hoverinfo="skip",
        )
        ends = (1.5, 1.12) if b > 0 else (1.12, 1.5)
        figure.add_annotation(
            x=ends[1] * n[0],
            y=ends[1] * n[1],
            ax=ends[0] * n[0],
            ay=ends[0] * n[1],
            axref="x",
            ayref="y",
            arrowhead=2,
            arrowwidth=1.6,
            arrowcolor="#0072b2" if b > 0 else "#d55e00",
            text="",
        )
        theme.note(figure, _ONE, f"{abs(b):.2f} T", 1.82 * n[0], 1.82 * n[1], "center", "middle")
    for axis, x, y in (("zeta", 0.72, 0.0), ("eta", 0.0, 0.72)):
        theme.guide(figure, _ONE, [0, x], [0, y], color=theme.MUTED, width=1)
        theme.note(figure, _ONE, axis, x, y, "center", "bottom")
    theme.dress(figure, 330, legend=False)
    figure.update_layout(margin={"l": 4, "r": 4, "t": 10, "b": 10})
    figure.update_xaxes(visible=False, range=[-2.1, 2.1], constrain="domain")
    figure.update_yaxes(visible=False, range=[-2.1, 2.1], scaleanchor="x", constrain="domain")
    return figure


def map_figure(sheet: MagnetSheet) -> Any:
    """The linear law's error over place and control current, along zeta."""
    import plotly.graph_objects as go

    item = sheet.maps[0]
    error = -100 * item.error
    most = max(float(np.abs(error).max()), 1e-6)
    figure = theme.subplots(rows=1, cols=1)
    figure.add_trace(
        go.Contour(
            x=np.float32(1e6 * item.places),
            y=np.float32(item.currents),
            z=np.float32(error),
            zmin=-most,
            zmax=most,
            colorscale="RdBu",
            contours={"showlabels": True, "labelfont": {"size": 11}},
            line={"width": 0.5},
            colorbar={"thickness": 12, "title": {"text": "%"}},
            hovertemplate="%{x:.3g} um, %{y:.3g} A: %{z:.3g} %<extra></extra>",
        ),
        **_ONE,
    )
    theme.dress(figure, 300, legend=False)
    figure.update_xaxes(title_text="Place along ζ [µm]")
    figure.update_yaxes(title_text="Control current [A]")
    return figure
