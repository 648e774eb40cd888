"""Digital filters of what autopilots measure."""
