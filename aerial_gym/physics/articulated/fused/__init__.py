"""The articulated engine as Warp code, with its own kernel factory, which keeps that of rigid vehicles fast."""
