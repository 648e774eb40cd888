"""Visible shapes of a vehicle whose file has none: arms, links and rotor discs, from hubs and joints.

Frames: body is x forward, y left, z up; shapes on a link are where they are in the reference pose.
"""

from math import atan2, dist, hypot

from aerial_gym.config.checks import Vec3
from aerial_gym.config.joint import BASE
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import PartCfg, ShapeCfg

FRONT, REAR, FRAME = (0.75, 0.2, 0.15), (0.2, 0.25, 0.3), (0.15, 0.15, 0.15)  # Colours of rotors and arms
SMALLEST = 0.01  # Radius of a rotor disc that is always visible [m]


def rotor_radii(robot: RobotCfg) -> list[float]:
    """Return the radius of every rotor [m]; where the file has none, 0.45 of the distance to the nearest hub."""
    hubs = [mount.position for mount in robot.mounts.layout]
    radii = []
    for hub, rotor in zip(hubs, robot.rotor_types, strict=True):
        near = min((dist(hub, other) for other in hubs if other != hub), default=2.0 * hypot(*hub))
        radii.append(max(rotor.radius or 0.45 * near, SMALLEST))
    return radii


def arm_parts(robot: RobotCfg) -> tuple[PartCfg, ...]:
    """Return a bar from the hinge of each link to the hubs and hinges that it carries; the base's begin at the origin."""
    joints = () if robot.joints is None else robot.joints.layout
    starts: dict[str, Vec3] = {BASE: (0.0, 0.0, 0.0), **{joint.name: joint.position for joint in joints}}
    ends = [(joint.parent, joint.position) for joint in joints]
    ends += [(mount.link, mount.position) for mount in robot.mounts.layout]
    bars = ((link, starts[link], end) for link, end in ends if dist(starts[link], end) > 0.0)
    return tuple(_bar(link, start, end) for link, start, end in bars)


def _bar(link: str, start: Vec3, end: Vec3) -> PartCfg:
    (x, y, z), length = (b - a for a, b in zip(start, end, strict=True)), dist(start, end)
    bar = ShapeCfg(kind="box", size=(length, 0.1 * length, 0.1 * length), color=FRAME)
    middle = (start[0] + x / 2, start[1] + y / 2, start[2] + z / 2)
    return PartCfg(shape=bar, position=middle, euler=(0.0, -atan2(z, hypot(x, y)), atan2(y, x)), link=link)


def rotor_parts(robot: RobotCfg) -> tuple[PartCfg, ...]:
    """Return a flat disc for every rotor, the front ones in red, each slightly above its hub along its axis."""
    parts = []
    for mount, radius in zip(robot.mounts.layout, rotor_radii(robot), strict=True):
        (x, y, z), (ax, ay, az) = mount.position, mount.axis
        length, rise = hypot(x, y, z), 0.1 * hypot(x, y, z) / hypot(ax, ay, az)
        color = FRONT if x > 0.1 * length else REAR
        disc = ShapeCfg(kind="cylinder", radius=radius, height=0.06 * radius, color=color)
        place = (x + rise * ax, y + rise * ay, z + rise * az)
        turn = (0.0, atan2(hypot(ax, ay), az), atan2(ay, ax))
        parts.append(PartCfg(shape=disc, position=place, euler=turn, link=mount.link))
    return tuple(parts)
