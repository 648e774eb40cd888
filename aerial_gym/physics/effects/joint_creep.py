"""Joint creep: soft arms that continue to bend for seconds, as viscoelastic materials do.

One slow Kelvin-Voigt element in each arm, ``tau h' = compliance f l a_z - h``, in ``arm_joint``.
"""

from aerial_gym.physics.effects.arm_joint import ArmJoint, joint_parameters


class JointCreep(ArmJoint):
    """Slow element of the joints."""

    name = "joint_creep"
    summary = "rotor arms continue to bend up under their thrust for seconds"
    parameters = joint_parameters(fastest=0.3, slowest=60.0, tau_scale=1.0, tau=3.0)
    excitation = "differences in thrust between rotors, and a mean thrust that changes for seconds"
    confused_with = ("joint_spring", "com_offset", "motor_tilt", "imu_misalignment")
