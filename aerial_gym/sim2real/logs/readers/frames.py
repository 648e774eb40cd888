"""Conversion of the axes north-east-down and forward-right-down to this package's. Letters: T samples."""

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.mapping import LogMapping

FLIP = np.array([1.0, -1.0, -1.0])  # Signs from body FRD to body FLU


def enu_from_ned(vectors: Array) -> Array:
    """Return vectors (T, 3) in world axes east, north, up."""
    return vectors[:, [1, 0, 2]] * (1.0, 1.0, -1.0)


def flu_from_frd(vectors: Array) -> Array:
    """Return vectors (T, 3) in body axes forward, left, up."""
    return vectors * FLIP


def attitude_with_world_enu(attitude: Array) -> Array:
    """Return quaternions (T, 4), xyzw, of body to ENU from those of body to NED: ``q_ned_to_enu q``."""
    x, y, z, w = attitude.T  # q_ned_to_enu = (1, 1, 0, 0) / sqrt(2), xyzw
    return np.stack((w + z, w - z, y - x, -x - y), axis=1) / np.sqrt(2.0)


def attitude_with_body_flu(attitude: Array) -> Array:
    """Return quaternions (T, 4), xyzw, of body FLU to world from those of body FRD: ``q q_flu_to_frd``."""
    x, y, z, w = attitude.T  # q_flu_to_frd = (1, 0, 0, 0), xyzw
    return np.stack((w, z, -y, -x), axis=1)


def attitude_from_ned_frd(wxyz: Array) -> Array:
    """Return quaternions (T, 4), xyzw, of FLU to ENU from those of FRD to NED, w first, as PX4 and ArduPilot log them."""
    return attitude_with_body_flu(attitude_with_world_enu(wxyz[:, [1, 2, 3, 0]]))


def quantity_from_ned_frd(quantity: str, values: Array) -> Array:
    """Return a quantity of a log channel in this package's axes, from NED and FRD, attitudes with w first."""
    convert = {"attitude": attitude_from_ned_frd, "position": enu_from_ned, "lin_vel": enu_from_ned}
    return convert.get(quantity, flu_from_frd)(values)


def to_package_frames(values: dict[str, Array], layout: LogMapping) -> dict[str, Array]:
    """Return the quantities in world ENU and body FLU, with quaternions from body to world."""
    result = dict(values)
    if layout.attitude_direction == "world_to_body" and "attitude" in result:
        result["attitude"] = result["attitude"] * (-1.0, -1.0, -1.0, 1.0)
    if layout.world_frame == "ned":
        result |= {n: enu_from_ned(result[n]) for n in ("position", "lin_vel", "other_position") if n in result}
        result |= {n: attitude_with_world_enu(q) for n, q in result.items() if n == "attitude"}
    if layout.body_frame == "frd":
        result |= {name: flu_from_frd(result[name]) for name in ("ang_vel", "specific_force") if name in result}
    if (layout.attitude_body_frame or layout.body_frame) == "frd":
        result |= {n: attitude_with_body_flu(q) for n, q in result.items() if n == "attitude"}
    return result
