"""Import of a robot file of another simulator, refused with a reason unless the robot hovers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.joint import JointsCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import BodyCfg, MountCfg, MountsCfg, RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.robots.check import check_robot
from aerial_gym.robots.importers import file_vehicle, mjcf, sdf, urdf

ROTOR_LINKS = r"(?!.*arm).*(motor|rotor|prop).*"  # Names of links of a URDF without motors that are taken for rotors

_JOINTS_HINT = ", or let its joints move with --joints"

_WAY_OUT = "Give a robot that has some: --rotors-of ROBOT, rotors_of of RotorHints"


@dataclass(frozen=True, kw_only=True)
class RotorHints:
    """Rotor data that the file lacks, given by the user."""

    rotors_of: RobotCfg | None = None  # Robot with these rotors; its mounts are taken where the file has none
    spins: tuple[int, ...] = ()  # +1 or -1 for each rotor in the order of the file, in place of its own values
    lag: float | None = None  # Of thrusts that follow at once in the file [s], and of rotors of a URDF's `properties`
    rotor_links: str = ROTOR_LINKS  # Regular expression of links of a URDF without motors that are rotors
    joints: bool = False  # Whether joints move (URDF and MJCF) but those of rotors; else all are welded
    accept_losses: bool = False  # Whether to import a vehicle without its wings or the joints that tilt its rotors


@dataclass(frozen=True)
class Imported:
    """An imported robot, with the unused elements of its file and the assumptions."""

    robot: RobotCfg
    notes: tuple[str, ...]  # Unused elements, a line each, without duplicates
    assumed: tuple[str, ...] = ()  # Changed or missing data, likewise

    def lines(self) -> Iterator[str]:
        """Yield one line per unused element and per assumption."""
        yield from (f"left out: {' '.join(note.split())}" for note in self.notes)
        yield from (f"assumed: {' '.join(note.split())}" for note in self.assumed)

    def as_file(self, name: str) -> str:
        """Return the text of the robot file; its first lines list the unused elements of the file ``name``."""
        lines = [f"Imported from {name} by aerial-gym robot import.", *self.lines()]
        return "".join(f"# {line}\n" for line in lines) + dump_yaml(self.robot)


def import_robot(path: str | Path, hints: RotorHints | None = None, *, gravity: float = STANDARD_GRAVITY) -> Imported:
    """Return the robot in a URDF, MJCF or SDF file, which hovers and can be steered.

    Joints are welded at zero unless the hints say otherwise. The frame of the root link becomes that of the body.
    """
    imported = read_robot(path, hints, gravity=gravity)
    where = Path(path).name
    problems = check_robot(imported.robot, name=where, controllers=(), gravity=gravity).problems
    if problems:
        mass = imported.robot.body.mass
        raise ConfigError(f"{where}: the vehicle, of {mass:.4g} kg, cannot be flown: {'; '.join(problems)}")
    return imported


def read_robot(path: str | Path, hints: RotorHints | None = None, *, gravity: float = STANDARD_GRAVITY) -> Imported:
    """Return the robot in a file as ``import_robot`` does, whether it can be flown or not."""
    path, hints = Path(path), hints or RotorHints()
    with np.errstate(all="ignore"):  # numbers beyond all bounds are refused by the checks of the robot file
        kind, vehicle = _read_file(path, hints)
    where = f"{kind} {path.name}"
    if vehicle.losses and not hints.accept_losses:
        move = _JOINTS_HINT if kind != "SDF" and not hints.joints else ""
        raise ConfigError(
            f"{where}: as a multirotor it would lose {'; '.join(vehicle.losses)}. Import it without with --accept-losses "
            f"(accept_losses of RotorHints){move}"
        )
    inertia = vehicle.body.inertia
    weight = file_vehicle.buoyant_forces(vehicle, gravity)
    effects = {**vehicle.effects, **weight.effects}
    robot = RobotCfg(
        summary=f"robot of {path.name}",
        body=BodyCfg(
            mass=vehicle.body.mass,
            inertia=(
                file_vehicle.round_vec3(inertia[0]),
                file_vehicle.round_vec3(inertia[1]),
                file_vehicle.round_vec3(inertia[2]),
            ),
            com=file_vehicle.round_vec3(vehicle.body.com),
            source=f"{where}: all links, joints welded at zero, by the parallel axis theorem",
        ),
        collision=file_vehicle.make_collision(vehicle.shapes, where),
        joints=JointsCfg(layout=vehicle.joints, source=f"{where}: its joints but those of rotors; {file_vehicle.ENDS}")
        if vehicle.joints
        else None,
        control=ControlCfg(buoyancy=weight.force, source=weight.source) if weight.force else ControlCfg(),
        effects=effects,
        effects_source="; ".join(filter(None, (vehicle.effects_source, weight.source))),
        **_rotor_fields(vehicle.rotors, hints, where),
    )
    return Imported(
        robot, tuple(dict.fromkeys((*vehicle.losses, *vehicle.notes))), assumed=tuple(dict.fromkeys(vehicle.assumed))
    )


def _read_file(path: Path, hints: RotorHints) -> tuple[str, file_vehicle.FileVehicle]:
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    root = file_vehicle.read_xml(path)
    if path.suffix == ".xacro" or "xacro" in "".join(child.tag for child in root):
        raise ConfigError(f"{path}: is a xacro. Expand it first: xacro {path.name} > robot.urdf")
    if root.tag == "robot":
        return "URDF", urdf.read_urdf_vehicle(
            path, hints.rotor_links, hints.lag, take_properties=hints.rotors_of is None, joints=hints.joints
        )
    if root.tag == "mujoco":
        return "MJCF", mjcf.read_mjcf(path, hints.lag, take_actuators=hints.rotors_of is None, joints=hints.joints)
    if root.tag == "sdf" and hints.joints:
        raise ConfigError(f"{path}: joints of SDF files are welded. Leave out --joints, or give a URDF or MJCF file")
    if root.tag == "sdf":
        return "SDF", sdf.read_sdf(path)
    raise ConfigError(f"{path}: its first tag is <{root.tag}>: must be <robot> (URDF), <mujoco> (MJCF) or <sdf> (SDF)")


def _rotor_fields(vehicle: Sequence[file_vehicle.FileRotor], hints: RotorHints, where: str) -> dict[str, Any]:
    """Return the fields of ``RobotCfg`` that hold rotors."""
    other = hints.rotors_of
    if not vehicle:
        if other is None:
            raise ConfigError(f"{where}: there are no rotors in it. {_WAY_OUT}")
        return {"rotor": other.rotor, "rotors": other.rotors, "mounts": other.mounts}
    names = ", ".join(rotor.name for rotor in vehicle)
    if hints.spins and len(hints.spins) != len(vehicle):
        raise ConfigError(f"{where}: {len(hints.spins)} spins for {len(vehicle)} rotors: {names}")
    spins = hints.spins or [rotor.spin for rotor in vehicle]
    if None in spins:
        raise ConfigError(f"{where}: does not say how its rotors turn. Give --spins, 1 or -1 for each of: {names}")
    like = None if other is None else other.the_rotor("rotors_of")
    kinds = [rotor.rotor or like for rotor in vehicle]
    if None in kinds:
        raise ConfigError(f"{where}: its rotors have no thrust, torque and lag: {names}. {_WAY_OUT}")
    types = list(dict.fromkeys(kinds))
    several = {f"type_{number}": kind for number, kind in enumerate(types, 1)} if len(types) > 1 else {}
    layout = tuple(
        MountCfg(
            position=file_vehicle.round_vec3(rotor.position),
            axis=file_vehicle.round_vec3(rotor.axis),
            spin=int(spin or 0),
            rotor=f"type_{types.index(kind) + 1}" if several else None,
            link=rotor.link,
        )
        for rotor, spin, kind in zip(vehicle, spins, kinds, strict=True)
    )
    mounts = MountsCfg(layout=layout, source=f"{where}: {names}")
    return {"rotor": None if several else types[0], "rotors": several, "mounts": mounts}
