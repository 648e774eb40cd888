"""Surroundings of the robots: ground, obstacles and contact. Letters: E environments."""

from dataclasses import dataclass

from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.config.contact import ContactCfg
from aerial_gym.physics import SubstepHook
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
    hook: SubstepHook | None = None  # Follows the robot through the substeps, where there is no contact with obstacles
