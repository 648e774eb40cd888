"""Every effect that comes with the package, in one table. Adding an effect is adding one file and one line here."""

from aerial_gym.physics.effects.actuation_delay import ActuationDelay
from aerial_gym.physics.effects.axial_inflow import AxialInflow
from aerial_gym.physics.effects.base import Effect
from aerial_gym.physics.effects.battery_sag import BatterySag
from aerial_gym.physics.effects.ceiling_effect import CeilingEffect
from aerial_gym.physics.effects.com_offset import ComOffset
from aerial_gym.physics.effects.constant_wind import ConstantWind
from aerial_gym.physics.effects.downwash import Downwash
from aerial_gym.physics.effects.ground_effect import GroundEffect
from aerial_gym.physics.effects.gusts import Gusts
from aerial_gym.physics.effects.h_force_flapping import HForceFlapping
from aerial_gym.physics.effects.imu_bias import ImuBias
from aerial_gym.physics.effects.imu_misalignment import ImuMisalignment
from aerial_gym.physics.effects.inertia_error import InertiaError
from aerial_gym.physics.effects.joint_creep import JointCreep
from aerial_gym.physics.effects.joint_spring import JointSpring
from aerial_gym.physics.effects.motor_asymmetry import MotorAsymmetry
from aerial_gym.physics.effects.motor_tilt import MotorTilt
from aerial_gym.physics.effects.motor_time_constant import MotorTimeConstant
from aerial_gym.physics.effects.payload_mass import PayloadMass
from aerial_gym.physics.effects.quadratic_drag import QuadraticDrag
from aerial_gym.physics.effects.rotor_drag import RotorDrag
from aerial_gym.physics.effects.rotor_inertia import RotorInertia
from aerial_gym.physics.effects.rotor_speed_scale import RotorSpeedScale
from aerial_gym.physics.effects.slung_payload import SlungPayload
from aerial_gym.physics.effects.thrust_coefficient import ThrustCoefficient
from aerial_gym.physics.effects.torque_ratio import TorqueRatio
from aerial_gym.physics.effects.translational_lift import TranslationalLift
from aerial_gym.physics.effects.weak_motor import WeakMotor
from aerial_gym.physics.effects.wind_shear import WindShear
from aerial_gym.registry import Registry

EFFECTS: Registry[Effect] = Registry("effect")

for _effect in (
    RotorDrag(),
    QuadraticDrag(),
    HForceFlapping(),
    AxialInflow(),
    TranslationalLift(),
    ThrustCoefficient(),
    WeakMotor(),
    TorqueRatio(),
    MotorTimeConstant(),
    MotorAsymmetry(),
    ActuationDelay(),
    BatterySag(),
    RotorInertia(),
    MotorTilt(),
    JointSpring(),
    JointCreep(),
    ComOffset(),
    PayloadMass(),
    SlungPayload(),
    InertiaError(),
    ConstantWind(),
    WindShear(),
    Gusts(),
    GroundEffect(),
    CeilingEffect(),
    Downwash(),
    ImuBias(),
    ImuMisalignment(),
    RotorSpeedScale(),
):
    EFFECTS.register(_effect.name, _effect)
