# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
"""MuJoCo's ``mj_multiRay``, C, float64: all rays of a camera in one call, analytic shapes fixed to the world; CPU only.

Its rays are exactly ours. Each environment has a model of its own. It gives distances along the rays and what each meets in
one go; that distances become depths is not timed, which favours it.
"""

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco_scene import static_model

PACKAGES = ("mujoco",)
FORWARD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])  # Our camera's frame to MuJoCo's, -z forward


def make_renderer(
    scene: dict[str, np.ndarray], device: str
) -> tuple[Callable[[], None], Callable[[], tuple[np.ndarray, np.ndarray | None]]]:
    """Return the function that draws the images and the function that returns them."""
    if device != "cpu":
        raise SystemExit("mj_multiRay runs on the CPU only")
    envs, (rows, columns) = len(scene["position"]), scene["direction"].shape[:2]
    rays = scene["direction"].reshape(-1, 3).astype(np.float64)
    worlds = []
    for env in range(envs):
        model = mujoco.MjModel.from_xml_string(static_model(scene, env))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        to_world = data.cam_xmat[0].reshape(3, 3) @ FORWARD
        worlds.append((model, data, data.cam_xpos[0].copy(), (rays @ to_world.T).ravel()))
    distance, geometry = np.zeros((envs, len(rays))), np.zeros((envs, len(rays)), dtype=np.int32)

    def draw() -> None:
        for env, (model, data, origin, headings) in enumerate(worlds):
            mujoco.mj_multiRay(
                m=model, d=data, pnt=origin, vec=headings, geomgroup=None, flg_static=1, bodyexclude=-1,
                geomid=geometry[env], dist=distance[env], normal=None, nray=len(rays), cutoff=1e3,
            )  # fmt: skip

    def images() -> tuple[np.ndarray, np.ndarray | None]:
        depth = np.where(distance < 0.0, -1.0, distance * rays[:, 0])
        seen = np.where(geometry < 0, -2, scene["identity"][geometry])
        return depth.reshape(envs, rows, columns), seen.reshape(envs, rows, columns)

    return draw, images
