"""Latents in place of cells, the encoder's of the present image; ``dce_navigation_task`` has those of the package."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import load_settings, settings_for
from aerial_gym.sensors.encoder.file import load_encoder, normalize_image
from aerial_gym.task.terms.actions import ACTIONS
from tests.unit.sensors.encoder.encoders import ROBOT, coarse_camera, random_encoder
from tests.unit.task.hover import begin, build_task

NAME, ENCODER = "dce_navigation_task", "collision_40x24"


@pytest.fixture
def encoder(tmp_path: Path) -> str:
    random_encoder().save(tmp_path / "encoder.pt")
    return str(tmp_path / "encoder.pt")


def test_latents_stand_where_cells_stood_also_for_the_critic(encoder: str) -> None:
    with begin("navigation_task", 6, seed=1, robot=ROBOT, encoder=encoder) as task:
        observation, _ = task.reset()
        for _ in range(3):
            expected = load_encoder(encoder)(normalize_image(task.env.gtd["depth_range_pixels"][:, 0], coarse_camera()))
            assert observation["observations"].shape == (6, 81)
            torch.testing.assert_close(observation["observations"][:, 17:], expected, atol=1e-5, rtol=0.0)
            before = expected
            observation, *_ = task.step(torch.tensor([[1.0, 0.0, 0.5, 0.0]]).expand(6, 4))
        assert float((observation["observations"][:, 17:] - before).abs().max()) > 1e-4
    with begin("safe_navigation_task", 2, robot=ROBOT, encoder=encoder) as task:
        observation, _ = task.reset()
        torch.testing.assert_close(observation["critic"][:, 17:81], observation["observations"][:, 17:81])


def test_what_has_no_place_for_them_is_told(encoder: str) -> None:
    with pytest.raises(ConfigError, match="this task has no image_latents and no nearest_in_cells"):
        task_registry.make_task("position_setpoint_task", num_envs=1, device="cpu", encoder=encoder)
    with pytest.raises(ConfigError, match="knows images of 40 x 24 pixels .* sensor base_depth_camera has 240 x 135"):
        task_registry.make_task("navigation_task", num_envs=1, device="cpu", encoder=encoder)
    task = task_registry.get("navigation_task")
    entries = task.observations["policy"]
    seen = tuple(replace(e, term="image_latents") if e.term == "nearest_in_cells" else e for e in entries)
    with pytest.raises(ConfigError, match=r"observation term 'image_latents': needs an encoder: --encoder FILE"):
        build_task(replace(task, robot=ROBOT, observations={"policy": seen}), 1)


def test_run_folder_keeps_its_encoder(encoder: str, tmp_path: Path) -> None:
    cfg = replace(load_settings(settings_for("ppo", "navigation_task")), robot=ROBOT, encoder=encoder)
    RunFolder(tmp_path / "run").create(cfg)
    Path(encoder).unlink()
    (tmp_path / "run").rename(tmp_path / "moved")
    result = RunFolder(tmp_path / "moved").config()
    assert result.encoder == str(tmp_path / "moved" / "encoder.pt")
    load_encoder(result.encoder)


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


def test_the_encoder_and_the_settings_are_those_of_navigation() -> None:
    trained = load_encoder(ENCODER).trained
    assert (trained["target"], trained["robot"]) == ("collision", "base_quadrotor_with_coarse_camera")
    assert settings_for("ppo", NAME, device="cpu") == settings_for("ppo", "navigation_task", device="cpu")
