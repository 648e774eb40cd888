"""Where torch and Warp meet: devices and streams."""

from aerial_gym.interop.devices import resolve_device
from aerial_gym.interop.streams import on_torch_stream, start_warp

__all__ = ["on_torch_stream", "resolve_device", "start_warp"]
