"""Families of shapes: rules that make any number of random variants from a seed and ranges of dimensions."""

from collections.abc import Sequence
from dataclasses import replace

from aerial_gym.assets.families import rules
from aerial_gym.assets.families.rules import Draw, Family
from aerial_gym.config.environment import AssetCfg, FamilyCfg, ShapeCfg
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter

__all__ = ["FAMILIES", "Draw", "Family", "assets_with_family_shapes", "family_shapes"]

FAMILIES: Registry[Family] = Registry("family")

for _name, _family in {
    "boxes": rules.BOXES, "corridors": rules.CORRIDORS, "doorways": rules.DOORWAYS, "gates": rules.GATES,
    "panels": rules.PANELS, "poles": rules.POLES, "rooms": rules.ROOMS, "shelves": rules.SHELVES, "tables": rules.TABLES,
    "thin_rods": rules.THIN_RODS, "trees": rules.TREES, "walls": rules.WALLS,
}.items():  # fmt: skip
    FAMILIES.register(_name, _family)

FAMILIES.accept_plugins(shape=instance_converter("aerial_gym.assets.families.rules:Family"))


def family_shapes(cfg: FamilyCfg) -> tuple[ShapeCfg, ...]:
    """Return the shapes of a family configuration, identical at every call."""
    return FAMILIES.get(cfg.name).shapes(cfg)


def assets_with_family_shapes(assets: Sequence[AssetCfg]) -> tuple[AssetCfg, ...]:
    """Return the assets with lists of shapes in place of their families."""
    return tuple(
        replace(asset, shapes=family_shapes(asset.family), family=None) if asset.family else asset for asset in assets
    )
