"""Configuration classes in the style of the Aerial Gym Simulator 2.0.1: every class from scratch, with every attribute.

Names of attributes, numbers and counts are those of the inventory of that simulator; the classes are written anew.
"""

import numpy as np
from aerial_gym.config.asset_config import dynamic_env_object_config, env_object_config, lidar_nav_env_config
from aerial_gym.config.asset_config.env_object_config import BACK_WALL_SEMANTIC_ID, FRONT_WALL_SEMANTIC_ID
from aerial_gym.config.robot_config.base_quad_config import BaseQuadCfg as GeneratedQuadCfg
from aerial_gym.config.sensor_config.camera_config.base_depth_camera_config import BaseDepthCameraConfig
from aerial_gym.config.sensor_config.camera_config.base_normal_faceID_camera_config import BaseNormalFaceIDCameraConfig
from aerial_gym.config.sensor_config.camera_config.stereo_camera_config import StereoCameraConfig
from aerial_gym.config.sensor_config.imu_config.base_imu_config import BaseImuConfig
from aerial_gym.config.sensor_config.lidar_config.base_lidar_config import BaseLidarConfig
from aerial_gym.config.sensor_config.lidar_config.fake_radar_config import fake_radar_config
from aerial_gym.config.sensor_config.lidar_config.rslidar_airy_config import RSLidar_Airy_Config
from aerial_gym.robots.base_multirotor import BaseMultirotor
from aerial_gym.robots.base_reconfigurable import BaseReconfigurable
from aerial_gym.robots.base_rov import BaseROV
from aerial_gym.robots.morphy import Morphy

from aerial_gym import AERIAL_GYM_DIRECTORY

RESOURCES = f"{AERIAL_GYM_DIRECTORY}/resources"


def quad_matrix(arm: float, ratio: float, yaw: tuple[int, ...] = (-1, 1, -1, 1)) -> list[list[float]]:
    roll, pitch = (-arm, -arm, arm, arm), (-arm, arm, arm, -arm)
    return [[0.0] * 4, [0.0] * 4, [1.0] * 4, list(roll), list(pitch), [ratio * sign for sign in yaw]]


def px4_matrix(ratio: float) -> list[list[float]]:
    """Return a matrix with arms of 0.13 m that contradicts the URDF and the motor directions, as there."""
    return [
        *([0.0] * 4, [0.0] * 4, [1.0] * 4),
        *([-0.13, 0.13, 0.13, -0.13], [-0.13, 0.13, -0.13, 0.13], [-ratio, ratio, -ratio, ratio]),
    ]


def cube_matrix() -> np.ndarray:
    """Return the matrix of eight tilted motors on a cube, as there: its torque ratio is 0.1 m, that of the motors 0.01 m."""
    a, b, c, place = 0.78867513, 0.21132487, 0.57735027, 0.1732051
    axes = np.array(
        [[-a, b, c], [b, a, -c], [-b, -a, -c], [a, -b, c], [a, -b, c], [-b, -a, -c], [b, a, -c], [-a, b, c]]
    )
    corners = place * np.array([[x, y, z] for z in (1, -1) for y in (1, -1) for x in (1, -1)])
    spins = np.array([1, -1] * 4)
    return np.concatenate((axes.T, (np.cross(corners, axes) - 0.1 * spins[:, None] * axes).T))


SIDE = ([0.1, 0.15, 0.15], [0.2, 0.85, 0.85])
QUAD = {"level": "motor_link", "directions": [1, -1, 1, -1], "matrix": quad_matrix(0.13, 0.01), "position": SIDE}
QUAD |= {"fall": (0.04, 0.04), "yaw": np.pi / 6}
PX4 = {"level": "motor_link", "directions": [1, 1, -1, -1]}
CUBE = {"directions": [1, -1] * 4, "matrix": cube_matrix(), "rps": False, "thrust": (-6.25, 6.25), "rise": (0.01, 0.03)}


