"""Setpoints of the formats, in SI units, ENU and FLU."""

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from aerial_gym.sim2real.logs.readers.setpoints import setpoint_channels, setpoints_in_package_axes

LEVEL_EAST = {"q_d[0]": 0.5**0.5, "q_d[1]": 0.0, "q_d[2]": 0.0, "q_d[3]": 0.5**0.5}  # PX4: heading east, yaw +90 deg


def setpoints(
    format_name: str, parameters: dict[str, float | str] | None = None, **topics: dict[str, float]
) -> dict[str, list[float]]:
    """Return the first value of each setpoint, the best source first."""
    time = np.arange(2.0)
    parts = [
        Topic(name=name, time=time, columns={field: np.full(2, value) for field, value in columns.items()})
        for name, columns in topics.items()
    ]
    log = RawLog(path="a", format=format_name, topics=tuple(parts), parameters=parameters or {})
    channels = list(setpoint_channels(log))
    return {one.quantity: one.values[0].tolist() for one in reversed(channels)}


def vector(name: str, *values: float) -> dict[str, float]:
    return {f"{name}[{k}]": value for k, value in enumerate(values)}


def test_setpoints_of_px4_are_turned_to_enu_and_flu() -> None:
    asked = setpoints(
        "ulog",
        vehicle_attitude_setpoint=LEVEL_EAST,
        vehicle_rates_setpoint={"roll": 0.1, "pitch": 0.2, "yaw": 0.3, **vector("thrust_body", 0.0, 0.0, -0.6)},
        trajectory_setpoint=vector("position", 1.0, 2.0, -3.0) | vector("velocity", 0.1, 0.2, -0.3),
        vehicle_local_position_setpoint={"x": 9.0, "y": 9.0, "z": 9.0},
    )
    np.testing.assert_allclose(np.abs(asked["attitude_setpoint"]), (0.0, 0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(asked["rate_setpoint"], (0.1, -0.2, -0.3))
    np.testing.assert_allclose(asked["thrust_setpoint"], (0.6,))
    np.testing.assert_allclose(asked["position_setpoint"], (2.0, 1.0, 3.0))
    np.testing.assert_allclose(asked["velocity_setpoint"], (0.2, 0.1, 0.3))


def test_setpoints_of_betaflight_are_in_flu_and_those_of_indiflight_in_frd() -> None:
    asked = setpoints("blackbox", main=vector("setpoint", 180.0, -90.0, 45.0, 400.0))
    np.testing.assert_allclose(asked["rate_setpoint"], (np.pi, -np.pi / 2, np.pi / 4))
    np.testing.assert_allclose(asked["thrust_setpoint"], (0.4,))
    fine = setpoints(
        "blackbox", {"blackbox_high_resolution": 1.0}, main=vector("setpoint", 1800.0, -900.0, 450.0, 400.0)
    )
    assert fine == asked
    main = (
        vector("gyroSp", 1800.0, 900.0, 0.0) | vector("spfSp", 0.0, 0.0, -981.0) | vector("posSp", 0.0, 1000.0, -1500.0)
    )
    asked = setpoints("blackbox", main=main)
    np.testing.assert_allclose(asked["rate_setpoint"], (np.pi, -np.pi / 2, 0.0))
    np.testing.assert_allclose(asked["specific_thrust_setpoint"], (9.81,))
    np.testing.assert_allclose(asked["position_setpoint"], (1.0, 0.0, 1.5))


def test_setpoints_of_ardupilot_and_of_the_crazyflie() -> None:
    asked = setpoints("dataflash", ATT={"DesRoll": 0.0, "DesPitch": 0.0, "DesYaw": 90.0}, CTUN={"ThO": 0.3})
    np.testing.assert_allclose(np.abs(asked["attitude_setpoint"]), (0.0, 0.0, 0.0, 1.0), atol=1e-12)
    assert asked["thrust_setpoint"] == [0.3]
    target = {f"ctrltarget.{axis}": value for axis, value in (("x", 1.0), ("y", 2.0), ("z", 3.0), ("yaw", 90.0))}
    asked = setpoints("crazyflie", event=target)
    assert asked["position_setpoint"] == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(asked["yaw_setpoint"], (np.pi / 2,))


def test_setpoints_of_a_mapping_have_its_axes() -> None:
    """A heading of 0 in NED is north, the y axis of ENU."""
    own = find_mapping("aerial_gym")
    ned = LogMapping(**{**vars(own), "world_frame": "ned", "body_frame": "frd"})
    values: dict[str, Array] = {"yaw_setpoint": np.zeros((1, 1)), "rate_setpoint": np.ones((1, 3))}
    asked = setpoints_in_package_axes(values | {"position_setpoint": np.array([[1.0, 2.0, -3.0]])}, ned)
    np.testing.assert_allclose(asked["yaw_setpoint"], [[np.pi / 2]])
    np.testing.assert_allclose(asked["rate_setpoint"], [[1.0, -1.0, -1.0]])
    np.testing.assert_allclose(asked["position_setpoint"], [[2.0, 1.0, 3.0]])
