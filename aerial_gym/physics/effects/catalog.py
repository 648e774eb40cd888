"""The table of registered effects. A new effect needs one class and one line here; its module is imported at its first use."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import ImportPath
from aerial_gym.registry import Registry

if TYPE_CHECKING:
    from aerial_gym.physics.effects.base import Effect

EFFECTS: "Registry[Effect]" = Registry("effect")

for _name, _class in (
    ("rotor_drag", "RotorDrag"),
    ("quadratic_drag", "QuadraticDrag"),
    ("h_force_flapping", "HForceFlapping"),
    ("axial_inflow", "AxialInflow"),
    ("translational_lift", "TranslationalLift"),
    ("thrust_coefficient", "ThrustCoefficient"),
    ("weak_motor", "WeakMotor"),
    ("torque_ratio", "TorqueRatio"),
    ("motor_time_constant", "MotorTimeConstant"),
    ("motor_asymmetry", "MotorAsymmetry"),
    ("motor_failure", "MotorFailure"),
    ("stuck_rotor", "StuckRotor"),
    ("brown_out", "BrownOut"),
    ("actuation_delay", "ActuationDelay"),
    ("battery_sag", "BatterySag"),
    ("rotor_inertia", "RotorInertia"),
    ("motor_tilt", "MotorTilt"),
    ("joint_spring", "JointSpring"),
    ("joint_creep", "JointCreep"),
    ("com_offset", "ComOffset"),
    ("payload_mass", "PayloadMass"),
    ("slung_payload", "SlungPayload"),
    ("inertia_error", "InertiaError"),
    ("products_of_inertia", "ProductsOfInertia"),
    ("constant_wind", "ConstantWind"),
    ("wind_shear", "WindShear"),
    ("gusts", "Gusts"),
    ("random_force", "RandomForce"),
    ("ground_effect", "GroundEffect"),
    ("ceiling_effect", "CeilingEffect"),
    ("downwash", "Downwash"),
    ("buoyancy", "Buoyancy"),
    ("hull_drag", "HullDrag"),
    ("link_drag", "LinkDrag"),
    ("link_buoyancy", "LinkBuoyancy"),
    ("link_added_mass", "LinkAddedMass"),
    ("added_mass", "AddedMass"),
    ("added_inertia", "AddedInertia"),
    ("imu_bias", "ImuBias"),
    ("imu_misalignment", "ImuMisalignment"),
    ("rotor_speed_scale", "RotorSpeedScale"),
    ("blade_element", "BladeElement"),
    ("vortex_ring", "VortexRing"),
):
    _home = ImportPath(f"aerial_gym.physics.effects.{_place}")
    EFFECTS.register_later(_name, _home.make, summary=_home.summary)
