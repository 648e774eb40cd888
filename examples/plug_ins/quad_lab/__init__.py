"""Examples of plug-ins for aerial_gym, one file for each kind."""
