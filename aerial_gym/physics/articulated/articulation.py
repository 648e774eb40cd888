"""Articulation of a vehicle: its tree, the laws of its joints, and the links of its rotors, from a robot file.

A vehicle is declared in its reference pose (``config.joint``); the tree has all frames along the body's axes there.
Letters: E environments, D joints, L = D + 1 links, R rotors, C joints with a drive, N creep elements of a joint.
"""

from dataclasses import dataclass, replace
from math import nan

import torch
from torch import Tensor

from aerial_gym.config.joint import DRIVE_MODES, JointCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.joint_laws import Creep, Drive, JointLaw, JointLimits, Spring, dry_friction
from aerial_gym.physics.articulated.motion import LinkPoses
from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState
from aerial_gym.physics.vehicle import Vehicle, is_shared

PLACES = 2.0**-24  # Round-off of a position in float32; an inertia with a lever of that share of the size is unknown


def check_motion_inertias(tree: Tree, links: Links, reference: Tensor, held: Tensor, names: tuple[str, ...]) -> None:
    """Raise ``ConfigError`` for a motion of the vehicle without inertia in its reference pose.

    The mass matrix is scaled by the inertia that each coordinate would move at the vehicle's full size. A motion has no inertia
    if the scaled matrix has an eigenvalue of at most N times the square of ``PLACES``.

    Args:
        links: Masses and inertias, float64, (1, L, ...).
        reference: Coordinates of the reference pose [rad] or [m], (D,).
        held: Whether the joint always has a spring or damper, which replaces inertia within a step, (D,).
    """
    state = TreeState.at_rest(1, tree.num_joints, like=reference)
    state.joint_pos.copy_(reference)
    system = equations_of_motion(tree, links, state, gravity=0.0)
    moved = links.mass[0] @ torch.tensor(tree.joint_moves_link, dtype=reference.dtype)
    turns = torch.tensor([joint.kind == "revolute" for joint in tree.joints])
    size = _square_of_size(links, system.places)
    base = links.total_mass[0] * torch.stack((torch.ones_like(size),) * 3 + (size,) * 3)
    scale = torch.cat((base, moved * torch.where(turns, size, 1.0))).rsqrt()
    weighed = system.mass[0] * torch.outer(scale, scale) + torch.nn.functional.pad(held.to(scale), (6, 0)).diag()
    first = 0 if tree.floating else 6
    sizes, motions = torch.linalg.eigh(weighed[first:, first:])
    if sizes[0] > len(sizes) * PLACES**2:
        return
    share = motions[:, 0].abs()
    of = ("base",) * (6 - first) + names
    free = sorted({of[k] for k in range(len(of)) if share[k] > 1e-3 * share.max()}, key=of.index)
    raise ConfigError(
        f"robot: {', '.join(free)} can move in the reference pose without moving any mass, and has no spring or damper. "
        "Give the link an inertia about the axis, or the joint a spring: {damping: ...}"
    )


def _square_of_size(links: Links, places: LinkPoses) -> Tensor:
    """Return a vehicle's size squared [m²]: that of its farthest point, plus the inertia of its links over the mass."""
    farthest = torch.cat((places.com, places.origin), dim=1).square().sum(-1).max()
    return farthest + links.inertia[0].diagonal(dim1=-2, dim2=-1).sum() / links.total_mass[0, 0]


UNBOUNDED = 1e9  # Limit of a joint without ends [rad], and of a drive without limit [N m]; finite in float32


