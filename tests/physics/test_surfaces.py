"""Ground and ceiling near rotors that blow down or up: closed forms of both signs, mirror images, limits."""

from dataclasses import replace
from math import sqrt

import pytest
import torch
from torch import Tensor

from aerial_gym import physics
from aerial_gym.assets.height_probe import FARTHEST, HeightProbe
from aerial_gym.assets.scene import PARKED_Z
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, MotionCfg
from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics.model import Model
from tests.builders import simulation
from tests.physics.rotor_types import FORCE, REVERSIBLE, with_rotor
from tests.physics.sensor_rig import make_scene
from tests.physics.vehicles import F64, asymmetric_robot

RADIUS, MASS = 0.1, 0.8
K = {"ground_effect": 2.0, "ceiling_effect": 1.5}
UPRIGHT, OVER = [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]


def level_robot(rotor=FORCE):
    robot = with_rotor(asymmetric_robot(com=(0.0, 0.0, 0.0)), rotor)
    mounts = robot.mounts.layout
    layout = tuple(replace(m, position=(*m.position[:2], 0.0), axis=(0.0, 0.0, 1.0)) for m in mounts)
    return replace(robot, mounts=replace(robot.mounts, layout=layout))


def make_model(*names: str, rotor=FORCE, **scene: float) -> Model:
    vehicle = physics.vehicle_from_config(level_robot(rotor), num_envs=1, dtype=F64)
    rows = [(physics.EFFECTS.get(name), torch.tensor([[K[name]]], dtype=F64)) for name in names]
    return physics.build_model(vehicle, rows, **{"ground_height": 0.0, "ceiling_height": None, **scene})


def body_state(height: float, state: float, attitude: list[float] = UPRIGHT) -> physics.BodyState:
    zero = torch.zeros(1, 3, dtype=F64)
    position = torch.tensor([[0.3, -0.2, height]], dtype=F64)
    turn, rotors = torch.tensor([attitude], dtype=F64), torch.full((1, 4), state, dtype=F64)
    return physics.BodyState(position=position, attitude=turn, lin_vel=zero, ang_vel=zero.clone(), rotor_speed=rotors)


def push(model: Model, state: physics.BodyState) -> Tensor:
    return MASS * physics.accelerations(model, state).specific_force[0]


def gain(name: str, distance: float) -> float:
    """Return ``1 / (1 - k (R / 4 h)²)``."""
    return 1.0 / (1.0 - K[name] * (RADIUS / 4.0 / distance) ** 2)


