"""Every kind of slip in a machine file gives one clear message: the table, the key, and the value
or the remedy.
"""

import re
from pathlib import Path

import pytest

from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.machine.file.toml import bundled_machines, load_machine, loads_machine
from ambrose.machine.file.update import save_machine

SMALL = Path(__file__).with_name("small.toml").read_text()

# name: (what stands in small.toml, what the slip makes of it, what the message must contain)
SLIPS = {
    # keys and tables
    "missing key": (
        'length = "200 mm"\n',
        "",
        '[[shaft]] 1 "left end"',
        "length is missing",
        "a length [m]",
        '"0.5 mm"',
    ),
    "missing name": ('name = "wheel"\n', "", "[[disc]] 1", "name is missing", "a name in quotes"),
    "missing pair": (
        "stiffness = [0.40e6, 0.42e6]\n",
        "",
        "[[coupling]] coupling",
        "stiffness is missing",
        "[zeta, eta]",
    ),
    "missing key in a nested table": (
        "turns = 36\n",
        "",
        "[[bearing]] B, [bearing.geometry]",
        "turns is missing",
    ),
    "missing schema": ("schema = 1\n", "", "[machine]", "schema is missing", "give 1"),
    "missing table": (
        '[amplifier]\norder = "twice-first"\nbandwidth = "1.5 kHz"\neddy_bandwidth = "3 kHz"\n',
        "",
        "[amplifier] is missing",
        "order",
    ),
    "unknown key": (
        "outer_diameter = ",
        "outer_diamter = ",
        "[[shaft]] 1",
        '"outer_diamter"',
        'did you mean "outer_diameter"?',
    ),
    "unknown key in a nested entry": (
        "pole_damping = ",
        "damping = ",
        "[[controller.notch]] 1",
        '"damping"',
        "did you mean",
    ),
    "unknown key without likeness": (
        "\n[controller]\n",
        "\n[controller]\nzzz = 1\n",
        "[controller]",
        'unknown key "zzz"',
        "known: channel, coordinates, delay",
    ),
    "key in other case": (
        "speed_range",
        "Speed_Range",
        "[operation]",
        '"Speed_Range"',
        'did you mean "speed_range"?',
    ),
    "unknown table": (
        "[requirements]",
        "[requirments]",
        "[requirments]",
        "unknown table",
        'did you mean "requirements"?',
    ),
    "newer schema": (
        "schema = 1",
        "schema = 2",
        "[machine]",
        "schema is 2",
        "must be 1",
        "update ambrose",
    ),
    "schema is not a number": (
        "schema = 1",
        "schema = true",
        "[machine]",
        "schema is true",
        "must be 1",
    ),
    # units and forms of value
    "wrong dimension": (
        'length = "200 mm"',
        'length = "5 kg"',
        "[[shaft]] 1",
        'length is "5 kg"',
        "a length [m]",
        '"0.5 mm"',
    ),
    "angle for a length": (
        'position = "150 mm"',
        'position = "45 deg"',
        "[[bearing]] A",
        'position is "45 deg"',
        "length [m]",
    ),
    "length for a speed": (
        'speed = "6000 rpm"',
        'speed = "6 m"',
        '[[operation.point]] 1 "nominal"',
        'speed is "6 m"',
        '"31500 rpm"',
    ),
    "percent for an angle": (
        'phase_margin = "30 deg"',
        'phase_margin = "30 %"',
        "[requirements]",
        'phase_margin is "30 %"',
        "angle [rad]",
    ),
    "angle for a ratio": (
        'relative = "20 %"',
        'relative = "20 deg"',
        "[[tolerance]] 2",
        'relative is "20 deg"',
        "a ratio",
    ),
    "unit for a plain number": (
        "turns = 36",
        'turns = "36 m"',
        "[bearing.geometry]",
        'turns is "36 m"',
        "without quotes",
    ),
    "unknown unit": (
        'gap = "0.5 mm"',
        'gap = "0.5 mmm"',
        "[[bearing]] A",
        'gap is "0.5 mmm"',
        "unit is unknown",
        '"mm"',
    ),
    "unit in other case": (
        'speed = "6000 rpm"',
        'speed = "6000 RPM"',
        "[[operation.point]] 1",
        "unit is unknown",
        'did you mean "rpm"?',
    ),
    "string without unit": (
        'mass = "3 kg"',
        'mass = "3"',
        "[[disc]] wheel",
        'mass is "3"',
        "without a unit",
        "number in kg",
    ),
    "empty string": (
        'mass = "3 kg"',
        'mass = ""',
        "[[disc]] wheel",
        'mass is ""',
        "a mass [kg]",
        '"1.2 kg"',
    ),
    "arithmetic in a unit": (
        'mass = "3 kg"',
        'mass = "3 kg**9**9**9"',
        "[[disc]] wheel",
        "unit cannot be read",
    ),
    "two numbers": (
        'mass = "3 kg"',
        'mass = "3 kg 4"',
        "[[disc]] wheel",
        'mass is "3 kg 4"',
        "unit cannot be read",
    ),
    "comma as decimal point": (
        'mass = "3 kg"',
        'mass = "3,5 kg"',
        "[[disc]] wheel",
        'mass is "3,5 kg"',
        'decimal mark is a comma; write "3.5 kg"',
    ),
    "wrong unit in a list": (
        '["150 N/A", 160]',
        '["150 N/A", "160 N"]',
        "[[bearing]] A",
        "force_per_current (element 2)",
        '"160 N"',
        "[N/A]",
    ),
    "wrong unit in a nested list": (
        '["1 N/um", 1.1e6]',
        '["1 kg", 1.1e6]',
        "[seal.table]",
        "k (element 2) (element 1)",
        '"1 kg"',
    ),
    "absolute in another unit": (
        'absolute = "0.1 N/um"',
        'absolute = "0.1 kg"',
        "[[tolerance]] 1 seal.center.K",
        'absolute is "0.1 kg"',
        "stiffness [N/m]",
    ),
    "NaN": ("length = 0.4", "length = nan", "[[shaft]] 2", "length is nan", "must be finite"),
    "infinity": ("length = 0.4", "length = inf", "[[shaft]] 2", "length is inf", "must be finite"),
    "number too large": (
        'mass = "3 kg"',
        'mass = "3e999 kg"',
        "[[disc]] wheel",
        "mass is",
        "must be finite",
    ),
    "integer too large": (
        "length = 0.4",
        f"length = {10**400}",
        "[[shaft]] 2",
        "length is 1000",
        "must be finite",
    ),
    "NaN in a list": (
        "[0.40e6, 0.42e6]",
        "[0.40e6, nan]",
        "[[coupling]] coupling",
        "stiffness (element 2) is nan",
    ),
    "boolean for a number": (
        "length = 0.4",
        "length = true",
        "[[shaft]] 2",
        "length is true",
        "a length [m]",
    ),
    "date for a number": (
        "length = 0.4",
        "length = 2026-01-31",
        "[[shaft]] 2",
        "length is",
        "a length [m]",
    ),
    "table for a number": (
        "length = 0.4",
        "length = {mm = 400}",
        "[[shaft]] 2",
        "length is a table",
        "a length [m]",
    ),
    "list for a number": (
        "length = 0.4",
        "length = [0.4]",
        "[[shaft]] 2",
        "length is [0.4]",
        "a length [m]",
    ),
    "number for a name": (
        'name = "wheel"',
        "name = 7",
        "[[disc]] 1",
        "name is 7",
        "must be a string",
    ),
    "fraction of an element": (
        "elements = 4",
        "elements = 4.5",
        "[[shaft]] 1",
        "elements is 4.5",
        "whole number",
    ),
    "string for a count": (
        "elements = 4",
        'elements = "4"',
        "[[shaft]] 1",
        'elements is "4"',
        "whole number",
    ),
    "reason is no text": (
        'bearing.A.gap = "made up"',
        "bearing.A.gap = 3",
        "[machine.assumed]",
        "bearing.A.gap is 3",
        "reason in quotes",
    ),
    "table in single brackets": (
        "[[disc]]",
        "[disc]",
        "disc is a table",
        "must be [[disc]]",
        "write its keys below",
    ),
    "table in double brackets": (
        "[amplifier]",
        "[[amplifier]]",
        "amplifier is an array",
        "must be [amplifier]",
    ),
    "list too long": (
        '["150 N/A", 160]',
        "[150, 160, 170]",
        "[[bearing]] A",
        "force_per_current is [150, 160, 170]",
        "two elements",
    ),
    "list too short": (
        "[0.40e6, 0.42e6]",
        "[0.40e6]",
        "[[coupling]] coupling",
        "a list of 1",
        "[zeta, eta]",
    ),
    "scalar for a range": (
        'speed_range = [0, "12000 rpm"]',
        "speed_range = 100",
        "[operation]",
        "speed_range is 100",
        "lowest, highest",
    ),
    "empty list": (
        'gain = "18 A/mm"',
        "gain = []",
        "[controller]",
        "gain is an empty list",
        "at least one element",
    ),
    "list too deep": (
        "k = [[0, 0], [",
        "k = [[[[1]]], [",
        "[seal.table]",
        "k (element 1)",
        "deeper than three",
    ),
    # choices and references
    "unknown beam theory": (
        '"timoshenko"',
        '"timoschenko"',
        "[machine]",
        'beam_theory is "timoschenko"',
        'did you mean "timoshenko"?',
    ),
    "unknown amplifier": (
        '"twice-first"',
        '"third"',
        "[amplifier]",
        'order is "third"',
        '"first"',
        "choose one",
    ),
    "unknown coordinates": (
        '"tilt-translate"',
        '"modal"',
        "[controller]",
        'coordinates is "modal"',
        '"tilt-translate"',
    ),
    "unknown coefficient": (
        'scales_with_pressure = ["C"]',
        'scales_with_pressure = ["Q"]',
        "[[seal]] center",
        'is "Q"',
        '"K"',
    ),
    "unknown material": (
        'material = "titanium"',
        'material = "titanum"',
        "[[shaft]] 2",
        '"titanum" is unknown',
        'did you mean "titanium"?',
    ),
    "material without table": (
        '[material.titanium]\ndensity = "4.43 g/cm^3"\nyoungs_modulus = "114 GPa"\npoisson_ratio '
        "= 0.34\n",
        "",
        "[[shaft]] 2",
        '"titanium"',
        "add [material.titanium]",
    ),
    "unknown bearing of a sensor": (
        'bearing = "A"',
        'bearing = "C"',
        "[[sensor]] C",
        '"C" is unknown',
        "known: A, B",
        "[[bearing]] A: no [[sensor]]",
    ),
    "no sensor for a bearing": (
        'bearing = "B"',
        'bearing = "A"',
        "[[bearing]] B",
        "no [[sensor]] serves it",
        "add one with bearing",
    ),
    "sensor angle in no unit of angles": (
        'angle = "35 deg"',
        'angle = "left"',
        "[[sensor]] A",
        'angle is "left"',
    ),
    "weights of zero": (
        "weight = 2",
        "weight = 0",
        "[[sensor]] A",
        "weight is 0",
        "leave it out for equal shares",
    ),
    "support of an unknown bearing": (
        'bearing = "A"\nmass',
        'bearing = "C"\nmass',
        "[[support]] C",
        '"C" is unknown',
        "known: A, B",
    ),
    "support without mass": (
        'mass = "300 kg"',
        "mass = 0",
        "[[support]] A",
        "mass is 0 kg",
        "must be positive",
    ),
    # the shaft
    "empty shaft": (
        re.compile(r"\[\[shaft\]\]\nlabel.*?(?=\n\[\[disc)", re.DOTALL),
        "",
        "[[shaft]] is missing",
        "length, outer_diameter",
    ),
    "negative length": (
        "length = 0.4",
        "length = -0.4",
        "[[shaft]] 2",
        "length is -0.4 m",
        "must be positive",
    ),
    "zero elements": (
        "elements = 4",
        "elements = 0",
        "[[shaft]] 1",
        "elements is 0",
        "from 1 to 800",
    ),
    "far too many elements": (
        "elements = 4",
        "elements = 100000",
        "the shaft has 100008 elements in all",
        "at most 800",
    ),
    "bore as wide as the shaft": (
        'inner_diameter = "20 mm"',
        'inner_diameter = "60 mm"',
        "[[shaft]] 1",
        "inner_diameter is 0.06 m",
        "below the outer_diameter, 0.06 m",
    ),
    "negative bore": (
        'inner_diameter = "20 mm"',
        'inner_diameter = "-2 mm"',
        "[[shaft]] 1",
        "inner_diameter is -0.002 m",
        "zero or positive",
    ),
    "mass inside the bore": (
        'inner_diameter = "20 mm"',
        'inner_diameter = "20 mm"\nmass_diameter = "15 mm"',
        "[[shaft]] 1",
        "mass_diameter is 0.015 m",
        "above the inner_diameter",
    ),
    "gap": (
        "length = 0.4",
        'length = 0.4\nstart = "210 mm"',
        "[[shaft]] 2",
        "start is 0.21 m",
        "a gap after",
        "ends at 0.2 m",
    ),
    "overlap": (
        "length = 0.4",
        'length = 0.4\nstart = "190 mm"',
        "[[shaft]] 2",
        "start is 0.19 m",
        "an overlap with",
        "ends at 0.2 m",
    ),
    "rotor starts elsewhere": (
        'label = "left end"',
        'label = "left end"\nstart = "1 mm"',
        "[[shaft]] 1",
        "start is 0.001 m",
        "left end",
    ),
    "negative density": (
        'density = "4.43 g/cm^3"',
        "density = -4430",
        "material titanium",
        "density is -4430 kg/m^3",
        "positive",
    ),
    "incompressible": (
        "poisson_ratio = 0.34",
        "poisson_ratio = 0.5",
        "material titanium",
        "poisson_ratio is 0.5",
        "steel has 0.3",
    ),
    # what sits on the shaft
    "bearing off the shaft": (
        'position = "500 mm"',
        'position = "950 mm"',
        "[[bearing]] B",
        "position is 0.95 m",
        "0 to 0.6 m",
    ),
    "sensor off the shaft": (
        'position = "530 mm"',
        'position = "-1 mm"',
        "[[sensor]] B",
        "position is -0.001 m",
        "0 to 0.6 m",
    ),
    "seal off the shaft": (
        'position = "300 mm"',
        'position = "3 m"',
        "[[seal]] center",
        "position is 3 m",
        "0 to 0.6 m",
    ),
    "disc off the shaft": (
        'position = "20 mm"',
        'position = "20 m"',
        "[[disc]] wheel",
        "position is 20 m",
        "0 to 0.6 m",
    ),
    "coupling off the shaft": (
        "position = 0\n",
        "position = 0.7\n",
        "[[coupling]] coupling",
        "position is 0.7 m",
        "0 to 0.6 m",
    ),
    "negative mass": (
        'mass = "3 kg"',
        'mass = "-3 kg"',
        "[[disc]] wheel",
        "mass is -3 kg",
        "positive",
    ),
    "impossible inertia": (
        '"0.011 kg m^2"',
        '"0.009 kg m^2"',
        "[[disc]] wheel",
        "polar_inertia is 0.02 kg m^2",
        "at most twice",
    ),
    "name taken": (
        'name = "center"',
        'name = "wheel"',
        "[[seal]] wheel",
        'name "wheel" is taken by a [[disc]]',
        "own name",
    ),
    "name with a blank that begins with a digit": (
        'name = "center"',
        'name = "2nd seal"',
        "[[seal]]",
        'name is "2nd seal"',
        'write "seal-2nd-seal"',
    ),
    "name with a dot": (
        'name = "center"',
        'name = "cen.ter"',
        "[[seal]]",
        'name is "cen.ter"',
        'write "cen-ter"',
    ),
    "no bias": (
        'position = "500 mm"\nbias_current = "4 A"',
        'position = "500 mm"\nbias_current = 0',
        "[[bearing]] B",
        "bias_current is 0 A",
        "positive",
    ),
    "one coefficient without the other": (
        'negative_stiffness = "1.2 N/um"\n',
        "",
        "[[bearing]] A",
        "negative_stiffness is missing",
        "both",
    ),
    "no coefficients": (
        '[bearing.geometry]\nturns = 36\npole_area = "480 mm^2"\ngap = "0.5 mm"\npole_half_angle '
        '= "22.5 deg"\n',
        "",
        "[[bearing]] B",
        "no coefficients",
        "[bearing.geometry]",
    ),
    "stiffness with the wrong sign": (
        '"1.2 N/um"',
        '"-1.2 N/um"',
        "[[bearing]] A",
        "negative_stiffness is -1.2e+06 N/m",
        "[[coupling]]",
    ),
    "negative force per current": (
        '["150 N/A", 160]',
        "[150, -160]",
        "[[bearing]] A",
        "force_per_current (eta) is -160 N/A",
        "positive",
    ),
    "measured twice": (
        "[[bearing.measured]]\n",
        "[[bearing.measured]]\nbias_current = 6\nforce_per_current = 1\nnegative_stiffness = "
        "1\n[[bearing.measured]]\n",
        "[[bearing]] A, [[bearing.measured]] 2",
        "bias_current 6 A is listed twice",
    ),
    "touchdown outside the gap": (
        '"250 um"',
        '"600 um"',
        "[[bearing]] A",
        "touchdown_gap is 0.0006 m",
        "at most the magnet's gap",
    ),
    "poles at a right angle": (
        '"22.5 deg"',
        '"90 deg"',
        "[bearing.geometry]",
        "pole_half_angle is 90 deg",
        "below 90 deg",
    ),
    "dead sensor": (
        'gain = [1.0, "98 %"]',
        "gain = [1.0, 0]",
        "[[sensor]] A",
        "gain (eta) is 0",
        "different from zero",
    ),
    "amplifier lacks a parameter": (
        'eddy_bandwidth = "3 kHz"\n',
        "",
        "[amplifier]",
        "eddy_bandwidth is missing",
        '"twice-first" needs it',
    ),
    "amplifier without order": (
        'order = "twice-first"\n',
        "",
        "[amplifier]",
        "order is missing",
        '"none", "first", "twice-first", "second"',
    ),
    "amplifier has one too many": (
        'order = "twice-first"',
        'order = "first"',
        "[amplifier]",
        "eddy_bandwidth is 18849.6 rad/s",
        '"first" does not use it',
        "remove it",
    ),
    "negative coupling": (
        'damping = "10 N s/m"',
        'damping = "-10 N s/m"',
        "[[coupling]] coupling",
        "damping is -10 N s/m",
        "holds back",
    ),
    # seals
    "no reference pressure": (
        'reference_pressure = "2 bar"\n',
        "",
        "[[seal]] center",
        "reference_pressure is missing",
        "2.04 bar",
    ),
    "table not ascending": (
        '["0 bar", "1 bar", "2 bar"]',
        '["0 bar", "2 bar", "1 bar"]',
        "[[seal]] center, [seal.table]",
        "pressure is [0.0, 200000.0, 100000.0]",
        "ascending",
    ),
    "table of the wrong size": (
        '[0, "200 Hz"]',
        '[0, "100 Hz", "200 Hz"]',
        "[seal.table]",
        "the size of k is 3 x 2",
        "3 x 3 (pressure x frequency)",
    ),
    "ragged table": (
        "k = [[0, 0], ",
        "k = [[0], ",
        "[seal.table]",
        "k is ragged",
        "pressure, frequency",
    ),
    "table without axes": (
        'pressure = ["0 bar", "1 bar", "2 bar"]\nfrequency = [0, "200 Hz"]\n',
        "",
        "[seal.table]",
        "axes are missing",
        "pressure, speed",
    ),
    "table without coefficient": (
        'k = [[0, 0], ["1 N/um", 1.1e6], [2e6, 2.2e6]]\n',
        "",
        "[seal.table]",
        "no coefficient",
        "K, k, C, c, M",
    ),
    "constant and table": (
        'K = "0.4 N/um"',
        'K = "0.4 N/um"\nk = 5',
        "[[seal]] center, [seal.table]",
        "k is 5 in [[seal]] center",
        "keep the constant or the table",
    ),
    "scaled twice": (
        'scales_with_pressure = ["C"]',
        'scales_with_pressure = ["C", "k"]',
        "[seal.table]",
        "k is given over pressure",
        "keep one",
    ),
    # controller, operation, tolerances, requirements
    "gains for three axes": (
        'gain = "18 A/mm"',
        "gain = [1, 2, 3]",
        "[controller]",
        "gain is a list of 3",
        "one value beside [[controller.channel]]",
    ),
    "negative gain": (
        'gain = "18 A/mm"',
        "gain = -18e3",
        "[controller]",
        "gain (element 1) is -18000 A/m",
        "positive",
    ),
    "no filter": (
        "derivative_filter = 0.1",
        "derivative_filter = 0",
        "[controller]",
        "derivative_filter is 0",
        "positive",
    ),
    "notch without poles": (
        "pole_damping = 0.5",
        "pole_damping = 0",
        "[[controller.notch]] 1",
        "pole_damping is 0",
        "positive",
    ),
    "controller that sees ahead": (
        'delay = "100 us"',
        'delay = "-100 us"',
        "[controller]",
        "delay is -0.0001 s",
        "ahead",
    ),
    "pressure rate of zero": (
        'pressure_rate = "20 bar/s"',
        "pressure_rate = 0",
        "[operation]",
        "pressure_rate",
        "leave it out",
    ),
    "design point that is none": (
        'design_point = "nominal"',
        'design_point = "nominl"',
        "[operation]",
        'design_point is "nominl"',
        "no point's label",
    ),
    "speed range upside down": (
        '[0, "12000 rpm"]',
        '["12000 rpm", 0]',
        "[operation]",
        "speed_range is [1256.64, 0] rad/s",
        "[lowest, highest]",
    ),
    "negative pressure": (
        'seal_pressure = "2 bar"',
        'seal_pressure = "-2 bar"',
        '[[operation.point]] 1 "nominal"',
        "seal_pressure is -200000 Pa",
        "difference",
    ),
    "label taken": (
        'label = "standstill"',
        'label = "nominal"',
        "[[operation.point]] 2",
        'label "nominal" is taken',
        "own label",
    ),
    "tolerance of an unknown table": (
        '"seal.center.K"',
        '"sael.center.K"',
        "[[tolerance]] 1",
        '"sael.center.K"',
        'did you mean "seal"?',
    ),
    "tolerance of an unknown seal": (
        '"seal.center.K"',
        '"seal.centre.K"',
        "[[tolerance]] 1",
        'unknown seal "centre"',
        'did you mean "center"?',
    ),
    "tolerance of an unknown quantity": (
        '"seal.center.K"',
        '"seal.center.Q"',
        "[[tolerance]] 1",
        'unknown quantity "Q"',
        "K, k, C, c, M",
    ),
    "tolerance of an impossible entry": (
        '"seal.center.K"',
        '"seal.center.K_xy"',
        "[[tolerance]] 1",
        '"seal.center.K_xy"',
        "K_xx",
    ),
    "incomplete tolerance": (
        '"seal.center.K"',
        '"seal.center"',
        "[[tolerance]] 1",
        '"seal.center" is incomplete',
        "seal.<name>.",
    ),
    "tolerance of an unused parameter": (
        '"bearing.A.negative_stiffness.zeta"',
        '"amplifier.damping"',
        "[[tolerance]] 2",
        "names nothing",
        '"twice-first"',
    ),
    "tolerance of the added mass": (
        '"bearing.A.negative_stiffness.zeta"',
        '"seal.center.M"',
        "[[tolerance]] 2",
        '"seal.center.M" cannot be uncertain',
        "acceleration",
        'give "seal.center.K" or "seal.center.C" a tolerance',
    ),
    "tolerance without width": (
        'relative = "20 %"\n',
        "",
        "[[tolerance]] 2 bearing.A.negative_stiffness.zeta",
        "neither relative nor absolute",
    ),
    "tolerance with two widths": (
        'relative = "20 %"',
        'relative = "20 %"\nabsolute = 5',
        "[[tolerance]] 2",
        "both relative and absolute",
    ),
    "tolerance without extent": (
        'relative = "20 %"',
        "relative = 0",
        "[[tolerance]] 2",
        "relative is 0",
        "positive",
    ),
    "tolerance twice": (
        '"seal.center.K"',
        '"bearing.A.negative_stiffness"',
        "[[tolerance]]",
        '"bearing.A.negative_stiffness" and',
        "same number",
    ),
    "requirement below zero": (
        '"8 um"',
        '"-8 um"',
        "[requirements]",
        "unbalance_orbit is -8e-06",
        "leave it out",
    ),
    "margin in decibels": (
        "gain_margin = 2",
        "gain_margin = 0.5",
        "[requirements]",
        "gain_margin is 0.5",
        "not decibels",
    ),
    "margin of degrees as radians": (
        'phase_margin = "30 deg"',
        "phase_margin = 30",
        "[requirements]",
        "phase_margin is 30 rad",
        '"30 deg"',
    ),
    "damping above critical": (
        'modal_damping = "1 %"',
        "modal_damping = 1",
        "[machine]",
        "modal_damping is 1",
        "0.005 is usual",
    ),
    "weight in decibels": ("peak = 2.5", "peak = 0.5", "[weights]", "peak is 0.5", "not decibels"),
    "weight without its size": (
        'error_scale = "20 um"\n',
        "",
        "[weights]",
        "error_scale is missing",
        "a length [m]",
    ),
}


