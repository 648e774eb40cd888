"""Write bags of ROS 1 and ROS 2, and MCAP files, by the writers of rosbags."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

IMU, ODOMETRY, BATTERY, VECTOR = (
    *("sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "sensor_msgs/msg/BatteryState"),
    "geometry_msgs/msg/Vector3Stamped",
)


def messages(
    types: Any, count: int, seed: int, *, seq: bool
) -> tuple[list[tuple[str, str, int, Any]], dict[str, np.ndarray]]:
    """Return (topic, type, time [ns], message) of a flight, and its numbers; frames have names of two lengths."""
    draw = np.random.default_rng(seed)
    numbers = {name: draw.normal(size=(count, 3)) for name in ("gyro", "force", "position")}
    quaternions = draw.normal(size=(count, 4))
    numbers["attitude"] = quaternions / np.linalg.norm(quaternions, axis=1)[:, None]
    numbers["body_velocity"] = draw.normal(size=(count, 3))
    make = types.types
    result = []

    def header(i: int) -> Any:
        nanoseconds = 1_700_000_000_000_000_000 + 10_000_000 * i
        stamp = make["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 1_000_000_000))
        order = {"seq": i} if seq else {}
        return make["std_msgs/msg/Header"](**order, stamp=stamp, frame_id="base" if i % 3 else "base_link")

    def vector(values: np.ndarray, kind: str = "Vector3") -> Any:
        return make[f"geometry_msgs/msg/{kind}"](*(float(value) for value in values))

    for i in range(count):
        gyro, force, position, attitude, velocity = (one[i] for one in numbers.values())
        turn = vector(attitude, "Quaternion")
        imu = make[IMU](header(i), turn, np.zeros(9), vector(gyro), np.zeros(9), vector(force), np.zeros(9))
        pose = make["geometry_msgs/msg/Pose"](vector(position, "Point"), turn)
        pose = make["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
        twist = make["geometry_msgs/msg/Twist"](vector(velocity), vector(gyro))
        twist = make["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36))
        late = 1_700_000_000_000_000_000 + 10_000_000 * i + 3_000_000
        result += [("/imu", IMU, late, imu), ("/odom", ODOMETRY, late, make[ODOMETRY](header(i), "base", pose, twist))]
        result += [("/setpoint/velocity", VECTOR, late, make[VECTOR](header(i), vector(velocity)))]
    return result, numbers


def write_bag(
    path: Path, compression: str | None = None, count: int = 60, seed: int = 0, nodes: int = 1
) -> dict[str, np.ndarray]:
    """Write a bag of ROS 1, whose topics come from several nodes in turn, and return its numbers."""
    types = get_typestore(Stores.ROS1_NOETIC)
    rows, numbers = messages(types, count, seed, seq=True)
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        keys = {(topic, kind, node): None for topic, kind, _, _ in rows for node in range(nodes)}
        links = {key: writer.add_connection(*key[:2], typestore=types, callerid=str(key[2])) for key in keys}
        for i, (topic, kind, time, message) in enumerate(rows):
            writer.write(links[topic, kind, i % nodes], time, types.serialize_ros1(message, kind))
    return numbers


def write_folder(
    path: Path, storage: str, count: int = 60, seed: int = 0, packed: str | None = None
) -> dict[str, np.ndarray]:
    """Write the folder of a ROS 2 bag, ``SQLITE3`` or ``MCAP``, packed by ``FILE`` or ``MESSAGE``, and return its numbers."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    rows, numbers = messages(types, count, seed, seq=False)
    writer = Writer2(path, version=9, storage_plugin=StoragePlugin[storage])
    if packed is not None:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with writer:
        links = {
            key: writer.add_connection(*key, typestore=types) for key in dict.fromkeys((row[0], row[1]) for row in rows)
        }
        for topic, kind, time, message in rows:
            writer.write(links[topic, kind], time, types.serialize_cdr(message, kind))
    return numbers
