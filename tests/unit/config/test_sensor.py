"""Sensor configurations: shipped values, the way to YAML and back, and every refusal with its words."""

from dataclasses import replace
from math import cos, inf, nan, pi, radians
from pathlib import Path

import pytest
import torch

from aerial_gym import ROBOTS, SENSORS
from aerial_gym.config import dump_yaml
from aerial_gym.config.sensor import (
    MODELS,
    CameraCfg,
    FisheyeCfg,
    LidarCfg,
    NoiseCfg,
    PrismCfg,
    RangeSensorCfg,
    RayTableCfg,
    RosetteCfg,
    StereoCfg,
    load_sensor,
)
from aerial_gym.errors import ConfigError
from aerial_gym.sensors.rays import ray_table
from tests.refusals import assert_refused

COMMON = {"summary": "test", "width": 16, "height": 8, "min_range": 0.2, "max_range": 10.0, "source": "test"}
CAMERA = CameraCfg(**COMMON, hfov_deg=87.0)
STEREO = StereoCfg(**COMMON, hfov_deg=87.0, baseline=-0.095)
FISHEYE = FisheyeCfg(**COMMON, hfov_deg=180.0)
LIDAR = LidarCfg(**COMMON, elevation_low_deg=-45.0, elevation_high_deg=45.0)
PRISM = PrismCfg(wedge_deg=18.0, turns_hz=-121.0, refractive_index=1.51)
ROSETTE = RosetteCfg(**{**COMMON, "height": 1}, prisms=(PRISM,), scan_columns=4, rate_hz=10.0)
TABLE = RayTableCfg(**{**COMMON, "width": 2, "height": 1}, rays=((1.0, 0.0, 0.0), (0.0, 0.0, -2.0)))

# parity.md 3.2: height, width, hfov [deg], ranges [m], segmentation, placement drawn
CAMERAS = {
    "base_depth_camera": (135, 240, 87.0, 0.2, 10.0, True, True),
    "base_normal_face_id_camera": (270, 480, 87.0, 0.2, 10.0, False, False),
    "rs_d455": (270, 480, 87.0, 0.2, 15.0, True, True),
    "intel_realsense_d455": (270, 480, 87.0, 0.2, 15.0, True, True),
    "luxonis_oak_d": (270, 480, 72.0, 0.7, 12.0, False, False),
    "luxonis_oak_d_pro_w": (270, 480, 127.0, 0.2, 12.0, False, False),
    "stereo_camera": (270, 480, 87.0, 0.2, 10.0, True, True),
}
OS0 = (3.36239e-5, -3.17199e-4, 9.61904e-3)
OS1 = (3.08287e-6, -4.07347e-6, 5.30757e-3)
DOME = (3.8089e-4, -3.43351e-3, 1.553284e-2)
# parity.md 3.3: height, width, azimuth, elevation [deg], ranges [m], noise on, (a, b, c), mean offset, dropout
LIDARS = {
    "base_lidar": (128, 512, 180.0, (-45.0, 45.0), (0.2, 10.0), True, (1e-5, 1e-5, 1e-5), -0.05, 0.0),
    "os0_128": (128, 512, 180.0, (-45.0, 45.0), (0.2, 35.0), False, OS0, -0.05, 0.0),
    "os0_64": (64, 512, 180.0, (-45.0, 45.0), (0.2, 35.0), False, OS0, -0.025, 0.0),
    "os1_64": (64, 512, 180.0, (-22.5, 22.5), (0.7, 90.0), False, OS1, -0.025, 0.0),
    "os2_64": (64, 512, 180.0, (-11.25, 11.25), (0.7, 200.0), False, OS1, -0.025, 0.0),
    "os_dome_64": (64, 512, 180.0, (0.0, 90.0), (0.5, 20.0), False, DOME, -0.025, 0.0),
    "rslidar_airy": (48, 120, 180.0, (0.0, 90.0), (0.2, 10.0), False, DOME, -0.025, 0.0),
    "fake_radar": (48, 120, 60.0, (-60.0, 60.0), (0.2, 10.0), False, OS1, -0.025, 0.01),
    "pmd_flexx2": (172, 224, 28.0, (-22.0, 22.0), (0.2, 5.0), False, OS1, -0.025, 0.01),
    "tof_matrix_90": (8, 8, 45.0, (-45.0, 45.0), (0.2, 4.0), False, OS1, -0.025, 0.0),
}


# ---------------------------------------------------------------------------------------------- what is shipped


