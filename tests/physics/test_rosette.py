"""Rosettes of turning prisms: angles, times, coverage, motion, resets; and the lidars that makers build so."""

from dataclasses import replace
from math import acos, asin, degrees, pi, radians, sin
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym.config.sensor import LidarCfg, PrismCfg, RosetteCfg, load_sensor
from aerial_gym.errors import ConfigError
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import SENSORS, SensorManager
from aerial_gym.sensors.mounts import Carrier
from aerial_gym.sensors.rays import ray_table, rosette_rays, through_prisms
from aerial_gym.sensors.scan import column_group_ages
from tests.physics.sensor_rig import LEVEL, make_caster, make_wall

CPU = torch.device("cpu")
AHEAD = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
THIN = PrismCfg(wedge_deg=0.01, turns_hz=7.0, refractive_index=1.5)
ROSETTE = RosetteCfg(
    summary="test rosette", width=60, height=1,
    prisms=(
        PrismCfg(wedge_deg=18.0, turns_hz=-121.0, refractive_index=1.51),
        PrismCfg(wedge_deg=17.0, turns_hz=78.0, refractive_index=1.51),
    ),
    frames=5, rate_hz=10.0, scan_columns=1, min_range=0.0, max_range=60.0, source="chosen for the test",
)  # fmt: skip

pytestmark = pytest.mark.usefixtures("few_rays")


def rosette(name: str) -> RosetteCfg:
    return SENSORS.get(name)


def off_axis(rays: Tensor) -> Tensor:
    """Return the angle of rays (..., 3) from the x axis [rad], accurate for small ones too."""
    return torch.atan2(rays[..., 1:].double().norm(dim=-1), rays[..., 0].double())


@pytest.mark.parametrize("face", ["entry", "exit"])
def test_one_prism_deflects_by_snells_law(face: str) -> None:
    """A beam along the axis: refracted at the inclined entry by a, then at the flat exit; or at the inclined exit alone.
    Entry: deflection asin(n sin(a - asin(sin a / n))). Exit: asin(n sin a) - a. It turns towards the thick end with the
    prism."""
    wedge, index = radians(20.0), 1.5
    prism = PrismCfg(wedge_deg=20.0, turns_hz=2.0, refractive_index=index, inclined_face=face)
    time = torch.tensor([0.0, 0.125, 0.25], dtype=torch.float64)  # 0, 90 and 180 degrees
    result = through_prisms([prism], time, AHEAD)
    deflection = (
        asin(index * sin(wedge - asin(sin(wedge) / index))) if face == "entry" else asin(index * sin(wedge)) - wedge
    )
    torch.testing.assert_close(
        off_axis(result), torch.full((3,), deflection, dtype=torch.float64), rtol=1e-12, atol=0.0
    )
    side = torch.sign(result[0, 1])
    expected = torch.tensor([[side, 0.0], [0.0, side], [-side, 0.0]], dtype=torch.float64) * sin(deflection)
    torch.testing.assert_close(result[:, 1:], expected, rtol=0.0, atol=1e-12)


def test_thin_prisms_add_their_deflections_as_vectors() -> None:
    """Deflection (n - 1) a each, to second order in the wedge: the curve is that of two turning vectors."""
    prisms = (THIN, replace(THIN, wedge_deg=0.007, turns_hz=-4.0))
    time = torch.linspace(0.0, 1.0, 50, dtype=torch.float64)
    result = through_prisms(prisms, time, AHEAD)
    sizes = [0.5 * radians(prism.wedge_deg) for prism in prisms]
    angles = [2.0 * pi * prism.turns_hz * time for prism in prisms]
    sign = torch.sign(through_prisms([THIN], time[:1], AHEAD)[0, 1])
    y = sign * sum(size * torch.cos(angle) for size, angle in zip(sizes, angles, strict=True))
    z = sign * sum(size * torch.sin(angle) for size, angle in zip(sizes, angles, strict=True))
    torch.testing.assert_close(result[:, 1:], torch.stack((y, z), dim=-1), rtol=0.0, atol=1e-10)


def test_angles_from_the_axis_follow_the_law_of_cosines() -> None:
    """With thin prisms and incommensurable speeds, P(angle < r) = 1 - acos((r² - a² - b²) / (2 a b)) / pi."""
    prisms = (THIN, replace(THIN, wedge_deg=0.007, turns_hz=-4.0 * 2.0**0.5))
    time = torch.linspace(0.0, 300.0, 200_000, dtype=torch.float64)
    angle = off_axis(through_prisms(prisms, time, AHEAD))
    a, b = (0.5 * radians(prism.wedge_deg) for prism in prisms)
    for share in (0.25, 0.5, 0.8, 0.95):
        r = a - b + share * 2.0 * b
        expected = 1.0 - acos((r * r - a * a - b * b) / (2.0 * a * b)) / pi
        assert float((angle < r).double().mean()) == pytest.approx(expected, abs=2e-3)


