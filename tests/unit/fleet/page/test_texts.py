"""Texts of sizes, causes and times."""

from math import inf, nan

import pytest

from aerial_gym.fleet.page.texts import change_in_scales, change_text, interval_text, time_text
from aerial_gym.fleet.wording import cause_name
from tests.unit.fleet.page.fleet_tables import cause


def test_changes_of_ratios_are_in_per_cent_and_the_most_certain_parameter_is_first() -> None:
    loss = cause("weak_motor", "step", 9.0, 5, {"scale": -0.021}, 0.002)
    assert (cause_name(loss), change_text(loss)) == ("weak motor, rotor 3", "-2.1 ± 0.4 %")
    assert change_in_scales(loss) == pytest.approx(0.42)
    shift = cause("com_offset", "step", 9.0, 5, {"x": 0.001, "y": -0.004, "z": 0.0}, 0.001)
    assert change_text(shift) == "y -0.0040 ± 0.0020 m; x +0.0010 ± 0.0020 m; z 0.0000 ± 0.0020 m"
    assert change_text(shift, most=1) == "y -0.0040 ± 0.0020 m"
    assert change_text(shift | {"std": [1e-4, 0.01, 0.01]}, most=1) == "x +0.00100 ± 0.00020 m"
    assert change_in_scales(shift) == pytest.approx(0.8)


def test_effects_that_are_not_registered_have_no_unit() -> None:
    other = {"effect": "my_effect", "rotor": 0, "parameters": ["k"], "change": [0.5], "std": [0.1]}
    assert (cause_name(other), change_text(other), change_in_scales(other)) == ("my effect", "+0.50 ± 0.20", 0.5)


def test_unknown_intervals_and_times_are_said() -> None:
    assert interval_text(1.0, inf, "m") == "1 interval not known"
    assert time_text(1772323200.0) == "2026-03-01 00:00 UTC"
    assert [time_text(seconds) for seconds in (None, nan, inf, -1.0, 1e12)] == [""] * 5
