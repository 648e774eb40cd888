"""The noise of signals, told from their spectra."""

import numpy as np
import pytest

from aerial_gym.sim2real.predict.rows.spectra import filter_by_gain, noise_level, power_density


def test_the_noise_is_that_of_the_quietest_octave() -> None:
    frequency = np.arange(0.0, 100.0, 0.5)
    density = np.where(frequency < 20.0, 50.0, np.where(frequency > 45.0, 9.0, 2.0))[:, None]
    result = noise_level(frequency, density, 10.0, 200.0)
    assert result[0] == pytest.approx(2.0)
    assert result[1] == 30.0
    assert noise_level(frequency, density, 40.0, 200.0) is None  # no octave between 60 and 90 Hz


def test_white_noise_is_level_and_its_power_is_its_variance() -> None:
    """Down to the lowest lines, from which a straight line is taken: 400 s of it, within four deviations of a mean."""
    values = 3.0 * np.random.default_rng(0).standard_normal((40_000, 2))
    frequency, density = power_density(values, 100.0)
    segments = 9.0 / 11.0 * 2.0 * 400.0 / 2.0
    assert density[1:-1] == pytest.approx(9.0 / 50.0, rel=5.0 / np.sqrt(segments))
    assert density[1:4].mean() == pytest.approx(9.0 / 50.0, rel=4.0 / np.sqrt(6.0 * segments))
    assert (density.sum(axis=0) * frequency[1]) == pytest.approx(9.0, rel=0.03)


def test_a_filter_keeps_the_phase() -> None:
    """A wave of 3 Hz at a gain that falls by 0.1 from each Hz to the next."""
    time = np.arange(2_000) / 100.0
    wave = np.sin(2.0 * np.pi * 3.0 * time)[:, None]
    frequency = np.arange(0.0, 51.0)
    result = filter_by_gain(wave, frequency, np.maximum(0.0, 1.0 - 0.1 * frequency)[:, None], 100.0)
    assert result[200:-200] == pytest.approx(0.7 * wave[200:-200], abs=0.01)
