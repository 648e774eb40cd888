"""The scene of the page: obstacles where the simulation has them, points of sensors, and a page that comes later."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from aerial_gym.config.shape import PartCfg, ShapeCfg
from aerial_gym.env_manager import SimBuilder
from aerial_gym.sensors.catalog import SENSORS
from aerial_gym.viewer.meshes import part_mesh
from aerial_gym.viewer.snapshot import SensorSample

pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.live import LiveView
from aerial_gym.viewer.scene import sensor_points
from aerial_gym.viewer.simulation import FlightInView

if TYPE_CHECKING:
    from viser import ViserServer


@pytest.fixture(scope="module")
def view(server: "ViserServer") -> LiveView:
    env = SimBuilder().build_env(
        sim_name="base_sim", env_name="env_with_obstacles", robot_name="base_quadrotor_with_camera",
        controller_name="lee_position_control", num_envs=2, device="cpu", seed=0,
    )  # fmt: skip
    return LiveView(server, FlightInView(env))


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (ShapeCfg(kind="box", size=(1.0, 2.0, 3.0)), (1.0, 2.0, 3.0)),
        (ShapeCfg(kind="sphere", radius=0.5), (1.0, 1.0, 1.0)),
        (ShapeCfg(kind="cylinder", radius=0.5, height=2.0), (1.0, 1.0, 2.0)),
        (ShapeCfg(kind="capsule", radius=0.5, height=2.0), (1.0, 1.0, 3.0)),
    ],
)
def test_mesh_has_the_size_and_place_of_its_part(shape: ShapeCfg, size: tuple[float, float, float]) -> None:
    mesh = part_mesh(PartCfg(shape=shape, position=(1.0, 2.0, 3.0)))
    np.testing.assert_allclose(mesh.extents, size, rtol=0.01)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), (1.0, 2.0, 3.0), atol=1e-6)


def test_obstacles_are_where_the_simulation_has_them(view: LiveView, server: "ViserServer") -> None:
    """Boxes of one part each, so that their instances have the poses of ``vec_root_tensor``."""
    snapshot, content = view.scene.last, view.scene.content
    assert snapshot is not None
    for row in set(snapshot.part_row.tolist()) - {-1}:
        node = server.scene.get_handle_by_name(f"/obstacles/{row}")
        assert node is not None
        places = snapshot.part_place[snapshot.part_row == row]
        np.testing.assert_allclose(node.batched_positions, places[:, :3], atol=1e-5)  # pyright: ignore[reportAttributeAccessIssue]
        size = content.parts[row].shape.size
        assert size is not None
        assert node.visible == (max(size) < 15.0)


def test_points_are_along_the_rays() -> None:
    """A sensor at (1, 0, 0), turned by 90 degrees about z: 2 m ahead is (1, 2, 0). Misses have no point."""
    lidar = SENSORS.get(next(name for name in SENSORS if "lidar" in name))
    cfg = replace(lidar, normalize=False)
    rays = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    reading = SensorSample(
        position=np.array([[1.0, 0.0, 0.0]], dtype=np.float32),
        attitude=np.array([[0.0, 0.0, 0.5**0.5, 0.5**0.5]], dtype=np.float32),
        distance=np.array([[[2.0, cfg.far_pixel]]], dtype=np.float32),
    )
    np.testing.assert_allclose(sensor_points(cfg, rays, reading), [[1.0, 2.0, 0.0]], atol=1e-6)


def test_pause_and_single_step(view: LiveView) -> None:
    flight, panel = view._flight, view.panel
    panel.paused, panel.single_steps = True, 0
    view.advance(0.1)
    before = flight.env.gtd["sim_steps"].clone()
    view.advance(0.1)
    assert torch.equal(flight.env.gtd["sim_steps"], before)
    panel.single_steps = 1
    view.advance(0.1)
    assert torch.equal(flight.env.gtd["sim_steps"], before + 1)
    panel.paused, panel.speed = False, 0.5
    for _ in range(4):
        view.advance(10.0 * flight.env.dt)
    assert int(flight.env.gtd["sim_steps"][0] - before[0]) == pytest.approx(1 + 20, abs=1)


def test_calls_of_the_page_are_made_between_steps(view: LiveView) -> None:
    made: list[int] = []
    view.panel.requests.append(lambda: made.append(1))
    view.advance(0.0)
    assert made == [1]
    assert not view.panel.requests