def test_a_beam_that_stays_inside_a_prism_is_refused() -> None:
    steep = PrismCfg(wedge_deg=44.0, turns_hz=1.0, refractive_index=1.51, inclined_face="exit")
    with pytest.raises(ConfigError):
        rosette_rays(replace(ROSETTE, prisms=(steep,)), device=CPU)


@pytest.mark.parametrize(("name", "cone_deg"), [("livox_mid40", 38.4), ("livox_mid70", 70.4)])
def test_cones_of_mid_40_and_mid_70_are_those_of_their_data_sheets(name: str, cone_deg: float) -> None:
    cfg = replace(rosette(name), frames=20)
    rays = rosette_rays(cfg, device=CPU)
    assert rays.shape == (20, 1, 10_000, 3)
    assert cfg.width * (cfg.rate_hz or 0.0) == 100_000
    assert 2.0 * degrees(float(off_axis(rays).max())) == pytest.approx(cone_deg, abs=0.15)


def test_avia_sees_what_its_data_sheet_says() -> None:
    """70.4 degrees across, 77.2 up and down, 240,000 points a second of six lasers."""
    cfg = replace(rosette("livox_avia"), frames=20)
    rays = rosette_rays(cfg, device=CPU).double()
    assert cfg.width * cfg.height * (cfg.rate_hz or 0.0) == 240_000
    across, up = (torch.rad2deg(torch.atan2(rays[..., i], rays[..., 0])) for i in (1, 2))
    assert float(across.max() - across.min()) == pytest.approx(70.4, abs=0.5)
    assert float(up.max() - up.min()) == pytest.approx(77.2, abs=0.5)


def test_vlp32c_has_its_uneven_table_and_offsets() -> None:
    """User manual: 12 of 32 beams within 2 degrees of the horizon, the lowest at -25 degrees; two lasers of one column that
    are offset by 4.2 degrees clockwise and by 4.2 the other way look 8.4 degrees apart."""
    cfg = SENSORS.get("velodyne_vlp32c")
    rays = ray_table(cfg, device=CPU).double()
    elevation, azimuth = (
        torch.rad2deg(torch.asin(rays[:, 900, 2])),
        torch.rad2deg(torch.atan2(rays[:, 900, 1], rays[:, 900, 0])),
    )
    assert int((elevation.abs() < 2.001).sum()) == 12
    rows = {round(float(angle), 3): float(turn) for angle, turn in zip(elevation, azimuth, strict=True)}
    assert min(rows) == -25.0
    assert max(rows) == 15.0
    assert rows[0.333] - rows[0.667] == pytest.approx(8.4, abs=1e-4)  # -4.2 and 4.2 degrees clockwise
    assert rows[15.0] - rows[-25.0] == pytest.approx(2.8, abs=1e-4)  # -1.4 and 1.4


@pytest.mark.parametrize(
    ("name", "top", "bottom", "beams"),
    [
        ("velodyne_vlp16", 15.0, -15.0, 16),
        ("velodyne_hdl32e", 10.67, -30.67, 32),
        ("velodyne_hdl64e", 2.0, -24.3333, 64),
    ],
)
def test_even_velodynes_have_the_limits_of_their_manuals(name: str, top: float, bottom: float, beams: int) -> None:
    rays = ray_table(SENSORS.get(name), device=CPU).double()
    elevation = torch.rad2deg(torch.asin(rays[:, 0, 2]))
    assert len(elevation) == beams
    assert (float(elevation[0]), float(elevation[-1])) == pytest.approx((top, bottom), abs=1e-3)


@pytest.mark.parametrize(("name", "degrees_wide"), [("st_vl53l5cx", 45.0), ("st_vl53l7cx", 60.0)])
def test_zones_of_a_time_of_flight_matrix_share_its_field_of_view(name: str, degrees_wide: float) -> None:
    """Eight equal zones; the ray of each is half a zone from its sides."""
    cfg = SENSORS.get(name)
    assert (cfg.azimuth_low_deg, cfg.azimuth_high_deg) == (-0.5 * degrees_wide, 0.5 * degrees_wide)
    rays = ray_table(cfg, device=CPU).double()
    azimuth, elevation = torch.rad2deg(torch.atan2(rays[..., 1], rays[..., 0])), torch.rad2deg(torch.asin(rays[..., 2]))
    middles = degrees_wide * (0.5 - (torch.arange(8) + 0.5) / 8.0).double()
    torch.testing.assert_close(azimuth, middles.expand(8, 8), rtol=0.0, atol=1e-4)
    torch.testing.assert_close(elevation, middles.unsqueeze(-1).expand(8, 8), rtol=0.0, atol=1e-4)


