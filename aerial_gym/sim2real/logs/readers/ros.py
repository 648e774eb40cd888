"""Read bags of ROS 1 and ROS 2, and MCAP files with messages of ROS. Topics are found by their type. Letters: T samples.

World is z up and body is FLU by REP 103, so that the frames are those of this package.

Source: ROS REP 103 and 145; message definitions of ``common_interfaces`` and ``mavros_msgs`` (github ros2, mavlink).
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.extras import optional_import
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import LogChannel, LogMessage, RawLog, Topic, faster_first, note_on_rotor_order
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNITS
from aerial_gym.sim2real.logs.readers.ros_files import (
    DATABASE,
    MCAP,
    LayoutError,
    MessageLayout,
    MessageSource,
    decode_messages,
    json_columns,
    read_message_sources,
)
from aerial_gym.sim2real.logs.readers.ulog import UlogReader

METADATA = "metadata.yaml"  # File of a ROS 2 bag that stands for its folder
LONGEST_DEFINITION = 50_000  # Characters of a message definition; the longest of PX4 have 20,000
LARGEST_MESSAGE = 65_536  # Mean size [B] from which a topic, such as images, is listed without its content
STATUS_TEXT, MOST_TEXTS = "mavros_msgs/msg/StatusText", 5000
TEXTS = {
    STATUS_TEXT: ("severity", "text", (4, 5, 7)),  # Least numbers of warning, info and debug; smaller ones are errors
    "rosgraph_msgs/msg/Log": ("level", "msg", (2, 4, 8)),  # Least numbers of info, warning and error
    "rcl_interfaces/msg/Log": ("level", "msg", (20, 30, 40)),
}
"""Fields of level and text of messages for people, and limits between levels."""

SETPOINTS = re.compile(
    "setpoint|target|desired|reference|command|cmd|goal|_ref$", re.IGNORECASE
)  # Topics that measure nothing
NOT_GIVEN = -1.0  # First covariance of an orientation, rate or acceleration that an IMU does not measure, by REP 145
WORLD = ("attitude", "position", "lin_vel")  # Quantities with world axes
BARE_ARRAY = re.compile(
    r"std_msgs/msg/\w+MultiArray"
)  # Messages of numbers alone; the name of the topic tells their meaning
ROTOR_SPEEDS = re.compile(r"(motor|rotor|esc|prop).*(speed|rpm|omega|vel)|rpm", re.IGNORECASE)
LARGEST_RAD_S = 6000.0  # No propeller of a drone turns faster; larger numbers are revolutions per minute
LEAST_POSE_HZ = 10.0  # Lowest rate of an attitude that resolves the turns of a vehicle, below 5 Hz
ON_GROUND, IN_AIR = 1.0, 2.0  # ``landed_state`` of mavros_msgs/ExtendedState

VECTORS = (
    ("attitude", "nav_msgs/msg/Odometry", "pose.pose.orientation", "xyzw"),
    ("attitude", "geometry_msgs/msg/PoseStamped", "pose.orientation", "xyzw"),
    ("attitude", "geometry_msgs/msg/PoseWithCovarianceStamped", "pose.pose.orientation", "xyzw"),
    ("attitude", "geometry_msgs/msg/TransformStamped", "transform.rotation", "xyzw"),
    ("attitude", "sensor_msgs/msg/Imu", "orientation", "xyzw"),
    ("attitude", "geometry_msgs/msg/QuaternionStamped", "quaternion", "xyzw"),
    ("attitude", "geometry_msgs/msg/Pose", "orientation", "xyzw"),
    ("position", "nav_msgs/msg/Odometry", "pose.pose.position", "xyz"),
    ("position", "geometry_msgs/msg/PoseStamped", "pose.position", "xyz"),
    ("position", "geometry_msgs/msg/PoseWithCovarianceStamped", "pose.pose.position", "xyz"),
    ("position", "geometry_msgs/msg/TransformStamped", "transform.translation", "xyz"),
    ("position", "geometry_msgs/msg/PointStamped", "point", "xyz"),
    ("position", "geometry_msgs/msg/Pose", "position", "xyz"),
    ("lin_vel", "nav_msgs/msg/Odometry", "twist.twist.linear", "xyz"),
    ("lin_vel", "geometry_msgs/msg/TwistStamped", "twist.linear", "xyz"),
    ("lin_vel", "geometry_msgs/msg/TwistWithCovarianceStamped", "twist.twist.linear", "xyz"),
    ("lin_vel", "geometry_msgs/msg/Vector3Stamped", "vector", "xyz"),
    ("ang_vel", "sensor_msgs/msg/Imu", "angular_velocity", "xyz"),
    ("ang_vel", "nav_msgs/msg/Odometry", "twist.twist.angular", "xyz"),
    ("attitude", "agiros_msgs/msg/QuadState", "pose.orientation", "xyzw"),
    ("position", "agiros_msgs/msg/QuadState", "pose.position", "xyz"),
    ("lin_vel", "agiros_msgs/msg/QuadState", "velocity.linear", "xyz"),
    ("ang_vel", "agiros_msgs/msg/QuadState", "velocity.angular", "xyz"),
    ("specific_force", "sensor_msgs/msg/Imu", "linear_acceleration", "xyz"),
    ("battery", "sensor_msgs/msg/BatteryState", "", ("voltage",)),
    ("armed", "mavros_msgs/msg/State", "", ("armed",)),
)
"""Quantity, message type, field, and components, from the best to the worst source."""

MEASURED = {kind for _, kind, _, _ in VECTORS}  # Types of messages that a vehicle has once


class RosReader(LogReader):
    """Reader of ROS bags and MCAP files."""

    name = "ros"
    summary = "bags of ROS 1 and ROS 2, MCAP"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file, or the ``metadata.yaml`` of its folder, is one of ROS."""
        return head.startswith((b"#ROSBAG V", DATABASE, MCAP, b"rosbag2_bagfile_information"))

    def read(self, path: Path) -> RawLog:
        """Return one topic for each topic of the bag, with the numbers of its messages."""
        with optional_import("reading bags of ROS"):
            from rosbags.typesys import Stores, get_typestore  # pyright: ignore[reportMissingImports]
        standard = get_typestore(Stores.LATEST).fielddefs
        topics, notes, types, messages = list[Topic](), list[Finding](), dict[str, str](), list[LogMessage]()
        for source in read_message_sources(path.parent if path.name == METADATA and path.is_file() else path):
            columns: dict[str, Array] = {}
            if sum(map(len, source.messages)) < LARGEST_MESSAGE * len(source.messages):
                fields = {**standard, **_types_in_message_definition(source)}
                columns, error = _decode_source(source, fields)
                messages += _log_messages(source, fields)
                if error:
                    notes.append(Finding("topic_left_out", "", {"topic": source.topic, "error": error}))
            instance = sum(topic.name == source.topic for topic in topics)
            time = _message_times(columns, np.array(source.times, dtype=np.float64) * 1e-9)
            topics.append(Topic(name=source.topic, instance=instance, time=time, columns=columns))
            types[topics[-1].source] = source.type
        if not topics:
            raise DataError(f"{path}: holds no message of ROS")
        for name, root in _topics_of_other_vehicles(topics, types).items():
            error = f"topic {name} is of another vehicle or sensor than those below {root}"
            notes.append(Finding("topic_left_out", "", {"topic": name, "error": error}))
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(topics),
            metadata=types,
            messages=tuple(messages),
            notes=tuple(notes),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; of several sources a much faster one comes first."""
        unused = _topics_of_other_vehicles(log.topics, log.metadata)
        topics = [topic for topic in log.topics if topic.columns and not SETPOINTS.search(topic.name)]
        topics = [topic for topic in topics if topic.name not in unused]
        vectors = [
            channel
            for quantity, kind, field, components in VECTORS
            for topic in topics
            if log.metadata[topic.source] == kind
            for channel in _vector_channels(topic, quantity, field, components)
        ]
        rotors = [channel for topic in topics for channel in _mavros_channels(topic, log.metadata[topic.source])]
        return [*_sort_by_common_world_axes(faster_first(vectors)), *rotors, *_px4_channels(log)]


def _topics_of_other_vehicles(topics: Sequence[Topic], types: Mapping[str, str]) -> dict[str, str]:
    """Return the topics whose name and type occur below another name too, as of several vehicles, and the name that is used.

    It is the one with the most topics. Names such as ``/uav1/imu`` and ``/uav2/imu`` differ before their last part only.
    """
    topics = [topic for topic in topics if not SETPOINTS.search(topic.name)]
    names = {topic.name: tuple(topic.name.strip("/").split("/")) for topic in topics}
    first: dict[tuple[str, str, int], tuple[str, ...]] = {}
    roots = dict[tuple[str, ...], int]()
    for topic in topics:
        parts, kind = names[topic.name], types[topic.source]
        like = first.setdefault((kind, parts[-1], len(parts)), parts)
        place = next((i for i, (one, other) in enumerate(zip(parts, like, strict=True)) if one != other), None)
        if place is not None and kind in MEASURED:
            roots |= dict.fromkeys((like[: place + 1], parts[: place + 1]), 0)
    for root in roots:
        roots[root] = sum(parts[: len(root)] == root for parts in names.values())
    best = max(roots, key=lambda root: roots[root], default=())
    left = {name for name, parts in names.items() if any(parts[: len(root)] == root for root in roots if root != best)}
    return dict.fromkeys(sorted(left), "/" + "/".join(best))


def _sort_by_common_world_axes(channels: Sequence[LogChannel]) -> list[LogChannel]:
    """Return the channels, those of topics with most of attitude, position and velocity first, as world axes may differ."""
    sources = Counter(one.source for one in channels if one.quantity in WORLD)

    def key(one: LogChannel) -> int:
        fast = one.time.size > LEAST_POSE_HZ * np.ptp(one.time)
        return -sources[one.source] if fast and one.quantity in WORLD else 0

    return sorted(channels, key=key)


def _decode_source(source: MessageSource, fields: Any) -> tuple[dict[str, Array], str]:
    """Return the numbers of all messages by field, and the reason why some of them are missing."""
    name, count = f"topic {source.topic}", len(source.messages)
    if source.encoding == "json":
        try:
            return json_columns(source.messages), ""
        except (ValueError, RecursionError, AttributeError) as error:
            return {}, f"{name} has messages that are no JSON objects ({type(error).__name__})"
    if source.encoding not in ("cdr", "ros1"):
        return {}, f"{name} has messages in {source.encoding or 'no encoding'}, which are not read; log messages of ROS"
    if source.type not in fields:
        remedy = "convert the bag to MCAP where this type is installed (ros2 bag convert)"
        return {}, f"{name} has the type {source.type}, whose definition is not in the bag; {remedy}"
    columns, lost = decode_messages(source.messages, source.type, fields, is_cdr=source.encoding == "cdr")
    return columns, f"{lost} of {count} messages of {name} do not fit their definition" if lost else ""


def _log_messages(source: MessageSource, fields: Any) -> Iterator[LogMessage]:
    """Yield the texts of a topic with messages for people, at most ``MOST_TEXTS``."""
    level, text, levels = TEXTS.get(source.type, ("", "", ()))
    for time, data in zip(source.times[:MOST_TEXTS], source.messages, strict=False) if text else ():
        with suppress(LayoutError):
            layout = MessageLayout(data, source.type, fields, is_cdr=source.encoding == "cdr")
            place = layout.numbers.get(level, (len(data), None))[0]
            rank = sum(data[place : place + 1] >= bytes([least]) for least in levels)
            name = ("debug", "info", "warning", "error")[rank if source.type != STATUS_TEXT else 3 - rank]
            yield LogMessage(time=1e-9 * time, level=name, text=layout.texts.get(text, b"").decode("utf-8", "replace"))


def _types_in_message_definition(source: MessageSource) -> Any:
    """Return the fields by type that the definition of a message states; nothing if it cannot be parsed."""
    from rosbags.typesys import get_types_from_msg  # pyright: ignore[reportMissingImports]

    if not source.definition or len(source.definition) > LONGEST_DEFINITION:
        return {}
    try:
        return get_types_from_msg(source.definition, source.type)
    except Exception:  # the parser raises many types
        return {}


def _message_times(columns: dict[str, Array], recorded: Array) -> Array:
    """Return the times [s] of the headers; those of the records if the headers have none."""
    if {"header.stamp.sec", "header.stamp.nanosec"} <= columns.keys():
        stamps = columns["header.stamp.sec"] + 1e-9 * columns["header.stamp.nanosec"]
        if np.isfinite(stamps).all() and np.all(stamps > 0.0):
            return stamps
    return recorded


def _vector_channels(topic: Topic, quantity: str, field: str, components: Sequence[str]) -> Iterator[LogChannel]:
    names = [f"{field}.{component}" if field else component for component in components]
    is_absent = f"{field}_covariance[0]" in topic.columns and topic.columns[f"{field}_covariance[0]"][0] == NOT_GIVEN
    if is_absent or not set(names) <= topic.columns.keys():
        return
    values = topic.numbers(*names)
    if field == "vector":  # only the name tells what a bare vector is
        if re.search("ang|gyro|rate", topic.name, re.IGNORECASE):
            quantity = "ang_vel"
        elif not re.search("vel", topic.name, re.IGNORECASE):
            return
    if field.endswith("twist.linear") and "body" in topic.name and "pose.pose.position.x" not in topic.columns:
        return
    if quantity == "attitude" and not np.median(np.abs(np.linalg.norm(values, axis=1) - 1.0)) < 0.1:  # not given
        return
    if field == "twist.twist.linear":
        values = _world_velocity_of_odometry(topic, values)
    yield topic.channel(quantity, values)


def _world_velocity_of_odometry(topic: Topic, velocity: Array) -> Array:
    """Return the velocity of an odometry in world axes: by its definition it is in body axes, which some sources ignore."""
    parts = [
        [f"pose.pose.{part}.{axis}" for axis in axes] for part, axes in (("position", "xyz"), ("orientation", "xyzw"))
    ]
    if not topic.columns.keys() >= {*parts[0], *parts[1]}:  # a damaged definition
        return velocity
    position, attitude = (topic.numbers(*names) for names in parts)
    if topic.time.size < 3 or not np.all(np.linalg.norm(attitude, axis=1) > 0.5):
        return velocity
    turned = Rotation.from_quat(attitude).apply(velocity)
    steps = np.diff(topic.time)
    moving = steps > 0.0
    rates = np.diff(position, axis=0)[moving] / steps[moving, None]
    errors = [np.nanmedian(np.linalg.norm(one[1:][moving] - rates, axis=1)) for one in (turned, velocity)]
    return velocity if errors[1] < errors[0] else turned


def _mavros_channels(topic: Topic, kind: str) -> Iterator[LogChannel]:
    """Yield rotor speeds, motor signals and contact with the ground."""
    rows = {
        "mavros_msgs/msg/ESCStatus": ("rotor_speed", "esc_status[{}].rpm", UNITS["rpm"], 0.0),
        "mavros_msgs/msg/ESCTelemetry": ("rotor_speed", "esc_telemetry[{}].rpm", UNITS["rpm"], 0.0),
        "mav_msgs/msg/Actuators": ("rotor_speed", "angular_velocities[{}]", 1.0, 0.0),
        "actuator_msgs/msg/Actuators": ("rotor_speed", "velocity[{}]", 1.0, 0.0),
        "agiros_msgs/msg/QuadState": ("rotor_speed", "motors[{}]", 1.0, 0.0),
        "mavros_msgs/msg/RCOut": ("rotor_command", "channels[{}]", 1e-3, -1.0),
    }
    notes = note_on_rotor_order("the bag")
    if BARE_ARRAY.fullmatch(kind) and ROTOR_SPEEDS.search(topic.name):
        is_rpm = "rpm" in topic.name.lower() or any(
            one.max(initial=0.0) > LARGEST_RAD_S for one in topic.columns.values()
        )
        rows[kind] = ("rotor_speed", "data[{}]", UNITS["rpm"] if is_rpm else 1.0, 0.0)
        unit_note = Finding("rotor_unit_assumed", "", {"topic": topic.name, "unit": "rpm" if is_rpm else "rad/s"})
        notes = notes if "rpm" in topic.name.lower() else (*notes, unit_note)
    if kind in rows:
        quantity, pattern, unit, offset = rows[kind]
        names = [pattern.format(i) for i in range(16) if pattern.format(i) in topic.columns]
        values = topic.numbers(*names, unit=unit) + offset
        used = np.nanmax(values, axis=0, initial=-np.inf) > np.nanmin(values, axis=0, initial=np.inf)
        if used.any():
            values = np.abs(values[:, used]) if quantity == "rotor_speed" else np.clip(values[:, used], 0.0, 1.0)
            yield topic.channel(quantity, values, notes)
    if kind == "mavros_msgs/msg/ExtendedState" and "landed_state" in topic.columns:
        state = topic.columns["landed_state"]
        known = np.isin(state, (ON_GROUND, IN_AIR))
        if known.any():
            values = (state[known] == ON_GROUND).astype(float)[:, None]
            yield replace(topic.channel("landed", values), time=topic.time[known])


def _px4_channels(log: RawLog) -> Sequence[LogChannel]:
    """Return the channels of PX4's own messages, whose fields are those of its ULog files."""
    topics = []
    for topic in log.topics:
        package, _, name = log.metadata[topic.source].partition("/msg/")
        if package == "px4_msgs" and "timestamp" in topic.columns and "/in/" not in topic.name:
            name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
            topics.append(replace(topic, name=name, time=1e-6 * topic.columns["timestamp"]))
    return UlogReader().channels(replace(log, topics=tuple(topics))) if topics else ()
