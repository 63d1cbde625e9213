"""What the user writes down about a machine. Data only: no matrices, no units but SI, no files.

Positions are axial coordinates from the rotor's left end [m]. ``zeta``/``eta`` pairs are in the actuator axes, tilted by
``angle`` from the global x, y. Parts are not checked on their own: the Machine made of them is (``machine/machine.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ambrose.machine.part import Part
from ambrose.machine.seals import FREQUENCY_DEPENDENCE as FREQUENCY_DEPENDENCE  # noqa: PLC0414
from ambrose.machine.seals import SEAL_AXES as SEAL_AXES  # noqa: PLC0414
from ambrose.machine.seals import SEAL_COEFFICIENTS as SEAL_COEFFICIENTS  # noqa: PLC0414
from ambrose.machine.seals import GasSealGeometry as GasSealGeometry  # noqa: PLC0414
from ambrose.machine.seals import Seal as Seal  # noqa: PLC0414
from ambrose.machine.seals import SealTable as SealTable  # noqa: PLC0414

Pair = tuple[float, float]  # (zeta, eta)

SCHEMA_VERSION = 1  # of the machine file
BEAM_THEORIES = ("bernoulli-euler", "rayleigh", "timoshenko")
CONTROLLER_COORDINATES = ("axes", "tilt-translate")


@dataclass(frozen=True, slots=True, repr=False)
class Material(Part):
    """density [kg/m3], youngs_modulus [Pa], poisson_ratio [-]; ``name`` is that of its table in a file, and not compared."""

    density: float = 7850.0
    youngs_modulus: float = 2.1e11
    poisson_ratio: float = 0.3
    name: str = field(default="", compare=False)


@dataclass(frozen=True, slots=True, repr=False)
class ShaftSection(Part):
    """One cylindrical piece of shaft; sections follow each other from left to right without gap or overlap.

    start, length [m]; outer_diameter and inner_diameter [m] carry the stiffness; mass_diameter [m] (default: the outer
    diameter) carries the mass, so that shrunk-on laminations add inertia without stiffness. ``elements`` per section.
    """

    start: float
    length: float
    outer_diameter: float
    inner_diameter: float = 0.0
    mass_diameter: float | None = None
    elements: int = 1
    material: Material = field(default_factory=Material)
    label: str = ""


@dataclass(frozen=True, slots=True, repr=False)
class Disc(Part):
    """A rigid disc: position [m], mass [kg], polar_inertia and diametral_inertia [kg m2] about its centre."""

    name: str
    position: float
    mass: float
    polar_inertia: float = 0.0
    diametral_inertia: float = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class MagnetGeometry(Part):
    """Heteropolar magnet: one opposing pair of horseshoes per axis, differential driving.

    turns [-] per horseshoe pole; pole_area [m2]; gap [m] nominal radial; pole_half_angle [rad] between an axis and its poles
    (22.5 degrees for eight poles).
    """

    turns: float
    pole_area: float
    gap: float
    pole_half_angle: float = 0.39269908169872414


@dataclass(frozen=True, slots=True, repr=False)
class MagnetIron(Part):
    """Iron in series with the air gaps; the flux density levels off smoothly (used by the virtual rig, and with geometry).

    turns [-] of one horseshoe, both poles together; flux_density [T] in the air gap that is never passed; equivalent_gap [m]
    of the unsaturated iron, its path length/(2 mu_r), which also sets how round the knee is.
    """

    turns: float
    flux_density: float
    equivalent_gap: float


@dataclass(frozen=True, slots=True, repr=False)
class Touchdown(Part):
    """Contact in the touchdown bearing, for the virtual rig; the defaults are assumed, not measured.

    stiffness [N/m], damping [N s/m], Coulomb friction [-]; radius [m] of the contact (None: the shaft's there);
    sliding_speed [m/s] below which friction fades to zero.
    """

    stiffness: float = 1e8
    damping: float = 1e4
    friction: float = 0.2
    radius: float | None = None
    sliding_speed: float = 0.01


@dataclass(frozen=True, slots=True, repr=False)
class BiasPoint(Part):
    """Coefficients measured at one bias current [A]: force_per_current k_i [N/A], negative_stiffness k_s [N/m] > 0."""

    bias_current: float
    force_per_current: Pair
    negative_stiffness: Pair


@dataclass(frozen=True, slots=True, repr=False)
class MagneticBearing(Part):
    """A radial AMB; f = k_i i + k_s x per axis, k_s > 0 destabilising.

    position [m], angle [rad] of zeta from x, bias_current [A]. Either force_per_current [N/A] and negative_stiffness [N/m]
    are given, or ``geometry``. ``measured`` holds coefficients at other bias currents. gap and touchdown_gap [m],
    max_current [A] (control current amplitude) and max_force [N] are limits used in verification. For the virtual rig alone:
    ``iron``, ``touchdown``, cross_coupling [-] (the part of the other axis' control current that acts on an axis) and
    magnetic_offset [m] of the magnetic centre from the sensors' zero.
    """

    name: str
    position: float
    bias_current: float
    angle: float = 0.0
    force_per_current: Pair | None = None
    negative_stiffness: Pair | None = None
    geometry: MagnetGeometry | None = None
    measured: tuple[BiasPoint, ...] = ()
    gap: float | None = None
    touchdown_gap: float | None = None
    max_current: float | None = None
    max_force: float | None = None
    iron: MagnetIron | None = None
    touchdown: Touchdown | None = None
    cross_coupling: float = 0.0
    magnetic_offset: Pair = (0.0, 0.0)


@dataclass(frozen=True, slots=True, repr=False)
class Runout(Part):
    """One harmonic of a sensor track's profile: amplitude cos(order (angle - axis) + phase), amplitude [m], phase [rad]."""

    order: int
    amplitude: float
    phase: float = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class Sensor(Part):
    """A radial displacement sensor pair that serves a bearing, in that bearing's axes.

    position [m], gain [-] (1 = calibrated), bandwidth [rad/s] of a first-order lag (None: none). For the virtual rig alone:
    noise [m] rms per sample, offset [m], resolution [m] of the quantisation (0: none), runout of the sensor track.
    """

    bearing: str
    position: float
    gain: Pair = (1.0, 1.0)
    bandwidth: float | None = None
    noise: float = 0.0
    offset: Pair = (0.0, 0.0)
    resolution: float = 0.0
    runout: tuple[Runout, ...] = ()


@dataclass(frozen=True, slots=True, repr=False)
class Amplifier(Part):
    """Current amplifier and coil of every axis, unit gain at DC.

    order "first": bandwidth/(s + bandwidth); "twice-first": that times eddy_bandwidth/(s + eddy_bandwidth);
    "second": natural_frequency^2/(s^2 + damping s + natural_frequency^2), damping [rad/s]; "none": ideal. All [rad/s].
    For the virtual rig alone: max_voltage [V] and the coil's inductance [H], which limit the slope of the current.
    """

    order: str = "none"
    bandwidth: float | None = None
    eddy_bandwidth: float | None = None
    natural_frequency: float | None = None
    damping: float | None = None
    max_voltage: float | None = None
    inductance: float | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Coupling(Part):
    """A flexible coupling to ground: position [m], stiffness [N/m] and damping [N s/m] (zeta, eta), angle [rad]."""

    name: str
    position: float
    stiffness: Pair
    damping: Pair = (0.0, 0.0)
    angle: float = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class Notch(Part):
    """A notch filter: frequency [rad/s], damping of its poles and of its zeros [-]."""

    frequency: float
    pole_damping: float
    zero_damping: float


@dataclass(frozen=True, slots=True, repr=False)
class PidSettings(Part):
    """The reference controller: K_p (1 + 1/(T_i s) + T_d s/(eps T_d s + 1)) per axis, and the usual additions.

    gain K_p [A/m] per axis in the order of the machine's axes, or one for all; integral_time T_i and derivative_time T_d [s];
    derivative_filter eps [-]; notches; lead (zero, pole) [rad/s]; low_pass [rad/s] second order with low_pass_damping;
    coordinates "axes" (decentralised) or "tilt-translate", where tilt_gain [-] scales the tilting part;
    sample_time [s] and delay [s] describe the deployed controller (None: continuous).
    """

    gain: tuple[float, ...]
    integral_time: float | None = None
    derivative_time: float | None = None
    derivative_filter: float = 0.1
    notches: tuple[Notch, ...] = field(default=(), metadata={"key": "notch"})
    lead: Pair | None = None
    low_pass: float | None = None
    low_pass_damping: float = 0.7071067811865476
    coordinates: str = "axes"
    tilt_gain: float = 1.0
    sample_time: float | None = None
    delay: float = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class OperatingPoint(Part):
    """speed [rad/s]; seal_pressure [Pa], the differential pressure of every seal; bias_current [A] (None: the machine's);
    whirl_frequency [rad/s] at which frequency-dependent seals are read (None: the speed)."""

    speed: float = 0.0
    seal_pressure: float = 0.0
    bias_current: float | None = None
    whirl_frequency: float | None = None
    label: str = ""


@dataclass(frozen=True, slots=True, repr=False)
class Operation(Part):
    """The points at which the machine is verified, and its speed range [rad/s]; the first point is the nominal one.

    design_point: label of the point that controllers are designed for; empty: the nominal one.
    """

    points: tuple[OperatingPoint, ...] = field(default=(OperatingPoint(label="standstill"),), metadata={"key": "point"})
    speed_range: Pair = (0.0, 0.0)
    design_point: str = ""

    @property
    def nominal(self) -> OperatingPoint:
        return self.points[0]

    @property
    def design(self) -> OperatingPoint:
        """The point that controllers are designed for."""
        return next((point for point in self.points if point.label == self.design_point and point.label), self.nominal)


@dataclass(frozen=True, slots=True, repr=False)
class Tolerance(Part):
    """One uncertain parameter, named by its path ("seal.center.k", "bearing.A.negative_stiffness.zeta").

    relative: half-width as a fraction of the nominal value; or absolute: half-width in SI units. One of the two.
    """

    parameter: str
    relative: float | None = None
    absolute: float | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Requirements(Part):
    """What verification demands; None leaves a criterion to its standard's default, or unchecked where there is none.

    sensitivity_peak [-]; compliance_peak [m/N]; balance_grade [m/s] (G2.5 = 2.5e-3); balance_speed [rad/s] at which the
    residual unbalance is set; unbalance_orbit [m] zero-to-peak up to unbalance_to [rad/s]; settling_time [s];
    gain_margin [-], phase_margin [rad]; log_decrement [-]; max_current [A].
    """

    sensitivity_peak: float | None = None
    compliance_peak: float | None = None
    balance_grade: float | None = None
    balance_speed: float | None = None
    unbalance_orbit: float | None = None
    unbalance_to: float | None = None
    settling_time: float | None = None
    gain_margin: float | None = None
    phase_margin: float | None = None
    log_decrement: float | None = None
    max_current: float | None = None


@dataclass(frozen=True, slots=True, repr=False)
class DesignWeights(Part):
    """What a robust design aims at, in words (``synthesis/weights.py`` makes transfer functions of it).

    error_scale D_e [m]: the largest acceptable error; current_scale D_u [A]: the largest control current. bandwidth w_B
    [rad/s], peak M [-] and low_frequency_error A_w [-] of the sensitivity. control_level [-]: weight of the current; with a
    control_crossover [rad/s] it rises from there through 1 at the crossover to control_limit [-] (None: 30), with
    control_order. current_disturbance, output_disturbance [-]: sizes of the disturbances in units of D_u and D_e.
    """

    error_scale: float
    current_scale: float
    bandwidth: float
    control_level: float
    peak: float = 3.0
    low_frequency_error: float = 1e-3
    control_crossover: float | None = None
    control_order: int = 1
    control_limit: float | None = None
    current_disturbance: float = 1.0
    output_disturbance: float = 1.0


@dataclass(frozen=True, slots=True, repr=False)
class MachineDescription(Part):
    """A rotor on magnetic bearings as written down, not yet checked; a Machine is one that was.

    modal_damping [-] is the damping ratio given to every bending mode; beam_theory "bernoulli-euler", "rayleigh" or
    "timoshenko"; gravity_direction [rad] from x towards y (-pi/2: down along y; None: no weight), for the virtual rig;
    ``assumed`` lists the parameters that were chosen, not measured or published, each with its reason. file_text is the file
    that the machine was read from (empty: none), for its comments, order and units; it is not compared.
    """

    name: str
    shaft: tuple[ShaftSection, ...]
    bearings: tuple[MagneticBearing, ...]
    sensors: tuple[Sensor, ...]
    amplifier: Amplifier = field(default_factory=Amplifier)
    discs: tuple[Disc, ...] = ()
    seals: tuple[Seal, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    controller: PidSettings | None = None
    operation: Operation = field(default_factory=Operation)
    tolerances: tuple[Tolerance, ...] = ()
    requirements: Requirements = field(default_factory=Requirements)
    weights: DesignWeights | None = None
    description: str = ""
    source: str = ""
    modal_damping: float = 0.005
    beam_theory: str = "bernoulli-euler"
    gravity_direction: float | None = None
    assumed: tuple[tuple[str, str], ...] = ()
    file_text: str = field(default="", compare=False)

    @property
    def length(self) -> float:
        """Rotor length [m]."""
        return self.shaft[-1].start + self.shaft[-1].length

    @property
    def axes(self) -> tuple[str, ...]:
        """The control axes in their fixed order: A_zeta, A_eta, B_zeta, B_eta."""
        return tuple(f"{bearing.name}_{axis}" for bearing in self.bearings for axis in ("zeta", "eta"))
