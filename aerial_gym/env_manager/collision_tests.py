"""Collision tests of a robot with obstacles, the ground, and on request its own links.

Letters: E environments, L links, K substeps of a step.
"""

from math import inf
from typing import TYPE_CHECKING

import torch

from aerial_gym.assets import AssetManager
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import BASE
from aerial_gym.physics import Trajectory
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec

if TYPE_CHECKING:
    from aerial_gym.assets.collision import CollisionTest
    from aerial_gym.assets.self_collision import SelfCollisionTest
    from aerial_gym.robots.joints.link_tensors import LinkTensors
    from aerial_gym.robots.joints.links import LinkPlaces


def make_trajectory(
    env: EnvironmentCfg, robot: RobotCfg, *, num_envs: int, device: torch.device, differentiable: bool = False
) -> Trajectory | None:
    """Return the trajectory record for swept collision tests; None without obstacles, or with contact forces.

    Over the ground alone a differentiable robot is tested at the poses only: its substeps are one kernel without a record.
    """
    scene = bool(env.num_assets or (env.ground_part and not (differentiable and robot.joints is None)))
    links = robot.collision.between_links or (robot.collides_with_links and scene)
    if env.contact is not None or not (scene or links):
        return None
    joints = len(robot.link_names) - 1 if links else 0
    return Trajectory.zeros(env.physics_steps_per_env_step, num_envs, device=device, num_joints=joints)


class CollisionTests:
    """The tests, with all views made at construction."""

    _collision: "CollisionTest | None" = None
    _between: "SelfCollisionTest | None" = None

    def __init__(
        self, robot: RobotCfg, gtd: GlobalTensorDictionary, assets: AssetManager, *, links: "LinkTensors | None",
        places: "LinkPlaces | None", trajectory: Trajectory | None, dt: float, is_last: bool = True,
    ) -> None:  # fmt: skip
        """Declare the distance between links on request, and take views.

        Args:
            trajectory: Record of each step; None where nothing is followed.
            is_last: Whether moving obstacles move with this test: the last of several.
        """
        crashes = gtd["crashes"]
        gtd["robot_clearance"].fill_(inf)
        if assets.scene.num_solid:  # local imports, as their Warp functions take long
            from aerial_gym.assets.collision import CollisionTest

            self._collision = CollisionTest(
                assets.scene, robot.collision.link_shapes(BASE),
                links=() if links is None else links.link_shapes(robot.collision),
                distance_out=gtd["robot_clearance"], moving=assets.moving, position=gtd["robot_position"],
                attitude=gtd["robot_orientation"],
            )  # fmt: skip
        followed = None if trajectory is None else (trajectory.position, trajectory.attitude)
        if places is not None and places.trajectory is not None:
            followed, dt = (places.trajectory.position, places.trajectory.attitude), dt / places.trajectory.pieces
        self._follows = followed is not None
        if followed is not None and self._collision is not None:
            self._collision.record_launches(*followed, dt=dt, crashes_out=crashes, moves_obstacles=is_last)
        if robot.collision.between_links and robot.joints is not None and links is not None and followed is not None:
            from aerial_gym.assets.self_collision import SelfCollisionTest

            self._between = SelfCollisionTest(
                robot.collision,
                names=robot.link_names,
                parents=[robot.joints.link_number(joint.parent) for joint in robot.joints.layout],
                pivots=links.pivots,
                state=links.state,
                distance_out=gtd.declare(TensorSpec(
                    key="robot_link_clearance", shape=("E",), unit="m", frame="-", owner="env",
                    meaning="signed distance of the robot's links to each other, without those that always touch",
                )),
            )  # fmt: skip
            self._between.record_launches(*followed, crashes_out=crashes)
        self.measure()

    def step(self) -> None:
        """Measure after a step. Obstacles that do not push back move; a touch at any time of the step is a crash."""
        if self._collision is not None:
            (self._collision.step if self._follows else self._collision.measure)()
        if self._between is not None:
            self._between.step()

    def measure(self) -> None:
        """Write the distances of the present poses."""
        if self._collision is not None:
            self._collision.measure()
        if self._between is not None:
            self._between.measure()
