"""platform_landing_task: where its target is, what a touchdown is, and that both backends feel the same platform."""

import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import CommandCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import Task
from aerial_gym.task.terms.terminations import missed_touchdown, touchdown
from tests.unit.task.hover import begin
from tests.unit.task.hover import make as make_hover

NAME, STANDS = "platform_landing_task", 0.4
"""Height of the body origin [m] where the vehicle stands on the platform: 0.2 m, on skids of 0.2 m."""


def put(task: Task, *, above: float, speed: float, beside: float = 0.0) -> None:
    """Put the robots over their platforms [m], level, with their velocity and so fast downwards [m/s]."""
    state, platform = task.env.robot_manager.tensors.state, task.env.gtd["vec_root_tensor"][:, 1]
    state.position.copy_(platform[:, :3])
    state.position[:, 2] = STANDS + above
    state.position[:, 0] += beside
    state.attitude.copy_(torch.tensor([0.0, 0.0, 0.0, 1.0]))
    state.lin_vel.copy_(platform[:, 7:10])
    state.lin_vel[:, 2] -= speed
    state.ang_vel.zero_()


def test_the_target_stands_on_the_platform_and_drives_with_it() -> None:
    with begin(NAME, 16) as task:
        for _ in range(5):
            before, velocity = task.target_position.clone(), task.values["target_velocity"].clone()
            task.step(torch.zeros(16, 4))  # the weight
            torch.testing.assert_close(task.target_position, before + task.env.dt * velocity, atol=1e-5, rtol=0.0)
        assert task.target_position[:, 2].tolist() == pytest.approx([STANDS] * 16)
        speed = velocity.norm(dim=-1)
        assert 0.2 - 1e-5 <= speed.min() < 0.4 < 0.6 < speed.max() <= 0.8 + 1e-5


@pytest.mark.parametrize(
    ("speed", "beside", "ended"), [(0.3, 0, "landed"), (0.7, 0, "missed"), (0.3, 0.37, "missed"), (1.3, 0, "hard")]
)
def test_a_touchdown_is_near_and_slow(speed: float, beside: float, ended: str) -> None:
    """From 5 mm above: slow on its middle, too fast, on its edge, and as fast as a crash."""
    with begin(NAME, 4, seed=3) as task:
        put(task, above=0.005, speed=speed, beside=beside)
        task.values.own["previous_relative_velocity"].copy_(torch.tensor([0.0, 0.0, -speed]))
        for _ in range(6):
            *_, info = task.step(torch.zeros(4, 4))
            if info["crashes"].any() or info["successes"].any():
                break
        means = task.episode_means()
        assert means[f"ended/{ended}"] == 1.0
        assert bool(info["successes"].all()) is (ended == "landed")


def test_touchdowns_are_told_from_other_touches() -> None:
    force = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [-1.0, 0.0, 0.0]])
    place = torch.tensor([[0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.3, 0.3, 0.0], [0.0, 0.0, 0.0]])
    velocity = torch.tensor([[0.0, 0.0, -0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.4, 0.4, 0.0]])
    given = (force, torch.zeros(4, 3), place, velocity)
    assert touchdown(*given, radius=0.3, speed=0.5).tolist() == [True, False, False, False]
    assert missed_touchdown(*given, radius=0.3, speed=0.5).tolist() == [False, False, True, True]


def test_an_asset_that_is_not_always_there_is_no_target() -> None:
    with pytest.raises(ConfigError, match=r"command asset: name = 'boat': must be an asset with keep: true, of \[\]"):
        make_hover(2, command=CommandCfg(generator="asset", params={"name": "boat"}))


def fly(num: int, backend: str, first: int = 0) -> tuple[Tensor, Tensor]:
    """Return the robots' positions after ten steps over their platforms, (E, 3), and their ground-effect factors k, (E,)."""
    with begin(NAME, num, seed=5, backend=backend, first_env=first) as task:
        put(task, above=0.05, speed=0.0)
        for _ in range(10):
            task.step(torch.zeros(num, 4))
        assert (task.env.gtd["surface_height"] - 0.2).abs().max() < 1e-6
        return task.env.gtd["robot_position"].clone(), task.env.draws()["effects.ground_effect.k"].flatten().clone()


def test_an_environment_is_the_same_alone_and_among_others_and_on_both_backends() -> None:
    """At 0.25 m over the platform thrust as heavy as the vehicle lifts it by ``a dt² n (n + 1) / 2``, a of its own k."""
    many, k = fly(6, "warp")
    assert torch.equal(fly(1, "warp", first=4)[0], many[4:5])
    torch.testing.assert_close(fly(6, "torch")[0], many, atol=2e-6, rtol=0.0)
    share = k * (0.0635 / (4.0 * 0.25)) ** 2
    lifted = 9.81 * share / (1.0 - share) * 0.01**2 * 10 * 11 / 2
    torch.testing.assert_close(many[:, 2] - (STANDS + 0.05), lifted, rtol=0.02, atol=1e-6)
