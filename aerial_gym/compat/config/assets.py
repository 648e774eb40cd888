"""Obstacles: flat classes with URDF files in a folder, placed by ratios of the bounds.

The state of 13 numbers there is position as a share of the bounds, roll, pitch, yaw [rad], a 1, and velocities.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.compat.config import fields
from aerial_gym.compat.helpers import AERIAL_GYM_DIRECTORY
from aerial_gym.config.environment import AssetCfg, FamilyCfg, MotionCfg, ShapeCfg
from aerial_gym.errors import ConfigError

WALLS = ("front_wall", "back_wall", "left_wall", "right_wall", "bottom_wall", "top_wall")

STANDARD_FILES: dict[str, str] = {
    **{name: name for name in ("panels", "objects", "thin", "trees")},
    **{f"walls/{name}.urdf": name for name in WALLS},
}
"""Folders and files of obstacles that come with that simulator, and the asset here that has the same shapes."""

SEMANTIC_IDS: dict[str, int] = {
    "THIN_SEMANTIC_ID": 1, "TREE_SEMANTIC_ID": 2, "OBJECT_SEMANTIC_ID": 3, "PANEL_SEMANTIC_ID": 20,
    **{f"{name.upper()}_SEMANTIC_ID": 9 + k for k, name in enumerate(WALLS)},
}  # fmt: skip
"""Constants of that simulator's asset modules."""

_FOLDER = "resources/models/environment_assets"


