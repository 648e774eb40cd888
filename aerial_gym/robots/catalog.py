"""Every robot that comes with the package, in one table."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import pi

from aerial_gym.config import CONFIG_DIR, load, summary_in
from aerial_gym.config.autopilots.px4 import Px4Cfg
from aerial_gym.config.joint import BASE, CreepCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import CapsuleCfg, CollisionCfg, RobotCfg, SphereCfg, load_robot
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.registry import Registry
from aerial_gym.robots.joints.snakes import snake

ROBOTS: Registry[RobotCfg] = Registry("robot")

_FOLDER = CONFIG_DIR / "robots"

for _name in (
    "base_quadrotor",
    "tinyprop",
    "crazyflie_21_brushless",
    "crazyflie_21",
    "neural_fly_quad",
    "omnidirectional_octarotor",
    "lmf1",
    "lmf2",
    "magpie",
    "x500",
    "base_quad_root_link_control",
    "base_octarotor",
    "base_random",
    "typhoon_hexarotor",
    "tilted_hexarotor",
    "coaxial_octarotor",
    "racing_quadrotor",
    "base_rov",
    "bluerov2_heavy",
    "tilt_tricopter",
    "morphy",
):
    _path = _FOLDER / f"{_name}.yaml"
    ROBOTS.register_later(_name, partial(load_robot, _path), summary=partial(summary_in, _path))


def _variant(summary: str, change: Callable[[RobotCfg], RobotCfg], *, of: str = "base_quadrotor") -> RobotCfg:
    """Return a registered robot with a change."""
    return replace(change(ROBOTS.get(of)), summary=summary)


def _carrying(*sensors: str) -> Callable[[RobotCfg], RobotCfg]:
    return partial(replace, sensors=sensors)


def _counted_twice(robot: RobotCfg) -> RobotCfg:
    """Twice the inertia: the motors stand in the base link there, and were added once more."""
    rows = tuple(tuple(2.0 * number for number in row) for row in robot.body.inertia)
    source = (
        "Aerial Gym Simulator 2.0.1, quad URDF, as it simulates it: the inertia of its base link, which is that of the motors, "
        "and the motors once more"
    )
    return replace(robot, body=replace(robot.body, inertia=(rows[0], rows[1], rows[2]), source=source))


def _on_skids(robot: RobotCfg) -> RobotCfg:
    """Two skids under the collision sphere of base_quadrotor, so that it does not roll where it lands."""
    skids = tuple(
        CapsuleCfg(center=(0.0, y, -0.19), radius=0.01, height=0.2, euler=(0.0, 0.5 * pi, 0.0)) for y in (0.1, -0.1)
    )
    source = "Chosen: two rods of 20 mm, 0.2 m long and apart, whose soles are 16 mm below the sphere"
    return replace(
        robot, collision=replace(robot.collision, capsules=skids, source=f"{robot.collision.source}. {source}")
    )


def _for_landing(robot: RobotCfg) -> RobotCfg:
    """Propellers of 5 inches, whose wake the ground holds up."""
    rotor = robot.the_rotor("the landing variant")
    source = (
        "Chosen: k of four rotors side by side, Sanchez-Cuevas, Heredia, Ollero (2017), Characterization of the aerodynamic "
        "ground effect"
    )
    return replace(
        robot,
        rotor=replace(rotor, radius=0.0635, source=f"{rotor.source} Radius chosen: propellers of 5 inches."),
        effects={"ground_effect": {"k": 2.5}},
        effects_source=source,
    )


def _with_load(robot: RobotCfg) -> RobotCfg:
    """A fifth of the vehicle's mass on a link of half a metre."""
    effects = {"slung_payload": {"mass": 0.05, "length": 0.5, "damping": 0.005}}
    return replace(robot, effects=effects, effects_source="Chosen: a swing that fades in 20 s (2 m / c)")


