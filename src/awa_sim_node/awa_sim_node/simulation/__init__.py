"""A particle-in-cell simulation of an AWA-like injector. The simulated machine does not need it."""
