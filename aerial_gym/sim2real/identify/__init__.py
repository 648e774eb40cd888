"""What fits to flights: effects, tolerances, the battery, a learned remainder."""
