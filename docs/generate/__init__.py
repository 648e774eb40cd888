"""Pages of the reference, generated from the code when the site is built."""