def test_every_shipped_sensor_is_in_a_table_of_this_test() -> None:
    further_sensors = {"depth_camera_64", "coarse_depth_camera", "coarse_dome_lidar", "base_rgb_camera", "ring_lidar"}
    further_sensors |= {
        "base_optical_flow_camera", "st_vl53l5cx", "st_vl53l7cx", "livox_mid40", "livox_mid70", "livox_avia",
    }  # fmt: skip
    further_sensors |= {"velodyne_vlp16", "velodyne_vlp32c", "velodyne_hdl32e", "velodyne_hdl64e"}
    assert set(SENSORS.names()) == {*CAMERAS, *LIDARS, *further_sensors}


@pytest.mark.parametrize("name", CAMERAS)
def test_shipped_cameras_hold_the_values_of_parity(name: str) -> None:
    """parity.md 3.2, and its placement: x .07 to .12, y -.06 to .03, z .01 to .04 m, +-5 deg on each axis."""
    cfg = SENSORS.get(name)
    drawn = cfg.position_low is not None
    values = (cfg.height, cfg.width, cfg.hfov_deg, cfg.min_range, cfg.max_range, cfg.segmentation, drawn)
    assert values == CAMERAS[name]
    assert (cfg.kind, cfg.position, cfg.euler) == ("depth", (0.1, 0.0, 0.03), (0.0, 0.0, 0.0))
    if drawn:
        assert (cfg.position_low, cfg.position_high) == ((0.07, -0.06, 0.01), (0.12, 0.03, 0.04))
        assert cfg.euler_low == pytest.approx((-radians(5.0),) * 3, abs=1e-6)
        assert cfg.euler_high == pytest.approx((radians(5.0),) * 3, abs=1e-6)
    assert cfg.active_noise is None
    assert (cfg.far_pixel, cfg.near_pixel) == ((1.0, -1.0) if cfg.normalize else (-1.0, -1.0))


def test_special_cameras_have_their_outputs() -> None:
    stereo, faces = SENSORS.get("stereo_camera"), SENSORS.get("base_normal_face_id_camera")
    assert stereo.baseline == -0.095
    assert (faces.normals, faces.face_ids) == ("world", True)


@pytest.mark.parametrize("name", LIDARS)
def test_shipped_lidars_hold_the_values_of_parity(name: str) -> None:
    """parity.md 3.3; points in the world frame of the dome and the radar; all but those and the matrix normalised."""
    height, width, azimuth, elevation, ranges, noisy, std, offset, dropout = LIDARS[name]
    cfg = SENSORS.get(name)
    assert (cfg.height, cfg.width, cfg.azimuth_low_deg, cfg.azimuth_high_deg) == (height, width, -azimuth, azimuth)
    assert (cfg.elevation_low_deg, cfg.elevation_high_deg) == elevation
    assert (cfg.min_range, cfg.max_range) == ranges
    assert (cfg.noise.std_a, cfg.noise.std_b, cfg.noise.std_c) == pytest.approx(std, rel=1e-5)
    assert (cfg.noise.mean_offset, cfg.noise.dropout) == (offset, dropout)
    assert cfg.active_noise == (cfg.noise if noisy else None)
    assert cfg.points == ("world" if name in ("rslidar_airy", "fake_radar") else None)
    assert cfg.normalize == (name not in ("rslidar_airy", "fake_radar", "tof_matrix_90"))
    assert cfg.kind == "range"


def test_the_airy_dome_faces_backwards() -> None:
    cfg = SENSORS.get("rslidar_airy")
    assert (cfg.position, cfg.euler) == ((-0.05, 0.0, 0.0), pytest.approx((0.0, -pi / 2, 0.0)))


def test_the_coarse_dome_is_the_airy_with_fewer_rays_noise_and_no_points() -> None:
    fine, coarse = SENSORS.get("rslidar_airy"), SENSORS.get("coarse_dome_lidar")
    told = {"summary": fine.summary, "source": fine.source}
    time = {"rate_hz": fine.rate_hz, "scan_s": fine.scan_s, "scan_columns": fine.scan_columns}
    assert replace(coarse, height=48, width=120, noise_enabled=False, points="world", **told, **time) == fine
    rays = ray_table(coarse, device=torch.device("cpu")).reshape(-1, 3).double()
    assert rays.shape == (32 * 40, 3)
    likeness = rays @ rays.T - 2.0 * torch.eye(len(rays), dtype=torch.float64)
    assert float(likeness.max()) < cos(radians(0.2))  # next to the zenith: 9 deg times sin(1.43 deg)


@pytest.mark.parametrize("name", SENSORS.names())
def test_every_sensor_names_its_source(name: str) -> None:
    assert len(SENSORS.get(name).source) > 20


