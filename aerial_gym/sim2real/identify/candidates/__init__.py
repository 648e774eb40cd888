"""What may differ between a vehicle and its model, linear about a fitted model, and the structure of what remains."""
