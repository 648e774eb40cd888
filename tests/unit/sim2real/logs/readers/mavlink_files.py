"""Write telemetry logs of MAVLink by the layout of its packets, with our own checksum."""

import struct
from typing import Any

import numpy as np

LAYOUTS = {
    "HEARTBEAT": (0, 50, "<IBBBBB"),
    "SYS_STATUS": (1, 124, "<IIIHHhHHHHHHb"),
    "PARAM_VALUE": (22, 220, "<fHH16sB"),
    "RAW_IMU": (27, 144, "<Qhhhhhhhhh"),
    "ATTITUDE": (30, 39, "<Iffffff"),
    "LOCAL_POSITION_NED": (32, 185, "<Iffffff"),
    "SERVO_OUTPUT_RAW": (36, 222, "<IHHHHHHHHB"),
    "HIGHRES_IMU": (105, 93, "<QfffffffffffffH"),
    "STATUSTEXT": (253, 83, "<B50s"),
}
"""Number, CRC_EXTRA and payload of each message. Source: MAVLink guide, and headers that its generator makes of common.xml."""

EXTRA = {
    **{name: extra for name, (_, extra, _) in LAYOUTS.items()},
    **{"SCALED_IMU": 170, "ATTITUDE_QUATERNION": 246, "ATTITUDE_TARGET": 22, "POSITION_TARGET_LOCAL_NED": 140},
    **{"EXTENDED_SYS_STATE": 130, "ESC_STATUS": 10, "ESC_TELEMETRY_1_TO_4": 144, "ESC_TELEMETRY_5_TO_8": 133},
}


def checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def packet(name: str, received_us: int, *values: Any, version: int = 2, system: int = 1, signed: bool = False) -> bytes:
    number, extra, layout = LAYOUTS[name]
    payload = struct.pack(layout, *(value.encode() if isinstance(value, str) else value for value in values))
    if version == 2:
        payload = payload.rstrip(b"\0") or b"\0"
        body = struct.pack("<BBBBBBHB", len(payload), signed, 0, 0, system, 1, number & 0xFFFF, number >> 16) + payload
    else:
        body = struct.pack("<BBBBB", len(payload), 0, system, 1, number) + payload
    crc = struct.pack("<H", checksum(body + bytes([extra])))
    magic = b"\xfd" if version == 2 else b"\xfe"
    return struct.pack(">Q", received_us) + magic + body + crc + bytes(13 * signed)


def log(seed: int = 0, count: int = 300, version: int = 2, signed: bool = False) -> tuple[bytes, dict[str, np.ndarray]]:
    """Return the telemetry of a copter at 50 Hz with other rates and a ground station, and its numbers."""
    draw = np.random.default_rng(seed)
    numbers = {name: draw.normal(size=(count, 6)).astype(np.float32) for name in ("attitude", "place")}
    numbers |= {"imu": draw.integers(-900, 900, (count, 6)), "outputs": draw.integers(1000, 2000, (count, 8))}
    data = b""

    def add(name: str, at: int, *values: Any, system: int = 1) -> None:
        nonlocal data
        data += packet(name, 1_700_000_000_000_000 + at, *values, version=version, system=system, signed=signed)

    add("HEARTBEAT", 0, 0, 2, 3, 0, 4, 3)
    for name, value in {"FRAME_CLASS": 1.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}.items():
        add("PARAM_VALUE", 0, value, 3, 0, name, 9)
    add("STATUSTEXT", 0, 3, "PreArm: check the compass")
    for i in range(count):
        boot, at = 5000 + 20 * i, 20_000 * i + int(draw.integers(500, 15_000))
        add("ATTITUDE", at, boot, *numbers["attitude"][i].tolist())
        add("ATTITUDE", at, 999, *6 * [0.0], system=255)
        add("RAW_IMU", at, 1000 * boot, *numbers["imu"][i].tolist(), 0, 0, 0)
        if i % 5 == 0:
            add("LOCAL_POSITION_NED", at, boot, *numbers["place"][i].tolist())
            add("SERVO_OUTPUT_RAW", at, 1000 * boot, *numbers["outputs"][i].tolist(), 0)
        if i % 50 == 0:
            add("HEARTBEAT", at, 0, 2, 3, 128 * (i >= 50), 4, 3)
            add("SYS_STATUS", at, 0, 0, 0, 0, 15500, 0, 0, 0, 0, 0, 0, 0, 80)
    return data, numbers
