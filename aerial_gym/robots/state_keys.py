"""Keys of a robot in the Global Tensor Dictionary.

All states belong to the same instant: the derived ones are refreshed once, after the physics.
Letters: E environments, R rotors, U entries of an action.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from math import inf

import torch
from torch import Tensor

from aerial_gym.config.joint import JointsCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.math.random import Purpose, Randomness, state_of_count, uniform_draw
from aerial_gym.physics import BodyState
from aerial_gym.physics.effects import EffectParams, LoadEffect, RotorEffect
from aerial_gym.physics.state import ArticulatedState, JointEfforts
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.robots.secondary_states import FiniteCheck, SecondaryStates


def declare_joints(gtd: GlobalTensorDictionary, cfg: JointsCfg) -> dict[str, Tensor]:
    """Declare coordinates and rates of the joints, and return them as ``ArticulatedState`` names them, each (E, D)."""
    gtd.define_size("D", len(cfg.layout))
    return {
        "joint_pos": _declare(gtd, cfg, "dof_position", "rad or m", "coordinates"),
        "joint_vel": _declare(gtd, cfg, "dof_velocity", "rad/s or m/s", "rates"),
    }


def declare_efforts(gtd: GlobalTensorDictionary, cfg: JointsCfg) -> JointEfforts:
    """Declare the efforts of drives and dry friction."""
    return JointEfforts(
        drive=_declare(gtd, cfg, "dof_drive_effort", "N m or N", "effort of the drive in the last substep"),
        friction=_declare(gtd, cfg, "dof_friction_effort", "N m or N", "effort of dry friction in the last substep"),
    )


def _declare(gtd: GlobalTensorDictionary, cfg: JointsCfg, key: str, unit: str, quantity: str) -> Tensor:
    """Declare one number per joint, (E, D)."""
    meaning = f"{quantity} of {', '.join(cfg.names)}"
    return gtd.declare(TensorSpec(key=key, shape=("E", "D"), unit=unit, frame="-", owner="physics", meaning=meaning))


class JointStates:
    """Draws joints where episodes begin and keeps ``dof_state_tensor``; captured with the step that it belongs to."""

    def __init__(
        self, cfg: JointsCfg, gtd: GlobalTensorDictionary, state: ArticulatedState, random: Randomness,
        efforts: JointEfforts | None,
    ) -> None:  # fmt: skip
        """Take the ranges, the state that is written, the random numbers, and the efforts that a reset clears."""
        self._state, self._random, self._efforts = state, random, efforts
        self._together = gtd.declare(TensorSpec(
            key="dof_state_tensor", shape=("E", "D", 2), unit="rad, rad/s", frame="-", owner="robot",
            meaning="copy of dof_position and dof_velocity, side by side",
        ))  # fmt: skip
        like = state.joint_pos
        self._ranges = tuple(
            (state_part, like.new_tensor([low for low, _ in ranges]), like.new_tensor([high for _, high in ranges]))
            for state_part, ranges in (
                (state.joint_pos, [joint.initial_range for joint in cfg.layout]),
                (state.joint_vel, [joint.initial_rate for joint in cfg.layout]),
            )
        )

    @torch.no_grad()
    def reset(self) -> None:
        """Draw joints in the environments of the mask that ``random`` keeps."""
        stream, mask = self._random.stream(Purpose.JOINTS), self._random.mask.unsqueeze(1)
        for number, (target, low, high) in enumerate(self._ranges):
            first = number * len(low)
            shares = [uniform_draw(state_of_count(stream, first + k), dtype=low.dtype) for k in range(len(low))]
            drawn = low + (high - low) * torch.stack(shares, dim=1)
            target.copy_(torch.where(mask, drawn, target))
        for effort in () if self._efforts is None else vars(self._efforts).values():
            effort.masked_fill_(mask, 0.0)
        self.refresh()

    @torch.no_grad()
    def refresh(self) -> None:
        """Update ``dof_state_tensor`` from the state."""
        self._together[..., 0].copy_(self._state.joint_pos)
        self._together[..., 1].copy_(self._state.joint_vel)


@dataclass(frozen=True, kw_only=True)
class RobotTensors:
    """The robot's tensors in the GTD."""

    state: BodyState  # Written by the physics
    derived: SecondaryStates  # Written after the physics and after a reset
    actions: Tensor  # (E, U)
    prev_actions: Tensor  # (E, U)


