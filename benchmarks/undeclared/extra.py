"""Parameters of hidden effects beyond mass, rotors and drag; neutral unless hidden."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True, kw_only=True)
class Extra:
    """Numbers of the effects that only ``FullPlant`` and the sensors know; each default does nothing."""

    h_force: float = 0.0  # In-plane force per rotor speed and airspeed in the disc [N s²/(m rad)]
    flapping: float = 0.0  # Hub moment per rotor speed and airspeed in the disc [N s²/rad]
    axial_inflow: float = 0.0  # Loss of thrust per rotor speed and airspeed along the axis [N s²/(m rad)]
    translational_lift: float = 0.0  # Thrust of one rotor per squared airspeed in the disc [N s²/m²]
    delay: float = 0.0  # Of the command on its way to the rotors [s]; a multiple of the plant's step
    battery_gain: float = 0.0  # Relative rotor speed per relative voltage [-]
    rotor_inertia: float = 0.0  # Of one rotor about its axis [kg m²]

    slung: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Mass [kg], length of the cable [m], damping between load and vehicle [N s/m]."""

    joint_spring: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Angle of each arm per moment at its joint [rad/(N m)], time constant [s], place of the joint on the way from the vertical
    body axis to the hub [-]."""

    joint_creep: tuple[float, float, float] = (0.0, 1.0, 0.0)  # The same of a slow element

    shear: tuple[float, float, float, float] = (0.0, 0.0, 10.0, 0.0)
    """Wind at the height of reference along world x and y [m/s], that height [m], exponent [-]."""

    gust: tuple[float, float] = (0.0, 1.0)  # Standard deviation of each axis [m/s], correlation time [s]
    ground: float = 0.0  # Strength of the ground effect [-]
    ceiling: float = 0.0  # Strength of the ceiling effect [-]
    downwash: tuple[float, float] = (0.0, 1.0)  # Force straight below the other vehicle [N], width of its wake [m]
    imu_bias: tuple[float, ...] = (0.0,) * 6  # Accelerometer [m/s²] (3), gyro [rad/s] (3), IMU axes
    imu_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Roll, pitch and yaw of the IMU axes in the body [rad]
    rotor_reading: float = 1.0  # Logged per true rotor speed [-]
    periodic: tuple[float, float] = (0.0, 1.0)  # Amplitude of a force along body x [N], frequency [Hz]

    attraction: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 1.0)
    """Centre, world [m] (3), largest force [N], distance of the largest force [m]."""

    fading: tuple[float, float] = (0.0, 1.0)  # Share of thrust lost in the end [-], time constant [s]
    shadow: tuple[float, float] = (0.0, 0.0)  # Largest force along body y [N], heading at which it is largest [rad]

    def document(self) -> dict[str, object]:
        """Return the numbers that are not neutral."""
        return {key: value for key, value in asdict(self).items() if value != getattr(NEUTRAL, key)}


NEUTRAL = Extra()
