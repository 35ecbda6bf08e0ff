"""Units: spellings, traps, dimensions and uncertainties."""

import numpy as np
import pytest

from ddetumble._errors import InputError
from ddetumble.measurement import units
from ddetumble.measurement.campaign import Uncertainty
from ddetumble.measurement.units import (
    ROLES,
    check_unit,
    list_usual,
    parse_deviation,
    parse_quantity,
    parse_uncertainty,
    parse_unit,
    si_unit,
)


@pytest.mark.parametrize(
    ("text", "value", "like"),
    [
        ("Nm", 1, "N*m"), ("kNm", 1e3, "N*m"), ("N·m", 1, "N*m"), ("N m", 1, "N*m"), ("Ns/m", 1, "N*s/m"),
        ("Pas", 1, "Pa*s"), ("Newtons", 1, "N"), ("Newton", 1, "N"), ("gf", 9.80665e-3, "N"), ("kgf", 9.80665, "N"),
        ("kp", 9.80665, "N"), ("lbf", 4.4482216152605, "N"), ("um", 1e-6, "m"), ("µm", 1e-6, "m"), ("μm", 1e-6, "m"),
        ("m s-1", 1, "m/s"), ("m s^-1", 1, "m/s"), ("m.s-1", 1, "m/s"), ("m·s⁻¹", 1, "m/s"), ("km/h", 1 / 3.6, "m/s"),
        ("kg·m²", 1, "kg*m^2"), ("kgm2", 1, "kg m^2"), ("rpm", np.pi / 30, "rad/s"), ("°/s", np.pi / 180, "rad/s"),
        ("psi", 6894.757293168, "Pa"), ("bara", 1e5, "Pa"), ("%", 0.01, "1"), ("-", 1, ""), ("N/K^0.5", 1, "N*K^-0.5"),
    ],
)  # fmt: skip
def test_spellings(text, value, like):
    unit = parse_unit(text)
    assert unit.scale == pytest.approx(value, rel=1e-12)
    assert unit.dimension == parse_unit(like).dimension


@pytest.mark.parametrize(
    "text",
    ["Fz", "MPA", "3 N", "m/0", "9**9", "N^1e9", "m**9**9", "dB", "__class__", "().a", "import os", "N" * 200, "N\n",
     "é", "[N]", "N;", "lambda: 0", "*", "/s"],
)  # fmt: skip
def test_no_units(text):
    if text == "N\n":
        assert parse_unit(text).si == parse_unit("N").si
        return
    with pytest.raises(InputError, match="unit"):
        parse_unit(text)


def test_common_units_are_as_pint_reads_them(monkeypatch):
    known = {text: parse_unit(text) for text in units._COMMON}
    monkeypatch.setattr(units, "_COMMON", {})
    for text, unit in known.items():
        assert unit == parse_unit.__wrapped__(text)


@pytest.mark.parametrize(("text", "plain"), [
    ("barg", "bar"), ("bar(ü)", "bar"), ("Bar (g)", "bar"), ("bar_g", "bar"), ("PSIG", "psi"), ("kPa rel.", "kPa"),
    ("MPa(g)", "MPa"), ("bar, gauge", "bar"), ("bar", None), ("g", None), ("mbar", None), ("gf", None)])
def test_units_above_the_pressure_around(text, plain):
    assert units.strip_gauge(text) == plain


def test_hints_and_gauges():
    with pytest.raises(InputError, match="did you mean MPa"):
        parse_unit("mpa")
    with pytest.raises(InputError, match="did you mean Pa"):
        check_unit("pa", "initial_pressure")  # pint alone: picoyears
    with pytest.raises(InputError, match="degC"):
        check_unit("C", "temperature")
    with pytest.raises(InputError, match="choose the column with the force$"):
        check_unit("mm", "normal_force")
    with pytest.raises(InputError, match="gauge"):
        parse_unit("barg")
    with pytest.raises(InputError, match="absolute") as caught:  # there is no field where one value is given
        parse_quantity("1 bar(g)", "ambient_pressure")
    assert "field" not in str(caught.value)
    with pytest.raises(InputError, match="'60 mm'.*'60 m'"):
        parse_quantity("60", "outer_diameter")
    with pytest.raises(InputError, match="turns"):
        check_unit("Hz", "angular_velocity_x")