def robot_class(
    urdf: str, *, directions: list[int], matrix: object, level: str = "motor_link", rps: bool = True, ratio: float = 0.01,
    constant: tuple[float, float] = (9.26312e-6, 1.826312e-5), rise: tuple[float, float] = (0.04, 0.04),
    fall: tuple[float, float] = (0.005, 0.005), thrust: tuple[float, float] = (0.0, 2.0), disturbed: bool = False,
    position: tuple[list[float], list[float]] = ([0.0] * 3, [1.0] * 3), yaw: float = np.pi, camera: object = None,
    lidar: object = None, joints: type | None = None, held: bool = False, imu: bool = False,
) -> type:  # fmt: skip
    """Return a robot class with every attribute that a class of that simulator has."""

    class RobotCfg:
        class init_config:
            min_init_state = [*position[0], 0, 0, -yaw, 1.0, *[-0.2] * 6]
            max_init_state = [*position[1], 0, 0, yaw, 1.0, *[0.2] * 6]

        class sensor_config:
            enable_camera = camera is not None
            camera_config = camera or BaseDepthCameraConfig
            enable_lidar = lidar is not None
            lidar_config = lidar or BaseLidarConfig
            enable_imu = imu
            imu_config = BaseImuConfig

        class disturbance:
            enable_disturbance = disturbed
            prob_apply_disturbance = 0.05
            max_force_and_torque_disturbance = [1.5, 1.5, 1.5, 0.25, 0.25, 0.25]

        class damping:
            linvel_linear_damping_coefficient = [0.0, 0.0, 0.0]
            linvel_quadratic_damping_coefficient = [0.0, 0.0, 0.0]
            angular_linear_damping_coefficient = [0.0, 0.0, 0.0]
            angular_quadratic_damping_coefficient = [0.0, 0.0, 0.0]

        class robot_asset:
            asset_folder = f"{RESOURCES}/robots/{urdf.split('/')[0]}"
            file = urdf.split("/")[1]
            name = "base_quadrotor"
            base_link_name = "base_link"
            disable_gravity = False
            collapse_fixed_joints = False
            fix_base_link = held
            collision_mask = 1
            replace_cylinder_with_capsule = False
            flip_visual_attachments = True
            density = 0.000001
            angular_damping = 0.02
            linear_damping = 0.02
            max_angular_velocity = 100.0
            max_linear_velocity = 100.0
            armature = 0.00001
            semantic_id = 0
            per_link_semantic = False
            min_state_ratio = [0.1, 0.1, 0.1, 0, 0, -np.pi, 1.0, 0, 0, 0, 0, 0, 0]
            max_state_ratio = [0.3, 0.9, 0.9, 0, 0, np.pi, 1.0, 0, 0, 0, 0, 0, 0]
            max_force_and_torque_disturbance = [0.1, 0.1, 0.1, 0.05, 0.05, 0.05]
            color = None
            semantic_masked_links = {}
            keep_in_env = True
            min_position_ratio = None
            max_position_ratio = None
            min_euler_angles = [-np.pi, -np.pi, -np.pi]
            max_euler_angles = [np.pi, np.pi, np.pi]
            place_force_sensor = True
            force_sensor_parent_link = "base_link"
            force_sensor_transform = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
            use_collision_mesh_instead_of_visual = False

        class control_allocator_config:
            num_motors = len(directions)
            force_application_level = level
            application_mask = [1 + len(directions) + k for k in range(len(directions))]
            motor_directions = directions
            allocation_matrix = matrix

            class motor_model_config:
                use_rps = rps
                motor_thrust_constant_min, motor_thrust_constant_max = constant
                motor_time_constant_increasing_min, motor_time_constant_increasing_max = rise
                motor_time_constant_decreasing_min, motor_time_constant_decreasing_max = fall
                min_thrust, max_thrust = thrust
                max_thrust_rate = 100000.0
                thrust_to_torque_ratio = ratio
                use_discrete_approximation = False
                integration_scheme = "euler"

    if joints is not None:
        RobotCfg.reconfiguration_config = joints  # pyright: ignore[reportAttributeAccessIssue]
    return RobotCfg


