"""PX4's simulator interface: MAVLink messages of sensors and motors in lockstep, on loopback. Not tested with PX4 itself."""