@pytest.mark.parametrize(
    ("quantity", "unit", "wrong"),
    [("initial_pressure", "MPa", "N"), ("approach_speed", "mm/s", "m"), ("normal_force", "kN", "kg"),
     ("printed_normal_force", "N", "Pa"), ("peak_friction_force", "mN", "1"), ("depression", "mm", "s"),
     ("angular_velocity_z", "deg/s", "deg"), ("time", "ms", "m"), ("effective_mass", "g", "N"), ("sequence", "1", "s"),
     ("restitution", "%", "m"), ("orbit_rate", "rad/s", "rad"), ("normal_load", "lbf", "lb")],
)  # fmt: skip
def test_dimensions(quantity, unit, wrong):
    assert check_unit(unit, quantity).si == si_unit(quantity)
    with pytest.raises(InputError, match=quantity):
        check_unit(wrong, quantity)


def test_conversion_is_exact_where_decimals_are():
    assert parse_quantity("0.25 ms", "time") == 0.00025
    assert parse_quantity("0.9467 MPa", "initial_pressure") == 946700.0
    np.testing.assert_array_equal(check_unit("mm", "depression").convert(np.array([1.1, 60.0])), [0.0011, 0.06])


def test_temperatures_have_an_offset_and_their_uncertainty_none():
    assert parse_quantity("20 degC", "temperature") == pytest.approx(293.15)
    assert parse_quantity("68 °F", "temperature") == pytest.approx(293.15)
    assert parse_uncertainty("0.5 degC", check_unit("degC", "temperature"), "temperature").absolute == 0.5
    assert parse_uncertainty("0.9 degF", check_unit("K", "temperature"), "temperature").absolute == pytest.approx(0.5)
    for text, quantity, unit in (("2 degC", "temperature", ""), ("2 degC", "theta", "K"), ("3.6 degF", "theta", "K"),
                                 ("2 K", "theta", "degC"), ("3.6 degF", "theta", "degC"), ("2 K", "theta", "K")):
        assert parse_deviation(text, quantity, unit) == 2.0
    assert parse_deviation("-2 degC", "theta", "K") == -2.0 and parse_deviation("5 mm", "theta", "m") == 0.005
    assert parse_quantity("293.15 K", "theta", "degC") == pytest.approx(20.0)
    with pytest.raises(InputError, match="relative"):
        parse_uncertainty("1 %", check_unit("degC", "temperature"), "temperature")


def test_further_columns_keep_their_kind_in_base_units():
    unit = parse_unit("kN/mm")
    assert (unit.scale, unit.si) == (1e6, "kg/s**2")
    assert parse_unit(unit.si).dimension == unit.dimension


def test_uncertainties():
    newton = check_unit("N", "normal_force")
    assert parse_uncertainty("0.25 N", newton, "normal_force") == Uncertainty(0.25, None)
    assert parse_uncertainty("250 mN", newton, "normal_force").absolute == 0.25
    assert parse_uncertainty("0.5 %", newton, "normal_force") == Uncertainty(None, 0.005)
    for text in ("0 N", "-1 N", "0 %", "nan N", "0.25", "0.25 s", "0,25 N", "N", "", "1e999 N"):
        with pytest.raises(InputError, match="normal_force"):
            parse_uncertainty(text, newton, "normal_force")
    np.testing.assert_allclose(Uncertainty(None, 0.01).sd([[100.0, -50.0]]), [[1.0, 0.5]])
    np.testing.assert_allclose(Uncertainty(0.2).sd([1.0, 2.0]), [0.2, 0.2])


def test_quantities():
    assert parse_quantity("60 mm", "outer_diameter") == 0.06
    assert parse_quantity("60mm", "outer_diameter") == 0.06
    assert parse_quantity(0.47, "poisson_ratio") == 0.47
    assert parse_quantity("2e-05 rad/s", "orbit_rate") == 2e-5
    for text in ("60", 60, "60 s", "sixty mm", "6,0 mm", "1e400 m"):
        with pytest.raises(InputError, match="outer_diameter"):
            parse_quantity(text, "outer_diameter")


def test_usual_units_measure_what_they_are_offered_for():
    for name in ROLES:
        assert list_usual(name)
        for unit in list_usual(name):
            check_unit(unit, name)
    assert list_usual("pad_hardness") == ()
