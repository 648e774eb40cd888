"""Inertial measurement units: flat classes, each quantity six numbers: three of the accelerometers, three of the gyros."""

from typing import Any

from aerial_gym.compat.config.fields import Changes, ConfigTable, Values, idle_field, native_field, unchangeable_field
from aerial_gym.compat.config.sensors import register_config
from aerial_gym.config.sensor import ImuCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sensors import IMUS

_SIXES = {
    "noise_density": ("imu_noise_std", "enable_noise"),
    "bias_walk": ("bias_std", "enable_bias"),
    "initial_bias": ("max_bias_init_value", "enable_bias"),
}
"""Six numbers and switch of a class, by quantity here."""


def _six_number_changes(*names: str) -> Any:
    """Return the function that splits the six numbers of some quantities; zeros where their switch is off."""

    def changes(values: Values) -> Changes:
        result: Changes = {}
        for name, (script_name, switch) in ((name, _SIXES[name]) for name in names):
            numbers = [float(n) if values[switch] else 0.0 for n in values[script_name]]
            if len(numbers) != 6:
                raise ConfigError(f"{script_name} = {values[script_name]!r}: needs six numbers, accelerometers first")
            result |= {f"accel_{name}": tuple(numbers[:3]), f"gyro_{name}": tuple(numbers[3:])}
        return result

    return changes


def _range_changes(values: Values) -> Changes:
    limits = [float(n) for n in values["max_measurement_value"]]
    if len(limits) != 6 or len(set(limits[:3])) > 1 or len(set(limits[3:])) > 1:
        raise ConfigError(f"max_measurement_value = {limits!r}: needs one limit for accelerometers and one for gyros")
    return {"accel_range": limits[0], "gyro_range": limits[3]}


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
            native_field(script_name, f"accel_{native}, gyro_{native}",
                    lambda c, native=native: [*getattr(c, f"accel_{native}"), *getattr(c, f"gyro_{native}")],
                    _six_number_changes(native), "six numbers")
            for native, (script_name, _) in _SIXES.items()
        ),
        native_field("enable_noise", "accel_noise_density, gyro_noise_density", lambda _: True,
                _six_number_changes("noise_density"), "False makes them 0"),
        native_field("enable_bias", "accel_bias_walk, ...", lambda _: True, _six_number_changes("bias_walk", "initial_bias"),
                "False makes them 0"),
        native_field("max_measurement_value", "accel_range, gyro_range",
                     lambda c: [c.accel_range] * 3 + [c.gyro_range] * 3, _range_changes),
        native_field("randomize_placement", "misalignment_deg", lambda c: any(c.misalignment_deg), _misalignment_changes),
        native_field("min_euler_rotation_deg", "misalignment_deg", lambda c: [-n for n in c.misalignment_deg],
                _misalignment_changes),
        native_field("max_euler_rotation_deg", "misalignment_deg", lambda c: list(c.misalignment_deg), _misalignment_changes),
        *(idle_field(name, None, "not used there; the place of an IMU is its mount in a robot file")
          for name in ("min_translation", "max_translation")),
        unchangeable_field("num_sensors", 1, "several IMUs are several mounts in a robot file"),
        unchangeable_field("sensor_type", "imu", "an IMU is an IMU"),
        unchangeable_field("world_frame", False, "rotate imu_measurement yourself; there a body rate was turned"),
        unchangeable_field("gravity_compensation", False, "it gives specific force; add gravity in the IMU's frame"),
    ),
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


def imu_catalog_name(cls: Any) -> str:
    """Return the registered name of an IMU class, after registration if needed."""
    return register_config(cls, translate_imu(cls), IMUS)


CLASSES: dict[str, type] = {
    imu: TABLE.make_class(name, IMUS.get(imu))
    for name, imu in (("BaseImuConfig", "base_imu"), ("VN100Config", "vn100"), ("BoschBMI088Config", "bmi088"))
}
"""Generated classes by the name of the IMU."""
