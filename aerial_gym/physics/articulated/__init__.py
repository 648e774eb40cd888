"""Engine for trees of rigid links with joints, separate from that of rigid vehicles.

``tree`` has topology and masses, ``motion`` kinematics, ``dynamics`` accelerations, ``joint_laws`` the efforts of joints, and
``steppers`` the integrators.
"""
