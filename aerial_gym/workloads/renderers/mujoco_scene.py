"""A scene as a MuJoCo model; geometry p is part p."""

import numpy as np


def static_model(scene: dict[str, np.ndarray], env: int) -> str:
    """Return the model of one environment, MJCF, with every part fixed to the world and the camera in its place."""
    poses = zip(scene["position"][env], scene["attitude"][env], strict=True)
    parts = _geometry_elements(scene, [_pose_attributes(*pose) for pose in poses])
    pose = _pose_attributes(scene["camera_position"][env], scene["camera_attitude"][env])
    return _model_text("".join(parts) + f"<body {pose}>{_camera_element(scene)}</body>")


def movable_model(scene: dict[str, np.ndarray]) -> str:
    """Return one model for all environments, MJCF: a mocap body for each part, and a last one for the camera."""
    parts = _geometry_elements(scene, [""] * len(scene["kind"]))
    bodies = [f'<body mocap="true">{inside}</body>' for inside in (*parts, _camera_element(scene))]
    return _model_text("".join(bodies))


def mocap_poses(scene: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (E, P + 1, 3) and attitudes wxyz (E, P + 1, 4) of the mocap bodies."""
    position = np.concatenate((scene["position"], scene["camera_position"][:, None]), axis=1)
    attitude = np.concatenate((scene["attitude"], scene["camera_attitude"][:, None]), axis=1)
    return position, attitude[..., [3, 0, 1, 2]]


def _geometry_elements(scene: dict[str, np.ndarray], poses: list[str]) -> list[str]:
    geometries = []
    for kind, size, pose in zip(scene["kind"].tolist(), scene["size"].tolist(), poses, strict=True):
        half = [0.5 * edge for edge in size]
        numbers = {"box": half, "floor": [*half[:2], 1.0], "sphere": size[:1], "cylinder": [size[0], half[1]]}
        name = "plane" if kind == "floor" else kind
        geometries.append(f'<geom type="{name}" size="{_number_text(numbers[kind])}" {pose}/>')
    return geometries


def _camera_element(scene: dict[str, np.ndarray]) -> str:
    return f'<camera xyaxes="0 -1 0 0 0 1" fovy="{float(scene["vfov_deg"])!r}"/>'  # looks along x of its body, z up


def _pose_attributes(position: np.ndarray, attitude: np.ndarray) -> str:
    return f'pos="{_number_text(position.tolist())}" quat="{_number_text(attitude[[3, 0, 1, 2]].tolist())}"'


def _number_text(numbers: list[float]) -> str:
    return " ".join(map(repr, numbers))


def _model_text(inside: str) -> str:
    return f"<mujoco><worldbody>{inside}</worldbody></mujoco>"
