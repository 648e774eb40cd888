"""The asset table: one row of parameters for each asset of an environment file, for use in kernels.

Frames: world of each environment, z up.
"""

from collections.abc import Sequence

import numpy as np
import torch
import warp as wp

from aerial_gym.config.environment import AT_BOUNDS, MOTIONS, AssetCfg
from aerial_gym.interop import start_warp

STILL, TWIST, WAYPOINTS = (wp.constant(i) for i in range(len(MOTIONS)))
"""Kinds of motion, in the order of ``MOTIONS``."""

PASS, BOUNCE, WRAP = (wp.constant(i) for i in range(len(AT_BOUNDS)))
"""Behaviour at the bounds, in the order of ``AT_BOUNDS``."""


@wp.struct
class AssetRow:
    """Ranges of the draws of one asset's instances, and their motion."""

    ratio_low: wp.vec3  # place, as a share of the bounds
    ratio_high: wp.vec3
    offset: wp.vec3  # added to the place, world [m]
    euler_low: wp.vec3  # ZYX roll, pitch, yaw [rad]
    euler_high: wp.vec3
    lin_vel_low: wp.vec3  # world [m/s]
    lin_vel_high: wp.vec3
    ang_vel_low: wp.vec3  # world [rad/s]
    ang_vel_high: wp.vec3
    speed_low: wp.float32  # along waypoints [m/s]
    speed_high: wp.float32
    motion: wp.int32  # STILL, TWIST or WAYPOINTS
    at_bounds: wp.int32  # PASS, BOUNCE or WRAP
    is_drawn: wp.int32  # whether the place is drawn (1) or given (0)


def asset_table(assets: Sequence[AssetCfg], *, device: torch.device) -> wp.array:
    """Return the rows of all assets on the device."""
    start_warp()
    rows = np.zeros(len(assets), dtype=AssetRow.numpy_dtype())  # type: ignore[call-overload]
    for row, asset in zip(rows, assets, strict=True):
        motion = asset.motion
        row["ratio_low"], row["ratio_high"] = asset.position_ratio_low, asset.position_ratio_high
        row["offset"] = asset.offset
        row["euler_low"], row["euler_high"] = asset.euler_low, asset.euler_high
        row["lin_vel_low"], row["lin_vel_high"] = motion.lin_vel_low, motion.lin_vel_high
        row["ang_vel_low"], row["ang_vel_high"] = motion.ang_vel_low, motion.ang_vel_high
        row["speed_low"], row["speed_high"] = motion.speed
        row["motion"], row["at_bounds"] = MOTIONS.index(motion.kind), AT_BOUNDS.index(motion.at_bounds)
        row["is_drawn"] = asset.position_ratio_low != asset.position_ratio_high
    return wp.array(rows, dtype=AssetRow, device=wp.device_from_torch(device))
