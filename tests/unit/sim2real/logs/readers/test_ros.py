"""Bags of ROS 1 and ROS 2, and MCAP: every storage gives the same quantities; hostile files are refused."""

import bz2
import shutil
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.ros import RosReader
from tests.unit.sim2real.logs.readers.open_log_bytes import REAL_LOGS, first_channel, read_file

pytest.importorskip("rosbags")
from mcap.writer import Writer

from tests.unit.sim2real.logs.readers import ros_bags

DATA = REAL_LOGS / "rosbag" / "m100exp01.bag"


read = partial(read_file, kind=RosReader)
channel = partial(first_channel, reader=RosReader())


@pytest.mark.parametrize(
    "kind",
    [
        *("ros1", "ros1 bz2", "ros1 lz4", "ros1 nodes", "db3", "mcap", "db3 alone", "mcap alone", "db3 yaml"),
        *("db3 file", "mcap file", "db3 message", "mcap message"),
    ],
)
def test_every_storage_gives_the_same_quantities(tmp_path, kind) -> None:
    path = tmp_path / "log"
    storage, _, rest = kind.partition(" ")
    if storage == "ros1":
        path = path.with_suffix(".bag")
        many = rest == "nodes"
        numbers = ros_bags.write_bag(path, None if many else rest.upper() or None, nodes=1 + many)
    else:
        packed = rest.upper() if rest in ("file", "message") else None
        numbers = ros_bags.write_folder(path, "SQLITE3" if storage == "db3" else "MCAP", packed=packed)
    if rest == "yaml":
        path /= "metadata.yaml"
    if rest == "alone":
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


def test_the_files_of_a_split_bag_are_one_log(tmp_path) -> None:
    numbers = ros_bags.write_folder(tmp_path / "log", "SQLITE3")
    (first,) = (tmp_path / "log").glob("*.db3")
    second = first.with_name("z.db3")
    shutil.copy(first, second)
    for path, half in ((first, ">="), (second, "<")):
        with closing(sqlite3.connect(path)) as base, base:
            base.execute(f"DELETE FROM messages WHERE timestamp {half} {1_700_000_000_300_000_000}")
    np.testing.assert_array_equal(channel(read(tmp_path / "log"), "ang_vel").values, numbers["gyro"])


@pytest.mark.parametrize("encoding", ["protobuf", "cbor"])
def test_messages_that_are_not_of_ros_are_named(tmp_path, encoding) -> None:
    with (tmp_path / "log").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_channel(topic="/imu", message_encoding=encoding, schema_id=0)
        writer.add_message(channel_id=number, log_time=5, publish_time=5, data=b"{}")
        writer.finish()
    (note,) = read(tmp_path / "log").notes
    assert encoding in note.values["error"]


def test_messages_of_ros_in_json_are_read(tmp_path) -> None:
    with (tmp_path / "log").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="sensor_msgs/msg/Imu", encoding="jsonschema", data=b"{}")
        number = writer.register_channel(topic="/imu", message_encoding="json", schema_id=schema)
        for i in range(3):
            data = f'{{"angular_velocity": {{"x": {i}.0, "y": 2.0, "z": 3.0}}}}'.encode()
            writer.add_message(channel_id=number, log_time=i, publish_time=i, data=data)
        writer.finish()
    log = read(tmp_path / "log")
    (channel,) = [one for one in RosReader().channels(log) if one.quantity == "ang_vel"]
    np.testing.assert_array_equal(channel.values, [[0.0, 2.0, 3.0], [1.0, 2.0, 3.0], [2.0, 2.0, 3.0]])


def test_a_type_without_definition_is_named(tmp_path) -> None:
    ros_bags.write_folder(tmp_path / "log", "SQLITE3")
    (path,) = (tmp_path / "log").glob("*.db3")
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("UPDATE topics SET type = 'px4_msgs/msg/VehicleAttitude'")
    assert all("px4_msgs/msg/VehicleAttitude" in note.values["error"] for note in read(path).notes)


def test_texts_for_people_become_messages(tmp_path) -> None:
    types = ros_bags.get_typestore(ros_bags.Stores.ROS1_NOETIC)
    make, kind = types.types, "rosgraph_msgs/msg/Log"
    with ros_bags.Writer1(tmp_path / "log.bag") as writer:
        link = writer.add_connection("/rosout", kind, typestore=types)
        for level, text in ((1, "tick"), (4, "low battery"), (8, "lost")):
            head = make["std_msgs/msg/Header"](0, make["builtin_interfaces/msg/Time"](1, 0), "")
            row = make[kind](head, level, "node", text, "file", "function", 1, [])
            writer.write(link, 5_000_000_000, types.serialize_ros1(row, kind))
    log = read(tmp_path / "log.bag")
    assert [(one.level, one.text) for one in log.messages] == [
        ("debug", "tick"), ("warning", "low battery"), ("error", "lost"),
    ]  # fmt: skip
    assert log.messages[0].time == 5.0


