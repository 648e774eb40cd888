"""Tasks by name, from a file, and from a module of the user's own; and what ``make_task`` may replace in them.
One policy for many vehicles: actions that are shares of what rotors can be told, and a robot that every episode draws.
"""

from dataclasses import replace
from itertools import product
from math import copysign
from pathlib import Path

import pytest
import torch

from aerial_gym import ROBOTS, task_registry
from aerial_gym.config import dump_yaml
from aerial_gym.config.task_terms import EndRewardCfg, RewardCfg
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.task.rotor_range import quadrotor_to_rotors_matrix, rotor_order, with_rotor_range
from tests.refusals import assert_refused
from tests.repetitions import frequent_values
from tests.unit.task.hover import begin

MODULE = """
from dataclasses import replace
from aerial_gym import Task, task_registry
SHORT = replace(task_registry.get("position_setpoint_task"), episode_len_steps=7)
class Quiet(Task):
    cfg = SHORT
    def step(self, actions):
        return super().step(0.0 * actions)
NUMBER = 3
"""


def test_a_file_and_a_module_hold_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = replace(task_registry.get("position_setpoint_task"), episode_len_steps=5)
    (tmp_path / "short.yaml").write_text(dump_yaml(short))
    (tmp_path / "users_task.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    assert task_registry.get("short.yaml") == short
    assert task_registry.get("users_task:SHORT").episode_len_steps == 7
    made = task_registry.make_task("users_task:Quiet", num_envs=2, device="cpu")
    assert type(made).__name__ == "Quiet"
    assert (made.num_envs, made.cfg.episode_len_steps) == (2, 7)


def test_a_file_may_extend_a_registered_task(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "extends: tracking_task\nepisode_len_steps: 7\nrewards: {calm: null}\nobservations: {policy: [{term: attitude}]}\n"
    )
    base, own = task_registry.get("tracking_task"), task_registry.get(str(file))
    assert (own.episode_len_steps, own.robot) == (7, base.robot)
    assert list(own.rewards) == [name for name in base.rewards if name != "calm"]
    assert [entry.term for entry in own.observations["policy"]] == ["attitude"]


def test_a_file_may_bring_terms_of_its_own(tmp_path: Path) -> None:
    own = "@REWARDS.term()\ndef five_of_its_own(robot_position):\n    return 5.0 + 0.0 * robot_position[:, 0]\n"
    (tmp_path / "my_terms.py").write_text(f"from aerial_gym.task import REWARDS\n{own}")
    task = task_registry.get("position_setpoint_task")
    rewards = {"five": RewardCfg(term="five_of_its_own")}
    file = tmp_path / "mine.yaml"
    file.write_text(dump_yaml(replace(task, imports=("my_terms.py",), rewards=rewards, crash_reward=None)))
    with begin(str(file), 2) as made:
        assert made.step(torch.zeros(2, 4))[1].tolist() == [5.0, 5.0]
    file.write_text(dump_yaml(replace(task, imports=("no_terms.py",))))
    assert_refused(UnknownNameError, r"no_terms.py: no such file", task_registry.get, str(file))


@pytest.mark.parametrize(("name", "error", "message"), [
    ("nowhere.yaml", ConfigError, "nowhere.yaml: no such file"),
    ("no_such_module:Task", UnknownNameError, "no_such_module:Task.*No module named"),
    ("json:Task", UnknownNameError, "has no attribute 'Task'. Give it as module:Name"),
    ("json:JSONDecoder", ConfigError, "must be a TaskCfg, or a subclass of Task that has one as its cfg"),
])  # fmt: skip
def test_what_is_no_task_is_refused(name: str, error: type[Exception], message: str) -> None:
    assert_refused(error, message, task_registry.get, name)


def test_sim_environment_and_robot_can_be_replaced() -> None:
    changes = {"sim": "base_sim_2ms", "env": "landing_env", "robot": "tinyprop"}
    task = task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", **changes)
    assert task.env.dt == pytest.approx(0.002 * task.env.cfg.physics_steps_per_env_step)
    assert (task.cfg.sim, task.cfg.env, task.cfg.robot) == ("base_sim_2ms", "landing_env", "tinyprop")
    with pytest.raises(UnknownNameError, match="base_sim_2ms"):
        task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", sim="base_sim_1ms")


def test_safe_navigation_is_navigation_but_for_what_it_says() -> None:
    task, safe = task_registry.get("navigation_task"), task_registry.get("safe_navigation_task")
    assert task.crash_reward == EndRewardCfg(value=-100.0)
    assert safe.crash_reward == EndRewardCfg(value=-300.0, difficulty_value=-3000.0)
    seen, expected = ([entry.term for entry in cfg.observations["policy"]] for cfg in (safe, task))
    assert [term.replace("log_", "") for term in seen] == expected
    same = {"observations": task.observations, "crash_reward": task.crash_reward}
    assert replace(safe, **same, summary=task.summary, source=task.source) == task


@pytest.mark.parametrize("name", ["position_setpoint_task", "tracking_task"])
def test_a_smooth_task_is_the_task_but_for_its_reward(name: str) -> None:
    task, smooth = task_registry.get(name), task_registry.get(f"smooth_{name}")
    told = {"summary": task.summary, "source": task.source}
    assert replace(smooth, rewards=task.rewards, **told) == task


def test_a_task_may_say_how_flights_begin() -> None:
    """Every attitude, and speeds and rates up to what the task says; the robot's own starts are level and slow."""
    cfg = task_registry.get("recovery_task")
    with begin("recovery_task", 500) as task:
        gtd = task.env.gtd
        up = 1.0 - 2.0 * gtd["robot_orientation"][:, :2].square().sum(dim=-1)
        assert float(up.min()) < -0.9 < 0.9 < float(up.max())
        for key, name in (("robot_linvel", "lin_vel"), ("robot_body_angvel", "ang_vel")):
            low, high = (getattr(cfg.start, f"{name}_{end}")[0] for end in ("low", "high"))
            assert low <= float(gtd[key].min()) < 0.95 * low
            assert 0.95 * high < float(gtd[key].max()) <= high
        assert float(task.target_position.sub(gtd["robot_position"]).abs().max()) <= 0.3 + 1e-6


def test_the_target_of_agile_tracking_accelerates_by_2_g() -> None:
    """Second differences of where it is, over a whole round; their error is (w dt)² / 12, 5e-5 of the largest term."""
    with begin("agile_tracking_task", 4) as task:
        hold = torch.tensor([[-0.375, 0.0, 0.0, 0.0]]).expand(4, -1)  # weight, no turning: nobody leaves in 2.6 s
        seen = []
        for _ in range(260):
            seen.append(task.target_position.clone().double())
            task.step(hold)
        whole = torch.stack(seen)
        pace = (whole[2:] - 2.0 * whole[1:-1] + whole[:-2]) / task.env.dt**2
        largest = pace.norm(dim=-1).max() / 9.80665
        assert float(largest) == pytest.approx(2.0, rel=0.02)


def test_gusts_push_a_vehicle_by_its_drag() -> None:
    """Velocities after one step differ from those in still air by ``d w dt / m``, w of 3 m/s on each axis, d from dy to dx."""
    speeds = []
    for robot in (None, "base_quadrotor_with_drag"):
        with begin("gust_rejection_task", 4096, robot=robot) as task:
            task.step(torch.zeros(4096, 4))
            speeds.append(task.env.gtd["robot_linvel"][:, :2].clone())
    push = (speeds[0] - speeds[1]).std(dim=0) / (3.0 * task.env.dt)
    assert bool((push > 0.35).all())
    assert bool((push < 0.58).all())


NAME = "any_quadrotor_task"


@pytest.mark.parametrize(("robot", "controller", "low", "high"), [
    (None, None, 0.0, (2.0 / 3.485449e-7) ** 0.5),  # 2 N [rad/s]
    ("tinyprop", None, (0.2 / 3.25852e-7) ** 0.5, (1.2 / 3.25852e-7) ** 0.5),
    ("x500", "no_control", 0.0, 20.0),  # N
])  # fmt: skip
def test_an_action_is_a_share_of_what_the_rotors_can_be_told(robot, controller, low, high) -> None:
    with begin(NAME, 2, robot=robot, controller=controller) as task:
        for action, expected in ((-1.0, low), (0.0, 0.5 * (low + high)), (1.0, high)):
            task.step(torch.full((2, 4), action))
            told = task.env.gtd["robot_actions"]
            torch.testing.assert_close(told, torch.full((2, 4), expected), rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("robot", ["base_quadrotor", "x500"])
def test_an_action_goes_to_the_rotor_at_its_place(robot: str) -> None:
    places = ((1, -1), (-1, -1), (-1, 1), (1, 1))
    mounts = ROBOTS.get(robot).mounts.layout
    with begin(NAME, 1, robot=robot) as task:
        task.step(torch.tensor([[-0.5, 0.0, 0.5, 1.0]]))
        told = task.env.gtd["robot_actions"][0].argsort().argsort()
    signs = [(int(copysign(1.0, x)), int(copysign(1.0, y))) for x, y, _ in (mount.position for mount in mounts)]
    assert told.tolist() == [places.index(sign) for sign in signs]


def test_places_are_counted_clockwise_from_the_nose() -> None:
    assert rotor_order([(0.0, 1.0, 0.0), (1.0, 1e-9, 0.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)]) == (3, 0, 1, 2)
    assert rotor_order([(1.0, -1.0, 0.1), (1.0, -1.0, -0.1), (-1.0, -1.0, 0.0)]) == (0, 1, 2)


def test_a_vehicle_that_spins_away_is_lost_before_it_is_infinite() -> None:
    """Full thrust on the right of every vehicle: an episode ends as a crash where a step leads beyond 35 rad/s."""
    with begin(NAME, 500) as task:
        crashed, fastest = torch.zeros(500, dtype=torch.bool), torch.zeros(())
        for _ in range(60):
            *_, info = task.step(torch.tensor([[1.0, 1.0, -1.0, -1.0]]).expand(500, 4).contiguous())
            crashed |= info["crashes"]
            fastest = fastest.maximum(task.env.gtd["robot_body_angvel"].norm(dim=-1).max())
    assert crashed.float().mean() > 0.9
    assert 30.0 < float(fastest) <= 35.0


def test_every_episode_draws_a_vehicle_of_thrust_to_weight_from_1_15_to_7() -> None:
    """What the robot has at full thrust, 3.26, times the factor that is drawn; another one in the next episode."""
    robot = ROBOTS.get("sampled_quadrotor")
    own = 4.0 * robot.the_rotor("the test").thrust_range[1] / (robot.body.mass * 9.81)
    with begin(NAME, 2000) as task:
        first = {name: drawn.clone() for name, drawn in task.env.draws().items()}
        ratio = own * first["rotor.thrust_map"].flatten(1)[:, -1]
        assert 1.149 < float(ratio.min()) < 1.2
        assert 6.7 < float(ratio.max()) < 7.01
        task.reset()
        assert float((task.env.draws()["body.inertia"] != first["body.inertia"]).float().mean()) > 0.99


@pytest.mark.parametrize(
    ("controller", "robot"),
    frequent_values(
        product(
            ("rotor_speed_control", "no_control"),
            ("typhoon_hexarotor", "base_octarotor", "tilted_hexarotor", "coaxial_octarotor", "morphy_stiff"),
        ),
        [("rotor_speed_control", "coaxial_octarotor"), ("no_control", "tilted_hexarotor")],
    ),
)
def test_other_rotors_lift_and_turn_as_a_quadrotor_would(controller: str, robot: str) -> None:
    with begin(NAME, 4, robot=robot, controller=controller) as task:
        half = 2.0 * 0.5**0.5 - 1.0
        more = torch.tensor([[0, 0, 0, 0], [1, 1, -1, -1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
        task.step(half + 0.05 * more)
        told = task.env.gtd["robot_actions"].double()
        vehicle = vehicle_from_config(ROBOTS.get(robot), num_envs=4, dtype=torch.float64)
        thrusts = rotor_thrust(vehicle, told) if controller == "rotor_speed_control" else told
        wrench = (allocation_matrix(vehicle, 9.81) @ thrusts.unsqueeze(-1)).squeeze(-1)
    scale = float(wrench[0, 2])
    assert scale > 0.3 * 9.81 * ROBOTS.get(robot).body.mass
    assert float(wrench[0, [0, 1, 3, 4, 5]].abs().max()) < 2e-3 * scale
    change = wrench - wrench[0]
    for row, axis, sign in ((1, 3, -1.0), (2, 4, 1.0), (3, 5, 1.0)):
        assert sign * float(change[row, axis]) > 0.0
        rest = change[row, [k for k in range(6) if k not in (2, axis)]]
        assert float(rest.abs().max()) < 0.1 * abs(float(change[row, axis]))


def test_what_cannot_fly_rotor_by_rotor_is_refused() -> None:
    robot = ROBOTS.get("base_quadrotor")
    places = zip(robot.mounts.layout, (0.2, 0.1, -0.1, -0.2), strict=True)
    row = tuple(replace(mount, position=(x, 0.0, 0.0)) for mount, x in places)
    with pytest.raises(ConfigError, match="cannot lift this robot and turn it about each axis by itself"):
        quadrotor_to_rotors_matrix(replace(robot, mounts=replace(robot.mounts, layout=row)))
    with pytest.raises(ConfigError, match="action rotor_range: controller lee_attitude_control tells no rotors"):
        task_registry.make_task(NAME, num_envs=2, device="cpu", controller="lee_attitude_control")
    cfg = task_registry.get(NAME)
    cfg = replace(cfg, action=replace(cfg.action, params={"places": 6}))
    assert_refused(ConfigError, "expected {places: 4} or none", with_rotor_range, cfg, ROBOTS.get("x500"), ("speed_1",))


@pytest.mark.parametrize(("robot", "joints"), [("snakey6", "yaw_1 velocity, .*"), ("tilt_tricopter", "[a-z_]+ p.*")])
def test_a_robot_that_is_told_joints_as_well_is_refused(robot: str, joints: str) -> None:
    with pytest.raises(ConfigError, match=f"also takes {joints} of its .* position_setpoint_task_reconfigurable"):
        task_registry.make_task(NAME, num_envs=2, device="cpu", robot=robot)
