"""Inertial measurement units: flat classes, each quantity six numbers: three of the accelerometers, three of the gyros."""

from typing import Any

from aerial_gym.compat.config.fields import Changes, ConfigTable, Values, constant_field, direct_field, idle_field
from aerial_gym.compat.config.registration import register_config
from aerial_gym.config.imu import ImuCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sensors import IMUS


def _six_number_writer(name: str, switch: str) -> Any:
    """Return the function that splits six numbers; zeros where the switch is off."""

    def write(values: Values) -> Changes:
        numbers = [float(n) if values[switch] else 0.0 for n in values[_SIXES[name][0]]]
        if len(numbers) != 6:
            raise ConfigError(
                f"{_SIXES[name][0]} = {values[_SIXES[name][0]]!r}: needs six numbers, accelerometers first"
            )
        return {f"accel_{name}": tuple(numbers[:3]), f"gyro_{name}": tuple(numbers[3:])}

    return write


_SIXES = {
    "noise_density": ("imu_noise_std", "enable_noise"),
    "bias_walk": ("bias_std", "enable_bias"),
    "initial_bias": ("max_bias_init_value", "enable_bias"),
}


def _switch_writer(*names: str) -> Any:
    return lambda values: {
        key: v for name in names for key, v in _six_number_writer(name, _SIXES[name][1])(values).items()
    }


def _range_changes(values: Values) -> Changes:
    limits = [float(n) for n in values["max_measurement_value"]]
    if len(limits) != 6 or len(set(limits[:3])) > 1 or len(set(limits[3:])) > 1:
        raise ConfigError(
            f"max_measurement_value = {limits!r}: needs one limit for the accelerometers and one for the gyros"
        )
    return {"accel_range": limits[0], "gyro_range": limits[3]}


def _six_measurement_limits(cfg: ImuCfg) -> list[float]:
    return [*[cfg.accel_range] * 3, *[cfg.gyro_range] * 3]


def _misalignment_changes(values: Values) -> Changes:
    low, high = ([float(n) for n in values[f"{end}_euler_rotation_deg"]] for end in ("min", "max"))
    if not values["randomize_placement"]:
        return {"misalignment_deg": (0.0, 0.0, 0.0)}
    if any(abs(a + b) > 1e-9 for a, b in zip(low, high, strict=True)):
        raise ConfigError(
            f"min_euler_rotation_deg = {low!r}, max_euler_rotation_deg = {high!r}: must lie about 0; turn the mount"
        )
    return {"misalignment_deg": tuple(high)}


TABLE = ConfigTable(
    kind="IMU",
    fields=(
        *(
            direct_field(script_name, f"accel_{native}, gyro_{native}",
                    lambda c, native=native: [*getattr(c, f"accel_{native}"), *getattr(c, f"gyro_{native}")],
                    _six_number_writer(native, switch), "six numbers")
            for native, (script_name, switch) in _SIXES.items()
        ),
        direct_field("enable_noise", "accel_noise_density, gyro_noise_density", lambda _: True,
                _switch_writer("noise_density"), "False makes them 0"),
        direct_field("enable_bias", "accel_bias_walk, ...", lambda _: True, _switch_writer("bias_walk", "initial_bias"),
                "False makes them 0"),
        direct_field("max_measurement_value", "accel_range, gyro_range", _six_measurement_limits, _range_changes),
        direct_field("randomize_placement", "misalignment_deg", lambda c: any(c.misalignment_deg), _misalignment_changes),
        direct_field("min_euler_rotation_deg", "misalignment_deg", lambda c: [-n for n in c.misalignment_deg],
                _misalignment_changes),
        direct_field("max_euler_rotation_deg", "misalignment_deg", lambda c: list(c.misalignment_deg), _misalignment_changes),
        *(idle_field(name, None, "not used there; the place of an IMU is its mount in a robot file")
          for name in ("min_translation", "max_translation")),
        constant_field("num_sensors", 1, "several IMUs are several mounts in a robot file"),
        constant_field("sensor_type", "imu", "an IMU is an IMU"),
        constant_field("world_frame", False, "rotate imu_measurement yourself; there a body rate was turned"),
        constant_field("gravity_compensation", False, "accelerometers measure specific force; add gravity in the IMU's frame"),
    ),
    idle_sections={},
)  # fmt: skip
"""Translation of the attributes of an IMU class."""


def imu_class(imu: str) -> type:
    """Return the configuration class of a registered IMU, the same one at every call."""
    if imu not in CLASSES:
        CLASSES[imu] = TABLE.make_class(imu, IMUS.get(imu))
    return CLASSES[imu]


def translate_imu(cls: Any) -> ImuCfg:
    """Return the translated IMU of an IMU class."""
    return TABLE.translate(cls, IMUS.get("base_imu"))


def imu_name(cls: Any) -> str:
    """Return the registered name of an IMU class, after registration if needed."""
    return register_config(cls, translate_imu(cls), IMUS)


CLASSES: dict[str, type] = {
    imu: TABLE.make_class(name, IMUS.get(imu))
    for name, imu in (("BaseImuConfig", "base_imu"), ("VN100Config", "vn100"), ("BoschBMI088Config", "bmi088"))
}
"""Generated classes by the name of the IMU."""
