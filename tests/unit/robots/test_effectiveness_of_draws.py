"""Allocation with the effectiveness of each environment's own vehicle: against numpy's pseudo-inverses of what was drawn.
Writes to the Global Tensor Dictionary: every key takes effect in the next step, refuses, or is an output of the step.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym import CONTROLLERS, EFFECTS, ROBOTS, EnvManager
from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.effectiveness import allocation_matrix, find_actuation
from aerial_gym.errors import OwnershipError
from aerial_gym.physics.rotors import rotor_thrust
from tests.builders import simulation
from tests.physics.rotor_types import three_type_robot
from tests.repetitions import rare_values
from tests.unit.task.hover import begin

QUAD = ROBOTS.get("base_quadrotor")
DRAWN: dict[str, RandomizeCfg] = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "body.com": RandomizeCfg(how="offset", low=(-0.01, -0.01, 0.0), high=(0.01, 0.01, 0.0)),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, low=0.9, high=1.1),
    "rotor.torque_map": RandomizeCfg(each_rotor=True, low=0.8, high=1.2),
    "mounts.*.position": RandomizeCfg(how="offset", low=-0.02, high=0.02, each_rotor=True),
    "mounts.2.axis": RandomizeCfg(how="offset", low=(-0.1, -0.1, 0.0), high=(0.1, 0.1, 0.0)),
    "effects.com_offset.x": RandomizeCfg(how="value", low=-0.01, high=0.01),
    "effects.motor_tilt.roll": RandomizeCfg(how="value", low=-0.1, high=0.1),
    "effects.thrust_coefficient.scale": RandomizeCfg(how="value", low=0.9, high=1.1),
    "effects.torque_ratio.scale": RandomizeCfg(how="value", low=0.9, high=1.1),
}
MASK = torch.tensor([True, False, True, False, False, True])


def make(
    randomize: Mapping[str, RandomizeCfg], num_envs: int = 6, *, effectiveness: str = "actual",
    controller: str = "lee_attitude_control", robot: RobotCfg = QUAD, allocation: str = "prioritised", **options,
) -> EnvManager:  # fmt: skip
    robot = replace(robot, control=ControlCfg(effectiveness=effectiveness))
    law = replace(CONTROLLERS.get(controller), allocation=allocation)
    env = simulation(
        robot, law, **{"num_envs": num_envs, "seed": 4, "randomize": randomize, "backend": "warp", **options}
    )
    env.reset()
    return env


@pytest.fixture(scope="module", params=["warp", "torch"])
def draw_env(request: pytest.FixtureRequest) -> EnvManager:
    return make(DRAWN, backend=request.param)


def effectiveness(env: EnvManager, i: int, robot: RobotCfg = QUAD) -> np.ndarray:
    """Return the matrix (6, R) of an environment of ``DRAWN`` in float64, from the robot file and ``draws()`` alone."""
    draws = {name: values[i].double().numpy() for name, values in env.draws().items()}
    com = np.array(robot.body.com) + draws["body.com"] + np.array([draws["effects.com_offset.x"], 0.0, 0.0])
    columns = []
    for number, mount in enumerate(robot.mounts.layout):
        hub = np.array(mount.position) + draws["mounts.*.position"][number] - com
        axis = np.array(mount.axis, dtype=float)
        if number == 1:
            axis = axis + draws["mounts.2.axis"]
            axis /= np.linalg.norm(axis)
        if number == 0:
            roll = draws["effects.motor_tilt.roll"]
            axis = np.array([[1, 0, 0], [0, cos(roll), -sin(roll)], [0, sin(roll), cos(roll)]]) @ axis
        ratio = robot.rotor.torque_ratio * draws["rotor.torque_map"][number] * draws["effects.torque_ratio.scale"]
        columns.append(np.concatenate((axis, np.cross(hub, axis) - mount.spin * ratio * axis)))
    return np.stack(columns, axis=1)


def maps(env: EnvManager) -> Tensor:
    """Return the thrust per squared speed of each rotor, (E, R), from the robot file and ``draws()`` alone, float64."""
    draws = env.draws()
    factor = draws["rotor.thrust_map"].double() * draws["effects.thrust_coefficient.scale"].double().unsqueeze(-1)
    return QUAD.rotor.thrust_map[2] * factor


def reference_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the pseudo-inverse of thrust and torques with no column for lateral force, which the declared vehicle lacks."""
    return np.concatenate((np.zeros((matrix.shape[1], 2)), np.linalg.pinv(matrix[2:])), axis=1)


def test_each_environment_has_the_pseudo_inverse_of_its_own_matrix(draw_env: EnvManager) -> None:
    """To round-off of float32: the condition of the matrix with rows of length 1 times a few roundings of its entries."""
    manager = draw_env.robot_manager
    assert manager._update.why_slow == ""
    for i, inverse in enumerate(manager.controller.allocation.inverse.double().numpy()):
        matrix = effectiveness(draw_env, i)
        scaled = matrix[2:] / np.linalg.norm(matrix[2:], axis=1, keepdims=True)
        expected = reference_inverse(matrix)
        error = np.abs(inverse - expected)[:, 2:].max(0) / np.abs(expected)[:, 2:].max(0)
        assert error.max() < 8 * np.finfo(np.float32).eps * np.linalg.cond(scaled) ** 2
    high = maps(draw_env) * 2.0 / QUAD.rotor.thrust_map[2]
    torch.testing.assert_close(manager.controller.allocation.high.double(), high)


