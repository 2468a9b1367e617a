"""A simulated machine to tune: the Argonne Wakefield Accelerator (AWA) injector, or a toy problem."""

import contextlib

with contextlib.suppress(ModuleNotFoundError):  # the simulation alone does without mobo_tuner
    from mobo_tuner.interrupts import end_quietly

    end_quietly(("awa_sim",))
