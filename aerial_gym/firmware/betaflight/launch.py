"""Start of the firmware's instances: calibration, arming, hover throttle. A reset returns to this moment."""

from collections.abc import Sequence

import numpy as np
import torch

from aerial_gym.errors import CapabilityError
from aerial_gym.firmware.betaflight.instances import KEEP, STEP, InstanceGroup
from aerial_gym.firmware.betaflight.vehicle import ARM, BELOW_ALL, LOW, THROTTLE, BetaflightVehicle, write_state

CALIBRATION_STEPS = 4500  # The gyro's calibration takes 4000 samples: 0.5 s at 8 kHz (`gyro_calib_duration`)
START_S = 4.0  # Until receiver and sensors are ready [s]
ARMING_S, HOVER_S = 0.3, 0.2  # Times at rest before a flight [s]


def arm_instances(group: InstanceGroup, vehicle: BetaflightVehicle, envs: Sequence[int], *, period: float) -> None:
    """Calibrate and arm the instances of environments, level and at rest, up to hover throttle; keep this moment.

    Args:
        period: Time between two exchanges [s].

    Raises:
        CapabilityError: If one ends, or its motors do not start.
    """
    envs = list(envs)
    rows = group.requests[envs]
    write_state(rows["state"], ang_vel=np.zeros((len(envs), 3)))
    all_channels = group.requests["channels"].copy()
    vehicle.channels(torch.zeros(len(all_channels), 4), all_channels)
    hover = all_channels[envs]
    safe = hover.copy()
    safe[:, THROTTLE] = BELOW_ALL
    disarmed = safe.copy()
    disarmed[:, ARM] = int(LOW)
    steps = (max(CALIBRATION_STEPS, round(START_S / period)), round(ARMING_S / period), round(HOVER_S / period))
    for channels, count in zip((disarmed, safe, hover), steps, strict=True):
        rows["channels"] = channels
        group.requests[envs] = rows
        group.repeat(STEP, envs, repeats=count)
    group.require(envs)
    if not (group.replies["pulses"][envs, :4] > LOW).all():
        raise CapabilityError("Betaflight does not arm: its motors stand still at hover throttle")
    group.repeat(KEEP, envs)
