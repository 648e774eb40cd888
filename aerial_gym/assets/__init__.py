"""Obstacles: shared shapes, per-environment instances, their placement, and the collision test."""

from aerial_gym.assets.asset_manager import AssetManager
from aerial_gym.assets.catalog import ENVIRONMENTS
from aerial_gym.assets.collision import CollisionTest
from aerial_gym.assets.placement import bounds_ranges, draw_bounds
from aerial_gym.assets.scene import PARKED_Z, Scene
from aerial_gym.assets.shapes import load_mesh

__all__ = [
    "ENVIRONMENTS",
    "PARKED_Z",
    "AssetManager",
    "CollisionTest",
    "Scene",
    "bounds_ranges",
    "draw_bounds",
    "load_mesh",
]
