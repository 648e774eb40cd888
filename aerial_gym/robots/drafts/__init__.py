"""Robot files whose numbers have an origin each: given, logged, measured or assumed."""
