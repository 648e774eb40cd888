"""Trees of links in MuJoCo for articulated vehicles: the common part of MuJoCo on the CPU and MuJoCo Warp.

Springs and dampers in joints act at the end of a step, as in ``steppers.implicit_euler``, with the stiffness K and the
damping C of the laws in each state:

    (M + C dt + K dt²) a = f - h - K q' dt.

The terms beside M enter MuJoCo as armature of a joint, the inertia of a geared rotor. So contacts, which MuJoCo solves before
the step, include them. With MuJoCo's own damping, which its ``Euler`` applies only afterwards, a contact would push a light
link as if its joint were free. Damping of links is constant over a step, like other forces on links, and is refused if it
would reverse their motion. A base on a stand keeps its pose.
Letters: E environments, L links, D joints, P parts of obstacles.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.physics.articulated.joint_laws import Drive, Effort, JointLaw
from aerial_gym.physics.articulated.link_loads import LinkDamping, LinkFluid
from aerial_gym.physics.articulated.steppers import advance_state, step_within_limits
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.ground import Solids
from aerial_gym.physics.mujoco.bodies import LARGEST
from aerial_gym.physics.mujoco.mjcf import Floor, write_mjcf
from aerial_gym.physics.state import JointEfforts

LEAST_MASS = 1e-9  # Mass [kg] and moments of inertia [kg m²] for links without any, because MuJoCo needs them


def template_mjcf(tree: Tree, dt: float, *, floor: Floor | None = None, env: int = 0) -> str:
    """Return the template MJCF of a tree with controls, whose links have 1 kg and 1 kg m²."""
    shape = (env + 1, tree.num_links)
    zero, unit = torch.zeros(1).expand(*shape, 3), torch.eye(3).expand(*shape, 3, 3)
    links = Links(mass=torch.ones(1).expand(shape), com=zero, inertia=unit)
    return write_mjcf(tree, links, env=env, gravity=0.0, dt=dt, floor=floor, actuated=True)


class MujocoTrees(ABC):
    """Trees of all environments, with ``move`` in place of ``steppers.implicit_euler``."""

    backend: str  # Name of the backend in messages
    impulse: Tensor  # Impulse of ground and obstacles in the last step [N s], world, (E, 3), float64

    def __init__(
        self, first: Any, tree: Tree, num_envs: int, dt: float, *, solids: Solids | None, touches: bool
    ) -> None:
        """Find the indices of links, joints and controls in a compiled ``MjModel`` of ``template_mjcf``."""
        self.dt, self._tree, self._solids, self._touches = dt, tree, solids, touches
        names = [f"joint{k}" for k in range(tree.num_joints)]
        self._joint_pos = [int(first.joint(name).qposadr[0]) for name in names]
        self._rates = [int(first.joint(name).dofadr[0]) for name in names]
        self._joint_vel = [first.nq + place for place in self._rates]
        self._places = [int(first.body(f"link{link}").id) for link in range(tree.num_links)]
        self._weights = torch.full((num_envs, 13 * tree.num_links + 3), torch.nan, dtype=torch.float64)
        self._armature = torch.full((num_envs, tree.num_joints), torch.nan, dtype=torch.float64)
        self._pose, self._twist = slice(0, 7), slice(first.nq, first.nq + 6)
        if solids is not None and solids.moves:
            count, of_part = solids.part.shape[1], first.joint("part0")
            pose, twist = int(of_part.qposadr[0]), first.nq + int(of_part.dofadr[0])
            self._part_poses, self._part_twists = slice(pose, pose + 7 * count), slice(twist, twist + 6 * count)
        still = torch.zeros(first.nu + 7 * first.nmocap, dtype=torch.float64)
        still[first.nu + 3 * first.nmocap :: 4] = 1.0
        self._rest = torch.cat((torch.from_numpy(first.qpos0), torch.zeros(first.nv, dtype=torch.float64))), still

    @abstractmethod
    def _write_links(self, changed: list[int], mass: Tensor, com: Tensor, inertia: Tensor, down: Tensor) -> None:
        """Write masses [kg], (K, L), centres of mass [m], inertias [kg m²] and free fall [m/s²], (K, 3), of K environments."""

    @abstractmethod
    def _write_armature(self, changed: list[int], armature: Tensor) -> None:
        """Write the armature of joints [kg m²] or [kg] in some environments, (K, D)."""

    @abstractmethod
    def _run(self, start: Tensor, control: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return the state after a step, and the force on ground and obstacles [N], world, (E, 3); None without contact.

        ``start`` is qpos and qvel, (E, nq + nv); ``control`` has controls, positions and attitudes wxyz of M mocap bodies.
        """

    def _write_changes(self, links: Links, gravity: float, armature: Tensor) -> None:
        """Write changed parameters; gravity is the downward acceleration of free fall [m/s²]."""
        down = torch.zeros_like(armature[:, :1]).expand(-1, 3) + torch.tensor(
            (0.0, 0.0, -gravity), dtype=armature.dtype
        )
        every = (links.mass, links.com, links.inertia)
        mass, com, inertia = (rows.double().expand(len(down), *rows.shape[1:]) for rows in every)
        weights = torch.cat((mass, com.flatten(1), inertia.flatten(1), down), dim=1)
        changed = (weights != self._weights).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._weights[changed] = weights[changed]
            some = LEAST_MASS * torch.eye(3, dtype=inertia.dtype)
            inertia = torch.where((inertia == 0.0).flatten(2).all(-1)[..., None, None], some, inertia)[changed]
            self._write_links(changed, mass[changed].clamp_min(LEAST_MASS), com[changed], inertia, down[changed])
        changed = (armature != self._armature).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._armature[changed] = armature[changed]
            self._write_armature(changed, armature[changed])

    def move(
        self, tree: Tree, links: Links, laws: Sequence[JointLaw], state: TreeState, dt: float, *, gravity: float,
        wrench: Tensor, drive: Drive | None = None, friction: Drive | None = None, damping: LinkDamping | None = None,
        fluid: LinkFluid | None = None, applied: JointEfforts | None = None,
    ) -> TreeState:  # fmt: skip
        """Return the state after one step; arguments as for ``steppers.implicit_euler``, but with constant damping of links.

        Rows with a number that is not finite, or beyond ``bodies.LARGEST``, become NaN without a step.
        """
        if fluid is not None:
            raise CapabilityError(
                f"backend {self.backend}: bodies of MuJoCo have one mass along all axes, and added mass of links is another "
                "along each. Use backend 'torch' or 'warp'"
            )
        if tree is not self._tree or dt != self.dt:
            raise ShapeError(f"MuJoCo's models are of another tree, or of steps of {self.dt:g} s. Make them anew")
        if damping is not None:
            self._check_link_damping(links, damping)
            wrench = wrench + damping.start_wrench(links)
        step = partial(self._step, links, state, gravity, wrench)
        return step_within_limits(step, laws, drive, friction, state, dt, applied=applied)

    def _initial_state(self, state: TreeState, swings: TreeState) -> tuple[Tensor, Tensor]:
        """Return MuJoCo's initial state, (E, nq + nv), and M mocap bodies: positions, then attitudes wxyz, (E, 7 M)."""
        start = torch.zeros(len(state.position), len(self._rest[0]), dtype=torch.float64)
        start[:, self._joint_pos], start[:, self._joint_vel] = state.joint_pos.double(), swings.joint_vel.double()
        places, turns = [start[:, :0]], [start[:, :0]]
        if self._tree.floating:
            start[:, self._pose] = torch.cat((state.position, _wxyz(state.attitude)), dim=-1).double()
            start[:, self._twist] = torch.cat((state.lin_vel, swings.ang_vel), dim=-1).double()
        else:
            places.append(state.position.double())
            turns.append(_wxyz(state.attitude).double())
        if self._solids is not None:
            place, attitude, lin_vel, ang_vel = self._solids.motion_of_parts()
            if self._solids.moves:
                start[:, self._part_poses] = torch.cat((place, _wxyz(attitude)), dim=-1).flatten(1)
                start[:, self._part_twists] = torch.cat((lin_vel, ang_vel), dim=-1).flatten(1)
            else:
                places.append(place.flatten(1))
                turns.append(_wxyz(attitude).flatten(1))
        return start, torch.cat((*places, *turns), dim=-1)

    def _step(
        self, links: Links, state: TreeState, gravity: float, wrench: Tensor, acts: Effort, swings: TreeState
    ) -> TreeState:
        """Return the state after one step under efforts of joints, taken at its end.

        MuJoCo steps from the rates of the velocity-dependent terms, and their change is added to the rates of the state. With
        contacts these are the rates at the start, at which MuJoCo's contacts act.
        """
        if self._touches:
            swings = state
        dt = self.dt
        held, stiff = acts.at_end_of_step(state.joint_vel, dt)
        armature = stiff.double()
        start, places = self._initial_state(state, swings)
        control = torch.cat((wrench.flatten(1).double(), held.double(), places), dim=-1)
        sane = (torch.cat((start, control, armature), dim=-1).abs() < LARGEST).all(dim=-1, keepdim=True)
        self._write_changes(links, gravity, torch.where(sane, armature, 0.0))
        end, force = self._run(torch.where(sane, start, self._rest[0]), torch.where(sane, control, self._rest[1]))
        if force is not None:
            self.impulse = torch.where(sane, -dt * force, 0.0)
        end = torch.where(sane, end, torch.nan).to(state.position.dtype)
        lin_vel, ang_vel = torch.zeros_like(state.lin_vel), torch.zeros_like(state.ang_vel)
        if self._tree.floating:
            lin_vel, ang_vel = end[:, self._twist].split(3, dim=-1)
            ang_vel = state.ang_vel + ang_vel - swings.ang_vel
        return advance_state(state, lin_vel, ang_vel, state.joint_vel + end[:, self._joint_vel] - swings.joint_vel, dt)

    def _check_link_damping(self, links: Links, acts: LinkDamping) -> None:
        """Raise ``CapabilityError`` if constant damping over a step would reverse a link's motion.

        Below ``D dt = m`` of each link, and likewise for torques, no motion of the tree reverses:
        ``sum J^T D J dt <= sum J^T m J <= M``. A point link has no inertia for this test.
        """
        dt = self.dt
        along, about = (part.amax(-1) for part in acts.damping.split(3, dim=-1))
        moment = torch.linalg.eigvalsh(links.inertia)[..., 0]
        for damping, size, quantity in (
            (along, links.mass, "mass [kg]"),
            (about, moment, "least moment of inertia [kg m²]"),
        ):
            size = size.expand_as(damping)
            if bool(((size > 0.0) & (dt * damping > size)).any()):
                ratio = float((dt * damping / size)[size > 0.0].nan_to_num(0.0).max())
                raise CapabilityError(
                    f"backend {self.backend}: holds drag of links through a step of {dt:g} s, which would take {ratio:.3g} "
                    f"times the speed of one: drag per speed times the step must stay below its {quantity}. Use backend "
                    "'torch' or 'warp', or shorter steps"
                )


def _wxyz(attitude: Tensor) -> Tensor:
    """Return quaternions in MuJoCo's order."""
    return attitude.roll(1, dims=-1)