@pytest.mark.parametrize("cfg", [CAMERA, STEREO, FISHEYE, LIDAR, TABLE, ROSETTE], ids=lambda c: c.model)
def test_every_model_survives_writing_and_reading(cfg: RangeSensorCfg, tmp_path: Path) -> None:
    cfg = replace(cfg, noise=NoiseCfg(std_b=0.01), count=3, rate_hz=30.0, latency_s=0.02, points="sensor")
    (tmp_path / "sensor.yaml").write_text(dump_yaml(cfg), encoding="utf-8")
    assert load_sensor(tmp_path / "sensor.yaml") == cfg
    assert MODELS[cfg.model] is type(cfg)


def test_the_path_of_a_ray_table_is_relative_to_its_file(tmp_path: Path) -> None:
    cfg = replace(TABLE, rays=None, path="rays/list.csv")
    (tmp_path / "sensor.yaml").write_text(dump_yaml(cfg), encoding="utf-8")
    loaded = load_sensor(tmp_path / "sensor.yaml")
    assert loaded.path == str(tmp_path.resolve() / "rays" / "list.csv")


@pytest.mark.parametrize(("robot", "sensor"), [
    ("base_quadrotor_with_camera", "base_depth_camera"),
    ("base_quadrotor_with_lidar", "base_lidar"),
    ("base_quadrotor_with_stereo_camera", "stereo_camera"),
    ("base_quadrotor_with_faceid_normal_camera", "base_normal_face_id_camera"),
])  # fmt: skip
def test_robots_with_a_sensor_are_the_base_quadrotor_otherwise(robot: str, sensor: str) -> None:
    base, cfg = ROBOTS.get("base_quadrotor"), ROBOTS.get(robot)
    assert cfg.sensors == (sensor,)
    assert sensor in SENSORS
    assert replace(cfg, summary=base.summary, sensors=base.sensors) == base


# ---------------------------------------------------------------------------------------------- what follows


def test_defaults_of_kind_and_of_pixels_out_of_range() -> None:
    """Cameras with a flat image measure depth, all others range; parity.md 3.4 for the pixels."""
    kinds = [cfg.kind for cfg in (CAMERA, STEREO, FISHEYE, LIDAR, TABLE)]
    assert kinds == ["depth", "depth", "range", "range", "range"]
    assert (LIDAR.far_pixel, LIDAR.near_pixel) == (-1.0, -1.0)
    normalised = replace(LIDAR, normalize=True)
    assert (normalised.far_pixel, normalised.near_pixel) == (1.0, -1.0)
    assert replace(normalised, near_out_of_range_value=5.0).near_pixel == 0.5


def test_noise_is_off_if_absent_or_switched_off() -> None:
    noise = NoiseCfg(std_c=0.01)
    assert CAMERA.active_noise is None
    assert replace(CAMERA, noise=noise).active_noise is noise
    assert replace(CAMERA, noise=noise, noise_enabled=False).active_noise is None


@pytest.mark.parametrize(("noise", "worst"), [
    (NoiseCfg(std_a=1.0, std_b=-4.0, std_c=5.0), 2.0),  # (r - 2)² + 1
    (NoiseCfg(std_a=1.0, std_b=-40.0, std_c=500.0), 10.0),  # vertex at 20 m, beyond
    (NoiseCfg(std_a=1.0, std_b=4.0, std_c=5.0), 0.2),  # vertex at -2 m, before
    (NoiseCfg(std_a=-1.0, std_b=10.0, std_c=5.0), 10.0),  # concave: at an end
    (NoiseCfg(std_b=0.01), 0.2),
])  # fmt: skip
def test_the_least_standard_deviation_is_found_in_closed_form(noise: NoiseCfg, worst: float) -> None:
    assert noise.least_std_distance(0.2, 10.0) == pytest.approx(worst)
    grid = [0.2 + 9.8 * i / 1000 for i in range(1001)]
    assert noise.std(worst) <= min(map(noise.std, grid)) + 1e-12


