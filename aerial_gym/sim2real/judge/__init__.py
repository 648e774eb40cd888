"""What test flights say of a model, and the verdict."""
