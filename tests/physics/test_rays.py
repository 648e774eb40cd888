"""Ray tables against closed forms of their projections, in float64. A float32 direction is good to 6e-8: 1e-6 is asked.
Angles are taken from directions by atan2, which keeps that accuracy everywhere (arccos does not)."""

from dataclasses import replace
from math import cos, pi, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree

from aerial_gym.config.sensor import CameraCfg, FisheyeCfg, LidarCfg, RangeSensorCfg, RayTableCfg, RosetteCfg, StereoCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sensors import SENSORS, pinhole_rays, ray_table

Array = NDArray[np.float64]

CPU = torch.device("cpu")
TOLERANCE = 1e-6
COMMON = {"summary": "test", "min_range": 0.2, "max_range": 10.0, "source": "test"}


def table(cfg: RangeSensorCfg) -> Array:
    rays = ray_table(cfg, device=CPU)
    assert rays.dtype == torch.float32
    assert rays.shape == (cfg.height, cfg.width, 3)
    array = rays.double().numpy()
    np.testing.assert_allclose(np.linalg.norm(array, axis=-1), 1.0, rtol=0.0, atol=TOLERANCE)
    return array


def angles_deg(rays: Array) -> tuple[Array, Array]:
    return np.degrees(np.arctan2(rays[..., 1], rays[..., 0])), np.degrees(
        np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
    )


def least_angle(rays: Array) -> float:
    """Return the smallest angle between any two rays [rad]: 2 arcsin(chord / 2)."""
    points = rays.reshape(-1, 3)
    chord = KDTree(points).query(points, k=2)[0][:, 1].min()
    return float(2.0 * np.arcsin(0.5 * chord))


def lidar(height: int, width: int, **fields: object) -> LidarCfg:
    return LidarCfg(**COMMON, height=height, width=width, **fields)


