"""MJCF files, read by MuJoCo itself: bodies as one, rotors from actuators that push at a site.

MuJoCo does compiler settings, defaults and frames. Every joint is welded unless asked otherwise; a welded one that moves the
thrust line of a rotor is a loss. Gravity compensation becomes an upward force.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aerial_gym.assets.urdf import RigidBody, weld
from aerial_gym.config.joint import JointCfg
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionShape, SphereCfg
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError
from aerial_gym.extras import optional_import
from aerial_gym.robots.importers.file_vehicle import (
    FileJoint,
    FileRotor,
    FileVehicle,
    LinkMass,
    WeightlessMass,
    euler_of_matrix,
    group_lines_by_kind,
    joint_configs,
    moves_thrust_line,
    round_vec3,
)
from aerial_gym.robots.importers.mjcf_actuators import Actuator


def read_mjcf(path: Path, lag: float | None, *, take_actuators: bool, joints: bool = False) -> FileVehicle:
    """Return the vehicle of an MJCF file; ``lag`` [s] is for actuators without one, ``joints`` lets hinges and slides move."""
    mujoco, model, where = _load_model(path)
    free = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        raise ConfigError(f"{where}: has {len(free)} bodies with a free joint: a vehicle is the one of a file")
    reader = _MjcfReader(mujoco, model, free[0], where)
    if joints:
        reader.find_joints()
    actuators = [Actuator(mujoco, model, i, where) for i in range(model.nu)]
    own = [one for one in actuators if one.is_enabled and one.can_push_vehicle and reader.acts_on_vehicle(one)]
    pushing = own if take_actuators else []
    for one in pushing:
        one.check()
    carried = [] if joints else [one for one in own if one.has_force]
    lines = [(one.thrust_line(reader.site_frame(one.site)), model.site_bodyid[one.site]) for one in carried]
    tilting = reader.rotors_by_tilting_joint(lines)
    rotors = [
        one.rotor(reader.site_frame(one.site), lag, reader.carrier_joint(model.site_bodyid[one.site]))
        for one in pushing
    ]
    delays = sorted({one.delay for one in pushing})
    delayed = len(delays) == 1 and delays[0] > 0.0
    left = [one.name for one in actuators if one not in pushing]
    label = "actuators" + (" (write drives of joints by hand, docs/guides/articulated_vehicles.md)" if joints else "")
    return FileVehicle(
        body=reader.body(),
        rotors=rotors,
        shapes=list(reader.shapes()),
        joints=reader.layout(),
        weightless=list(reader.gravity_free_masses()),
        effects={"actuation_delay": {"delay": delays[0]}} if delayed else {},
        effects_source=f"{where}: delay of its actuators" if delayed else "",
        notes=(
            *group_lines_by_kind((note, one.name) for one in pushing for note in one.lines_on_unused()),
            *([f"delays of actuators, which differ: {delays} s"] if len(delays) > 1 else []),
            *([f"{label}: {', '.join(left)}"] if left else []),
            *reader.lines_on_unused(
                [one.site for one in pushing], [] if joints else [j for j in reader.joints() if j not in tilting]
            ),
        ),
        assumed=tuple(group_lines_by_kind((label, one.name) for one in pushing for label in one.assumptions())),
        losses=tuple(reader.parts_lost(tilting)),
    )


def _load_model(path: Path) -> tuple[Any, Any, str]:
    """Return MuJoCo, the model in a file, and the name of the file in messages."""
    with optional_import(f"MJCF {path}"):
        import mujoco
    where = f"MJCF {path.name}"
    try:
        return mujoco, mujoco.MjModel.from_xml_path(str(path)), where
    except ValueError as error:
        raise ConfigError(f"{where}: cannot be read ({' '.join(str(error).split())})") from None


class _MjcfReader:
    """One vehicle of a model."""

    def __init__(self, mujoco: Any, model: Any, root: int, where: str) -> None:
        self._mujoco, self._model, self._root, self._where = mujoco, model, root, where
        self._data = data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self._bodies = [b for b in range(model.nbody) if self.is_part(b)]
        self._armature = float(model.dof_armature[int(model.body_dofadr[root])])
        self._from_world = np.linalg.inv(_homogeneous_pose(data.xpos[root], data.xmat[root]))
        self._joints: list[FileJoint] = []
        self._on: dict[int, str] = {}

    def body(self) -> RigidBody:
        """Return all bodies as one; the armature of the free joint is a point at the origin that resists turning as well."""
        m, extra = self._model, self._armature
        return weld(
            [*(float(m.body_mass[b]) for b in self._bodies), extra],
            [*(self._com_frame(b) for b in self._bodies), np.eye(4)],
            [*(np.diag(m.body_inertia[b]) for b in self._bodies), extra * np.eye(3)],
        )

    def gravity_free_masses(self) -> Iterator[WeightlessMass]:
        """Yield masses without weight: bodies with gravity compensation, and the armature."""
        for b in self._bodies:
            mass = float(self._model.body_gravcomp[b] * self._model.body_mass[b])
            if mass:
                yield WeightlessMass(mass=mass, position=self._com_frame(b)[:3, 3], link=self.carrier_joint(b))
        if self._armature:
            yield WeightlessMass(mass=self._armature, position=np.zeros(3))

    def _com_frame(self, body: int) -> np.ndarray:
        """Return the frame of a body's centre of mass in that of the vehicle, (4, 4)."""
        return self.frame_in_vehicle(self._data.xipos[body], self._data.ximat[body])

    def find_joints(self) -> None:
        """Find hinges and slides, and the joint that moves each body: of several on one body the last."""
        m, kinds = self._model, self._mujoco.mjtJoint
        for body in self._bodies:  # parents come first
            at = self._on.get(int(m.body_parentid[body]), BASE)
            own = self._joints_of_body(body)
            pose = self._com_frame(body)
            weight = LinkMass(mass=float(m.body_mass[body]), pose=pose, inertia=np.diag(m.body_inertia[body]))
            for j in own:
                if int(m.jnt_type[j]) not in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)):
                    raise ConfigError(f"{self._where}: joint {m.joint(j).name!r} is a ball: give three hinges")
                last = j == own[-1]
                self._joints.append(self._file_joint(j, at, (weight,) if last else ()))
                at = self._joints[-1].name
            self._on[body] = at
            if not own and at != BASE:
                place = next(i for i, joint in enumerate(self._joints) if joint.name == at)
                self._joints[place] = replace(self._joints[place], weights=(*self._joints[place].weights, weight))

    def _file_joint(self, j: int, parent: str, weights: tuple[LinkMass, ...]) -> FileJoint:
        m, slides = self._model, int(self._model.jnt_type[j]) == int(self._mujoco.mjtJoint.mjJNT_SLIDE)
        place, dof = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
        turn = self._from_world[:3, :3]
        return FileJoint(
            name=m.joint(j).name or f"joint_{j}", parent=parent, kind="prismatic" if slides else "revolute",
            axis=turn @ self._data.xaxis[j], position=turn @ self._data.xanchor[j] + self._from_world[:3, 3],
            reference=float(m.qpos0[place]),
            limits=(float(m.jnt_range[j][0]), float(m.jnt_range[j][1])) if m.jnt_limited[j] else None,
            stiffness=float(np.ravel(m.jnt_stiffness[j])[0]), rest=float(m.qpos_spring[place]),
            damping=float(np.ravel(m.dof_damping[dof])[0]), friction=float(m.dof_frictionloss[dof]), weights=weights,
        )  # fmt: skip

    def layout(self) -> tuple[JointCfg, ...]:
        """Return the joints as a robot file has them."""
        return joint_configs(self._joints)

    def carrier_joint(self, body: int) -> str:
        """Return the joint that moves a body, or the base."""
        return self._on.get(int(body), BASE)

    def is_part(self, body: int) -> bool:
        """Return whether a body belongs to the vehicle."""
        return int(self._model.body_rootid[body]) == int(self._model.body_rootid[self._root])

    def frame_in_vehicle(self, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return a world frame relative to the vehicle frame, (4, 4)."""
        return self._from_world @ _homogeneous_pose(place, turn)

    def site_frame(self, site: int) -> np.ndarray:
        """Return the frame of a site relative to the vehicle frame, (4, 4)."""
        return self.frame_in_vehicle(self._data.site_xpos[site], self._data.site_xmat[site])

    def _joints_of_body(self, body: int) -> list[int]:
        first = int(self._model.body_jntadr[body])
        return [] if body == self._root else list(range(first, first + int(self._model.body_jntnum[body])))

    def rotors_by_tilting_joint(self, lines: Sequence[tuple[FileRotor, int]]) -> dict[int, list[str]]:
        """Return the joints that move thrust lines, with their rotors and the bodies that carry them."""
        hinge, rotors_by_joint = int(self._mujoco.mjtJoint.mjJNT_HINGE), {}
        turn, place = self._from_world[:3, :3], self._from_world[:3, 3]
        for rotor, start in lines:
            body = int(start)
            while body != self._root and body > 0:
                for j in self._joints_of_body(body):
                    kind = "hinge" if int(self._model.jnt_type[j]) == hinge else "other"
                    if moves_thrust_line(rotor, kind, turn @ self._data.xaxis[j], turn @ self._data.xanchor[j] + place):
                        rotors_by_joint.setdefault(j, []).append(rotor.name)
                body = int(self._model.body_parentid[body])
        return rotors_by_joint

    def parts_lost(self, tilting: dict[int, list[str]]) -> Iterator[str]:
        """Yield wings, and welded joints that move rotors."""
        m = self._model
        for j, names in tilting.items():
            yield f"joint {m.joint(j).name or f'joint_{j}'}, which moves {', '.join(names)}, is welded"
        winged = [g for g in self._vehicle_geoms() if m.geom_fluid[g][0] > 0.0]
        if m.opt.density and winged:
            yield f"lift of {', '.join(m.geom(g).name or f'geom_{g}' for g in winged)} (fluidshape)"

    def _vehicle_geoms(self) -> list[int]:
        return [g for g in range(self._model.ngeom) if self.is_part(int(self._model.geom_bodyid[g]))]

    def shapes(self) -> Any:
        """Yield shapes of geoms that touch: spheres, capsules, and boxes around the others."""
        m, kinds = self._model, self._mujoco.mjtGeom
        for geom in range(m.ngeom):
            if not self.is_part(int(m.geom_bodyid[geom])) or not (m.geom_contype[geom] or m.geom_conaffinity[geom]):
                continue
            pose = self.frame_in_vehicle(self._data.geom_xpos[geom], self._data.geom_xmat[geom])
            own = _collision_shape(kinds, m.geom_type[geom], m.geom_size[geom], m.geom_aabb[geom], pose)
            yield replace(own, link=self.carrier_joint(m.geom_bodyid[geom]))

    def acts_on_vehicle(self, actuator: Actuator) -> bool:
        """Return whether an actuator's target belongs to the vehicle."""
        return not actuator.at_site or self.is_part(int(self._model.site_bodyid[actuator.site]))

    def joints(self) -> list[int]:
        """Return the joints of the vehicle but its free one."""
        return [j for b in self._bodies for j in self._joints_of_body(b)]

    def lines_on_unused(self, sites: Sequence[int], welded: Sequence[int]) -> Iterator[str]:
        """Yield the unused elements other than actuators, a line for each kind; ``welded`` are joints not named elsewhere."""
        m, root = self._model, self._root
        if m.opt.density or m.opt.viscosity:
            yield (
                f"forces of a medium (density {m.opt.density:g} kg/m³, viscosity {m.opt.viscosity:g} Pa s): give rotor_drag or "
                "quadratic_drag as effects"
            )
        free = slice(int(m.body_dofadr[root]), int(m.body_dofadr[root]) + 6)
        for label, values in (("damping", m.dof_damping), ("frictionloss", m.dof_frictionloss)):
            if np.any(np.asarray(values)[free]):
                yield f"{label} of the free joint: {np.max(np.asarray(values)[free]):g}"
        own = self.joints()
        if welded:
            yield f"joints that are welded: {', '.join(m.joint(j).name or f'joint_{j}' for j in welded)}"
        if self._joints and any(np.any(np.asarray(m.dof_armature)[int(m.jnt_dofadr[j])] > 0.0) for j in own):
            yield "armature of joints: add it to the inertia of their links"
        for label, chosen in (("actuatorfrcrange", m.jnt_actfrclimited), ("actuatorgravcomp", m.jnt_actgravcomp)):
            if of := [m.joint(j).name or f"joint_{j}" for j in own if chosen[j]]:
                yield f"{label} of joints: {', '.join(of)}"
        off = m.opt.disableflags & int(self._mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        if off or not np.array_equal(m.opt.gravity, (0.0, 0.0, -9.81)):
            yield f"gravity of the file, {[0, 0, 0] if off else m.opt.gravity.tolist()} m/s²: the environment's acts"
        if np.any(m.opt.wind):
            yield f"wind of the file, {m.opt.wind.tolist()} m/s: give constant_wind as an effect"
        if unused_sites := [s for s in range(m.nsite) if s not in sites]:
            yield f"sites: {', '.join(m.site(s).name or f'site_{s}' for s in unused_sites)}"
        if unseen := [g for g in self._vehicle_geoms() if not (m.geom_contype[g] or m.geom_conaffinity[g])]:
            yield f"geoms that do not touch: {', '.join(m.geom(g).name or f'geom_{g}' for g in unseen)}"
        if around := [g for g in range(m.ngeom) if g not in self._vehicle_geoms()]:
            yield f"geoms of other bodies: {', '.join(m.geom(g).name or f'geom_{g}' for g in around)}"
        for kind, count, name in _UNREAD_KINDS:
            indices = range(int(getattr(m, count)))
            if indices:
                yield f"{kind}: {', '.join(getattr(m, name)(i).name or f'{name}_{i}' for i in indices)}"


_UNREAD_KINDS = (
    ("sensors", "nsensor", "sensor"), ("cameras", "ncam", "cam"), ("lights", "nlight", "light"),
    ("tendons", "ntendon", "tendon"), ("equality constraints", "neq", "eq"), ("contact pairs", "npair", "pair"),
    ("contact exclusions", "nexclude", "exclude"), ("plugins", "nplugin", "plugin"), ("keyframes", "nkey", "key"),
    ("skins", "nskin", "skin"), ("flexes", "nflex", "flex"), ("custom numbers", "nnumeric", "numeric"),
    ("custom texts", "ntext", "text"), ("materials", "nmat", "mat"), ("textures", "ntex", "tex"),
)  # fmt: skip
"""Other elements of a model: name, the field with their number, and the accessor."""


def _homogeneous_pose(place: np.ndarray, turn: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.asarray(turn).reshape(3, 3), place
    return pose


def _collision_shape(kinds: Any, kind: int, size: np.ndarray, bounds: np.ndarray, pose: np.ndarray) -> CollisionShape:
    euler = euler_of_matrix(pose[:3, :3])
    if kind == kinds.mjGEOM_SPHERE:
        return SphereCfg(center=round_vec3(pose[:3, 3]), radius=float(size[0]))
    if kind == kinds.mjGEOM_CAPSULE:
        return CapsuleCfg(
            center=round_vec3(pose[:3, 3]), euler=euler, radius=float(size[0]), height=2.0 * float(size[1])
        )
    return BoxCfg(
        center=round_vec3(pose[:3, 3] + pose[:3, :3] @ bounds[:3]), euler=euler, size=round_vec3(2.0 * bounds[3:])
    )
