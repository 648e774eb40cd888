"""Controllers of the Crazyflie, from papers and its documentation, in its own units."""
