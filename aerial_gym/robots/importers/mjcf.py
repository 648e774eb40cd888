"""MJCF files, read by MuJoCo itself: bodies as one, rotors from actuators that push at a site.

An actuator with the gear ``(f, t)`` gives the force ``f u`` and the torque ``t u`` in the frame of its site for a control u: a
rotor with the axis f, a thrust of ``|f| u`` and, where t is along f, the torque ratio ``|t| / |f|``. Its control range gives
the limits.

Source: MuJoCo documentation, XML reference, actuator/general (trntype site, gear, dyntype).
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aerial_gym.assets.urdf_body import weld
from aerial_gym.config.joint import JointCfg
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionShape, RotorCfg, SphereCfg
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.found import Found, FoundRotor, roll_pitch_yaw, vec3
from aerial_gym.robots.importers.joints import FoundJoint, Weight, layout_of

ALONG = 1e-6
"""Share of a torque that may be across the axis of its rotor."""


def read(path: Path, lag: float | None, *, take_actuators: bool, joints: bool = False) -> Found:
    """Return the vehicle of an MJCF file.

    Args:
        path: The file, with its meshes where it says.
        lag: Of the thrusts [s], for actuators without one; None refuses them.
        take_actuators: Whether its actuators are the rotors.
        joints: Whether hinges and slides move.
    """
    try:
        import mujoco
    except ImportError:
        raise ConfigError(f"MJCF {path}: needs MuJoCo; install aerial-gym[dev], or pip install mujoco") from None
    where = f"MJCF {path.name}"
    try:
        model: Any = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ConfigError(f"{where}: cannot be read ({' '.join(str(error).split())})") from None
    free = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        raise ConfigError(f"{where}: has {len(free)} bodies with a free joint: a vehicle is the one of a file")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    reader = _Reader(mujoco, model, data, free[0], where)
    bodies = [b for b in range(model.nbody) if reader.is_part(b)]
    body = weld(
        [float(model.body_mass[b]) for b in bodies],
        [reader.frame(data.xipos[b], data.ximat[b]) for b in bodies],
        [np.diag(model.body_inertia[b]) for b in bodies],
    )
    actuators = list(range(model.nu if take_actuators else 0))
    notes, layout = reader.notes(), ()
    if joints:
        reader.find_joints(bodies)
        layout, of_joints = reader.layout(), [i for i in actuators if reader.turns_joint(i)]
        actuators = [i for i in actuators if i not in of_joints]
        notes = (*notes, *reader.notes_on_joints(of_joints))
    for i in actuators:
        reader.check(i)
    rotors = [reader.rotor(i, lag) for i in actuators]
    return Found(body=body, rotors=rotors, shapes=list(reader.shapes()), joints=layout, notes=notes)


class _Reader:
    """One vehicle of a model."""

    def __init__(self, mujoco: Any, model: Any, data: Any, root: int, where: str) -> None:
        self._mujoco, self._model, self._data, self._root, self._where = mujoco, model, data, root, where
        self._from_world = np.linalg.inv(_pose(data.xpos[root], data.xmat[root]))
        self._joints: list[FoundJoint] = []
        self._on: dict[int, str] = {}

    def find_joints(self, bodies: list[int]) -> None:
        """Take hinges and slides, and which of them moves each body; a body with several is carried by the last."""
        m, kinds = self._model, self._mujoco.mjtJoint
        for body in bodies:  # parents come first
            at = self._on.get(int(m.body_parentid[body]), BASE)
            first = int(m.body_jntadr[body])
            own = [] if body == self._root else list(range(first, first + int(m.body_jntnum[body])))
            pose = self.frame(self._data.xipos[body], self._data.ximat[body])
            weight = Weight(mass=float(m.body_mass[body]), pose=pose, inertia=np.diag(m.body_inertia[body]))
            for j in own:
                if int(m.jnt_type[j]) not in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)):
                    raise ConfigError(f"{self._where}: joint {m.joint(j).name!r} is a ball: give three hinges")
                last = j == own[-1]
                self._joints.append(self._joint(j, at, (weight,) if last else ()))
                at = self._joints[-1].name
            self._on[body] = at
            if not own and at != BASE:
                place = next(i for i, joint in enumerate(self._joints) if joint.name == at)
                self._joints[place] = replace(self._joints[place], weights=(*self._joints[place].weights, weight))

    def _joint(self, j: int, parent: str, weights: tuple[Weight, ...]) -> FoundJoint:
        m, slides = self._model, int(self._model.jnt_type[j]) == int(self._mujoco.mjtJoint.mjJNT_SLIDE)
        place, dof = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
        turn = self._from_world[:3, :3]
        return FoundJoint(
            name=m.joint(j).name or f"joint_{j}",
            parent=parent,
            kind="prismatic" if slides else "revolute",
            axis=turn @ self._data.xaxis[j],
            position=turn @ self._data.xanchor[j] + self._from_world[:3, 3],
            reference=float(m.qpos0[place]),
            limits=(float(m.jnt_range[j][0]), float(m.jnt_range[j][1])) if m.jnt_limited[j] else None,
            stiffness=float(np.ravel(m.jnt_stiffness[j])[0]),
            rest=float(m.qpos_spring[place]),
            damping=float(np.ravel(m.dof_damping[dof])[0]),
            friction=float(m.dof_frictionloss[dof]),
            weights=weights,
        )

    def layout(self) -> tuple[JointCfg, ...]:
        """Return the joints as a robot file has them."""
        return layout_of(self._joints)

    def turns_joint(self, actuator: int) -> bool:
        """Return whether an actuator acts on a joint."""
        return int(self._model.actuator_trntype[actuator]) == int(self._mujoco.mjtTrn.mjTRN_JOINT)

    def notes_on_joints(self, actuators: list[int]) -> tuple[str, ...]:
        """Return what of the joints is not taken over."""
        found = [
            f"actuator {self._model.actuator(i).name}: give the joint a drive in the robot file" for i in actuators
        ]
        if np.any(self._model.dof_armature[6:] > 0.0):
            found.append("armature of joints: add it to the inertia of their links")
        return tuple(found)

    def _carrier(self, body: int) -> str:
        return self._on.get(int(body), BASE)

    def is_part(self, body: int) -> bool:
        """Return whether a body belongs to the vehicle."""
        return int(self._model.body_rootid[body]) == int(self._model.body_rootid[self._root])

    def frame(self, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return a frame of the world in that of the vehicle, (4, 4)."""
        return self._from_world @ _pose(place, turn)

    def check(self, actuator: int) -> None:
        """Raise ``ConfigError`` if an actuator is no rotor."""
        at = self._name(actuator)
        if self._model.actuator_trntype[actuator] != self._mujoco.mjtTrn.mjTRN_SITE:
            raise ConfigError(f"{at}: pushes at no site, and only such actuators are rotors. {_WAY_OUT}")
        force, torque = self._push(actuator)
        size = float(np.linalg.norm(force))
        if size == 0.0:
            raise ConfigError(
                f"{at}: gives a torque and no force, so that it stands for several rotors at once, whose places the file does "
                f"not tell. {_WAY_OUT}"
            )
        across = torque - (torque @ force) * force / size**2
        if np.linalg.norm(across) > ALONG * size:
            raise ConfigError(f"{at}: its torque is not about the axis of its force, as that of a rotor is. {_WAY_OUT}")

    def rotor(self, actuator: int, lag: float | None) -> FoundRotor:
        """Return the rotor that an actuator is."""
        force, torque = self._push(actuator)
        size = float(np.linalg.norm(force))
        along = float(torque @ force) / size
        return FoundRotor(
            name=self._model.actuator(actuator).name,
            position=self._site(actuator)[:3, 3],
            axis=force / size,
            spin=-1 if along > 0.0 else 1,
            rotor=self._type(actuator, size, abs(along) / size, lag),
            link=self._carrier(self._model.site_bodyid[self._model.actuator_trnid[actuator][0]]),
        )

    def _name(self, actuator: int) -> str:
        return f"{self._where}: actuator {self._model.actuator(actuator).name!r}"

    def _site(self, actuator: int) -> np.ndarray:
        site = int(self._model.actuator_trnid[actuator][0])
        return self.frame(self._data.site_xpos[site], self._data.site_xmat[site])

    def _push(self, actuator: int) -> tuple[np.ndarray, np.ndarray]:
        """Return force and torque for a control of 1, in the frame of the vehicle, (3,) each."""
        turn, gain = self._site(actuator)[:3, :3], float(self._model.actuator_gainprm[actuator][0])
        force, torque = np.split(self._model.actuator_gear[actuator], 2)
        return turn @ force * gain, turn @ torque * gain

    def _type(self, actuator: int, size: float, ratio: float, lag: float | None) -> RotorCfg:
        m, dynamics, at = self._model, self._mujoco.mjtDyn, self._name(actuator)
        if not m.actuator_ctrllimited[actuator]:
            raise ConfigError(f"{at}: has no ctrlrange, so that its largest thrust is unknown. Give it one")
        kind, source = int(m.actuator_dyntype[actuator]), f"{self._where}: gear and ctrlrange"
        if kind in (int(dynamics.mjDYN_FILTER), int(dynamics.mjDYN_FILTEREXACT)):
            lag, source = float(m.actuator_dynprm[actuator][0]), f"{source}, dynprm"
        elif kind != int(dynamics.mjDYN_NONE) or lag is None:
            raise ConfigError(
                f"{at}: its thrust follows at once, and rotors have a lag. Give one (--lag-s, lag of RotorHints), measured or "
                "that of a similar motor: 0.02 to 0.1 s"
            )
        else:
            source = f"{source}; lag of {lag:g} s: given when it was imported"
        low, high = (size * float(limit) for limit in m.actuator_ctrlrange[actuator])
        return RotorCfg(
            mode="force",
            torque_ratio=ratio,
            time_constant_up=lag,
            time_constant_down=lag,
            thrust_range=(low, high),
            source=source,
        )

    def shapes(self) -> Any:
        """Yield shapes of geoms that touch: spheres, capsules, and boxes around the others."""
        m, kinds = self._model, self._mujoco.mjtGeom
        for geom in range(m.ngeom):
            if not self.is_part(int(m.geom_bodyid[geom])) or not (m.geom_contype[geom] or m.geom_conaffinity[geom]):
                continue
            pose = self.frame(self._data.geom_xpos[geom], self._data.geom_xmat[geom])
            own = _shape(kinds, m.geom_type[geom], m.geom_size[geom], m.geom_aabb[geom], pose)
            yield replace(own, link=self._carrier(m.geom_bodyid[geom]))

    def notes(self) -> tuple[str, ...]:
        """Return what is not taken over."""
        m = self._model
        if m.opt.density or m.opt.viscosity:
            return (
                f"the forces of a medium (density {m.opt.density:g} kg/m³, viscosity {m.opt.viscosity:g} Pa s) are left out: "
                "give rotor_drag or quadratic_drag as effects",
            )
        return ()


_WAY_OUT = "Take rotors of a robot file: --rotors-of ROBOT, rotors_of of RotorHints"


def _pose(place: np.ndarray, turn: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.asarray(turn).reshape(3, 3), place
    return pose


def _shape(kinds: Any, kind: int, size: np.ndarray, bounds: np.ndarray, pose: np.ndarray) -> CollisionShape:
    euler = roll_pitch_yaw(pose[:3, :3])
    if kind == kinds.mjGEOM_SPHERE:
        return SphereCfg(center=vec3(pose[:3, 3]), radius=float(size[0]))
    if kind == kinds.mjGEOM_CAPSULE:
        return CapsuleCfg(center=vec3(pose[:3, 3]), euler=euler, radius=float(size[0]), height=2.0 * float(size[1]))
    return BoxCfg(center=vec3(pose[:3, 3] + pose[:3, :3] @ bounds[:3]), euler=euler, size=vec3(2.0 * bounds[3:]))