def test_what_is_commanded_is_what_the_rotors_make(draw_env: EnvManager) -> None:
    g = torch.Generator().manual_seed(0)
    wanted = torch.zeros(6, 6)
    wanted[:, 2] = QUAD.body.mass * 9.81
    wanted[:, 3:] = torch.tensor([0.03, 0.03, 0.003]) * (2.0 * torch.rand(6, 3, generator=g) - 1.0)

    def output_wrench(env: EnvManager) -> np.ndarray:
        speed = env.robot_manager.controller.allocation.speed_for_wrench(wanted).double()
        thrust = (maps(env) * speed.square()).numpy()
        return np.stack([effectiveness(env, i) @ thrust[i] for i in range(6)])

    error = (output_wrench(draw_env) - wanted.double().numpy())[:, 2:]
    assert np.abs(error).max() < 1e-5
    nominal = make(DRAWN, backend=draw_env.sim_cfg.backend, effectiveness="nominal")
    assert nominal.robot_manager.controller.allocation.rows == {}
    error = (output_wrench(nominal) - wanted.double().numpy())[:, 2:]
    assert np.abs(error).max(0).min() > 1e-3
    thrust = torch.linalg.pinv(torch.tensor([[1.0] * 4, *_arm_rows()], dtype=torch.float64)) @ wanted[:, 2:].double().T
    thrust = maps(nominal) / QUAD.rotor.thrust_map[2] * thrust.T
    predicted = np.stack([effectiveness(nominal, i) @ thrust[i].numpy() for i in range(6)])
    torch.testing.assert_close(output_wrench(nominal), predicted, atol=1e-5, rtol=1e-5)


def _arm_rows() -> list[list[float]]:
    layout, ratio = QUAD.mounts.layout, QUAD.rotor.torque_ratio
    x, y, spin = [m.position[0] for m in layout], [m.position[1] for m in layout], [m.spin for m in layout]
    return [y, [-a for a in x], [-ratio * s for s in spin]]


def test_a_reset_writes_the_rows_of_its_mask_alone(draw_env: EnvManager) -> None:
    manager = draw_env.robot_manager
    targets = [*manager.controller.allocation.rows.values(), *manager.backend.parameter_targets()]
    before = [target.clone() for target in targets]
    draw_env.reset(MASK)
    for old, new in zip(before, targets, strict=True):
        assert torch.equal(old[~MASK], new[~MASK])
    assert (before[0][MASK] != targets[0][MASK]).flatten(1).any(1).all()
    after = [target.clone() for target in targets]
    manager.refresh_model()
    for written, built in zip(after, targets, strict=True):
        torch.testing.assert_close(written, built, rtol=2e-5, atol=1e-6 * float(built.abs().max()))


@pytest.mark.parametrize("cfg", [{"rotor.time_constant": RandomizeCfg(low=0.9, high=1.1)}, {}])
def test_nothing_is_kept_where_nothing_differs(cfg: dict[str, RandomizeCfg]) -> None:
    assert make(cfg).robot_manager.controller.allocation.rows == {}


def fly(env: EnvManager, *, hard: bool = False) -> Tensor:
    number = torch.arange(env.num_envs, dtype=torch.float32).unsqueeze(-1)
    action = torch.sin(number + torch.arange(4.0)) * torch.tensor([1.0, 0.4, 0.4, 0.5])
    for step in range(12):
        env.step(3.0 * action if hard else 0.3 * action)
        env.reset((torch.arange(env.num_envs) + step) % 3 == 0)
    for _ in range(3):
        env.step(action)
    return env.gtd["robot_state_tensor"].clone()


LAWS = [("lee_attitude_control", "prioritised"), ("lee_attitude_control", "clamp")]
LAWS += [("pid_rates_control", "prioritised"), ("no_control", "prioritised")]


