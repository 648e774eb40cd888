"""Fleet analysis: the measured-data loop over many logs. Only ``engine.py`` imports Ray."""
