"""One policy for many vehicles: actions that are shares of what rotors can be told, and a robot that every episode draws."""

import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.task import task_registry

NAME = "any_quadrotor_task"


@pytest.mark.parametrize(
    ("robot", "controller", "low", "high"),
    [
        (None, None, 0.0, (2.0 / 3.485449e-7) ** 0.5),  # 2 N [rad/s]
        ("tinyprop", None, (0.2 / 3.25852e-7) ** 0.5, (1.2 / 3.25852e-7) ** 0.5),
        ("x500", "no_control", 0.0, 20.0),  # N
    ],
)
def test_an_action_is_a_share_of_what_the_rotors_can_be_told(
    robot: str | None, controller: str | None, low: float, high: float
) -> None:
    with task_registry.make_task(NAME, num_envs=2, device="cpu", robot=robot, controller=controller) as task:
        task.reset()
        for action, expected in ((-1.0, low), (0.0, 0.5 * (low + high)), (1.0, high)):
            task.step(torch.full((2, 4), action))
            told = task.env.gtd["robot_actions"]
            torch.testing.assert_close(told, torch.full((2, 4), expected), rtol=1e-6, atol=1e-3)


def test_a_controller_that_tells_no_rotors_is_refused() -> None:
    with pytest.raises(ConfigError, match="action rotor_range: controller lee_attitude_control tells no rotors"):
        task_registry.make_task(NAME, num_envs=2, device="cpu", controller="lee_attitude_control")


def test_every_episode_draws_a_vehicle_of_thrust_to_weight_from_1_2_to_5() -> None:
    """What the robot has at full thrust, 3.26, times the factor that is drawn; another one in the next episode."""
    robot = ROBOTS.get("sampled_quadrotor")
    own = 4.0 * robot.the_rotor("the test").thrust_range[1] / (robot.body.mass * 9.81)
    with task_registry.make_task(NAME, num_envs=2000, device="cpu", seed=0) as task:
        task.reset()
        first = {name: drawn.clone() for name, drawn in task.env.draws().items()}
        ratio = own * first["rotor.thrust_map"].flatten(1)[:, -1]
        assert 1.2 <= float(ratio.min()) < 1.25
        assert 4.8 < float(ratio.max()) < 5.01
        task.reset()
        assert float((task.env.draws()["body.inertia"] != first["body.inertia"]).float().mean()) > 0.99
