"""Translation of configuration classes of the Aerial Gym Simulator."""
