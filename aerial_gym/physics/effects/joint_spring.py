"""Joint spring: soft arms that follow the thrust quickly, with elastic, damped joints.

One Kelvin-Voigt element in each arm, ``tau h' = compliance f l a_z - h``, in ``arm_joint``.
"""

from aerial_gym.physics.effects.arm_joint import ArmJoint, joint_parameters


class JointSpring(ArmJoint):
    """Fast element of the joints."""

    name = "joint_spring"
    summary = "rotor arms bend up under their thrust, within tenths of a second"
    parameters = joint_parameters(fastest=0.001, slowest=0.3, tau_scale=0.02, tau=0.02)
    excitation = "differences in thrust between rotors, at high and at low thrust"
    confused_with = ("joint_creep", "com_offset", "motor_tilt", "imu_misalignment")
