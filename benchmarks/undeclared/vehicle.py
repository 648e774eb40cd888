"""Parameters of one quadrotor, declared or true.

Frames: body is x forward, y left, z up, with its origin at the geometric centre of the frame, where the IMU sits.
Rotor order: 1 front right, 2 back right, 3 back left, 4 front left.
"""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.81  # Magnitude of gravity [m/s²], along world -z
ROTOR_RADIUS = 0.0635  # Of the propellers [m]: 5 inch in diameter

SOURCE = "invented for this benchmark: a 0.75 kg X quadrotor with 5 inch propellers on 4 cells; no real vehicle"


@dataclass(frozen=True, kw_only=True)
class Extra:
    """Parameters of hidden effects beyond mass, rotors and drag; each default does nothing."""

    h_force: float = 0.0  # In-plane force per rotor speed and airspeed in the disc [N s²/(m rad)]
    flapping: float = 0.0  # Hub moment per rotor speed and airspeed in the disc [N s²/rad]
    axial_inflow: float = 0.0  # Loss of thrust per rotor speed and airspeed along the axis [N s²/(m rad)]
    thrust_voltage: float = 0.0  # Exponent of the battery voltage in the thrust at a speed
    thrust_curve: float = 0.0  # Added to the exponent 2 of the rotor speed, about the speed of hover
    translational_lift: float = 0.0  # Thrust of one rotor per squared airspeed in the disc [N s²/m²]
    delay: float = 0.0  # Of the command on its way to the rotors [s]; a multiple of the plant's step
    battery_gain: float = 0.0  # Relative rotor speed per relative voltage [-]
    rotor_inertia: float = 0.0  # Of one rotor about its axis [kg m²]
    slung: tuple[float, float, float] = (0.0, 1.0, 0.0)  # Mass [kg], length of the cable [m], damping [N s/m]

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
    ground_law: tuple = ()  # Another law with its numbers (``other_laws``), as the four below
    ceiling_law: tuple = ()
    gust_law: tuple = ()
    downwash_law: tuple = ()
    drag_law: tuple = ()
    cable: tuple = ()  # Mass [kg], length [m], stiffness [N/m], damping [N s/m], depth of the hook below the centre of mass [m]
    imu_bias: tuple[float, ...] = (0.0,) * 6  # Accelerometer [m/s²] (3), gyro [rad/s] (3), IMU axes
    imu_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Roll, pitch and yaw of the IMU axes in the body [rad]
    tracked_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the axes of the logged attitude in the body [rad]."""

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


@dataclass(frozen=True, kw_only=True)
class PlantVehicle:
    """Mass, rotors and surrounding air of one quadrotor; vectors are in body axes, except ``wind_world``."""

    mass: float  # Mass [kg], > 0
    inertia: Array  # Inertia about the centre of mass [kg m²], symmetric positive definite, (3, 3)
    com: Array  # Centre of mass relative to the body origin [m], (3,)
    rotor_position: Array  # Rotor hubs relative to the body origin [m], (4, 3)
    rotor_axis: Array  # Direction of positive thrust, unit, (4, 3)
    rotor_spin: Array  # +1 turns positively about its axis, -1 negatively, (4,)
    thrust_coeff: Array  # Thrust per squared speed of each rotor [N s²/rad²], > 0, (4,)
    torque_ratio: float  # Drag torque per thrust [m], >= 0
    tau_up: float  # Lag of the rotor speed while it rises [s], > 0
    tau_down: float  # Lag of the rotor speed while it falls [s], > 0
    thrust_range: tuple[float, float]  # Lowest and highest thrust that is commanded of one rotor [N]
    linear_drag: Array  # Force per airspeed along each body axis [N s/m], (3,)
    quadratic_drag: Array  # Force per |airspeed| times airspeed along each body axis [N s²/m²], (3,)
    wind_world: Array  # Velocity of the air [m/s], world, (3,)
    extra: Extra = NEUTRAL  # What only some hidden effects need

    def __post_init__(self) -> None:
        positive = {"mass": self.mass, "tau_up": self.tau_up, "tau_down": self.tau_down}
        for name, value in positive.items():
            if not 0.0 < value < np.inf:
                raise ValueError(f"Vehicle.{name} = {value!r}: must be > 0 and finite")
        if not np.all(self.thrust_coeff > 0.0):
            raise ValueError(f"Vehicle.thrust_coeff = {self.thrust_coeff}: must be > 0")
        if not np.array_equal(self.inertia, self.inertia.T) or not np.all(np.linalg.eigvalsh(self.inertia) > 0.0):
            raise ValueError("Vehicle.inertia: must be symmetric and positive definite")

    def speed_range(self) -> tuple[float, float]:
        """Return the lowest and highest commanded rotor speed [rad/s], from the mean thrust coefficient."""
        low, high = np.sqrt(np.asarray(self.thrust_range) / self.thrust_coeff.mean())
        return float(low), float(high)

    def hover_speed(self) -> float:
        """Return the speed [rad/s] at which four equal rotors carry the weight, ``sqrt(m g / sum c_t)``."""
        return float(np.sqrt(self.mass * GRAVITY / self.thrust_coeff.sum()))


DECLARED = PlantVehicle(
    mass=0.75,
    inertia=np.array([[2.30e-3, 2.0e-5, -3.0e-5], [2.0e-5, 2.60e-3, 1.0e-5], [-3.0e-5, 1.0e-5, 4.40e-3]]),
    com=np.zeros(3),
    rotor_position=np.array(
        [[0.085, -0.08, 0.012], [-0.085, -0.08, 0.012], [-0.085, 0.08, 0.012], [0.085, 0.08, 0.012]]
    ),
    rotor_axis=np.tile([0.0, 0.0, 1.0], (4, 1)),
    rotor_spin=np.array([1.0, -1.0, 1.0, -1.0]),
    thrust_coeff=np.full(4, 1.45e-6),
    torque_ratio=0.014,
    tau_up=0.038,
    tau_down=0.038,
    thrust_range=(0.1, 6.0),
    linear_drag=np.array([0.20, 0.23, 0.12]),
    quadratic_drag=np.zeros(3),
    wind_world=np.zeros(3),
)
"""What the maker of the logs would write down: hover at 1126 rad/s, thrust to weight 3.3."""
