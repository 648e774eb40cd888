"""Link poses and velocities as tensors of the Global Tensor Dictionary; ``links`` writes them.

Frames: world z up; that of a link is the body's in the reference pose. Letters: E environments, L links, the base first.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.config.joint import JointsCfg
from aerial_gym.config.robot import CollisionCfg
from aerial_gym.config.sensor import ImuCfg, RangeSensorCfg
from aerial_gym.config.shape import BASE
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.sensors.mounts import Carrier, RobotSensor

if TYPE_CHECKING:
    from aerial_gym.assets.collision import LinkGeometry
    from aerial_gym.physics import Trajectory
    from aerial_gym.physics.state import ArticulatedState
    from aerial_gym.robots.joints.links import LinkPlaces


@dataclass(frozen=True, kw_only=True)
class LinkTensors:
    """Link poses and velocities in the GTD."""

    state: Tensor  # Position [m], xyzw, velocity [m/s], angular velocity [rad/s] of the link frames, world, (E, L, 13)
    ang_vel: Tensor  # Angular velocity [rad/s], axes of the link, (E, L, 3)
    names: tuple[str, ...]  # Of the links, L of them
    pivots: tuple[Vec3, ...]  # Hinge of each link in its frame [m]; the origin for the base and links that slide

    def link_of_sensors(
        self, mounted: Mapping[str, RobotSensor[RangeSensorCfg] | RobotSensor[ImuCfg]]
    ) -> dict[str, Carrier]:
        """Return the carrier link of each sensor by name, without sensors on the base."""
        carriers = {}
        for name, each in mounted.items():
            if each.link != BASE:
                k = self.names.index(each.link)
                position, attitude, lin_vel, _ = self.state[:, k].split((3, 4, 3, 3), dim=-1)
                motion = {"position": position, "attitude": attitude, "lin_vel": lin_vel}
                carriers[name] = Carrier(number=k, **motion, ang_vel=self.ang_vel[:, k])
        return carriers

    def link_shapes(self, collision: CollisionCfg) -> "list[LinkGeometry]":
        """Return the collision shapes of each link except the base."""
        from aerial_gym.assets.collision import LinkGeometry

        shapes_by_link = [(number, collision.link_shapes(name)) for number, name in enumerate(self.names[1:], 1)]
        position, attitude = self.state[..., :3], self.state[..., 3:7]
        return [
            LinkGeometry(
                shapes=shapes, number=k, position=position[:, k], attitude=attitude[:, k], pivot=self.pivots[k]
            )
            for k, shapes in shapes_by_link
            if shapes
        ]

    def make_launches(self, cfg: JointsCfg, state: "ArticulatedState", trajectory: "Trajectory | None") -> "LinkPlaces":
        """Return the launches that write these tensors from a robot's state, and follow a trajectory with joints."""
        from aerial_gym.robots.joints.links import LinkPlaces

        return LinkPlaces(cfg, state, self, trajectory)


def declare_links(gtd: GlobalTensorDictionary, cfg: JointsCfg) -> LinkTensors:
    """Declare the links of a robot that bends."""
    gtd.define_size("L", len(cfg.link_names))
    names, origin = ", ".join(cfg.link_names), (0.0, 0.0, 0.0)
    return LinkTensors(
        names=cfg.link_names,
        pivots=(origin, *(origin if joint.kind == "prismatic" else joint.position for joint in cfg.layout)),
        state=gtd.declare(TensorSpec(
            key="robot_link_state_tensor", shape=("E", "L", 13), unit="m, -, m/s, rad/s", frame="world", owner="robot",
            meaning=f"p, q xyzw, v, w of the frames of {names}, each the body's in the reference pose",
        )),
        ang_vel=gtd.declare(TensorSpec(
            key="robot_link_body_angvel", shape=("E", "L", 3), unit="rad/s", frame="link", owner="robot",
            meaning="angular velocity of each link in its own axes",
        )),
    )  # fmt: skip