def _dragged(robot: RobotCfg) -> RobotCfg:
    """The drag of rotors in sideways flow, for each kilogram that of a measured quadrotor."""
    dx, dy = (share * robot.body.mass for share in (0.544, 0.386))  # 1/s
    source = (
        "Faessler, Franchi, Scaramuzza (2018), Differential flatness of quadrotor dynamics subject to rotor drag: their "
        "0.544 and 0.386 1/s times the mass"
    )
    return replace(robot, effects={"rotor_drag": {"dx": dx, "dy": dy, "dz": 0.0}}, effects_source=source)


def _braked_in_spin(robot: RobotCfg) -> RobotCfg:
    """The drag of each rotor where it is, in the plane in which it turns: it brakes a spin as a measured quadrotor's is.

    At hover four rotors at a distance l give the torque ``-4 kh w l² r`` to a spin r: that of the source for each kilogram and
    squared metre.
    """
    damping, mass, arm = 2.75e-3, 0.5, 0.17  # N m s/rad, kg, m
    rotor = robot.the_rotor("a drag of its spin")
    hover = 4.0 * rotor.speed_at(0.25 * robot.body.mass * STANDARD_GRAVITY)
    source = (
        "Mueller, D'Andrea (2014), Stability and control of a quadrocopter despite the complete loss of one, two, or three "
        "propellers, section V: a spin of their 0.5 kg with arms of 0.17 m is braked by 2.75e-3 N m s/rad, as public "
        "implementations of it agree; it balances their equilibrium without a propeller, 1.69e-2 m (2 * 2.05 - 1.025) N = "
        "2.75e-3 * 18.89 rad/s to 0.1 %. The paper itself was not at hand. Here as the drag of rotors"
    )
    kh = damping / (mass * arm**2) * robot.body.mass / hover
    return replace(robot, effects={"h_force_flapping": {"kh": kh, "kf": 0.0}}, effects_source=source)


def _in_gusts(robot: RobotCfg) -> RobotCfg:
    """Wind that wanders about zero by 3 m/s on each axis, within a second."""
    effects = {**robot.effects, "gusts": {"std": 3.0, "corr_time": 1.0}}
    return replace(robot, effects=effects, effects_source=f"{robot.effects_source}. Gusts: chosen")


def _sampled(robot: RobotCfg) -> RobotCfg:
    """Thrust to weight 1.15 to 7, where the robot has 3.26; inertia, lag and torque of rotors from racers to carriers; gusts.

    The inertia is drawn from the robot's, which is light, to ten times that; gusts from none to stronger than the robot's.
    """
    factors = {"rotor.thrust_map": (0.353, 2.146), "body.inertia": (1.0, 10.0), "rotor.time_constant": (0.25, 2.5)}
    factors |= {"rotor.torque_map": (0.3, 7.0)}
    randomize = {name: RandomizeCfg(distribution="log_uniform", low=a, high=b) for name, (a, b) in factors.items()}
    weather = {"effects.rotor_drag.dx": 2.0, "effects.rotor_drag.dy": 2.0, "effects.gusts.std": 1.2}
    randomize |= {name: RandomizeCfg(low=0.0, high=most) for name, most in weather.items()}
    com = RandomizeCfg(how="offset", low=(-0.005, -0.005, 0.0), high=(0.005, 0.005, 0.0))
    return replace(robot, randomize={**randomize, "body.com": com})


def _as_px4_flies_it(robot: RobotCfg) -> RobotCfg:
    """PX4's default parameters, and 150 to 1000 rad/s: SIM_GZ_EC_MIN and SIM_GZ_EC_MAX of its airframe 4001_gz_x500."""
    rotor = robot.the_rotor("the PX4 variant")
    least, most = (rotor.thrust_map[2] * speed**2 for speed in (150.0, 1000.0))
    px4 = load(Px4Cfg, CONFIG_DIR / "controllers" / "px4_defaults.yaml")
    source = f"{rotor.source}; speeds of PX4's airframe 4001_gz_x500"
    return replace(
        robot,
        rotor=replace(rotor, thrust_range=(least, most), source=source),
        control=replace(robot.control, px4=px4),
    )


