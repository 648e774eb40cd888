"""Names of things and tensors of things: ``Registry`` and the Global Tensor Dictionary."""

from aerial_gym.registry.registry import Registry
from aerial_gym.registry.tensors import GlobalTensorDictionary, TensorSpec

__all__ = ["GlobalTensorDictionary", "Registry", "TensorSpec"]
