"""Digital filters of autopilots."""
