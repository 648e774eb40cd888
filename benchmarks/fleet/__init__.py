"""A synthetic fleet of the undeclared plant, and scores of ``aerial-gym fleet`` on it."""
