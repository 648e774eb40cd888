"""Setpoints in logs: targets of position, velocity, heading, attitude, body rates and thrust. Letters: T samples.

Source: PX4 message definitions VehicleAttitudeSetpoint, VehicleRatesSetpoint, TrajectorySetpoint and
VehicleLocalPositionSetpoint; Betaflight 4.5, ``blackbox.c``, for ``setpoint`` (deg/s, with
``blackbox_high_resolution`` a tenth, throttle in thousandths); Bitcraze, *Log
groups and variables*, ``ctrltarget``; ArduPilot, *Onboard Message Log Messages*, ATT, RATE and CTUN. INDIFLIGHT's flights show
its units and axes: the gyro follows ``gyroSp`` in 0.1 deg/s, FRD, and ``spfSp`` balances the weight at hover in cm/s².
"""

from collections.abc import Iterable, Iterator
from math import pi
from typing import NamedTuple

from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog
from aerial_gym.sim2real.logs.readers.mapping import UNITS, LogMapping, quantity_from_ned_frd, to_package_frames


class SetpointSource(NamedTuple):
    """Fields of one setpoint quantity in a log format."""

    quantity: str  # A key of ``SETPOINTS``
    topic: str  # Name of the topic; empty for any
    fields: tuple[str, ...]
    unit: float = 1.0
    axes: str = "ned"  # ``ned`` with body FRD, ``enu`` with body FLU, or ``angles``: roll, pitch, yaw of NED and FRD


def _xyz(pattern: str, names: Iterable[str] = "012") -> tuple[str, ...]:
    return tuple(pattern.format(name) for name in names)


DEGREE = UNITS["deg/s"]
SOURCES = {
    "ulog": (
        SetpointSource("attitude_setpoint", "vehicle_attitude_setpoint", _xyz("q_d[{}]", "0123")),
        SetpointSource("rate_setpoint", "vehicle_rates_setpoint", ("roll", "pitch", "yaw")),
        SetpointSource("thrust_setpoint", "vehicle_rates_setpoint", ("thrust_body[2]",), -1.0),
        SetpointSource("thrust_setpoint", "vehicle_rates_setpoint", ("thrust",)),
        SetpointSource("position_setpoint", "trajectory_setpoint", _xyz("position[{}]")),
        SetpointSource("velocity_setpoint", "trajectory_setpoint", _xyz("velocity[{}]")),
        SetpointSource("position_setpoint", "vehicle_local_position_setpoint", ("x", "y", "z")),
    ),
    "blackbox": (
        SetpointSource("attitude_setpoint", "main", _xyz("quatSp[{}]", "0123"), 1.0 / 8127.0),
        SetpointSource("rate_setpoint", "main", _xyz("gyroSp[{}]"), 0.1 * DEGREE),
        SetpointSource("specific_thrust_setpoint", "main", ("spfSp[2]",), -0.01),
        SetpointSource("position_setpoint", "main", _xyz("posSp[{}]"), UNITS["mm"]),
        SetpointSource("rate_setpoint", "main", _xyz("setpoint[{}]"), DEGREE, "enu"),
        SetpointSource("thrust_setpoint", "main", ("setpoint[3]",), 1e-3),
    ),
    "crazyflie": (
        SetpointSource("position_setpoint", "", _xyz("ctrltarget.{}", "xyz"), axes="enu"),
        SetpointSource("velocity_setpoint", "", _xyz("ctrltarget.v{}", "xyz"), axes="enu"),
        SetpointSource("yaw_setpoint", "", ("ctrltarget.yaw",), DEGREE),
    ),
    "mavlink": (
        SetpointSource("attitude_setpoint", "ATTITUDE_TARGET", _xyz("q[{}]", "0123")),
        SetpointSource("rate_setpoint", "ATTITUDE_TARGET", _xyz("body_{}_rate", ("roll", "pitch", "yaw"))),
        SetpointSource("thrust_setpoint", "ATTITUDE_TARGET", ("thrust",)),
        SetpointSource("position_setpoint", "POSITION_TARGET_LOCAL_NED", ("x", "y", "z")),
        SetpointSource("velocity_setpoint", "POSITION_TARGET_LOCAL_NED", ("vx", "vy", "vz")),
    ),
    "dataflash": (
        SetpointSource("attitude_setpoint", "ATT", ("DesRoll", "DesPitch", "DesYaw"), axes="angles"),
        SetpointSource("rate_setpoint", "RATE", ("RDes", "PDes", "YDes"), DEGREE),
        SetpointSource("thrust_setpoint", "CTUN", ("ThO",)),
    ),
}
"""Sources of setpoints by log format, the best one of a quantity first."""

MEASURED = {
    **{"attitude_setpoint": "attitude", "position_setpoint": "position"},
    **{"velocity_setpoint": "lin_vel", "rate_setpoint": "ang_vel"},
}
"""Measured quantity with the axes of a setpoint."""


def setpoint_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield the setpoints of a decoded log in this package's axes and units."""
    for source in SOURCES.get(log.format, ()):
        for topic in log.topics:
            if source.topic in ("", topic.name) and topic.instance == 0 and set(source.fields) <= topic.columns.keys():
                values = _in_package_axes(source, topic.numbers(*source.fields))
                fine = source.fields[0] == "setpoint[0]" and log.number("blackbox_high_resolution", 0.0) == 1.0
                yield topic.channel(source.quantity, 0.1 * values if fine else values)


def _in_package_axes(source: SetpointSource, values: Array) -> Array:
    if source.axes == "angles":
        values = Rotation.from_euler("ZYX", values[:, ::-1], degrees=True).as_quat()[:, [3, 0, 1, 2]]
    if source.axes == "enu" or values.shape[1] == 1:
        return source.unit * values
    return quantity_from_ned_frd(MEASURED[source.quantity], source.unit * values)


def setpoints_in_package_axes(values: dict[str, Array], layout: LogMapping) -> dict[str, Array]:
    """Return setpoints of a mapping's axes in those of this package, by quantity."""
    results = dict[str, Array]()
    for name, asked in values.items():
        measured = MEASURED.get(name, name)
        results[name] = to_package_frames({measured: asked}, layout)[measured]
    if layout.world_frame == "ned" and "yaw_setpoint" in results:
        results["yaw_setpoint"] = 0.5 * pi - results["yaw_setpoint"]
    return results