# ---------------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("cfg", [CAMERA, STEREO, FISHEYE, LIDAR], ids=lambda c: c.model)
@pytest.mark.parametrize(("fields", "message"), [
    ({"width": 0}, r"width = 0: must be >= 1"),
    ({"width": 2.5}, r"width = 2.5: must be whole"),
    ({"height": -3}, r"height = -3: must be >= 1"),
    ({"min_range": 10.0}, r"min_range = 10.0: must be >= 0 and below max_range = 10.0"),
    ({"min_range": -0.1}, r"min_range = .*: must be >= 0 and below max_range"),
    ({"min_range": nan}, r"min_range = .*: must be >= 0 and below max_range"),
    ({"max_range": inf}, r"min_range = .*: must be >= 0 and below max_range"),
    ({"kind": "depht"}, r"kind = 'depht': must be one of depth, range"),
    ({"model": "pinole"}, r"model = 'pinole': must be '\w+'; another model is another class"),
    ({"points": "body"}, r"points = 'body': must be one of world, sensor, or None"),
    ({"normals": "camera"}, r"normals = 'camera': must be one of world, sensor, or None"),
    ({"count": 0}, r"count = 0: must be >= 1"),
    ({"count": 1.5}, r"count = 1.5: must be whole"),
    ({"position": (inf, 0.0, 0.0)}, r"position = .*: must be finite"),
    ({"euler": (0.0, nan, 0.0)}, r"euler = .*: must be finite"),
    ({"euler": (0.0, 90.0, 0.0)}, r"euler = .*: must lie within \+-2 pi. Angles are in radians"),
    ({"position_low": (0.0, 0.0, 0.0)}, r": give both position_low and position_high, or neither"),
    ({"euler_high": (0.0, 0.0, 0.0)}, r": give both euler_low and euler_high, or neither"),
    ({"position_low": (0.0, 0.1, 0.0), "position_high": (0.0, -0.1, 0.0)}, r": position_low = .* exceed position"),
    ({"position_low": (0.1, 0.0, 0.0), "position_high": (0.2, 0.0, 0.0)}, r": position_low = .* exceed position "),
    ({"euler_low": (-0.2, 0.0, 0.0), "euler_high": (-0.1, 0.0, 0.0)}, r": euler = .* must not exceed euler_high"),
    ({"euler_low": (0.0, 0.0, -5.0), "euler_high": (0.0, 0.0, 90.0)}, r"euler_high = .*: must lie within \+-2 pi"),
    ({"position_low": (nan, 0.0, 0.0), "position_high": (0.0, 0.0, 0.0)}, r"position_low = .*: must be finite"),
    ({"rate_hz": 0.0}, r"rate_hz = 0.0: must be > 0 and finite"),
    ({"rate_hz": nan}, r"rate_hz = nan: must be > 0"),
    ({"latency_s": -0.01}, r"latency_s = -0.01: must be >= 0 and finite"),
    ({"latency_s": inf}, r"latency_s = inf: must be >= 0 and finite"),
    ({"far_out_of_range_value": nan}, r"far_out_of_range_value = nan: must be finite"),
    ({"near_out_of_range_value": inf}, r"near_out_of_range_value = inf: must be finite"),
    ({"noise": NoiseCfg(std_c=-0.01)}, r"noise = .*standard deviation is -0.01 m at 0.2 m: must be >= 0"),
    ({"noise": NoiseCfg(std_a=-1e-3)}, r"noise = .* deviation is -0.1 m at 10 m"),
    ({"noise": NoiseCfg(std_a=1.0, std_b=-4.0, std_c=3.9), "noise_enabled": False}, r"noise = .* deviation is -0.1 m at 2 m"),
])  # fmt: skip
def test_impossible_range_sensors_are_refused(cfg: RangeSensorCfg, fields: dict, message: str) -> None:
    assert_refused(ConfigError, rf"{type(cfg).__name__}\.?{message}", replace, cfg, **fields)