def _spec(key: str, width: int | str, unit: str, frame: str, owner: str, meaning: str) -> TensorSpec:
    return TensorSpec(key=key, shape=("E", width), unit=unit, frame=frame, owner=owner, meaning=meaning)


def declare_robot_tensors(
    gtd: GlobalTensorDictionary, root_state: Tensor, joints: JointsCfg | None = None
) -> RobotTensors:
    """Declare every key of a robot; ``root_state`` is its row (E, 13) of ``vec_root_tensor``, ``joints`` its joints, if any.

    The physics works on tensors of its own for each quantity: rows of 13 numbers would halve its speed on a GPU, where
    neighbouring threads then touch memory 52 bytes apart (``docs/results/performance.md``).
    """

    def new(key: str, width: int | str, unit: str, frame: str, owner: str, meaning: str) -> Tensor:
        return gtd.declare(_spec(key, width, unit, frame, owner, meaning))

    rows = "copy of position, xyzw, velocity, angular velocity; row 0 of vec_root_tensor"
    gtd.declare(_spec("robot_state_tensor", 13, "m, -, m/s, rad/s", "world", "robot", rows), view=root_state)
    state = BodyState(
        position=new("robot_position", 3, "m", "world", "physics", "body origin"),
        attitude=new("robot_orientation", 4, "-", "world", "physics", "body to world, xyzw"),
        lin_vel=new("robot_linvel", 3, "m/s", "world", "physics", "velocity of the origin"),
        ang_vel=new("robot_body_angvel", 3, "rad/s", "body", "physics", "angular velocity"),
        rotor_speed=new(
            "rotor_speed", "R", "rad/s", "-", "physics", "speed of each rotor; in force mode its thrust [N]"
        ),
    )
    if joints is not None:
        state = ArticulatedState(**vars(state), **declare_joints(gtd, joints))
    state.attitude[:, 3] = 1.0
    actions = new("robot_actions", "U", "see controller", "-", "robot", "last action")
    derived = SecondaryStates(
        state,
        root_state=root_state,
        ang_vel_world=new("robot_angvel", 3, "rad/s", "world", "robot", "angular velocity"),
        lin_vel_body=new("robot_body_linvel", 3, "m/s", "body", "robot", "velocity of the origin"),
        vehicle_attitude=new("robot_vehicle_orientation", 4, "-", "world", "robot", "yaw alone, xyzw"),
        vehicle_lin_vel=new("robot_vehicle_linvel", 3, "m/s", "vehicle", "robot", "velocity of the origin"),
        euler=new("robot_euler_angles", 3, "rad", "-", "robot", "ZYX roll, pitch, yaw in (-pi, pi]"),
        checked=FiniteCheck(actions=actions, non_finite=gtd["non_finite"], crashes=gtd["crashes"]),
    )
    return RobotTensors(
        state=state,
        derived=derived,
        actions=actions,
        prev_actions=new("robot_prev_actions", "U", "see controller", "-", "robot", "action before, at the step rate"),
    )


@dataclass(frozen=True, kw_only=True)
class EffectScene:
    """Tensors of the GTD; None if no effect reads them."""

    other_position: Tensor | None  # Position of the vehicle above, source of downwash [m], world, (E, 3)
    surface_height: Tensor | None  # Height of the first surface below the robot [m], world, (E, 1)

    @property
    def sources(self) -> tuple[Tensor, ...]:
        """The tensors that are not None, in the order of ``pop_rows``."""
        return tuple(each for each in (self.other_position, self.surface_height) if each is not None)

    def pop_rows(self, rest: list[Tensor]) -> "EffectScene":
        """Remove the rows (E, ...) of these tensors from the end of a list and return them."""
        surface = None if self.surface_height is None else rest.pop()
        other = None if self.other_position is None else rest.pop()
        return EffectScene(other_position=other, surface_height=surface)


