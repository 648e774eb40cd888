"""Trees of links in MuJoCo on the CPU, in float64: vehicles that bend.

Springs and dampers in joints are those of the end of a step, as in ``steppers.implicit_euler``, with the stiffness K and the
damping C that the laws have in each state:

    (M + C dt + K dt²) a = f - h - K q' dt.

MuJoCo's ``Euler`` takes the damping D of a joint so: ``(M + D dt) a = u - h - D q'``. With ``D = C + K dt`` and
``u = f + C q'`` it is the same step. Damping of links is no joint's: it is held through a step as other forces on links are,
and refused where it would turn their motion round. A base on a stand is where its state says, and stands still.
Letters: E environments, L links, D joints, P parts of obstacles.
"""

from collections.abc import Sequence
from copy import copy
from functools import partial
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.physics.articulated.joint_laws import Drive, Effort, JointLaw
from aerial_gym.physics.articulated.link_damping import LinkDamping
from aerial_gym.physics.articulated.steppers import moved_on, with_drive
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.mujoco.bodies import LARGEST, load
from aerial_gym.physics.mujoco.cpu.rollouts import Rollouts
from aerial_gym.physics.mujoco.mjcf import Floor, write_mjcf
from aerial_gym.physics.mujoco.softness import solver_numbers
from aerial_gym.physics.mujoco.solid_bodies import check_solids

LEAST_MASS = 1e-9
"""Of links without mass [kg], and the moments of those without inertia [kg m²]: MuJoCo's links have some."""


