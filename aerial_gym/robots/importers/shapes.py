"""Collision shapes of the files of other simulators."""

from collections.abc import Sequence

from aerial_gym.assets import load_mesh
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionCfg, CollisionShape, PartCfg, SphereCfg
from aerial_gym.robots.importers.file_vehicle import vec3


def part_shape(part: PartCfg) -> CollisionShape:
    """Return spheres, capsules and boxes unchanged, and the bounding box of a cylinder or mesh."""
    shape = part.shape
    if shape.kind == "sphere":
        return SphereCfg(center=part.position, radius=shape.radius or 0.0)
    if shape.kind == "capsule":
        return CapsuleCfg(
            center=part.position, euler=part.euler, radius=shape.radius or 0.0, height=shape.height or 0.0
        )
    if shape.kind == "box" and shape.size is not None:
        return BoxCfg(center=part.position, size=shape.size, euler=part.euler)
    if shape.kind == "cylinder":
        across = 2.0 * (shape.radius or 0.0)
        return BoxCfg(center=part.position, size=(across, across, shape.height or 0.0), euler=part.euler)
    return _box_around_mesh(part)


def _box_around_mesh(part: PartCfg) -> BoxCfg:
    from trimesh.transformations import euler_matrix

    low, high = load_mesh(part.shape.path or "", scale=part.shape.scale, up=part.shape.up).bounds
    center = euler_matrix(*part.euler, axes="sxyz")[:3, :3] @ (0.5 * (low + high)) + part.position
    return BoxCfg(center=vec3(center), size=vec3(high - low), euler=part.euler)


def make_collision(shapes: Sequence[CollisionShape], name: str) -> CollisionCfg:
    """Return the collision configuration of shapes; ``name`` is the file, for errors."""
    return CollisionCfg(
        spheres=tuple(shape for shape in shapes if isinstance(shape, SphereCfg)),
        boxes=tuple(shape for shape in shapes if isinstance(shape, BoxCfg)),
        capsules=tuple(shape for shape in shapes if isinstance(shape, CapsuleCfg)),
        source=f"{name}; boxes around cylinders and around the bounds of meshes",
    )
