"""Images of some environments alone: the others stay as they are, and what comes after is as if all had been taken at once."""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.robots import ROBOTS
from tests.builders import simulation

E = 3


def build() -> EnvManager:
    """Return a simulation with a noisy sensor of a rate and a latency, one of a rate alone, and one of neither."""
    sensors = (
        SensorMountCfg(sensor="st_vl53l5cx", name="late", rate_hz=6.0, latency_s=0.2),
        SensorMountCfg(sensor="st_vl53l5cx", name="slow", rate_hz=4.0),
        SensorMountCfg(sensor="st_vl53l5cx", name="plain"),
    )
    robot = replace(ROBOTS.get("tinyprop"), sensors=sensors)
    return simulation(robot, "lee_velocity_control", env="dynamic_env", num_envs=E, seed=1)


def copy_images(env: EnvManager) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in env.gtd.items() if key.endswith("pixels")}


def test_looking_before_a_reset_and_once_more_where_it_was_gives_the_same_images() -> None:
    once, twice = build(), build()
    for env in (once, twice):
        env.reset()
        env.render()
    actions, number = torch.linspace(-0.5, 0.5, 4 * E).view(E, 4), torch.arange(E)
    changed = 0
    for step in range(12):
        mask = (number + step) % 5 == 0
        once.step(actions)
        once.reset(mask)
        once.render()
        twice.step(actions)
        twice.render()
        before = copy_images(twice)
        twice.reset(mask)
        twice.render(mask)
        result = copy_images(twice)
        assert not [key for key, image in copy_images(once).items() if not torch.equal(result[key], image)]
        assert not [key for key in result if not torch.equal(result[key][~mask], before[key][~mask])]
        changed += sum(not torch.equal(result[key][mask], before[key][mask]) for key in result if mask.any())
    assert changed > 10
