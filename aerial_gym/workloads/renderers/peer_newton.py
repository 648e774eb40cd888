# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportArgumentType=false
"""Newton's camera sensor, Warp: analytic shapes under a tree of bounding boxes per world.

Pixels are drawn in tiles of 16x8 on a GPU and view by view on a CPU, where that is faster. Its rays are exactly ours. The
tree is built once and not refitted, which favours it: ours finds moved obstacles anew in every image. Only depth is asked
for, and the shapes' numbers for segmentation.
"""

from collections.abc import Callable

import newton
import numpy as np
import warp as wp
from newton.sensors import SensorCamera

PACKAGES = ("newton", "warp-lang")

FORWARD = wp.quat(0.5, -0.5, -0.5, 0.5)  # From a camera along -z, y up, to one along x, z up, xyzw


def make_renderer(
    scene: dict[str, np.ndarray], device: str
) -> tuple[Callable[[], None], Callable[[], tuple[np.ndarray, np.ndarray | None]]]:
    """Return the function that draws the images and the function that returns them."""
    wp.config.quiet = True
    envs, parts = scene["position"].shape[:2]
    rows, columns = scene["direction"].shape[:2]
    with wp.ScopedDevice(device):
        world = newton.ModelBuilder()
        for kind, size in zip(scene["kind"], scene["size"].tolist(), strict=True):
            _add_shape(world, str(kind), size)
        builder = newton.ModelBuilder()
        builder.replicate(world, envs)
        model = builder.finalize(device=device)
        model.shape_transform.assign(np.concatenate((scene["position"], scene["attitude"]), axis=-1).reshape(-1, 7))
        state = model.state()
        model.bvh_build_shapes(state)
        camera = SensorCamera(model, load_textures=False)
        orders = SensorCamera.RenderOrder
        camera.default_render_config.render_order = orders.VIEW_PRIORITY if device == "cpu" else orders.TILED
        camera.default_clear_data = SensorCamera.ClearData(clear_depth=-1.0)
        forward = wp.quat_to_matrix(FORWARD)
        rays = np.zeros((rows, columns, 1, 2, 3), dtype=np.float32)
        rays[:, :, 0, 1] = scene["direction"] @ np.array(forward).reshape(3, 3)  # from our camera's frame to its own
        poses = [
            wp.transform(wp.vec3(*position), wp.quat(*attitude) * FORWARD)
            for position, attitude in zip(
                scene["camera_position"].tolist(), scene["camera_attitude"].tolist(), strict=True
            )
        ]
        rays, poses = wp.array(rays, dtype=wp.vec3), wp.array(poses, dtype=wp.transform)
        depth = camera.allocate_image_depth_forward(envs, columns, rows)
        shape = camera.allocate_image_shape_index(envs, columns, rows) if scene["segmentation"] else None

    def draw() -> None:
        with wp.ScopedDevice(device):
            camera.update(
                state, poses, rays, forward_depth_image=depth, shape_index_image=shape, sync_deformables=False
            )

    def images() -> tuple[np.ndarray, np.ndarray | None]:
        if shape is None:
            return depth.numpy(), None
        index = shape.numpy().astype(np.int64)
        seen = scene["identity"][np.where(index < envs * parts, index, 0) % parts]
        return depth.numpy(), np.where(index < envs * parts, seen, -2)

    return draw, images


def _add_shape(world: newton.ModelBuilder, kind: str, size: list[float]) -> None:
    if kind == "box":
        world.add_shape_box(body=-1, hx=0.5 * size[0], hy=0.5 * size[1], hz=0.5 * size[2])
    elif kind == "floor":
        world.add_shape_plane(body=-1, width=size[0], length=size[1])
    elif kind == "sphere":
        world.add_shape_sphere(body=-1, radius=size[0])
    else:
        world.add_shape_cylinder(body=-1, radius=size[0], half_height=0.5 * size[1])
