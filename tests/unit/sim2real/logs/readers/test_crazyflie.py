"""Micro-SD logs of a Crazyflie: both versions, units, damage, and a log of other people."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog, Topic
from aerial_gym.sim2real.logs.readers.crazyflie import CrazyflieReader
from tests.unit.sim2real.logs.readers.crazyflie_files import card
from tests.unit.sim2real.logs.readers.open_log_bytes import REAL_LOGS, read_bytes

DATA = REAL_LOGS / "crazyflie" / "usd_log05"


read = partial(read_bytes, kind=CrazyflieReader)


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


def test_the_supervisor_tells_arming_and_flight() -> None:
    topic = Topic(name="a", time=np.arange(3.0), columns={"supervisor.info": np.array([1.0, 11.0, 27.0])})
    log = RawLog(path="a", format="crazyflie", topics=(topic,))
    assert channels(log, "armed")[0].values[:, 0].tolist() == [0.0, 1.0, 1.0]
    assert channels(log, "landed")[0].values[:, 0].tolist() == [1.0, 1.0, 0.0]


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
