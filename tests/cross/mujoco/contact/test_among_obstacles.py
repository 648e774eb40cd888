"""Whole simulations of robots with joints among obstacles that push them, in MuJoCo as a backend."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh

from aerial_gym.config.environment import AssetCfg, ContactCfg, EnvironmentCfg, MotionCfg, PartCfg, ShapeCfg
from aerial_gym.errors import CapabilityError
from tests.cross.mujoco.contact.on_legs import STANDING, build, let_go, put

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

G, MASS = 9.81, 0.29
LOW, HIGH = (ShapeCfg(kind="box", size=(1.0, 1.0, height)) for height in (0.4, 0.8))
SINKING = STANDING.contact.sinking / 4.0
"""Depth of each of four legs [m]."""


def tables(*shapes: ShapeCfg, count: int = 1, contact: ContactCfg | None = None, **rest) -> EnvironmentCfg:
    """Return an environment with tables, their middles at the height of the ground, between 0.5 m one way and the other."""
    corner = {"position_ratio_low": (0.4, 0.4, 0.0), "position_ratio_high": (0.6, 0.6, 0.0)}
    asset = AssetCfg(name="table", shapes=shapes, count=count, **(corner | rest))
    return replace(STANDING, assets=(asset,), contact=contact or STANDING.contact)


def tops(sim) -> torch.Tensor:
    return torch.tensor((0.2, 0.4))[sim.asset_manager.scene.shape_index[:, 0].long()]


@pytest.mark.slow
def test_robots_stand_on_tables_of_their_environments(on_legs: str) -> None:
    """Where and as high as each reset draws them; after another seed as well, which gives environments other shapes."""
    sim, seen = build(on_legs, tables(LOW, HIGH)), set()
    for seed in (0, 2):
        sim.restart(seed)
        sim.reset()
        middle, top = sim.gtd["obstacle_position"][:, 0].clone(), tops(sim)
        seen |= {tuple(top.tolist())}
        middle[:, 2] += top + 0.08
        put(sim, middle)
        assert not let_go(sim, 0.8).any()
        weight = torch.tensor([[0.0, 0.0, MASS * G]]).repeat(2, 1)
        torch.testing.assert_close(sim.gtd["robot_contact_force"], weight, rtol=0.0, atol=0.02 * MASS * G)
        torch.testing.assert_close(sim.gtd["robot_clearance"], torch.full((2,), -SINKING), rtol=0.1, atol=1e-5)
        assert ((sim.gtd["robot_position"] - middle)[:, :2].norm(dim=1) < 1e-3).all()
    assert len(seen) > 1


def test_what_is_parked_does_not_push(on_legs: str) -> None:
    """Two obstacles, one of which the curriculum leaves out: in its place is air, down to the ground."""
    sim = build(on_legs, tables(LOW, count=2, position_ratio_low=(0.5, 0.5, 0.0), position_ratio_high=(0.5, 0.5, 0.0)))
    sim.asset_manager.set_num_obstacles(1)
    sim.reset()
    sim.gtd["obstacle_position"][:, 0, 0] = 2.0
    put(sim, torch.tensor([0.0, 0.0, 0.08]))
    let_go(sim, 0.3)
    assert (sim.gtd["robot_position"][:, 2] < 0.08).all()
    assert (sim.gtd["obstacle_position"][:, 1, 2] < -500.0).all()


def test_a_fast_touch_of_an_obstacle_is_a_crash(on_legs: str) -> None:
    """From 0.05 and 0.5 m above the table: 1.0 and 3.1 m/s, 2 are a crash; the ground below is not reached."""
    sim = build(on_legs, tables(LOW))
    sim.reset()
    middle = sim.gtd["obstacle_position"][:, 0].clone()
    middle[:, 2] += 0.2 + 0.06 + torch.tensor((0.05, 0.5))
    put(sim, middle)
    assert let_go(sim, 0.45).tolist() == [False, True]


def test_a_platform_carries_a_robot_up_and_sideways(on_legs: str) -> None:
    """At its speed, without slip; friction reaches that after ``v / (mu g)``, the weight is what the force is."""
    velocity = (0.3, 0.0, 0.2)
    motion = MotionCfg(kind="twist", lin_vel_low=velocity, lin_vel_high=velocity)
    sim = build(on_legs, tables(LOW, contact=ContactCfg(friction=0.7, crash_speed=2.0), motion=motion))
    sim.reset()
    start = sim.gtd["obstacle_position"][:, 0].clone()
    put(sim, start + torch.tensor([0.0, 0.0, 0.2 + 0.07]))
    assert not let_go(sim, 0.8).any()
    moved = sim.gtd["obstacle_position"][:, 0] - start
    torch.testing.assert_close(moved, 0.8 * torch.tensor([velocity] * 2), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(sim.gtd["robot_linvel"], torch.tensor([velocity] * 2), rtol=0.0, atol=5e-3)
    assert sim.gtd["robot_contact_force"][:, 2] == pytest.approx([MASS * G] * 2, rel=0.02)


def test_a_wall_without_any_ground_stops_a_robot(on_legs: str) -> None:
    """Thrown against a pole at 1 m/s in free fall: it is pushed back, and no deeper in than contacts give way."""
    wall = AssetCfg(
        name="wall", shapes=(ShapeCfg(kind="cylinder", radius=1.0, height=4.0),), count=1,
        position_ratio_low=(1.0, 0.5, 0.5), position_ratio_high=(1.0, 0.5, 0.5),
    )  # fmt: skip
    sim = build(on_legs, replace(STANDING, assets=(wall,), ground_height=None))
    sim.reset()
    put(sim, torch.tensor([1.85, 0.0, 2.0]))
    sim.gtd["robot_linvel"][:, 0] = 1.0
    impulse = torch.zeros(2, 3)
    for _ in range(20):
        sim.step(torch.zeros_like(sim.gtd["robot_actions"]))
        impulse += sim.dt * sim.gtd["robot_contact_force"]
    assert (impulse[:, 0] < -0.05).all()
    assert (sim.gtd["robot_position"][:, 0] < 1.95).all()
    assert (sim.gtd["robot_clearance"] > -0.01).all()


def test_shapes_that_mujoco_has_not_are_refused_by_name(on_legs: str, tmp_path: Path) -> None:
    with pytest.raises(CapabilityError, match="an obstacle that is a plane does not push links. Give a box"):
        build(on_legs, tables(ShapeCfg(kind="plane")))
    bench = trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 3))])
    bench.export(tmp_path / "bench.stl")
    with pytest.raises(CapabilityError, match="bench.stl is not one closed convex body.*compound of convex parts"):
        build(on_legs, tables(ShapeCfg(kind="mesh", path=str(tmp_path / "bench.stl"))))
    with pytest.raises(CapabilityError, match="push back at a contact of a vehicle with joints. Use backend 'mujoco'"):
        build(on_legs, tables(LOW), backend="torch")


@pytest.mark.slow
def test_a_mesh_and_a_compound_carry_as_the_box_that_they_are(on_legs: str, tmp_path: Path) -> None:
    trimesh.creation.box((1.0, 1.0, 0.4)).export(tmp_path / "table.stl")
    half = ShapeCfg(kind="box", size=(0.5, 1.0, 0.4))
    parts = tuple(PartCfg(shape=half, position=(x, 0.0, 0.0)) for x in (-0.25, 0.25))
    ends = []
    for shape in (LOW, ShapeCfg(kind="mesh", path=str(tmp_path / "table.stl")), ShapeCfg(kind="compound", parts=parts)):
        sim = build(on_legs, tables(shape))
        sim.reset()
        put(sim, sim.gtd["obstacle_position"][:, 0] + torch.tensor([0.0, 0.0, 0.28]))
        assert not let_go(sim, 0.3).any()
        ends.append(torch.cat((sim.gtd["robot_position"], sim.gtd["dof_position"]), dim=1))
    torch.testing.assert_close(ends[1], ends[0], rtol=0.0, atol=1e-4)
    torch.testing.assert_close(ends[2], ends[0], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("moves", [False, True])
def test_an_environment_among_obstacles_is_bit_for_bit_the_same_alone_and_when_it_continues(
    on_legs: str, moves: bool
) -> None:
    """Environment 1 in a batch of two and by itself, and a batch of other tables that goes on from what the first has saved."""
    speed = (0.2, 0.1, 0.0)
    motion = MotionCfg(kind="twist", lin_vel_low=speed, lin_vel_high=speed) if moves else MotionCfg()
    env, ends, saved = tables(LOW, HIGH, count=2, motion=motion), [], {}
    for options in ({}, {"num_envs": 1, "first_env": 1}, {"seed": 2}):
        sim = build(on_legs, env, **options)
        sim.reset()
        place = sim.gtd["obstacle_position"][:, 0].clone()
        place[:, 2] = 0.47
        put(sim, place)
        let_go(sim, 0.1)
        if "seed" in options:
            sim.load_state(saved["batch"])
        elif not options:
            saved["batch"] = sim.save_state()
        let_go(sim, 0.1)
        ends.append(
            torch.cat((sim.gtd["robot_position"], sim.gtd["dof_position"], sim.gtd["robot_contact_force"]), dim=1)
        )
    assert torch.equal(ends[1][0], ends[0][1])
    assert torch.equal(ends[2], ends[0])
    assert ends[0][:, -1].any()


@pytest.mark.parametrize("speed", [0.0, -8.0])
def test_a_thin_pole_between_two_poses_is_a_crash(on_legs: str, speed: float) -> None:
    """At 10 to 40 m/s, from 64 distances each; the pole is at rest, or comes along."""
    motion = (
        MotionCfg() if speed == 0.0 else MotionCfg(kind="twist", lin_vel_low=(speed, 0, 0), lin_vel_high=(speed, 0, 0))
    )
    pole = AssetCfg(
        name="pole", shapes=(ShapeCfg(kind="cylinder", radius=0.01, height=2.0),), count=1, motion=motion,
        position_ratio_low=(0.5, 0.5, 0.5), position_ratio_high=(0.5, 0.5, 0.5),
    )  # fmt: skip
    sim = build(on_legs, replace(STANDING, assets=(pole,), ground_height=None), num_envs=64)
    sim.reset()
    share = torch.linspace(0.0, 1.0, 64)
    put(sim, sim.gtd["obstacle_position"][:, 0] - torch.tensor([1.0, 0.0, 0.0]) * (0.3 + 0.4 * share[:, None]))
    sim.gtd["robot_linvel"][:, 0] = 10.0 + 30.0 * (7.0 * share % 1.0)
    assert let_go(sim, 0.1).all()
