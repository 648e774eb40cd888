"""Motion of robots and joints as an autograd graph, through which gradients flow from step to step.

The Global Tensor Dictionary holds float32 copies for sensors, rewards and other readers. Gradients flow through the motion
here, which is never overwritten. Letters: E environments, U entries of an action.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, quat_from_euler, quat_rotate, quat_rotate_inverse
from aerial_gym.math.random import Randomness
from aerial_gym.physics.backend import ControlLaw
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.model import Model
from aerial_gym.physics.state import ArticulatedState, BodyState, JointEfforts
from aerial_gym.physics.substep_hook import SubstepHook, check_substeps
from aerial_gym.physics.torch_backend import TorchBackend, copy_tensors
from aerial_gym.physics.torch_rows import SubstepRows


class DifferentiableBackend(TorchBackend):
    """The torch backend in a float type of its own; it keeps the motion as an autograd graph and copies it to the GTD."""

    def __init__(self, shown: BodyState, shown_actions: tuple[Tensor, Tensor], *, dtype: torch.dtype) -> None:
        """Take state and last two actions in the Global Tensor Dictionary, and the float type of the graph."""
        self._shown, self._shown_actions, self._dtype = shown, shown_actions, dtype
        self.state: BodyState = _map_state(shown, lambda rows: rows.detach().to(dtype, copy=True))
        self.actions: tuple[Tensor, Tensor] = _map_pair(shown_actions, lambda rows: rows.detach().to(dtype, copy=True))
        """Actions of this step and the previous one, each (E, U), with gradients."""
        self._traced: GradientTensors | None = None
        self._rows: tuple[float, SubstepRows | None] | None = None
        self._graph_places: dict[str, Tensor] = {}

    @property
    def gradient_tensors(self) -> "GradientTensors":
        """Motion, actions and secondary states with gradients, by GTD key."""
        if self._traced is None or self._traced.state is not self.state:
            self._traced = GradientTensors(self.state, self.actions)
        return self._traced

    def act(self, action: Tensor) -> None:
        """Take the action of a step, (E, U), with its graph."""
        self.actions, self._traced = (action.to(self._dtype), self.actions[0]), None

    def allocate(
        self, model: Model, control: ControlLaw, *, integrator: str, ground: Ground | None = None,
        hook: SubstepHook | None = None, random: Randomness | None = None, efforts: JointEfforts | None = None,
    ) -> None:  # fmt: skip
        """Take everything in the float type of the graph; the control law is in it already."""
        if ground is not None:
            ground = replace(ground, spheres=ground.spheres.to(self._dtype))
        super().allocate(
            model, control, integrator=integrator, ground=ground, hook=hook, random=random, efforts=efforts
        )

    def set_model(self, model: Model) -> None:
        """Replace the parameters of the model."""
        self._rows = None
        super().set_model(model.to_dtype(self._dtype))

    def link_state_of_load(self) -> Tensor | None:
        """Return direction and rate of the load's cable, in float32 and without gradients; None without a load."""
        link = super().link_state_of_load()
        return None if link is None else link.detach().float()

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name; gradients end here."""
        self.detach()
        graph = vars(self.state) | dict(zip(("action", "previous_action"), self.actions, strict=True))
        return super().state_tensors() | {f"graph.{name}": rows for name, rows in graph.items()}

    def parameter_rows(self, model: Model) -> tuple[Tensor, ...]:
        """Return the parameters of the inner backend for each environment, in its float type."""
        return tuple(rows.to(self._dtype) for rows in super().parameter_rows(model))

    def step(self, state: BodyState, command: Tensor, dt: float, substeps: int) -> None:
        """Extend the graph by ``substeps`` of ``dt`` [s] under its own action, and copy the result to ``state``."""
        del command  # the action of the graph, rounded
        check_substeps(self._hook, substeps)
        if self._hook is not None:
            with torch.no_grad():
                self._hook.begin(state)
        rows = self._substep_kernel(dt)
        for k in range(substeps):
            if rows is None:
                before, self.state = self.advance_once(self.state, self.actions[0], dt)
            else:
                before, self.state = None, rows(self.state, self.actions[0])
            with torch.no_grad():
                state.copy_(self.state)
                if self._hook is not None and before is not None:
                    self._hook.after_substep(k, _map_state(before, torch.Tensor.detach), state)

    def _substep_kernel(self, dt: float) -> SubstepRows | None:
        """Return a substep of ``dt`` [s] as one float32 kernel, without the hook, which needs the motion before it."""
        if self._rows is None or self._rows[0] != dt:
            plain = self._dtype == torch.float32 and self._hook is None
            self._rows = (dt, self.make_substep_rows(self.state, self.actions[0], dt) if plain else None)
        return self._rows[1]

    def reset_memory(self, mask: Tensor) -> None:
        """Restart the graph of the environments in ``mask``, bool (E,), from the GTD's state; others continue."""
        mask = mask.clone()  # the graph keeps it; the next reset overwrites the mask
        self.reset_memory_with_gradients(mask)
        rows = mask.unsqueeze(-1)

        def select_rows(new: Tensor, old: Tensor) -> Tensor:
            return torch.where(rows, new.to(self._dtype), old)

        old = vars(self.state)
        self.state = replace(
            self.state, **{name: select_rows(new, old[name]) for name, new in vars(self._shown).items()}
        )
        (last, before), (new, new_before) = self.actions, self._shown_actions
        self.actions = (select_rows(new, last), select_rows(new_before, before))

    def detach(self) -> None:
        """Cut the gradients at this instant."""
        self.state = _map_state(self.state, torch.Tensor.detach)
        self.actions = _map_pair(self.actions, torch.Tensor.detach)
        super().detach()

    def detach_in_place(self) -> None:
        """Cut the gradients at this instant, in tensors that stay the same at every call, as start of a recorded window."""
        super().detach_in_place()
        own = vars(self.state) | dict(zip(("action", "previous_action"), self.actions, strict=True))
        settled = copy_tensors(self._graph_places, own)
        self.actions = (settled.pop("action"), settled.pop("previous_action"))
        self.state, self._traced = replace(self.state, **settled), None


