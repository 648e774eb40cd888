"""One module a trainer, named as a user names it; each has ``run``."""
