"""Surroundings of the robots, and their contact forces in the form that a backend takes.

Letters: E environments, C collision spheres.
"""

from dataclasses import dataclass
from math import inf

from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.cores import contact_points
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import BASE
from aerial_gym.config.sim import SimCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS, SubstepHook
from aerial_gym.physics.effects import FluidEffect
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.state import BodyState
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.robots.joints.link_tensors import LinkTensors


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Ground, obstacles and contact of all environments."""

    bounds: tuple[Tensor, Tensor]  # Lower and upper corner of the environments [m], world, each (E, 3)
    crashes: Tensor  # Touch of the ground, with `contact` also of an obstacle, bool (E,); set by physics
    ground_height: float | None = None  # Height of the ground plane [m], world; None where there is none
    ceiling_height: float | None = None  # Height of the ceiling [m], world; None where there is none
    contact: ContactCfg | None = None  # Contact law of ground and obstacles; None without contact forces
    scene: Scene | None = None  # The obstacles; only needed with `contact`, which moves them between the substeps
    moving: "Obstacles | None" = None  # Its instances as they move; None if nothing moves
    links: LinkTensors | None = None  # Link poses; None for a rigid robot
    several_vehicles: bool = False  # Whether other vehicles of the environment put their wakes on this one
    hook: SubstepHook | None = None  # Follows the robot through the substeps, where there is no contact with obstacles


class ContactSources:
    """Ground and obstacles of one robot; without ``contact`` they report a touch and exert no force."""

    def __init__(self, robot: RobotCfg, gtd: GlobalTensorDictionary, around: Surroundings) -> None:
        """Declare the contact force where there is one; raise ``ConfigError`` if the robot has no collision shape."""
        self._robot, self._around = robot, around
        self._spheres, self._on_links = contact_points(robot.collision.link_shapes(BASE), device=gtd.device), None
        if around.contact is not None and robot.joints is not None:
            from aerial_gym.robots.joints.obstacle_sweep import shapes_on_links

            moves = around.moving is not None
            self._spheres, self._on_links = shapes_on_links(robot, device=gtd.device, scene=around.scene, moves=moves)
        self.force: Tensor | None = None
        """Sum of impulses of the step [N s], and at its end the mean force [N], world, (E, 3); None without contact."""
        if around.contact is None:
            return
        if not len(self._spheres):
            raise ConfigError(
                "the environment asks for contact, but this robot has no collision shape. Give its file "
                "collision: {boxes: [{size: [...]}]}, or spheres, or capsules"
            )
        self.force = gtd.declare(TensorSpec(
            key="robot_contact_force", shape=("E", 3), unit="N", frame="world", owner="physics",
            meaning="mean force of ground and obstacles on the robot over the step",
        ))  # fmt: skip

    def make_ground(self) -> Ground | None:
        """Return the ground, None without one; among obstacles a robot with joints gets one at minus infinity."""
        height = self._around.ground_height
        if height is None and (self._on_links is None or self._on_links.solids is None):
            return None
        return Ground(
            height=-inf if height is None else height, spheres=self._spheres, contact=self._around.crashes,
            cfg=self._around.contact, impulse=self.force, on_links=self._on_links,
        )  # fmt: skip

    def make_hook(
        self, state: BodyState, sim: SimCfg, *, mass: Tensor, inertia: Tensor, com: Tensor
    ) -> SubstepHook | None:
        """Return the hook after each substep: contact with obstacles, else the hook of the surroundings."""
        around, robot = self._around, self._robot
        scene, contact = around.scene, around.contact
        if self.force is None or contact is None or scene is None or not scene.num_instances:
            return around.hook
        if around.links is not None:
            from aerial_gym.robots.joints.obstacle_sweep import LinkObstacleSweep

            return LinkObstacleSweep(
                scene, contact, robot, state, around.links, dt=sim.dt, crashes_out=around.crashes, moving=around.moving
            )
        from aerial_gym.robots.scene_contact import ContactBody, SceneContact

        in_fluid = any(isinstance(EFFECTS.get(name), FluidEffect) for name in robot.effects)
        pushed = ContactBody(
            mass=mass, inertia=inertia, com=com, spheres=self._spheres, shapes=robot.collision.shapes, in_fluid=in_fluid
        )
        return SceneContact(
            scene, contact, pushed, state, integrator=sim.integrator, dt=sim.dt, crashes_out=around.crashes,
            impulse_out=self.force, moving=around.moving,
        )  # fmt: skip