def _script_state(position: Any, euler: Any) -> list[float]:
    return [*position, *euler, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def _ratio_changes(end: str) -> Any:
    def write(values: fields.Values) -> fields.Changes:
        state = values["min_state_ratio" if end == "low" else "max_state_ratio"]
        return {f"position_ratio_{end}": tuple(state[0:3]), f"euler_{end}": tuple(state[3:6])}

    return write


def _shape_changes(values: fields.Values) -> fields.Changes:
    """Return the shapes of a folder's URDF files, or the replacements of a folder of that simulator."""
    folder, file = Path(str(values["asset_folder"])), values["file"]
    name = STANDARD_FILES.get(folder.name, STANDARD_FILES.get(f"{folder.name}/{file}"))
    if name is not None and not folder.is_dir():
        like = getattr(CLASSES[name], fields.STANDS_FOR)
        return {"shapes": like.shapes, "family": like.family, "offset": like.offset}
    files = [folder / file] if file else sorted(folder.glob("*.urdf"))
    if not files or not all(path.is_file() for path in files):
        raise ConfigError(
            f"asset_folder = {str(folder)!r}, file = {file!r}: no such URDF file. Those of that simulator with shapes here: "
            f"{', '.join(STANDARD_FILES)}. Give URDF files, or leave the asset out of include_asset_type"
        )
    link_ids = values["semantic_masked_links"] or None
    first = max(int(values["semantic_id"]), 0) if values["per_link_semantic"] else None
    shapes = (ShapeCfg(kind="urdf", path=str(path), link_ids=link_ids, first_link_id=first) for path in files)
    return {"shapes": tuple(shapes), "family": None}


TABLE = fields.ConfigTable(
    kind="asset",
    fields=(
        *fields.same_fields(num_assets="count"),
        fields.native_field("asset_folder", "shapes", lambda c: f"{AERIAL_GYM_DIRECTORY}/{_FOLDER}/{c.name}", _shape_changes,
                "URDF files; folders of that simulator stand for the same shapes here"),
        fields.native_field("file", "shapes", lambda _: None, _shape_changes, "one file of the folder; None takes all"),
        fields.native_field("min_state_ratio", "position_ratio_low, euler_low",
                lambda c: _script_state(c.position_ratio_low, c.euler_low), _ratio_changes("low"), "entries 0 to 5"),
        fields.native_field("max_state_ratio", "position_ratio_high, euler_high",
                lambda c: _script_state(c.position_ratio_high, c.euler_high), _ratio_changes("high"), "entries 0 to 5"),
        *fields.same_fields(keep_in_env="keep"),
        fields.native_field("semantic_id", "semantic_id", lambda c: c.semantic_id,
                remark="-1: the instance's own id, counted in each environment"),
        fields.native_field("per_link_semantic", "shapes: first_link_id", lambda _: False, _shape_changes, "URDF files only"),
        fields.native_field("semantic_masked_links", "shapes: link_ids", lambda _: {}, _shape_changes, "URDF files only"),
        fields.native_field("fix_base_link", "motion", lambda c: c.motion.kind == "none",
                lambda v: {"motion": MotionCfg(kind="none" if v["fix_base_link"] else "twist")},
                "not fixed: flies with env_actions"),
        *(fields.idle_field(name, value, "PhysX") for name, value in (
            ("collision_mask", 1), ("replace_cylinder_with_capsule", False),
            ("flip_visual_attachments", False), ("density", 0.001), ("angular_damping", 0.1), ("linear_damping", 0.1),
            ("max_angular_velocity", 100.0), ("max_linear_velocity", 100.0), ("armature", 0.001),
            ("collapse_fixed_joints", True), ("place_force_sensor", False), ("force_sensor_parent_link", ""),
            ("force_sensor_transform", None), ("vhacd_enabled", False),
        )),
        fields.idle_field("disable_gravity", True, "obstacles never fall here"),
        *(fields.idle_field(name, None, "read nowhere there either") for name in (
            "min_position_ratio", "max_position_ratio", "min_euler_angles", "max_euler_angles", "specified_position",
            "specified_euler_angle",
        )),
        *(fields.idle_field(name, value, "rays and contact share a shape; its colour is its `color:`") for name, value in (
            ("use_collision_mesh_instead_of_visual", False), ("use_mesh_materials", False), ("color", None),
            ("body_semantic_label", 0), ("link_semantic_label", 0), ("specific_filepath", None), ("name", None),
        )),
    ),
)  # fmt: skip
"""Translation of the attributes of an asset class."""

_BOX = AssetCfg(
    name="asset", shapes=(ShapeCfg(kind="box", size=(0.4, 0.4, 0.4)),), count=1, position_ratio_low=(0.5, 0.5, 0.5),
    position_ratio_high=(0.5, 0.5, 0.5),
)  # fmt: skip

_THIN = AssetCfg(
    name="thin", family=FamilyCfg(name="thin_rods", variants=100), count=10, position_ratio_low=(0.3, 0.05, 0.05),
    position_ratio_high=(0.85, 0.95, 0.95), euler_low=(-3.1415927, -3.1415927, -3.1415927),
    euler_high=(3.1415927, 3.1415927, 3.1415927),
)  # fmt: skip

_made: list[tuple[AssetCfg, type]] = []


def asset_class(cfg: AssetCfg) -> type:
    """Return the configuration class of an obstacle, one and the same for equal obstacles."""
    for known, cls in _made:
        if known == cfg:
            return cls
    wall = cfg.name.endswith("_wall")
    cls = TABLE.make_class(
        cfg.name if wall else f"{cfg.name.removesuffix('s')}_asset_params", cfg, parent=BaseAssetParams
    )
    _made.append((cfg, cls))
    return cls


def translate_asset(name: str, cls: Any) -> AssetCfg | None:
    """Return the translated obstacle under its name in an environment class; None for a count of 0."""
    if not getattr(cls, "num_assets", 1):
        return None
    cfg = TABLE.translate(cls, _BOX)
    if cfg.shapes == _BOX.shapes:
        raise ConfigError(f"{cls.__name__}.asset_folder: must be given, with URDF files, where none is inherited")
    return replace(cfg, name=name)


def environment_asset(place: str) -> type:
    """Return the class of an obstacle of a registered environment, ``environment/obstacle``, else that of ``CLASSES``."""
    env, _, name = place.partition("/")
    return next((asset_class(asset) for asset in ENVIRONMENTS.get(env).assets if asset.name == name), CLASSES[name])


BaseAssetParams = TABLE.make_class("BaseAssetParams", _BOX)
MovingAssetParams = TABLE.make_class("asset_state_params", replace(_BOX, motion=MotionCfg(kind="twist")))

CLASSES: dict[str, type] = {
    asset.name: asset_class(asset)
    for asset in (
        _THIN,
        *ENVIRONMENTS.get("env_with_obstacles").assets,
        next(asset for asset in ENVIRONMENTS.get("forest_env").assets if asset.name == "trees"),
    )
}
CLASSES["tiles"] = type(
    "tile_asset_params", (BaseAssetParams,), {"asset_folder": f"{AERIAL_GYM_DIRECTORY}/{_FOLDER}/tile_meshes"}
)
"""Classes by the name of the obstacle. Meshes of tiles are missing there too: an environment that includes them is refused."""
