"""The articulated engine as Warp code: a kernel factory of its own, so that that of rigid vehicles stays as fast as it is."""
