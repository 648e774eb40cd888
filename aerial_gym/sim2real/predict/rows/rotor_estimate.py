"""Rotor speeds as a prediction needs them: without the part of their noise that would be taken for motion.

What is predicted from a noisy speed has its noise in it, and a fit takes that noise for the effect: it makes the effect smaller
(attenuation), where a vehicle hardly moves by several times. A prediction from the *expected* speed, given all that was logged,
has no such bias: what the expectation misses is independent of it (Berkson's error), and is only more noise of the residual.

The expectation is that of stationary signals: of what was measured, motion and white noise of the sensor, a frequency keeps
the share ``1 - N / P`` of noise N in the density P, for each force and torque that the rotors make together. The level of the
noise is that where the spectrum is lowest above the band of the comparison: white noise is nowhere more than the whole. Where
a vehicle moves, the share is nearly one, and speeds stay as they were measured; in hover most of their scatter goes. Where
noise is more than motion, what commands lead to by the declared lag tells more of the motion than the sensor: there the share
is that of what was measured beside it. (Elsewhere it would not do: a lag that is wrong by a little is no noise.) How large
the share is, is itself known only as well as a spectrum of that length tells: what it leaves unsure is a tolerance of the
comparison, beside those of the vehicle.

Letters: T rows, R rotors and as many modes of theirs, L lines of a spectrum.

Sources:
    Carroll, Ruppert, Stefanski, Crainiceanu (2006), Measurement Error in Nonlinear Models, chapter 4 (regression calibration);
    Wiener (1949), Extrapolation, Interpolation, and Smoothing of Stationary Time Series (the filter ``1 - N / P``).
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
from aerial_gym.sim2real.logs.signals import without_line
from aerial_gym.sim2real.predict.model_params import ModelParams, declared_params, effects_at
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay
from aerial_gym.sim2real.predict.rows.spectra import density_of, filtered, noise_above, segment_length

ORDER = (2, 3, 4, 5, 0, 1)
"""Forces and torques in the order in which combinations of rotors are found that make them: thrust, roll, pitch, yaw, then the
forces along x and y, which flat vehicles lack."""

MOTION = np.geomspace(1e-3, 1e6, 91)
"""Densities of motion over that of noise that are thought of before a flight is seen, equally probable."""


@dataclass(frozen=True, kw_only=True)
class RotorEstimate:
    """Rotor speeds of a flight, as their sensors would read them without noise."""

    speed: Array
    """Their expectation [rad/s], (T, R)."""

    unsure: Array
    """What one standard deviation of the share of motion in a mode would add [rad/s], (R modes, T, R)."""


def as_measured(flight: Flight) -> RotorEstimate | None:
    """Return the speeds as they were measured, noise and all."""
    if flight.rotor_speed is None:
        return None
    return RotorEstimate(speed=flight.rotor_speed, unsure=np.zeros((flight.num_rotors, *flight.rotor_speed.shape)))


def estimate_rotors(robot: RobotCfg, flights: Sequence[Flight], bandwidth: float) -> list[RotorEstimate | None]:
    """Return the expected rotor speeds of each flight.

    None for a flight without measured speeds. Speeds of a log that is too slow to tell the noise stay as they are.

    Args:
        robot: As declared.
        flights: With what was measured.
        bandwidth: Of the comparison [Hz].
    """
    model = rotors_of(robot)
    led = RotorReplay(flights).speeds(model, 0.0, model.effects[RotorSensorEffect])
    made = allocation_matrix(model.vehicle, STANDARD_GRAVITY)[0].numpy()
    found = [_estimate(flight, commanded, made, bandwidth) for flight, commanded in zip(flights, led, strict=True)]
    return [as_measured(flight) if one is None else one for flight, one in zip(flights, found, strict=True)]


def rotors_of(robot: RobotCfg) -> Model:
    """Return the declared vehicle with those of its effects that change how rotors follow commands."""
    kinds = (VehicleEffect, DelayEffect, CommandEffect, RotorSensorEffect)
    effects = {
        name: params for name, params in declared_params(robot).effects.items() if isinstance(EFFECTS.get(name), kinds)
    }
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    return build_model(vehicle, effects_at(ModelParams(effects=effects), 1))


def _estimate(flight: Flight, led: Array | None, made: Array, bandwidth: float) -> RotorEstimate | None:
    """Return the expected speeds of a flight, None where there are none or the log is too slow to tell the noise.

    Args:
        flight: With what was measured.
        led: What commands lead to [rad/s], (T, R); None without commands.
        made: Force and torque that the rotors make, (6, R).
        bandwidth: Of the comparison [Hz].
    """
    speed, rate = flight.rotor_speed, flight.rate
    if speed is None:
        return None
    base = np.broadcast_to(speed.mean(axis=0), speed.shape)
    frequency, density = density_of(speed - base if led is None else speed - led, rate)
    noise = noise_above(frequency, density, bandwidth, rate)
    if noise is None or not noise[0].all():
        return None
    level, lines = noise
    root = np.sqrt(level)
    modes = _modes(made * root)
    moved, around = (speed - base) / root @ modes, np.zeros_like(speed)
    if led is not None:
        density = density_of(moved, rate)[1]
        in_band = density[(frequency > 0.0) & (frequency <= bandwidth)].mean(axis=0)
        noisy = in_band - 1.0 < 1.0  # motion is less than noise, which is 1 here
        around[:, noisy] = ((led - base) / root @ modes)[:, noisy]
        moved = moved - around
    density, segments = density_of(moved, rate)[1], _segments(len(speed), rate)
    shares = [_share_of_motion(one, segments, 1.0 / np.sqrt(segments * lines)) for one in density.T]
    share, spread = (np.stack(parts, axis=1) for parts in zip(*shares, strict=True))
    left = without_line(moved.T).T
    expected = around + moved - left + filtered(left, frequency, share, rate)
    unsure = filtered(left, frequency, spread, rate)
    return RotorEstimate(
        speed=base + expected @ modes.T * root, unsure=unsure.T[:, :, None] * (modes.T * root)[:, None, :]
    )


def _modes(made: Array) -> Array:
    """Return orthonormal combinations of rotors, (R, R): one for each force and torque, then those that make none."""
    return np.linalg.qr(made[list(ORDER)].T, mode="complete")[0]


def _segments(rows: int, rate: float) -> float:
    """Return over how many independent segments Welch's mean is: half-overlapping Hann windows count 9/11 each.

    Source: Welch (1967), The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on Audio and
    Electroacoustics 15 (variance 11/9 of that of as many independent segments).
    """
    return max(1.0, 9.0 / 11.0 * (2.0 * rows / segment_length(rows, rate) - 1.0))


def _share_of_motion(density: Array, segments: float, unsure: float) -> tuple[Array, Array]:
    """Return the share of motion in each line (L,) of a density in which that of the noise is 1, and its standard deviation.

    That of motion falls with frequency: lines that rise are one level (isotonic regression). A level over so many lines and
    segments scatters by itself (as chi-squared); of what it may be made of, the expected share is taken. ``unsure`` is the
    relative standard deviation of the noise.
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
