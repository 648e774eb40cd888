"""Where torch and Warp meet: devices and streams."""

from aerial_gym.interop.devices import resolve_device
from aerial_gym.interop.streams import on_torch_stream

__all__ = ["on_torch_stream", "resolve_device"]
