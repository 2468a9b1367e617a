"""The parts of the tuner's node: a run, how it begins and goes on, and what is served beside it."""
