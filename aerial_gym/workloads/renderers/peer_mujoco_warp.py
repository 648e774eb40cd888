# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
"""MuJoCo Warp's renderer: analytic shapes under a tree of bounding boxes per world.

Its rays are those of its own pinhole camera, through the same pixels. The tree is fitted once and not for every image,
which favours it: ours finds moved obstacles anew in every image. Only depth is asked for, and segmentation if wanted.
"""

from collections.abc import Callable

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_scene import mocap_poses, movable_model

PACKAGES = ("mujoco-warp", "mujoco", "warp-lang")


def make_renderer(
    scene: dict[str, np.ndarray], device: str
) -> tuple[Callable[[], None], Callable[[], tuple[np.ndarray, np.ndarray | None]]]:
    """Return the function that draws the images and the function that returns them."""
    wp.config.quiet = True
    envs, (rows, columns), segment = len(scene["position"]), scene["direction"].shape[:2], bool(scene["segmentation"])
    model = mujoco.MjModel.from_xml_string(movable_model(scene))
    data = mujoco.MjData(model)
    position, attitude = mocap_poses(scene)
    data.mocap_pos[:], data.mocap_quat[:] = position[0], attitude[0]
    mujoco.mj_forward(model, data)
    with wp.ScopedDevice(device):
        worlds, on_device = mjw.put_data(model, data, nworld=envs), mjw.put_model(model)
        worlds.mocap_pos.assign(position.astype(np.float32))
        worlds.mocap_quat.assign(attitude.astype(np.float32))
        context = mjw.create_render_context(
            model, nworld=envs, cam_res=(columns, rows), render_rgb=False, render_depth=True, render_seg=segment,
            use_textures=False,
        )  # fmt: skip
        mjw.forward(on_device, worlds)
        mjw.refit_bvh(on_device, worlds, context)

    def draw() -> None:
        with wp.ScopedDevice(device):
            mjw.render(on_device, worlds, context)

    def images() -> tuple[np.ndarray, np.ndarray | None]:
        depth = context.depth_data.numpy().reshape(envs, rows, columns)
        depth = np.where(depth <= 0.0, -1.0, depth)
        if not segment:
            return depth, None
        geometry = context.seg_data.numpy().reshape(envs, rows, columns, 2)[..., 0]
        return depth, np.where(geometry < 0, -2, scene["identity"][geometry])

    return draw, images
