"""Draw vehicles that bend: ``python -m benchmarks.joints.draw_joints OUT.png --record morphy_joint_step.csv``.

Left: the elevation of an arm of Morphy that is let go on a stand, the record of the Aerial Gym Simulator beside the published
law and the one that creeps, in steps of 2 ms. Right: a snake of six rods that opens from its ring in hover, from above.
"""

from argparse import ArgumentParser
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes

from aerial_gym import ENVIRONMENTS, ROBOTS, SimBuilder
from aerial_gym.env_manager import EnvManager
from aerial_gym.math.quaternion import quat_to_matrix
from aerial_gym.physics.articulated.motion import place_links

STEP = 0.002


def built(robot: object) -> EnvManager:
    """Return one robot in steps of 2 ms."""
    env = SimBuilder().build_env(
        sim_name="base_sim_2ms",
        env_name=replace(ENVIRONMENTS.get("empty_env_2ms"), physics_steps_per_env_step=1),
        robot_name=robot,  # type: ignore[arg-type]
        controller_name="no_control",
        num_envs=1,
        device="cpu",
    )
    env.reset()
    return env


def draw_release(ax: Axes, record: str) -> None:
    """Draw the first two seconds of a release."""
    table = pd.read_csv(record)
    time, angle = table["t"].to_numpy(), table["elevation_rad"].to_numpy()
    start, shown = float(angle[time < 0.0].mean()), (time > -0.1) & (time < 2.0)
    ax.plot(time[shown], np.degrees(angle[shown]), color="0.6", lw=4, label="record")
    for name, label in (("morphy", "published law"), ("morphy_creeping", "with creep")):
        robot = ROBOTS.get(name)
        assert robot.joints is not None
        layout = tuple(replace(joint, ends=None) for joint in robot.joints.layout)
        env = built(replace(robot, joints=replace(robot.joints, layout=layout, floating=False)))
        for key in ("dof_position", "dof_velocity", "rotor_speed"):
            env.gtd[key].zero_()
        env.gtd["dof_position"][:, ::2] = start
        seen = [start]
        for _ in range(1000):
            env.step(torch.zeros(1, 4))
            seen.append(float(env.gtd["dof_position"][0, 0]))
        ax.plot(STEP * np.arange(len(seen)), np.degrees(seen), lw=1.2, label=label)
    ax.set(xlabel="time [s]", ylabel="elevation [deg]", title="an arm of Morphy, let go")
    ax.legend()


def draw_snake(ax: Axes) -> None:
    """Draw a snake as it opens; rotors carry the weight of their own rods."""
    env = built("snakey6_position")
    bends, robot = env.robot_manager.articulation, env.robot_manager.cfg
    assert bends is not None
    vehicle = env.robot_manager.model.vehicle
    actions = torch.zeros(1, env.robot_manager.num_actions)
    actions[:, :6] = robot.body.mass * 9.81 / 6.0
    for step in range(1201):
        share = min(step / 1000.0, 1.0)
        actions[:, 6:] = (1.0 - share) * bends.reference
        if step % 400 == 0:
            places = place_links(bends.tree, bends.links(vehicle), env.gtd["dof_position"])
            turn = quat_to_matrix(env.gtd["robot_orientation"])[0]
            links = (0, *(k + 1 for k in range(1, bends.num_joints, 2)))
            for number, link in enumerate(links):
                hub = vehicle.rotor_position[0, number] - bends.origins[link]
                middle = places.origin[0, link] + places.rotation[0, link] @ hub
                along = places.rotation[0, link] @ _direction(robot.mounts.layout, number)
                ends = torch.stack([turn @ (middle + side * along) for side in (-0.5, 0.5)])
                ends = ends + env.gtd["robot_position"][0]
                ax.plot(*ends[:, :2].T, color=plt.get_cmap("viridis")(step / 1200), lw=2.5)
        env.step(actions)
    ax.set(xlabel="x [m]", ylabel="y [m]", title="a snake of six rods opens in 2 s", aspect="equal")


def _direction(layout: tuple, number: int) -> torch.Tensor:
    """Return the direction of a rod in the reference pose, a regular polygon."""
    angle = 2.0 * np.pi * number / len(layout)
    return torch.tensor([np.cos(angle), np.sin(angle), 0.0], dtype=torch.float32)


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("out")
    parser.add_argument("--record", required=True)
    given = parser.parse_args()
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    draw_release(left, given.record)
    draw_snake(right)
    figure.savefig(given.out, dpi=90)


if __name__ == "__main__":
    main()
