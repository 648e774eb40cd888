"""Joint states of a robot in the Global Tensor Dictionary, and their draw at reset.

Letters: E environments, D joints.
"""

import torch
from torch import Tensor

from aerial_gym.config.joint import JointsCfg
from aerial_gym.math.random import Purpose, Randomness, state_of_count, uniform_draw
from aerial_gym.physics.state import ArticulatedState, JointEfforts
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec


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
