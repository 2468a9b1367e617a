"""A particle-in-cell simulation of an AWA-like injector; the simulated machine does not need it."""
