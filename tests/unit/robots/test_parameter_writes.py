"""Writes to the Global Tensor Dictionary: every key takes effect in the next step, refuses, or is an output of the step."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import EFFECTS, ROBOTS, EnvManager
from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.errors import OwnershipError
from tests.builders import simulation
from tests.unit.task.hover import begin

BACKENDS = ["torch", "warp"]
EFFECTS_ON_BOARD = (
    "rotor_drag", "payload_mass", "thrust_coefficient", "constant_wind", "imu_bias", "motor_time_constant", "downwash",
    "com_offset", "inertia_error",
)  # fmt: skip
DRAWN: Randomize = {
    "body.mass": RandomizeCfg(low=0.9, high=1.1, how="scale"),
    "effects.rotor_drag.dx": RandomizeCfg(low=0.1, high=0.2, how="value"),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1, how="scale"),
}
REFUSED = {"robot_mass", "robot_inertia", "robot_imu_errors", "effect_rotor_drag"}
OUTPUTS = {
    "robot_clearance", "crashes", "truncations", "non_finite", "robot_state_tensor", "robot_angvel",
    "robot_body_linvel", "robot_vehicle_orientation", "robot_vehicle_linvel", "robot_euler_angles", "robot_prev_actions",
    "imu_measurement",
}  # fmt: skip
"""Measurements, flags and copies: the step overwrites them."""
KEPT = {"env_bounds_min", "env_bounds_max", "sim_steps", "num_obstacles_in_env"}
"""Terminations read the first three, a reset the last."""


def build(backend: str, randomize: Randomize | None = None, env_name: str = "empty_env") -> EnvManager:
    robot, effects = ROBOTS.get("base_quadrotor_with_imu"), {}
    for name in EFFECTS_ON_BOARD:
        effect = EFFECTS.get(name)
        neutral = zip(effect.parameters, effect.neutral(robot), strict=True)
        effects[name] = {each.name: value + 0.1 * each.scale for each, value in neutral}
    robot = replace(robot, effects=effects, effects_source="test")
    options = {"env": env_name, "randomize": randomize or {}, "backend": backend}
    env = simulation(robot, "lee_velocity_control", **options)
    env.reset()
    env.step(torch.zeros(2, 4))
    return env


def future(env: EnvManager, steps: int = 1) -> dict[str, Tensor]:
    for _ in range(steps):
        env.step(torch.tensor([[0.5, 0.2, 0.1, 0.1]]).expand(2, 4))
    return {key: env.gtd.plain(key).clone().nan_to_num() for key in env.gtd}


def write(target: Tensor) -> None:
    if target.dtype == torch.bool:
        target[:] = ~target
    elif target.dtype.is_floating_point:
        target[:] = torch.where(torch.isfinite(target), 1.3 * target + 0.05, 1.0)
    else:
        target += 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_key_is_live_or_refuses_or_is_an_output(backend: str) -> None:
    env = build(backend, DRAWN, "env_with_obstacles")
    start = env.save_state()
    expected = future(env)
    result: dict[str, set[str]] = {"live": set(), "refused": set(), "output": set(), "kept": set()}
    for key in env.gtd:
        env.load_state(start)
        try:
            write(env.gtd[key])
        except OwnershipError:
            result["refused"].add(key)
            continue
        if key == "downwash_position":  # acts on what is below it alone
            env.gtd[key][:] = env.gtd["robot_position"] + torch.tensor([0.0, 0.0, 1.0])
        after = future(env)
        changed = {each for each in expected if not torch.equal(after[each], expected[each])}
        result["live" if changed - {key} else "kept" if changed else "output"].add(key)
    assert result["refused"] == REFUSED
    assert result["output"] == OUTPUTS
    assert result["kept"] == KEPT
    placed = []
    for none in (False, True):
        env.load_state(start)
        if none:
            env.gtd["num_obstacles_in_env"].zero_()
        env.reset()
        placed.append(env.gtd["obstacle_position"].clone())
    assert not torch.equal(*placed)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_written_payload_is_in_the_next_step(backend: str) -> None:
    env = build(backend)
    mass = env.gtd["robot_mass"].clone()
    env.gtd["effect_payload_mass"][1] += 0.1 * float(mass[1])
    env.step(torch.zeros(2, 4))
    torch.testing.assert_close(env.gtd["robot_mass"], mass * torch.tensor([1.0, 1.1]))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_written_draw_is_in_the_next_step_until_the_next_reset(backend: str) -> None:
    env = build(backend, {"body.mass": RandomizeCfg(low=0.9, high=1.1, how="scale")})
    declared = ROBOTS.get("base_quadrotor_with_imu").body.mass
    payload = float(env.gtd["effect_payload_mass"][0, 0])
    env.draws()["body.mass"][:] = torch.tensor([1.5, 0.5])
    env.step(torch.zeros(2, 4))
    torch.testing.assert_close(env.gtd["robot_mass"] - payload, declared * torch.tensor([1.5, 0.5]))
    env.reset()
    drawn = (env.gtd["robot_mass"] - payload) / declared
    assert bool(((drawn > 0.89) & (drawn < 1.11)).all())


def test_a_recorded_step_is_dropped_where_a_write_moves_the_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    """A CUDA graph keeps addresses: the task steps without it, and records anew at the next reset."""
    task = begin("position_setpoint_task", 2)

    class GraphStub:
        def replay(self, actions: Tensor) -> None:
            raise AssertionError("replayed")

    for moved in (False, True):
        monkeypatch.setattr(task, "_graph", GraphStub())
        monkeypatch.setattr(task.env.robot_manager, "take_writes", lambda moved=moved: moved)
        if not moved:
            with pytest.raises(AssertionError, match="replayed"):
                task.step(torch.zeros(2, task.num_actions))
            continue
        task.step(torch.zeros(2, task.num_actions))
        assert not task.is_captured
        assert task._capture_at_reset
