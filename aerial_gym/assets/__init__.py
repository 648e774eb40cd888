"""Obstacles: shared shapes, per-environment instances, their placement, and the collision test."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.assets.asset_manager import AssetManager
    from aerial_gym.assets.catalog import ENVIRONMENTS
    from aerial_gym.assets.collision import CollisionTest
    from aerial_gym.assets.families import FAMILIES, family_shapes
    from aerial_gym.assets.mesh_files import load_mesh
    from aerial_gym.assets.placement import Bounds
    from aerial_gym.assets.scene import PARKED_Z, Scene
    from aerial_gym.assets.urdf import load_urdf

__all__ = [
    "ENVIRONMENTS", "FAMILIES", "PARKED_Z", "AssetManager", "Bounds", "CollisionTest", "Scene", "family_shapes",
    "load_mesh", "load_urdf",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
