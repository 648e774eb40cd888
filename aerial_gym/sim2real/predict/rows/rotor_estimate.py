"""Expected rotor speeds for predictions, without the noise that would bias a fit.

A fit to a prediction from noisy speeds underestimates the effect (attenuation), in hover by several times. The error of the
*expected* speed, given all measurements, is independent of it (Berkson's error). At each frequency the expectation keeps
the share ``1 - N / P`` of the noise N, the lowest density above the band, in the density P, for each force and torque of
the rotors. If noise exceeds motion, the share applies to the difference from the declared lag driven by the commands.
Letters: T rows, R rotors and as many modes of theirs, L lines of a spectrum.

Sources: Carroll, Ruppert, Stefanski, Crainiceanu (2006), Measurement Error in Nonlinear Models, chapter 4 (regression
calibration); Wiener (1949), Extrapolation, Interpolation, and Smoothing of Stationary Time Series (the filter ``1 - N /
P``).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import isotonic_regression

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.physics import EFFECTS, Model, build_model, vehicle_from_config
from aerial_gym.physics.effects import CommandEffect, DelayEffect, RotorSensorEffect, VehicleEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import remove_line
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects, params_from_robot
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay
from aerial_gym.sim2real.predict.rows.spectra import filter_by_gain, noise_level, power_density, segment_length

ORDER = (2, 3, 4, 5, 0, 1)  # Rotor modes: thrust, roll, pitch, yaw, then forces along x and y, which flat vehicles lack
MOTION = np.geomspace(1e-3, 1e6, 91)  # Prior grid of motion density over noise density, equally probable


@dataclass(frozen=True, kw_only=True)
class RotorEstimate:
    """Expected noise-free sensor readings of a flight's rotor speeds."""

    speed: Array  # Expectation [rad/s], (T, R)
    unsure: Array  # Change of speed per standard deviation of each mode's share of motion [rad/s], (R modes, T, R)


def estimate_as_measured(flight: Flight) -> RotorEstimate | None:
    """Return the measured speeds unchanged; None without any."""
    if flight.rotor_speed is None:
        return None
    return RotorEstimate(speed=flight.rotor_speed, unsure=np.zeros((flight.num_rotors, *flight.rotor_speed.shape)))


def estimate_rotors(robot: RobotCfg, flights: Sequence[Flight], bandwidth: float) -> list[RotorEstimate | None]:
    """Return the expected rotor speeds of each flight, as measured for a log too slow to show noise; None without any."""
    model = rotor_response_model(robot)
    led = RotorReplay(flights).speeds(model, 0.0, model.effects[RotorSensorEffect])
    made = allocation_matrix(model.vehicle, STANDARD_GRAVITY)[0].numpy()
    pairs = list(zip(flights, led, strict=True))
    estimates = [_estimate_rotor_speeds(flight, commanded, made, bandwidth) for flight, commanded in pairs]
    return [one or estimate_as_measured(flight) for flight, one in zip(flights, estimates, strict=True)]


def rotor_response_model(robot: RobotCfg) -> Model:
    """Return the declared vehicle with only those effects that change the rotors' response to commands."""
    kinds = (VehicleEffect, DelayEffect, CommandEffect, RotorSensorEffect)
    declared = params_from_robot(robot).effects
    effects = {name: params for name, params in declared.items() if isinstance(EFFECTS.get(name), kinds)}
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    return build_model(vehicle, expand_effects(ModelParams(effects=effects), 1))


def _estimate_rotor_speeds(flight: Flight, led: Array | None, made: Array, bandwidth: float) -> RotorEstimate | None:
    """Return the expected speeds of a flight or None; ``led``: replayed speeds (T, R), ``made``: thrusts to wrench, (6, R)."""
    speed, rate = flight.rotor_speed, flight.rate
    if speed is None:
        return None
    base = np.broadcast_to(speed.mean(axis=0), speed.shape)
    frequency, density = power_density(speed - base if led is None else speed - led, rate)
    noise = noise_level(frequency, density, bandwidth, rate)
    if noise is None or not noise[0].all():
        return None
    level, lines = noise
    root = np.sqrt(level)
    modes = _rotor_modes(made * root)
    moved, around = (speed - base) / root @ modes, np.zeros_like(speed)
    if led is not None:
        density = power_density(moved, rate)[1]
        in_band = density[(frequency > 0.0) & (frequency <= bandwidth)].mean(axis=0)
        noisy = in_band - 1.0 < 1.0  # motion below noise, which is 1 here
        around[:, noisy] = ((led - base) / root @ modes)[:, noisy]
        moved = moved - around
    density = power_density(moved, rate)[1]
    # Half-overlapping Hann segments of Welch's mean count 9/11 of independent ones (Welch, 1967, variance 11/9).
    segments = max(1.0, 9.0 / 11.0 * (2.0 * len(speed) / segment_length(len(speed), rate) - 1.0))
    shares = [_share_of_motion(one, segments, 1.0 / np.sqrt(segments * lines)) for one in density.T]
    share, spread = (np.stack(parts, axis=1) for parts in zip(*shares, strict=True))
    left = remove_line(moved.T).T
    expected = around + moved - left + filter_by_gain(left, frequency, share, rate)
    unsure = filter_by_gain(left, frequency, spread, rate)
    return RotorEstimate(
        speed=base + expected @ modes.T * root, unsure=unsure.T[:, :, None] * (modes.T * root)[:, None, :]
    )


def _rotor_modes(made: Array) -> Array:
    """Return orthonormal rotor modes, (R, R): one per force and torque, then those without any."""
    return np.linalg.qr(made[list(ORDER)].T, mode="complete")[0]


def _share_of_motion(density: Array, segments: float, unsure: float) -> tuple[Array, Array]:
    """Return the share of motion in each line (L,) of a density with noise 1, and its standard deviation.

    Rising lines are pooled (isotonic regression); the level of each pool is chi-squared, with a posterior mean over
    ``MOTION``. ``unsure``: relative standard deviation of the noise level.
    """
    falling = isotonic_regression(density, increasing=False)
    lines = np.diff(falling.blocks)
    level, number = falling.x[falling.blocks[:-1]], segments * lines
    log_likelihood = -number * (np.log1p(MOTION)[:, None] + level / (1.0 + MOTION)[:, None])
    weight, of_motion = np.exp(log_likelihood - log_likelihood.max(axis=0)), (MOTION / (1.0 + MOTION))[:, None]
    weight = weight / weight.sum(axis=0)
    share = (weight * of_motion).sum(axis=0)
    spread = np.sqrt((weight * (of_motion - share) ** 2).sum(axis=0) + (unsure * (1.0 - share)) ** 2)
    return np.repeat(share, lines), np.repeat(spread, lines)
