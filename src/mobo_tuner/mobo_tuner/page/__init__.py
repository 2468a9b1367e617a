"""The page for the control room: what a browser shows of a tuner, and the ways to steer it."""
