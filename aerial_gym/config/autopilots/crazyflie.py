"""Parameters of the Crazyflie's controllers, by the names that its firmware gives them.

Counts are those of its PWM: 65535 is all that a rotor gives. What is left out is derived from the vehicle
(``control.crazyflie.parameters``), so that any quadrotor flies; ``config/robots/crazyflie/crazyflie_21.yaml`` has the numbers
that a Crazyflie 2 comes with.
Source: Bitcraze's documentation, "Controllers in the Crazyflie" and "Mellinger controller", and its list of parameters; of
``BrescianiniCfg`` the papers that ``control.crazyflie.brescianini`` names.
"""

from dataclasses import dataclass
from typing import ClassVar

from aerial_gym.config.autopilots.autopilot import AutopilotTuning
from aerial_gym.config.checks import Vec3, require


@dataclass(frozen=True, kw_only=True)
class MellingerCfg(AutopilotTuning):
    """Parameters of ``crazyflie_mellinger_control``: group ``ctrlMel``. It runs at ``ControllerCfg.rate_hz``, there 500 Hz."""

    POSITIVE: ClassVar[frozenset[str]] = frozenset(("mass", "massThrust"))
    mass: float | None = None  # Vehicle mass in the firmware's settings [kg]
    massThrust: float | None = None  # Counts per newton of all rotors together
    kp_xy: float | None = None  # Force per position error [N/m], along world x and y; names in `_z`: along or about z
    kd_xy: float | None = None  # Per velocity error [N s/m]
    ki_xy: float = 0.0  # Per integrated position error [N/(m s)]; that of a Crazyflie is 0.05
    i_range_xy: float = 2.0  # Largest integrated error [m s]
    kp_z: float | None = None
    kd_z: float | None = None
    ki_z: float = 0.0
    i_range_z: float = 0.4
    kR_xy: float | None = None  # Moment per attitude error [counts], of which 2 is a radian, about body x and y
    kw_xy: float | None = None  # Per rate error [counts s/rad]
    ki_m_xy: float = 0.0  # Per integrated attitude error [counts/s]
    i_range_m_xy: float = 1.0  # Largest integrated error [s]
    kd_omega_rp: float = 0.0  # Per difference of the rate error [counts s²/rad], about body x and y
    kR_z: float | None = None
    kw_z: float | None = None
    ki_m_z: float = 0.0
    i_range_m_z: float = 1500.0
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers


@dataclass(frozen=True, kw_only=True)
class CrazyfliePidCfg(AutopilotTuning):
    """Parameters of ``crazyflie_pid_control``; attitude and rates run at ``rate_hz``, the rest at ``ControllerCfg.rate_hz``.

    Three numbers are of x, y, z, or of roll, pitch, yaw.
    """

    rate_hz: float | None = None  # Rate of the attitude and rate loops [1/s]. Default: every physics step; there 500
    position_kp: Vec3 | None = None  # Velocity per position error [1/s]: `posCtlPid.xKp`, `yKp`, `zKp`
    position_ki: Vec3 = (0.0, 0.0, 0.0)  # Per integrated one [1/s²]: `posCtlPid.xKi`, ..

    velocity_max: Vec3 = (1.0, 1.0, 1.0)  # Largest velocity setpoint [m/s], clamp a tenth above: `posCtlPid.xVelMax`

    velocity_kp: Vec3 | None = None
    """Tilt per velocity error [deg s/m], along z output, a thousand counts each, [s/m]: ``velCtlPid.vxKp``, ..."""

    velocity_ki: Vec3 | None = None  # Per integrated one [deg/m], [1/m]: `velCtlPid.vxKi`, ..
    tilt_limit: float = 20.0  # Largest roll and pitch [deg]: `posCtlPid.rLimit`, `pLimit`
    thrust_base: float | None = None  # Counts that hover: `posCtlPid.thrustBase`
    thrust_min: float | None = None  # Least counts: `posCtlPid.thrustMin`; if not given 5/9 of those that hover
    attitude_kp: Vec3 | None = None  # Rate per angle [1/s]: `pid_attitude.roll_kp`, ..
    attitude_ki: Vec3 = (0.0, 0.0, 0.0)  # Per integrated one [1/s²]: `pid_attitude.roll_ki`, ..
    attitude_kd: Vec3 = (0.0, 0.0, 0.0)  # Per measured change of the angle [-]: `pid_attitude.roll_kd`, ..
    attitude_limit: Vec3 = (20.0, 20.0, 360.0)  # Largest integrated angle [deg s]
    rate_kp: Vec3 | None = None  # Counts per rate error [s/deg]: `pid_rate.roll_kp`, ..
    rate_ki: Vec3 | None = None  # Per integrated one [1/deg]: `pid_rate.roll_ki`, ..
    rate_kd: Vec3 = (0.0, 0.0, 0.0)  # Per measured change of the rate [s²/deg]: `pid_rate.roll_kd`, ..
    rate_limit: Vec3 | None = None  # Largest integrated rate [deg]; if not given it takes half of the possible moment
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers


