"""payload_task: where the vehicle belongs, what it sees of the load, and when the load is held."""

import pytest
import torch

from aerial_gym.config.task_terms import CommandCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import OBSERVATIONS, REWARDS, TERMINATIONS, task_registry
from tests.unit.task.hover import make as make_hover

NAME = "payload_task"


def test_the_vehicle_belongs_a_link_above_the_place_of_the_load() -> None:
    with task_registry.make_task(NAME, num_envs=500, device="cpu", seed=0) as task:
        obs, _ = task.reset()
        mass, length, _ = task.env.gtd["effect_slung_payload"].unbind(-1)
        assert 0.02 <= mass.min() < 0.03 < 0.09 < mass.max() <= 0.1
        assert 0.3 <= length.min() < 0.35 < 0.95 < length.max() <= 1.0
        above = task.target_position - task.values["load_target"]
        torch.testing.assert_close(above, torch.stack((0.0 * length, 0.0 * length, length), dim=-1))
        assert (task.values["load_target"][:, 0] >= 0.5 - 1e-6).all()  # 0.75 of bounds of +-1 m
        seen = obs["observations"]
        assert seen.shape == (500, 21)
        torch.testing.assert_close(seen[:, 15:18], torch.stack((0.0 * length, 0.0 * length, -length), dim=-1))
        before = task.target_position.clone()
        task._begin(torch.arange(500) < 250, counted=False)
        assert torch.equal(before[250:], task.target_position[250:])


def test_terms_of_the_load_are_their_formulas() -> None:
    place, target = torch.tensor([[0.0, 0.3, 0.0], [0.0, 0.0, 0.05]]), torch.zeros(2, 3)
    velocity, own = torch.tensor([[0.0, 0.0, 0.2], [0.09, 0.0, 0.0]]), torch.tensor([[0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    result = REWARDS.get("load_distance_bell").value(target, place, height=3.0, width=8.0)
    torch.testing.assert_close(result, 3.0 * torch.tensor([-8.0 * 0.09, -8.0 * 0.0025]).exp())
    result = REWARDS.get("load_slow").value(velocity, height=1.0, width=2.0)
    torch.testing.assert_close(result, torch.tensor([-2.0 * 0.04, -2.0 * 0.0081]).exp())
    held = TERMINATIONS.get("load_at_rest").value(target, place, velocity, distance=0.1, speed=0.1)
    assert held.tolist() == [False, True]
    away = OBSERVATIONS.get("load_offset_world").value(place, own)
    torch.testing.assert_close(away, torch.tensor([[0.0, 0.2, 0.0], [0.0, 0.0, 0.05]]))
    relative = OBSERVATIONS.get("load_vel_world").value(velocity, own)
    torch.testing.assert_close(relative, torch.tensor([[0.0, -0.1, 0.2], [0.09, 0.0, 0.0]]))


def test_a_robot_without_a_load_is_refused_and_so_are_shares_beyond_the_bounds() -> None:
    ends = {"low": (0.1, 0.1, 0.1), "high": (0.9, 0.9, 0.9)}
    with pytest.raises(ConfigError, match="command load_point: nothing hangs on the robot"):
        make_hover(2, command=CommandCfg(generator="load_point", params=ends))
    with pytest.raises(ConfigError, match="command drawn_point: low = .*: needs 0 <= low <= high <= 1"):
        make_hover(2, command=CommandCfg(generator="drawn_point", params={**ends, "high": (0.9, 0.9, 1.1)}))
