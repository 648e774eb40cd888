"""How far a ball flies along each ray: against the closed forms of a point and of a wall."""

import pytest
import torch
from torch import Tensor

from aerial_gym.config.camera import CameraCfg
from aerial_gym.sensors import pinhole_rays
from aerial_gym.sensors.encoder import collision
from aerial_gym.sensors.encoder.collision import collision_distance

RADIUS, LARGEST = 0.3, 50.0


def ray_row(*angles: float) -> Tensor:
    """Return unit rays in the plane of x and y at some angles [rad], (1, W, 3)."""
    at = torch.tensor(angles, dtype=torch.float64)
    return torch.stack((at.cos(), at.sin(), torch.zeros_like(at)), dim=-1).unsqueeze(0)


def nearest_collision(distances: list[float], *angles: float, radius: float = RADIUS) -> Tensor:
    seen = torch.tensor(distances, dtype=torch.float64).view(1, 1, -1)
    return collision_distance(seen, ray_row(*angles), radius=radius, largest=LARGEST)[0, 0]


def test_ball_touches_a_point_where_its_centre_is_a_radius_away() -> None:
    """|p - t u| = r with p on the second ray: t = p.u - sqrt(r² - |p x u|²) is the smaller root."""
    point, angle = 2.0, 0.1
    t, own = nearest_collision([LARGEST, point], 0.0, angle)
    place = point * ray_row(angle)[0, 0]
    assert float((place - t * ray_row(0.0)[0, 0]).norm()) == pytest.approx(RADIUS, abs=1e-12)
    assert t < point
    assert float(own) == pytest.approx(point - RADIUS, abs=1e-12)


def test_ball_passes_a_point_that_is_further_beside_its_way_than_its_radius() -> None:
    """|p| sin(angle) = 0.31 > 0.3: nothing is touched; at 0.29 it is."""
    assert float(nearest_collision([LARGEST, 0.31 / 0.5], 0.0, torch.pi / 6)[0]) == LARGEST
    assert float(nearest_collision([LARGEST, 0.29 / 0.5], 0.0, torch.pi / 6)[0]) < 0.6


def test_points_behind_are_left_behind_and_points_within_the_ball_stop_it() -> None:
    """A point 120 degrees beside the ray, 0.32 m away, lies closer to its line than r, but the ball moves away from it."""
    assert float(nearest_collision([LARGEST, 0.32], 0.0, 2.0 * torch.pi / 3)[0]) == LARGEST
    assert float(nearest_collision([LARGEST, 0.25], 0.0, 2.0 * torch.pi / 3)[0]) == 0.0


def test_ball_stops_a_radius_before_a_wall() -> None:
    """Before a wall at d the centre of the ball reaches d - r, whatever its direction: t = (d - r) / cos. Points of the
    wall are h apart, so the one that is touched lies within h of the foot of the ball: its centre gets at most ``r -
    sqrt(r² - h²)`` further."""
    camera = CameraCfg(summary="", width=80, height=48, hfov_deg=87.0, min_range=0.2, max_range=10.0, source="")
    rays, wall = pinhole_rays(camera, device=torch.device("cpu")).double(), 3.0
    ahead = rays[..., 0]
    reached = (collision_distance((wall / ahead).unsqueeze(0), rays, radius=RADIUS, largest=LARGEST)[0] * ahead) - wall
    spacing = wall * float(rays[24, 40, 1] / rays[24, 40, 0] - rays[24, 41, 1] / rays[24, 41, 0])
    beyond = RADIUS - (RADIUS**2 - spacing**2) ** 0.5
    inner = reached[8:-8, 8:-8]  # at the edge the foot lies outside of the image
    assert float(inner.min()) >= -RADIUS - 1e-9
    assert float(inner.max()) <= -RADIUS + beyond


def test_images_and_blocks_of_rays_do_not_change_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(0)
    rays = torch.nn.functional.normalize(torch.randn(4, 6, 3, generator=generator) + torch.tensor([3.0, 0, 0]), dim=-1)
    seen = 5.0 * torch.rand(7, 4, 6, generator=generator)
    whole = collision_distance(seen, rays, radius=RADIUS, largest=LARGEST)
    monkeypatch.setitem(collision.PAIRS, "cpu", 50)
    blocks = collision_distance(seen, rays, radius=RADIUS, largest=LARGEST)
    torch.testing.assert_close(blocks, whole, atol=0.0, rtol=0.0)
    assert bool((whole <= seen).all())