class RolloutTrees:
    """A MuJoCo model for each environment, whose ``move`` is a step as ``steppers.implicit_euler`` is."""

    impulse: Tensor
    """Of ground and obstacles in the last step [N s], world, (E, 3), float64."""

    def __init__(
        self, tree: Tree, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models.

        Args:
            tree: How links hang together.
            num_envs: Environments E.
            dt: Length of a step [s].
            floor: What can be touched; None for nothing.
            cfg: How it gives way; with a floor.

        Raises:
            MissingDependencyError: If MuJoCo is not installed.
            CapabilityError: If an obstacle has a shape that MuJoCo has not.
        """
        self.dt, self._tree, self._floor, self._cfg = dt, tree, floor, cfg
        self._touches, self._solids = floor is not None, None if floor is None else floor.solids
        if self._solids is not None:
            check_solids(self._solids)
            self._part = self._solids.part.clone()
        models = self._compile(list(range(num_envs)))
        held, first = ("mjSTATE_CTRL", "mjSTATE_MOCAP_POS", "mjSTATE_MOCAP_QUAT"), models[0]
        self._rollouts = Rollouts(list(models.values()), num_envs, *held)
        names = [f"joint{k}" for k in range(tree.num_joints)]
        self._joint_pos = [1 + int(first.joint(name).qposadr[0]) for name in names]
        self._rates = [int(first.joint(name).dofadr[0]) for name in names]
        self._joint_vel = [1 + first.nq + place for place in self._rates]
        self._places = [int(first.body(f"link{link}").id) for link in range(tree.num_links)]
        self._weights = torch.full((num_envs, 13 * tree.num_links + 3), torch.nan, dtype=torch.float64)
        self._damping = torch.zeros(num_envs, tree.num_joints, dtype=torch.float64)
        pose, twist = self._rollouts.pose.start, self._rollouts.twist.start
        self._pose, self._twist = slice(pose, pose + 7), slice(twist, twist + 6)
        if self._solids is not None and self._solids.moves:
            count, of_part = self._solids.part.shape[1], first.joint("part0")
            pose, twist = pose + int(of_part.qposadr[0]), twist + int(of_part.dofadr[0])
            self._part_poses, self._part_twists = slice(pose, pose + 7 * count), slice(twist, twist + 6 * count)
        self._rest = self._rollouts.at_rest()

    def _compile(self, envs: list[int]) -> dict[int, Any]:
        """Return the models of some environments, into which weights can be written; each of a kind is read once."""
        tree, shape = self._tree, (max(envs) + 1, self._tree.num_links)
        zero, unit = torch.zeros(1).expand(*shape, 3), torch.eye(3).expand(*shape, 3, 3)
        links = Links(mass=torch.ones(1).expand(shape), com=zero, inertia=unit)
        mujoco, kinds, found = load("mujoco", backend="mujoco"), {}, {}
        for env in envs:
            kind = () if self._solids is None else tuple(self._solids.part[env].tolist())
            if kind not in kinds:
                text = write_mjcf(tree, links, env=env, gravity=0.0, dt=self.dt, floor=self._floor, actuated=True)
                model = kinds[kind] = mujoco.MjModel.from_xml_string(text)
                if self._cfg is not None:
                    numbers = solver_numbers(self._cfg, self.dt)
                    model.geom_solref[:], model.geom_solimp[:] = model.pair_solref[:], model.pair_solimp[:] = numbers
            found[env] = copy(kinds[kind])
        return found

    def _renew(self) -> None:
        """Make the models anew of environments whose obstacles have become others."""
        if self._solids is None:
            return
        changed = (self._solids.part != self._part).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._part.copy_(self._solids.part)
            self._rollouts.replace(self._compile(changed))
            self._weights[changed] = self._damping[changed] = torch.nan

    def _follow(self, links: Links, gravity: float, damping: Tensor) -> None:
        """Write what has changed into the models; gravity is how fast what falls gets faster [m/s²]."""
        self._renew()
        down = torch.zeros_like(damping[:, :1]).expand(-1, 3) + torch.tensor((0.0, 0.0, -gravity), dtype=damping.dtype)
        every = (links.mass, links.com, links.inertia)
        mass, com, inertia = (rows.double().expand(len(down), *rows.shape[1:]) for rows in every)
        weights = torch.cat((mass, com.flatten(1), inertia.flatten(1), down), dim=1)
        changed = (weights != self._weights).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._weights[changed] = weights[changed]
            some = LEAST_MASS * torch.eye(3, dtype=inertia.dtype)
            inertia = torch.where((inertia == 0.0).flatten(2).all(-1)[..., None, None], some, inertia)[changed]
            mass = mass[changed].clamp_min(LEAST_MASS)
            self._rollouts.write_bodies(changed, self._places, mass, com[changed], inertia, down[changed])
            self._rollouts.settle(changed)
            if self._touches:
                self._rollouts.refer_contacts_to(changed, self._places, mass.sum(dim=-1))
        changed = (damping != self._damping).any(dim=-1).nonzero().squeeze(-1).tolist()
        self._damping[changed] = damping[changed]
        for k, row in zip(changed, damping[changed].numpy(), strict=True):
            self._rollouts.models[k].dof_damping[self._rates] = row

    def move(
        self,
        tree: Tree,
        links: Links,
        laws: Sequence[JointLaw],
        state: TreeState,
        dt: float,
        *,
        gravity: float,
        wrench: Tensor,
        drive: Drive | None = None,
        friction: Drive | None = None,
        damping: LinkDamping | None = None,
    ) -> TreeState:
        """Return the state after one step; arguments as for ``steppers.implicit_euler``, but that damping is held through it.

        Rows with a number that is not finite, or beyond ``bodies.LARGEST``, come out NaN; they are not stepped.

        Raises:
            ShapeError: If it was made for another tree or for steps of another length.
            CapabilityError: If damping of links is too large to be held.
        """
        if tree is not self._tree or dt != self.dt:
            raise ShapeError(f"MuJoCo's models are of another tree, or of steps of {self.dt:g} s. Make them anew")
        if damping is not None:
            _check_held(links, damping, dt)
            wrench = wrench + damping.held(links)
        return with_drive(partial(self._step, links, state, gravity, wrench), laws, drive, friction, state)

    def _start_of(self, state: TreeState, swings: TreeState) -> tuple[Tensor, Tensor]:
        """Return where a step begins in MuJoCo, (E, 1 + nq + nv), and M mocap bodies: places, then attitudes wxyz, (E, 7 M)."""
        start = torch.zeros_like(self._rollouts.start)
        start[:, self._joint_pos], start[:, self._joint_vel] = state.joint_pos.double(), swings.joint_vel.double()
        places, turns = [start[:, :0]], [start[:, :0]]
        if self._tree.floating:
            start[:, self._pose] = torch.cat((state.position, _wxyz(state.attitude)), dim=-1).double()
            start[:, self._twist] = torch.cat((state.lin_vel, swings.ang_vel), dim=-1).double()
        else:
            places.append(state.position.double())
            turns.append(_wxyz(state.attitude).double())
        if self._solids is not None:
            place, attitude, lin_vel, ang_vel = self._solids.of_parts()
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

        MuJoCo steps from the rates at which turning and swinging are taken, and what they gain is added to those of the state.
        Where something can be touched these are the rates at the start, at which MuJoCo's contacts push.
        """
        if self._touches:
            swings = state
        dt = self.dt
        damping = (acts.damping + dt * acts.stiffness).double()
        held = acts.value - dt * acts.stiffness * state.joint_vel + damping * swings.joint_vel
        start, places = self._start_of(state, swings)
        control = torch.cat((wrench.flatten(1).double(), held.double(), places), dim=-1)
        sane = (torch.cat((start, control, damping), dim=-1).abs() < LARGEST).all(dim=-1, keepdim=True)
        self._rollouts.start.copy_(torch.where(sane, start, self._rest[0]))
        self._rollouts.control.copy_(torch.where(sane, control, self._rest[1]))
        self._follow(links, gravity, torch.where(sane, damping, 0.0))
        self._rollouts.step()
        self.impulse = torch.where(sane, -dt * self._rollouts.sensed.unflatten(-1, (-1, 3)).sum(1), 0.0)
        end = torch.where(sane, self._rollouts.end, torch.nan).to(state.position.dtype)
        lin_vel, ang_vel = torch.zeros_like(state.lin_vel), torch.zeros_like(state.ang_vel)
        if self._tree.floating:
            lin_vel, ang_vel = end[:, self._twist].split(3, dim=-1)
            ang_vel = state.ang_vel + ang_vel - swings.ang_vel
        return moved_on(state, lin_vel, ang_vel, state.joint_vel + end[:, self._joint_vel] - swings.joint_vel, dt)


def _wxyz(attitude: Tensor) -> Tensor:
    """Return quaternions in MuJoCo's order."""
    return attitude.roll(1, dims=-1)


def _check_held(links: Links, acts: LinkDamping, dt: float) -> None:
    """Raise ``CapabilityError`` where damping that is held through a step takes more than all of a link's motion.

    Below ``D dt = m`` of each link, and likewise for torques, no motion of the tree turns round:
    ``sum J^T D J dt <= sum J^T m J <= M``. A link that is a point has no inertia to say so by.
    """
    along, about = (part.amax(-1) for part in acts.damping.split(3, dim=-1))
    moment = torch.linalg.eigvalsh(links.inertia)[..., 0]
    for damping, size, what in ((along, links.mass, "mass [kg]"), (about, moment, "least moment of inertia [kg m²]")):
        size = size.expand_as(damping)
        if bool(((size > 0.0) & (dt * damping > size)).any()):
            ratio = float((dt * damping / size)[size > 0.0].nan_to_num(0.0).max())
            raise CapabilityError(
                f"backend mujoco: holds drag of links through a step of {dt:g} s, which would take {ratio:.3g} times the speed "
                f"of one: drag per speed times the step must stay below its {what}. Use backend 'torch' or 'warp', or "
                "shorter steps"
            )
