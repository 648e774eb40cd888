"""Where torch and Warp meet: devices, streams and threads."""

from aerial_gym.interop.devices import resolve_device
from aerial_gym.interop.streams import on_torch_stream, start_warp
from aerial_gym.interop.threads import one_thread

__all__ = ["on_torch_stream", "one_thread", "resolve_device", "start_warp"]
