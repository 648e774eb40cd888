"""MuJoCo as a physics backend for the rigid body and its contacts; all else is shared with the torch backend."""
