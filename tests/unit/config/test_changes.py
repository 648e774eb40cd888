"""Single settings by dotted keys: types, entries of lists and mappings, and all wrong ones together."""

import pytest

from aerial_gym import ROBOTS, task_registry
from aerial_gym.config.changes import Changes, changes_simulation, settings_of_run
from aerial_gym.errors import ConfigError


def apply_to_base(*settings: str, name: str = "base_quadrotor"):
    changes = Changes(settings)
    robot = changes.apply("robot", ROBOTS.get(name))
    changes.finish()
    return robot


def test_a_value_takes_the_type_of_its_field() -> None:
    robot = apply_to_base("robot.body.mass=3e-1", "robot.body.com=[0, 0, 1e-2]", "robot.summary=12", "robot.imu=null")
    assert (robot.body.mass, robot.body.com, robot.summary, robot.imu) == (0.3, (0.0, 0.0, 0.01), "12", None)


def test_entries_of_lists_and_mappings_are_changed_added_and_removed() -> None:
    robot = apply_to_base("robot.mounts.layout.1.position=[1, 2, 3]", "robot.effects.linear_drag.x=0.1")
    assert robot.mounts.layout[1].position == (1.0, 2.0, 3.0)
    assert robot.mounts.layout[0] == ROBOTS.get("base_quadrotor").mounts.layout[0]
    assert robot.effects == {"linear_drag": {"x": 0.1}}
    bent = apply_to_base("robot.joints.layout.elevation_2.spring.stiffness=0.7", name="morphy").joints.layout
    assert [joint.spring.stiffness == 0.7 for joint in bent] == [joint.name == "elevation_2" for joint in bent]
    changes = Changes(
        ["task.rewards.still=null", "task.rewards.near.params.height=5", "task.observations.policy.0.scale=2"]
    )
    task = changes.apply("task", task_registry.get("position_setpoint_task"))
    assert "still" not in task.rewards
    assert (task.rewards["near"].params["height"], task.observations["policy"][0].scale) == (5, 2.0)


def test_without_settings_the_configuration_itself_is_returned() -> None:
    robot = ROBOTS.get("base_quadrotor")
    assert Changes(["task.num_envs=3"]).apply("robot", robot) is robot


def test_all_wrong_settings_are_reported_together() -> None:
    settings = (
        "robot.body.mas=1", "robot.body.mass=heavy", "robot.body.mass.x=1", "robot.mounts.layout.9.spin=1",
        "robt.body.mass=1", "robot.visible", "body.mass=2", "robot.randomize.mass.low=1",
    )  # fmt: skip
    with pytest.raises(ConfigError) as refused:
        apply_to_base(*settings)
    head, *lines = str(refused.value).splitlines()
    assert head == "8 faults:"
    for text in (
        "'robot.visible': must be KEY=VALUE",
        "robot.body.mas: no setting 'mas' here. Did you mean 'mass'?",
        "robot.body.mass: is 0.25, which has no part 'x'",
        "robot.mounts.layout.9: no setting '9' here. Known: 0, 1, 2, 3",
        "robt.body.mass: no setting 'robt' here. Did you mean 'robot'?",
    ):
        assert any(text in line for line in lines), text


@pytest.mark.parametrize(("setting", "message"), [
    ("robot.body.mass=-1", "BodyCfg.mass = -1.0: must be > 0"),
    ("robot.body.com=[0, 0]", "robot.body.com = .*must have 3 entries"),
    ("controller.allocation=clmp", "controller.allocation = 'clmp': must be 'prioritised' or 'clamp'"),
    ("robot.mounts.layout.0.spin=up", "robot.mounts.layout.0.spin = 'up': must be a whole number"),
])  # fmt: skip
def test_impossible_values_are_refused_with_the_rule(setting, message) -> None:
    changes = Changes([setting])
    task_registry.configurations("position_setpoint_task", changes)
    with pytest.raises(ConfigError, match=message):
        changes.finish()


def test_settings_of_a_run_end_with_their_robot_or_task() -> None:
    settings = ("robot.body.mass=1", "task.episode_len_steps=5", "env.clearance=1", "controller.rate_hz=50")
    assert settings_of_run(settings, robot=None, task=None) == settings
    assert settings_of_run(settings, robot="x500", task=None) == settings[1:]
    assert settings_of_run(settings, robot=None, task="racing_task") == settings[:1]
    assert [changes_simulation(each) for each in (*settings, "robot=x500", "ppo.horizon=3")] == [True] * 4 + [False] * 2


def test_a_task_refuses_a_setting_that_is_an_argument_too() -> None:
    with pytest.raises(ConfigError, match="task.num_envs: it is given as num_envs already"):
        task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", settings=("task.num_envs=3",))


def test_a_task_is_built_with_changed_settings() -> None:
    settings = ("robot.body.mass=0.3", "sim.dt=0.02", "task.num_envs=3", "controller.action_delay=0.04")
    with task_registry.make_task("position_setpoint_task", device="cpu", settings=settings) as task:
        assert task.env.gtd["robot_mass"].tolist() == pytest.approx([0.3] * 3)
        assert task.env.dt == pytest.approx(0.02)
    assert task_registry.configurations("position_setpoint_task", Changes(settings))[-1].action_delay == 0.04