@pytest.mark.parametrize(
    "old, new, wanted", [(s[0], s[1], s[2:]) for s in SLIPS.values()], ids=list(SLIPS)
)
def test_slip(old, new, wanted):
    text, count = (
        old.subn(new, SMALL)
        if isinstance(old, re.Pattern)
        else (SMALL.replace(old, new, 1), SMALL.count(old))
    )
    assert count, f"small.toml no longer contains {old}"
    with pytest.raises(InvalidInput) as caught:
        loads_machine(text, "small.toml")
    message = str(caught.value)
    assert message.startswith("small.toml")
    for fragment in wanted:
        assert fragment in message
    assert ";" in message  # the remedy follows
    assert len(message) < 700


BROKEN = {
    "empty": ("", "is empty", "[machine]"),
    "blank": (" \n\t\n", "is empty", "[[shaft]]"),
    "comment only": ("# nothing yet\n", "table [machine] is missing", "[[bearing]]", "[[sensor]]"),
    "no TOML": ("this is not a machine\n", "not valid TOML", "line 1"),
    "unclosed string": (SMALL.replace('"small"', '"small'), "not valid TOML", "line 5"),
    "unclosed bracket": (SMALL.replace("[[disc]]", "[[disc]"), "not valid TOML", "line 38"),
    "key twice": (
        SMALL.replace("elements = 4", "elements = 4\nelements = 5"),
        "not valid TOML",
        "line 31",
    ),
    "table twice": (SMALL + "\n[amplifier]\n", "not valid TOML", "amplifier"),
    "nested without end": ("a = " + "[" * 100_000, "nested too deeply"),
    "number without end": ("a = " + "1" * 5000, "not valid TOML"),
    "wrong kind everywhere": (
        "machine = 1\nshaft = 2\nbearing = {}\nsensor = [3]\namplifier = []\n",
        "machine is 1",
        "[[shaft]]",
        "sensor is 3",
        "must be [amplifier]",
    ),
}