def snake_class(name: str, motors: int, dof_mode: str = "velocity") -> type:
    count = 2 * (motors - 1)
    gains = {"position": (50.0, 10.0), "velocity": (0.0, 10.0), "effort": (1.5, 0.3)}[dof_mode]

    class reconfiguration_config:
        init_state_min = [[-np.pi / 2.0, -0.3] * (count // 2), [-0.1] * count]
        init_state_max = [[np.pi / 2.0, 0.3] * (count // 2), [0.1] * count]
        stiffness = [gains[0]] * count
        damping = [gains[1]] * count

    reconfiguration_config.dof_mode = dof_mode  # pyright: ignore[reportAttributeAccessIssue]
    return robot_class(
        f"{name}/model.urdf", directions=([-1, 1] * motors)[:motors], rps=False, rise=(0.005, 0.005), thrust=(0.0, 15.0),
        matrix=quad_matrix(0.13, 0.01) if motors == 4 else np.ones((6, motors)), disturbed=True, joints=reconfiguration_config,
    )  # fmt: skip


class arms:
    dof_mode = "effort"
    init_state_min = [[-0.1] * 8, [-0.05] * 8]
    init_state_max = [[0.1] * 8, [0.05] * 8]
    stiffness = [0.2, 1.0] * 4
    damping = [0.025, 0.02] * 4
    custom_nonlinear_stiffness = -230.0
    custom_linear_damping = -5834.0


class arms_for_identification(arms):
    init_state_min = [[0.29, 0.0] * 4, [0.0] * 8]
    init_state_max = [[0.29, 0.0] * 4, [0.0] * 8]


MORPHY = {"matrix": quad_matrix(0.0785, 0.01, (1, -1, 1, -1)), "directions": [-1, 1, -1, 1], "rps": False}
MORPHY |= {"rise": (0.01, 0.03), "yaw": np.pi / 6}
LMF2 = {
    "level": "base_link",
    "directions": [1, -1, 1, -1],
    "rise": (0.05, 0.08),
    "thrust": (0.1, 10.0),
    "disturbed": True,
}
LMF2 |= {"position": SIDE, "yaw": np.pi / 6, "ratio": 0.07, "matrix": quad_matrix(0.13, 0.07)}

RANDOM_AXES = np.array([
    [0.0, 1.0, 0.0], [-0.32139380, -0.34202014, -0.88302222], [-0.45451948, -0.70710678, 0.54167522],
    [-0.34202014, 0.0, 0.93969262], [0.96984631, -0.17364818, 0.17101007], [0.34202014, 0.93969262, 0.0],
    [0.86602540, 0.5, 0.0], [-0.75440651, -0.17364818, 0.63302222],
])  # fmt: skip
RANDOM_TORQUES = np.array([
    [0.175, 0.01, 0.28248737], [0.12378874, 0.27884513, -0.14173549], [-0.05697837, -0.04328523, -0.08585411],
    [0.13497717, -0.27206177, 0.03848589], [0.0336959, -0.19779386, -0.33346803], [-0.26653414, 0.08636871, 0.08367414],
    [-0.07883975, 0.15655445, 0.00846778], [-0.0206894, -0.17126129, -0.08743363],
])  # fmt: skip


class RootLinkCfg(GeneratedQuadCfg):
    class robot_asset(GeneratedQuadCfg.robot_asset):
        file = "model.urdf"

    control_allocator_config = robot_class(
        "quad/model.urdf", **QUAD | {"level": "root_link", "fall": (0.005, 0.005)}, constant=(1.826312e-5, 1.826312e-5),
        rise=(0.01, 0.03), thrust=(0.0, 10.0),
    ).control_allocator_config  # fmt: skip


ROBOTS: dict[str, tuple[type, type]] = {
    "base_quadrotor": (BaseMultirotor, robot_class("quad/quad.urdf", **QUAD)),
    "base_quadrotor_with_imu": (BaseMultirotor, robot_class("quad/quad.urdf", **QUAD, imu=True)),
    "base_quadrotor_with_camera": (BaseMultirotor, robot_class("quad/quad.urdf", **QUAD, camera=BaseDepthCameraConfig)),
    "base_quadrotor_with_camera_imu": (
        BaseMultirotor, robot_class("quad/quad.urdf", **QUAD, camera=BaseDepthCameraConfig, imu=True),
    ),
    "base_quadrotor_with_lidar": (BaseMultirotor, robot_class("quad/quad.urdf", **QUAD, lidar=BaseLidarConfig)),
    "base_quadrotor_with_faceid_normal_camera": (
        BaseMultirotor, robot_class("quad/quad.urdf", **QUAD, camera=BaseNormalFaceIDCameraConfig),
    ),
    "base_quadrotor_with_stereo_camera": (BaseMultirotor, robot_class("quad/quad.urdf", **QUAD, camera=StereoCameraConfig)),
    "base_quad_root_link_control": (BaseMultirotor, RootLinkCfg),
    "base_octarotor": (BaseMultirotor, robot_class("octarotor/octarotor.urdf", **CUBE, disturbed=True)),
    "base_random": (
        BaseMultirotor,
        robot_class("random/random.urdf", matrix=np.concatenate((RANDOM_AXES.T, RANDOM_TORQUES.T)), directions=[-1, 1] * 4,
                    rps=False, rise=(0.01, 0.03), thrust=(-5.0, 5.0), disturbed=True),
    ),
    "base_rov": (BaseROV, robot_class("BlueROV/rov.urdf", **CUBE, disturbed=True)),
    "lmf1": (BaseMultirotor, robot_class("lmf1/model.urdf", **PX4, matrix=px4_matrix(0.05), ratio=0.05, thrust=(0.0, 20.0),
                                         constant=(5.487e-6, 5.487e-6), rise=(0.025, 0.025), fall=(0.025, 0.025))),
    "lmf2": (BaseMultirotor, robot_class("lmf2/model.urdf", **LMF2, camera=BaseDepthCameraConfig)),
    "lmf2_radar": (BaseMultirotor, robot_class("lmf2/model.urdf", **LMF2, lidar=fake_radar_config)),
    "magpie": (BaseMultirotor, robot_class("magpie/model.urdf", **LMF2 | {
        "matrix": quad_matrix(0.13, 0.02), "ratio": 0.02, "rise": (0.01, 0.02), "thrust": (0.1, 12.0), "yaw": np.pi},
        fall=(0.005, 0.015), lidar=RSLidar_Airy_Config)),
    "x500": (BaseMultirotor, robot_class("x500/model.urdf", **PX4, matrix=px4_matrix(0.025), ratio=0.025, thrust=(0.0, 20.0),
                                         constant=(8.54858e-6, 8.54858e-6), rise=(0.0125, 0.0125), fall=(0.025, 0.025))),
    "tinyprop": (BaseMultirotor, robot_class("tinyprop/tinyprop.urdf", **QUAD | {
        "matrix": quad_matrix(0.16, 0.01), "fall": (0.047, 0.047), "position": ([-0.7] * 3, [0.7] * 3), "yaw": np.pi},
        constant=(1.286412e-5, 1.286412e-5), rise=(0.047, 0.047), thrust=(0.2, 1.2))),
    "morphy": (Morphy, robot_class("morphy/morphy.urdf", **MORPHY, joints=arms)),
    "morphy_fixed_base": (Morphy, robot_class("morphy/morphy.urdf", **MORPHY, joints=arms_for_identification, held=True)),
    "morphy_stiff": (BaseMultirotor, robot_class("morphy/morphy_stiff.urdf", **MORPHY | {
        "matrix": quad_matrix(0.0785, 0.01), "directions": [1, -1, 1, -1]}, disturbed=True)),
    "snakey": (BaseReconfigurable, snake_class("snakey", 4)),
    "snakey5": (BaseReconfigurable, snake_class("snakey5", 5)),
    "snakey6": (BaseReconfigurable, snake_class("snakey6", 6)),
}  # fmt: skip
"""Robot class and configuration class by the name under which that simulator registers the robot."""


def obstacle_class(base: type, folder: str, state_min: list[float], state_max: list[float], **values: object) -> type:
    """Return an obstacle class with every attribute that a class of that simulator has."""
    attributes = {
        "asset_folder": f"{RESOURCES}/models/environment_assets/{folder}", "collision_mask": 1, "per_link_semantic": False,
        "collapse_fixed_joints": True, "semantic_id": -1, "color": [170, 66, 66], "keep_in_env": False,
        "min_state_ratio": [*state_min, 1.0, *[0.0] * 6], "max_state_ratio": [*state_max, 1.0, *[0.0] * 6],
        "min_position_ratio": [0.3, 0.05, 0.05], "max_position_ratio": [0.85, 0.95, 0.95],
        "specified_position": [-1000.0] * 3, "min_euler_angles": [0.0, 0.0, -np.pi / 3.0],
        "max_euler_angles": [0.0, 0.0, np.pi / 3.0],
    }  # fmt: skip
    return type("asset_params", (base,), attributes | values)


class asset_state_params:
    num_assets = 1
    asset_folder = f"{RESOURCES}/models/environment_assets"
    file = None
    disable_gravity = False
    replace_cylinder_with_capsule = True
    flip_visual_attachments = True
    density = 0.001
    angular_damping = 0.1
    linear_damping = 0.1
    max_angular_velocity = 100.0
    max_linear_velocity = 100.0
    armature = 0.001
    fix_base_link = True
    specific_filepath = None
    body_semantic_label = 0
    link_semantic_label = 0
    semantic_masked_links = {}
    place_force_sensor = False
    force_sensor_parent_link = "base_link"
    force_sensor_transform = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    use_collision_mesh_instead_of_visual = False


class twist_params(asset_state_params):
    fix_base_link = False
    disable_gravity = True


def obstacle_classes(
    base: type,
    panels: tuple[int, list[float], list[float]],
    objects: tuple[int, list[float], list[float]],
    *,
    keep: bool,
) -> dict[str, type]:
    """Return the classes of all obstacles by their names in ``asset_type_to_dict_map``.

    Panels and objects are given by number, lowest and highest place.
    """
    every, back = [np.pi] * 3, [-np.pi] * 3
    centres = {
        "front_wall": [1.0, 0.5, 0.5], "back_wall": [0.0, 0.5, 0.5], "left_wall": [0.5, 1.0, 0.5],
        "right_wall": [0.5, 0.0, 0.5], "bottom_wall": [0.5, 0.5, 0.0], "top_wall": [0.5, 0.5, 1.0],
    }  # fmt: skip
    classes = {
        "panels": obstacle_class(base, "panels", [*panels[1], 0.0, 0.0, -np.pi / 3.0], [*panels[2], 0.0, 0.0, np.pi / 3.0],
                                 num_assets=panels[0], keep_in_env=keep),
        "thin": obstacle_class(base, "thin", [0.3, 0.05, 0.05, *back], [0.85, 0.95, 0.95, *every], num_assets=0),
        "trees": obstacle_class(base, "trees", [0.1, 0.1, 0.0, 0, -np.pi / 6.0, -np.pi], [0.9, 0.9, 0.0, 0, np.pi / 6.0, np.pi],
                                per_link_semantic=True, keep_in_env=True, semantic_masked_links={}),
        "objects": obstacle_class(base, "objects", [*objects[1], *back], [*objects[2], *every], num_assets=objects[0]),
        "tiles": obstacle_class(base, "tile_meshes", [0.5] * 3 + [0.0] * 3, [0.5] * 3 + [0.0] * 3, keep_in_env=keep),
    }  # fmt: skip
    for number, (wall, centre) in enumerate(centres.items(), FRONT_WALL_SEMANTIC_ID):
        place = [*centre, 0.0, 0.0, 0.0]
        more = {"file": f"{wall}.urdf", "specific_filepath": "cube.urdf", "semantic_id": number, "keep_in_env": keep}
        classes[wall] = obstacle_class(base, "walls", place, place, **more)
    assert classes["back_wall"].semantic_id == BACK_WALL_SEMANTIC_ID
    return classes


PANELS, OBJECTS = ([0.3, 0.05, 0.05], [0.85, 0.95, 0.95]), ([0.3, 0.05, 0.05], [0.85, 0.9, 0.9])
CORRIDOR = obstacle_classes(asset_state_params, (3, *PANELS), (35, *OBJECTS), keep=True)
HALL = obstacle_classes(
    asset_state_params, (15, [0.35, 0.0, 0.0], [1.0] * 3), (70, [0.3, 0.0, 0.0], [1.0] * 3), keep=False
)
MOVING = obstacle_classes(twist_params, (3, *PANELS), (40, *OBJECTS), keep=True)


def environment_class(
    lower: list[list[float]], upper: list[list[float]], classes: dict[str, type], included: tuple[str, ...], *,
    steps: int = 10, ground: bool = False, env_actions: int = 4,
) -> type:  # fmt: skip
    """Return an environment class with every attribute that a class of that simulator has, and its helper ``e_s``."""

    class EnvironmentCfg:
        class env:
            num_envs = 3
            num_env_actions = env_actions
            env_spacing = 1.0
            num_physics_steps_per_env_step_mean = steps
            num_physics_steps_per_env_step_std = 0
            render_viewer_every_n_steps = 2
            collision_force_threshold = 0.05
            manual_camera_trigger = False
            reset_on_collision = True
            create_ground_plane = ground
            sample_timestep_for_latency = True
            perturb_observations = True
            keep_same_env_for_num_episodes = 1
            write_to_sim_at_every_timestep = ground
            use_warp = True
            e_s = env_spacing
            lower_bound_min, lower_bound_max = lower
            upper_bound_min, upper_bound_max = upper

        class env_config:
            include_asset_type = {name: name in included for name in classes}
            asset_type_to_dict_map = classes

    return EnvironmentCfg


SQUARE = [[-1.0] * 3] * 2, [[1.0] * 3] * 2
ROOM = [[-2.0, -4.0, -3.0], [-1.0, -2.5, -2.0]], [[9.0, 2.5, 2.0], [10.0, 4.0, 3.0]]
WALLS = ("front_wall", "back_wall", "left_wall", "right_wall", "bottom_wall", "top_wall")

ENVIRONMENTS: dict[str, type] = {
    "empty_env": environment_class(*SQUARE, {}, (), steps=1, env_actions=0),
    "empty_env_2ms": environment_class(*SQUARE, {}, (), steps=5, env_actions=0),
    "env_with_obstacles": environment_class(*ROOM, CORRIDOR, ("panels", "objects", *WALLS)),
    "env_with_lidar_nav_obstacles": environment_class(
        [[-7.5, -7.5, -5.0], [-5.0, -5.0, -3.0]], [[5.0, 5.0, 3.0], [7.5, 7.5, 5.0]], HALL, ("panels", "objects", *WALLS)
    ),
    "forest_env": environment_class(
        [[-5.0, -5.0, -1.0]] * 2, [[5.0, 5.0, 3.0]] * 2, CORRIDOR, ("trees", "objects", "bottom_wall")
    ),
    "dynamic_env": environment_class(
        [[-2.0, -4.0, 0.0], [-1.0, -2.5, 0.0]], [[9.0, 2.5, 4.0], [10.0, 4.0, 5.0]], MOVING, ("objects",), ground=True,
        env_actions=6,
    ),
}  # fmt: skip
"""Environment classes by the name under which that simulator registers them."""

MODULES = (env_object_config, lidar_nav_env_config, dynamic_env_object_config)
