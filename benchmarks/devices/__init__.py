"""IMUs and propellers against what their files and tests say."""
