"""Parameters that PX4 needs to fly a vehicle of the simulation: rotor i of the robot file, from 0, is its motor i + 1.

PX4's body is x forward, y right, z down. Letters: E environments, R rotors.
"""

from aerial_gym.config.autopilots import Px4Cfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.errors import ConfigError
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.vehicle import Vehicle

FIRST_MOTOR = 101  # Output function of motor 1. Source: PX4 parameter reference, PWM_MAIN_FUNC1
MOST_ROTORS = 12  # Source: PX4 parameter reference, CA_ROTOR_COUNT


def px4_parameters(vehicle: Vehicle, px4: Px4Cfg, gravity: float) -> dict[str, float]:
    """Return PX4's geometry, outputs and hover thrust for a declared vehicle, as ``param set NAME VALUE`` takes them.

    The motor signal of PX4 is the share of the rotor's range of speeds.

    Raises:
        ConfigError: If PX4 cannot have such rotors.
    """
    if vehicle.num_rotors > MOST_ROTORS or vehicle.traits or not vehicle.upright:
        raise ConfigError(
            f"sitl px4: needs at most {MOST_ROTORS} rotors that turn in one direction, take a speed and thrust along body z. "
            "Take another robot"
        )
    thrust = rotor_thrust(vehicle, vehicle.speed_high)[0].tolist()
    factor, allocation = px4.THR_MDL_FAC or 0.0, Allocation(vehicle, gravity)
    result = {"CA_AIRFRAME": 0.0, "CA_ROTOR_COUNT": float(vehicle.num_rotors), "THR_MDL_FAC": factor}
    result["MPC_THR_HOVER"] = _hover_thrust(vehicle, allocation, gravity, factor)
    ratios = (vehicle.torque_map[0, :, 2] / vehicle.thrust_map[0, :, 2]).tolist()
    rows = zip(vehicle.rotor_lever[0].tolist(), vehicle.rotor_spin[0].tolist(), thrust, ratios, strict=True)
    for number, ((x, y, z), spin, full, ratio) in enumerate(rows):
        own = {
            "PX": x,
            "PY": -y,
            "PZ": -z,
            "CT": full,
            "KM": spin * ratio,
        }  # KM is positive for counter-clockwise rotors
        result |= {f"CA_ROTOR{number}_{name}": value for name, value in own.items()}
        result[f"PWM_MAIN_FUNC{number + 1}"] = float(FIRST_MOTOR + number)
    return result


def _hover_thrust(vehicle: Vehicle, allocation: Allocation, gravity: float, factor: float) -> float:
    """Return PX4's normalised hover thrust, the mean of all rotors: ``f s² + (1 - f) s`` of the motor signal s."""
    speed = allocation.speed(vehicle.mass[0] * gravity * allocation.inverse[..., 2])[0]
    signal = (speed - vehicle.speed_low[0]) / (vehicle.speed_high - vehicle.speed_low)[0]
    return float((factor * signal.square() + (1.0 - factor) * signal).mean())
