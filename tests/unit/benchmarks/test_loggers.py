"""How logs are changed to see whether the loop still names what is hidden."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.robustness.loggers import ACC, ATTITUDE, CHANGES, COMMANDS, GYRO, POSITION, ROTORS, VELOCITY, rate_of

TIME = np.arange(800) / 400.0


def log() -> pd.DataFrame:
    """Return two seconds in which all turns about z by 1.5 rad/s, speeds up, and everything else swings slowly."""
    wave = np.sin(2.0 * np.pi * TIME)
    table = {"t": TIME} | {
        name: wave + number for number, name in enumerate(POSITION + VELOCITY + ACC + ROTORS + COMMANDS)
    }
    table |= dict(zip(GYRO, (0.0 * TIME, 0.0 * TIME, 1.5 + 4.0 * TIME), strict=True))
    angle = 0.5 * (1.5 * TIME + 2.0 * TIME**2)
    return pd.DataFrame(
        table | dict(zip(ATTITUDE, (0.0 * TIME, 0.0 * TIME, np.sin(angle), np.cos(angle)), strict=True))
    )


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_the_same_in_all_logs_and_leaves_a_log(name: str) -> None:
    one, other = (CHANGES[name](log(), np.random.default_rng(3)) for _ in range(2))
    pd.testing.assert_frame_equal(one, other)
    assert np.isfinite(one.to_numpy()).all()
    assert (np.diff(one["t"]) > 0.0).all()
    assert name == "none" or not one.equals(log())


@pytest.mark.parametrize(
    ("name", "columns", "seconds"),
    [
        ("tracking_late", POSITION, 0.008),
        ("rotor_late", ROTORS, 0.010),
        ("velocity_filtered", VELOCITY, 1 / (16 * np.pi)),
    ],
)
def test_what_comes_late_is_what_was_before(name: str, columns: list[str], seconds: float) -> None:
    """A low-pass of first order delays a slow wave by one over its corner, in radians: to 2 % of the wave's size."""
    found = CHANGES[name](log(), np.random.default_rng(0))
    for number, column in enumerate(columns):
        before = np.interp(TIME - seconds, TIME, log()[column])
        np.testing.assert_allclose(found[column][100:], before[100:], atol=0.02, err_msg=f"{number}")
    assert found["t"].equals(log()["t"])


def test_an_accelerometer_elsewhere_feels_the_turning() -> None:
    """About z alone: ``-w² r`` outwards and ``w' z x r`` along the turn, and nothing along z."""
    place = 0.01 * np.clip(np.random.default_rng(1).standard_normal(3), -2.0, 2.0)
    found, rate = CHANGES["acc_elsewhere"](log(), np.random.default_rng(1)), 1.5 + 4.0 * TIME
    felt = (found[ACC] - log()[ACC]).to_numpy()
    expected = np.outer(-(rate**2), place * (1.0, 1.0, 0.0)) + 4.0 * np.array([-place[1], place[0], 0.0])
    np.testing.assert_allclose(felt[50:-50], expected[50:-50], atol=1e-4)


def test_rates_of_logs() -> None:
    assert rate_of(log()) == pytest.approx(400.0)
    assert rate_of(CHANGES["slow_100"](log(), np.random.default_rng(0))) == pytest.approx(100.0)
