"""Families of shapes: rules that make any number of random variants from a seed and ranges of dimensions."""

from collections.abc import Sequence
from dataclasses import replace

from aerial_gym.assets.families.boxes import BOXES, DOORWAYS, PANELS, WALLS
from aerial_gym.assets.families.corridors import CORRIDORS
from aerial_gym.assets.families.family import Draw, Family
from aerial_gym.assets.families.furniture import SHELVES, TABLES
from aerial_gym.assets.families.gates import GATES, POLES
from aerial_gym.assets.families.rods import THIN_RODS
from aerial_gym.assets.families.rooms import ROOMS
from aerial_gym.assets.families.trees import TREES
from aerial_gym.config.environment import AssetCfg, FamilyCfg, ShapeCfg
from aerial_gym.registry import Registry

__all__ = ["FAMILIES", "Draw", "Family", "family_shapes", "with_shapes"]

FAMILIES: Registry[Family] = Registry("family")

for _name, _family in {
    "boxes": BOXES,
    "corridors": CORRIDORS,
    "doorways": DOORWAYS,
    "gates": GATES,
    "panels": PANELS,
    "poles": POLES,
    "rooms": ROOMS,
    "shelves": SHELVES,
    "tables": TABLES,
    "thin_rods": THIN_RODS,
    "trees": TREES,
    "walls": WALLS,
}.items():
    FAMILIES.register(_name, _family)


def family_shapes(cfg: FamilyCfg) -> tuple[ShapeCfg, ...]:
    """Return the shapes of a family configuration, identical at every call."""
    return FAMILIES.get(cfg.name).shapes(cfg)


def with_shapes(assets: Sequence[AssetCfg]) -> tuple[AssetCfg, ...]:
    """Return the assets with the shapes of their families listed."""
    return tuple(
        replace(asset, shapes=family_shapes(asset.family), family=None) if asset.family else asset for asset in assets
    )
