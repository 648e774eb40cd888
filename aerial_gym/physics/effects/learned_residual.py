"""Learned residual: a small network for force and torque that no named effect explains.

With the inputs u (velocity through the air, angular velocity, mean squared rotor speed), held within the training data:
``x = (clip(u) - centre) / scale``, ``h = tanh(W1 x + b1)``, ..., ``y = W h + b``; the wrench is ``t(q) clip(y)`` with the trust
``t = s² (3 - 2 s)``, ``s = clip((4 - q) / 3)`` in [0, 1], and ``q = |whitening (u - centre) / scale|²``: 1 within the training
data (Mahalanobis distance), 0 beyond twice that distance. Without position and time it cannot learn a map of the room.
Source: Goodfellow, Bengio, Courville (2016), Deep Learning, section 6 (the network); the bounds are our own.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.config.learned_residual import LearnedResidualCfg
from aerial_gym.math.rows import times
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import WrenchEffect

Layer = tuple[Tensor, Tensor]  # Weights (out, in) and bias (out,)


def network_inputs(air_velocity: Tensor, ang_vel: Tensor, rotor_speed: Tensor) -> Tensor:
    """Return the inputs u, (E, 7), from velocities [m/s, rad/s], body, each (E, 3), and rotor speeds [rad/s], (E, R)."""
    return torch.cat((air_velocity, ang_vel, rotor_speed.square().mean(-1, keepdim=True)), dim=-1)


def network(values: Tensor, hidden: Sequence[Layer], output: Layer) -> Tensor:
    """Return the outputs of layers with tanh and of a last one without, (E, O), for standardised inputs (E, D)."""
    for weights, bias in hidden:
        values = torch.tanh(times(values, weights.T) + bias)
    weights, bias = output
    return times(values, weights.T) + bias


class LearnedResidual(WrenchEffect):
    """The network of one robot file; it is not registered, because it needs the numbers of that file."""

    name = "learned_residual"
    summary = "force and torque learned from flights, where no named effect fits"
    parameters = (Parameter("share", "-", 0.0, 1.0, 0.1, "share of the network's output; 1 in robot files"),)
    excitation = "any motion; beyond what was flown it fades to zero"
    confused_with = ()
    rotors = ("reversible", "slew", "dead_band")

    def __init__(
        self, cfg: LearnedResidualCfg, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
    ) -> None:
        """Store the numbers as tensors; a kernel has them as constants."""

        def put(values: object) -> Tensor:
            return torch.tensor(values, dtype=dtype, device=device)

        self.cfg = cfg
        self._low, self._high, self._limit = put(cfg.low), put(cfg.high), put(cfg.limit)
        self._centre, self._scale, self._whitening = put(cfg.centre), put(cfg.scale), put(cfg.whitening)
        self._hidden = [(put(layer.weights), put(layer.bias)) for layer in cfg.hidden]
        self._output = put(cfg.output.weights), put(cfg.output.bias)

    def to_dtype(self, dtype: torch.dtype) -> "LearnedResidual":
        """Return the same network in another float type."""
        return LearnedResidual(self.cfg, dtype=dtype, device=self._low.device)

    def distance(self, felt: Tensor) -> Tensor:
        """Return the squared Mahalanobis distance q of inputs (E, 7), (E, 1): above 1 outside the training data."""
        return times((felt - self._centre) / self._scale, self._whitening.T).square().sum(-1, keepdim=True)

    def evaluate(self, felt: Tensor) -> Tensor:
        """Return force [N] and torque [N m], body axes, (E, 6), for inputs (E, 7)."""
        values = (torch.minimum(torch.maximum(felt, self._low), self._high) - self._centre) / self._scale
        values = network(values, self._hidden, self._output)
        near = ((4.0 - self.distance(felt)) / 3.0).clamp(0.0, 1.0)
        return near * near * (3.0 - 2.0 * near) * torch.minimum(torch.maximum(values, -self._limit), self._limit)

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque, (E, 6)."""
        return params * self.evaluate(network_inputs(condition.air_velocity, condition.ang_vel, condition.rotor_speed))
