"""Bags of ROS 1 and ROS 2, and MCAP: every storage gives the same quantities; hostile files are refused."""

import bz2
import struct
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.ros import RosReader
from tests.unit.sim2real.logs.readers.open_log_bytes import REAL_LOGS, first_channel, read_file

pytest.importorskip("rosbags")
from tests.unit.sim2real.logs.readers import ros_bags

DATA = REAL_LOGS / "rosbag" / "m100exp01.bag"


read = partial(read_file, kind=RosReader)
channel = partial(first_channel, reader=RosReader())


@pytest.mark.parametrize("kind", ["ros1", "ros1 bz2", "ros1 lz4", "db3", "mcap", "db3 file", "mcap file"])
def test_every_storage_gives_the_same_quantities(tmp_path, kind) -> None:
    path = tmp_path / "log"
    storage, _, rest = kind.partition(" ")
    if storage == "ros1":
        path = path.with_suffix(".bag")
        numbers = ros_bags.write_bag(path, rest.upper() or None)
    else:
        numbers = ros_bags.write_folder(path, "SQLITE3" if storage == "db3" else "MCAP")
    if rest == "file":
        (path,) = path.glob(f"*.{storage}")
    log = read(path)
    assert log.notes == ()
    np.testing.assert_array_equal(channel(log, "ang_vel").values, numbers["gyro"])
    np.testing.assert_array_equal(channel(log, "specific_force").values, numbers["force"])
    np.testing.assert_array_equal(channel(log, "position").values, numbers["position"])
    np.testing.assert_array_equal(channel(log, "attitude").values, numbers["attitude"])
    np.testing.assert_allclose(channel(log, "ang_vel").time, 1.7e9 + 0.01 * np.arange(60), atol=1e-6, rtol=0.0)
    world = Rotation.from_quat(numbers["attitude"]).apply(numbers["body_velocity"])
    velocities = [one for one in RosReader().channels(log) if one.quantity == "lin_vel"]
    assert [one.source for one in velocities] == ["/odom[0]"]  # a setpoint is no measurement
    # the positions are noise here, so that either axes may fit them
    assert min(np.abs(velocities[0].values - one).max() for one in (world, numbers["body_velocity"])) < 1e-12


def test_an_unfinished_bag_is_read_up_to_its_end(tmp_path) -> None:
    path = tmp_path / "log.bag"
    ros_bags.write_bag(path, count=200)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert 50 < channel(read(path), "ang_vel").time.size < 150


def test_a_chunk_that_fills_the_memory_is_refused(tmp_path) -> None:
    """300 MB of zeros are less than a kilobyte in bz2."""
    machine = bz2.BZ2Compressor()
    bomb = b"".join(machine.compress(bytes(10_000_000)) for _ in range(30)) + machine.flush()
    header = b"".join(struct.pack("<I", len(text)) + text for text in (b"op=\x05", b"compression=bz2"))
    path = tmp_path / "bomb"
    path.write_bytes(b"#ROSBAG V2.0\n" + struct.pack("<I", len(header)) + header + struct.pack("<I", len(bomb)) + bomb)
    with pytest.raises(DataError, match="grow"):
        read(path)


@pytest.mark.parametrize("head", [b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x89MCAP0\r\n"])
def test_a_file_without_messages_is_refused(tmp_path, head) -> None:
    path = tmp_path / "log"
    path.write_bytes(head + bytes(500))
    with pytest.raises(DataError):
        read(path)


@pytest.mark.skipif(not DATA.exists(), reason="needs the logs of other people")
def test_a_bag_of_other_people_is_read() -> None:
    """Its IMU is at rest while the vehicle moves, which later checks find."""
    log = read(DATA)
    assert channel(log, "ang_vel").time.size == 4078
    assert np.abs(channel(log, "lin_vel").values).max() > 1.0
    assert np.abs(channel(log, "ang_vel").values).max() < 0.02


def test_a_velocity_beside_a_damaged_attitude_stays_as_logged(tmp_path) -> None:
    ros_bags.write_bag(tmp_path / "log.bag", None)
    log = read(tmp_path / "log.bag")
    topics = [
        replace(topic, columns={k: v for k, v in topic.columns.items() if k != "pose.pose.orientation.z"})
        for topic in log.topics
    ]
    assert any("twist.twist.linear.x" in topic.columns for topic in topics)
    velocity = channel(replace(log, topics=tuple(topics)), "lin_vel")
    topic = next(topic for topic in topics if "twist.twist.linear.x" in topic.columns)
    np.testing.assert_allclose(velocity.values[:, 0], topic.columns["twist.twist.linear.x"])
