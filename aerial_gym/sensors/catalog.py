"""Every range sensor and every inertial measurement unit that comes with the package, in one table each."""

from functools import partial

from aerial_gym.config import CONFIG_DIR, summary_in
from aerial_gym.config.imu import ImuCfg, load_imu
from aerial_gym.config.sensor import RangeSensorCfg, load_sensor
from aerial_gym.registry import Registry

SENSORS: Registry[RangeSensorCfg] = Registry("sensor")

for _name in (
    "base_depth_camera",
    "coarse_depth_camera",
    "depth_camera_64",
    "base_rgb_camera",
    "base_normal_face_id_camera",
    "base_optical_flow_camera",
    "rs_d455",
    "intel_realsense_d455",
    "luxonis_oak_d",
    "luxonis_oak_d_pro_w",
    "stereo_camera",
    "base_lidar",
    "os0_128",
    "os0_64",
    "os1_64",
    "os2_64",
    "os_dome_64",
    "velodyne_vlp16",
    "velodyne_vlp32c",
    "velodyne_hdl32e",
    "velodyne_hdl64e",
    "livox_mid40",
    "livox_mid70",
    "livox_avia",
    "rslidar_airy",
    "coarse_dome_lidar",
    "fake_radar",
    "pmd_flexx2",
    "st_vl53l5cx",
    "st_vl53l7cx",
    "tof_matrix_90",
):
    _path = CONFIG_DIR / "sensors" / f"{_name}.yaml"
    SENSORS.register_later(_name, partial(load_sensor, _path), summary=partial(summary_in, _path))

IMUS: Registry[ImuCfg] = Registry("IMU")

for _name in ("base_imu", "bmi088", "vn100"):
    _path = CONFIG_DIR / "imus" / f"{_name}.yaml"
    IMUS.register_later(_name, partial(load_imu, _path), summary=partial(summary_in, _path))
