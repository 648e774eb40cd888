"""Chains of 2 to 12 joints on a CPU: recursion beside a factor of the mass matrix, ``python -m benchmarks.joints.chains``.

Ours is the fused kernel, which eliminates link by link (``physics.articulated.fused.recursion``); MuJoCo works out the mass
matrix by composite inertias and factors it (L^T D L), in C. One thread each, ours in float32 and MuJoCo in float64, on the same
rods on a free base with damped hinges that turn about y and z in turn, in steps of 2 ms, implicit in the damping. Prints a row
of a Markdown table for each length.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import torch

from aerial_gym.config.joint import BASE, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.random import Randomness
from aerial_gym.physics import build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import articulation_of
from aerial_gym.physics.mujoco.mjcf import write_mjcf
from aerial_gym.physics.state import JointedState, state_at_rest
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS

DT, NUM_ENVS, SUBSTEPS = 0.002, 64, 50
LENGTH, MASS, DAMPING = 0.2, 0.1, 0.01
"""Of a rod [m] and [kg], and of each hinge [N m s/rad]."""


def chain(num_joints: int) -> RobotCfg:
    """Return a body of 1 kg with rods in a row along x."""
    across = MASS * LENGTH**2 / 12.0
    inertia = ((1e-4, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, across))
    layout = tuple(
        JointCfg(
            name=f"rod_{k}",
            parent=BASE if k == 0 else f"rod_{k - 1}",
            axis=(0.0, 1.0, 0.0) if k % 2 == 0 else (0.0, 0.0, 1.0),
            position=(LENGTH * k, 0.0, 0.0),
            link=LinkCfg(mass=MASS, com=(LENGTH * (k + 0.5), 0.0, 0.0), inertia=inertia),
            spring=SpringCfg(damping=DAMPING),
        )
        for k in range(num_joints)
    )
    mass = 1.0 + num_joints * MASS
    places = [LENGTH * (k + 0.5) for k in range(num_joints)]
    com = MASS * sum(places) / mass
    wide = 0.01 + com**2 + sum(across + MASS * (x - com) ** 2 for x in places)
    plain = ROBOTS.get("base_quadrotor")
    whole = ((0.01 + num_joints * 1e-4, 0.0, 0.0), (0.0, wide, 0.0), (0.0, 0.0, wide))
    body = replace(plain.body, mass=mass, com=(com, 0.0, 0.0), inertia=whole)
    return replace(plain, body=body, joints=JointsCfg(layout=layout, source="made up"))


def ours(robot: RobotCfg) -> Callable[[], object]:
    """Return what advances 64 environments by 50 steps."""
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS)
    bends = articulation_of(robot, like=vehicle.mass)
    assert bends is not None
    law, backend = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=DT), WarpBackend()
    backend.allocate(build_model(vehicle, articulation=bends), law, integrator="euler", random=Randomness(NUM_ENVS))
    still = state_at_rest(NUM_ENVS, vehicle.num_rotors, device=torch.device("cpu"), dtype=torch.float32)
    rest = torch.zeros(NUM_ENVS, bends.num_joints)
    state, action = JointedState(**vars(still), joint_pos=rest + 0.1, joint_vel=rest.clone()), torch.zeros(NUM_ENVS, 4)
    return lambda: backend.step(state, action, DT, SUBSTEPS)


def theirs(robot: RobotCfg) -> Callable[[], object]:
    """Return what advances one environment of MuJoCo by as many steps as all of ours together."""
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    bends = articulation_of(robot, like=vehicle.mass)
    assert bends is not None
    mujoco: Any = import_module("mujoco")
    text = write_mjcf(bends.tree, bends.links(vehicle), gravity=9.81, dt=DT, integrator="implicitfast")
    model = mujoco.MjModel.from_xml_string(text)
    model.dof_damping[6:] = DAMPING
    data = mujoco.MjData(model)
    data.qpos[7:] = 0.1
    return lambda: mujoco.mj_step(model, data, NUM_ENVS * SUBSTEPS)


def main() -> None:
    """Print steps per second of processor time of both, medians of 21 repeats that take turns."""
    torch.set_num_threads(1)
    print("| joints | recursion, ours | composite inertia and factor, MuJoCo | ratio |\n| --- | --- | --- | --- |")
    for num_joints in (2, 4, 6, 8, 10, 12):
        runs, rates = [make(chain(num_joints)) for make in (ours, theirs)], ([], [])
        for repeat in range(22):
            for run, found in zip(runs, rates, strict=True):
                start = time.process_time()
                run()
                if repeat:
                    found.append(NUM_ENVS * SUBSTEPS / (time.process_time() - start))
        a, b = (statistics.median(found) for found in rates)
        print(f"| {num_joints} | {a:.3g} | {b:.3g} | {a / b:.2f} |", flush=True)


if __name__ == "__main__":
    main()
