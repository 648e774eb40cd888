"""Interoperation of torch and Warp: devices, streams and threads."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.interop.launches import (
        ReusableLaunch,
        compile_ahead,
        launch_on_cpu,
        launch_side_by_side,
        make_struct,
        map_in_threads,
        on_device,
        on_torch_stream,
        one_thread,
        record_graph,
        split,
        wait_for_kernel,
    )
    from aerial_gym.interop.settings import (
        action_tensor,
        plain_device,
        resolve_device,
        usual_settings,
        with_usual_settings,
    )
    from aerial_gym.interop.warp_start import start_warp

__all__ = [
    "ReusableLaunch", "action_tensor", "compile_ahead", "launch_on_cpu", "launch_side_by_side", "make_struct",
    "map_in_threads", "on_device", "on_torch_stream", "one_thread", "plain_device", "record_graph", "resolve_device",
    "split", "start_warp", "usual_settings", "wait_for_kernel", "with_usual_settings",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
