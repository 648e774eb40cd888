"""``aerial-gym demo``: the whole story in one page."""
