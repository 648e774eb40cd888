"""Spectral densities of flight signals, their noise level, zero-phase filters, and the correlation of noise with torque.

In hover, much of the torque is the autopilot's response to gyro noise, and a fit attributes this to inertia or rotor drag.
With noise of RMS n, torque of RMS t and a response of RMS a, the torque seems larger by at most ``n a / t²``; the standard
deviation within this bound is bound / sqrt(3). The response is later than the noise by some phase, so the bound also holds
for the torque a quarter period late, which would look like a delay or a drag of the rotation. Noise and response are
measured above the band; the response is that of commands through the rotor lag, or else of rotor speeds. Letters: T rows,
L lines of a spectrum, K columns.

Source: Ljung (1999), System Identification: Theory for the User, section 13.4 (feedback in the direct method).
"""

import numpy as np
import torch
from scipy import fft

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.physics import Vehicle
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import hann_window, lowpass_gain, welch

SEGMENT_S = 2.0  # Length of a segment of Welch's spectrum [s]
OCTAVE = 2.0  # Frequency ratio of the bands among which the quietest gives the noise
FROM_BAND, TO_BAND = 1.5, 6.0  # Range of these bands in bandwidths, as resampled logs have less noise above
TO_RATE = 0.45  # Upper limit of these bands as a share of the rate


def segment_length(rows: int, rate: float) -> int:
    """Return the number of rows per segment."""
    return min(rows, round(SEGMENT_S * rate))


def power_density(values: Array, rate: float) -> tuple[Array, Array]:
    """Return the frequencies [Hz], (L,), and the density of each column (T, any), flat for white noise."""
    length = segment_length(len(values), rate)
    frequency, density = welch(values, rate, length)
    return frequency, density / _white_noise_gain(length)[:, None]


def _white_noise_gain(length: int) -> Array:
    """Return the gain of Welch's density for white noise, ``|v_k - P v_k|²`` of wave v_k without lines P, over |v_k|², (L,)."""
    window = hann_window(length)
    place = np.arange(length) - 0.5 * (length - 1)
    lost = sum(np.abs(np.fft.rfft(window * one)) ** 2 / (one @ one) for one in (np.ones(length), place))
    return 1.0 - lost / (window @ window)


def noise_level(frequency: Array, density: Array, bandwidth: float, rate: float) -> tuple[Array, float] | None:
    """Return the density of each column in its quietest octave above the band [Hz], (K,), and its least number of lines."""
    low, high = FROM_BAND * bandwidth, min(TO_BAND * bandwidth, TO_RATE * rate)
    places = np.flatnonzero((frequency >= low) & (OCTAVE * frequency <= high))
    if not places.size:
        return None
    means = [density[place : round(OCTAVE * place)].mean(axis=0) for place in places]
    return np.min(means, axis=0), (OCTAVE - 1.0) * float(places[0])


def filter_by_gain(values: Array, frequency: Array, gain: Array, rate: float) -> Array:
    """Return columns (T, R) filtered with a gain (L, R) by frequency, without phase shift."""
    mirrored = np.concatenate((values, values[::-1]))
    at = fft.rfftfreq(len(mirrored), 1.0 / rate)
    gains = np.stack([np.interp(at, frequency, one) for one in gain.T], axis=1)
    spectrum = np.asarray(fft.rfft(mirrored, axis=0))
    return np.asarray(fft.irfft(spectrum * gains, n=len(mirrored), axis=0))[: len(values)]


def delay_by_quarter_period(values: Array) -> Array:
    """Return columns (T, K) of zero mean with each frequency a quarter period late (Hilbert transform)."""
    return np.asarray(fft.irfft(-1j * np.asarray(fft.rfft(values, axis=0)), n=len(values), axis=0))


def torque_gain_uncertainty(flight: Flight, declared: Vehicle, turning: Array, bandwidth: float) -> Array:
    """Return the standard deviation of the apparent relative increase of the torque about each axis, (3,); 0 if unseen.

    It also holds for the apparent part a quarter period late.

    ``turning``: predicted angular acceleration in the band [rad/s²], body, (T, 3).
    """
    noise, answer = _angular_acceleration_noise_rms(flight, bandwidth), _rotor_response_rms(flight, declared, bandwidth)
    if noise is None or answer is None or not len(turning):
        return np.zeros(3)
    moved = turning.std(axis=0)
    seeming = noise * np.minimum(answer, moved) / np.sqrt(3.0)
    return np.divide(seeming, moved**2, out=np.zeros(3), where=moved > 0.0)


def _angular_acceleration_noise_rms(flight: Flight, bandwidth: float) -> Array | None:
    """Return the RMS noise of the angular acceleration in the band [rad/s²], (3,); None if the log is too slow."""
    frequency, density = power_density(flight.ang_vel, flight.rate)
    level = noise_level(frequency, density, bandwidth, flight.rate)
    if level is None:
        return None
    return _band_rms(bandwidth, frequency, level[0] * (2.0 * np.pi * frequency[:, None]) ** 2)


def _rotor_response_rms(flight: Flight, vehicle: Vehicle, bandwidth: float) -> Array | None:
    """Return the RMS rotor response in the band as angular acceleration [rad/s²], (3,); None if the log is too slow."""
    told = flight.rotor_command is not None
    speed = flight.rotor_command if told else flight.rotor_speed
    assert speed is not None
    thrust = rotor_thrust(vehicle, torch.from_numpy(speed))
    torque = allocation_matrix(vehicle, STANDARD_GRAVITY)[0, 3:] @ thrust.T
    frequency, density = power_density(torch.linalg.solve(vehicle.inertia[0], torque).T.numpy(), flight.rate)
    slowed = 1.0 + (2.0 * np.pi * frequency[:, None] * float(vehicle.time_constant_up.mean())) ** 2
    level = noise_level(frequency, density if told else density * slowed, bandwidth, flight.rate)
    return None if level is None else _band_rms(bandwidth, frequency, level[0] / slowed)


def _band_rms(bandwidth: float, frequency: Array, density: Array) -> Array:
    """Return the RMS below a bandwidth [Hz] of signals with densities (L, K) at frequencies [Hz], (K,)."""
    gain = lowpass_gain(frequency, bandwidth)[:, None]
    return np.sqrt((density * gain**2).sum(axis=0) * frequency[1])