@dataclass(frozen=True, kw_only=True)
class Articulation:
    """Joints and links of a vehicle; shared by all environments."""

    tree: Tree  # Frames of links are along those of the base in the reference pose
    origins: Tensor  # Origins of the links from the body origin [m], body axes, reference pose, (L, 3)
    link_mass: Tensor  # Masses of the links without the base [kg], (D,)
    link_com: Tensor  # Their centres of mass from the body origin [m], body axes, reference pose, (D, 3)
    link_inertia: Tensor  # Their inertias about these centres [kg m²], (D, 3, 3)
    rotor_links: tuple[int, ...]  # Link of each rotor, R of them
    reference: Tensor  # Coordinates in the reference pose [rad] or [m], (D,)
    spring: Spring  # Passive law of every joint, tensors (1, D)
    friction: Tensor  # Dry friction of every joint [N m], (1, D)
    rubs: bool  # Whether any joint has dry friction
    ends: JointLimits  # Soft ends of every joint, tensors (1, D)
    creep_stiffness: Tensor  # Stiffness of the creep elements, (N, D); zero for missing elements of a joint
    creep_time: Tensor  # Their time constants [s], (N, D)
    drive_gains: Tensor  # Stiffness, damping and largest effort of each drive, (C, 3)
    driven: tuple[int, ...]  # Indices of the C joints with a drive
    modes: tuple[str, ...]  # Their command modes, of `DRIVE_MODES`
    command_low: Tensor  # Lowest commands, (C,)
    command_high: Tensor  # Highest commands, (C,)
    names: tuple[str, ...]  # Names of the joints

    @property
    def num_joints(self) -> int:
        """Number D of joints."""
        return self.tree.num_joints

    @property
    def num_driven(self) -> int:
        """Number C of joints with a drive."""
        return len(self.driven)

    def link_rotors(self, link: int) -> tuple[int, ...]:
        """Return the indices of the rotors on a link."""
        return tuple(rotor for rotor, place in enumerate(self.rotor_links) if place == link)

    @property
    def solves_limits(self) -> bool:
        """Whether a step solves for drives within their limits or for dry friction."""
        return bool(self.driven) or self.rubs

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the entries of a joint command."""
        return tuple(f"{self.names[k]} {mode}" for k, mode in zip(self.driven, self.modes, strict=True))

    def to_dtype_and_device(self, like: Tensor) -> "Articulation":
        """Return the articulation with float type and device of ``like``."""

        def move_tensor(value: object) -> object:
            if isinstance(value, Tensor):
                return value.to(like)
            if isinstance(value, (Spring, JointLimits)):
                return replace(value, **{name: rows.to(like) for name, rows in vars(value).items()})
            return value

        return replace(self, **{name: move_tensor(value) for name, value in vars(self).items() if name != "tree"})

    def links(self, vehicle: Vehicle) -> Links:
        """Return the masses of links for a whole vehicle with those of ``vehicle`` in its reference pose, (E, L, ...).

        Links have their declared masses, and the base has all changes of the whole. (1, L, ...) if shared.
        """
        whole = (vehicle.mass, vehicle.com, vehicle.inertia)
        mass, com, inertia = (rows[:1] for rows in whole) if all(map(is_shared, whole)) else whole
        own, first, about = self.base(mass, com, inertia)
        num_envs = mass.shape[0]
        return Links(
            mass=torch.cat((own.unsqueeze(1), self.link_mass.expand(num_envs, -1)), dim=1),
            com=torch.cat((first.unsqueeze(1), (self.link_com - self.origins[1:]).expand(num_envs, -1, -1)), dim=1),
            inertia=torch.cat((about.unsqueeze(1), self.link_inertia.expand(num_envs, -1, -1, -1)), dim=1),
        )

    def base(self, mass: Tensor, com: Tensor, inertia: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return mass (E,), centre of mass (E, 3) and inertia about it (E, 3, 3) of the base: the whole vehicle in its
        reference pose minus the links."""
        own = mass - self.link_mass.sum()
        first = (mass.unsqueeze(-1) * com - self.link_mass @ self.link_com) / own.unsqueeze(-1)
        links = _shift_inertia(self.link_inertia, self.link_mass, self.link_com).sum(0)
        about_origin = _shift_inertia(inertia, mass, com) - links
        return own, first, _shift_inertia(about_origin, -own, first)

    @property
    def num_creep(self) -> int:
        """Largest number N of creep elements in a joint."""
        return len(self.creep_time)

    def laws(self, crept: Tensor | None) -> tuple[JointLaw, ...]:
        """Return the laws of the joints without drives, for dashpots at ``crept``, (E, N, D)."""
        result: list[JointLaw] = [self.spring, self.ends]
        if crept is not None and self.num_creep:
            result.append(Creep(stiffness=self.creep_stiffness.unsqueeze(0), crept=crept))
        return tuple(result)

    def unset_dashpots(self, num_envs: int) -> Tensor:
        """Return unset dashpots (NaN), which start at the joints' positions, (E, N, D)."""
        return self.creep_time.new_full((num_envs, *self.creep_time.shape), nan)

    def initialise_creep(self, crept: Tensor, joint_pos: Tensor) -> Tensor:
        """Return dashpots at the start of a step, (E, N, D); unset ones take the joints' positions (E, D)."""
        return torch.where(crept.isnan(), joint_pos.unsqueeze(1), crept)

    def advance_creep(self, crept: Tensor, joint_pos: Tensor, dt: float) -> Tensor:
        """Return dashpots (E, N, D) at the end of a step of ``dt`` [s] that ends with joints at (E, D)."""
        end = joint_pos.unsqueeze(1)
        return end + (crept - end) * torch.exp(-dt / self.creep_time)

    @property
    def dry_friction_law(self) -> Drive | None:
        """Dry friction; None without friction."""
        return dry_friction(self.friction) if self.rubs else None

    def drive(self, command: Tensor) -> Drive | None:
        """Return the drives under a command, (E, C); None without drives."""
        if not self.driven:
            return None
        command = torch.minimum(torch.maximum(command, self.command_low), self.command_high)
        zero = command.new_zeros(command.shape[0], self.num_joints)
        columns = {name: list(zero.unbind(1)) for name in ("position", "velocity", "effort")}
        gains = [list(zero[:1].unbind(1)) for _ in range(2)] + [list((zero[:1] + UNBOUNDED).unbind(1))]
        for place, (k, mode) in enumerate(zip(self.driven, self.modes, strict=True)):
            columns[mode][k] = command[:, place]
            for gain, value in zip(gains, self.drive_gains[place], strict=True):
                gain[k] = value.expand(1)
        stiffness, damping, limit = (torch.stack(gain, dim=1) for gain in gains)
        position, rate, effort = (torch.stack(columns[name], dim=1) for name in ("position", "velocity", "effort"))
        return Drive(stiffness=stiffness, damping=damping, position=position, rate=rate, effort=effort, limit=limit)