def _map_state(state, change):
    """Return a state with a change of every tensor."""
    return replace(state, **{name: change(rows) for name, rows in vars(state).items()})


def _map_pair(pair: tuple[Tensor, Tensor], change: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
    """Return a pair with a change of both."""
    return change(pair[0]), change(pair[1])


FOLLOWING: dict[str, Callable[["GradientTensors"], Tensor]] = {
    "robot_angvel": lambda now: quat_rotate(now.state.attitude, now.state.ang_vel),
    "robot_body_linvel": lambda now: quat_rotate_inverse(now.state.attitude, now.state.lin_vel),
    "robot_vehicle_orientation": lambda now: quat_from_euler(
        torch.cat((torch.zeros_like(now["robot_euler_angles"][:, :2]), now["robot_euler_angles"][:, 2:]), dim=-1)
    ),
    "robot_vehicle_linvel": lambda now: quat_rotate_inverse(now["robot_vehicle_orientation"], now.state.lin_vel),
    "robot_euler_angles": lambda now: euler_from_quat(now.state.attitude),
}
"""Secondary states as functions of the motion, by GTD key."""

FOLLOWING_JOINTS: dict[str, Callable[["GradientTensors"], Tensor]] = {
    "dof_state_tensor": lambda now: torch.stack((now["dof_position"], now["dof_velocity"]), dim=-1)
}
"""Quantities derived from joint states, by GTD key."""


class GradientTensors(Mapping[str, Tensor]):
    """Motion, actions and secondary states of one instant, by GTD key; secondary states are computed on request."""

    def __init__(self, state: BodyState, actions: tuple[Tensor, Tensor]) -> None:
        """Take the motion, and the last action and the one before, each (E, U)."""
        self.state = state
        self._known: dict[str, Tensor] = {
            "robot_position": state.position, "robot_orientation": state.attitude, "robot_linvel": state.lin_vel,
            "robot_body_angvel": state.ang_vel, "rotor_speed": state.rotor_speed, "robot_actions": actions[0],
            "robot_prev_actions": actions[1],
        }  # fmt: skip
        self._following = FOLLOWING
        if isinstance(state, ArticulatedState):
            self._known |= {"dof_position": state.joint_pos, "dof_velocity": state.joint_vel}
            self._following = FOLLOWING | FOLLOWING_JOINTS
        self._names = (*self._known, *self._following)

    def __getitem__(self, key: str) -> Tensor:
        if key not in self._known:
            self._known[key] = self._following[key](self)
        return self._known[key]

    def __contains__(self, key: object) -> bool:
        return key in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
