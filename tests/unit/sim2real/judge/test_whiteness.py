"""Whether a residual is noise: against the nominal share of false alarms, and against lines and drifts of known size."""

import numpy as np
import pytest

from aerial_gym.sim2real.judge.whiteness import (
    WHITE,
    octave_ranges,
    power_by_octave,
    spectral_lines,
    whiteness_of_channels,
)
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import Channel

RATE, BAND = 30.0, 10.0
FORCE, TURN = Channel(kind="specific_force", axis="x"), Channel(kind="angular_acceleration", axis="x")


def low_passed(values: np.ndarray, *, derivative: bool = False) -> np.ndarray:
    """Return noise sampled at ten times the band, low-passed and decimated to three times the band as in a comparison."""
    return lowpass(values, 100.0, BAND, derivative=derivative)[::3][10:-10]


def test_noise_is_called_noise_as_often_as_stated() -> None:
    """400 residuals of two flights: p is uniform, also of a differentiated sensor."""
    rng = np.random.default_rng(0)
    result = []
    for _ in range(200):
        noise = [rng.standard_normal((1000, 1)) for _ in range(2)]
        both = [np.hstack((low_passed(n), low_passed(n, derivative=True))) for n in noise]
        times = [0.03 * np.arange(len(rows)) for rows in both]
        result += [w.probability for w in whiteness_of_channels(times, both, (FORCE, TURN), BAND)]
    for share in (0.05, 0.2, 0.5):
        scatter = 4.0 * np.sqrt(share * (1 - share) / 400) + 0.02
        assert np.mean(np.array(result) < share) == pytest.approx(share, abs=scatter)


@pytest.mark.parametrize("kind", ["line", "drift"])
def test_what_is_no_noise_is_told_and_where_it_lies(kind: str) -> None:
    rng, time = np.random.default_rng(1), 0.03 * np.arange(400)
    own = np.sin(2.0 * np.pi * 7.0 * time) if kind == "line" else np.sin(2.0 * np.pi * 0.3 * time)
    values = rng.standard_normal((400, 1)) + own[:, None]
    (result,) = whiteness_of_channels([time], [values], (FORCE,), BAND)
    assert result.probability < WHITE
    assert not result.white
    assert int(np.argmax(result.octaves)) == (3 if kind == "line" else 0)


def test_a_sine_lies_in_its_octave_with_its_power_and_gaps_split_flights() -> None:
    """``rows / 2`` of a sine of 4 Hz, undone for the gain of the low-pass there."""
    time = np.arange(300) / RATE
    frequency, power = spectral_lines([time], [np.sin(2.0 * np.pi * 4.0 * time)[:, None]], BAND)
    octaves = power_by_octave(frequency, power, BAND)[:, 0]
    gain = 1.0 / (1.0 + 0.4**8)
    np.testing.assert_allclose(octaves, [0.0, 0.0, 300 / 4 / gain**2, 0.0], atol=1e-9)
    assert octave_ranges(BAND)[2] == "2.5 to 5 Hz"
    jump = np.where(time < 5.0, time, time + 3.0)
    split, _ = spectral_lines([jump], [np.ones((300, 1))], BAND)
    assert split.min() == pytest.approx(RATE / 150)