def test_an_orientation_that_an_imu_does_not_give_is_none() -> None:
    """Its covariance begins with -1, and the orientation may be any, such as level."""
    columns = {f"orientation.{axis}": np.full(3, float(axis == "w")) for axis in "xyzw"}
    columns |= {"orientation_covariance[0]": np.full(3, -1.0)} | {
        f"angular_velocity.{axis}": np.ones(3) for axis in "xyz"
    }
    topic = Topic(name="/imu", time=np.arange(3.0), columns=columns)
    log = RawLog(path="a", format="ros", topics=(topic,), metadata={"/imu[0]": ros_bags.IMU})
    assert [one.quantity for one in RosReader().channels(log)] == ["ang_vel"]


@pytest.mark.parametrize(
    ("name", "kind", "field", "raw", "expected", "assumed"),
    [
        ("/mavros/rc/out", "mavros_msgs/msg/RCOut", "channels", (1200, 1700, 0, 0), (0.2, 0.7), False),
        ("/pilot/state", "agiros_msgs/msg/QuadState", "motors", (900, 950, 800, 850), (900, 950, 800, 850), False),
        ("/motor_rpm", "std_msgs/msg/Float32MultiArray", "data", (3000, 6000), (314.16, 628.32), False),
        ("/rotors/speed", "std_msgs/msg/Float64MultiArray", "data", (900, 950), (900, 950), True),
        ("/esc/speeds", "std_msgs/msg/Int32MultiArray", "data", (30000, 6000), (3141.6, 628.32), True),
    ],
)
def test_rotors_are_found_by_type_or_by_the_name_of_an_array(name, kind, field, raw, expected, assumed) -> None:
    """Outputs that never change drive no rotor; an array without a unit in its name is named."""
    steps = np.array((1.0, 1.001, 1.002))
    columns = {f"{field}[{i}]": value * steps for i, value in enumerate(raw)}
    topics = (Topic(name=name, time=np.arange(3.0), columns=columns),)
    (one,) = RosReader().channels(RawLog(path="a", format="ros", topics=topics, metadata={f"{name}[0]": kind}))
    np.testing.assert_allclose(one.values[0], expected, rtol=1e-4)
    assert ("rotor_unit_assumed" in {note.code for note in one.notes}) == assumed


@pytest.mark.parametrize(("rate", "used"), [(20.0, "/odom[0]"), (2.0, "/imu[0]")])
def test_attitude_comes_from_the_topic_of_position_and_velocity_if_that_is_fast_enough(rate, used) -> None:
    """Heading of an IMU and axes of an odometry may differ."""
    fields = ("orientation.{}", "pose.pose.orientation.{}", "pose.pose.position.{}", "twist.twist.linear.{}")
    columns = {field.format(axis): np.full(40, float(axis == "w")) for field in fields for axis in "xyzw"}
    imu, odometry = (
        Topic(name=name, time=np.arange(40) / hz, columns=columns) for name, hz in (("/imu", 200.0), ("/odom", rate))
    )
    imu = replace(imu, time=np.repeat(imu.time, 10), columns={key: np.repeat(all, 10) for key, all in columns.items()})
    types = {"/imu[0]": ros_bags.IMU, "/odom[0]": ros_bags.ODOMETRY}
    log = RawLog(path="a", format="ros", topics=(imu, odometry), metadata=types)
    assert channel(log, "attitude").source == used


@pytest.mark.parametrize(
    ("names", "used"),
    [
        (("/b/imu", "/a/imu", "/a/odom"), {"/a/imu", "/a/odom"}),  # two vehicles
        (("/vrpn/wall/pose", "/vrpn/uav/pose", "/imu"), {"/vrpn/wall/pose", "/imu"}),  # the first of equals
        (("/mavros/setpoint_position/pose", "/mavros/local_position/pose"), {"/mavros/local_position/pose"}),
        (("/mavros/imu/data", "/mavros/imu/data_raw", "/vicon/uav/odom"), None),
    ],
)
def test_topics_of_other_vehicles_are_left_out(names, used) -> None:
    kinds = {"imu": ros_bags.IMU, "data": ros_bags.IMU, "data_raw": ros_bags.IMU, "odom": ros_bags.ODOMETRY}
    types = {f"{name}[0]": kinds.get(name.rpartition("/")[2], "geometry_msgs/msg/PoseStamped") for name in names}
    fields = {"angular_velocity", "pose.position", "pose.pose.position"}
    columns = {f"{field}.{axis}": np.ones(3) for field in fields for axis in "xyz"}
    topics = tuple(Topic(name=name, time=np.arange(3.0), columns=columns) for name in names)
    log = RawLog(path="a", format="ros", topics=topics, metadata=types)
    assert {one.source.removesuffix("[0]") for one in RosReader().channels(log)} == (used or set(names))


@pytest.mark.parametrize("head", [b"#ROSBAG V1.2\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x89MCAP0\r\n"])
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
