"""Kinds of effect, one file each: the hooks of a step that an effect can implement, in torch and in Warp."""
