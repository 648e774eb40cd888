"""Telemetry logs of MAVLink: layouts by their published CRC_EXTRA, packets of both versions, clocks, channels and damage."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.mavlink import MESSAGES, MavlinkMessage, MavlinkReader
from tests.unit.sim2real.logs.readers import mavlink_files as files
from tests.unit.sim2real.logs.readers.open_log_bytes import first_channel, read_bytes

read = partial(read_bytes, kind=MavlinkReader)
channel = partial(first_channel, reader=MavlinkReader())
NAMES = {
    **{"u1": "uint8_t", "i1": "int8_t", "S1": "char", "u2": "uint16_t", "i2": "int16_t", "u4": "uint32_t"},
    **{"i4": "int32_t", "f4": "float", "u8": "uint64_t"},
}


@pytest.mark.parametrize("number", list(MESSAGES))
def test_each_layout_has_the_published_crc_extra(number: int) -> None:
    """It is a checksum of names, types and order of the fields, without extensions."""
    message = MavlinkMessage(text=MESSAGES[number].partition(" | ")[0])
    text = f"{message.name} ".encode()
    for name in message.record.names or ():
        base, shape = (message.record[name].base, message.record[name].shape)
        kind = NAMES[base.str.lstrip("<|")] + ("_mavlink_version" if name == "mavlink_version" else "")
        text += f"{kind} {name} ".encode() + bytes(shape)
    if message.name == "HEARTBEAT":
        text = text.replace(b"_mavlink_version ", b" ", 1)
    crc = files.checksum(text)
    assert (crc & 0xFF) ^ (crc >> 8) == files.EXTRA[message.name]


@pytest.mark.parametrize(("version", "signed"), [(1, False), (2, False), (2, True)])
def test_messages_become_channels_in_si_units_enu_and_flu(version: int, signed: bool, tmp_path) -> None:
    data, numbers = files.log(version=version, signed=signed)
    log = read(tmp_path, data)
    assert log.notes == ()
    gyro = channel(log, "ang_vel")
    assert gyro.source == "RAW_IMU[0]"
    np.testing.assert_allclose(gyro.values, 1e-3 * numbers["imu"][:, 3:] * (1.0, -1.0, -1.0))
    np.testing.assert_allclose(np.diff(gyro.time), 0.02, atol=1e-9)  # the vehicle's stamps, not the link's
    np.testing.assert_allclose(channel(log, "specific_force").values[:, 0], 9.80665e-3 * numbers["imu"][:, 0])
    north, east, down = numbers["place"][::5, :3].T
    np.testing.assert_allclose(channel(log, "position").values, np.stack((east, north, -down), axis=1))
    roll, pitch, yaw = numbers["attitude"][7, :3]
    expected = Rotation.from_euler("ZYX", (0.5 * np.pi - yaw, -pitch, roll))
    assert (Rotation.from_quat(channel(log, "attitude").values[7]).inv() * expected).magnitude() < 1e-6
    outputs = np.clip((numbers["outputs"][::5, :4] - 1100.0) / 800.0, 0.0, 1.0)
    np.testing.assert_allclose(channel(log, "rotor_command").values, outputs)
    assert channel(log, "battery").values[0, 0] == pytest.approx(15.5)
    assert channel(log, "armed").values[:3, 0].tolist() == [0.0, 0.0, 1.0]
    assert log.parameters["MOT_PWM_MAX"] == 1900.0
    assert [(one.level, one.text) for one in log.messages] == [("error", "PreArm: check the compass")]


def test_a_restart_of_the_vehicle_keeps_its_pause(tmp_path) -> None:
    """Its clock begins anew, that of the ground station does not."""
    packets = list[bytes]()
    for at, boot in zip((0, 1, 2, 50, 51), (30, 31, 32, 4, 5), strict=True):
        packets.append(files.packet("ATTITUDE", 1_700_000_000_000_000 + 10**6 * at, 1000 * boot, *6 * [0.0]))
    (topic,) = read(tmp_path, b"".join(packets)).topics
    np.testing.assert_allclose(topic.time - topic.time[0], (0.0, 1.0, 2.0, 50.0, 51.0), atol=1e-6)


def test_damaged_bytes_lose_only_the_packets_that_they_touch(tmp_path) -> None:
    data, _ = files.log()
    place = data.index(b"\xfd", len(data) // 2)
    whole, log = read(tmp_path, data), read(tmp_path, data[:place] + bytes(300) + data[place + 5 :])
    assert log.notes[0].code == "bytes_left_out"
    left, right = (sum(topic.time.size for topic in one.topics) for one in (whole, log))
    assert 0 < left - right <= 3
    with pytest.raises(DataError):
        read(tmp_path, files.packet("STATUSTEXT", 1_700_000_000_000_000, 3, "a"))
