"""White noise of the sensors of a log, by their spectra above the motion. Letters: T rows, C columns."""

from collections.abc import Sequence

import numpy as np

from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.noise_floor import WIDE_BAND, noise_floor_of_columns

MOTION = 0.08  # Upper end of the motion as a share of the rate: 20 Hz of a log at 250 Hz
STREAMS = ("position", "lin_vel", "attitude", "ang_vel")  # Streams that a policy observes


def sensor_noise(logs: Sequence[FlightLog]) -> dict[str, float]:
    """Return the standard deviation of one sample of each stream, of the attitude as an angle [rad]; less those not logged.

    Noise is white: of its variance a band b of a rate r has the share 2 b / r.
    """
    noise = {}
    for name in STREAMS:
        squares = []
        for log in logs:
            values, rate = getattr(log, name), sample_rate(log)
            if values is None:
                continue
            wide = lowpass(values, rate, WIDE_BAND * rate)
            floor = noise_floor_of_columns(wide, rate, MOTION * rate, [True] * values.shape[1])
            if floor is not None:
                squares.append(float(np.sum(floor**2)) / (2.0 * MOTION))
        if squares:  # Three angles of noise s change the entries of a quaternion by s / 2
            noise[name] = float(np.sqrt(np.mean(squares) / 3.0)) * (2.0 if name == "attitude" else 1.0)
    return noise
