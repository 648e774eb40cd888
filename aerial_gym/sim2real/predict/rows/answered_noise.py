"""What noise of the gyro and torque have in common: an autopilot answers that noise.

Where a vehicle only hovers, much of the torque about an axis is such an answer. Then what is measured and what predicts it go
together beyond what the torque does, and a fit takes that for the vehicle's inertia or its rotors' drag (the bias of
identification in closed loop). How much they have in common nobody logs, but there is a bound: noise of rms n goes together
with torque of rms t, of which an answer of rms a, so far that the torque seems larger by ``n a / t²`` at most. All up to
that bound is equally probable, with either sign, which makes a standard deviation of that over root 3. Where a vehicle moves,
it is next to nothing.

The noise is that of the gyro above the band; the answer is what the rotors are told there, where next to nothing else is,
slowed by their lag. In a log without commands it is what would make them turn as they do there, noise of their sensors and all.

Letters: T rows, L lines of a spectrum, K columns.

Source:
    Ljung (1999), System Identification: Theory for the User, section 13.4 (what feedback does to the direct method).
"""

import numpy as np
import torch

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.physics import Vehicle
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass_gain
from aerial_gym.sim2real.predict.rows.spectra import density_of, noise_above


def seeming_torque(flight: Flight, declared: Vehicle, turning: Array, bandwidth: float) -> Array:
    """Return by how much the torque may seem larger about each axis, as a share of it: one standard deviation, (3,).

    0 where the log is too slow to tell the noise, and about an axis about which nothing turns.

    Args:
        flight: With what was measured.
        declared: One environment.
        turning: Angular acceleration that it makes, in the band [rad/s²], body, (T, 3).
        bandwidth: Of the comparison [Hz].
    """
    noise, answer = _noise(flight, bandwidth), _answer(flight, declared, bandwidth)
    if noise is None or answer is None or not len(turning):
        return np.zeros(3)
    moved = turning.std(axis=0)
    seeming = noise * np.minimum(answer, moved) / np.sqrt(3.0)
    return np.divide(seeming, moved**2, out=np.zeros(3), where=moved > 0.0)


def _noise(flight: Flight, bandwidth: float) -> Array | None:
    """Return the rms of the noise of the angular acceleration in the band [rad/s²], (3,); None where it cannot be told."""
    frequency, density = density_of(flight.ang_vel, flight.rate)
    level = noise_above(frequency, density, bandwidth, flight.rate)
    return (
        None if level is None else _rms_below(bandwidth, frequency, level[0] * (2.0 * np.pi * frequency[:, None]) ** 2)
    )


def _answer(flight: Flight, vehicle: Vehicle, bandwidth: float) -> Array | None:
    """Return the rms of the angular acceleration by which rotors answer in the band [rad/s²], (3,); None as for the noise."""
    told = flight.rotor_command is not None
    speed = flight.rotor_command if told else flight.rotor_speed
    assert speed is not None
    thrust = rotor_thrust(vehicle, torch.from_numpy(speed))
    torque = allocation_matrix(vehicle, STANDARD_GRAVITY)[0, 3:] @ thrust.T
    frequency, density = density_of(torch.linalg.solve(vehicle.inertia[0], torque).T.numpy(), flight.rate)
    slowed = 1.0 + (2.0 * np.pi * frequency[:, None] * float(vehicle.time_constant_up.mean())) ** 2
    level = noise_above(frequency, density if told else density * slowed, bandwidth, flight.rate)
    return None if level is None else _rms_below(bandwidth, frequency, level[0] / slowed)


def _rms_below(bandwidth: float, frequency: Array, density: Array) -> Array:
    """Return the rms below a bandwidth [Hz] of signals of these densities (L, K) at frequencies [Hz], (K,)."""
    gain = lowpass_gain(frequency, bandwidth)[:, None]
    return np.sqrt((density * gain**2).sum(axis=0) * frequency[1])
