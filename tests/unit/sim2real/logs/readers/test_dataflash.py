"""ArduPilot logs: messages by type and instance, units, damaged bytes, channels, and a log of other people."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.dataflash import DataflashReader
from tests.unit.sim2real.logs.readers import dataflash_files as files
from tests.unit.sim2real.logs.readers.open_log_bytes import REAL_LOGS, first_channel, read_bytes

DATA = REAL_LOGS / "ardupilot" / "copter364_two_flights.bin"


read = partial(read_bytes, kind=DataflashReader)
channel = partial(first_channel, reader=DataflashReader())


def test_messages_become_topics_by_instance_with_units(tmp_path) -> None:
    data, numbers = files.log()
    log = read(tmp_path, data)
    second = next(topic for topic in log.topics if topic.source == "IMU[1]")
    np.testing.assert_array_equal(second.columns["AccZ"], numbers["imu"][:, 1, 5])
    np.testing.assert_allclose(second.time, 2.0 + 0.01 * np.arange(400), rtol=1e-15)
    assert second.units["GyrX"] == "rad/s"
    assert second.units["TimeUS"] == "1e-06 s"
    assert log.parameters["MOT_PWM_MAX"] == 1900.0
    assert log.metadata == {"firmware": "ArduCopter V4.5.1 (00000000)"}
    assert log.notes == ()


def test_channels_are_in_si_units_enu_and_flu(tmp_path) -> None:
    data, numbers = files.log()
    log = read(tmp_path, data)
    np.testing.assert_allclose(channel(log, "ang_vel").values, numbers["imu"][:, 0, :3] * (1.0, -1.0, -1.0))
    north, east, down = numbers["ekf"][::2, 3:].T
    np.testing.assert_allclose(channel(log, "position").values, np.stack((east, north, -down), axis=1))
    attitude = Rotation.from_quat(channel(log, "attitude").values[0])
    roll, pitch, _ = np.radians(0.01 * numbers["attitude"][0])
    east_and_level = Rotation.from_euler("ZYX", (0.0, -pitch, roll))  # heading 90 deg is east; nose up is -y of FLU
    assert (attitude.inv() * east_and_level).magnitude() < 1e-9
    assert channel(log, "battery").values[0, 0] == 15.5
    assert channel(log, "armed").values[:, 0].tolist() == [0.0, 1.0]


def test_rotors_follow_the_functions_of_the_outputs(tmp_path) -> None:
    """Motors 1 to 4 are on outputs 8 to 5, whose signals run from 1100 to 1900 us."""
    data, numbers = files.log()
    log = read(tmp_path, data)
    expected = np.clip((numbers["outputs"][::2, [7, 6, 5, 4]] - 1100.0) / 800.0, 0.0, 1.0)
    np.testing.assert_allclose(channel(log, "rotor_command").values, expected)
    np.testing.assert_allclose(channel(log, "rotor_speed").values, numbers["rpm"][::2, ::-1] * np.pi / 30.0, rtol=1e-6)


def test_damaged_bytes_lose_only_the_messages_that_they_touch(tmp_path) -> None:
    data, numbers = files.log()
    place = data.index(files.message("IMU", 4_000_000, 0, *numbers["imu"][200, 0].tolist()))
    log = read(tmp_path, data[: place + 10] + b"\xa3\x95\x10" * 150 + data[place + 10 :])
    assert log.notes[0].code == "bytes_left_out"
    time = channel(log, "ang_vel").time
    assert time.size == 399
    assert not np.any(np.isclose(time, 4.0))


def test_a_head_within_a_message_begins_no_message(tmp_path) -> None:
    head = int.from_bytes(b"\xa3\x95", "little", signed=True)
    raw = files.message("RAW", 2_000_000, [head, 0x87] * 16)
    log = read(tmp_path, files.log()[0] + raw * 3)
    topic = next(one for one in log.topics if one.name == "RAW")
    assert topic.columns["x[30]"].tolist() == [head] * 3
    assert log.notes == ()


@pytest.mark.parametrize(
    ("old", "new"), [(b"MultIds", b"MultIdz"), (b"Name,Value", b"Name,Valve"), (b"Id,Label", b"Ib,Label")]
)
def test_a_damaged_definition_leaves_the_sensors(tmp_path, old, new) -> None:
    data, _ = files.log()
    log = read(tmp_path, data.replace(old, new))
    assert channel(log, "ang_vel").time.size == 400


@pytest.mark.parametrize("data", [b"\xa3\x95", b"\xa3\x95\x80" + bytes(200), files.definitions()])
def test_a_log_without_sensors_is_refused(tmp_path, data) -> None:
    with pytest.raises(DataError):
        read(tmp_path, data)


@pytest.mark.skipif(not DATA.exists(), reason="needs the logs of other people")
def test_a_log_of_other_people_is_read() -> None:
    """Numbers by pymavlink 2.4.50, which decodes all values alike."""
    log = DataflashReader().read(DATA)
    assert channel(log, "ang_vel").time.size == 1820
    assert len(log.parameters) == 809
