"""Write micro-SD logs of a Crazyflie by the description of their format."""

import struct
import zlib

import numpy as np
from scipy.spatial.transform import Rotation

EVENTS = {
    5: ("imu", "gyro.x(f) gyro.y(f) gyro.z(f) acc.x(f) acc.y(f) acc.z(f)"),
    9: ("slow", "motor.m1(H) motor.m2(H) motor.m3(H) motor.m4(H) pm.vbat(f) stateEstimateZ.quat(I)"),
    11: ("angles", "stateEstimate.roll(f) stateEstimate.pitch(f) stateEstimate.yaw(f)"),
}


def compress(quaternion: np.ndarray) -> int:
    """Return a quaternion, xyzw, as 2 bits for the place of the largest component, then sign and 9 bits of the others."""
    largest = int(np.argmax(np.abs(quaternion)))
    result = largest
    for value in np.delete(quaternion * np.sign(quaternion[largest]), largest):
        result = result << 10 | (512 if value < 0.0 else 0) | round(abs(value) * 511 * 2**0.5)
    return result


def card(version: int = 2, count: int = 100, seed: int = 0) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Return a log, the values of its IMU, and its attitudes as quaternions."""
    draw = np.random.default_rng(seed)
    imu, turns = draw.normal(size=(count, 6)).astype(np.float32), Rotation.random(count, random_state=0).as_quat()
    data = struct.pack("<BHH", 0xBC, version, len(EVENTS))
    for number, (name, variables) in EVENTS.items():
        fields = variables.split()
        data += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(fields))
        data += b"".join(field.encode() + b"\0" for field in fields)
    for i in range(count):
        stamp = struct.pack("<I", 1000 + 2 * i) if version == 1 else struct.pack("<Q", 1_000_000 + 2000 * i)
        data += struct.pack("<H", 5) + stamp + imu[i].tobytes()
        data += struct.pack("<H", 9) + stamp + struct.pack("<HHHHfI", 0, 13107, 32768, 65535, 3.9, compress(turns[i]))
        data += struct.pack("<H", 11) + stamp + struct.pack("<fff", 10.0, 20.0, 90.0)
    return data + struct.pack("<I", zlib.crc32(data)), imu, turns
