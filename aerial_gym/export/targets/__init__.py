"""Export to the engines that fly policies on vehicles: PX4's ``mc_nn_control`` and ``mc_raptor``, and the Crazyflie."""