@pytest.mark.parametrize(("controller", "allocation"), rare_values(LAWS, LAWS[1:]))
def test_the_fused_kernel_flies_as_torch(controller: str, allocation: str) -> None:
    law = {"controller": controller, "allocation": allocation}
    ends = [fly(make(DRAWN, backend=backend, **law), hard=True) for backend in ("warp", "torch")]
    torch.testing.assert_close(ends[0], ends[1], rtol=1e-3, atol=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("optimise_kernels")
@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_an_environment_is_the_same_among_few_and_many(backend: str) -> None:
    few, many = make(DRAWN, 4, backend=backend), make(DRAWN, 64, backend=backend)
    assert torch.equal(fly(few), fly(many)[:4])
    for name, rows in few.robot_manager.controller.allocation.rows.items():
        assert torch.equal(rows, many.robot_manager.controller.allocation.rows[name][:4])


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_a_loaded_state_has_the_allocation_that_was_saved(backend: str) -> None:
    flown = make(DRAWN, backend=backend)
    fly(flown)
    state = {name: rows.clone() for name, rows in flown.save_state().items()}
    other = make(DRAWN, backend=backend)
    other.load_state(state)
    for name, rows in flown.robot_manager.controller.allocation.rows.items():
        assert torch.equal(rows, other.robot_manager.controller.allocation.rows[name])
    for _ in range(3):
        other.step(torch.full((6, 4), 0.2))
        flown.step(torch.full((6, 4), 0.2))
    assert torch.equal(other.gtd["robot_state_tensor"], flown.gtd["robot_state_tensor"])


def test_rotors_of_any_kind_make_what_is_commanded() -> None:
    cfg = {"rotor.thrust_map": DRAWN["rotor.thrust_map"], "mounts.*.position": DRAWN["mounts.*.position"]}
    options = {"robot": three_type_robot(), "controller": "lee_rates_control"}
    env, fused = make(cfg, backend="torch", **options), make(cfg, backend="warp", **options)
    manager = env.robot_manager
    assert manager._update.why_slow == ""
    vehicle, allocation = manager.model.vehicle.to_dtype(torch.float64), manager.controller.allocation
    asked = list(find_actuation(allocation_matrix(manager.declared, 9.81)[0]).axes)
    assert {2, 3, 4} <= set(asked)
    wanted = torch.tensor([[0.0, 0.0, 9.0, 0.05, -0.05, 0.01]]).expand(6, -1)
    state = allocation.speed_for_wrench(wanted).double()
    assert ((state > vehicle.speed_low) & (state < vehicle.speed_high)).all()
    thrust = rotor_thrust(vehicle, state)
    made = (allocation_matrix(vehicle, 9.81) @ thrust.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(made[:, asked], wanted[:, asked].double(), rtol=0, atol=1e-4)
    assert {"allocation", "low", "high", "thrust_map", "reverse_thrust_map"} == allocation.rows.keys()
    for name, rows in fused.robot_manager.controller.allocation.rows.items():
        assert torch.equal(rows, allocation.rows[name])
    torch.testing.assert_close(fly(env), fly(fused), rtol=1e-3, atol=1e-3)


def test_an_effect_of_the_robot_file_counts_without_draws() -> None:
    robot = replace(QUAD, effects={"com_offset": {"x": 0.02, "y": 0.0, "z": 0.0}}, effects_source="test")
    env = make({}, robot=robot)
    for x in (0.02, -0.01):
        env.gtd["effect_com_offset"][:, 0] = x
        env.robot_manager.refresh_model()
        arms = np.array(_arm_rows())
        matrix = np.stack((np.ones(4), arms[0], arms[1] + x, arms[2]))
        result = env.robot_manager.controller.allocation.inverse[3, :, 2:]
        torch.testing.assert_close(result.double().numpy(), np.linalg.inv(matrix), rtol=1e-5, atol=1e-5)


def test_gradients_in_float64_flow_through_it_and_are_those_of_differences() -> None:
    env = make(DRAWN, 2, backend="auto", differentiable=True, dtype=torch.float64)
    allocation = env.robot_manager.controller.allocation
    assert {rows.dtype for rows in allocation.rows.values()} == {torch.float64}
    for i, inverse in enumerate(allocation.inverse.numpy()):
        result = effectiveness(env, i)[2:] @ inverse[:, 2:]
        torch.testing.assert_close(result, np.eye(4), atol=2e-5, rtol=0)
    vehicle = env.robot_manager.backend._model.vehicle
    rows = allocation.compute_rows(vehicle)["allocation"]
    torch.testing.assert_close(rows, allocation.inverse, rtol=1e-12, atol=1e-12)

    def loss(action: Tensor) -> Tensor:
        env.restart(4)
        env.reset()
        for _ in range(3):
            env.step(action)
        return env.gradient_tensors["robot_linvel"].cos().sum() + env.gradient_tensors["robot_body_angvel"].sin().sum()

    action = 0.1 * torch.rand(2, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    (result,) = torch.autograd.grad(loss(action.requires_grad_()), action)
    nudges = 1e-6 * torch.eye(8, dtype=torch.float64).view(8, 2, 4)
    with torch.no_grad():
        differences = torch.stack([loss(action + each) - loss(action - each) for each in nudges]).view(2, 4) / 2e-6
    torch.testing.assert_close(result, differences, atol=1e-8, rtol=1e-6)


BACKENDS = ["torch", "warp"]
EFFECTS_ON_BOARD = (
    "rotor_drag", "payload_mass", "thrust_coefficient", "constant_wind", "imu_bias", "motor_time_constant", "downwash",
    "com_offset", "inertia_error",
)  # fmt: skip
DRAWN_ROBOT: Randomize = {
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
    env = build(backend, DRAWN_ROBOT, "env_with_obstacles")
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
