"""MuJoCo as a physics backend: the rigid body and its contact with the ground are MuJoCo's, all else is the torch backend's."""