def declare_effect_scene(
    gtd: GlobalTensorDictionary, effects: Sequence[EffectParams], *, obstacles: bool, gradients: bool
) -> EffectScene:
    """Declare the tensors that the effects read: another vehicle's position and, with ``obstacles``, the height below."""
    other = surface = None
    if any("other_position" in effect.needs for effect, _ in effects):
        other = gtd.declare(TensorSpec(
            key="downwash_position", shape=("E", 3), unit="m", frame="world", owner="robot",
            meaning="position of another vehicle, source of downwash",
        ))  # fmt: skip
        other[:, 2] = inf
    near = [effect.name for effect, _ in effects if isinstance(effect, RotorEffect) and "position" in effect.needs]
    if near and obstacles:
        if gradients:
            raise CapabilityError(f"effect {near[0]}: no gradients over obstacles. Leave them or the effect out")
        surface = gtd.declare(TensorSpec(
            key="surface_height", shape=("E", 1), unit="m", frame="world", owner="env",
            meaning=f"first surface straight below the robot at the start of the step, which {', '.join(near)} feel",
        ))  # fmt: skip
    return EffectScene(other_position=other, surface_height=surface)


class SlungLoadState:
    """Keys of the GTD for the load; gradients do not flow through them."""

    def __init__(self, gtd: GlobalTensorDictionary, length: Tensor, state: BodyState) -> None:
        """Declare the keys; ``length`` leads from the body origin to the load [m], (E, 1), and is read at every refresh."""
        self._length, self._state = length, state
        self._position, self._lin_vel = (
            gtd.declare(
                TensorSpec(
                    key=key, shape=("E", 3), unit=unit, frame="world", owner="robot", meaning=f"{quantity} of the load"
                )
            )
            for key, unit, quantity in (("load_position", "m", "place"), ("load_linvel", "m/s", "velocity"))
        )

    @torch.no_grad()
    def refresh(self, load: Tensor) -> None:
        """Write place and velocity for direction and rate of the link, (E, 6)."""
        for target, origin, part in (
            (self._position, self._state.position, load[:, :3]),
            (self._lin_vel, self._state.lin_vel, load[:, 3:]),
        ):
            torch.mul(self._length, part, out=target)
            target.add_(origin)


def make_slung_load(
    gtd: GlobalTensorDictionary, effects: Sequence[EffectParams], state: BodyState
) -> SlungLoadState | None:
    """Return the slung load of a robot; None without one."""
    for effect, params in effects:
        if isinstance(effect, LoadEffect):
            column = [parameter.name for parameter in effect.parameters].index("length")
            return SlungLoadState(gtd, params[:, column : column + 1], state)
    return None


FOLLOWS = {"robot_mass": ("body.mass", "payload_mass"), "robot_inertia": ("body.inertia", "inertia_error")}
"""Keys that follow from the robot: the quantity that may be drawn, and the effect that may be written, in their place."""

LIVE = ("drawn_parameters", "downwash_position")  # Writable keys besides those of effects, read by the next step


def watch_parameter_writes(
    gtd: GlobalTensorDictionary, effects: Sequence[EffectParams], drawn: Collection[int], *, notice: Callable[[], None]
) -> None:
    """Let writes to independent parameters call ``notice``; refuse those to derived ones and effects ``drawn``."""
    for key, (quantity, effect) in FOLLOWS.items():
        gtd.refuse(
            key,
            f"it follows from the robot. Write effect_{effect} of a robot with that effect, or draw {quantity} (randomize) "
            f"and write draws()[{quantity!r}]",
        )
    if "robot_imu_errors" in gtd:
        gtd.refuse("robot_imu_errors", "write effect_imu_bias or effect_imu_misalignment, from which it follows")
    for i, (effect, _) in enumerate(effects):
        if i in drawn:
            way_out = f"it is drawn. Write draws()['effects.{effect.name}.PARAMETER'], or do not draw it"
            gtd.refuse(f"effect_{effect.name}", way_out)
        else:
            gtd.watch(f"effect_{effect.name}", notice)
    for key in LIVE:
        if key in gtd:
            gtd.watch(key, notice)
