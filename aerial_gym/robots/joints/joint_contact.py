"""Contact shapes of a robot with joints, for ground, obstacles and its own links."""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.cores import contact_points, shape_core
from aerial_gym.assets.mesh_files import is_convex, load_mesh
from aerial_gym.assets.self_collision import select_link_pairs
from aerial_gym.assets.shapes import half_size
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import PartCfg
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics.ground import LinkContacts, LinkShape, Solid, Solids


def shapes_on_links(
    robot: RobotCfg, *, device: torch.device, scene: Scene | None = None, moves: bool = False
) -> tuple[Tensor, LinkContacts]:
    """Return the ground contact spheres in link axes, (C, 4) [m], and the contact shapes of a robot with joints.

    With ``between_links`` or obstacles these are also the shapes that push each other, or that obstacles push.
    """
    joints, cfg = robot.joints, robot.collision
    assert joints is not None
    origins = [(0.0, 0.0, 0.0), *(joint.position for joint in joints.layout)]
    shapes, points = [], [torch.zeros(0, 4, device=device)]
    for shape in cfg.shapes:
        link = robot.link_names.index(shape.link)
        own = replace(shape, center=tuple(c - o for c, o in zip(shape.center, origins[link], strict=True)))
        center, attitude, half, radius = shape_core(own)
        core = {"center": center, "attitude": attitude, "half": half}
        shapes.append(LinkShape(link=link, radius=radius, **{name: tuple(x.tolist()) for name, x in core.items()}))
        points.append(contact_points([own], device=device))
    spheres = torch.cat(points)
    links = tuple(shape.link for shape, rows in zip(shapes, points[1:], strict=True) for _ in rows)
    solids = None if scene is None or not scene.num_instances else _scene_solids(scene, moves=moves)
    pairs: list[tuple[int, int]] = []
    if cfg.between_links:
        parents = [joints.link_number(joint.parent) for joint in joints.layout]
        pairs = select_link_pairs(cfg, names=robot.link_names, parents=parents, device=torch.device("cpu"))
    elif solids is None:
        shapes = []
    return spheres, LinkContacts(links=links, shapes=tuple(shapes), pairs=tuple(pairs), solids=solids)


def _scene_solids(scene: Scene, *, moves: bool) -> Solids:
    """Return the instances of a scene, which is read again at every step."""
    parts, part, carrier = scene.instance_parts()
    table = tuple(map(_part_solid, parts))
    return Solids(table=table, part=part, carrier=carrier, state=scene.asset_state, moves=moves)


def _part_solid(part: PartCfg) -> Solid:
    shape, turn = part.shape, quat_from_euler(torch.tensor(part.euler, dtype=torch.float64))
    place = {"position": part.position, "attitude": tuple(turn.tolist())}
    if shape.kind != "mesh" or shape.path is None:
        return Solid(kind=shape.kind, size=half_size(shape), **place)
    mesh = load_mesh(shape.path, scale=shape.scale, up=shape.up)
    vertices = tuple(map(tuple, mesh.vertices.tolist()))
    return Solid(kind=shape.kind, path=shape.path, vertices=vertices, convex=is_convex(mesh), **place)
