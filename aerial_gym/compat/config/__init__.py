"""Configuration classes as users of the Aerial Gym Simulator write them, and what becomes of them here."""