@pytest.mark.parametrize(
    ("name", "blows", "floor", "roof"),
    [
        ("ground_effect", "down", 0.12, None), ("ground_effect", "up", None, 0.2),
        ("ceiling_effect", "down", None, 0.2), ("ceiling_effect", "up", 0.12, None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("attitude", [UPRIGHT, OVER])
def test_each_surface_acts_on_the_rotors_on_its_side(name, blows, floor, roof, attitude) -> None:
    """0.12 m over the ground, 0.2 m under the ceiling, thrust of either sign, either side up: the gain is that of one
    surface. The wake goes down where thrust along the axis and the axis have the same sign."""
    thrust = 1.5 if (blows == "down") == (attitude is UPRIGHT) else -1.5
    result = push(make_model(name, ceiling_height=0.32), body_state(0.12, thrust, attitude))
    expected = 4.0 * thrust * gain(name, roof if floor is None else floor)
    torch.testing.assert_close(result, torch.tensor([0.0, 0.0, expected], dtype=F64), rtol=1e-12, atol=1e-12)
    assert abs(expected) > 6.0


@pytest.mark.parametrize("rotor", [FORCE, REVERSIBLE])
def test_gains_vanish_where_thrust_passes_through_zero(rotor) -> None:
    """Continuous: what comes to the thrust on either side of zero is proportional to it."""
    more = (gain("ground_effect", 0.1) + gain("ceiling_effect", 0.1) - 2.0) * (1.0 + 1e-9)
    model, bare = (make_model(*names, rotor=rotor, ceiling_height=0.2) for names in (K, ()))
    for state in (1e-6, -1e-6, 0.0):
        own = push(bare, body_state(0.1, state))
        assert (push(model, body_state(0.1, state)) - own).abs().max() <= more * own.abs().max()


def test_surfaces_far_away_or_absent_do_nothing() -> None:
    for names, state in ((("ground_effect",), body_state(0.1, -1.5)), (("ground_effect",), body_state(1e6, 1.5))):
        torch.testing.assert_close(push(make_model(*names), state), push(make_model(), state), rtol=1e-12, atol=1e-12)
    far = push(make_model("ceiling_effect", ceiling_height=1e9), body_state(1e6, -1.5))
    torch.testing.assert_close(far, push(make_model(), body_state(1e6, -1.5)), rtol=1e-12, atol=1e-12)


CPU = torch.device("cpu")
BOX, BALL = ShapeCfg(kind="box", size=(0.8, 0.4, 0.2)), ShapeCfg(kind="sphere", radius=0.5)


def heights(position: list[list[float]], *, ground: bool = False, parked: bool = False) -> list[float]:
    """Return the surface heights below places [m]; the scene has a turned box with its top at 0.6 m and a ball at x = 3 m."""
    num = len(position)
    place = torch.tensor([[0.0, 0.0, 0.5], [3.0, 0.0, 1.0]]).expand(num, -1, -1).clone()
    place[..., 2] += PARKED_Z if parked else 0.0
    turn = quat_from_euler(torch.tensor([[0.0, 0.0, 1.5707963], [0.0, 0.0, 0.0]])).expand(num, -1, -1)
    shapes = [BOX, BALL]
    if ground:
        shapes.append(ShapeCfg(kind="plane"))
        place = torch.cat((place, torch.zeros(num, 1, 3)), dim=1)
        turn = torch.cat((turn, torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(num, 1, -1)), dim=1)
    result = torch.full((num, 1), float("nan"))
    HeightProbe(
        make_scene(shapes, place, turn, device=CPU), position=torch.tensor(position), height_out=result
    ).measure_heights()
    return result[:, 0].tolist()


def test_heights_are_those_of_the_highest_surface_under_the_robot() -> None:
    places = [[0.15, 0.35, 2.0], [0.35, 0.15, 2.0], [3.0, 0.3, 2.0], [0.0, 0.0, 0.2], [3.0, 0.0, 0.4]]
    expected = [0.6, 0.0, 1.0 + sqrt(0.25 - 0.09), 0.0, 0.0]  # the last ones are under the box and the ball
    assert heights(places, ground=True) == pytest.approx(expected, abs=2e-6)


def test_without_anything_below_the_height_is_the_farthest() -> None:
    assert heights([[1.0, 0.0, 2.0]]) == pytest.approx([2.0 - float(FARTHEST)])
    assert heights([[0.0, 0.0, 2.0]], parked=True) == pytest.approx([2.0 - float(FARTHEST)])


@pytest.mark.parametrize("backend", [physics.TorchBackend, physics.WarpBackend])
def test_each_environment_has_its_own_ground_and_follows_it(backend) -> None:
    vehicle = physics.vehicle_from_config(level_robot(), num_envs=3)
    ground = torch.tensor([[0.38], [0.3], [-4.5]])
    model = physics.build_model(
        vehicle, [(physics.EFFECTS.get("ground_effect"), torch.full((3, 1), K["ground_effect"]))], ground_height=ground
    )
    stepper = backend()
    stepper.allocate(model, make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81), integrator="euler")
    stepper.prepare(0.001)
    told = torch.full((3, 4), 1.2)
    for rooms in ([0.12, 0.2, 5.0], [5.0, 0.12, 0.2]):
        ground[:, 0] = 0.5 - torch.tensor(rooms)
        stepper.take_ground_heights()
        one = body_state(0.5, 1.2)
        state = replace(one, **{name: rows.float().repeat(3, 1) for name, rows in vars(one).items()})
        stepper.step(state, told, 0.001, 1)
        felt = torch.tensor([4.0 * 1.2 * gain("ground_effect", room) for room in rooms])
        torch.testing.assert_close(state.lin_vel[:, 2], 0.001 * (felt / MASS - model.gravity), rtol=2e-5, atol=1e-7)


def over_a_platform(backend: str, *, differentiable: bool = False, speed: float = 4.0) -> EnvManager:
    """Return robots at (0, 0, 1) m over a platform that begins to pass below at x = -0.5 m; its top is at 0.7 m."""
    platform = AssetCfg(
        name="platform", shapes=(ShapeCfg(kind="box", size=(0.6, 4.0, 0.2)),), count=1, keep=True,
        position_ratio_low=(0.25, 0.5, 0.5), position_ratio_high=(0.25, 0.5, 0.5), offset=(0.0, 0.0, 0.6),
        motion=MotionCfg(kind="twist", lin_vel_low=(speed, 0.0, 0.0), lin_vel_high=(speed, 0.0, 0.0)),
    )  # fmt: skip
    scene = EnvironmentCfg(
        summary="test", physics_steps_per_env_step=1, source="test", assets=(platform,), ground_height=0.0,
        bounds_lower_low=(-1.0, -1.0, -1.0), bounds_lower_high=(-1.0, -1.0, -1.0),
        bounds_upper_low=(1.0, 1.0, 1.0), bounds_upper_high=(1.0, 1.0, 1.0),
    )  # fmt: skip
    start = InitialStateCfg(
        position_ratio_low=(0.5, 0.5, 1.0), position_ratio_high=(0.5, 0.5, 1.0), euler_low=(0.0, 0.0, 0.0),
        euler_high=(0.0, 0.0, 0.0), lin_vel_low=(0.0, 0.0, 0.0), lin_vel_high=(0.0, 0.0, 0.0),
        ang_vel_low=(0.0, 0.0, 0.0), ang_vel_high=(0.0, 0.0, 0.0),
    )  # fmt: skip
    robot = level_robot()
    corners = (
        (0.15, -0.15, 0.0),
        (-0.15, -0.15, 0.0),
        (-0.15, 0.15, 0.0),
        (0.15, 0.15, 0.0),
    )  # the same lift, no torque
    layout = tuple(replace(m, position=corner) for m, corner in zip(robot.mounts.layout, corners, strict=True))
    robot = replace(robot, mounts=replace(robot.mounts, layout=layout))
    robot = replace(robot, effects={"ground_effect": {"k": 2.0}}, effects_source="test", initial_state=start)
    return simulation(robot, env=scene, differentiable=differentiable, backend=backend)


@pytest.mark.parametrize("backend", ["torch", "warp"])
def test_a_platform_that_passes_below_lifts_the_robot_while_it_is_there(backend: str) -> None:
    """From a step to the next the velocity grows by ``T gain(h) / m - g``, h the height over the platform or the ground."""
    env = over_a_platform(backend)
    env.reset()
    told, dt, seen = env.gtd["rotor_speed"].clone(), env.dt, set[float]()  # thrusts, which stay: the weight
    for _ in range(30):
        edge = env.gtd["vec_root_tensor"][:, 1, 0]
        place, before = env.gtd["robot_position"].clone(), env.gtd["robot_linvel"].clone()
        top = torch.where((edge.abs() - 0.3).abs() < 1e-4, torch.nan, torch.where(edge.abs() < 0.3, 0.7, 0.0))
        env.step(told)
        room = place[:, 2] - top
        felt = told.sum(-1) / (1.0 - 2.0 * (0.1 / 4.0 / room) ** 2)
        expected = dt * (felt / MASS - env.sim_cfg.gravity)
        known = ~top.isnan()
        gained = env.gtd["robot_linvel"][:, 2] - before[:, 2]
        torch.testing.assert_close(gained[known], expected[known], rtol=2e-4, atol=2e-7)
        seen |= set(top[known].tolist())
    assert len(seen) == 2


def test_gradients_through_a_surface_that_is_looked_for_are_refused() -> None:
    with pytest.raises(CapabilityError, match="effect ground_effect: no gradients over obstacles"):
        over_a_platform("torch", differentiable=True)


def surfaces(env: EnvManager) -> Tensor:
    return env.gtd["surface_height"][:, 0].clone()


def test_heights_belong_to_the_episode_that_begins() -> None:
    """After a reset by mask the masked robot has the ground below, the other one the platform, still."""
    env = over_a_platform("warp")
    env.reset()
    for _ in range(10):
        env.step(torch.full((2, 4), 2.0))
    assert surfaces(env).tolist() == pytest.approx([0.7, 0.7])
    env.reset(torch.tensor([True, False]))
    env.step(torch.full((2, 4), 2.0))
    assert surfaces(env).tolist() == pytest.approx([0.0, 0.7])
