"""A simulated machine to tune: the Argonne Wakefield Accelerator (AWA) injector, or a toy problem."""