@dataclass(frozen=True, kw_only=True)
class CrazyflieLeeCfg(AutopilotTuning):
    """Parameters of ``crazyflie_lee_control``: group ``ctrlLee``. It runs at ``ControllerCfg.rate_hz``, there 500 Hz.

    Three numbers are along world x, y, z, or about body x, y, z.
    """

    POSITIVE: ClassVar[frozenset[str]] = frozenset(("mass",))
    mass: float | None = None  # Vehicle mass in the firmware's settings [kg]
    Kpos_P: Vec3 | None = None  # Acceleration per position error [1/s²]; that of a Crazyflie is 7
    Kpos_D: Vec3 | None = None  # Per velocity error [1/s]; that of a Crazyflie is 4

    Kpos_I: Vec3 = (0.0, 0.0, 0.0)
    """Per integrated position error [1/s³]; that of a Crazyflie is 0. It removes the error by wind and overshoots a step."""

    Kpos_I_limit: Vec3 | None = None
    """Largest integrated position error [m s]. If not given half of the acceleration that the inclination allows is left to it.
    The firmware's parameter of that name limits nothing."""

    KR: Vec3 | None = None  # Torque per attitude error [N m/rad]; that of a Crazyflie is 0.007, about z 0.008
    Kw: Vec3 | None = None  # Per rate error [N m s/rad]; that of a Crazyflie is 0.00115, about z 0.002
    KI: Vec3 = (0.0, 0.0, 0.0)  # Per integrated attitude error [N m/(rad s)]; that of a Crazyflie is 0.03
    KI_limit: Vec3 | None = None  # Largest integrated attitude error [rad s]. Default: half the hover torque
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers


@dataclass(frozen=True, kw_only=True)
class BrescianiniCfg(AutopilotTuning):
    """Parameters of ``crazyflie_brescianini_control``: group ``ctrlAtt``, and what a Crazyflie has compiled in.

    Body rates are controlled at ``rate_hz``; the rest runs at ``ControllerCfg.rate_hz``.
    """

    POSITIVE: ClassVar[frozenset[str]] = frozenset(
        ("rate_hz", "tau_xy", "tau_z", "tau_rp", "tau_rp_rate", "tau_yaw_rate", "coll_max", "omega_rp_max", "omega_yaw_max")
    )  # fmt: skip

    rate_hz: float | None = None  # Rate of the body-rate loop [1/s]. Default: every physics step; there 500
    tau_xy: float | None = None  # Time constant of the position [s], along world x and y
    zeta_xy: float | None = None  # Its damping ratio [-]
    tau_z: float | None = None  # Along z
    zeta_z: float | None = None
    tau_rp: float | None = None  # Time constant of the attitude [s]
    mixing_factor: float | None = None  # Weight of the heading error, 0 to 1; that of a Crazyflie is 1

    tau_rp_rate: float | None = None
    """Time constant of body rates about x and y [s]; from here on no parameters of the group, but compiled in."""

    tau_yaw_rate: float | None = None  # About z
    coll_min: float | None = None  # Least thrust per mass [m/s²], 1 there; if not given a tenth of the weight
    coll_max: float | None = None  # Largest thrust per mass [m/s²]. If not given all that the rotors give
    omega_rp_max: float = 30.0  # Largest wanted rate of tilting [rad/s]: that of a Crazyflie, as the next
    omega_yaw_max: float = 10.0  # Largest wanted rate about body z [rad/s]
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, "mixing_factor", (self.mixing_factor or 0.0) <= 1.0, "must be from 0 to 1")
        low, high = self.coll_min, self.coll_max
        require(self, "coll_min", low is None or high is None or low < high, f"must be below coll_max = {high!r}")
