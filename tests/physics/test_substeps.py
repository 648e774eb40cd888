"""All substeps of a step in one launch: where the robot goes, what it touches on the way, and how obstacles move
meanwhile. The reference is the loop over substeps that the launch replaces: one substep, one move of the obstacles, one
measurement of the distance. Poses and distances must agree bit for bit on the CPU, since each is found by the same
arithmetic. A touch at a pose is a crash, and so is one between two poses (``test_sweep.py``)."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh
from torch import Tensor

from aerial_gym.assets import PARKED_Z, CollisionTest, Scene
from aerial_gym.config.environment import AssetCfg, ContactCfg, EnvironmentCfg, MotionCfg, PartCfg, ShapeCfg
from aerial_gym.config.robot import CollisionCfg, SphereCfg
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.physics import Trajectory
from aerial_gym.physics.integrators import MassState
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.unit.assets.managers import move_obstacles

K, DT = 10, 0.01
PLATE = ShapeCfg(kind="box", size=(0.05, 2.0, 2.0))
TREE = ShapeCfg(
    kind="compound",
    parts=(
        PartCfg(shape=ShapeCfg(kind="cylinder", radius=0.15, height=1.5)),
        PartCfg(
            shape=ShapeCfg(kind="capsule", radius=0.1, height=0.8), position=(0.3, 0.1, 0.4), euler=(0.0, 0.9, 0.2)
        ),
        PartCfg(shape=ShapeCfg(kind="sphere", radius=0.4), position=(0.0, 0.0, 1.0)),
    ),
)
ROBOT = replace(
    ROBOTS.get("base_quadrotor"),
    collision=CollisionCfg(
        spheres=(SphereCfg(center=(0.1, 0.0, 0.02), radius=0.1), SphereCfg(center=(-0.15, 0.05, 0.0), radius=0.06)),
        source="test",
    ),
)
SPIN = MotionCfg(
    kind="twist", at_bounds="bounce", lin_vel_low=(-15.0, -15.0, -15.0), lin_vel_high=(15.0, 15.0, 15.0),
    ang_vel_low=(-4.0, -4.0, -4.0), ang_vel_high=(4.0, 4.0, 4.0),
)  # fmt: skip
MOTIONS = {"still": MotionCfg(), "twist": SPIN, "waypoints": MotionCfg(kind="waypoints", speed=(1.0, 20.0))}


def crowd(motion: MotionCfg, **fields) -> EnvironmentCfg:
    """Return a room of 4 m with plates, trees and spheres, of which the last asset does not move."""
    half = {
        f"bounds_{side}_{end}": 3 * (x,) for side, x in (("lower", -2.0), ("upper", 2.0)) for end in ("low", "high")
    }
    drawn = {"position_ratio_low": (0.1, 0.1, 0.1), "position_ratio_high": (0.9, 0.9, 0.9)}
    turned = {"euler_low": (-3.0, -3.0, -3.0), "euler_high": (3.0, 3.0, 3.0)}
    ball = ShapeCfg(kind="sphere", radius=0.2)
    assets = (
        AssetCfg(name="movers", count=5, shapes=(PLATE, TREE, ball), motion=motion, **drawn, **turned),
        AssetCfg(name="others", count=2, shapes=(TREE, PLATE), **drawn, **turned),
    )
    return EnvironmentCfg(
        summary="a test", source="test", physics_steps_per_env_step=K, assets=assets, ground_height=-2.0, **half, **fields
    )  # fmt: skip


def build(env: EnvironmentCfg, num_envs: int, *, backend: str = "warp", num_others: int = 6) -> EnvManager:
    made = simulation(
        ROBOT, sim=replace(SIMS.get("base_sim"), backend=backend, dt=DT), env=env, num_envs=num_envs, seed=3
    )
    made.asset_manager.set_num_obstacles(num_others)  # of the crowd the seventh is parked
    made.reset()
    return made


def throw(env: EnvManager, rows: slice = slice(None)) -> None:
    generator = torch.Generator().manual_seed(4)
    draw = torch.randn(64, 9, generator=generator)[rows]
    env.gtd["robot_position"].copy_(0.6 * draw[:, :3].clamp(-2.0, 2.0))
    env.gtd["robot_orientation"].copy_(torch.tensor([0.0, 0.0, 0.0, 1.0]))
    env.gtd["rotor_speed"].fill_(0.0)
    env.gtd["robot_linvel"].copy_(12.0 * draw[:, 3:6])
    env.gtd["robot_body_angvel"].copy_(3.0 * draw[:, 6:])


def loop(env: EnvManager) -> Tensor:
    """Advance by one step substep by substep; return which touched an obstacle or the ground, (E, K)."""
    gtd, touched = env.gtd, []
    gtd["crashes"].zero_()
    for _ in range(K):
        env.robot_manager.advance(1)
        move_obstacles(env.asset_manager, DT)
        env._collision.measure()
        touched.append(gtd["robot_clearance"] < 0.0)
    gtd["crashes"].logical_or_(torch.stack(touched).any(dim=0))
    return torch.stack(touched, dim=1)


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_step_equals_the_loop_over_its_substeps(motion: str) -> None:
    one, other = build(crowd(MOTIONS[motion]), 64), build(crowd(MOTIONS[motion]), 64)
    throw(one)
    throw(other)
    only_on_the_way = only_between = 0
    for _ in range(3):
        one.step(torch.zeros(64, 4))
        touched = loop(other)
        only_on_the_way += int((touched.any(dim=1) & ~touched[:, -1]).sum())
        for key in ("robot_position", "robot_orientation", "robot_linvel", "env_asset_state_tensor"):
            assert torch.equal(one.gtd[key], other.gtd[key]), key
        assert torch.equal(one.gtd["robot_clearance"], other.gtd["robot_clearance"])
        assert (one.gtd["crashes"] | ~other.gtd["crashes"]).all()
        only_between += int((one.gtd["crashes"] & ~other.gtd["crashes"]).sum())
    assert only_on_the_way > 20
    assert only_between > 2
    assert not one.gtd["crashes"].all()


def test_the_torch_backend_tells_the_same_substeps() -> None:
    ways = []
    for backend in ("warp", "torch"):
        env = build(crowd(SPIN), 64, backend=backend)
        throw(env)
        env.step(torch.zeros(64, 4))
        ways.append(env)
    warp, torch_ = ways
    torch.testing.assert_close(warp.gtd["robot_position"], torch_.gtd["robot_position"], rtol=0.0, atol=2e-5)
    torch.testing.assert_close(warp.gtd["robot_clearance"], torch_.gtd["robot_clearance"], rtol=0.0, atol=5e-5)
    assert torch.equal(warp.gtd["env_asset_state_tensor"], torch_.gtd["env_asset_state_tensor"])
    assert (warp.gtd["crashes"] != torch_.gtd["crashes"]).sum() <= 1


PUSHING = crowd(SPIN, contact=ContactCfg(friction=0.4, crash_speed=4.0))


def test_obstacles_that_push_do_so_after_every_substep_of_one_launch() -> None:
    """Thrown through a crowd that pushes: ten substeps at once against ten launches of one, bit for bit. A launch of one
    substep stores in float32 what the long one keeps in registers."""
    one, other = build(PUSHING, 64), build(PUSHING, 64)
    throw(one)
    throw(other)
    one.step(torch.zeros(64, 4))
    other.robot_manager.act(torch.zeros(64, 4))
    for _ in range(K):
        other.robot_manager.advance(1)
    other.collide()
    other.robot_manager.refresh(other.dt)
    for key in ("robot_position", "robot_linvel", "env_asset_state_tensor", "robot_clearance", "crashes"):
        assert torch.equal(one.gtd[key], other.gtd[key]), key
    force, expected = one.gtd["robot_contact_force"], other.gtd["robot_contact_force"]
    rounding = (
        2 * K * 2.0**-24 * expected.abs().max().item()
    )  # the impulses of ground and obstacles are added in another order
    torch.testing.assert_close(force, expected, rtol=0.0, atol=rounding)
    assert 5 < one.gtd["crashes"].sum() < 60


def test_the_torch_backend_calls_the_obstacles_that_push() -> None:
    """One substep, as collisions at 30 m/s multiply every rounding: velocities to 1e-4 of what the push changed. Float32
    (6e-8) times the condition of the system of contacts, some 1e3: its penalty is 100 masses."""
    ways = []
    for backend in ("warp", "torch"):
        env = build(PUSHING, 64, backend=backend)
        throw(env)
        before = env.gtd["robot_linvel"].clone()
        env.robot_manager.act(torch.zeros(64, 4))
        env.robot_manager.advance(1)
        ways.append(env.gtd)
    warp, torch_ = ways
    error = (warp["robot_linvel"] - torch_["robot_linvel"]).norm(dim=1)
    assert (error <= 1e-4 * (warp["robot_linvel"] - before).norm(dim=1) + 1e-6).all()
    assert (warp["robot_contact_force"] != 0.0).any(dim=1).sum() > 3
    assert torch.equal(warp["crashes"], torch_["crashes"])
    assert torch.equal(warp["env_asset_state_tensor"], torch_["env_asset_state_tensor"])


class SphereFlight:
    """Robots of one sphere of 0.1 m on given ways past one obstacle, without physics."""

    def __init__(self, shape: ShapeCfg, position: Tensor, *, instance: Tensor | None = None) -> None:
        """Take the poses, (K + 1, E, 3), the first of which starts the step."""
        num_envs = position.shape[1]
        upright = torch.tensor([0.0, 0.0, 0.0, 1.0])
        state = torch.zeros(num_envs, 1, 13)
        state[..., 6] = 1.0
        if instance is not None:
            state[..., :3] = instance
        rows = torch.zeros(1, dtype=torch.int64)
        self.state, self.position = state, position
        self.crashes, self.distance = torch.zeros(num_envs, dtype=torch.bool), torch.full((num_envs,), float("nan"))
        self.test = CollisionTest(
            Scene([shape], shape_index=rows, semantic_id=rows, asset_state=state),
            (SphereCfg(center=(0.0, 0.0, 0.0), radius=0.1),), position=position[-1],
            attitude=upright.repeat(num_envs, 1), distance_out=self.distance,
        )  # fmt: skip
        self.test.record_launches(position, upright.repeat(len(position), num_envs, 1), dt=DT, crashes_out=self.crashes)
        self.test.step()


@pytest.mark.parametrize("shape", [PLATE, ShapeCfg(kind="plane"), TREE, "mesh"], ids=lambda s: getattr(s, "kind", s))
def test_a_still_part_is_passed_over_only_if_no_substep_can_touch_it(shape: ShapeCfg | str, tmp_path: Path) -> None:
    """Random ways of every length, beside distances at 50 places of each substep. Between two of these places the distance
    falls by half of what lies between them at most, and by the 0.2 mm of a touch."""
    if isinstance(shape, str):
        trimesh.creation.icosphere(subdivisions=1, radius=0.5).export(tmp_path / "ball.obj")
        shape = ShapeCfg(kind="mesh", path=str(tmp_path / "ball.obj"))
    generator = torch.Generator().manual_seed(6)
    length = 10.0 ** (3.0 * torch.rand(1, 400, 1, generator=generator) - 2.0)
    way = torch.randn(1, 400, 3, generator=generator) + length * torch.randn(3, 400, 3, generator=generator)
    flight = SphereFlight(shape, way)
    share = torch.linspace(0.0, 1.0, 51)[:, None, None]
    distance = torch.stack(
        [SphereFlight(shape, place.expand(2, -1, -1)).distance for place in way[0] + share * (way[1] - way[0])]
    )
    later = [SphereFlight(shape, place.expand(2, -1, -1)).distance for place in way[1] + share * (way[2] - way[1])]
    distance = torch.cat((distance, torch.stack(later)))
    between = (way[1:] - way[:-1]).norm(dim=-1).amax(dim=0) / 50
    least = distance.amin(dim=0)
    assert flight.crashes[least < 0.0].all()
    assert not flight.crashes[least > 0.5 * between + 2.1e-4].any()
    assert torch.equal(flight.distance, SphereFlight(shape, way[-1:].expand(2, -1, -1)).distance)
    between_poses = (least < 0.0) & (distance[[0, 51, -1]] >= 0.0).all(dim=0)
    assert between_poses.any() or shape.kind == "plane"  # to which a straight way is nearest at an end
    assert (~flight.crashes).sum() > 20


def test_crashes_are_never_cleared_and_parked_obstacles_never_touch() -> None:
    way = torch.zeros(K + 1, 2, 3)
    way[..., 2] = PARKED_Z
    flight = SphereFlight(PLATE, way, instance=torch.tensor([0.0, 0.0, PARKED_Z]))
    assert flight.crashes.tolist() == [False, False]
    assert flight.distance.tolist() == [float("inf")] * 2
    flight.crashes[1] = True
    flight.test.step()
    assert flight.crashes.tolist() == [False, True]


def test_a_step_of_more_substeps_than_there_is_room_for_is_refused() -> None:
    env = build(crowd(MotionCfg()), 1)
    with pytest.raises(ShapeError, match="substeps = 11: Trajectory has room for 10"):
        env.robot_manager.advance(K + 1)
    record = Trajectory.zeros(3, 2, device=torch.device("cpu"))
    assert record.position.shape == (4, 2, 3)
    assert record.attitude.shape == (4, 2, 4)


def test_a_record_whose_start_is_unknown_is_refused() -> None:
    """A backend that does not call ``begin`` would leave the start of another step in row 0."""
    env = build(crowd(MotionCfg()), 1, backend="torch")
    state, record = env.robot_manager.tensors.state, Trajectory.zeros(2, 1, device=torch.device("cpu"))
    before = MassState(**vars(state), load=torch.zeros(1, 6))
    with pytest.raises(CapabilityError):
        record.after_substep(0, before, state)
    record.begin(state)
    record.after_substep(0, before, state)
    record.after_substep(1, before, state)
    assert torch.equal(record.position, state.position.expand(3, 1, 3))
    with pytest.raises(CapabilityError):
        record.after_substep(0, before, state)