def _shift_inertia(inertia: Tensor, mass: Tensor, lever: Tensor) -> Tensor:
    """Return inertias about a point at ``-lever`` from the centres, by the parallel axis theorem: ``J + m (l² 1 - l l^T)``.

    A negative mass shifts them back to the centres.
    """
    square = lever.square().sum(-1)[..., None, None] * torch.eye(3, dtype=lever.dtype, device=lever.device)
    return inertia + mass[..., None, None] * (square - lever.unsqueeze(-1) * lever.unsqueeze(-2))


def build_articulation(robot: RobotCfg, *, like: Tensor) -> Articulation | None:
    """Build the articulation of a robot, with float type and device of ``like``; None for a rigid one.

    Raises:
        ConfigError: If the links exceed the whole mass, leave an impossible base, or have motions without inertia.
    """
    cfg = robot.joints
    if cfg is None:
        return None
    origins = [(0.0, 0.0, 0.0), *(joint.position for joint in cfg.layout)]
    joints = []
    for joint in cfg.layout:
        parent = cfg.link_number(joint.parent)
        joints.append(_joint(joint, parent, origins[parent]))

    def column(part: str, name: str, default: float) -> Tensor:
        values = [getattr(getattr(joint, part), name, default) for joint in cfg.layout]
        return like.new_tensor(values).unsqueeze(0)

    elements = [() if joint.spring is None else joint.spring.creep for joint in cfg.layout]
    most = max(map(len, elements))

    def creep(name: str, default: float) -> Tensor:
        rows = [[getattr(own[i], name) if i < len(own) else default for own in elements] for i in range(most)]
        return like.new_tensor(rows).reshape(most, len(elements))

    drives = [joint.drive for joint in cfg.layout if joint.drive is not None]
    zero_inertia = ((0.0, 0.0, 0.0),) * 3
    links = [joint.link for joint in cfg.layout]
    result = Articulation(
        tree=Tree(joints=tuple(joints), floating=cfg.floating),
        origins=like.new_tensor(origins),
        link_mass=like.new_tensor([0.0 if link is None else link.mass for link in links]),
        link_com=like.new_tensor([j.position if j.link is None else j.link.com for j in cfg.layout]),
        link_inertia=like.new_tensor([zero_inertia if link is None else link.inertia for link in links]),
        rotor_links=tuple(cfg.link_number(mount.link) for mount in robot.mounts.layout),
        reference=like.new_tensor([joint.reference for joint in cfg.layout]),
        spring=Spring(
            **{n: column("spring", n, 0.0) for n in ("stiffness", "quadratic", "damping", "rest", "preload")}
        ),
        friction=column("spring", "friction", 0.0),
        rubs=any(joint.spring is not None and joint.spring.friction > 0.0 for joint in cfg.layout),
        ends=JointLimits(
            low=column("ends", "low", -UNBOUNDED),
            high=column("ends", "high", UNBOUNDED),
            stiffness=column("ends", "stiffness", 0.0),
            damping=column("ends", "damping", 0.0),
        ),
        creep_stiffness=creep("stiffness", 0.0),
        creep_time=creep("time", 1.0),
        drive_gains=like.new_tensor([[d.stiffness, d.damping, d.limit] for d in drives]).reshape(-1, 3),
        driven=cfg.drive_joints,
        modes=tuple(drive.mode for drive in drives),
        command_low=like.new_tensor([drive.command_range[0] for drive in drives]),
        command_high=like.new_tensor([drive.command_range[1] for drive in drives]),
        names=cfg.names,
    )
    assert set(result.modes) <= set(DRIVE_MODES)
    _check_bodies(robot, result)
    return result


