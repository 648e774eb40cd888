"""dce_navigation_task: navigation by an encoder that comes with the package, three actions, no noise, full rooms."""

import torch

from aerial_gym import task_registry
from aerial_gym.rl_training import settings_for
from aerial_gym.sensors.encoder.file import load_encoder, normalize_image
from aerial_gym.task.terms.actions import ACTIONS
from tests.unit.sensors.encoder.encoders import coarse_camera

NAME, ENCODER = "dce_navigation_task", "collision_40x24"


def test_layout_of_81_numbers_is_kept_without_noise() -> None:
    """A fifth of the distance at place 3, latents of the present image behind the 17 numbers of the state."""
    with task_registry.make_task(NAME, num_envs=4, device="cpu", seed=2) as task:
        observation, _ = task.reset()
        seen = observation["observations"]
        assert seen.shape == (4, 81)
        distance = (task.target_position - task.env.gtd["robot_position"]).norm(dim=-1)
        torch.testing.assert_close(seen[:, 3], 0.2 * distance, atol=1e-6, rtol=0.0)
        latents = load_encoder(ENCODER)(normalize_image(task.env.gtd["depth_range_pixels"][:, 0], coarse_camera()))
        torch.testing.assert_close(seen[:, 17:], latents, atol=1e-5, rtol=0.0)
        assert all(entry.cfg.noise_std == 0.0 for entry in task.observation_terms["observations"])
        assert int(task.env.gtd["curriculum_level"]) == 36


def test_three_actions_are_those_of_navigation_without_its_idle_one() -> None:
    actions = torch.rand(5, 4, generator=torch.Generator().manual_seed(0)) * 2.4 - 1.2
    with task_registry.make_task(NAME, num_envs=5, device="cpu") as task:
        assert task.num_actions == 3
        params = dict(task.cfg.action.params)
    three, four = (ACTIONS.get(name).value for name in ("forward_flight_3", "forward_flight"))
    torch.testing.assert_close(three(actions[:, :3], **params), four(actions, **params), atol=0.0, rtol=0.0)


def test_encoder_of_the_package_tells_how_far_the_robot_could_fly() -> None:
    trained = load_encoder(ENCODER).trained
    assert (trained["target"], trained["robot"]) == ("collision", "base_quadrotor_with_coarse_camera")


def test_it_is_trained_with_the_settings_of_navigation() -> None:
    assert settings_for("ppo", NAME, device="cpu") == settings_for("ppo", "navigation_task", device="cpu")