def _as_arpl_declares(robot: RobotCfg) -> RobotCfg:
    """Rotor offsets and lags with which the ARPL flights were flown."""
    rotor = robot.the_rotor("the ARPL variant")
    return replace(
        robot,
        rotor=replace(
            rotor,
            time_constant_up=0.01,
            time_constant_down=0.01,
            source=f"{rotor.source} Here the lag is 0.01 s, ASSUMED: the flights were flown to find it.",
        ),
        mounts=replace(
            robot.mounts,
            layout=tuple(
                replace(m, position=tuple(0.028 / 0.0325 * p for p in m.position)) for m in robot.mounts.layout
            ),
            source="README of the ARPL flights: offsets of 0.028 m, order and signs",
        ),
    )


def _as_raced(robot: RobotCfg) -> RobotCfg:
    """The bare vehicle, with a sphere about each rotor: it fits through gates, and spheres cost a quarter of a box."""
    spheres = tuple(SphereCfg(center=(x, y, 0.0), radius=0.035) for x in (-0.035, 0.035) for y in (-0.035, 0.035))
    source = "Four spheres as wide as the collision box of drone-models, cf21B_500.xml (0.14 m x 0.14 m x 0.04 m)"
    return replace(
        robot,
        body=replace(
            robot.body, mass=0.04338, source=f"{robot.body.source} Here that of the bare vehicle: cf21B_500.xml"
        ),
        collision=CollisionCfg(spheres=spheres, source=source),
    )


def _held(robot: RobotCfg) -> RobotCfg:
    """The base on a stand."""
    assert robot.joints is not None
    return replace(robot, joints=replace(robot.joints, floating=False))


def _creeping(robot: RobotCfg) -> RobotCfg:
    """Elevations as ``aerial-gym identify joint`` finds them in the record of a release, per inertia of a point mass."""
    assert robot.joints is not None
    inertia = 0.01625 * 0.07**2  # kg m²
    creep = tuple(
        CreepCfg(stiffness=k * inertia, time=t) for k, t in ((3474.6, 0.048488), (1665.6, 0.36546), (656.34, 4.0371))
    )
    layout = tuple(
        replace(
            joint,
            spring=replace(
                joint.spring,
                stiffness=4877.9 * inertia,
                quadratic=0.0,
                damping=56.623 * inertia,
                rest=0.12473,
                creep=creep,
            ),
        )
        if joint.spring is not None and joint.name.startswith("elevation")
        else joint
        for joint in robot.joints.layout
    )
    source = f"{robot.joints.source} Elevations: aerial-gym identify joint, morphy_joint_step.csv (docs/joints.md)"
    return replace(robot, joints=replace(robot.joints, layout=layout, source=source))


def _stiff(robot: RobotCfg) -> RobotCfg:
    """Without joints: rigid in the reference pose."""
    layout = tuple(replace(mount, link=BASE) for mount in robot.mounts.layout)
    return replace(robot, joints=None, mounts=replace(robot.mounts, layout=layout))


