"""Drag of links on the fused backend, which eliminates link by link, against the torch reference, which factors a
matrix. The bound is that of ``test_joints``: so many times as far from float64 as float32 torch is."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import SimBuilder
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, PhysicsBackend, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.effects import EffectParams
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.cross.test_joints import FACTOR, ROUND_OFF, odd_tree
from tests.physics.vehicles import random_state
from tests.repetitions import frequent_values

NUM_ENVS, DT, SUBSTEPS, STEPS = 16, 0.002, 3, 3

OF_ALL = {"lx": 0.02, "ly": 0.03, "lz": 0.01, "qx": 0.02, "qy": 0.01, "qz": 0.03, "ax": 1e-4, "az": 2e-4, "bx": 1e-4}

CASES = {
    "morphy": ("morphy", {**OF_ALL, "azimuth_2.qx": 0.3, "azimuth_3.lz": 0.4, "base.qx": 0.0}, ("constant_wind",)),
    "on a stand": ("morphy_fixed_base", OF_ALL, ("gusts",)),
    "one arm alone": ("morphy", {"azimuth_1.qz": 0.5, "azimuth_1.by": 1e-3}, ("constant_wind", "quadratic_drag")),
    "the base alone": ("morphy", {"base.lx": 0.2, "base.qy": 0.1, "base.az": 1e-3}, ("wind_shear",)),
    "snake": ("snakey", OF_ALL, ("constant_wind",)),
    "everything": ("odd", {**OF_ALL, "slide.qx": 0.3, "left.ay": 2e-3}, ("constant_wind", "gusts", "rotor_drag")),
}


def with_drag(name: str, drag: dict[str, float]) -> RobotCfg:
    robot = odd_tree() if name == "odd" else ROBOTS.get(name)
    return replace(robot, effects={"link_drag": drag}, effects_source="test")


def effect_rows(robot: RobotCfg, rest: tuple[str, ...], dtype: torch.dtype) -> list[EffectParams]:
    """Return effects of the robot and others, each environment with numbers of its own."""
    each, rows = torch.linspace(0.5, 1.5, NUM_ENVS, dtype=dtype).unsqueeze(1), []
    for name, values in robot.effects.items():
        law = EFFECTS.get(name).bind_robot(robot)
        rows.append((law, each * torch.tensor(law.parse_params(values), dtype=dtype)))
    for name in rest:
        effect = EFFECTS.get(name)
        row = [a + p.scale for a, p in zip(effect.neutral(robot), effect.parameters, strict=True)]
        rows.append((effect, torch.tensor(row, dtype=dtype) * each.flip(0)))
    return rows


def fly(
    backend: PhysicsBackend, robot: RobotCfg, rest: tuple[str, ...], dtype: torch.dtype, *, nudge: float = 0.0,
    dt: float = DT,
) -> tuple[Tensor, ...]:  # fmt: skip
    """Return the state at the end of a flight under random thrusts and drives, in float64; ``nudge`` moves its start."""
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS, dtype=dtype)
    law, articulation = (
        make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=dt),
        build_articulation(robot, like=vehicle.mass),
    )
    model = build_model(vehicle, effect_rows(robot, rest, dtype), articulation=articulation)
    gen = torch.Generator().manual_seed(7)

    def draw(*shape: int) -> Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=gen) - 0.5

    hover = vehicle.speed_high[0, 0].item() * 0.5
    start = vars(random_state(NUM_ENVS, seed=5, rotor_speed=hover))
    start["rotor_speed"] = torch.full((NUM_ENVS, vehicle.num_rotors), hover, dtype=torch.float64)
    joints = articulation.reference.double() + 0.3 * draw(NUM_ENVS, articulation.num_joints)
    state = ArticulatedState(**start, joint_pos=joints, joint_vel=2.0 * draw(NUM_ENVS, articulation.num_joints))
    signs = torch.where(draw(NUM_ENVS, 1) > 0.0, 1.0, -1.0) * nudge
    state = replace(state, **{name: (rows * (1.0 + signs)).to(dtype) for name, rows in vars(state).items()})
    backend.allocate(model, law, integrator="euler", random=Randomness(NUM_ENVS))
    weight = 9.81 * robot.body.mass / vehicle.num_rotors
    for _ in range(STEPS):
        thrusts = 1.5 * weight * (0.5 + draw(NUM_ENVS, len(law.action_names)))
        command = torch.cat((thrusts, 2.0 * draw(NUM_ENVS, articulation.num_driven)), dim=1).to(dtype)
        backend.step(state, command, dt, SUBSTEPS)
    return tuple(tensor.double() for tensor in state.tensors())


@pytest.mark.parametrize("case", frequent_values(CASES, ("on a stand",)))
def test_the_fused_step_with_drag_is_that_of_the_reference(case: str) -> None:
    """A star of universal joints, a chain, a stand, and a tree that has everything; drag is seen in all that moves. A tree
    flies with it always among the effects at hubs of ``test_joints``."""
    name, drag, remaining = CASES[case]
    robot = with_drag(name, drag)
    exact = fly(TorchBackend(), robot, remaining, torch.float64)
    singles = [fly(TorchBackend(), robot, remaining, torch.float32, nudge=nudge * 2.0**-24) for nudge in (0, 1)]
    fused = fly(WarpBackend(), robot, remaining, torch.float32)
    without = fly(TorchBackend(), with_drag(name, dict.fromkeys(drag, 0.0)), remaining, torch.float64)
    for place, (right, own, *roughs) in enumerate(zip(exact, fused, *singles, strict=True)):
        away = max(float((rough - right).abs().max()) for rough in roughs)
        allowed = FACTOR * away + ROUND_OFF * float(right.abs().max().clamp_min(1.0))
        assert bool(right.isfinite().all())
        assert float((own - right).abs().max()) <= allowed
        if place in (3, 6) and not (place == 3 and name == "morphy_fixed_base"):  # angular velocity, rates of joints
            assert float((without[place] - right).abs().max()) > 100.0 * allowed


def test_each_environment_flies_as_it_does_alone() -> None:
    name, drag, remaining = CASES["on a stand"]
    robot, ends = with_drag(name, drag), []
    for count in (8, 2):
        vehicle = vehicle_from_config(robot, num_envs=count)
        law, articulation = (
            make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=DT),
            build_articulation(robot, like=vehicle.mass),
        )
        rows = [(effect, params[:count]) for effect, params in effect_rows(robot, remaining, torch.float32)]
        backend = WarpBackend()
        model = build_model(vehicle, rows, articulation=articulation)
        backend.allocate(model, law, integrator="euler", random=Randomness(count))
        start = {name: rows[:count].float() for name, rows in vars(random_state(8, seed=1, rotor_speed=0.5)).items()}
        joints = articulation.reference.repeat(count, 1)
        state = ArticulatedState(**start, joint_pos=joints, joint_vel=torch.zeros_like(joints))
        for _ in range(4):
            backend.step(state, torch.full((count, 4), 0.5), DT, SUBSTEPS)
        ends.append(state)
    for one, other in zip(ends[0].tensors(), ends[1].tensors(), strict=True):
        assert torch.equal(one[:2], other)


def make_env(robot: RobotCfg, randomize: dict[str, RandomizeCfg], **rest: object) -> EnvManager:
    defaults = {"sim_name": "base_sim_2ms", "env_name": "empty_env", "controller_name": "no_control", "num_envs": 32}
    robot = replace(robot, randomize=randomize)
    return SimBuilder().build_env(**(defaults | rest), robot_name=robot, device="cpu", seed=1)


def test_a_reset_draws_the_drag_of_a_link_and_the_arms_feel_it() -> None:
    """Morphy on a stand in wind from the front, the arms let go at rest: the more drag, the further back they are blown."""
    robot = replace(
        ROBOTS.get("morphy_fixed_base"),
        effects={"link_drag": {"azimuth_1.lx": 0.01}, "constant_wind": {"x": -8.0, "y": 0.0, "z": 0.0}},
        effects_source="test",
        sensors=(),
    )
    drawn = RandomizeCfg(how="value", distribution="uniform", low=0.001, high=0.02)
    env = make_env(robot, {"effects.link_drag.azimuth_1.lx": drawn})
    env.reset()
    env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    env.gtd["dof_position"].zero_()
    env.gtd["dof_velocity"].zero_()
    drag = env.gtd["effect_link_drag"]
    assert drag.shape == (32, 1)
    for _ in range(20):
        env.step(torch.zeros(32, 4))
    draws = env.robot_manager.draws()["effects.link_drag.azimuth_1.lx"]
    assert len(set(draws.tolist())) == 32
    moved = env.gtd["dof_position"][:, robot.joints.names.index("azimuth_1")]
    order = draws.argsort()
    assert bool((moved[order].diff() < 0.0).all())


def test_a_differentiable_rollout_and_names_that_are_not_there_are_refused() -> None:
    robot = with_drag("morphy", OF_ALL)
    with pytest.raises(CapabilityError, match="a differentiable rollout moves no joints"):
        fly(WarpBackend(differentiable=True), robot, (), torch.float32)
    drawn = RandomizeCfg(how="value", distribution="uniform", low=0.001, high=0.02)
    with pytest.raises(ConfigError, match="no quantity 'effects.link_drag.azimuth_9.lx'. Did you mean"):
        make_env(robot, {"effects.link_drag.azimuth_9.lx": drawn})
    with pytest.raises(ConfigError, match="effect link_drag: is of the links"):
        make_env(ROBOTS.get("tinyprop"), {"effects.link_drag.lx": drawn})
