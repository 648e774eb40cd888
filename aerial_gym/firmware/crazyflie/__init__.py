"""Controllers of the Crazyflie's firmware as a host library: build, parameters, instances, flights and comparison."""
