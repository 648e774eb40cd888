"""Ways to solve for the accelerations of a tree in a kernel, beside that of the library, and kernels that compare them."""
