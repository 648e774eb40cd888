"""The table of registered effects. A new effect needs one class and one line here; its module is imported at its first use."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import ImportPath
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter

if TYPE_CHECKING:
    from aerial_gym.physics.effects.base import Effect

EFFECTS: "Registry[Effect]" = Registry("effect")

for _name, _place in (
    ("rotor_drag", "drag:RotorDrag"),
    ("rotor_drag_of_thrust", "drag:RotorDragOfThrust"),
    ("quadratic_drag", "drag:QuadraticDrag"),
    ("quadratic_drag_of_axes", "drag:QuadraticDragOfAxes"),
    ("h_force_flapping", "rotor_flow:HForceFlapping"),
    ("axial_inflow", "rotor_flow:AxialInflow"),
    ("translational_lift", "rotor_flow:TranslationalLift"),
    ("thrust_curve", "rotor_flow:ThrustCurve"),
    ("thrust_coefficient", "vehicle_errors:ThrustCoefficient"),
    ("weak_motor", "rotor_failures:WeakMotor"),
    ("motor_gain", "rotor_failures:MotorGain"),
    ("torque_ratio", "vehicle_errors:TorqueRatio"),
    ("arm_length", "vehicle_errors:ArmLength"),
    ("torque_gain", "vehicle_errors:TorqueGain"),
    ("motor_time_constant", "vehicle_errors:MotorTimeConstant"),
    ("motor_asymmetry", "vehicle_errors:MotorAsymmetry"),
    ("motor_failure", "rotor_failures:MotorFailure"),
    ("stuck_rotor", "rotor_failures:StuckRotor"),
    ("brown_out", "rotor_failures:BrownOut"),
    ("actuation_delay", "actuation:ActuationDelay"),
    ("battery_sag", "actuation:BatterySag"),
    ("thrust_voltage", "actuation:ThrustVoltage"),
    ("command_curve", "actuation:CommandCurveEffect"),
    ("rotor_inertia", "rotor_flow:RotorInertia"),
    ("motor_tilt", "rotor_failures:MotorTilt"),
    ("joint_spring", "arm_joint:JointSpring"),
    ("joint_creep", "arm_joint:JointCreep"),
    ("com_offset", "vehicle_errors:ComOffset"),
    ("payload_mass", "vehicle_errors:PayloadMass"),
    ("slung_payload", "slung_payload:SlungPayload"),
    ("slung_payload_rod", "slung_payload:RodPayload"),
    ("inertia_error", "vehicle_errors:InertiaError"),
    ("products_of_inertia", "vehicle_errors:ProductsOfInertia"),
    ("constant_wind", "air_motion:ConstantWind"),
    ("wind_shear", "air_motion:WindShear"),
    ("gusts", "air_motion:Gusts"),
    ("random_force", "air_motion:RandomForce"),
    ("random_push", "air_motion:RandomPush"),
    ("ground_effect", "rotor_flow:GroundEffect"),
    ("ceiling_effect", "rotor_flow:CeilingEffect"),
    ("ground_effect_curve", "rotor_flow:GroundEffectCurve"),
    ("ceiling_effect_curve", "rotor_flow:CeilingEffectCurve"),
    ("downwash", "air_motion:Downwash"),
    ("downwash_jet", "air_motion:DownwashJet"),
    ("downwash_core", "air_motion:DownwashCore"),
    ("buoyancy", "water:Buoyancy"),
    ("hull_drag", "water:HullDrag"),
    ("link_drag", "links:LinkDrag"),
    ("link_buoyancy", "links:LinkBuoyancy"),
    ("link_added_mass", "links:LinkAddedMass"),
    ("added_mass", "water:AddedMass"),
    ("added_inertia", "water:AddedInertia"),
    ("imu_bias", "sensor_errors:ImuBias"),
    ("imu_misalignment", "sensor_errors:ImuMisalignment"),
    ("attitude_bias", "sensor_errors:AttitudeBias"),
    ("rotor_speed_scale", "sensor_errors:RotorSpeedScale"),
    ("tachometer_scale", "sensor_errors:TachometerScale"),
    ("blade_element", "blade_element:BladeElement"),
    ("vortex_ring", "rotor_flow:VortexRing"),
):
    _home = ImportPath(f"aerial_gym.physics.effects.{_place}")
    EFFECTS.register_later(_name, _home.make, summary=_home.summary)

EFFECTS.accept_plugins(effect=instance_converter("aerial_gym.physics.effects.base:Effect"))
