"""The files of a run: what is kept while it goes on, and what is made of it later. Without ROS."""
