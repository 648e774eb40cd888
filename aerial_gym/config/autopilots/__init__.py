"""Parameters of real autopilots, by the names that these give them."""