def test_every_round_lidar_of_a_maker_turns() -> None:
    """A column of age t has turned by 360 t / scan_s degrees: motion distortion is on in every one of them."""
    for name in SENSORS.names():
        cfg = SENSORS.get(name)
        if (
            isinstance(cfg, LidarCfg)
            and cfg.full_turn
            and name not in ("base_lidar", "coarse_dome_lidar", "ring_lidar")
        ):
            assert cfg.rate_hz * cfg.scan_s == pytest.approx(1.0), name
            ages = column_group_ages(replace(cfg, scan_columns=1))
            assert (ages[0], ages[-1]) == (pytest.approx(cfg.scan_s * (cfg.width - 1) / cfg.width), 0.0), name


def test_each_image_has_the_next_rays_of_the_table(device: torch.device) -> None:
    """Before a wall at d, the range along a ray is d / x; after the last frame the scan begins anew."""
    caster = make_caster(ROSETTE, make_wall(6.0, device))
    frames = rosette_rays(ROSETTE, device=CPU).double()
    assert (frames[0] - frames[1]).abs().max() > 0.1
    for image in range(7):
        caster.cast()
        expected = 6.0 / frames[image % 5, ..., 0]
        torch.testing.assert_close(caster.images.distance[0, 0].cpu().double(), expected, rtol=1e-6, atol=0.0)


def test_environments_are_at_their_own_place_of_the_table_and_reset_by_mask(device: torch.device) -> None:
    caster = make_caster(ROSETTE, make_wall(6.0, device, num_envs=3))
    frames = rosette_rays(ROSETTE, device=CPU).double()
    seen = [0, 0, 0]
    for call in range(6):
        if call == 2:
            caster.reset(torch.tensor([False, True, False], device=device))
            seen[1] = 0
        caster.due[:] = torch.tensor([True, call != 3, True], device=device)
        before = caster.images.distance.clone()
        caster.cast()
        for env in range(3):
            if not caster.due[env]:
                assert torch.equal(caster.images.distance[env], before[env])
                continue
            expected = 6.0 / frames[seen[env] % 5, ..., 0]
            torch.testing.assert_close(caster.images.distance[env, 0].cpu().double(), expected, rtol=1e-6, atol=0.0)
            seen[env] += 1


def column_ages(cfg: RosetteCfg) -> Tensor:
    """Return the age of each column at the capture [s], (W,): the last one is of that instant."""
    return (cfg.width - 1 - torch.arange(cfg.width, dtype=torch.float64)) / (cfg.width * (cfg.rate_hz or 0.0))


