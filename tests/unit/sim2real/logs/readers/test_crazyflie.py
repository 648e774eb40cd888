"""Micro-SD logs of a Crazyflie: both versions, units, damage, and a log of other people."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog
from aerial_gym.sim2real.logs.readers.crazyflie import CrazyflieReader
from aerial_gym.sim2real.logs.readers.log_readers import find_reader

DATA = Path(__file__).parents[5].parent / "shared" / "data" / "real_logs" / "crazyflie" / "usd_log05"
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


def read(tmp_path: Path, data: bytes) -> RawLog:
    path = tmp_path / "log"
    path.write_bytes(data)
    reader = find_reader(path)
    assert isinstance(reader, CrazyflieReader)
    return reader.read(path)


def channels(log: RawLog, quantity: str) -> list[LogChannel]:
    return [one for one in CrazyflieReader().channels(log) if one.quantity == quantity]


@pytest.mark.parametrize("version", [1, 2])
def test_channels_are_in_si_units(tmp_path, version) -> None:
    data, imu, turns = card(version)
    log = read(tmp_path, data)
    assert log.notes == ()
    gyro = channels(log, "ang_vel")[0]
    np.testing.assert_allclose(gyro.values, np.radians(imu[:, :3]), rtol=1e-6)
    np.testing.assert_allclose(gyro.time, 1.0 + 0.002 * np.arange(100), rtol=1e-12)
    np.testing.assert_allclose(channels(log, "specific_force")[0].values, 9.80665 * imu[:, 3:], rtol=1e-6)
    np.testing.assert_allclose(channels(log, "rotor_command")[0].values[0], (0.0, 0.2, 32768 / 65535, 1.0))
    compressed, angles = channels(log, "attitude")
    errors = (Rotation.from_quat(compressed.values).inv() * Rotation.from_quat(turns)).magnitude()
    assert errors.max() < 5e-3  # 9 bits of 1 / sqrt(2)
    nose_up = Rotation.from_euler("ZYX", (90.0, -20.0, 10.0), degrees=True)
    assert (Rotation.from_quat(angles.values[0]).inv() * nose_up).magnitude() < 1e-6


def test_an_unknown_event_ends_the_log_with_a_note(tmp_path) -> None:
    data, _, _ = card()
    log = read(tmp_path, data[:-4] + b"\x77\x77" * 50 + data[-4:])
    assert log.notes[0].code == "bytes_left_out"
    assert log.topics[0].time.size == 100


def test_a_changed_byte_is_noted(tmp_path) -> None:
    data, _, _ = card()
    log = read(tmp_path, data[:-30] + bytes([data[-30] ^ 1]) + data[-29:])
    assert log.notes[0].code == "checksum_wrong"


@pytest.mark.parametrize(
    "data", [card()[0][:60], card(count=0)[0], b"\xbc\x02\x00\xff\xff\x05\x00imu\x00\xff\xffa(x)\x00"]
)
def test_damaged_definitions_and_empty_logs_are_refused(tmp_path, data) -> None:
    with pytest.raises(DataError):
        read(tmp_path, data)


@pytest.mark.skipif(not DATA.exists(), reason="needs the logs of other people")
def test_a_log_of_other_people_is_read() -> None:
    log = CrazyflieReader().read(DATA)
    assert log.notes == ()
    force = channels(log, "specific_force")[0].values
    assert np.median(np.linalg.norm(force, axis=1)) == pytest.approx(9.81, rel=0.02)