@pytest.mark.parametrize(("cfg", "fields", "message"), [
    *(
        (NoiseCfg(), {name: value}, rf"NoiseCfg.{name} = {value}: must be finite")
        for name in ("std_a", "std_b", "std_c", "mean_offset")
        for value in (nan, inf)
    ),
    *((NoiseCfg(), {"dropout": share}, rf"NoiseCfg.dropout = {share}: must be a prob") for share in (1.0, -0.1, nan)),
    (CAMERA, {"hfov_deg": 180.0}, r"CameraCfg.hfov_deg = 180.0: must lie between 0 and 180 degrees. A fisheye"),
    (CAMERA, {"hfov_deg": 0.0}, r"CameraCfg.hfov_deg = 0.0: must lie between"),
    (STEREO, {"hfov_deg": nan}, r"StereoCfg.hfov_deg = nan: must lie between"),
    (STEREO, {"baseline": 0.0}, r"StereoCfg.baseline = 0.0: must be finite and not 0. Left is positive"),
    (STEREO, {"baseline": nan}, r"StereoCfg.baseline = nan: must be finite and not 0"),
    (FISHEYE, {"hfov_deg": 0.0}, r"FisheyeCfg.hfov_deg = 0.0: must be > 0 and at most 360 degrees"),
    (FISHEYE, {"hfov_deg": 361.0}, r"FisheyeCfg.hfov_deg = 361.0: must be > 0 and at most 360 degrees"),
    (FISHEYE, {"hfov_deg": nan}, r"FisheyeCfg.hfov_deg = nan: must be > 0"),
    (FISHEYE, {"width": 64, "height": 64, "hfov_deg": 300.0}, r"looks 208.8 degrees off the axis: must be less th"),
    (LIDAR, {"azimuth_low_deg": 180.0}, r"LidarCfg.azimuth_low_deg = 180.0: with azimuth_high_deg = 180.0 needs"),
    (LIDAR, {"azimuth_high_deg": 190.0}, r"at most one turn between them"),
    (LIDAR, {"azimuth_low_deg": nan}, r"azimuth_low_deg = nan"),
    (LIDAR, {"azimuth_low_deg": 170.0, "azimuth_high_deg": 400.0}, r"needs -360 <= low < high <= 360"),
    (LIDAR, {"elevation_high_deg": 91.0}, r"elevation_high_deg = 91.0 needs -90 <= low < high <= 90"),
    (LIDAR, {"elevation_low_deg": -90.5}, r"elevation_low_deg = -90.5"),
    (LIDAR, {"elevation_low_deg": 45.0}, r"elevation_low_deg = 45.0: with elevation_high_deg = 45.0 needs -90 "),
    (LIDAR, {"elevation_low_deg": nan}, r"elevation_low_deg = nan"),
    (LIDAR, {"elevation_low_deg": None}, r"give elevation_low_deg and elevation_high_deg, or beam_elevations_deg"),
    (LIDAR, {"beam_elevations_deg": (1.0,)}, r"LidarCfg: give elevation limits or beam_elevations_deg, not both"),
    (LIDAR, {"scan_s": 0.0}, r"LidarCfg.scan_s = 0.0: must be > 0 and finite"),
    (LIDAR, {"scan_s": nan}, r"LidarCfg.scan_s = nan: must be > 0 and finite"),
    (TABLE, {"path": "rays.csv"}, r"RayTableCfg: give exactly one of path and rays"),
    (TABLE, {"rays": None}, r"RayTableCfg: give exactly one of path and rays"),
    (TABLE, {"width": 3}, r"RayTableCfg.rays has 2 rays, expected height \* width = 3"),
    (TABLE, {"rays": ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))}, r"RayTableCfg.rays\[1\] = .*: must not be zero"),
    (TABLE, {"rays": ((1.0, 0.0, 0.0), (nan, 0.0, 0.0))}, r"RayTableCfg.rays = .*: must be finite"),
])  # fmt: skip
def test_impossible_models_and_noises_are_refused(cfg: RangeSensorCfg | NoiseCfg, fields: dict, message: str) -> None:
    assert_refused(ConfigError, message, replace, cfg, **fields)


@pytest.mark.parametrize(("beams", "message"), [
    ((10.0, 0.0), r"LidarCfg.beam_elevations_deg = .*: needs height = 3"),
    ((10.0, 0.0, -91.0), r"must lie within \+-90 degrees"),
    ((10.0, nan, -10.0), r"must lie within \+-90 degrees"),
    ((-10.0, 0.0, 10.0), r"must fall from entry to entry, row 0 is on top"),
    ((10.0, 0.0, 0.0), r"must fall from entry to entry"),
])  # fmt: skip
def test_impossible_beams_are_refused(beams: tuple[float, ...], message: str) -> None:
    assert_refused(ConfigError, message, LidarCfg, **{**COMMON, "height": 3}, beam_elevations_deg=beams)


@pytest.mark.parametrize(("text", "message"), [
    ("model: pinole\n", r"model = 'pinole': must be one of pinhole, .* Did you mean 'pinhole'"),
    ("summary: no model\n", r"model = None: must be one of pinhole, stereo, fisheye, lidar, ray_table"),
    ("model: lidar\nhfov_deg: 90.0\n", r"sensor.yaml: unknown field 'hfov_deg'"),
    ("model: fisheye\nhfov: 90.0\n", r"unknown field 'hfov'. Did you mean 'hfov_deg'"),
    ("model: lidar\nnoise: {std: 0.1}\n", r"noise: unknown field 'std'"),
])  # fmt: skip
def test_a_sensor_file_with_an_unknown_word_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "sensor.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        load_sensor(tmp_path / "sensor.yaml")
