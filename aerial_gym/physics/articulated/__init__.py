"""Trees of rigid links with joints: an engine of its own beside that of rigid vehicles.

``tree`` says how links hang together and what they weigh, ``motion`` where they are and how they move, ``dynamics`` how they
accelerate, ``joint_laws`` what acts in joints, ``steppers`` how time goes on.
"""