def test_pinhole_rows_and_columns_have_equal_steps_of_the_tangent() -> None:
    """On the plane x = 1 pixel centres are a grid of W x H squares between +-tan(hfov / 2) to the left and right."""
    cfg = CameraCfg(**COMMON, width=31, height=18, hfov_deg=100.0)
    rays = table(cfg)
    side = 2.0 * tan(radians(50.0)) / 31
    y, z = rays[..., 1] / rays[..., 0], rays[..., 2] / rays[..., 0]
    np.testing.assert_allclose(y, np.broadcast_to((15 - np.arange(31)) * side, (18, 31)), rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(z, np.broadcast_to((8.5 - np.arange(18))[:, None] * side, (18, 31)), rtol=0.0, atol=1e-5)
    assert torch.equal(ray_table(cfg, device=CPU), pinhole_rays(cfg, device=CPU))
    stereo = StereoCfg(**COMMON, width=31, height=18, hfov_deg=100.0, baseline=0.1)
    assert torch.equal(ray_table(stereo, device=CPU), pinhole_rays(cfg, device=CPU))


@pytest.mark.parametrize(
    "cfg",
    [
        CameraCfg(**COMMON, width=30, height=17, hfov_deg=87.0),
        FisheyeCfg(**COMMON, width=30, height=17, hfov_deg=200.0),
        lidar(16, 45, elevation_low_deg=-30.0, elevation_high_deg=30.0),
        lidar(16, 46, azimuth_low_deg=-60.0, azimuth_high_deg=60.0, elevation_low_deg=-30.0, elevation_high_deg=30.0),
    ],
    ids=lambda c: c.model,
)
def test_tables_are_symmetric_about_the_axis(cfg: RangeSensorCfg) -> None:
    """The mirror image left to right has the opposite y, top to bottom the opposite z; left is +y and top is +z."""
    rays = table(cfg)
    np.testing.assert_allclose(rays[:, ::-1] * [1, -1, 1], rays, rtol=0.0, atol=TOLERANCE)
    np.testing.assert_allclose(rays[::-1] * [1, 1, -1], rays, rtol=0.0, atol=TOLERANCE)
    assert (rays[: cfg.height // 2, :, 2] > 0.0).all()
    assert (rays[:, : cfg.width // 2, 1] > 0.0).all()


def test_a_narrow_lidar_holds_both_ends_and_equal_steps() -> None:
    """Columns fall from +60 to -20 deg by 80 / (W - 1), rows from 15 to -25 deg by 40 / (H - 1)."""
    limits = {
        "azimuth_low_deg": -20.0, "azimuth_high_deg": 60.0, "elevation_low_deg": -25.0, "elevation_high_deg": 15.0,
    }  # fmt: skip
    azimuth, elevation = angles_deg(table(lidar(9, 17, **limits)))
    np.testing.assert_allclose(azimuth, np.tile(60.0 - 5.0 * np.arange(17), (9, 1)), rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(elevation, np.tile(15.0 - 5.0 * np.arange(9)[:, None], (1, 17)), rtol=0.0, atol=1e-4)


@pytest.mark.parametrize(("low", "high"), [(-180.0, 180.0), (0.0, 360.0), (-300.0, 60.0)])
def test_a_full_turn_keeps_half_a_step_from_both_ends(low: float, high: float) -> None:
    """36 columns: 10 deg apart, the first 5 deg below the upper limit."""
    cfg = lidar(1, 36, azimuth_low_deg=low, azimuth_high_deg=high, elevation_low_deg=-1.0, elevation_high_deg=1.0)
    azimuth, _ = angles_deg(table(cfg))
    error = (azimuth[0] - (high - 5.0 - 10.0 * np.arange(36)) + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(error, 0.0, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize(("height", "width"), [(128, 512), (64, 511), (5, 2), (3, 7)])
def test_a_full_turn_repeats_no_ray(height: int, width: int) -> None:
    """The smallest angle between any two rays is a step of elevation, or of azimuth on the outermost rows. Two rays at the
    same elevation e and the azimuths' distance a are 2 arcsin(cos e sin(a / 2)) apart."""
    rays = table(lidar(height, width, elevation_low_deg=-45.0, elevation_high_deg=45.0))
    across = 2.0 * np.arcsin(cos(pi / 4) * sin(pi / width))
    nominal = min(across, pi / 2 / (height - 1))
    assert least_angle(rays) > 0.9 * nominal
    assert least_angle(rays) == pytest.approx(nominal, rel=1e-3)


@pytest.mark.parametrize(
    ("low", "high", "top", "step"),
    [
        (0.0, 90.0, 90.0 - 90.0 / 63.5 / 2, 90.0 / 63.5),
        (-90.0, 0.0, 0.0, 90.0 / 63.5),
        (-90.0, 90.0, 90.0 - 180.0 / 64 / 2, 180.0 / 64),
    ],
)
def test_a_dome_keeps_half_a_step_from_its_pole(low: float, high: float, top: float, step: float) -> None:
    """At +-90 deg all columns would be the same ray; the other end is held."""
    rays = table(lidar(64, 40, elevation_low_deg=low, elevation_high_deg=high))
    _, elevation = angles_deg(rays)
    np.testing.assert_allclose(elevation[:, 0], top - step * np.arange(64), rtol=0.0, atol=1e-4)
    across = 2.0 * np.arcsin(np.cos(np.radians(elevation)).min() * sin(pi / 40))
    assert least_angle(rays) > 0.9 * across


def test_one_row_or_column_looks_at_the_middle() -> None:
    limits = {
        "azimuth_low_deg": -20.0, "azimuth_high_deg": 60.0, "elevation_low_deg": -10.0, "elevation_high_deg": 30.0,
    }  # fmt: skip
    azimuth, elevation = angles_deg(table(lidar(1, 5, **limits)))
    np.testing.assert_allclose(elevation, 10.0, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(azimuth[0], [60.0, 40.0, 20.0, 0.0, -20.0], rtol=0.0, atol=1e-4)
    azimuth, elevation = angles_deg(table(lidar(3, 1, **limits)))
    np.testing.assert_allclose(azimuth, 20.0, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(elevation[:, 0], [30.0, 10.0, -10.0], rtol=0.0, atol=1e-4)
    azimuth, elevation = angles_deg(table(lidar(1, 1, elevation_low_deg=-90.0, elevation_high_deg=90.0)))
    np.testing.assert_allclose([azimuth.item(), elevation.item()], 0.0, rtol=0.0, atol=1e-4)
    for cfg in (CameraCfg, FisheyeCfg):
        one = table(cfg(**COMMON, width=1, height=1, hfov_deg=90.0))
        np.testing.assert_allclose(one[0, 0], [1.0, 0.0, 0.0], rtol=0.0, atol=0.0)


def test_listed_beams_are_the_elevations_of_the_rows() -> None:
    beams = (15.0, 3.0, 1.0, -0.5, -24.9)
    azimuth, elevation = angles_deg(table(lidar(5, 8, beam_elevations_deg=beams)))
    np.testing.assert_allclose(elevation, np.tile(np.array(beams)[:, None], (1, 8)), rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(azimuth[0], 157.5 - 45.0 * np.arange(8), rtol=0.0, atol=1e-4)


SIX = ((2.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0), (-3.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 3e-200, -4e-200))
SIX_UNIT = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0.5**0.5, 0.5**0.5, 0], [0, 0.6, -0.8]])


def table_cfg(**fields: object) -> RayTableCfg:
    return RayTableCfg(**{**COMMON, "width": 3, "height": 2, **fields})


def test_listed_rays_are_made_unit_length_and_fill_the_image_row_by_row() -> None:
    np.testing.assert_allclose(table(table_cfg(rays=SIX)), SIX_UNIT.reshape(2, 3, 3), rtol=0.0, atol=TOLERANCE)


def test_a_csv_of_directions_is_the_same_table(tmp_path: Path) -> None:
    path = tmp_path / "rays.csv"
    path.write_text("x, y, z\n" + "".join(f"{x}, {y}, {z}\n" for x, y, z in SIX), encoding="utf-8")
    np.testing.assert_array_equal(table(table_cfg(path=str(path))), table(table_cfg(rays=SIX)))


def test_a_csv_of_angles_gives_directions_with_those_angles(tmp_path: Path) -> None:
    """Signed cases: azimuth 90 is +y (left), elevation 90 is +z (up)."""
    path = tmp_path / "rays.csv"
    path.write_text("azimuth_deg,elevation_deg\n0,0\n90,0\n17,90\n180,0\n45,0\n-30,-60\n", encoding="utf-8")
    last = [cos(pi / 6) / 2, -0.25, -(0.75**0.5)]
    expected = np.concatenate((SIX_UNIT[:5], [last])).reshape(2, 3, 3)
    np.testing.assert_allclose(table(table_cfg(path=str(path))), expected, rtol=0.0, atol=TOLERANCE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,0,0\n", r"rays.csv: header '1,0,0': must be x,y,z or azimuth_deg,elevation_deg"),
        ("", r"rays.csv: header ''"),
        ("x,y,z\n", r"rays.csv: has no rays"),
        ("x,y,z\n1,0,0\n1,0\n", r"rays.csv: line 3 = '1,0': must be 3 finite numbers"),
        ("x,y,z\n1,zero,0\n", r"rays.csv: line 2 = '1,zero,0': must be 3 finite numbers"),
        ("x,y,z\n1,nan,0\n", r"rays.csv: line 2 = '1,nan,0': must be 3 finite numbers"),
        ("x,y,z\n1,inf,0\n", r"rays.csv: line 2 = '1,inf,0': must be 3 finite numbers"),
        ("x,y,z\n0,0,0\n", r"rays.csv: line 2 = '0,0,0': must not be zero"),
        ("azimuth_deg,elevation_deg\n0,95\n", r"rays.csv: line 2 = '0,95': elevation must lie within \+-90 degrees"),
        ("x,y,z\n1,0,0\n", r"rays.csv has 1 rays, expected height \* width = 6"),
    ],
)
def test_a_csv_that_does_not_fit_is_refused_with_its_line(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "rays.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        ray_table(table_cfg(path=str(tmp_path / "rays.csv")), device=CPU)


def test_a_missing_csv_is_named() -> None:
    with pytest.raises(ConfigError, match=r"/nowhere/rays.csv: cannot be read \(No such file or directory\)"):
        ray_table(table_cfg(path="/nowhere/rays.csv"), device=CPU)


@pytest.mark.parametrize(
    "cfg",
    [
        FisheyeCfg(**COMMON, kind="depth", width=9, height=9, hfov_deg=200.0),
        lidar(8, 16, kind="depth", elevation_low_deg=-20.0, elevation_high_deg=20.0),
        lidar(
            2, 2, kind="depth", azimuth_low_deg=-90.0, azimuth_high_deg=90.0, elevation_low_deg=-1.0,
            elevation_high_deg=1.0,
        ),
        table_cfg(rays=SIX, kind="depth"),
    ],
    ids=["fisheye", "around", "sideways", "ray_table"],
)  # fmt: skip
def test_depth_is_refused_for_rays_that_do_not_look_ahead(cfg: RangeSensorCfg) -> None:
    """Depth over cosine is the range: at 90 deg off the axis and beyond there is none."""
    with pytest.raises(ConfigError, match=rf"{type(cfg).__name__}.kind = 'depth': some rays do not look ahead"):
        ray_table(cfg, device=CPU)
    assert ray_table(replace(cfg, kind="range"), device=CPU).isfinite().all()


def test_depth_is_allowed_for_a_narrow_fisheye() -> None:
    rays = table(FisheyeCfg(**COMMON, kind="depth", width=9, height=9, hfov_deg=100.0))
    assert rays[..., 0].min() > 0.1


@pytest.mark.parametrize("name", SENSORS.names())
def test_every_shipped_sensor_covers_its_field_of_view_and_repeats_no_ray(name: str) -> None:
    """Cameras: the outermost column lies at (W - 1) / W of the tangent of half the field of view; lidars: at their limits,
    or half a step inside where the limits meet, or of cells; rosettes have tests of their own."""
    cfg = SENSORS.get(name)
    if isinstance(cfg, RosetteCfg):
        return
    rays = table(cfg)
    assert least_angle(rays) > 1e-5
    azimuth, elevation = angles_deg(rays)
    if isinstance(cfg, CameraCfg):
        edge = tan(radians(0.5 * cfg.hfov_deg)) * np.array([1.0, cfg.height / cfg.width])
        ratio = (np.array([cfg.width, cfg.height]) - 1) / np.array([cfg.width, cfg.height])
        corner = rays[0, 0, 1:] / rays[0, 0, 0]
        np.testing.assert_allclose(corner, edge * ratio, rtol=1e-6)
        np.testing.assert_allclose(rays[-1, -1, 1:] / rays[-1, -1, 0], -edge * ratio, rtol=1e-6)
        return
    beams = cfg.beam_elevations_deg or (cfg.elevation_high_deg, cfg.elevation_low_deg)
    high, low = beams[0], beams[-1]
    across = 0.5 * (cfg.azimuth_high_deg - cfg.azimuth_low_deg) / cfg.width if cfg.full_turn or cfg.cells else 0.0
    cell = 0.5 * (high - low) / cfg.height if cfg.cells else 0.0
    pole = 45.0 / (cfg.height - 0.5) if high == 90.0 else cell
    offset = 0.0 if cfg.beam_azimuths_deg is None else cfg.beam_azimuths_deg[cfg.height // 2]
    turn = (
        azimuth[cfg.height // 2, [0, -1]]
        - [cfg.azimuth_high_deg - across + offset, cfg.azimuth_low_deg + across + offset]
    ) % 360.0
    np.testing.assert_allclose(np.minimum(turn, 360.0 - turn), 0.0, atol=1e-4)
    assert elevation[0].min() == pytest.approx(high - pole, abs=1e-4)
    assert elevation[-1].max() == pytest.approx(low + cell, abs=1e-4)


def test_an_unknown_class_of_sensor_is_refused() -> None:
    class Sonar(RangeSensorCfg):
        model = "sonar"

    with pytest.raises(ConfigError, match="Sonar has no ray table. Give them by its method rays"):
        ray_table(Sonar(**COMMON, model="sonar", width=1, height=1), device=CPU)