def test_flying_at_a_wall_each_ray_has_the_range_of_its_own_time(device: torch.device) -> None:
    """The wall was v t further away at a ray of age t: r = (d + v t) / x."""
    speed = 8.0
    caster = make_caster(ROSETTE, make_wall(6.0, device), lin_vel=torch.tensor([[speed, 0.0, 0.0]]))
    frames = rosette_rays(ROSETTE, device=CPU).double()
    for image in range(2):
        caster.cast()
        expected = (6.0 + speed * column_ages(ROSETTE)) / frames[image, ..., 0]
        torch.testing.assert_close(caster.images.distance[0, 0].cpu().double(), expected, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("columns", [1, 7, 60])
def test_a_turning_rosette_sees_the_wall_along_the_rays_as_they_were_turned(columns: int, device: torch.device) -> None:
    """Yawing at w, a ray of age t was turned by -w t: r = d / (x cos(w t) + y sin(w t)); columns of a group share one age."""
    cfg, rate = replace(ROSETTE, scan_columns=columns), 3.0
    caster = make_caster(cfg, make_wall(6.0, device), ang_vel=torch.tensor([[0.0, 0.0, rate]]))
    caster.cast()
    rays = rosette_rays(cfg, device=CPU).double()[0]
    ages = torch.cat([group.mean().expand(len(group)) for group in column_ages(cfg).split(columns)])
    expected = 6.0 / (rays[..., 0] * torch.cos(rate * ages) + rays[..., 1] * torch.sin(rate * ages))
    torch.testing.assert_close(caster.images.distance[0, 0].cpu().double(), expected, rtol=2e-6, atol=0.0)


def test_lasers_of_one_pulse_share_its_time(device: torch.device) -> None:
    cfg = replace(ROSETTE, height=2, lasers_deg=((0.0, 1.0), (0.0, -1.0)))
    caster = make_caster(cfg, make_wall(6.0, device), lin_vel=torch.tensor([[8.0, 0.0, 0.0]]))
    caster.cast()
    rays = rosette_rays(cfg, device=CPU).double()[0]
    assert ((rays[0] - rays[1]).norm(dim=-1) > radians(1.0)).all()
    expected = (6.0 + 8.0 * column_ages(cfg)) / rays[..., 0]
    torch.testing.assert_close(caster.images.distance[0, 0].cpu().double(), expected, rtol=1e-6, atol=0.0)


def make_manager(cfg: RosetteCfg, dt: float, device: torch.device) -> tuple[SensorManager, GlobalTensorDictionary]:
    gtd = GlobalTensorDictionary(device=device, sizes={"E": 1})
    zero = torch.zeros(1, 3, device=device)
    state = {"position": zero, "attitude": LEVEL.repeat(1, 1).to(device), "lin_vel": zero, "ang_vel": zero}
    return SensorManager(
        {"top": cfg}, gtd, make_wall(6.0, device), Carrier(**state), num_envs=1, device=device, dt=dt
    ), gtd


def test_the_scan_keeps_time_between_its_frames(device: torch.device) -> None:
    """10 Hz on steps of 20 ms: after n steps frame n // 5 of the table is seen."""
    manager, gtd = make_manager(ROSETTE, 0.02, device)
    manager.reset(torch.ones(1, dtype=torch.bool, device=device))
    frames = rosette_rays(ROSETTE, device=CPU).double()
    for step in range(25):
        manager.capture()
        expected = 6.0 / frames[step // 5, ..., 0]
        torch.testing.assert_close(gtd["depth_range_pixels"][0, 0].cpu().double(), expected, rtol=1e-6, atol=0.0)


def test_frames_shorter_than_a_step_are_refused(device: torch.device) -> None:
    make_manager(ROSETTE, 0.1, device)
    with pytest.raises(ConfigError):
        make_manager(ROSETTE, 0.11, device)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="a graph needs a GPU")
def test_a_captured_image_moves_on_at_every_replay() -> None:
    """The frame is a number on the device: replays of one graph see frame after frame."""
    device = torch.device("cuda:0")
    caster = make_caster(ROSETTE, make_wall(6.0, device))
    frames = rosette_rays(ROSETTE, device=CPU).double()
    caster.cast()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        caster.cast()
    for image in range(1, 7):
        graph.replay()
        expected = 6.0 / frames[image % 5, ..., 0]
        torch.testing.assert_close(caster.images.distance[0, 0].cpu().double(), expected, rtol=1e-6, atol=0.0)


def test_a_scan_from_a_file_is_read_in_order_of_time(tmp_path: Path) -> None:
    """Two lasers and three pulses a frame: lines of one pulse follow each other."""
    angles = [(float(3 * i), 1.0 if i % 2 else -1.0) for i in range(12)]
    lines = ["azimuth_deg,elevation_deg", *(f"{a},{e}" for a, e in angles)]
    (tmp_path / "scan.csv").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "lidar.yaml").write_text(
        "model: rosette\nsummary: s\nwidth: 3\nheight: 2\npath: scan.csv\nframes: 2\nrate_hz: 10.0\nscan_columns: 1\n"
        "min_range: 0.1\nmax_range: 40.0\nsource: made for a test\n",
        encoding="utf-8",
    )
    cfg = load_sensor(tmp_path / "lidar.yaml")
    rays = rosette_rays(cfg, device=CPU).double()
    azimuth = torch.rad2deg(torch.atan2(rays[..., 1], rays[..., 0]))
    expected = 3.0 * torch.arange(12).view(2, 3, 2).transpose(1, 2).double()
    torch.testing.assert_close(azimuth, expected, rtol=0.0, atol=1e-5)
    with pytest.raises(ConfigError):
        rosette_rays(replace(cfg, frames=3), device=CPU)


@pytest.mark.parametrize(
    "changes",
    [
        {"rate_hz": None}, {"prisms": ()}, {"path": "scan.csv"}, {"height": 2}, {"frames": 0}, {"scan_columns": 61},
        {"kind": "depth"}, {"lasers_deg": ((0.0, 50.0),)},
    ],
)  # fmt: skip
def test_impossible_rosettes_are_refused(changes: dict) -> None:
    with pytest.raises(ConfigError):
        replace(ROSETTE, **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"wedge_deg": 0.0}, {"wedge_deg": 45.0}, {"refractive_index": 1.0}, {"turns_hz": float("nan")},
        {"inclined_face": "left"},
    ],
)  # fmt: skip
def test_impossible_prisms_are_refused(changes: dict) -> None:
    with pytest.raises(ConfigError):
        replace(THIN, **changes)