for _name, _of, _change, _summary in (
    ("morphy_fixed_base", "morphy", _held, "morphy whose base is held, to look at its arms"),
    ("morphy_stiff", "morphy", _stiff, "morphy with rigid arms"),
    (
        "morphy_creeping",
        "morphy",
        _creeping,
        "morphy with arms as its record shows them: stiffer at first, then they creep",
    ),
    (
        "base_quadrotor_doubled_inertia",
        "base_quadrotor",
        _counted_twice,
        "base_quadrotor with the inertia that the Aerial Gym Simulator gives it: twice the right one",
    ),
    (
        "base_quadrotor_with_camera",
        "base_quadrotor",
        _carrying("base_depth_camera"),
        "base_quadrotor with a depth and segmentation camera",
    ),
    (
        "base_quadrotor_with_coarse_camera",
        "base_quadrotor",
        _carrying("coarse_depth_camera"),
        "base_quadrotor with a depth camera of fewer pixels, to train with",
    ),
    (
        "base_quadrotor_with_imu",
        "base_quadrotor",
        _carrying("base_imu"),
        "base_quadrotor with an inertial measurement unit",
    ),
    (
        "base_quadrotor_with_camera_imu",
        "base_quadrotor",
        _carrying("base_depth_camera", "base_imu"),
        "base_quadrotor with a depth and segmentation camera and an inertial measurement unit",
    ),
    (
        "base_quadrotor_with_lidar",
        "base_quadrotor",
        _carrying("base_lidar"),
        "base_quadrotor with a lidar that sees all around",
    ),
    (
        "base_quadrotor_with_dome_lidar",
        "base_quadrotor",
        _carrying("rslidar_airy"),
        "base_quadrotor with a dome lidar that sees what is behind it",
    ),
    (
        "base_quadrotor_with_coarse_dome_lidar",
        "base_quadrotor",
        _carrying("coarse_dome_lidar"),
        "base_quadrotor with a dome lidar of fewer rays, to train with",
    ),
    (
        "base_quadrotor_with_stereo_camera",
        "base_quadrotor",
        _carrying("stereo_camera"),
        "base_quadrotor with a stereo depth camera",
    ),
    (
        "base_quadrotor_with_faceid_normal_camera",
        "base_quadrotor",
        _carrying("base_normal_face_id_camera"),
        "base_quadrotor with a camera of surface normals and face ids",
    ),
    (
        "lmf2_with_camera",
        "lmf2",
        _carrying("base_depth_camera"),
        "lmf2 with a depth and segmentation camera, without which lmf2 is cheaper",
    ),
    (
        "lmf2_radar",
        "lmf2",
        _carrying("fake_radar"),
        "lmf2 with a radar-like sensor that looks ahead",
    ),
    (
        "base_quadrotor_on_skids",
        "base_quadrotor",
        _on_skids,
        "base_quadrotor with two skids, on which it stands where it lands",
    ),
    (
        "base_quadrotor_lander",
        "base_quadrotor_on_skids",
        _for_landing,
        "base_quadrotor_on_skids with propellers of 5 inches, in ground effect",
    ),
    (
        "crazyflie_21_brushless_racing",
        "crazyflie_21_brushless",
        _as_raced,
        "crazyflie_21_brushless without decks, with collision spheres that fit through gates",
    ),
    (
        "base_quadrotor_with_payload",
        "base_quadrotor",
        _with_load,
        "base_quadrotor with a load of 50 g that hangs half a metre below it",
    ),
    (
        "base_quadrotor_with_drag",
        "base_quadrotor",
        _dragged,
        "base_quadrotor with the drag of rotors in sideways flow, by which wind pushes it",
    ),
    (
        "base_quadrotor_braked_in_spin",
        "base_quadrotor",
        _braked_in_spin,
        "base_quadrotor with the drag of each rotor where it is, which brakes a spin",
    ),
    (
        "base_quadrotor_in_gusts",
        "base_quadrotor_with_drag",
        _in_gusts,
        "base_quadrotor_with_drag in gusts of 3 m/s",
    ),
    (
        "sampled_quadrotor",
        "base_quadrotor_in_gusts",
        _sampled,
        "base_quadrotor of which each episode draws thrust, inertia, centre of mass, lag, torque, drag of rotors, and gusts",
    ),
    (
        "x500_px4",
        "x500",
        _as_px4_flies_it,
        "x500 as PX4 flies it: its default parameters, and the rotor speeds of its Gazebo model",
    ),
    (
        "crazyflie_2x_arpl",
        "crazyflie_21",
        _as_arpl_declares,
        "crazyflie_21 as the ARPL flights declare it: their rotor offsets, and rotors that follow at once",
    ),
):
    ROBOTS.register_later(_name, partial(_variant, _summary, _change, of=_of), summary=partial(str, _summary))

for _rods in (4, 5, 6):
    for _mode in ("velocity", "position", "effort"):
        _name = f"snakey{'' if _rods == 4 else _rods}{'' if _mode == 'velocity' else f'_{_mode}'}"
        _summary = f"{_rods} rods of 1 m with a rotor each and universal joints between, driven by {_mode}"
        ROBOTS.register_later(_name, partial(snake, _rods, _mode), summary=partial(str, _summary))
