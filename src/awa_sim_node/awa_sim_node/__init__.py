"""A simulated machine to tune: the Argonne Wakefield Accelerator (AWA) injector, or a toy problem."""

from mobo_tuner.interrupts import end_quietly

end_quietly(("awa_sim",))