def _joint(cfg: JointCfg, parent: int, parent_origin: tuple[float, float, float]) -> Joint:
    """Return a joint whose link has the declared pose at the coordinate ``reference``."""
    offset = tuple(p - q for p, q in zip(cfg.position, parent_origin, strict=True))
    attitude = (0.0, 0.0, 0.0, 1.0)
    axis = torch.tensor(cfg.axis, dtype=torch.float64)
    if cfg.kind == "revolute":
        back = quat_exp((-cfg.reference * axis).unsqueeze(0))[0]
        attitude = tuple(back.tolist())
    else:
        offset = tuple(p - cfg.reference * a for p, a in zip(offset, cfg.axis, strict=True))
    return Joint(parent=parent, kind=cfg.kind, axis=cfg.axis, position=offset, attitude=attitude)  # type: ignore[arg-type]


def _check_bodies(robot: RobotCfg, articulation: Articulation) -> None:
    """Raise ``ConfigError`` if the remaining base is no possible body, or a motion has no inertia."""
    exact = articulation.to_dtype_and_device(torch.zeros(1, dtype=torch.float64))

    def as_row(values: object) -> Tensor:
        return torch.tensor(values, dtype=torch.float64).unsqueeze(0)

    carried = float(exact.link_mass.sum())
    if carried >= robot.body.mass:
        raise ConfigError(
            f"robot: its links weigh {carried:.6g} kg, the whole {robot.body.mass:.6g} kg. body.mass is that of the whole "
            "vehicle: the base must weigh something"
        )
    whole = _Whole(mass=as_row(robot.body.mass), com=as_row(robot.body.com), inertia=as_row(robot.body.inertia))
    links = exact.links(whole)  # type: ignore[arg-type]
    left = links.inertia[0, 0]
    moments = torch.linalg.eigvalsh(left)
    if moments[0] < 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6):
        raise ConfigError(
            f"robot: body.inertia without the links leaves a base with principal moments {moments.tolist()} kg m², which "
            "no body has. body.inertia is that of the whole vehicle in its reference pose, about its centre of mass"
        )
    held = (exact.spring.stiffness + exact.spring.damping)[0] + exact.creep_stiffness.sum(0) > 0.0
    check_motion_inertias(exact.tree, links, exact.reference, held, exact.names)


@dataclass(frozen=True, kw_only=True)
class _Whole:
    """Mass properties of a whole vehicle, from which those of its base follow."""

    mass: Tensor
    com: Tensor
    inertia: Tensor
