"""Drives with limits and dry friction on the fused backend: the efforts that it publishes. They stay within their limits, and
are the efforts that changed the rates, by inverse dynamics in float64. Float32 rounding of the rates at the end is itself an
effort, inertia times rate over the step. So the bound of the comparison is taken from float32 torch from the same starts: the
fused step may be ``FACTOR`` times as far. Letters: E environments, D joints."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.config.joint import DriveCfg, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics import TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated import steppers
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.dynamics import EquationsOfMotion
from aerial_gym.physics.articulated.fused import limit_solver
from aerial_gym.physics.articulated.joint_laws import Drive, dry_friction, joint_effort
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.physics.state import ArticulatedState, JointEfforts
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.effort_rig import DT, Residuals, TreeCase, residuals
from tests.physics.vehicles import random_state
from tests.repetitions import frequent_values

FACTOR, ROUND_OFF = 4.0, 1e-5

NUM_ENVS, STEPS = 32, 50


def snake(name: str) -> RobotCfg:
    robot = ROBOTS.get(name)
    layout = tuple(
        replace(joint, spring=replace(joint.spring or SpringCfg(), friction=0.05 * (k % 2)))
        for k, joint in enumerate(robot.joints.layout)
    )
    return replace(robot, joints=replace(robot.joints, layout=layout))


def random_robot(seed: int) -> RobotCfg:
    """Return a quadrotor with a tree of 1 to 6 joints; each has a drive of some mode, dry friction or both."""
    rng, robot = np.random.default_rng(seed), ROBOTS.get("base_quadrotor")
    places, masses, inertias, layout = [np.zeros(3)], [0.3], [np.diag((2e-3, 3e-3, 4e-3))], []
    coms, names = [np.zeros(3)], ["base"]
    for k in range(int(rng.integers(1, 7))):
        parent, axis = int(rng.integers(0, k + 1)), rng.normal(size=3)
        places.append(places[parent] + rng.uniform(-0.1, 0.1, 3))
        coms.append(places[-1] + rng.uniform(-0.05, 0.05, 3))
        masses.append(float(rng.uniform(0.01, 0.05)))
        inertias.append(np.diag(rng.uniform(1e-5, 1.9e-5, 3)))
        mode, has = rng.choice(("position", "velocity", "effort")), rng.integers(0, 3)
        drive = DriveCfg(
            mode=str(mode), stiffness=float(rng.uniform(0.1, 20.0)) * float(mode == "position"),
            damping=float(rng.uniform(0.01, 2.0)) * float(mode != "effort"), limit=float(rng.uniform(0.005, 0.1)),
            command_range=(-3.0, 3.0) if mode != "effort" else (-0.2, 0.2),
        )  # fmt: skip
        layout.append(
            JointCfg(
                name=f"j{k}", parent=names[parent], axis=tuple((axis / np.linalg.norm(axis)).tolist()),
                position=tuple(places[-1].tolist()), initial=(-0.3, 0.3), drive=drive if has else None,
                kind="prismatic" if rng.random() < 0.2 else "revolute", spring=SpringCfg(friction=0.02 * (has != 1)),
                link=LinkCfg(mass=masses[-1], com=tuple(coms[-1].tolist()), inertia=_rows(inertias[-1])),
            )
        )  # fmt: skip
        names.append(f"j{k}")
    mass, com = sum(masses), np.average(coms, axis=0, weights=masses)
    whole = np.zeros((3, 3))
    for own, weight, place in zip(inertias, masses, coms, strict=True):
        lever = place - com
        whole += own + weight * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    body = replace(robot.body, mass=mass, com=tuple(com.tolist()), inertia=_rows(whole))
    return replace(robot, body=body, joints=JointsCfg(layout=tuple(layout), source="test"))


def _rows(matrix: np.ndarray) -> tuple[Vec3, Vec3, Vec3]:
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix.tolist()
    return (xx, xy, xz), (yx, yy, yz), (zx, zy, zz)


class RobotFlight:
    def __init__(self, robot: RobotCfg, backend: TorchBackend | WarpBackend, dtype: torch.dtype) -> None:
        self.vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS, dtype=dtype)
        bends = build_articulation(robot, like=self.vehicle.mass)
        self.bends, self.backend, self.dtype = bends, backend, dtype
        law = make_controller(CONTROLLERS.get("no_control"), self.vehicle, 9.81, dt=DT)
        zeros = torch.zeros(NUM_ENVS, bends.num_joints, dtype=dtype)
        self.efforts = JointEfforts(drive=zeros, friction=zeros.clone())
        model = build_model(self.vehicle, [], articulation=bends)
        backend.allocate(model, law, integrator="euler", efforts=self.efforts)

    def step(self, start: ArticulatedState, action: Tensor) -> tuple[ArticulatedState, JointEfforts]:
        state = ArticulatedState(**{name: rows.clone().to(self.dtype) for name, rows in vars(start).items()})
        self.backend.step(state, action.to(self.dtype), DT, 1)
        efforts = {name: rows.double() for name, rows in vars(self.efforts).items()}
        return ArticulatedState(**{name: rows.double() for name, rows in vars(state).items()}), JointEfforts(**efforts)


def change_effort(
    exact: RobotFlight, result: EquationsOfMotion, start: ArticulatedState, end: ArticulatedState
) -> Tensor:
    """Return the total effort of drive and friction of each joint that changes the rates from start to end, (E, D)."""
    turn = start.attitude
    change = quat_rotate_inverse(turn, end.lin_vel - start.lin_vel), end.ang_vel - start.ang_vel
    acc = torch.cat((*change, end.joint_vel - start.joint_vel), dim=1) / DT
    effort = (result.mass @ acc.unsqueeze(-1)).squeeze(-1)[:, 6:] - result.force[:, 6:]
    passive = joint_effort(exact.bends.laws(None), start.joint_pos, start.joint_vel)
    return effort - passive.value + passive.damping * DT * acc[:, 6:] + passive.stiffness * DT * end.joint_vel


def tree_case(exact: RobotFlight, state: ArticulatedState, action: Tensor) -> TreeCase:
    """Return the laws of drives and friction under an action."""
    bends = exact.bends
    drive = bends.drive(action[:, exact.vehicle.num_rotors :])
    zero = torch.zeros_like(state.joint_pos)
    none = Drive(stiffness=zero, damping=zero, position=zero, rate=zero, effort=zero, limit=zero)
    return TreeCase(
        bends.tree, bends.links(exact.vehicle), (), drive or none, dry_friction(bends.friction), zero, state
    )


SNAKES = [f"snakey{rods}{mode}" for rods in ("", "5", "6") for mode in ("", "_position", "_effort")]


def fly(robot: RobotCfg, monkeypatch: pytest.MonkeyPatch) -> dict[str, Residuals]:
    """Return the largest violations in 0.1 s under commands and thrusts drawn anew every 10 ms; each step also on torch from
    the same start."""
    seen: list[EquationsOfMotion] = []
    own = steppers._implicit_step

    def record_step(tree, state, result, acts, dt):
        seen.append(result)
        return own(tree, state, result, acts, dt)

    monkeypatch.setattr(steppers, "_implicit_step", record_step)
    exact, single, fused = (
        RobotFlight(robot, backend, dtype)
        for backend, dtype in ((TorchBackend(), torch.float64), (TorchBackend(), torch.float32), (WarpBackend(), torch.float32))
    )  # fmt: skip
    generator, bends = torch.Generator().manual_seed(3), exact.bends

    def draw(width: int) -> Tensor:
        return torch.rand(NUM_ENVS, width, dtype=torch.float64, generator=generator)

    body, num_rotors = random_state(NUM_ENVS, seed=5, rotor_speed=1.0), exact.vehicle.num_rotors
    weight = robot.body.mass * 9.81 / num_rotors
    state = ArticulatedState(
        **{**vars(body), "rotor_speed": state_for_thrust(exact.vehicle, torch.full((NUM_ENVS, num_rotors), weight).double())},
        joint_pos=bends.reference + draw(bends.num_joints) - 0.5, joint_vel=4.0 * draw(bends.num_joints) - 2.0,
    )  # fmt: skip
    state = ArticulatedState(**{name: rows.float().double() for name, rows in vars(state).items()})
    worst = {"torch": Residuals(), "fused": Residuals()}
    for k in range(STEPS):
        if k % 5 == 0:
            told = bends.command_low + draw(bends.num_driven) * (bends.command_high - bends.command_low)
            action = torch.cat((2.0 * weight * draw(num_rotors), told), dim=1).float().double()
        exact.step(state, action)
        results, laws = seen[-1], tree_case(exact, state, action)
        for kind, flown in (("torch", single), ("fused", fused)):
            end, efforts = flown.step(state, action)
            change = change_effort(exact, results, state, end)
            worst[kind] = worst[kind].join(residuals(laws, efforts, change, end))
        state = end
    return worst


@pytest.mark.parametrize("name", frequent_values([*SNAKES, *map(str, range(200))], ["snakey_position", "1"]))
def test_efforts_of_fused_steps_keep_their_limits_and_change_the_rates(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    worst = fly(snake(name) if name in SNAKES else random_robot(int(name)), monkeypatch)
    print(f"\n{name}: fused {worst['fused']}; float32 torch {worst['torch']}")
    for now in worst.values():
        assert max(now.excess, now.power) <= ROUND_OFF
    for quantity in ("law", "change"):
        own, single_own = (getattr(worst[kind], quantity) for kind in ("fused", "torch"))
        assert own <= FACTOR * single_own + ROUND_OFF, quantity


def test_no_limit_is_exceeded_in_a_fused_step_without_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Efforts of rows that are not solved are held within the limits, and friction along the motion is left out. The change of
    rates cannot be compared: velocity terms of the reference use the rates of a solved step."""
    monkeypatch.setattr(limit_solver, "ROUNDS", 0)
    worst = fly(snake("snakey_position"), monkeypatch)
    assert max(worst["fused"].excess, worst["fused"].power) <= ROUND_OFF
    assert worst["fused"].law > 0.1 > worst["torch"].law
