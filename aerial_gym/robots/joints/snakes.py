"""Flying snakes: rods of one metre, each with a rotor in its middle, that hang together by universal joints.

The reference pose is a regular polygon, in which rotors around the middle hold the vehicle level; the base is the first rod.
Letters: N rods.
"""

from math import cos, pi, sin
from typing import Literal

from aerial_gym.config.checks import Vec3
from aerial_gym.config.joint import BASE, DriveCfg, EndsCfg, JointCfg, JointsCfg, LinkCfg
from aerial_gym.config.robot import BodyCfg, CapsuleCfg, CollisionCfg, InitialStateCfg, MountCfg, MountsCfg, RobotCfg
from aerial_gym.config.rotor import RotorCfg

LENGTH, RADIUS = 1.0, 0.02
"""Of a rod [m]."""

MASS = 0.30625
"""Of a rod of 0.3 kg with its rotor [kg]."""

YAW, ROLL = 2.356, 0.5
"""Where joints end, either way [rad]."""

DriveMode = Literal["position", "velocity", "effort"]

SOURCE = "Aerial Gym Simulator 2.0.1, snakey, snakey5 and snakey6"


def snake(num_rods: int, mode: DriveMode = "velocity", *, between_links: bool = False) -> RobotCfg:
    """Return a snake of N rods whose 2 (N - 1) joints follow commands of a mode; its rods may collide with each other."""
    corner = 2.0 * pi / num_rods
    headings = [k * corner for k in range(num_rods)]
    middles = _middles(headings)
    rods = [_rod(middle, heading) for middle, heading in zip(middles, headings, strict=True)]
    return RobotCfg(
        summary=f"{num_rods} rods of 1 m with a rotor each and universal joints between, driven by {mode}",
        body=_whole(rods),
        rotor=RotorCfg(
            mode="force",
            torque_ratio=0.01,
            time_constant_up=0.005,
            time_constant_down=0.005,
            thrust_range=(0.0, 15.0),
            source=f"{SOURCE}: thrust as state, lag 0.005 s, 0 to 15 N; torque ratio as that of its other vehicles, 0.01 m",
        ),
        mounts=MountsCfg(
            layout=tuple(
                MountCfg(position=middle, spin=1 if k % 2 == 0 else -1, link=BASE if k == 0 else f"roll_{k}")
                for k, middle in enumerate(middles)
            ),
            source=f"{SOURCE}: one rotor in the middle of a rod. Turning directions, chosen: in turns",
        ),
        joints=JointsCfg(
            layout=tuple(
                joint
                for k, heading in enumerate(headings)
                if k > 0
                for joint in _universal(k, middles[k], heading, corner, rods[k], mode)
            ),
            source=(
                f"{SOURCE}: yaw to 2.356, roll to 0.5 rad; damping 10 N m s/rad, in position mode stiffness 50 N m/rad; "
                "efforts of 1.5 N m in yaw and 0.3 N m in roll. Chosen: ends ten times as stiff as the drive, rods 20 mm thick"
            ),
        ),
        collision=CollisionCfg(
            capsules=tuple(
                CapsuleCfg(
                    radius=RADIUS,
                    height=LENGTH - 2.0 * RADIUS,
                    center=middle,
                    euler=(0.0, 0.5 * pi, heading),
                    link=BASE if k == 0 else f"roll_{k}",
                )
                for k, (middle, heading) in enumerate(zip(middles, headings, strict=True))
            ),
            between_links=between_links,
            source="Chosen: rods 20 mm thick",
        ),
        initial_state=InitialStateCfg(
            position_ratio_low=(0.5, 0.5, 0.5),
            position_ratio_high=(0.5, 0.5, 0.5),
            euler_low=(0.0, 0.0, 0.0),
            euler_high=(0.0, 0.0, 0.0),
            lin_vel_low=(0.0, 0.0, 0.0),
            lin_vel_high=(0.0, 0.0, 0.0),
            ang_vel_low=(0.0, 0.0, 0.0),
            ang_vel_high=(0.0, 0.0, 0.0),
        ),
    )


def _middles(headings: list[float]) -> list[Vec3]:
    """Return where the middles of rods are that follow each other with headings [rad]; the first one's is the origin."""
    x, y, found = -0.5 * LENGTH, 0.0, []
    for heading in headings:
        along = (cos(heading), sin(heading))
        found.append((x + 0.5 * LENGTH * along[0], y + 0.5 * LENGTH * along[1], 0.0))
        x, y = x + LENGTH * along[0], y + LENGTH * along[1]
    return found


def _rod(middle: Vec3, heading: float) -> LinkCfg:
    """Return a rod, of even density, with its rotor."""
    along, across = 0.5 * MASS * RADIUS**2, MASS * (LENGTH**2 / 12.0 + RADIUS**2 / 4.0)
    c, s = cos(heading), sin(heading)
    xx, yy, xy = along * c * c + across * s * s, along * s * s + across * c * c, (along - across) * c * s
    return LinkCfg(mass=MASS, com=middle, inertia=((xx, xy, 0.0), (xy, yy, 0.0), (0.0, 0.0, across)))


def _whole(rods: list[LinkCfg]) -> BodyCfg:
    """Return mass and inertia of all rods about their common centre."""
    import numpy as np

    centre = np.mean([rod.com for rod in rods], axis=0)
    total = np.zeros((3, 3))
    for rod in rods:
        lever = np.asarray(rod.com) - centre
        total += np.asarray(rod.inertia) + rod.mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    rows = [(float(a), float(b), float(c)) for a, b, c in total]
    return BodyCfg(
        mass=MASS * len(rods),
        com=(float(centre[0]), float(centre[1]), float(centre[2])),
        inertia=(rows[0], rows[1], rows[2]),
        source=f"{SOURCE}: rods of 0.3 kg and rotors of 6.25 g; parallel axes",
    )


def _universal(
    k: int, middle: Vec3, heading: float, corner: float, rod: LinkCfg, mode: DriveMode
) -> tuple[JointCfg, JointCfg]:
    """Return yaw and roll between rod k - 1 and rod k."""
    along = (cos(heading), sin(heading), 0.0)
    joint = (middle[0] - 0.5 * LENGTH * along[0], middle[1] - 0.5 * LENGTH * along[1], 0.0)
    parent = BASE if k == 1 else f"roll_{k - 1}"
    return (
        JointCfg(
            name=f"yaw_{k}",
            parent=parent,
            axis=(0.0, 0.0, 1.0),
            position=joint,
            reference=corner,
            drive=_drive(mode, 1.5, YAW),
            ends=_ends(YAW),
        ),
        JointCfg(
            name=f"roll_{k}",
            parent=f"yaw_{k}",
            axis=along,
            position=joint,
            link=rod,
            drive=_drive(mode, 0.3, ROLL),
            ends=_ends(ROLL),
        ),
    )


def _drive(mode: DriveMode, limit: float, end: float) -> DriveCfg:
    largest = {"position": end, "velocity": 1.5, "effort": limit}[mode]
    return DriveCfg(
        mode=mode,
        stiffness=50.0 if mode == "position" else 0.0,
        damping=0.0 if mode == "effort" else 10.0,
        limit=limit,
        command_range=(-largest, largest),
    )


def _ends(end: float) -> EndsCfg:
    return EndsCfg(low=-end, high=end, stiffness=500.0, damping=10.0)
