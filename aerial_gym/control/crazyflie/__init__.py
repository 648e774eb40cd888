"""Controllers of the Crazyflie, from their papers and its documentation, in its units."""