@pytest.mark.parametrize("text, wanted", [(b[0], b[1:]) for b in BROKEN.values()], ids=list(BROKEN))
def test_broken_text(text, wanted):
    with pytest.raises(InvalidInput) as caught:
        loads_machine(text, "broken.toml")
    assert str(caught.value).startswith("broken.toml")
    for fragment in wanted:
        assert fragment in str(caught.value)


def test_a_file_cut_off_anywhere_is_refused_or_still_whole():
    """Only cuts that leave a machine (behind the last table that it cannot do without) may pass."""
    needed = SMALL.index('bandwidth = "1.5 kHz"')
    for end in range(0, needed, 7):
        with pytest.raises(InvalidInput):
            loads_machine(SMALL[:end])
    for end in range(needed, len(SMALL), 7):
        try:
            assert loads_machine(SMALL[:end]).name == "small"
        except AmbroseError as error:
            assert "machine file" in str(error)


def test_all_problems_are_in_one_message():
    text = (
        SMALL.replace('"3 kg"', '"3 m"')
        .replace('"200 mm"', '"x"')
        .replace('order = "', 'ordr = "')
        .replace("tilt_gain", "tiltgain")
    )
    with pytest.raises(InvalidInput) as caught:
        loads_machine(text)
    lines = str(caught.value).splitlines()
    assert lines[0] == "machine file has 5 problems:"  # "ordr" is unknown, and order is missing
    assert all(line.startswith("  - [") for line in lines[1:])
    assert [
        key
        for key in ("length", "mass", "tiltgain", "ordr", "order is missing")
        if key not in str(caught.value)
    ] == []


