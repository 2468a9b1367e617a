"""Multi-objective Bayesian tuning of a running machine, with ROS 2 nodes around it."""
