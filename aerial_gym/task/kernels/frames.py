"""Warp kernel of the history of images. Letters: E environments, P numbers of an image."""

from functools import cache
from typing import Any

import warp as wp


@cache
def make_image_history_kernel(source: Any, target: Any, history: int) -> wp.Kernel:
    """Return the kernel for a type of Warp in, one out, and a number of frames."""
    rounding = 0.5 if target is wp.uint8 else 0.0

    @wp.kernel(module="unique", enable_backward=False)
    def write_frame(
        image: wp.array2d[source],  # (E, P), negative where a pixel has nothing
        mask: wp.array[wp.bool],  # (E,) whose images are taken
        begun: wp.array[wp.bool],  # (E,) whose episode has just begun
        # params
        largest: float,  # image value of 1, in the unit of the image
        top: float,  # output for 1
        empty: float,  # share of a pixel that has nothing
        # out
        frames_out: wp.array3d[target],  # (E, history, P), oldest first
    ):
        """Write the image as the newest frame, or as all frames where an episode has just begun."""
        env, pixel = wp.tid()
        if not mask[env]:
            return
        value = float(image[env, pixel])
        share = wp.where(value >= 0.0, wp.clamp(value / largest, 0.0, 1.0), empty)
        new = target(share * top + wp.static(rounding))
        for k in range(wp.static(history - 1)):
            frames_out[env, k, pixel] = wp.where(begun[env], new, frames_out[env, k + 1, pixel])
        frames_out[env, wp.static(history - 1), pixel] = new

    return write_frame
