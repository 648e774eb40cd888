"""Every effect that comes with the package, in one table. Adding an effect is adding one file and one line here."""

from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.effects.com_offset import ComOffset
from aerial_gym.physics.effects.constant_wind import ConstantWind
from aerial_gym.physics.effects.motor_time_constant import MotorTimeConstant
from aerial_gym.physics.effects.quadratic_drag import QuadraticDrag
from aerial_gym.physics.effects.rotor_drag import RotorDrag
from aerial_gym.physics.effects.thrust_coefficient import ThrustCoefficient
from aerial_gym.registry import Registry

EFFECTS: Registry[Effect] = Registry("effect")

for _effect in (
    RotorDrag(),
    QuadraticDrag(),
    ThrustCoefficient(),
    ComOffset(),
    MotorTimeConstant(),
    ConstantWind(),
):
    EFFECTS.register(_effect.name, _effect)
