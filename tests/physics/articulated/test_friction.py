"""Dry friction in joints, on both backends: a swing that comes to rest, and a weight that is held or not."""

from dataclasses import replace
from itertools import product

import pytest
import torch

from aerial_gym.config.joint import SpringCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.physics.articulated.joint_laws import STICK_RATE
from tests.builders import simulation
from tests.physics.test_links_seen import DOWN, LEFT, arm, bending
from tests.repetitions import frequent_values

INERTIA = 1e-6 + 1e-3 * 0.05**2
"""Of the arm about its hinge [kg m²]: 1 g at 0.05 m."""

WEIGHT = 1e-3 * 9.81 * 0.05
"""Its moment about the hinge where it is level [N m]."""


def course(axis: tuple[float, float, float], friction: float, rate: float, *, backend: str, dt: float, time: float):
    spring = SpringCfg(friction=friction)
    manager = simulation(
        bending(arm(axis, 0.0, rate=rate, spring=spring)), sim=replace(SIMS.get("base_sim"), backend=backend, dt=dt),
        num_envs=1, seed=1,
    )  # fmt: skip
    manager.reset()
    result = []
    for _ in range(round(time / dt)):
        manager.step(torch.zeros(1, 4))
        result.append(torch.cat((manager.gtd["dof_position"][0], manager.gtd["dof_velocity"][0])))
    return torch.stack(result)


@pytest.mark.parametrize(
    ("rate", "backend"), frequent_values(product((1.0, -1.0), ("warp", "torch")), [(1.0, "torch"), (-1.0, "warp")])
)
def test_a_swing_slows_down_evenly_and_stays_where_it_stops(rate, backend) -> None:
    """By F / I: to rest after w I / F = 0.1 s and w² I / 2 F = 0.05 rad, to order 1; it never turns round."""
    off = []
    for dt in (0.004, 0.002):
        result = course(LEFT, 10.0 * INERTIA, rate, backend=backend, dt=dt, time=0.2)
        assert (result[:, 1] * rate > -1e-6).all()
        assert result[round(0.11 / dt) :, 1].abs().max() < STICK_RATE
        half = round(0.052 / dt)
        assert result[half - 1, 1].item() == pytest.approx(rate * (1.0 - 10.0 * half * dt), abs=6.0 * dt)
        off.append(abs(result[-1, 0].item()) - 0.05)
    assert abs(off[1]) < 0.6 * abs(off[0])
    assert abs(off[1]) < 2e-3


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_a_weight_is_held_by_more_friction_and_falls_from_less(backend) -> None:
    held = course(DOWN, 2.0 * WEIGHT, 0.0, backend=backend, dt=0.01, time=0.5)
    assert held[-1, 1].item() == pytest.approx(0.5 * STICK_RATE, rel=1e-3)
    assert 0.0 < held[-1, 0].item() < 0.5 * STICK_RATE
    falls = course(DOWN, 0.5 * WEIGHT, 0.0, backend=backend, dt=0.001, time=0.02)
    expected = 0.5 * 0.5 * WEIGHT / INERTIA * 0.02**2
    assert falls[-1, 0].item() == pytest.approx(expected, rel=0.08)
