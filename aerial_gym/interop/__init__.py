"""Where torch and Warp meet: devices, streams and threads."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.interop.devices import resolve_device
    from aerial_gym.interop.launches import RecordedLaunch, compile_ahead, wait_for, wait_for_all
    from aerial_gym.interop.streams import on_torch_stream, start_warp
    from aerial_gym.interop.threads import launch_side_by_side, one_thread, split

__all__ = [
    "RecordedLaunch",
    "compile_ahead",
    "launch_side_by_side",
    "on_torch_stream",
    "one_thread",
    "resolve_device",
    "split",
    "start_warp",
    "wait_for",
    "wait_for_all",
]

__getattr__, __dir__ = exports(__name__, __file__)
