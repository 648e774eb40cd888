"""Row i of a batch of the torch backend is bit for bit what it is in every other batch, float32 and float64, on any thread."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.random import Randomness
from aerial_gym.physics import BodyState, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.effects.condition import sum_of_crosses, velocity_of_turning
from aerial_gym.physics.model import robot_effects
from aerial_gym.physics.state import ArticulatedState, state_at_rest
from aerial_gym.robots import ROBOTS
from tests.cross.test_backends import DT, build, random_actions, scale_by_env, start_state
from tests.physics.vehicles import ON_RIGID, asymmetric_robot, random_network
from tests.repetitions import thin_values

COUNTS = (1, 3, 4, 5, 63, 65, 130)
MANY = 2048
BENDING = 130


def assert_rows_alike(
    robot: RobotCfg, controller: str, dtype: torch.dtype, *, effects=(), network=None, adjust=None,
    integrator: str | None = None, first: int = 0, many: int = MANY,
) -> None:  # fmt: skip
    """Fly the rows from ``first`` on as batches of every size in ``COUNTS``, and as part of ``many``."""
    cfg, ends = CONTROLLERS.get(controller), {}
    whole, law = build(robot, cfg, many, dtype, effects, adjust)
    start, actions = start_state(whole, many), 2.0 * random_actions(law, whole, many)
    for count in (many, *COUNTS):
        rows = slice(None) if count == many else slice(first, first + count)
        model, law = build(robot, cfg, count, dtype, effects)
        if network is not None:
            learned = LearnedResidual(network, dtype=dtype), torch.full((count, 1), 0.7, dtype=dtype)
            model = replace(model, effects=type(model.effects)([*model.effects, learned]))
        if adjust is not None:
            own = {name: kept[rows].clone() for name, kept in whole.vehicle.tensors_by_name().items()}
            inverse = whole.inertia_inverse[rows].clone()
            model = replace(model, vehicle=replace(whole.vehicle, **own), inertia_inverse=inverse)
        backend = TorchBackend()
        numbers = Randomness(count, first_env=rows.start or 0)
        numbers.begin(torch.ones(count, dtype=torch.bool))
        backend.allocate(model, law, integrator=integrator or ("rk4" if effects else "euler"), random=numbers)
        state = BodyState(**{name: kept[rows].to(dtype, copy=True) for name, kept in vars(start).items()})
        for _ in range(2):
            backend.step(state, actions[rows].to(dtype), DT, 2)
        ends[count] = state
    for count in COUNTS:
        for name, result in vars(ends[count]).items():
            expected = getattr(ends[many], name)[first : first + count]
            assert result.isfinite().all()
            assert torch.equal(result, expected), f"{name} among {count}"


@pytest.mark.parametrize(
    "controller", thin_values([name for name in CONTROLLERS.names() if CONTROLLERS.get(name).gains is None], 2)
)
def test_under_every_controller(controller: str) -> None:
    pose = CONTROLLERS.get(controller).law == "pose"
    assert_rows_alike(ROBOTS.get("base_octarotor") if pose else asymmetric_robot(), controller, torch.float32)


@pytest.mark.parametrize("dtype", [torch.float32, pytest.param(torch.float64, marks=pytest.mark.slow)])
def test_with_all_effects_at_once_on_any_number_of_threads(threads: int, dtype: torch.dtype) -> None:
    assert_rows_alike(asymmetric_robot(), "lee_velocity_control", dtype, effects=ON_RIGID, first=8001, many=8192)


def test_with_a_learned_residual() -> None:
    for dtype in (torch.float32, torch.float64):
        assert_rows_alike(ROBOTS.get("tinyprop"), "lee_rates_control", dtype, network=random_network(16, 12))


def test_with_added_mass_under_euler() -> None:
    effects = ("added_mass", "added_inertia", "slung_payload")
    assert_rows_alike(asymmetric_robot(), "no_control", torch.float32, effects=effects, integrator="euler")


@pytest.mark.parametrize("robot", ["tinyprop", "omnidirectional_octarotor"])
def test_with_a_vehicle_of_its_own_in_each_environment(robot: str) -> None:
    assert_rows_alike(ROBOTS.get(robot), "rotor_speed_control", torch.float32, adjust=scale_by_env)


ON_LINKS = {
    "link_drag": {"qx": 0.002, "ax": 0.001},
    "link_buoyancy": {"force": 0.1, "x": 0.01},
    "link_added_mass": {"mx": 0.01},
}


@pytest.mark.parametrize("robot", ["morphy_creeping", "snakey6_effort"])
def test_of_vehicles_that_bend(robot: str) -> None:
    """With effects on links: products of matrices sum in other orders for one environment, and where all share a matrix."""
    cfg = replace(ROBOTS.get(robot), effects=ON_LINKS, effects_source="test")
    gen, ends = torch.Generator().manual_seed(2), {}
    drawn = torch.rand(BENDING, 60, generator=gen) - 0.5
    for count in (BENDING, 1, 3, 65):
        vehicle = vehicle_from_config(cfg, num_envs=count)
        bends = build_articulation(cfg, like=vehicle.mass)
        effects = robot_effects(cfg, num_envs=count, device=torch.device("cpu"), dtype=torch.float32)
        law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=DT)
        backend = TorchBackend()
        model = build_model(vehicle, effects, articulation=bends)
        backend.allocate(model, law, integrator="euler", random=Randomness(count))
        still = state_at_rest(count, vehicle.num_rotors, device=torch.device("cpu"), dtype=torch.float32)
        rows, number = drawn[:count], bends.num_joints
        moving = replace(still, lin_vel=rows[:, :3].clone(), ang_vel=4.0 * rows[:, 3:6])
        state = ArticulatedState(
            **vars(moving),
            joint_pos=bends.reference + 0.2 * rows[:, 6 : 6 + number],
            joint_vel=2.0 * rows[:, 20 : 20 + number],
        )
        for _ in range(5):
            backend.step(state, rows[:, 40 : 40 + len(law.action_names) + bends.num_driven] + 0.5, DT, 2)
        ends[count] = state
    for count in (1, 3, 65):
        for name, result in vars(ends[count]).items():
            assert result.isfinite().all()
            assert torch.equal(result, getattr(ends[BENDING], name)[:count]), f"{name} among {count}"


@pytest.mark.parametrize("cross", [sum_of_crosses, lambda ang_vel, lever: velocity_of_turning(ang_vel[:, 0], lever)])
def test_one_environment_with_hubs_of_its_own_is_no_shared_row(
    cross: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
) -> None:
    """Crosses with hubs that all share are added up in another order than others."""
    vectors, hubs = torch.randn(2, 4096, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    together = cross(vectors, hubs)
    for row in range(0, 4096, 64):
        assert torch.equal(cross(vectors[row : row + 1], hubs[row : row + 1]), together[row : row + 1])
