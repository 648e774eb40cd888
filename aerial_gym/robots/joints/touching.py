"""What of a robot that bends is pushed by the ground and by its own links."""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.assets.between_links import pairs_apart
from aerial_gym.assets.body_shapes import contact_points, core_of
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.ground import LinkShape, LinkShapes


def shapes_on_links(robot: RobotCfg, *, device: torch.device) -> tuple[Tensor, LinkShapes]:
    """Return the spheres that touch the ground, axes of their links, (C, 4) [m], and what touches what of a robot with joints.

    With ``between_links`` these are also the shapes that push each other.
    """
    joints, cfg = robot.joints, robot.collision
    assert joints is not None
    origins = [(0.0, 0.0, 0.0), *(joint.position for joint in joints.layout)]
    shapes, points = [], [torch.zeros(0, 4, device=device)]
    for shape in cfg.shapes:
        link = robot.link_names.index(shape.link)
        own = replace(shape, center=tuple(c - o for c, o in zip(shape.center, origins[link], strict=True)))
        center, attitude, half, radius = core_of(own)
        core = {"center": center, "attitude": attitude, "half": half}
        shapes.append(
            LinkShape(link=link, radius=radius, **{name: tuple(values.tolist()) for name, values in core.items()})
        )
        points.append(contact_points([own], device=device))
    spheres = torch.cat(points)
    links = tuple(shape.link for shape, rows in zip(shapes, points[1:], strict=True) for _ in rows)
    if not cfg.between_links:
        return spheres, LinkShapes(links=links)
    parents = [joints.link_of(joint.parent) for joint in joints.layout]
    pairs = pairs_apart(cfg, names=robot.link_names, parents=parents, device=torch.device("cpu"))
    return spheres, LinkShapes(links=links, shapes=tuple(shapes), pairs=tuple(pairs))
