"""Is a log what it claims to be: frames, clocks, kinematics, rotors."""
