"""Names of things and tensors of things: ``Registry`` and the Global Tensor Dictionary."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.registry.registry import Registry
    from aerial_gym.registry.tensors import GlobalTensorDictionary, TensorSpec

__all__ = ["GlobalTensorDictionary", "Registry", "TensorSpec"]

__getattr__, __dir__ = exports(__name__, __file__)