def test_all_physical_problems_are_in_one_message():
    text = SMALL.replace('"3 kg"', '"-3 kg"').replace("length = 0.4", "length = 0.01")
    with pytest.raises(InvalidInput) as caught:
        loads_machine(text)
    message = str(caught.value)
    lines = message.splitlines()
    assert lines[0] == f"machine file has {len(lines) - 1} problems:"
    assert all(line.startswith("  - [[") for line in lines[1:])
    assert "mass is -3 kg" in message
    assert "[[bearing]] B: position is 0.5 m" in message
    assert "[[seal]] center: position is 0.3 m" in message


class TestFiles:
    def test_missing_file(self, tmp_path):
        with pytest.raises(
            InvalidInput,
            match=r"neither a file nor a bundled machine; bundled machines: .*seal-rig",
        ):
            load_machine(tmp_path / "none.toml")

    def test_misspelt_bundled_machine(self):
        with pytest.raises(InvalidInput, match=r'"seal_rig" is neither .* did you mean "seal-rig"'):
            load_machine("seal_rig")

    def test_a_file_named_without_its_ending(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "seal_rig.toml").write_text("")
        with pytest.raises(InvalidInput, match=r'did you mean "seal_rig\.toml"'):
            load_machine("seal_rig")

    def test_directory(self, tmp_path):
        with pytest.raises(
            InvalidInput,
            match="is a directory, but must be a file; give the path of a machine file",
        ):
            load_machine(tmp_path)

    @pytest.mark.parametrize("name", ["", "\0", "x" * 5000])
    def test_impossible_name(self, name):
        with pytest.raises(InvalidInput):
            load_machine(name)

    def test_not_utf8(self, tmp_path):
        file = tmp_path / "latin.toml"
        file.write_bytes(SMALL.replace("made up", "ausgedächt").encode("latin-1"))
        with pytest.raises(
            InvalidInput,
            match=r"latin.toml is not UTF-8 text \(byte \d+ is 0xe4\); save it as UTF-8",
        ):
            load_machine(file)

    def test_binary(self, tmp_path):
        file = tmp_path / "binary.toml"
        file.write_bytes(bytes(range(128)))
        with pytest.raises(InvalidInput, match="not valid TOML"):
            load_machine(file)

    def test_too_large(self, tmp_path):
        file = tmp_path / "large.toml"
        with file.open("wb") as stream:
            stream.truncate(20_000_000)
        with pytest.raises(InvalidInput, match="more than 1000000 bytes; that is no machine file"):
            load_machine(file)

    def test_message_names_the_file(self, tmp_path):
        file = tmp_path / "rig.toml"
        file.write_text(SMALL.replace('"3 kg"', '"3 m"'))
        with pytest.raises(InvalidInput, match=r"rig\.toml: \[\[disc\]\] wheel: mass is"):
            load_machine(file)

    def test_byte_order_mark_and_windows_line_ends_are_read(self, tmp_path):
        file = tmp_path / "windows.toml"
        file.write_bytes(b"\xef\xbb\xbf" + SMALL.replace("\n", "\r\n").encode())
        assert load_machine(file) == loads_machine(SMALL)

    @pytest.mark.parametrize("name", ["nowhere/rig.toml", ".", ""])
    def test_cannot_be_written(self, tmp_path, name):
        machine = load_machine(bundled_machines()["seal-rig"])
        with pytest.raises(InvalidInput, match=r"machine file .*; (give|add) a file"):
            save_machine(machine, tmp_path / name)

    @pytest.mark.parametrize("wrong", [None, 3, b"seal-rig", ["seal-rig"]])
    def test_what_is_no_path_is_refused(self, wrong):
        with pytest.raises(
            InvalidInput,
            match=r"the machine is .*must be a file or the name of a bundled machine; .*seal-rig",
        ):
            load_machine(wrong)

    def test_a_machine_comes_back(self):
        machine = load_machine("seal-rig")
        assert load_machine(machine) is machine
